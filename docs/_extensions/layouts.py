"""The directive `layouts`: tables of a packet's fields, generated from its schema.

    ```{layouts} RobotModeData
    ```

A packet class has one layout for each set of fields that a release sends. If a layout is the beginning of a longer
layout, the table of the longer layout shows both: the column `end` is the length of a packet that ends there. With the
option `firmware`, the directive shows only the layout of that release.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, ClassVar

import numpy as np
from _tables import spans, table
from docutils import nodes
from docutils.parsers.rst import directives
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment
from sphinx.util import logging
from sphinx.util.docutils import SphinxDirective

from linkcore.errors import PacketError
from linkcore.wire.fields import Array, Coded, Mask64, Raw, Text
from linkcore.wire.layout import Layout, Place
from linkcore.wire.packet import State
from urlink import packets
from urlink.protocol.firmware import RELEASES
from urlink.protocol.primary.robot_message import MESSAGES, PACKAGES
from urlink.protocol.primary.robot_state import SUB_PACKAGES

_log = logging.getLogger(__name__)

# Only the necessary columns, because a table has to fit the page.
_HEAD = ("offset", "end", "field", "wire type", "since", "meaning")


class LayoutsDirective(SphinxDirective):
    """The layouts of one packet class as tables."""

    required_arguments = 1
    option_spec: ClassVar[dict[str, Any]] = {"firmware": directives.unchanged_required}

    def run(self) -> list[nodes.Node]:
        """Return the summary of the class, and a table for each layout that is not part of a longer one."""
        name = self.arguments[0]
        cls: type[State] | None = getattr(packets, name, None)
        if cls is None or not hasattr(cls, "LAYOUTS"):
            raise self.error(f"urlink.packets has no class {name}")
        documented(self.env).setdefault(self.env.docname, set()).add(name)
        return tables(name, self.options.get("firmware"))


def tables(name: str, firmware: str | None = None) -> list[nodes.Node]:
    """Return the summary of a packet class and its layouts: all layouts, or the layout of one release."""
    cls: type[State] = getattr(packets, name)
    chosen = [cls.LAYOUTS.of(firmware)] if firmware is not None else longest(cls)
    found: list[nodes.Node] = [nodes.paragraph("", (cls.__doc__ or "").partition("\n\n")[0].replace("\n", " "))]
    for layout in chosen:
        found.append(nodes.paragraph("", "", nodes.strong("", sizes(cls, layout))))
        found.append(fields_table(layout))
    return found


def documented(env: BuildEnvironment) -> dict[str, set[str]]:
    """Return the packet classes whose tables are on each page."""
    pages: dict[str, set[str]] | None = getattr(env, "layouts_documented", None)
    if pages is None:
        pages = {}
        env.layouts_documented = pages  # type: ignore[attr-defined]
    return pages


def longest(cls: type[State]) -> list[Layout]:
    """Return the layouts that are not the beginning of a longer layout, oldest first."""
    every = cls.LAYOUTS.all
    return [one for one in every if not any(one is not other and begins(one, other) for other in every)]


def begins(short: Layout, long: Layout) -> bool:
    """Whether `long` has the fields of `short`, in the same shapes, before its own."""
    return long.fields[: len(short.fields)] == short.fields and len(long.fields) > len(short.fields)


def sizes(cls: type[State], layout: Layout) -> str:
    """Return the sizes of the packets in a table, each with the releases that send it."""
    parts = []
    for each in cls.LAYOUTS.all:
        # A short layout that is the beginning of several layouts belongs to the newest of them.
        home = [other for other in longest(cls) if other is each or begins(each, other)][-1]
        if home is layout:
            size = f"{'at least ' if each.has_text else ''}{each.size} bytes"
            parts.append(size + releases(cls, each) + (", with the optional block" if each.has_block else ""))
    return "; ".join(parts)


def releases(cls: type[State], layout: Layout) -> str:
    """Return the releases that send this layout; empty if no release is known to send another one."""
    if layout.first == (0, 0) and len({each.first for each in cls.LAYOUTS.all}) == 1:
        return ""
    numbers = []
    for number, release in enumerate(RELEASES):
        try:
            sent = cls.LAYOUTS.of(release.since, dict.fromkeys(cls.LAYOUTS.blocks, layout.has_block))
        except PacketError:
            continue
        if sent is layout:
            numbers.append(number)
    return f" ({spans(numbers)})"


def fields_table(layout: Layout) -> nodes.table:
    """Return the table of a layout; without the column `since` if every release sends all fields."""
    found = list(header_rows(layout))
    is_fixed = True
    for place in layout.places.values():
        found.append(row(place, is_fixed))
        is_fixed = is_fixed and place.number is not None
    shown = [number for number, name in enumerate(_HEAD) if name != "since" or any(each[number] for each in found)]
    head, *body = [tuple(each[number] for number in shown) for each in (_HEAD, *found)]
    return table(head, body, code=(head.index("field"),))


def header_rows(layout: Layout) -> Iterator[tuple[str, ...]]:
    """Yield the rows of the header, which precede the fields."""
    offset = 0
    for name, number in layout.header.parts.items():
        end = offset + number.width
        meaning = "size of the packet in bytes, including this field" if name == "size" else "type byte"
        yield str(offset), str(end), name, np.dtype(number.kind).name, "", meaning
        offset = end


def row(place: Place, is_fixed: bool) -> tuple[str, ...]:
    """Return the row of a field. A field that follows a text has no fixed offset."""
    field = place.field
    count = place.count or 1
    offset, end = str(place.offset), str(place.offset + place.stride * (count - 1) + place.width)
    if place.stride != place.width:
        offset = f"{place.offset} + {place.stride} i"
    since = "" if field.since.text == "0.0" else field.since.text.replace("/", " / ")
    if field.until is not None:
        since += f"{' ' if since else ''}until {'.'.join(map(str, field.until))}"
    if place.number is None:
        end = ""
    if not is_fixed:
        offset, end = "", ""
    kind = shape(place) if place.count is None else f"{count} × {shape(place)}"
    meaning = f"{field.doc} [{field.unit}]" if field.unit else field.doc
    return offset, end, field.name, kind, since, meaning


def shape(place: Place) -> str:
    """Return the type on the wire, and the enum of its number."""
    element = place.shape.element if isinstance(place.shape, Array) else place.shape
    if isinstance(element, Raw):
        what = "text" if isinstance(element, Text) else "bytes"
        return f"{what} to the end" if element.prefix is None else f"uint{8 * place.size} length, {what}"
    if element is Mask64:
        return "64-bit mask"
    assert place.number is not None
    number = np.dtype(place.number.kind).name  # `d` of 8 bytes is float64
    if isinstance(element, Coded):
        return f"{number} as {getattr(element.meaning, '__name__', '')}"
    return number


def check(app: Sphinx, env: BuildEnvironment) -> None:
    """Warn about packet classes that no page shows."""
    shown = set().union(*documented(env).values())
    every = {cls.__name__ for group in SUB_PACKAGES.values() for cls in group}
    every |= {cls.__name__ for cls in (*MESSAGES.values(), *PACKAGES.values())}
    for name in sorted(every - shown):
        _log.warning("no page shows the layouts of %s", name)


def forget(app: Sphinx, env: BuildEnvironment, docname: str) -> None:
    """Forget the classes of a page before Sphinx reads it again."""
    documented(env).pop(docname, None)


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the directive."""
    app.add_directive("layouts", LayoutsDirective)
    app.connect("env-check-consistency", check)
    app.connect("env-purge-doc", forget)
    return {"parallel_read_safe": False, "parallel_write_safe": True}

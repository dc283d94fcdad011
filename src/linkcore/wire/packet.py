"""Typed, frozen packets declared once: `@packet` and `wire()`.

A packet class says, field by field, the Python type that users hold beside the construct shape on
the wire, the unit, and the version since which it is sent::

    @packet(header=PACKAGE, type=9)
    class CalibrationData(State):
        F: Vector = wire(Float64b[3], "N", "force")

From that the decorator derives one `Layout` per distinct order of fields, the properties, and the
choice of the layout for a packet of a given length and version. A state *is* its bytes: the
properties read from them, so nothing is lost and equality is equality of bytes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

import numpy as np
import numpy.typing as npt

from ..errors import PacketError
from .layout import Layout, Row, Wire
from .shapes import OpenInt
from .version import Since, Version, parse_version, version_text

if TYPE_CHECKING:
    from typing_extensions import Self

    from ..stamp import Stamp

__all__ = ["IntVector", "Layouts", "State", "Vector", "packet", "wire"]

#: Read-only float64 array; the declaration of the field says its length.
Vector = npt.NDArray[np.float64]
#: Read-only integer array.
IntVector = npt.NDArray[np.integer[Any]]

_Class = TypeVar("_Class", bound="type[State]")


def wire(
    shape: Any,
    unit: str = "",
    doc: str = "",
    *,
    since: str = "0.0",
    until: str | None = None,
    before: tuple[str, Any] | None = None,
    interleave: str | None = None,
    block: str | None = None,
) -> Any:
    """Declare one field of a packet.

    Args:
        shape: construct shape: `Float64b`, `Float64b[6]`, `Coded(Int8ub, bool)`, `Text()`.
        unit: SI unit, or what the number is.
        doc: meaning.
        since: first versions that send it, one per generation: ``"3.10/5.4"``.
        until: first version that no longer does.
        before: ``("3.0", Int16ub)``: versions before 3.0 send this other shape.
        interleave: neighbours of the same group are sent element by element in turn.
        block: the field is sent only when the field of this name is true.
    """
    return Wire(
        name="",
        shape=shape,
        unit=unit,
        doc=doc,
        since=Since(since),
        until=None if until is None else parse_version(until),
        before=None if before is None else (parse_version(before[0]), before[1]),
        interleave=interleave,
        block=block,
    )


class State:
    """One decoded packet: typed, frozen, and backed by the bytes that came.

    ``State(version, name=value, ...)`` builds one, for tests and simulators: what is not given is
    zero. Equal states have equal bytes.
    """

    __slots__ = ("_data", "_layout", "_lost", "_stamp", "_values")

    #: name -> declaration of the field, in declared order
    FIELDS: ClassVar[Mapping[str, Wire]] = {}
    #: the layouts of the class, and the choice among them
    LAYOUTS: ClassVar[Layouts]
    #: False for a sample of something that goes on, True for news that comes once
    IS_EVENT: ClassVar[bool] = False

    _data: bytes
    _layout: Layout
    _lost: bool
    _stamp: Stamp | None
    _values: Any

    def __init__(self, version: str | Version | None = None, /, **fields: Any) -> None:
        layout = self.LAYOUTS.of(version, fields)
        built = layout.decode(layout.encode(fields))
        self._data, self._layout, self._stamp, self._values = built._data, layout, None, built._values

    @classmethod
    def dtype(cls, version: str | Version | None = None) -> np.dtype[Any]:
        """The numpy dtype of the packet on the wire, as `version` (or the newest) sends it.

        ``np.frombuffer(data, RealtimeState.dtype("5.10"))["q_actual"]`` reads many at once.
        """
        return cls.LAYOUTS.of(version).dtype

    @property
    def received(self) -> Stamp | None:
        """When the bytes arrived; None for a state that came over no link."""
        return self._stamp

    @property
    def tail(self) -> bytes:
        """The bytes after the last field that is known."""
        return self._data[self._layout.end(self._data) :]

    def __bytes__(self) -> bytes:
        """The packet as it lay on the wire, header and tail included."""
        return self._data

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        return self._data == other._data

    def __hash__(self) -> int:
        return hash(self._data)

    def __reduce__(self) -> tuple[object, ...]:
        return (_restored, (type(self), self._data, self._layout.first, self._layout.has_block, self._stamp))

    def __copy__(self) -> Self:
        return self

    def __deepcopy__(self, memo: object) -> Self:
        return self

    def dissect(self) -> Iterator[Row]:
        """Every stretch of the packet's bytes with offset, name, value and unit; the unknown tail last."""
        return self._layout.dissect(self._data)

    def to_dict(self) -> dict[str, Any]:
        """name -> plain Python value of every field sent: numbers, lists, text; codes by name."""
        return {name: _plain(getattr(self, name)) for name in self._layout.places}

    def __str__(self) -> str:
        shown = ", ".join(f"{name}={_short(getattr(self, name))}" for name in self._layout.places)
        return f"{type(self).__name__}({shown})"

    __repr__ = __str__

    def _repr_html_(self) -> str:
        import html  # notebooks have it already; whoever imports us should not pay for it

        rows = "".join(
            f"<tr><td>{name}</td><td>{html.escape(_short(getattr(self, name)))}</td>"
            f"<td>{html.escape(place.wire.unit)}</td><td>{html.escape(place.wire.doc)}</td></tr>"
            for name, place in self._layout.places.items()
        )
        head = "<tr><th>field</th><th>value</th><th>unit</th><th>meaning</th></tr>"
        return f"<table><caption>{type(self).__name__}</caption>{head}{rows}</table>"


def _restored(cls: type[State], data: bytes, first: Version, has_block: bool, stamp: Stamp | None) -> Any:
    (layout,) = (each for each in cls.LAYOUTS.all if (each.first, each.has_block) == (first, has_block))
    return layout.decode(data, stamp)


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, tuple):
        return [_plain(element) for element in value]
    if isinstance(value, OpenInt):
        return value.name
    if isinstance(value, bytes):
        return value.hex()
    return value


def _short(value: Any) -> str:
    """Text for one line, without control characters, whatever came over the wire."""
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, OpenInt):
        return str(value.name)
    if isinstance(value, (np.ndarray, tuple)):
        return "[" + ", ".join(_short(element) for element in list(value)) + "]"
    return repr(value) if isinstance(value, (str, bytes)) else str(value)


class Layouts:
    """The layouts of one packet class, and the choice among them by version and by length."""

    def __init__(
        self,
        cls: type[State],
        header: Any,
        constants: Mapping[str, int],
        reorder: tuple[Version, Sequence[str]] | None,
    ) -> None:
        self.cls = cls
        self._reorder = reorder
        self._of: dict[tuple[Version, bool], Layout] = {}
        # (size, version) -> the layouts that fit, and the decoder where these two alone decide
        self._known: dict[tuple[int, Version | None], tuple[list[Layout], Callable[..., Any] | None]] = {}
        self.blocks = {wire.block for wire in cls.FIELDS.values() if wire.block is not None}
        known: dict[Any, Layout] = {}
        for version in self._borders():
            for has_block in (False, True) if self.blocks else (False,):
                fields = self._fields(version, has_block)
                if not fields and cls.FIELDS:
                    continue
                key = tuple((wire.name, id(shape)) for wire, shape in fields)
                if key not in known:
                    known[key] = Layout(cls, version, fields, header, constants, has_block)
                self._of[version, has_block] = known[key]
        #: every distinct layout, oldest first
        self.all: tuple[Layout, ...] = tuple(known.values())

    def _borders(self) -> list[Version]:
        borders: set[Version] = set()
        for wire in self.cls.FIELDS.values():
            borders |= wire.since.borders
            borders |= {wire.until} if wire.until is not None else set()
            borders |= {wire.before[0]} if wire.before is not None else set()
        if self._reorder is not None:
            borders.add(self._reorder[0])
        return sorted(borders) or [(0, 0)]

    def _fields(self, version: Version, has_block: bool) -> list[tuple[Wire, Any]]:
        order: Sequence[str] = list(self.cls.FIELDS)
        if self._reorder is not None and version < self._reorder[0]:
            order = self._reorder[1]
        sent = ((wire, wire.shape_in(version)) for wire in map(self.cls.FIELDS.__getitem__, order))
        return [(wire, shape) for wire, shape in sent if shape is not None and (has_block or wire.block is None)]

    def of(self, version: str | Version | None = None, fields: Mapping[str, Any] | None = None) -> Layout:
        """The layout that `version` sends, or the newest; with its block if `fields` asks for it.

        Raises:
            PacketError: that version does not send this packet.
        """
        has_block = any((fields or {}).get(block) for block in self.blocks)
        if version is None:
            return next(layout for layout in reversed(self.all) if layout.has_block == has_block)
        version = parse_version(version)
        known = [border for border, block in self._of if block == has_block and border <= version]
        layout = self._of[max(known), has_block] if known else None
        if layout is None or not self._fields(version, has_block):
            text = version_text(version)
            raise PacketError("not sent by this firmware", packet=self.cls.__name__, version=text)
        return layout

    def fitting(self, size: int, version: Version | None = None) -> list[Layout]:
        """The layouts that a packet of `size` bytes can have, best first.

        An exact size wins, then the longest that fits: what is left over is the tail. With a
        version, its own layout is the least that will do, and only layouts that extend it come
        into question, since a newer release appends. Where a release took fields away, its first
        builds may still send them: an exact size of the same generation will do, if it is larger.

        Raises:
            PacketError: the packet is shorter than its version's layout, or than any.
        """
        candidates = list(self.all)
        least = min(layout.size for layout in candidates)
        if version is not None:
            own = [self.of(version)]
            if self.blocks:
                own.append(self.of(version, dict.fromkeys(self.blocks, True)))
            least = own[0].size
            candidates = [
                layout
                for layout in candidates
                if any(layout.fields[: len(mine.fields)] == mine.fields for mine in own)
                or (layout.first[0] == version[0] and layout.size == size > least and not layout.has_text)
            ]
        fits = [layout for layout in candidates if layout.size <= size]
        if not fits:
            raise PacketError(
                "packet too short",
                packet=self.cls.__name__,
                version=None if version is None else version_text(version),
                expected=least,
                actual=size,
                offset=size,
            )
        return sorted(fits, key=lambda layout: (layout.size == size, layout.size), reverse=True)

    def decode(self, data: bytes, version: Version | None = None, stamp: Stamp | None = None) -> Any:
        """The typed state of one whole packet, header included.

        Raises:
            PacketError: no layout holds it.
        """
        key = (len(data), version)
        known = self._known.get(key)
        if known is None:
            known = self.fitting(*key), self.decoder(*key)
            if len(self._known) < 256:  # lengths come from the wire: keep no more than a few
                self._known[key] = known
        fits, decode = known
        if decode is not None:
            return decode(data, stamp)
        failure: PacketError | None = None
        for layout in fits:
            try:
                state = layout.decode(data, stamp)
            except PacketError as error:
                failure = failure or error
                continue
            if all(bool(getattr(state, block)) == layout.has_block for block in self.blocks):
                return state
        if failure is not None:
            raise failure
        return fits[0].decode(data, stamp)

    def decoder(self, size: int, version: Version | None = None) -> Callable[..., Any] | None:
        """The decoder of packets of this size, or None where their content has to choose.

        Raises:
            PacketError: no layout holds such a packet.
        """
        fits = self.fitting(size, version)
        by_text = fits[0].has_text and len(fits) > 1
        by_block = len({layout.has_block for layout in fits}) > 1
        return None if by_text or by_block else fits[0].decode


def _property(cls: type[State], name: str, number: int) -> property:
    """The property of field `number`, the shortest way to its value that is right in all layouts."""
    places = [layout.places.get(name) for layout in cls.LAYOUTS.all]
    first = places[0]
    same_place = first is not None and all(place is not None and place.at == first.at for place in places)
    plain = first is not None and first.element is None and first.count is not None
    wire = cls.FIELDS[name]
    get: Callable[[Any], Any]
    if first is not None and same_place and plain and all(layout.of_cells for layout in cls.LAYOUTS.all):
        at = first.at

        # The same cells in every layout: one view, nothing to look up.
        def get(self: Any) -> Any:
            return self._values[at]
    elif all(place is not None for place in places) and plain and all(layout.of_cells for layout in cls.LAYOUTS.all):
        # In every layout, but not at the same place.
        def get(self: Any) -> Any:
            return self._values[self._layout.cells_at[number]]
    else:

        def get(self: Any) -> Any:
            return self._layout.readers[number](self._values)

    unit = f" [{wire.unit}]" if wire.unit else ""
    return property(get, doc=f"{wire.doc}{unit}")


def packet(
    *,
    header: Any,
    reorder: tuple[str, Sequence[str]] | None = None,
    **constants: int,
) -> Callable[[_Class], _Class]:
    """Make a packet class of a `State` subclass whose body declares fields with `wire()`.

    Args:
        header: construct of what precedes the fields; its `size` is filled in.
        reorder: ``("3.0", names)``: versions before 3.0 send the fields in this other order.
        constants: values of the header's other fields, and defaults of the packet's own.
    """

    def decorate(cls: _Class) -> _Class:
        inherited = {name: wire for base in cls.__mro__[1:] for name, wire in getattr(base, "FIELDS", {}).items()}
        declared = {name: item for name, item in vars(cls).items() if isinstance(item, Wire)}
        body = {name: item for name, item in vars(cls).items() if name not in {*declared, "__dict__", "__weakref__"}}
        # As attrs does: a class with slots has to be made anew.
        remake: Any = type(cls)
        made = remake(cls.__name__, cls.__bases__, {**body, "__slots__": ()})
        fields = {**inherited}
        for name, wire in declared.items():
            fields[name] = Wire(**{**vars(wire), "name": name})
        made.FIELDS = fields
        before = None if reorder is None else (parse_version(reorder[0]), reorder[1])
        made.LAYOUTS = Layouts(made, header, constants, before)
        for number, name in enumerate(fields):
            setattr(made, name, _property(made, name, number))
        return made  # type: ignore[no-any-return]

    return decorate

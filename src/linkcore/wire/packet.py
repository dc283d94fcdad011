"""Typed, frozen packets from a single declaration: `@packet` and `wire()`.

A packet class declares for each field the Python type of the user's value, the shape on the wire, the unit, and the
first version that sends it::

    @packet(header=PACKAGE, type=9)
    class CalibrationData(State):
        F: Vector = wire(Float64b[3], "N", "force")

From this declaration, the decorator derives the properties. At the first use, it makes one layout for each distinct
order of fields, and the function that selects the layout for a packet of a given size and version. A state consists of
its bytes. The properties read from the bytes, so no data is lost, and two states are equal if their bytes are equal.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from .fields import Field, Header, Raw, Shape, Since, parse_version
from .state import State as State
from .state_layouts import StateLayouts, is_array_of_floats

#: Read-only float64 array. The declaration of the field states its length.
Vector = npt.NDArray[np.float64]
#: Read-only integer array.
IntVector = npt.NDArray[np.integer[Any]]

_Class = TypeVar("_Class", bound="type[State]")


def wire(
    shape: Shape,
    unit: str = "",
    doc: str = "",
    *,
    since: str = "0.0",
    until: str | None = None,
    before: tuple[str, Shape] | None = None,
    interleave: str | None = None,
    block: str | None = None,
) -> Any:
    """Declare one field of a packet.

    Args:
        shape: Shape on the wire: `Float64b`, `Float64b[6]`, `Coded(Int8ub, bool)`, `Text()`.
        unit: SI unit, or a description of the number.
        doc: Meaning.
        since: First versions that send it, one for each generation: ``"3.10/5.4"``.
        until: First version that no longer sends it.
        before: ``("3.0", Int16ub)`` if versions before 3.0 send this other shape.
        interleave: Name of a group. Neighbouring fields of a group are sent element by element in turn.
        block: Name of another field. This field is sent only if the other field is true.
    """
    if before is not None:
        # The same property reads both shapes, so they may differ only in the number or in its meaning.
        assert before[1].count is shape.count is None
        assert (before[1].read is None) is (shape.read is None)
    return Field(
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


# -- fields as properties ------------------------------------------------------------------------


def _getter(shape: Shape, number: int, has_text: bool) -> Callable[[Any], Any]:
    """Return the function that reads a field of a state.

    It is a single Python function without further calls, because a robot state has 120 fields.

    Args:
        shape: Shape of the field.
        number: Number of the field in the class.
        has_text: Whether packets of the class contain text, so that all values were read when the packet was decoded.
    """
    get: Callable[[Any], Any]
    if has_text:

        def get(self: Any) -> Any:
            return self._values[number]
    elif is_array_of_floats(shape):

        def get(self: Any) -> Any:
            layout = self._layout
            items = layout.vectors[number]
            if items is None:
                return None
            cells = self._values
            return (layout.swap(self) if cells is None else cells)[items]
    elif shape.count is not None:

        def get(self: Any) -> Any:
            unpack_from, offset, meaning = self._layout.singles[number]
            try:
                numbers = unpack_from(self._data, offset)
            except TypeError:  # a `DeferredPacket`; the check is free for bytes, because they raise nothing
                numbers = self._data.numbers(self._layout.names[number])
            return meaning(numbers)
    else:

        def get(self: Any) -> Any:
            unpack_from, offset, meaning = self._layout.singles[number]
            try:
                (value,) = unpack_from(self._data, offset)
            except TypeError:
                (value,) = self._data.numbers(self._layout.names[number])
            return value if meaning is None else meaning(value)

    return get


def packet(
    *, header: Header, reorder: tuple[str, Sequence[str]] | None = None, **constants: int
) -> Callable[[_Class], _Class]:
    """Make a packet class of a `State` subclass whose body declares fields with `wire()`.

    Args:
        header: Header before the fields. Its `size` is set automatically.
        reorder: ``("3.0", names)`` if versions before 3.0 send the fields in this other order.
        constants: Values of the other parts of the header, and defaults of the fields of the packet.
    """

    def decorate(cls: _Class) -> _Class:
        inherited = {name: field for base in cls.__mro__[1:] for name, field in getattr(base, "FIELDS", {}).items()}
        declared = {name: item._replace(name=name) for name, item in vars(cls).items() if isinstance(item, Field)}
        fields = {**inherited, **declared}
        has_text = any(isinstance(field.shape, Raw) for field in fields.values())
        body = {name: item for name, item in vars(cls).items() if name not in {"__dict__", "__weakref__"}}
        for number, (name, field) in enumerate(fields.items()):
            unit = f" [{field.unit}]" if field.unit else ""
            get = _getter(field.shape, number, has_text)
            body[name] = property(get, doc=f"{field.doc}{unit}")
        # The class is made again, because slots cannot be added to an existing class. attrs does the same.
        remake: Any = type(cls)
        made = remake(cls.__name__, cls.__bases__, {**body, "__slots__": (), "FIELDS": fields})
        before = None if reorder is None else (parse_version(reorder[0]), reorder[1])
        made.LAYOUTS = StateLayouts(made, header, constants, before, has_text=has_text)
        return made  # type: ignore[no-any-return]

    return decorate

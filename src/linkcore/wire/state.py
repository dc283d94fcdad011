"""Class `State`: a decoded packet, which is typed, immutable, and stores the received bytes.

`linkcore.wire.packet` makes the packet classes, which derive from it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from .fields import Field, OpenInt, Version

if TYPE_CHECKING:
    from typing_extensions import Self

    from ..clock import Stamp
    from .schema import Row
    from .state_layouts import StateLayout, StateLayouts


class State:
    """Decoded packet. It has typed values, is immutable, and stores the received bytes.

    ``State(version, name=value, ...)`` makes a state for tests and simulators; fields without a value are zero. Equal
    states have equal bytes.
    """

    # If the packet contains text, `_values` has the values of all fields. Otherwise it has the arrays of floats, or is
    # None until the first array is read and `StateLayout.swap` has made them. In simulated time, both `_data` and
    # `_values` might be a `DeferredPacket`.
    __slots__ = ("_data", "_layout", "_stamp", "_values")

    #: Name -> declaration of the field, in the order of the declarations.
    FIELDS: ClassVar[Mapping[str, Field]] = {}
    #: Layouts of the class, and the functions that select a layout.
    LAYOUTS: ClassVar[StateLayouts]
    #: Whether a packet of this class is an event, which occurs once, and not a sample of a continuous quantity.
    IS_EVENT: ClassVar[bool] = False

    _data: bytes
    _layout: StateLayout
    _stamp: Stamp | None
    _values: Any

    def __init__(self, version: str | Version | None = None, /, **fields: Any) -> None:
        layout = self.LAYOUTS.of(version, fields)
        self._data = data = layout.encode(fields)
        self._layout = layout
        self._stamp = None
        self._values = layout.values(data)

    @classmethod
    def dtype(cls, version: str | Version | None = None) -> np.dtype[Any]:
        """Return the numpy dtype of the packet on the wire for `version`, or for the newest version.

        ``np.frombuffer(data, RealtimeState.dtype("5.10"))["q_actual"]`` reads many at once.
        """
        return cls.LAYOUTS.of(version).dtype

    @property
    def received(self) -> Stamp | None:
        """Time at which the bytes arrived; None for a state that was not received."""
        return self._stamp

    @property
    def tail(self) -> bytes:
        """Bytes after the last known field."""
        data = bytes(self._data)
        return data[self._layout.end(data) :]

    def __bytes__(self) -> bytes:
        """Return the packet as on the wire, header and tail included."""
        return bytes(self._data)

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            return NotImplemented
        return bytes(self._data) == bytes(other._data)

    def __hash__(self) -> int:
        return hash(bytes(self._data))

    def __reduce__(self) -> tuple[object, ...]:
        return (_restored, (type(self), bytes(self._data), self._layout.first, self._layout.has_block, self._stamp))

    def __dir__(self) -> list[str]:
        # Omit each `Elsewhere`, because it represents a name that the class does not have.
        return [name for name in super().__dir__() if hasattr(type(self), name)]

    def __copy__(self) -> Self:
        return self

    def __deepcopy__(self, memo: object) -> Self:
        return self

    def dissect(self) -> Iterator[Row]:
        """Return each section of the packet's bytes with offset, name, value and unit.

        The unknown tail is the last.
        """
        from .schema import dissect  # imported here, because it imports construct, which takes long

        return dissect(self._layout, bytes(self._data))

    def to_dict(self) -> dict[str, Any]:
        """Return name -> plain Python value of each sent field: numbers, lists and text.

        Codes are given by name.
        """
        return {name: plain(getattr(self, name)) for name in self._layout.places}

    def __str__(self) -> str:
        shown = ", ".join(f"{name}={_short(getattr(self, name))}" for name in self._layout.places)
        return f"{type(self).__name__}({shown})"

    __repr__ = __str__

    def _repr_html_(self) -> str:
        from ..text import html_table  # imported here: importing the library stays fast

        fields = ((name, place.field) for name, place in self._layout.places.items())
        rows = [(name, _short(getattr(self, name)), field.unit, field.doc) for name, field in fields]
        return html_table(type(self).__name__, ("field", "value", "unit", "meaning"), rows)


def _restored(cls: type[State], data: bytes, first: Version, has_block: bool, stamp: Stamp | None) -> State:
    (layout,) = (each for each in cls.LAYOUTS.all if (each.first, each.has_block) == (first, has_block))
    return layout.decode(data, stamp)  # type: ignore[no-any-return]


def plain(value: Any) -> Any:
    """Return the value of a field for JSON: codes by name, bytes in hexadecimal."""
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    if isinstance(value, (tuple, list)):
        return [plain(element) for element in value]
    if isinstance(value, OpenInt):
        return value.name
    return value.hex() if isinstance(value, (bytes, bytearray)) else value


def _short(value: Any) -> str:
    """Return a text for one line without control characters, because the value comes from the wire."""
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, OpenInt):
        return str(value.name)
    if isinstance(value, (np.ndarray, tuple)):
        return "[" + ", ".join(_short(element) for element in list(value)) + "]"
    return repr(value) if isinstance(value, (str, bytes)) else str(value)

"""Typed, frozen packets declared once: `@packet` and `wire()`.

A packet class says, field by field, the Python type that users hold beside the shape on the wire, the unit, and the
version since which it is sent::

    @packet(header=PACKAGE, type=9)
    class CalibrationData(State):
        F: Vector = wire(Float64b[3], "N", "force")

From that the decorator derives the properties, and, when they are first needed, one layout per distinct order of fields
and the choice of the layout for a packet of a given size and version. A state *is* its bytes: the properties read from
them, so nothing is lost and equality is equality of bytes.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

import numpy as np
import numpy.typing as npt

from .fields import Field, Header, OpenInt, Raw, Shape, Since, Version, parse_version
from .layout import indices, is_of_cells
from .split import is_split, split_indices
from .state_layouts import StateLayout, StateLayouts

if TYPE_CHECKING:
    from typing_extensions import Self

    from ..clock import Stamp
    from .schema import Row

#: Read-only float64 array; the declaration of the field says its length.
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
        shape: on the wire: `Float64b`, `Float64b[6]`, `Coded(Int8ub, bool)`, `Text()`.
        unit: SI unit, or what the number is.
        doc: meaning.
        since: first versions that send it, one per generation: ``"3.10/5.4"``.
        until: first version that no longer does.
        before: ``("3.0", Int16ub)``: versions before 3.0 send this other shape.
        interleave: neighbours of the same group are sent element by element in turn.
        block: the field is sent only when the field of this name is true.
    """
    if before is not None:
        # One property reads both: what differs is the number, or what it stands for.
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


class State:
    """One decoded packet: typed, frozen, and backed by the bytes that were received.

    ``State(version, name=value, ...)`` builds one, for tests and simulators: fields that are not given are
    zero. Equal states have equal bytes.
    """

    # `_values` are the numbers and texts; of a layout `of_cells` None, since each is read from the bytes by itself.
    # `_vectors` are made when the first vector is asked for: all values as one array, or of a layout that is split the
    # vectors; see `_array_getter`. Of such a layout `_values` are the other numbers.
    __slots__ = ("_data", "_layout", "_lost", "_stamp", "_values", "_vectors")

    #: name -> declaration of the field, in declared order
    FIELDS: ClassVar[Mapping[str, Field]] = {}
    #: the layouts of the class, and the choice among them
    LAYOUTS: ClassVar[StateLayouts]
    #: False for a sample of something that goes on, True for news that comes once
    IS_EVENT: ClassVar[bool] = False

    _data: bytes
    _layout: StateLayout
    _lost: bool
    _stamp: Stamp | None
    _values: Any
    _vectors: Any

    def __init__(self, version: str | Version | None = None, /, **fields: Any) -> None:
        layout = self.LAYOUTS.of(version, fields)
        self._data = layout.encode(fields)
        self._layout = layout
        self._stamp = None
        self._values = None if layout.of_cells else layout.kept(self._data)
        self._vectors = None

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

    def __dir__(self) -> list[str]:
        # Without each `Elsewhere`, which is a name that the class does not have.
        return [name for name in super().__dir__() if hasattr(type(self), name)]

    def __copy__(self) -> Self:
        return self

    def __deepcopy__(self, memo: object) -> Self:
        return self

    def dissect(self) -> Iterator[Row]:
        """Every stretch of the packet's bytes with offset, name, value and unit; the unknown tail last."""
        from .schema import dissect  # which imports construct: a program that dissects nothing does not pay for that

        return dissect(self._layout, self._data)

    def to_dict(self) -> dict[str, Any]:
        """name -> plain Python value of every field sent: numbers, lists, text; codes by name."""
        return {name: plain(getattr(self, name)) for name in self._layout.places}

    def __str__(self) -> str:
        shown = ", ".join(f"{name}={_short(getattr(self, name))}" for name in self._layout.places)
        return f"{type(self).__name__}({shown})"

    __repr__ = __str__

    def _repr_html_(self) -> str:
        from ..text import html_table  # imported here: importing the library stays cheap

        fields = ((name, place.field) for name, place in self._layout.places.items())
        rows = [(name, _short(getattr(self, name)), field.unit, field.doc) for name, field in fields]
        return html_table(type(self).__name__, ("field", "value", "unit", "meaning"), rows)


def _restored(cls: type[State], data: bytes, first: Version, has_block: bool, stamp: Stamp | None) -> State:
    (layout,) = (each for each in cls.LAYOUTS.all if (each.first, each.has_block) == (first, has_block))
    return layout.decode(data, stamp)  # type: ignore[no-any-return]


def plain(value: Any) -> Any:
    """A field's value for JSON: codes by name, bytes in hex."""
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    if isinstance(value, (tuple, list)):
        return [plain(element) for element in value]
    if isinstance(value, OpenInt):
        return value.name
    return value.hex() if isinstance(value, (bytes, bytearray)) else value


def _short(value: Any) -> str:
    """Text for one line, without control characters, whatever came over the wire."""
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, OpenInt):
        return str(value.name)
    if isinstance(value, (np.ndarray, tuple)):
        return "[" + ", ".join(_short(element) for element in list(value)) + "]"
    return repr(value) if isinstance(value, (str, bytes)) else str(value)


# -- fields as properties ------------------------------------------------------------------------


def _getter(
    field: Field, number: int, at: int | slice | None, *, of_cells: bool, has_text: bool
) -> Callable[[Any], Any]:
    """What reads a field of a state. One Python function does it all, since a robot state has 120 fields to be read.

    Args:
        field: its declaration.
        number: its number among the fields of the class.
        at: where its values are in every layout; None where that differs, or where it is not always sent. A field that
            the layout of the state does not send has no place there, and is None.
        of_cells: nothing is unpacked before it is asked for.
        has_text: some of the values are bytes.
    """
    if field.shape.count is not None:
        return _array_getter(field.shape, number, at, of_cells=of_cells, has_text=has_text)
    get: Callable[[Any], Any]
    read = field.shape.read
    if of_cells:
        assert field.shape.number is not None, "there is no text in cells"
        unpack_from = struct.Struct(f">{field.shape.number.code}").unpack_from

        def get(self: Any) -> Any:
            layout = self._layout
            offset = layout.offsets[number]
            if offset is None:
                return None
            (value,) = unpack_from(self._data, offset)
            read = layout.reads[number]  # the number may stand for something else in another layout
            return value if read is None else read(value)
    elif field.before is not None:

        def get(self: Any) -> Any:
            layout = self._layout
            at = layout.at[number]
            if at is None:
                return None
            value = self._values[at]
            read = layout.reads[number]  # the number may stand for something else in another layout
            return value if read is None else read(value)
    elif at is None:

        def get(self: Any) -> Any:
            at = self._layout.at[number]
            if at is None:
                return None
            return self._values[at] if read is None else read(self._values[at])
    elif read is None:

        def get(self: Any) -> Any:
            return self._values[at]
    else:

        def get(self: Any) -> Any:
            return read(self._values[at])

    return get


def _array_getter(
    shape: Shape, number: int, at: int | slice | None, *, of_cells: bool, has_text: bool
) -> Callable[[Any], Any]:
    """As `_getter`, of an array."""
    assert shape.number is not None, "there are no arrays of text"
    read = shape.read
    is_float = shape.number.kind[0] == "f"
    get: Callable[[Any], Any]
    if read is not None:

        def get(self: Any) -> Any:
            layout = self._layout
            at = layout.at[number]
            if at is None:
                return None
            return tuple(map(read, layout.vectors(self)[at].tolist() if of_cells else self._values[at]))
    elif is_float and not has_text and at is not None:

        def get(self: Any) -> Any:
            vectors = self._vectors
            return (self._layout.vectors(self) if vectors is None else vectors)[at]
    elif is_float and not has_text:

        def get(self: Any) -> Any:
            layout = self._layout
            at = layout.at[number]
            if at is None:
                return None
            vectors = self._vectors
            return (layout.vectors(self) if vectors is None else vectors)[at]
    else:
        # Floats of four bytes too are handed out as float64; that is exact.
        dtype = np.dtype("f8" if is_float else shape.number.kind)
        pack = struct.Struct(f"={shape.count}{'d' if is_float else shape.number.code}").pack

        def get(self: Any) -> Any:
            at = self._layout.at[number]
            return None if at is None else np.frombuffer(pack(*self._values[at]), dtype)

    return get


def _fixed_places(fields: Mapping[str, Field], order: Sequence[str] | None) -> dict[str, int | slice]:
    """Where the values of a field are, as far as that is the same in every layout, which all have it.

    Args:
        fields: of the packet, in declared order.
        order: the other order in which the oldest versions send them, if there is one.
    """
    fixed: list[tuple[Field, Shape]] = []
    first = min((field.since.firsts for field in fields.values()), default=())
    for number, (name, field) in enumerate(fields.items()):
        # With entries for several generations, a version may send other fields without these.
        is_first = len(first) == 1 and field.since.firsts == first
        is_always_sent = is_first and field.until is None and field.block is None
        if not is_always_sent or (order is not None and order[number] != name):
            # From here on, what stands before a field differs. A group is interleaved with all its members.
            while fixed and field.interleave is not None and fixed[-1][0].interleave == field.interleave:
                fixed.pop()
            break
        fixed.append((field, field.shape))
    return indices(fixed)


def packet(
    *, header: Header, reorder: tuple[str, Sequence[str]] | None = None, **constants: int
) -> Callable[[_Class], _Class]:
    """Make a packet class of a `State` subclass whose body declares fields with `wire()`.

    Args:
        header: what precedes the fields; its `size` is filled in.
        reorder: ``("3.0", names)``: versions before 3.0 send the fields in this other order.
        constants: values of the header's other parts, and defaults of the packet's own fields.
    """

    def decorate(cls: _Class) -> _Class:
        inherited = {name: field for base in cls.__mro__[1:] for name, field in getattr(base, "FIELDS", {}).items()}
        declared = {name: item._replace(name=name) for name, item in vars(cls).items() if isinstance(item, Field)}
        fields = {**inherited, **declared}
        shapes = [field.shape for field in fields.values()]
        of_cells = is_of_cells(shapes + [field.before[1] for field in fields.values() if field.before is not None])
        has_text = any(isinstance(shape, Raw) for shape in shapes)
        split = not of_cells and reorder is None and is_split(fields.values())
        if split:
            fixed = split_indices([(name, field.shape) for name, field in fields.items()])
        else:
            fixed = _fixed_places(fields, None if reorder is None else reorder[1])
        body = {name: item for name, item in vars(cls).items() if name not in {"__dict__", "__weakref__"}}
        for number, (name, field) in enumerate(fields.items()):
            unit = f" [{field.unit}]" if field.unit else ""
            get = _getter(field, number, fixed.get(name), of_cells=of_cells, has_text=has_text)
            body[name] = property(get, doc=f"{field.doc}{unit}")
        # As attrs does: a class with slots has to be made anew.
        remake: Any = type(cls)
        made = remake(cls.__name__, cls.__bases__, {**body, "__slots__": (), "FIELDS": fields})
        before = None if reorder is None else (parse_version(reorder[0]), reorder[1])
        made.LAYOUTS = StateLayouts(made, header, constants, before, of_cells=of_cells, is_split=split)
        return made  # type: ignore[no-any-return]

    return decorate

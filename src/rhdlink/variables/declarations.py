"""Variables as typed properties: declared in a class, bound by name to a database.

The declarations say nothing of who is reading them: on the robot's side `Read` variables are set and `Write` variables
read, on a program's side it is the reverse.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, ClassVar, Generic, Literal, NoReturn, TypeVar, overload

from numpy.typing import ArrayLike

from linkcore.errors import BadValue, LocalError

from ..errors import NotThere, WrongVariables
from ..wire.schema import WORD
from .database import Database, VariableTable
from .value_types import Order, Packer, ValueType

V = TypeVar("V")
S = TypeVar("S")
V2 = TypeVar("V2")
A2 = TypeVar("A2")
S2 = TypeVar("S2")
D = TypeVar("D", bound="Declaration[Any, Any]")

_WHOSE = {"r": "read", "w": "write"}


class Declaration(Generic[V, S]):
    """A variable as a property; see `Read` and `Write`.

    Attributes:
        direction: "r" from robot to program, "w" from program to robot.
        type: of its values.
        count: values in it.
        unit: of its values; "" for none.
        doc: what it is, in words.
        name: in the robot's database; that of the attribute, unless it was given.
        attribute: name of the attribute.
        order: in which a value of several words, or of bytes, stands; None leaves it to the class.
        is_optional: a robot may lack it.
    """

    direction: ClassVar[str]

    def __init__(
        self,
        type: ValueType[Any, Any, Any],
        n: int = 1,
        *,
        unit: str | None = None,
        doc: str = "",
        name: str | None = None,
        order: Order | None = None,
        optional: bool = False,
    ) -> None:
        if not isinstance(type, ValueType):
            raise BadValue(f"{type!r} is no type of variable; expected Int32, Float64, Scaled(...) or another")
        if not isinstance(n, int) or n < 1:
            raise BadValue(f"n is {n!r}; expected the number of values, at least 1")
        if order not in (None, "little", "big"):
            raise BadValue(f"order is {order!r}; expected 'little' or 'big'")
        self.type = type
        self.count = n
        self.unit = type.unit if unit is None else unit
        self.doc = self.__doc__ = doc
        self.name = name or ""
        self.attribute = ""
        self.order = order
        self.is_optional = optional

    @property
    def length(self) -> int:
        """32-bit words."""
        return self.type.length(self.count)

    def __set_name__(self, owner: type, name: str) -> None:
        self.attribute = name
        self.name = self.name or name

    def __repr__(self) -> str:
        many = f", {self.count}" if self.count > 1 else ""
        return f"<{self.__class__.__name__}({self.type!r}{many}) {self.name}>"

    @overload
    def __get__(self: D, instance: None, owner: type) -> D: ...

    @overload
    def __get__(self, instance: Declarations, owner: type) -> V: ...

    def __get__(self, instance: Declarations | None, owner: type | None = None) -> Any:
        if instance is None:
            return self
        # The common case first and without a branch: control loops read variables at each tick.
        try:
            read = instance._bound_readers[self.attribute]
        except KeyError:
            self._missing(instance)
        return read()

    def __set__(self, instance: Declarations, value: S) -> None:
        try:
            pack = instance._bound_packers[self.attribute]
        except KeyError:
            self._missing(instance)
        instance._check_set(self)
        try:
            words = pack(value)
        except BadValue as error:
            raise BadValue(f"{self.name}: {error}") from None
        with instance._bound_lock:
            # Found under the lock: another thread may just have bound the instance to the tables of a new connection.
            table, identity = instance._place(self)
            table.set(identity, words)

    def _missing(self, instance: Declarations) -> NoReturn:
        instance._place(self)  # says what is wrong
        raise AssertionError(f"{self.name} has a place and nothing that reads and packs it")

    def unpack(self, words: Any, order: Order) -> V:
        """The value in the words of the variable."""
        many = self.count > 1
        value: V = self.type.unpack_many(words, self.count, order) if many else self.type.unpack(words, order)
        return value


class Read(Declaration[V, S]):
    """A variable from the robot to programs.

    Args:
        type: of its values, such as `Int32` or `Scaled`.
        n: values in it; with more than one the property is an array.
        unit: of its values; by default the type's.
        doc: what it is.
        name: in the robot's database; by default that of the attribute.
        order: in which the robot's machine holds values of several words; by default the class's.
        optional: a robot may lack it; using it then raises `NotThere`.

    Raises:
        BadValue: an argument that cannot be.
    """

    direction = "r"

    @overload
    def __init__(
        self: Read[V2, S2],
        type: ValueType[V2, A2, S2],
        n: Literal[1] = 1,
        *,
        unit: str | None = None,
        doc: str = "",
        name: str | None = None,
        order: Order | None = None,
        optional: bool = False,
    ) -> None: ...

    @overload
    def __init__(
        self: Read[A2, ArrayLike],
        type: ValueType[V2, A2, S2],
        n: int,
        *,
        unit: str | None = None,
        doc: str = "",
        name: str | None = None,
        order: Order | None = None,
        optional: bool = False,
    ) -> None: ...

    def __init__(self, type: ValueType[Any, Any, Any], n: int = 1, **options: Any) -> None:
        super().__init__(type, n, **options)


class Write(Declaration[V, S]):
    """A variable from programs to the robot; for its arguments see `Read`."""

    direction = "w"

    @overload
    def __init__(
        self: Write[V2, S2],
        type: ValueType[V2, A2, S2],
        n: Literal[1] = 1,
        *,
        unit: str | None = None,
        doc: str = "",
        name: str | None = None,
        order: Order | None = None,
        optional: bool = False,
    ) -> None: ...

    @overload
    def __init__(
        self: Write[A2, ArrayLike],
        type: ValueType[V2, A2, S2],
        n: int,
        *,
        unit: str | None = None,
        doc: str = "",
        name: str | None = None,
        order: Order | None = None,
        optional: bool = False,
    ) -> None: ...

    def __init__(self, type: ValueType[Any, Any, Any], n: int = 1, **options: Any) -> None:
        super().__init__(type, n, **options)


class Declarations:
    """Has variables declared in its class, and a database that they are bound to.

    Class arguments:
        order: in which the robot's machine holds values of several words, "little" or "big", for
            declarations that do not say.
    """

    _word_order: ClassVar[Order] = "little"
    _declarations: ClassVar[Mapping[str, Declaration[Any, Any]]] = MappingProxyType({})

    _bound_places: Mapping[str, tuple[VariableTable, int]] | None = None
    _bound_readers: Mapping[str, Callable[[], Any]] = MappingProxyType({})
    _bound_packers: Mapping[str, Packer] = MappingProxyType({})
    _bound_lock: threading.RLock

    def __init_subclass__(cls, *, order: Order | None = None, **options: Any) -> None:
        super().__init_subclass__(**options)
        if order is not None:
            if order not in ("little", "big"):
                raise BadValue(f"order is {order!r}; expected 'little' or 'big'")
            cls._word_order = order
        declared: dict[str, Declaration[Any, Any]] = {}
        # From the oldest base on, so that a class replaces what its bases declare, and removes it with `name = None`.
        for base in reversed(cls.__mro__):
            for attribute, value in vars(base).items():
                declared.pop(attribute, None)
                if isinstance(value, Declaration):
                    declared[attribute] = value
        cls._declarations = MappingProxyType(declared)

    @classmethod
    def declared(cls) -> Mapping[str, Declaration[Any, Any]]:
        """The declarations by attribute, inherited ones first."""
        return cls._declarations

    def _place(self, declaration: Declaration[Any, Any]) -> tuple[VariableTable, int]:
        """Where a variable is.

        Raises:
            LocalError: the instance has not been bound.
            NotThere: the database lacks it.
        """
        places = self._bound_places
        if places is None:
            raise LocalError(f"{declaration.name} belongs to no robot yet; its class is what connect() takes")
        place = places.get(declaration.attribute)
        if place is None:
            raise NotThere(f"this robot has no {_WHOSE[declaration.direction]} variable {declaration.name!r}")
        return place

    def _check_set(self, declaration: Declaration[Any, Any]) -> None:
        """Raise if this side may not set the variable. The robot's own side may set all."""


def refuse_hiding(declared: type[Declarations], base: type[Declarations]) -> None:
    """Raise `BadValue` if a class declares a variable by a name that every instance of `base` uses otherwise."""
    for attribute, declaration in declared.declared().items():
        if hasattr(base, attribute) or attribute in base.__annotations__:
            raise BadValue(
                f"{declared.__name__}.{attribute} would hide what every {base.__name__} object has; "
                f"call it otherwise, with name={declaration.name!r}"
            )


def create_variables(declared: type[Declarations], database: Database) -> None:
    """Make the variables that a class declares in a database; those that are there already are left as they are.

    Raises:
        BadValue: a name or a length that cannot be.
        LocalError: the database is frozen and lacks one.
    """
    for declaration in declared.declared().values():
        table = database.table(declaration.direction)
        # Plugins share variables by declaring the same one; whether it is the same, `bind` finds out.
        if declaration.name not in table:
            table.add(declaration.name, declaration.length)


def bind(instance: Declarations, database: Database, lock: threading.RLock | None = None) -> None:
    """Find the variables that an instance declares in a database, by name.

    Args:
        instance: gets and sets them there from now on.
        database: which.
        lock: held around every access to it, where threads share it.

    Raises:
        WrongVariables: says all that the database lacks, or has in another length or direction.
    """
    places: dict[str, tuple[VariableTable, int]] = {}
    readers: dict[str, Callable[[], Any]] = {}
    packers: dict[str, Packer] = {}
    # All of them are collected: who connects to a robot of another kind sees at once how it differs.
    differences = []
    # Re-entrant: a signal handler may read a variable while the main thread is reading one.
    lock = lock or threading.RLock()
    for attribute, declaration in instance.declared().items():
        table = database.table(declaration.direction)
        identity = table.find(declaration.name)
        if identity is not None and table.rows[identity].length == declaration.length:
            places[attribute] = table, identity
            readers[attribute] = _reader(declaration, instance._word_order, table, identity, lock)
            packers[attribute] = declaration.type.packer(declaration.count, declaration.order or instance._word_order)
        elif (difference := _difference(declaration, database)) is not None:
            differences.append(difference)
    if differences:
        raise WrongVariables(differences)
    # Last, so that an instance which cannot be bound keeps working on the tables that it had.
    instance._bound_lock, instance._bound_places = lock, places
    instance._bound_readers, instance._bound_packers = readers, packers


def _reader(
    declaration: Declaration[Any, Any], order: Order, table: VariableTable, identity: int, lock: threading.RLock
) -> Callable[[], Any]:
    """What a property read calls. All that can be found out beforehand is, so that a read takes half a microsecond."""
    read = declaration.type.reader(declaration.count, declaration.order or order)
    offset = WORD * table.start(identity)

    def read_now() -> Any:
        # Without the lock, half of a value of two words could be that of the batch which is just coming in. The table's
        # memory is looked up each time, since it is another one after a plugin has added a variable.
        with lock:
            return read(table.memory, offset)[0]

    return read_now


def _difference(declaration: Declaration[Any, Any], database: Database) -> str | None:
    """How the database differs from what was declared; None if an optional variable is missing."""
    name, whose = declaration.name, _WHOSE[declaration.direction]
    identity = database.table(declaration.direction).find(name)
    if identity is not None:
        length = database.table(declaration.direction).rows[identity].length
        return f"{name} has {length} words, declared as {declaration.length} ({declaration!r})"
    other = "w" if declaration.direction == "r" else "r"
    if name in database.table(other):
        return f"{name} is a {_WHOSE[other]} variable, declared as {whose}"
    return None if declaration.is_optional else f"there is no {whose} variable {name}"

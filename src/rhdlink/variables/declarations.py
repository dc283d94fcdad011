"""Variables as typed properties. They are declared in a class, and bound by name to a database.

A declaration does not depend on the side that uses it. The robot's side sets `Read` variables and reads `Write`
variables. A client program does the reverse.
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
    """Declared variable as a property; see `Read` and `Write`.

    Attributes:
        direction: "r" for values from robot to program, "w" for values from program to robot.
        type: Type of the values.
        count: Number of values.
        unit: Unit of the values; "" for none.
        doc: Description of the variable.
        name: Name in the robot's database. The default is the name of the attribute.
        attribute: Name of the attribute.
        order: Byte and word order of a value of several words or of bytes; None for the order of the class.
        is_optional: Whether a robot may lack the variable.
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
            raise BadValue(f"{type!r} is not a variable type; expected Int32, Float64, Scaled(...) or another type")
        if not isinstance(n, int) or n < 1:
            raise BadValue(f"n is {n!r}; expected the number of values, 1 or more")
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
        """Length of the variable in 32-bit words."""
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
        # The common case comes first and without a branch, because control loops read variables at each tick.
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
            # Look it up under the lock: another thread might just have bound the instance to a new connection's tables.
            table, identity = instance._place(self)
            table.set(identity, words)

    def _missing(self, instance: Declarations) -> NoReturn:
        instance._place(self)  # raises the error that fits
        raise AssertionError(f"{self.name} has a place in the database, but no reader or packer")

    def unpack(self, words: Any, order: Order) -> V:
        """Convert the words of the variable to its value."""
        many = self.count > 1
        value: V = self.type.unpack_many(words, self.count, order) if many else self.type.unpack(words, order)
        return value


class Read(Declaration[V, S]):
    """Variable that the robot sets and programs read.

    Args:
        type: Type of the values, such as `Int32` or `Scaled`.
        n: Number of values. With more than one, the property is an array.
        unit: Unit of the values. The default is the unit of the type.
        doc: Description of the variable.
        name: Name in the robot's database. The default is the name of the attribute.
        order: Order in which the robot's machine stores values of several words. The default is the order of the class.
        optional: Whether a robot may lack the variable. If a robot lacks it, the use of the variable raises `NotThere`.

    Raises:
        BadValue: If an argument is not valid.
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
    """Variable that programs set and the robot reads. For the arguments, see `Read`."""

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
    """Base class of classes that declare variables, which are bound to a database.

    Class arguments:
        order: Order in which the robot's machine stores values of several words, "little" or "big". It applies to
            declarations without an `order`.
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
        # Begin with the oldest base, so that a class can replace declarations of its bases, or remove one with
        # `name = None`.
        for base in reversed(cls.__mro__):
            for attribute, value in vars(base).items():
                declared.pop(attribute, None)
                if isinstance(value, Declaration):
                    declared[attribute] = value
        cls._declarations = MappingProxyType(declared)

    @classmethod
    def declared(cls) -> Mapping[str, Declaration[Any, Any]]:
        """Declarations by attribute name, inherited ones first."""
        return cls._declarations

    def _place(self, declaration: Declaration[Any, Any]) -> tuple[VariableTable, int]:
        """Find the table and id of a variable.

        Raises:
            LocalError: If the instance is not bound.
            NotThere: If the database lacks the variable.
        """
        places = self._bound_places
        if places is None:
            raise LocalError(f"{declaration.name} is not connected; use the object that rhdlink.connect() returns")
        place = places.get(declaration.attribute)
        if place is None:
            raise NotThere(f"this robot has no {_WHOSE[declaration.direction]} variable {declaration.name!r}")
        return place

    def _check_set(self, declaration: Declaration[Any, Any]) -> None:
        """Raise an error if this side may not set the variable.

        The robot's own side may set all variables.
        """


def refuse_hiding(declared: type[Declarations], base: type[Declarations]) -> None:
    """Raise `BadValue` if a class declares a variable with the name of an attribute of `base`."""
    for attribute, declaration in declared.declared().items():
        if hasattr(base, attribute) or attribute in base.__annotations__:
            raise BadValue(
                f"{declared.__name__}.{attribute} would hide an attribute that every {base.__name__} object has; "
                f"choose another attribute name, with name={declaration.name!r}"
            )


def create_variables(declared: type[Declarations], database: Database) -> None:
    """Create in a database the variables that a class declares.

    Existing variables are not changed.

    Raises:
        BadValue: If a name or a length is not valid.
        LocalError: If the database is frozen and lacks a variable.
    """
    for declaration in declared.declared().values():
        table = database.table(declaration.direction)
        # Plugins share a variable by declaring the same one. `bind` checks whether the declarations agree.
        if declaration.name not in table:
            table.add(declaration.name, declaration.length)


def bind(instance: Declarations, database: Database, lock: threading.RLock | None = None) -> None:
    """Find in a database, by name, the variables that an instance declares.

    Args:
        instance: Object that reads and sets its variables in the database from now on.
        database: Database in which to find the variables.
        lock: Lock that is held around every access to the database. The default is a new lock.

    Raises:
        WrongVariables: If the database lacks variables, or has them with another length or direction. The error lists
            all of them.
    """
    places: dict[str, tuple[VariableTable, int]] = {}
    readers: dict[str, Callable[[], Any]] = {}
    packers: dict[str, Packer] = {}
    # Collect all differences, so that one error shows how a robot of another kind differs.
    differences = []
    # Re-entrant: a signal handler might read a variable while the main thread is reading one.
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
    # Assign these last, so that an instance that cannot be bound keeps working on its previous tables.
    instance._bound_lock, instance._bound_places = lock, places
    instance._bound_readers, instance._bound_packers = readers, packers


def _reader(
    declaration: Declaration[Any, Any], order: Order, table: VariableTable, identity: int, lock: threading.RLock
) -> Callable[[], Any]:
    """Return the function that a property read calls.

    As much as possible is prepared, so that a read takes only half a microsecond.
    """
    read = declaration.type.reader(declaration.count, declaration.order or order)
    offset = WORD * table.start(identity)

    def read_now() -> Any:
        # Without the lock, one of two words of a value might be from the batch that is just arriving. Look up the
        # table's memory at each read, because it is replaced when a plugin adds a variable.
        with lock:
            return read(table.memory, offset)[0]

    return read_now


def _difference(declaration: Declaration[Any, Any], database: Database) -> str | None:
    """Describe how the database differs from the declaration.

    Return None if there is no difference, or if only an optional variable is missing.
    """
    name, whose = declaration.name, _WHOSE[declaration.direction]
    identity = database.table(declaration.direction).find(name)
    if identity is not None:
        length = database.table(declaration.direction).rows[identity].length
        return f"{name} has {length} words, declared as {declaration.length} ({declaration!r})"
    other = "w" if declaration.direction == "r" else "r"
    if name in database.table(other):
        return f"{name} is a {_WHOSE[other]} variable, declared as {whose}"
    return None if declaration.is_optional else f"there is no {whose} variable {name}"

"""Variables as typed properties: declared in a class, bound by name to a database.

The declarations say nothing of who is reading them: on the robot's side `Read` variables are set and
`Write` variables read, on a program's side it is the other way round.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, ClassVar, Generic, Literal, TypeVar, overload

from numpy.typing import ArrayLike

from linkcore.errors import BadValue, LocalError

from .database import Database, Table
from .errors import NotThere, WrongVariables
from .kinds import Kind, Order

__all__ = ["Declaration", "Declarations", "Read", "Write"]

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
        kind: what its words mean.
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
        kind: Kind[Any, Any, Any],
        n: int = 1,
        *,
        unit: str | None = None,
        doc: str = "",
        name: str | None = None,
        order: Order | None = None,
        optional: bool = False,
    ) -> None:
        if not isinstance(kind, Kind):
            raise BadValue(f"{kind!r} is no kind of variable; expected Int32, Float64, Scaled(...) or another")
        if n < 1:
            raise BadValue(f"n is {n}; expected at least 1 value")
        if order not in (None, "little", "big"):
            raise BadValue(f"order is {order!r}; expected 'little' or 'big'")
        self.kind = kind
        self.count = n
        self.unit = kind.unit if unit is None else unit
        self.doc = self.__doc__ = doc
        self.name = name or ""
        self.attribute = ""
        self.order = order
        self.is_optional = optional

    @property
    def length(self) -> int:
        """32-bit words."""
        return self.kind.length(self.count)

    def __set_name__(self, owner: type, name: str) -> None:
        self.attribute = name
        self.name = self.name or name

    def __repr__(self) -> str:
        many = f", {self.count}" if self.count > 1 else ""
        return f"<{type(self).__name__}({self.kind!r}{many}) {self.name}>"

    @overload
    def __get__(self: D, instance: None, owner: type) -> D: ...

    @overload
    def __get__(self, instance: Declarations, owner: type) -> V: ...

    def __get__(self, instance: Declarations | None, owner: type) -> Any:
        if instance is None:
            return self
        table, identity = instance._place(self)
        with instance._guard:
            words = table.value(identity).copy()
        return self.unpack(words, self.order or instance._order)

    def __set__(self, instance: Declarations, value: S) -> None:
        table, identity = instance._place(self)
        instance._check_set(self)
        order = self.order or instance._order
        try:
            words = (
                self.kind.pack(value, order) if self.count == 1 else self.kind.pack_many(value, self.count, order)  # type: ignore[arg-type]
            )
        except BadValue as error:
            raise BadValue(f"{self.name}: {error}") from None
        with instance._guard:
            table.set(identity, words)

    def unpack(self, words: Any, order: Order) -> V:
        """The value in the words of the variable."""
        many = self.count > 1
        value: V = self.kind.unpack_many(words, self.count, order) if many else self.kind.unpack(words, order)
        return value


class Read(Declaration[V, S]):
    """A variable from the robot to programs.

    Args:
        kind: what its words mean.
        n: values in it; with more than one the property is an array.
        unit: of its values; by default the kind's.
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
        kind: Kind[V2, A2, S2],
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
        kind: Kind[V2, A2, S2],
        n: int,
        *,
        unit: str | None = None,
        doc: str = "",
        name: str | None = None,
        order: Order | None = None,
        optional: bool = False,
    ) -> None: ...

    def __init__(self, kind: Kind[Any, Any, Any], n: int = 1, **options: Any) -> None:
        super().__init__(kind, n, **options)


class Write(Declaration[V, S]):
    """A variable from programs to the robot; for its arguments see `Read`."""

    direction = "w"

    @overload
    def __init__(
        self: Write[V2, S2],
        kind: Kind[V2, A2, S2],
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
        kind: Kind[V2, A2, S2],
        n: int,
        *,
        unit: str | None = None,
        doc: str = "",
        name: str | None = None,
        order: Order | None = None,
        optional: bool = False,
    ) -> None: ...

    def __init__(self, kind: Kind[Any, Any, Any], n: int = 1, **options: Any) -> None:
        super().__init__(kind, n, **options)


class Declarations:
    """Has variables declared in its class, and a database that they are bound to.

    Class arguments:
        order: in which the robot's machine holds values of several words, "little" or "big", for
            declarations that do not say.
    """

    _order: ClassVar[Order] = "little"
    _declared: ClassVar[Mapping[str, Declaration[Any, Any]]] = MappingProxyType({})

    _places: Mapping[str, tuple[Table, int]] | None = None
    _guard: contextlib.AbstractContextManager[Any] = contextlib.nullcontext()

    def __init_subclass__(cls, *, order: Order | None = None, **options: Any) -> None:
        super().__init_subclass__(**options)
        if order is not None:
            if order not in ("little", "big"):
                raise BadValue(f"order is {order!r}; expected 'little' or 'big'")
            cls._order = order
        declared: dict[str, Declaration[Any, Any]] = {}
        for base in reversed(cls.__mro__):
            for attribute, value in vars(base).items():
                declared.pop(attribute, None)
                if isinstance(value, Declaration):
                    declared[attribute] = value
        cls._declared = MappingProxyType(declared)

    @classmethod
    def declared(cls) -> Mapping[str, Declaration[Any, Any]]:
        """The declarations by attribute, inherited ones first."""
        return cls._declared

    @classmethod
    def create(cls, database: Database) -> None:
        """Make the declared variables in a database; those that are there already are left as they are.

        Raises:
            BadValue: a name or a length that cannot be.
            LocalError: the database is frozen and lacks one.
        """
        for declaration in cls._declared.values():
            table = database.table(declaration.direction)
            if declaration.name not in table:
                table.add(declaration.name, declaration.length)

    def bind(self, database: Database, guard: contextlib.AbstractContextManager[Any] | None = None) -> None:
        """Find the declared variables in a database, by name.

        Args:
            database: which.
            guard: held around every access to it, where threads share it.

        Raises:
            WrongVariables: says all that it lacks, or has in another length or direction.
        """
        places: dict[str, tuple[Table, int]] = {}
        differences = []
        for attribute, declaration in self._declared.items():
            table = database.table(declaration.direction)
            identity = table.find(declaration.name)
            if identity is not None and table.rows[identity].length == declaration.length:
                places[attribute] = table, identity
            elif (difference := _difference(declaration, database)) is not None:
                differences.append(difference)
        if differences:
            raise WrongVariables(differences)
        if guard is not None:
            self._guard = guard
        self._places = places

    def _place(self, declaration: Declaration[Any, Any]) -> tuple[Table, int]:
        places = self._places
        if places is None:
            raise LocalError(f"{declaration.name} belongs to no robot yet; its class is what connect() takes")
        place = places.get(declaration.attribute)
        if place is None:
            raise NotThere(f"this robot has no {_WHOSE[declaration.direction]} variable {declaration.name!r}")
        return place

    def _check_set(self, declaration: Declaration[Any, Any]) -> None:
        """Raise if this side may not set the variable. The robot's own side may set all."""


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

"""Recipes: names and types that are known only at run time, lowered to a layout of data packages.

A recipe is made of what a client asked for and a controller answered. Both sides use it: `Recipe.encode` and
`Recipe.decode` for values by name, `Recipe.state_class` for typed states as fast as those of the other interfaces.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Any, ClassVar

from linkcore.errors import BadValue, PacketError
from linkcore.names import StrictAttributes
from linkcore.wire.fields import Field, Header, Int8ub
from linkcore.wire.layout import Layout
from linkcore.wire.packet import State, packet, wire

from ...foreign_names import hint_other_interfaces
from .packets import HEADER
from .variables import OUTPUTS, TYPES, Variable, shape_of

if TYPE_CHECKING:
    from linkcore.clock import Stamp

#: Input recipes of one client; number 0 says that a request was refused.
MOST_RECIPES = 255

DATA_TYPE = ord("U")

#: What a data package begins with, but for those of a controller under protocol 1, which have no number of a recipe.
DATA_HEADER = Header(**HEADER.parts, recipe=Int8ub)


class Outputs(State):
    """The values of one data package, by the names of the variables.

    The classes of what comes are made at run time, one for each recipe; what all of them have in common is this one.
    """

    __slots__ = ()

    #: of the data package; None of a class that is not of one recipe
    RECIPE: ClassVar[Recipe | None] = None
    #: variables that were asked for and that the controller does not have; they read as None
    LEFT_OUT: ClassVar[tuple[str, ...]] = ()

    def __reduce__(self) -> tuple[object, ...]:
        # The class was made at run time, so it is made again.
        recipe, base = self.RECIPE, type(self).__mro__[1]
        assert recipe is not None, "there are no packets of a class without a recipe"
        made = (recipe.names, recipe.types, recipe.number)
        return (_restored, (made, base, self.LEFT_OUT, self._data, self._stamp))


hint_other_interfaces(Outputs, "rtde")


def _restored(
    recipe: tuple[Any, ...], base: type[Outputs], left_out: tuple[str, ...], data: bytes, stamp: Stamp | None
) -> Any:
    return Recipe(*recipe).state_class(base, left_out).LAYOUTS.decode(data, None, stamp)


class Recipe(StrictAttributes):
    """Names and types of one recipe, in wire order.

    Args:
        names: of the variables; one may come twice.
        types: of each, as the controller answers them.
        number: that data packages begin with; None for those of a controller under protocol 1, which have none.
        table: what is known of the variables, `OUTPUTS` or `INPUTS`.

    Raises:
        BadValue: not as many types as names, an unknown type (`NOT_FOUND` and `IN_USE` among them), or a number
            that is not 1 to 255.

    Attributes:
        size: bytes of a data package, header included.
        fields: of the data packages, by name. Where a name comes again its field is called `name#2`.
        header: of the data packages.
        constants: values of the header's parts, its size aside.
        layout: of the data packages.
    """

    def __init__(
        self,
        names: Sequence[str],
        types: Sequence[str],
        number: int | None = 1,
        table: Mapping[str, Variable] = OUTPUTS,
    ) -> None:
        if len(names) != len(types):
            raise BadValue(f"{len(types)} types for {len(names)} names: {', '.join(types)} for {', '.join(names)}")
        if number is not None and not 1 <= number <= MOST_RECIPES:
            raise BadValue(f"recipe number {number}; expected 1 to {MOST_RECIPES}")
        self.names, self.types, self.number = tuple(names), tuple(types), number
        fields: dict[str, Field] = {}
        for name, type in zip(names, types, strict=True):
            if type not in TYPES:
                raise BadValue(f"{name} is of the type {type}; expected one of {', '.join(TYPES)}")
            variable = table.get(name)
            key = name if name not in fields else f"{name}#{names[: len(fields) + 1].count(name)}"
            unit, doc = ("", "") if variable is None else (variable.unit, variable.doc)
            fields[key] = Field(key, shape_of(variable, type), unit, doc)
        self.fields: Mapping[str, Field] = fields
        self.header = HEADER if number is None else DATA_HEADER
        self.constants = {"type": DATA_TYPE} | ({} if number is None else {"recipe": number})
        self.layout = Layout(
            "data package", [(field, field.shape) for field in fields.values()], self.header, constants=self.constants
        )
        self.size = self.layout.size
        self._is_plain = tuple(fields) == self.names

    def __repr__(self) -> str:
        return f"<Recipe {self.number}: {', '.join(self.names)}>"

    def encode(self, values: Mapping[str, Any]) -> bytes:
        """The data package of these values, header included; what is not given is zero.

        Raises:
            BadValue: no such name in the recipe, or a value that its type cannot hold.
        """
        if not self._is_plain:
            given = {key: values[name] for key, name in zip(self.fields, self.names, strict=True) if name in values}
            values = {**values, **given}
        return self.layout.encode(values)

    def decode(self, data: bytes) -> dict[str, Any]:
        """name -> value in one whole data package: numbers, tuples of numbers, and what they stand for.

        Raises:
            PacketError: it has another size than the recipe, or is of another recipe.
        """
        self.check(data)
        values = self.layout.unpack(data)
        found = {}
        for place, name in zip(self.layout.places.values(), self.names, strict=True):
            value, read = values[place.at], place.shape.read
            if place.count is not None:
                found[name] = value if read is None else tuple(map(read, value))
            else:
                found[name] = value if read is None else read(value)
        return found

    def check(self, data: bytes) -> None:
        """That a data package is one of this recipe.

        Raises:
            PacketError: it has another size, or is of another recipe.
        """
        if len(data) != self.size:
            raise PacketError(
                f"does not fit recipe {self.number}", packet="data package", expected=self.size, actual=len(data)
            )
        if self.number is not None and data[3] != self.number:
            raise PacketError(f"of recipe {data[3]}, not {self.number}", packet="data package", offset=3)

    def state_class(self, base: type[Outputs] = Outputs, left_out: tuple[str, ...] = ()) -> type[Outputs]:
        """The class of typed states with a property for each variable, derived from `base`; `left_out` read as None.

        The same recipe has the same class, so that states from before and after a reconnect are of one.

        Raises:
            BadValue: a name that comes twice.
        """
        if not self._is_plain:
            raise BadValue(f"a name comes twice: {', '.join(self.names)}")
        return _state_class(self.names, self.types, self.number, base, left_out)  # type: ignore[arg-type]  # classes can be hashed


@lru_cache(maxsize=256)
def _state_class(
    names: tuple[str, ...], types: tuple[str, ...], number: int | None, base: type[Outputs], left_out: tuple[str, ...]
) -> type[Outputs]:
    recipe = Recipe(names, types, number)
    body = {name: wire(field.shape, field.unit, field.doc) for name, field in recipe.fields.items()}
    made = type(
        base.__name__,
        (base,),
        {"RECIPE": recipe, "LEFT_OUT": left_out, "__doc__": base.__doc__, **dict.fromkeys(left_out), **body},
    )
    return packet(header=recipe.header, reorder=None, **recipe.constants)(made)

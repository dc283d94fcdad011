"""Recipes: names and types that are known only at run time, converted to the layout of data packages.

A recipe combines the request of a client and the reply of a controller. Both sides use recipes. `Recipe.encode` and
`Recipe.decode` convert values by name. `Recipe.state_class` creates typed states, as fast as the states of other
interfaces.
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

from ..field_names import hint_other_interfaces
from .packets import HEADER
from .variables import OUTPUTS, TYPES, Variable, shape_of

if TYPE_CHECKING:
    from linkcore.clock import Stamp

#: Maximum number of input recipes of one client. Number 0 means that a request was refused.
MOST_RECIPES = 255

DATA_TYPE = ord("U")

#: Header of data packages. Packages from a controller under protocol 1 have no recipe number, and use `HEADER`.
DATA_HEADER = Header(**HEADER.parts, recipe=Int8ub)


class Outputs(State):
    """Values of one data package, by the names of the variables.

    A class is created at run time for each recipe. This is the common base class.
    """

    __slots__ = ()

    #: Recipe of the data package; None if the class does not belong to one recipe.
    RECIPE: ClassVar[Recipe | None] = None
    #: Requested variables that the controller does not have; their values are None.
    LEFT_OUT: ClassVar[tuple[str, ...]] = ()

    def __reduce__(self) -> tuple[object, ...]:
        # The class was created at run time, so unpickling has to create it again.
        recipe, base = self.RECIPE, type(self).__mro__[1]
        assert recipe is not None, "a class without a recipe has no packets"
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
        names: Names of the variables; a name may occur twice.
        types: Type of each variable, as the controller reports it.
        number: Recipe number at the beginning of data packages; None for a controller under protocol 1, which does not
            send the number.
        table: Known variables, `OUTPUTS` or `INPUTS`.

    Raises:
        BadValue: If the numbers of types and names differ, a type is unknown (including `NOT_FOUND` and `IN_USE`), or
            `number` is not 1 to 255.

    Attributes:
        size: Size of a data package in bytes, including the header.
        fields: Fields of the data packages, by name. The field of a repeated name is called `name#2`.
        header: Header of the data packages.
        constants: Values of the parts of the header, except its size.
        layout: Layout of the data packages.
    """

    def __init__(
        self,
        names: Sequence[str],
        types: Sequence[str],
        number: int | None = 1,
        table: Mapping[str, Variable] = OUTPUTS,
    ) -> None:
        if len(names) != len(types):
            raise BadValue(f"got {len(types)} types for {len(names)} names: {', '.join(types)} for {', '.join(names)}")
        if number is not None and not 1 <= number <= MOST_RECIPES:
            raise BadValue(f"the recipe number is {number}; expected 1 to {MOST_RECIPES}")
        self.names, self.types, self.number = tuple(names), tuple(types), number
        fields: dict[str, Field] = {}
        for name, type in zip(names, types, strict=True):
            if type not in TYPES:
                raise BadValue(f"{name} has the type {type}; expected one of {', '.join(TYPES)}")
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
        """Return the data package of these values, including the header. Values that are not given are zero.

        Raises:
            BadValue: If a name is not in the recipe, or a value does not fit its type.
        """
        if not self._is_plain:
            given = {key: values[name] for key, name in zip(self.fields, self.names, strict=True) if name in values}
            values = {**values, **given}
        return self.layout.encode(values)

    def decode(self, data: bytes) -> dict[str, Any]:
        """Decode one whole data package to name -> value: numbers, tuples of numbers, or their enums.

        Raises:
            PacketError: If the size differs from the size of the recipe, or the package belongs to another recipe.
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
        """Check that a data package belongs to this recipe.

        Raises:
            PacketError: If the package has another size, or belongs to another recipe.
        """
        if len(data) != self.size:
            raise PacketError(
                f"its size is not the size of recipe {self.number}",
                packet="data package",
                expected=self.size,
                actual=len(data),
            )
        if self.number is not None and data[3] != self.number:
            raise PacketError(f"it belongs to recipe {data[3]}, not {self.number}", packet="data package", offset=3)

    def state_class(self, base: type[Outputs] = Outputs, left_out: tuple[str, ...] = ()) -> type[Outputs]:
        """Return the class of typed states, derived from `base`, with a property for each variable.

        The variables in `left_out` read as None. The same recipe always has the same class, so states from before and
        after a reconnect are of one class.

        Raises:
            BadValue: If a name occurs twice.
        """
        if not self._is_plain:
            raise BadValue(f"a name occurs twice in {', '.join(self.names)}; pass each name once")
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

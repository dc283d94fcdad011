"""Declared variables: bound by name, typed, and rejected if they are invalid."""

from __future__ import annotations

import pickle
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray

from linkcore.errors import BadValue, LocalError
from rhdlink import AccessDenied, NotThere, Plugin, Variables, WrongVariables, robots
from rhdlink.variables.database import Database
from rhdlink.variables.declarations import Declarations, Read, Write, bind, create_variables
from rhdlink.variables.value_types import Bool, Float32, Float64, Int32, Int64, Scaled, Structure, Text, UInt32
from rhdlink.wire.messages import SymbolRow

if TYPE_CHECKING:
    from typing_extensions import assert_type  # in typing since Python 3.11
else:

    def assert_type(value: object, _: object) -> object:
        return value


class Everything(Declarations):
    whole = Read(Int32)
    line = Read(Int32, 8, unit="raw", doc="reflectance")
    bits = Read(UInt32)
    long = Read(Int64)
    small = Read(Float32)
    pose = Read(Float64, 3)
    speed = Write(Scaled(1e-5, unit="m/s"))
    on = Write(Bool)
    flags = Write(Bool, 2)
    label = Write(Text(12))
    fix = Write(Structure([("quality", "u1"), ("age", "f4")]))
    other = Read(Int32, name="a name that is no attribute")
    maybe = Read(Float64, optional=True)


def bound() -> tuple[Everything, Database]:
    database = Database()
    create_variables(Everything, database)
    everything = Everything()
    bind(everything, database)
    return everything, database


def test_mypy_infers_the_types_of_declared_variables() -> None:
    it, _ = bound()
    assert_type(it.whole, int)
    assert_type(it.line, NDArray[np.int32])
    assert_type(it.bits, int)
    assert_type(it.long, int)
    assert_type(it.small, float)
    assert_type(it.pose, NDArray[np.float64])
    assert_type(it.speed, float)
    assert_type(it.on, bool)
    assert_type(it.flags, NDArray[np.bool_])
    assert_type(it.label, str)
    assert_type(it.fix, np.void)
    # mypy must reject these assignments too, otherwise it reports the comments as unused.
    for wrong in ("fast", None):
        with pytest.raises(BadValue):
            it.speed = wrong  # type: ignore[assignment]
    with pytest.raises(BadValue):
        it.whole = 1.5  # type: ignore[assignment]
    assert type(it.whole) is int
    assert type(it.speed) is float
    assert type(it.on) is bool


def test_values_are_set_and_read_back() -> None:
    it, database = bound()
    it.whole, it.bits, it.long, it.small = -5, 2**32 - 1, -(2**40), 0.5
    it.line, it.pose, it.flags = range(8), [1.5, -2.0, 1e300], [True, False]
    it.speed, it.on, it.label, it.fix = 0.3, True, "hølle", (7, 0.25)
    it.other = 3
    assert (it.whole, it.bits, it.long, it.small) == (-5, 2**32 - 1, -(2**40), 0.5)
    assert (it.line.tolist(), it.pose.tolist(), it.flags.tolist()) == (
        list(range(8)),
        [1.5, -2.0, 1e300],
        [True, False],
    )
    assert (it.speed, it.on, it.label, it.fix.tolist()) == (30000 * 1e-5, True, "hølle", (7, 0.25))
    assert database.write.value(0).tolist() == [30000]
    assert database.read.value(database.read.find("a name that is no attribute") or 0).tolist() == [3]
    assert set(database.write.dirty.take().tolist()) == {0, 1, 2, 3, 4}


def test_arrays_are_immutable_copies() -> None:
    it, _ = bound()
    it.line = range(8)
    before = it.line
    it.line = [9] * 8
    assert before.tolist() == list(range(8))
    with pytest.raises(ValueError, match="read-only"):
        before[0] = 1


def test_bad_value_names_the_variable_and_sets_nothing() -> None:
    it, database = bound()
    with pytest.raises(BadValue, match=r"speed: .* does not fit"):
        it.speed = 1e9
    with pytest.raises(BadValue, match="line: Int32: expected 8 values"):
        it.line = [1, 2]
    assert not database.write.dirty
    assert not database.read.dirty


def test_word_order_is_set_by_the_class_or_the_declaration() -> None:
    class Big(Declarations, order="big"):
        value = Read(Float64)
        other = Read(Float64, order="little")

    class Derived(Big):
        third = Read(Float64)

    database = Database()
    create_variables(Derived, database)
    it = Derived()
    bind(it, database)
    it.value = it.other = it.third = 1.0
    assert database.read.values.tolist() == [0x3FF00000, 0, 0, 0x3FF00000, 0x3FF00000, 0]
    assert (it.value, it.other, it.third) == (1.0, 1.0, 1.0)
    with pytest.raises(BadValue, match="order is 'middle'"):

        class Middle(Declarations, order="middle"):  # type: ignore[arg-type]
            pass


def test_all_differences_are_in_one_error() -> None:
    database = Database(
        read=[SymbolRow("whole", 2), SymbolRow("speed", 1), SymbolRow("bits", 1), SymbolRow("maybe", 1)],
        write=[SymbolRow("line", 8), SymbolRow("on", 1)],
    )
    with pytest.raises(WrongVariables) as caught:
        bind(Everything(), database)
    assert caught.value.differences == (
        "whole has 2 words, declared as 1 (<Read(Int32) whole>)",
        "line is a write variable, declared as read",
        "there is no read variable long",
        "there is no read variable small",
        "there is no read variable pose",
        "speed is a read variable, declared as write",
        "there is no write variable flags",
        "there is no write variable label",
        "there is no write variable fix",
        "there is no read variable a name that is no attribute",
        "maybe has 1 words, declared as 2 (<Read(Float64) maybe>)",
    )
    for difference in caught.value.differences:
        assert difference in str(caught.value)
    again = pickle.loads(pickle.dumps(caught.value))
    assert (again.differences, str(again)) == (caught.value.differences, str(caught.value))


def test_optional_variable_may_be_missing() -> None:
    class Hopeful(Declarations):
        tick = Read(Int32)
        gyro = Read(Int32, 3, optional=True)

    it = Hopeful()
    bind(it, Database(read=[SymbolRow("tick", 1)]))
    assert it.tick == 0
    assert not hasattr(it, "gyro")
    with pytest.raises(NotThere, match="no read variable 'gyro'"):
        _ = it.gyro


def test_unbound_declarations_raise_not_connected() -> None:
    for it in (Everything(), robots.Smr()):
        with pytest.raises(LocalError, match="is not connected"):
            _ = it.whole if isinstance(it, Everything) else it.encl


def test_declarations_are_inherited_replaced_and_removed() -> None:
    class Mine(robots.Smr):
        irsensor = Read(Int32, 5)
        gyro = None  # type: ignore[assignment]
        extra = Write(Int32)

    names = list(Mine.declared())
    assert "gyro" not in names
    assert Mine.declared()["irsensor"].length == 5
    assert names.index("encl") < names.index("extra")
    assert "gyro" in robots.Smr.declared()


def test_declaration_is_accessible_in_its_class() -> None:
    line = Everything.line
    assert_type(line, Read[NDArray[np.int32], ArrayLike])
    assert (line.name, line.unit, line.doc, line.length) == ("line", "raw", "reflectance", 8)
    assert repr(line) == "<Read(Int32, 8) line>"
    assert Everything.speed.unit == "m/s"
    assert Everything.label.length == 3


@pytest.mark.parametrize(
    ("arguments", "options"),
    [((int,), {}), ((Int32, 0), {}), ((Int32, -1), {}), ((Int32,), {"order": "middle"})],
)
def test_read_rejects_invalid_arguments(arguments: tuple[Any, ...], options: dict[str, Any]) -> None:
    with pytest.raises(BadValue):
        Read(*arguments, **options)


def test_variable_with_the_name_of_an_attribute_is_rejected() -> None:
    with pytest.raises(
        BadValue, match=r"Bad.sync would hide an attribute that every Variables object has; .* name='sync'"
    ):

        class Bad(Variables):
            sync = Read(Int32)  # type: ignore[assignment]

    with pytest.raises(BadValue, match=r"Worse.host would hide an attribute that every Plugin object has"):

        class Worse(Plugin):
            host = Read(Int32)  # type: ignore[assignment]

    class Good(Variables):
        synchronous = Read(Int32, name="sync")

    assert Good.declared()["synchronous"].name == "sync"


def test_misspelt_attribute_cannot_be_set() -> None:
    with pytest.raises(NotThere, match="Smr does not declare speedL"):
        robots.Smr().speedL = 5


@pytest.mark.parametrize("robot", [robots.Smr, robots.VelocityOmega, robots.Ackerman, robots.Gps])
def test_predefined_robots_can_be_created_and_bound(robot: type[Variables]) -> None:
    database = Database()
    create_variables(robot, database)
    create_variables(robot, database)  # another plugin declares the same variables
    it = robot()
    bind(it, database)
    assert len(database.read) + len(database.write) == len(robot.declared())
    for attribute, declaration in robot.declared().items():
        value = getattr(it, attribute)
        setattr(it, attribute, value)
        assert not np.any(value)
        assert len(declaration.name) <= 32


def test_scales_equal_those_of_the_original() -> None:
    database = Database()
    create_variables(robots.VelocityOmega, database)
    it = robots.VelocityOmega()
    bind(it, database)
    it.cmdtransvel, it.cmdrotvel = 0.3, -0.6
    assert database.write.values[:2].tolist() == [30000, -24000]
    assert isinstance(AccessDenied("x"), PermissionError)

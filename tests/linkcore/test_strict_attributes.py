"""Unknown attributes and arguments of public objects, for every public class."""

from __future__ import annotations

import dataclasses
import enum
import inspect
from collections.abc import Iterator
from typing import Any

import pytest

import rhdlink
import urlink
from linkcore.names import _OWN_KEYWORDS, StrictAttributes, _arguments, _moves
from linkcore.wire.packet import State
from rhdlink import Int32, Variables, Write
from tests.surface_classes import public_classes

#: Public classes whose instances accept any attribute, with the reason.
LEFT_OUT = {
    "Computer": "a computer in simulated time, made by the library",
    "Counters": "a data class of a simulated controller, set in each cycle",
    "Database": "the variables of a host, which are read and set at each tick",
    "Declaration": "the declaration of a variable, which is read at each access to the variable",
    "ModbusSignal": "a data class",
    "Modes": "modes of a simulated controller, read and set in each cycle",
    "PendingCall": "one is made for each awaited call",
    "Plugin": "users derive from it, and set their own attributes from anywhere",
    "Sample": "a data class with slots",
    "Scaled": "as ValueType",
    "Selection": "it is read at each tick",
    "SimulatedArm": "it is read and set in each cycle; strict attributes would double the time of a cycle at rest",
    "Structure": "as ValueType",
    "Text": "as ValueType",
    "ValueType": "users derive from it",
    "VariableTable": "it is set at each tick",
    "Read": "as Declaration",
    "Write": "as Declaration",
}


def is_plain(kind: type) -> bool:
    """Whether the class is a value or a protocol: its attributes cannot be set, or users implement it."""
    frozen = getattr(kind, "__dataclass_params__", None)
    return (
        issubclass(kind, (BaseException, enum.Enum, tuple, int, float, State))
        or (dataclasses.is_dataclass(kind) and frozen is not None and frozen.frozen)
        or getattr(kind, "_is_protocol", False)
    )


STRICT = sorted(
    (kind for kind in public_classes() if issubclass(kind, StrictAttributes)), key=lambda kind: kind.__name__
)


def test_public_classes_reject_unknown_attributes_or_are_listed() -> None:
    loose = {
        f"{kind.__module__}.{kind.__name__} ({place}): derive it from linkcore.names.StrictAttributes, or "
        "add it to LEFT_OUT in tests/linkcore/test_strict_attributes.py with the reason"
        for kind, place in public_classes().items()
        if not issubclass(kind, StrictAttributes) and not is_plain(kind) and kind.__name__ not in LEFT_OUT
    }
    assert not loose, "\n".join(sorted(loose))
    names = {kind.__name__ for kind in public_classes() if not issubclass(kind, StrictAttributes)}
    assert set(LEFT_OUT) <= names, f"not public or strict; remove from LEFT_OUT: {sorted(set(LEFT_OUT) - names)}"
    assert len(STRICT) > 60


@pytest.mark.parametrize("kind", STRICT, ids=lambda kind: kind.__name__)
def test_unknown_attribute_can_be_neither_set_nor_read(kind: Any) -> None:
    held = object.__new__(kind)
    with pytest.raises(AttributeError):
        held.no_such_name = 1
    with pytest.raises(AttributeError):
        held.no_such_name  # noqa: B018
    assert "no_such_name" not in getattr(held, "__dict__", {})


def moves() -> Iterator[tuple[str, Any, str, str]]:
    """Class and method, the method, and a foreign argument with its own name."""
    for kind in STRICT:
        for name in dir(kind):
            method = inspect.getattr_static(kind, name)
            if (name == "__init__" or name[0] != "_") and inspect.isfunction(method) and _moves(method):
                if kind.__name__.startswith("Async"):
                    continue  # raises only when awaited; see test_async_move_names_the_right_argument_for_a_wrong_one
                for foreign, own in _OWN_KEYWORDS.items():
                    if own in _arguments(method):
                        yield f"{kind.__name__}.{name}", method, foreign, own


def test_wrong_argument_name_raises_error_with_the_right_name() -> None:
    tried = set()
    for name, method, foreign, own in moves():
        with pytest.raises(TypeError, match=f"has no argument '{foreign}'; use '{own}'"):
            method(None, **{foreign: 1})
        assert own in inspect.signature(method).parameters
        tried.add(name)
    expected = {"Motions.move_joints", "Motions.servo", "Group.follow", "Gripper.move", "Scripts.run", "Joint.__init__"}
    expected |= {"Drive.forward"}
    assert expected <= tried, f"no hint for {sorted(expected - tried)}; see _OF_MOVES in src/linkcore/names.py"


@pytest.mark.simulated_time
def test_async_move_names_the_right_argument_for_a_wrong_one() -> None:
    import asyncio

    async def move() -> None:
        async with urlink.connect_async("sim://") as robot:
            with pytest.raises(TypeError, match="has no argument 'vel'; use 'speed'"):
                await robot.motion.move_joints([0.0] * 6, vel=1, wait=True)  # type: ignore[call-arg]

    asyncio.run(move())


def test_move_does_not_change_type_errors_without_a_hint() -> None:
    class Mover(StrictAttributes):
        def move(self, speed: float) -> None:
            raise TypeError("its own")

    with pytest.raises(TypeError, match=r"^its own$"):
        Mover().move(speed=1)
    with pytest.raises(TypeError, match="missing 1 required positional argument"):
        Mover().move()  # type: ignore[call-arg]
    with pytest.raises(TypeError, match="has no argument 'sped'; did you mean 'speed'"):
        Mover().move(sped=1)  # type: ignore[call-arg]


# -- attributes that can be set --------------------------------------------------------------------


@pytest.mark.simulated_time
def test_error_of_assignment_names_the_alternative() -> None:
    with urlink.connect("sim://") as robot:
        held: Any = robot
        for part, name, hint in (
            (held.safety, "policey", r"Safety has no attribute 'policey'; did you mean 'policy'\?"),
            (held, "speed", r"Robot has no 'speed'; equivalent here: robot.set_speed_slider\(fraction\)"),
            (held.io, "tool_voltage", r"IO has no attribute 'tool_voltage' that can be set; use set_tool_voltage\(\)"),
            (held.motion, "stop", r"Motions has no attribute 'stop' that can be set; stop\(\) is a method"),
            (held.controller, "remote_contol", "did you mean 'remote_control'"),
        ):
            with pytest.raises(AttributeError, match=hint):
                setattr(part, name, 1)
        held.safety.policy = "always"
        assert held.safety.policy == "always"


@pytest.mark.simulated_time
def test_methods_can_be_replaced_by_functions() -> None:
    with urlink.connect("sim://") as robot:
        motion: Any = robot.motion
        motion.move_joints = lambda q: "replaced"
        assert motion.move_joints(None) == "replaced"


def test_code_of_the_defining_package_can_add_attributes() -> None:
    class Own(StrictAttributes):
        def __init__(self) -> None:
            self.count = 0

    own: Any = Own()
    own.count = 1
    own.more = 2
    assert (own.count, own.more) == (1, 2)


def test_misspelt_variable_raises_an_error_with_a_hint() -> None:
    class Smr(Variables):
        speedl = Write(Int32)

    robot: Any = Smr()
    with pytest.raises(rhdlink.NotThere, match="does not declare sped; did you mean 'speedl'"):
        robot.sped = 20
    with pytest.raises(AttributeError, match="Smr has no attribute 'sped'; did you mean 'speedl'"):
        robot.sped  # noqa: B018


def test_plugins_can_have_any_attribute() -> None:
    class Battery(rhdlink.Plugin):
        def periodic(self, tick: int) -> None:
            self.ticks = tick

    plugin: Any = Battery()
    plugin.periodic(1)
    plugin.log = print
    assert plugin.ticks == 1


# -- objects that are not connected yet ------------------------------------------------------------


def test_unconnected_robot_raises_error_that_shows_async_with() -> None:
    opening: Any = urlink.connect_async("sim://")
    with pytest.raises(
        AttributeError, match="Opening has no attribute 'realtime'; it is not connected yet; write 'async"
    ):
        opening.realtime  # noqa: B018
    opening = rhdlink.connect_async("localhost")
    with pytest.raises(AttributeError, match="it is not connected yet"):
        opening.sync  # noqa: B018

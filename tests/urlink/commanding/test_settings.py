"""Settings: what is sent, and whether the robot's own states show it."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from linkcore.errors import BadValue, LinkError, LocalError
from tests.urlink.stand_in import StandIn
from tests.waiting import until
from urlink.errors import NotConfirmed, NotRunning
from urlink.interfaces.enums import AnalogDomain, RobotMode
from urlink.interfaces.primary.robot_state import CartesianInfo, MasterboardData, RobotModeData, RobotState, ToolData
from urlink.interfaces.realtime.packets import RealtimeState

#: Acts on a robot with a timeout; what its states show afterwards, and what they may show before.
Case = tuple[Callable[[StandIn, float | None], None], dict[str, Any], dict[str, Any]]


def board(**fields: Any) -> dict[str, Any]:
    return {"board": fields}


SHOWN: dict[str, Case] = {
    "digital": (
        lambda r, c: r.io.set_digital_out(3, True, confirm=c),
        board(digital_output_bits=1 << 3),
        board(digital_output_bits=1 << 2),
    ),
    "off": (
        lambda r, c: r.io.set_digital_out(3, False, confirm=c),
        board(digital_output_bits=0),
        board(digital_output_bits=1 << 3),
    ),
    "configurable": (
        lambda r, c: r.io.set_configurable_digital_out(0, True, confirm=c),
        board(digital_output_bits=1 << 8),
        board(digital_output_bits=1),
    ),
    "tool": (
        lambda r, c: r.io.set_tool_digital_out(1, True, confirm=c),
        board(digital_output_bits=1 << 17),
        board(digital_output_bits=1 << 9),
    ),
    "current": (
        lambda r, c: r.io.set_analog_out(0, 0.5, confirm=c),
        board(analog_output_0=0.012),
        board(analog_output_0=0.011, analog_output_1=0.012),
    ),
    "voltage": (
        lambda r, c: r.io.set_analog_out(1, 0.5, confirm=c),
        board(analog_output_1=5.0, analog_output_domain_1=AnalogDomain.VOLTAGE),
        board(analog_output_1=4.0, analog_output_domain_1=AnalogDomain.VOLTAGE),
    ),
    "tool voltage": (
        lambda r, c: r.io.set_tool_voltage(24, confirm=c),
        {"tool": {"tool_output_voltage": 24}},
        {"tool": {"tool_output_voltage": 12}},
    ),
    "slider": (
        lambda r, c: r.settings.speed_slider(0.42, c),
        {"modes": {"target_speed_fraction": 0.42}},
        {"modes": {"target_speed_fraction": 0.43}},
    ),
    "tcp": (
        lambda r, c: r.settings.tcp([0.1, 0, 0.2, 0, 0, 1.0], c),
        {"tcp": [0.1, 0, 0.2, 0, 0, 1.0]},
        {"tcp": [0.1, 0, 0.2, 0, 0, 1.1]},
    ),
    "tcp the longer way round": (
        lambda r, c: r.settings.tcp([0, 0, 0, 0, 0, 4.0], c),
        {"tcp": [0, 0, 0, 0, 0, 4.0 - 6.283185307179586]},
        {"tcp": [0, 0, 0, 0, 0, -4.0]},
    ),
    "mass": (
        lambda r, c: r.settings.payload(1.5, None, None, c),
        {"payload": (1.5, [0, 0, 0.3])},
        {"payload": (1.4, [0, 0, 0.3])},
    ),
    "centre of gravity": (
        lambda r, c: r.settings.payload(1.5, [0, 0.01, 0.1], None, c),
        {"payload": (1.5, [0, 0.01, 0.1])},
        {"payload": (1.5, [0, 0, 0.1])},
    ),
}


@pytest.fixture
def robot() -> Iterator[StandIn]:
    with StandIn() as robot:
        robot.clear()
        yield robot


def show(robot: StandIn, what: dict[str, Any]) -> None:
    """A state on each interface that shows it."""
    axes = ("X", "Y", "Z", "Rx", "Ry", "Rz")
    offset = {f"tcp_offset_{axis}": value for axis, value in zip(axes, what.get("tcp", [0] * 6), strict=True)}
    packages = [
        RobotModeData(robot.firmware, robot_mode=RobotMode.RUNNING, **what.get("modes", {})),
        MasterboardData(robot.firmware, **what.get("board", {})),
        ToolData(robot.firmware, **what.get("tool", {})),
        CartesianInfo(robot.firmware, **offset),
    ]
    mass, cog = what.get("payload", (0.0, [0, 0, 0]))
    fields = {"payload_mass": mass, "payload_cog": cog} if robot.firmware >= (5, 10) else {}
    robot.slow.put(bytes(RobotState(*packages)))
    robot.fast.put(bytes(RealtimeState(robot.firmware, robot_mode=RobotMode.RUNNING, **fields)))


class Setting:
    """A setting in a thread of its own."""

    def __init__(self, robot: StandIn, act: Callable[[StandIn, float | None], None], confirm: float | None) -> None:
        self.error: LinkError | None = None
        self._thread = threading.Thread(target=self._run, args=(robot, act, confirm))
        self._thread.start()

    def _run(self, robot: StandIn, act: Callable[[StandIn, float | None], None], confirm: float | None) -> None:
        try:
            act(robot, confirm)
        except LinkError as error:
            self.error = error

    @property
    def is_over(self) -> bool:
        return not self._thread.is_alive()


@pytest.mark.parametrize("name", SHOWN)
def test_waits_until_the_robot_shows_it(robot: StandIn, name: str) -> None:
    act, right, wrong = SHOWN[name]
    setting = Setting(robot, act, 10.0)
    until(lambda: robot.sent)
    for _ in range(3):
        show(robot, wrong)
    assert not setting.is_over

    def shown() -> bool:
        show(robot, right)
        return setting.is_over

    until(shown)
    assert setting.error is None
    assert len(robot.sent) == 1


@pytest.mark.parametrize("name", SHOWN)
def test_says_what_the_robot_shows_instead(robot: StandIn, name: str) -> None:
    act, _, wrong = SHOWN[name]
    setting = Setting(robot, act, 0.3)

    def tell() -> bool:
        show(robot, wrong)
        return setting.is_over

    until(tell)
    assert isinstance(setting.error, NotConfirmed)
    assert "did not show it within 0.3 s: its states show" in str(setting.error)
    assert "nothing of it" not in str(setting.error)


@pytest.mark.parametrize("name", SHOWN)
def test_does_not_wait_where_that_is_not_asked_for(robot: StandIn, name: str) -> None:
    SHOWN[name][0](robot, None)
    assert len(robot.sent) == 1


@pytest.mark.parametrize(
    ("firmware", "is_remote", "why"),
    [
        ("5.11", False, "The robot is in local control"),
        ("5.11", None, "look at the pendant"),
        ("5.11", True, "Perhaps the controller was held up"),
        ("3.4", None, "Perhaps the controller was held up"),
    ],
)
def test_names_the_likely_cause(firmware: str, is_remote: bool | None, why: str) -> None:
    with StandIn(firmware, is_remote=is_remote) as robot:
        robot.clear()
        with pytest.raises(NotConfirmed, match=why):
            robot.io.set_digital_out(0, True, confirm=0.05)


@pytest.mark.parametrize(
    ("firmware", "act"),
    [
        ("5.9", lambda r: r.settings.payload(1.0, None, None, 1.0)),
        ("3.1", lambda r: r.settings.tcp([0] * 6, 1.0)),
        ("1.8", lambda r: r.settings.speed_slider(0.5, 1.0)),
        ("1.8", lambda r: r.io.set_tool_digital_out(0, True)),
        ("5.11", lambda r: r.settings.popup("x", "y", False, False)),
        ("5.11", lambda r: r.io.set_flag(3, True)),
    ],
)
def test_does_not_wait_for_what_no_state_shows(firmware: str, act: Callable[[StandIn], None]) -> None:
    with StandIn(firmware) as robot:
        robot.clear()
        act(robot)
        assert len(robot.sent) == 1


def test_where_it_would_wait_for_itself(robot: StandIn) -> None:
    raised: list[LinkError] = []

    def switch(state: RobotState) -> None:
        try:
            robot.io.set_digital_out(0, True)
        except LinkError as error:
            raised.append(error)
        robot.io.set_digital_out(0, True, confirm=None)

    with robot.primary.subscribe(switch, inline=True):
        robot.state(fast=False)
        until(lambda: robot.sent)
    assert isinstance(raised[0], LocalError)
    assert len(robot.sent) == 1


def test_from_a_callback_with_a_thread_of_its_own(robot: StandIn) -> None:
    done = threading.Event()

    def switch(state: RobotState) -> None:
        robot.io.set_digital_out(0, True)
        done.set()

    def is_done() -> bool:
        robot.state(board={"digital_output_bits": 1})
        return done.is_set()

    with robot.primary.subscribe(switch):
        until(is_done)


def test_nothing_is_sent_to_a_robot_that_does_not_run(robot: StandIn) -> None:
    robot.state(RobotMode.POWER_OFF)
    until(lambda: robot.safety.robot_mode is RobotMode.POWER_OFF)
    with pytest.raises(NotRunning):
        robot.io.set_digital_out(0, True)
    assert robot.sent == []


@pytest.mark.parametrize("confirm", [0, -1, "soon", float("nan"), True])
def test_no_number_of_seconds(robot: StandIn, confirm: Any) -> None:
    with pytest.raises(BadValue, match="confirm"):
        robot.settings.tcp([0] * 6, confirm)
    assert robot.sent == []


@pytest.mark.parametrize(
    ("model", "mass", "is_carried"),
    [
        ("UR3e", 3.75, True),
        ("UR3e", 3.76, False),
        ("UR5e", 9.375, True),
        ("UR5e", 9.38, False),
        ("UR5e", 50.0, False),
    ],
)
def test_no_payload_that_the_arm_cannot_carry(model: str, mass: float, is_carried: bool) -> None:
    """A UR3e carries 3 kg, a UR7e, which says that it is a UR5e, 7.5 kg; a quarter is left for later software."""
    with StandIn(model=model) as robot:
        robot.clear()
        if is_carried:
            robot.settings.payload(mass, None, None, None)
        else:
            with pytest.raises(BadValue, match=r"a (UR3e carries 3|UR5e or UR7e carries 7\.5) kg at most"):
                robot.settings.payload(mass, None, None, None)
        assert len(robot.sent) == is_carried


def test_an_arm_that_nobody_knows_carries_what_any_does() -> None:
    with StandIn() as robot:
        robot.clear()
        robot.settings.payload(99.0, None, None, None)
        with pytest.raises(BadValue, match="payload mass"):
            robot.settings.payload(101.0, None, None, None)

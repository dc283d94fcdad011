"""Settings: the sent text, and the confirmation by the robot's own states."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterator
from decimal import Decimal
from typing import Any, cast

import pytest

from linkcore.errors import BadValue, LinkError, LinkTimeout, LocalError
from linkcore.streaming.connection import Connection
from linkcore.wire.packet import State
from tests.fakes.controller import ScriptedController
from tests.fakes.line import Line
from tests.fakes.packets import packet
from tests.waiting import until
from urlink.command.io import IO
from urlink.command.section import Section
from urlink.command.settings import SettingChannel, Settings
from urlink.errors import NotConfirmed, NotRunning
from urlink.protocol.enums import AnalogDomain, RobotMode
from urlink.protocol.firmware import Firmware
from urlink.protocol.primary.robot_state import CartesianInfo, MasterboardData, RobotModeData, RobotState, ToolData
from urlink.protocol.realtime.packets import RealtimeState
from urlink.script.wrapping import StartPlace
from urlink.session.identity import Identity, KnownIdentity

pytestmark = pytest.mark.simulated_time

#: Setting with a timeout; values that the states show afterwards; values that they may show before.
Case = tuple[Callable[[ScriptedController, float | None], None], dict[str, Any], dict[str, Any]]


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
    "tcp turned by more than 180 degrees": (
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
    "analog output of another type of number": (
        lambda r, c: r.io.set_analog_out(0, cast(Any, Decimal("0.5")), confirm=c),
        board(analog_output_0=0.012),
        board(analog_output_0=0.011),
    ),
    "slider of another type of number": (
        lambda r, c: r.settings.speed_slider(cast(Any, Decimal("0.25")), c),
        {"modes": {"target_speed_fraction": 0.25}},
        {"modes": {"target_speed_fraction": 0.26}},
    ),
    "payload of another type of number": (
        lambda r, c: r.settings.payload(cast(Any, Decimal("1.5")), [cast(Any, Decimal("0.5"))] * 3, None, c),
        {"payload": (1.5, [0.5, 0.5, 0.5])},
        {"payload": (1.5, [0, 0, 0.1])},
    ),
}


@pytest.fixture
def robot() -> Iterator[ScriptedController]:
    with ScriptedController() as robot:
        robot.clear()
        yield robot


def show(robot: ScriptedController, what: dict[str, Any]) -> None:
    """On each interface, send a state that shows the values of `what`."""
    axes = ("X", "Y", "Z", "Rx", "Ry", "Rz")
    offset = {f"tcp_offset_{axis}": value for axis, value in zip(axes, what.get("tcp", [0] * 6), strict=True)}
    packages = [
        packet(RobotModeData, robot.firmware, robot_mode=RobotMode.RUNNING, **what.get("modes", {})),
        packet(MasterboardData, robot.firmware, **what.get("board", {})),
        packet(ToolData, robot.firmware, **what.get("tool", {})),
        packet(CartesianInfo, robot.firmware, **offset),
    ]
    mass, cog = what.get("payload", (0.0, [0, 0, 0]))
    fields = {"payload_mass": mass, "payload_cog": cog} if robot.firmware >= (5, 10) else {}
    robot.slow.put(bytes(RobotState(*packages)))
    robot.fast.put(bytes(packet(RealtimeState, robot.firmware, robot_mode=RobotMode.RUNNING, **fields)))


class Setting:
    """Setting that is made in a new thread."""

    def __init__(
        self, robot: ScriptedController, act: Callable[[ScriptedController, float | None], None], confirm: float | None
    ) -> None:
        self.error: LinkError | None = None
        self._thread = threading.Thread(target=self._run, args=(robot, act, confirm))
        self._thread.start()

    def _run(
        self, robot: ScriptedController, act: Callable[[ScriptedController, float | None], None], confirm: float | None
    ) -> None:
        try:
            act(robot, confirm)
        except LinkError as error:
            self.error = error

    @property
    def is_over(self) -> bool:
        return not self._thread.is_alive()


@pytest.mark.parametrize("name", SHOWN)
def test_setting_waits_until_states_show_it(robot: ScriptedController, name: str) -> None:
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
def test_not_confirmed_error_names_the_reported_value(robot: ScriptedController, name: str) -> None:
    act, _, wrong = SHOWN[name]
    setting = Setting(robot, act, 0.3)

    def is_refused() -> bool:
        show(robot, wrong)
        return setting.is_over

    until(is_refused)
    assert isinstance(setting.error, NotConfirmed)
    assert "did not show it within 0.3 s: its states show" in str(setting.error)
    assert "no value" not in str(setting.error)


@pytest.mark.parametrize("name", SHOWN)
def test_setting_without_confirm_does_not_wait(robot: ScriptedController, name: str) -> None:
    SHOWN[name][0](robot, None)
    assert len(robot.sent) == 1


@pytest.mark.parametrize(
    ("firmware", "is_remote", "why"),
    [
        ("5.11", False, "the robot is in local control"),
        ("5.11", None, "check the mode on the pendant"),
        ("5.11", True, "the controller might have been delayed"),
        ("3.4", None, "the controller might have been delayed"),
    ],
)
def test_not_confirmed_error_names_the_likely_cause(firmware: str, is_remote: bool | None, why: str) -> None:
    with ScriptedController(firmware, is_remote=is_remote) as robot:
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
def test_setting_that_states_do_not_show_does_not_wait(
    firmware: str, act: Callable[[ScriptedController], None]
) -> None:
    with ScriptedController(firmware) as robot:
        robot.clear()
        act(robot)
        assert len(robot.sent) == 1


def test_setting_in_inline_callback_cannot_wait(robot: ScriptedController) -> None:
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


def test_setting_in_queued_callback_can_wait(robot: ScriptedController) -> None:
    done = threading.Event()

    def switch(state: RobotState) -> None:
        robot.io.set_digital_out(0, True)
        done.set()

    def is_done() -> bool:
        robot.state(board={"digital_output_bits": 1})
        return done.is_set()

    with robot.primary.subscribe(switch):
        until(is_done)


def test_setting_is_refused_when_robot_is_not_running(robot: ScriptedController) -> None:
    robot.state(RobotMode.POWER_OFF)
    until(lambda: robot.safety.robot_mode is RobotMode.POWER_OFF)
    with pytest.raises(NotRunning):
        robot.io.set_digital_out(0, True)
    assert robot.sent == []


@pytest.mark.parametrize("confirm", [0, -1, "soon", float("nan"), True])
def test_setting_rejects_invalid_confirm(robot: ScriptedController, confirm: Any) -> None:
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
def test_payload_is_limited_to_capacity_of_the_arm(model: str, mass: float, is_carried: bool) -> None:
    """A UR3e carries 3 kg. A UR7e, which identifies itself as a UR5e, carries 7.5 kg.

    The limit is a quarter higher, for later software.
    """
    with ScriptedController(model=model) as robot:
        robot.clear()
        if is_carried:
            robot.settings.payload(mass, None, None, None)
        else:
            with pytest.raises(BadValue, match=r"a (UR3e carries at most 3|UR5e or UR7e carries at most 7\.5) kg"):
                robot.settings.payload(mass, None, None, None)
        assert len(robot.sent) == is_carried


def test_payload_of_unknown_arm_has_general_limit() -> None:
    with ScriptedController() as robot:
        robot.clear()
        robot.settings.payload(99.0, None, None, None)
        with pytest.raises(BadValue, match="payload mass"):
            robot.settings.payload(101.0, None, None, None)


# -- a robot that shows a value immediately after a setting was sent -----------------------------------


class Answering:
    """Settings of a robot that replies to each setting with the states `answers`, before the wait begins."""

    def __init__(self, firmware: str = "5.11", is_remote: Callable[[], bool | None] = lambda: None) -> None:
        self.firmware = Firmware.parse(firmware)
        self.primary, self.realtime = Line(), Line()
        self.answers: list[State] = []
        self.sent: list[str] = []
        self.doubts = 0
        self.settings = Settings(
            cast(SettingChannel, self),
            cast(Connection, self.primary),
            cast(Connection, self.realtime),
            KnownIdentity(lambda: Identity(self.firmware, True, None)),
            Section(),
            is_remote,
            StartPlace(None, ()),
        )

    def send(self, text: str, values: object = None, *, wait: bool = True) -> None:
        self.sent.append(text)
        for answer in self.answers:
            (self.realtime if isinstance(answer, RealtimeState) else self.primary).deliver(answer)

    def doubt(self) -> None:
        self.doubts += 1

    def is_confirmed(self, act: Callable[[Settings, float], None], *answers: State) -> bool:
        self.answers = list(answers)
        try:
            act(self.settings, 0.001)
        except NotConfirmed:
            return False
        finally:
            assert self.primary.subscribers == self.realtime.subscribers == []
        return True


def offset(*pose: float) -> CartesianInfo:
    axes = ("X", "Y", "Z", "Rx", "Ry", "Rz")
    return CartesianInfo((5, 11), **{f"tcp_offset_{axis}": value for axis, value in zip(axes, pose, strict=True)})


@pytest.mark.parametrize(
    ("wanted", "shown", "is_same"),
    [
        ((0.1, 0.2, 0.3, 0, 0, 0), (0.1, 0.2, 0.3, 0, 0, 0), True),
        ((0.1, 0.2, 0.3, 0, 0, 0), (0.1, 0.2, 0.3 + 0.9e-6, 0, 0, 0), True),
        ((0.1, 0.2, 0.3, 0, 0, 0), (0.1, 0.2, 0.3 + 1.1e-6, 0, 0, 0), False),
        ((0.1, 0.2, 0.3, 0, 0, 0), (0.1, 0.2, 0.3, 0, 0, 1.1e-6), False),
        ((0, 0, 0, 0, 0, 0.5), (0, 0, 0, 0, 0, 0.5 - 2 * math.pi), True),
        ((0, 0, 0, 0, 6.0, 0), (0, 0, 0, 0, 6.0 - 2 * math.pi, 0), True),
        ((0, 0, 0, -3.0, 0, 0), (0, 0, 0, 2 * math.pi - 3.0, 0, 0), True),
        ((0, 0, 0, 0, 0, 0), (0, 0, 0, 0, 0, 2 * math.pi), True),
        ((0, 0, 0, 0, 0, 0.5), (0, 0, 0, 0, 0, -0.5), False),
    ],
)
def test_tcp_is_confirmed_when_the_reported_pose_is_equal(
    wanted: tuple[float, ...], shown: tuple[float, ...], is_same: bool
) -> None:
    robot = Answering()
    assert robot.is_confirmed(lambda settings, confirm: settings.tcp(wanted, confirm), offset(*shown)) == is_same
    assert robot.doubts == (not is_same)


def analog_out(settings: Settings, fraction: float, confirm: float) -> None:
    nobody: Any = None
    IO(settings, primary=nobody, realtime=nobody).set_analog_out(0, fraction, confirm=confirm)


@pytest.mark.parametrize(
    ("act", "shown", "is_right"),
    [
        (lambda s, c: s.speed_slider(0.5, c), RobotModeData((5, 11), target_speed_fraction=0.5049), True),
        (lambda s, c: s.speed_slider(0.5, c), RobotModeData((5, 11), target_speed_fraction=0.4951), True),
        (lambda s, c: s.speed_slider(0.5, c), RobotModeData((5, 11), target_speed_fraction=0.5051), False),
        (lambda s, c: s.speed_slider(0.5, c), RobotModeData((5, 11), target_speed_fraction=0.4949), False),
        (lambda s, c: s.speed_slider(0.0, c), RobotModeData((5, 11), target_speed_fraction=0.005), True),
        (lambda s, c: analog_out(s, 0.5, c), MasterboardData((5, 11), analog_output_0=0.004 + 0.016 * 0.519), True),
        (lambda s, c: analog_out(s, 0.5, c), MasterboardData((5, 11), analog_output_0=0.004 + 0.016 * 0.479), False),
        (
            lambda s, c: analog_out(s, 0.0, c),
            MasterboardData((5, 11), analog_output_domain_0=1, analog_output_0=0.2),
            True,
        ),
        (lambda s, c: s.payload(1.0, None, None, c), RealtimeState((5, 11), payload_mass=1.0 + 0.9e-6), True),
        (lambda s, c: s.payload(1.0, None, None, c), RealtimeState((5, 11), payload_mass=1.0 - 1.1e-6), False),
        (lambda s, c: s.payload(1.0, [0, 0, 0], None, c), RealtimeState((5, 11), payload_mass=1.0), True),
        (lambda s, c: s.payload(1.0, [0, 0, 1e-5], None, c), RealtimeState((5, 11), payload_mass=1.0), False),
    ],
)
def test_setting_is_confirmed_only_within_its_tolerance(
    act: Callable[[Settings, float], None], shown: State, is_right: bool
) -> None:
    assert Answering().is_confirmed(act, shown) == is_right


@pytest.mark.parametrize(
    ("firmware", "act", "is_waited_for"),
    [
        ("5.9", lambda s, c: s.payload(1.0, None, None, c), False),
        ("5.10", lambda s, c: s.payload(1.0, None, None, c), True),
        ("3.1", lambda s, c: s.tcp([0] * 6, c), False),
        ("3.2", lambda s, c: s.tcp([0] * 6, c), True),
        ("1.8", lambda s, c: s.speed_slider(0.5, c), False),
        ("3.0", lambda s, c: s.speed_slider(0.5, c), True),
    ],
)
def test_setting_is_confirmed_only_by_firmware_that_shows_it(
    firmware: str, act: Callable[[Settings, float], None], is_waited_for: bool
) -> None:
    robot = Answering(firmware)
    assert robot.is_confirmed(act) != is_waited_for
    assert len(robot.sent) == 1


def test_setting_is_confirmed_by_one_matching_state() -> None:
    robot = Answering()

    def act(settings: Settings, confirm: float) -> None:
        settings.speed_slider(0.5, confirm)

    right, other = (RobotModeData((5, 11), target_speed_fraction=each) for each in (0.5, 0.7))
    assert robot.is_confirmed(act, other, right, other)
    robot.answers = [right, other]
    robot.settings.speed_slider(0.5, None)
    robot.answers = [other]
    with pytest.raises(NotConfirmed, match=r"within 0\.001 s: its states show 0\.7;"):
        act(robot.settings, 0.001)


def test_setting_is_not_confirmed_by_states_without_its_fields() -> None:
    """The controller reports firmware 5.11, but sends packets of an older firmware."""
    robot = Answering()
    robot.answers = [RealtimeState("3.4"), CartesianInfo("1.8")]
    acts: list[Callable[[], None]] = [
        lambda: robot.settings.payload(1.0, None, None, 0.001),
        lambda: robot.settings.tcp([0] * 6, 0.001),
    ]
    for act in acts:
        with pytest.raises(NotConfirmed, match="its states show no value"):
            act()


def test_not_confirmed_error_names_a_cause_without_dashboard() -> None:
    asked: list[str] = []

    def is_remote() -> bool | None:
        asked.append("dashboard")
        raise LinkTimeout("no answer")

    for firmware, why, count in (
        ("5.11", "check the mode on the pendant", 1),
        ("3.4", "the controller might have been delayed", 0),
    ):
        asked.clear()
        with pytest.raises(NotConfirmed, match=why):
            Answering(firmware, is_remote).settings.speed_slider(0.5, 0.001)
        assert len(asked) == count


def test_zero_force_sensor_needs_firmware_3_0() -> None:
    robot = Answering("3.0")
    robot.settings.zero_force_sensor()
    assert "zero_ftsensor()" in robot.sent[0]
    with pytest.raises(LocalError, match=r"1\.8 cannot zero its force sensor"):
        Answering("1.8").settings.zero_force_sensor()

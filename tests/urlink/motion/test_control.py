"""Commands to a robot, as `connect` sets them up, and robots that reject commands."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

import urlink
from linkcore.errors import BadValue, LocalError
from tests.waiting import until
from urlink.errors import NotEnabled, NotRunning, SafetyStop
from urlink.simulator import Controller

pytestmark = pytest.mark.simulated_time


@pytest.fixture
def controller() -> Iterator[Controller]:
    with Controller("UR5e", "5.11") as controller:
        yield controller


@pytest.fixture
def robot(controller: Controller) -> Iterator[urlink.Robot]:
    before = set(threading.enumerate())
    controller.received.clear()
    with urlink.connect(controller.address) as robot:
        yield robot
    assert set(threading.enumerate()) <= before
    controller.faults.clear()
    controller.faults.power_on()


def lines(controller: Controller, count: int) -> list[str]:
    """Return the lines that the primary interface received, when there are `count` of them."""
    until(lambda: len(controller.received) >= count)
    assert {port for port, _ in controller.received} == {"primary"}
    return [line for _, line in controller.received]


@pytest.mark.parametrize(
    ("act", "text"),
    [
        (lambda robot: robot.set_payload(1.5, (0, 0, 0.1)), "  set_payload(1.5, [0.0, 0.0, 0.1])"),
        (lambda robot: robot.set_tcp((0, 0, 0.1, 0, 0, 0)), "  set_tcp(p[0.0, 0.0, 0.1, 0.0, 0.0, 0.0])"),
        (lambda robot: robot.popup("mind the gap"), '  popup("mind the gap", "Popup", False, False)'),
        (lambda robot: robot.io.set_digital_out(1, True), "  set_standard_digital_out(1, True)"),
    ],
)
def test_commands_are_sent_as_script(controller: Controller, act: Callable[[urlink.Robot], None], text: str) -> None:
    controller.received.clear()
    with urlink.connect(controller.address, commands_via="script") as robot:
        act(robot)
        assert lines(controller, 3) == ["sec urlink_command():", text, "end"]


def test_speed_slider_sends_set_speed(controller: Controller) -> None:
    controller.received.clear()
    with urlink.connect(controller.address, commands_via="script") as robot:
        robot.set_speed_slider(0.42)
        assert lines(controller, 1) == ["set speed 0.42"]


def test_robot_parts_are_the_same_object_at_each_access(robot: urlink.Robot) -> None:
    for name in ("safety", "script", "io"):
        assert getattr(robot, name) is getattr(robot, name)


def test_safety_stop_blocks_scripts_until_cleared(controller: Controller, robot: urlink.Robot) -> None:
    heard: list[urlink.LinkError] = []
    robot.safety.on_stop(heard.append)
    robot.script.send_line("stopj(1.0)")
    controller.faults.protective_stop()
    until(lambda: heard)
    assert isinstance(heard[0], SafetyStop)
    with pytest.raises(SafetyStop, match="protective stop"):
        robot.script.run("movej(q)")
    robot.io.set_tool_voltage(0)
    controller.faults.clear()
    robot.safety.wait_enabled(5)
    controller.faults.emergency_stop()
    until(lambda: robot.safety.cause)
    controller.faults.clear()
    until(lambda: robot.safety.robot_mode is urlink.packets.RobotMode.POWER_OFF)
    until(lambda: robot.safety.cause is None)
    with pytest.raises(NotRunning, match="POWER_OFF"):
        robot.set_payload(1.0)
    controller.faults.power_on()
    robot.safety.wait_enabled(5)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["stop", "pause", "power_off"])
def test_dashboard_stop_overtakes_a_motion(robot: urlink.Robot, name: str) -> None:
    robot.realtime.wait()
    call = urlink.PendingCall()
    with contextlib.suppress(urlink.LinkError):
        getattr(robot.dashboard, name)()
    with pytest.raises(urlink.LinkError):
        call.make(lambda: robot.motion.move_joints([0.5, -1.57, 1.57, -1.57, -1.57, 0]))
    assert isinstance(call.make(lambda: robot.safety.refusal), urlink.LinkError)
    assert robot.motion.current is None


def test_motion_starts_right_after_power_on() -> None:
    """The newest message of the primary interface can be a tenth of a second old."""
    with urlink.connect("sim://ur5e?firmware=5.11") as robot:
        robot.io.set_digital_out(0, True)
        for _ in range(3):
            robot.dashboard.power_off()  # the robot comes to rest first, and is RUNNING until then
            robot.dashboard.start()
            robot.motion.stop().wait(10)


def test_closed_robot_does_not_connect_to_dashboard(controller: Controller) -> None:
    robot = urlink.connect(controller.address)
    robot.close()
    with pytest.raises(urlink.Closed):
        robot.dashboard.play()


def test_require_enable_always_refuses_until_enabled(controller: Controller) -> None:
    with urlink.connect(controller.address, require_enable="always") as robot:
        with pytest.raises(NotEnabled):
            robot.script.send_line("stopj(1.0)")
        robot.safety.enable()
        robot.script.send_line("stopj(1.0)")


def test_read_only_rejects_commands(controller: Controller) -> None:
    with urlink.connect(controller.address, read_only=True) as robot:
        for name in ("safety", "script", "io", "motion", "dashboard"):
            with pytest.raises(LocalError, match="read_only=True"):
                getattr(robot, name)
        with pytest.raises(LocalError, match="read_only=True"):
            robot.set_payload(1.0)
        with pytest.raises(LocalError, match="is not a simulator started by this program"):
            robot.controller  # noqa: B018


def test_recording_rejects_commands(robot: urlink.Robot, tmp_path: Path) -> None:
    with robot.record(tmp_path / "run.urlog"):
        robot.primary.wait(5)
    with urlink.connect(f"replay://{tmp_path / 'run.urlog'}") as played:
        with pytest.raises(LocalError, match="is a recording"):
            played.script  # noqa: B018
        with pytest.raises(LocalError, match="is a recording"):
            played.set_speed_slider(0.5)


def test_unknown_enable_policy_is_rejected() -> None:
    with pytest.raises(BadValue, match="require_enable='sometimes'"):
        urlink.connect("sim://", require_enable="sometimes")  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "option",
    [
        {"reverse_port": 70000},
        {"reverse_port": -1},
        {"reverse_port": "50001"},
        {"reverse_host": ""},
        {"reverse_host": 3},
        {"reverse_peer": 3},
        {"timeout": 0},
        {"timeout": "5"},
        {"silence": None},
        {"stale_after": 0},
        {"start_timeout": float("nan")},
        {"start_register": 48},
        {"start_register": True},
        {"start_flags": 31},
        {"start_flags": [32]},
        {"start_flags": [True]},
        {"start_flags": [31, 30, 31]},
        {"start_flags": "31"},
        {"backoff": 2.0},
        {"commands_via": "rtde"},
    ],
    ids=str,
)
def test_invalid_option_is_named_in_error(option: dict[str, Any]) -> None:
    (name,) = option
    with pytest.raises(BadValue, match=name):
        urlink.connect("sim://", **option)


def test_closed_robot_rejects_commands(controller: Controller) -> None:
    robot = urlink.connect(controller.address)
    robot.script.send_line("stopj(1.0)")
    robot.close()
    robot.close()
    with pytest.raises((NotRunning, urlink.Closed)):
        robot.script.send_line("stopj(1.0)")


def test_close_respects_timeout_despite_hanging_callback(controller: Controller) -> None:
    robot = urlink.connect(controller.address)
    go_on = threading.Event()
    inside = threading.Event()

    def hang(motion: urlink.Motion) -> None:
        inside.set()
        go_on.wait(20)

    motion = robot.motion.stop()
    motion.add_done_callback(hang)
    motion.wait(10)
    assert inside.wait(10)
    began = time.monotonic()
    robot.close(0.5)
    assert time.monotonic() - began < 5.0
    go_on.set()


def test_last_setting_before_close_arrives(controller: Controller) -> None:
    """The connection is closed in good order, so the last bytes sent are not discarded."""
    controller.faults.clear()
    for on in (True, False, True):
        with urlink.connect(controller.address) as robot:
            robot.io.set_digital_out(5, on, confirm=None)
        until(lambda on=on: bool(controller.signals.digital_outputs >> 5 & 1) == on)  # type: ignore[misc]

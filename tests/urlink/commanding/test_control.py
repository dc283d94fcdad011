"""What a robot is commanded by, as `connect` wires it up; and who cannot be commanded."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

import urlink
from linkcore.errors import BadValue, LocalError
from tests.waiting import until
from urlink.errors import NotEnabled, NotRunning, SafetyStop
from urlink.simulator import Controller


@pytest.fixture(scope="module")
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
    """The lines that came to the primary interface, once there are so many."""
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
def test_commands(controller: Controller, robot: urlink.Robot, act: Callable[[urlink.Robot], None], text: str) -> None:
    act(robot)
    assert lines(controller, 3) == ["sec urlink_command():", text, "end"]


@pytest.mark.parametrize(("mass", "is_carried"), [(6.25, True), (6.3, False), (50.0, False)])
def test_no_payload_that_the_arm_cannot_carry(
    controller: Controller, robot: urlink.Robot, mass: float, is_carried: bool
) -> None:
    """A UR5e carries 5 kg, and a quarter is left for later software."""
    if is_carried:
        robot.set_payload(mass)
        assert len(lines(controller, 3)) == 3
    else:
        with pytest.raises(BadValue, match=r"a UR5e carries 5 kg"):
            robot.set_payload(mass)
        assert not controller.received


def test_speed_slider(controller: Controller, robot: urlink.Robot) -> None:
    robot.set_speed_slider(0.42)
    assert lines(controller, 1) == ["set speed 0.42"]


def test_each_part_is_one(robot: urlink.Robot) -> None:
    for name in ("safety", "script", "io"):
        assert getattr(robot, name) is getattr(robot, name)


def test_a_stop_of_the_controller(controller: Controller, robot: urlink.Robot) -> None:
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
    until(lambda: robot.safety.robot_mode is urlink.RobotMode.POWER_OFF)
    until(lambda: robot.safety.cause is None)
    with pytest.raises(NotRunning, match="POWER_OFF"):
        robot.set_payload(1.0)
    controller.faults.power_on()
    robot.safety.wait_enabled(5)


def test_moved_as_soon_as_it_is_switched_on() -> None:
    """What the primary interface said last may be a tenth of a second old."""
    with urlink.connect("sim://ur5e?firmware=5.11") as robot:
        robot.io.set_digital_out(0, True)
        for _ in range(3):
            robot.dashboard.power_off()  # it comes to rest first, and until then it runs
            robot.dashboard.start()
            robot.motion.stop().wait(10)


def test_a_closed_robot_connects_to_no_dashboard(controller: Controller) -> None:
    robot = urlink.connect(controller.address)
    robot.close()
    with pytest.raises(urlink.Closed):
        robot.dashboard.play()


def test_enabling_is_asked_for(controller: Controller) -> None:
    with urlink.connect(controller.address, require_enable="always") as robot:
        with pytest.raises(NotEnabled):
            robot.script.send_line("stopj(1.0)")
        robot.safety.enable()
        robot.script.send_line("stopj(1.0)")


def test_read_only(controller: Controller) -> None:
    with urlink.connect(controller.address, read_only=True) as robot:
        for name in ("safety", "script", "io", "motion", "dashboard"):
            with pytest.raises(LocalError, match="read_only=True"):
                getattr(robot, name)
        with pytest.raises(LocalError, match="read_only=True"):
            robot.set_payload(1.0)
    assert robot.control is None


def test_a_recording(robot: urlink.Robot, tmp_path: Path) -> None:
    with robot.record(tmp_path / "run.urlog"):
        robot.primary.wait(5)
    with urlink.connect(f"replay://{tmp_path / 'run.urlog'}") as played:
        with pytest.raises(LocalError, match="is a recording"):
            played.script  # noqa: B018
        with pytest.raises(LocalError, match="is a recording"):
            played.set_speed_slider(0.5)


def test_bad_arguments() -> None:
    with pytest.raises(BadValue, match="require_enable='sometimes'"):
        urlink.connect("sim://", require_enable="sometimes")  # type: ignore[arg-type]
    with pytest.raises(BadValue, match="reverse_port=70000"):
        urlink.connect("sim://", reverse_port=70000)


def test_closing_is_quick_and_final(controller: Controller) -> None:
    robot = urlink.connect(controller.address)
    robot.script.send_line("stopj(1.0)")
    robot.close()
    robot.close()
    with pytest.raises((NotRunning, urlink.Closed)):
        robot.script.send_line("stopj(1.0)")

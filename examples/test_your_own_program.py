"""Tests of your own programs without a robot; run them with pytest.

`wait_until_stopped`, `fetch` and `WAVE` stand for your programs: the first watches a robot, the second moves it, and
the third is URScript. The tests pass them the address of a simulated controller instead of a robot, and cause faults.
The controller executes the URScript that it receives, so a test can check where the arm has moved.

    pytest examples/test_your_own_program.py
"""

import time
from collections.abc import Callable, Iterator

import pytest

import urlink
from urlink.packets import SafetyMode
from urlink.simulator import Controller, Still

HOME = (0.0, -1.57, 1.57, -1.57, -1.57, 0.0)

WAVE = """
def wave():
  movej([0, -1.57, 1.57, -1.57, -1.57, 0.5], a=1.4, v=1.05)
  set_standard_digital_out(1, True)
  movej([0, -1.57, 1.57, -1.57, -1.57, 0], a=1.4, v=1.05)
end
"""


def wait_until_stopped(address: str, timeout: float = 5.0) -> str:
    """Your program: wait until the robot is stopped, and return the reason."""
    with urlink.connect(address, silence=0.5) as robot:
        try:
            while True:
                state = robot.realtime.wait(timeout)
                if state.safety_mode not in (None, SafetyMode.NORMAL):
                    return state.safety_mode.name
        except urlink.RemoteError:
            return "NO CONNECTION"


def fetch(address: str, angle: float) -> str:
    """Your program: turn the tool joint, close the gripper, and return the result."""
    with urlink.connect(address) as robot:
        try:
            robot.motion.move_joints((*HOME[:5], angle), speed=1.0).wait(timeout=20)
            robot.io.set_digital_out(0, True)
        except urlink.SafetyStop as stop:
            return stop.cause
        return "fetched"


def until(condition: Callable[[], object], seconds: float = 5.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "the condition did not become true in time"
        time.sleep(0.005)


@pytest.fixture
def controller() -> Iterator[Controller]:
    with Controller("UR5e", "5.11") as controller:
        yield controller


def test_reports_reason_of_stop(controller: Controller) -> None:
    controller.faults.protective_stop()
    assert wait_until_stopped(controller.address) == "PROTECTIVE_STOP"


def test_survives_reboot_with_another_firmware(controller: Controller) -> None:
    # Times are in seconds since the controller was made. After the reboot, it has its initial modes again.
    controller.schedule("reboot=5.12@0.3", "emergency_stop@2")
    assert wait_until_stopped(controller.address) == "ROBOT_EMERGENCY_STOP"


def test_silent_robot_raises_link_timeout(controller: Controller) -> None:
    address = controller.address
    with urlink.connect(address) as robot:
        robot.realtime.wait()
        controller.faults.stall(30)
        with pytest.raises(urlink.LinkTimeout):
            for _ in robot.realtime.iterate(timeout=0.2):
                pass  # states that were already sent still arrive


def test_result_does_not_depend_on_packet_sizes(controller: Controller) -> None:
    controller.faults.split([7, 1460, 1])
    controller.faults.emergency_stop()
    assert wait_until_stopped(controller.address) == "ROBOT_EMERGENCY_STOP"


def test_turns_tool_and_closes_gripper(controller: Controller) -> None:
    assert fetch(controller.address, 0.3) == "fetched"
    assert controller.arm.setpoint.q[5] == pytest.approx(0.3)
    until(lambda: controller.signals.digital_outputs & 1)


def test_reports_stop_during_motion(controller: Controller) -> None:
    # A person presses the emergency stop while the arm is moving.
    controller.schedule(f"emergency_stop@{controller.cycle / controller.firmware.rate + 1.0}")
    assert fetch(controller.address, 3.0) == "robot emergency stop"


def test_urscript_runs_without_waiting() -> None:
    """Step a controller that is not started: it has no clock, so two seconds take milliseconds."""
    controller = Controller("UR5e", "5.11", motion=Still())
    controller.take(WAVE)
    furthest = 0.0
    for _ in range(5 * controller.firmware.rate):
        controller.step()
        furthest = max(furthest, controller.arm.setpoint.q[5])
    assert furthest == pytest.approx(0.5)
    assert controller.program_name is None
    assert controller.signals.digital_outputs == 1 << 1

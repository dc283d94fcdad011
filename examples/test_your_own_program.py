"""How to test a program of your own without a robot; run it with pytest.

`wait_until_stopped`, `fetch` and `WAVE` stand for your programs: one that watches a robot, one that moves it, and one
in URScript. The tests give them a simulated controller by its address, as they would give them a robot, and let things
go wrong. The controller runs the URScript that it is sent, so a test can look where the arm has gone.

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
    """Your program: wait for the robot to be stopped, and say why."""
    with urlink.connect(address, silence=0.5) as robot:
        try:
            while True:
                state = robot.realtime.wait(timeout)
                if state.safety_mode not in (None, SafetyMode.NORMAL):
                    return state.safety_mode.name
        except urlink.RemoteError:
            return "NO CONNECTION"


def fetch(address: str, angle: float) -> str:
    """Your program: turn the tool joint, close the gripper, and say how it went."""
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
        assert time.monotonic() < end, "it did not come about"
        time.sleep(0.005)


@pytest.fixture
def controller() -> Iterator[Controller]:
    with Controller("UR5e", "5.11") as controller:
        yield controller


def test_says_why_the_robot_stopped(controller: Controller) -> None:
    controller.faults.protective_stop()
    assert wait_until_stopped(controller.address) == "PROTECTIVE_STOP"


def test_survives_a_reboot_into_another_firmware(controller: Controller) -> None:
    # Times are seconds since the controller was made. It comes back with its modes as new.
    controller.schedule("reboot=5.12@0.3", "emergency_stop@2")
    assert wait_until_stopped(controller.address) == "ROBOT_EMERGENCY_STOP"


def test_notices_a_robot_that_is_connected_but_silent(controller: Controller) -> None:
    address = controller.address
    with urlink.connect(address) as robot:
        robot.realtime.wait()
        controller.faults.stall(30)
        with pytest.raises(urlink.LinkTimeout):
            for _ in robot.realtime.iterate(timeout=0.2):
                pass  # what was under way still comes


def test_does_not_mind_how_the_network_cuts_the_bytes(controller: Controller) -> None:
    controller.faults.split([7, 1460, 1])
    controller.faults.emergency_stop()
    assert wait_until_stopped(controller.address) == "ROBOT_EMERGENCY_STOP"


def test_turns_the_tool_and_closes_the_gripper(controller: Controller) -> None:
    assert fetch(controller.address, 0.3) == "fetched"
    assert controller.arm.setpoint.q[5] == pytest.approx(0.3)
    until(lambda: controller.signals.digital_outputs & 1)


def test_says_what_stopped_it_on_its_way(controller: Controller) -> None:
    # As if somebody had pressed the button once the arm is under way.
    controller.schedule(f"emergency_stop@{controller.cycle / controller.firmware.rate + 1.0}")
    assert fetch(controller.address, 3.0) == "robot emergency stop"


def test_urscript_in_no_time() -> None:
    """Not started, a controller has no clock: two seconds take milliseconds, and are the same each time."""
    controller = Controller("UR5e", "5.11", motion=Still())
    controller.take(WAVE)
    furthest = 0.0
    for _ in range(5 * controller.firmware.rate):
        controller.step()
        furthest = max(furthest, controller.arm.setpoint.q[5])
    assert furthest == pytest.approx(0.5)
    assert controller.program_name is None
    assert controller.signals.digital_outputs == 1 << 1

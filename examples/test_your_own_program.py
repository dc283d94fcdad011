"""How to test a program of your own without a robot; run it with pytest.

`wait_until_stopped` stands for your program. The tests give it a simulated controller by its address, as they would
give it a robot, and let things go wrong.

    pytest examples/test_your_own_program.py
"""

from collections.abc import Iterator

import pytest

import urlink
from urlink import SafetyMode
from urlink.simulator import Controller


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
            robot.realtime.wait(timeout=0.2)


def test_does_not_mind_how_the_network_cuts_the_bytes(controller: Controller) -> None:
    controller.faults.split([7, 1460, 1])
    controller.faults.emergency_stop()
    assert wait_until_stopped(controller.address) == "ROBOT_EMERGENCY_STOP"

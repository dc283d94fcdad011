"""Tests that the next connection of this process undoes a failed call that might still be executed.

The service of the simulated controller hangs, the call fails, the robot is closed, and the service continues.
"""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable, Iterator

import pytest

import urlink
from linkcore.errors import LinkError
from linkcore.net.undo import PendingUndos
from tests.waiting import until
from urlink.protocol.firmware import Firmware
from urlink.robot import peers_of
from urlink.session.address import RobotAddress, parse_address
from urlink.simulator import Controller, Still

pytestmark = pytest.mark.simulated_time

TIMEOUT = 20.0
#: Start position of the arm, in rad. The move from here takes about 15 s, so the arm cannot stop because it arrived.
HOME = (0.0, -1.57, 1.57, -1.57, -1.57, 0.0)
TEXT = f"movej({[1.5, *HOME[1:]]}, a=20, v=0.1)"
#: Time for which the service hangs, and time within which an answer must arrive, in s.
HANGS, ANSWER = 1.5, 0.4


@pytest.fixture
def controller() -> Iterator[Controller]:
    files = {"/p.urp": f"def p():\n  {TEXT}\nend\n"}
    before = set(threading.enumerate())
    with Controller("UR5e", "5.11", motion=Still(HOME), files=files) as controller:
        yield controller
    until(lambda: set(threading.enumerate()) <= before)


@pytest.fixture(autouse=True)
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("urlink.command.interpreter._REPLY", ANSWER)


def moves(controller: Controller) -> bool:
    return max(map(abs, controller.arm.setpoint.qd)) > 0.05


def is_owed(controller: Controller) -> bool:
    place = parse_address(controller.address)
    assert isinstance(place, RobotAddress)
    return PendingUndos.is_owed(*peers_of(place))


def play(controller: Controller, robot: urlink.Robot) -> None:
    robot.dashboard.load("/p.urp")
    controller.faults.stall(HANGS, "dashboard")
    robot.dashboard.send("play", ANSWER)


def execute(controller: Controller, robot: urlink.Robot) -> None:
    interpreter = robot.interpreter()
    controller.faults.stall(HANGS, "interpreter")
    interpreter.execute(TEXT)


def squeeze(controller: Controller, robot: urlink.Robot) -> None:
    robot.gripper.activate()
    robot.gripper._timeout = ANSWER
    controller.faults.stall(HANGS, "gripper")
    robot.gripper.set(POS=255, SPE=0, GTO=1)


def give_up(controller: Controller, call: Callable[[Controller, urlink.Robot], None]) -> None:
    """Connect, check that `call` fails, and close the robot."""
    with urlink.connect(controller.address, stale_after=20.0, silence=30.0) as robot:
        robot.motion.stop(wait=10)
        with pytest.raises(LinkError, match="it might still be executed"):
            call(controller, robot)
    until(lambda: not [each for each in threading.enumerate() if each.name.endswith("undo")])
    assert is_owed(controller)


def anew(controller: Controller) -> None:
    """Connect again, and close the robot."""
    urlink.connect(controller.address).close()


def anew_with_asyncio(controller: Controller) -> None:
    async def connect() -> None:
        async with urlink.connect_async(controller.address):
            pass

    asyncio.run(connect())


@pytest.mark.parametrize("connect", [anew, anew_with_asyncio])
def test_connect_stops_an_abandoned_program_first(
    controller: Controller, connect: Callable[[Controller], None]
) -> None:
    give_up(controller, play)
    until(lambda: moves(controller), TIMEOUT)
    urlink.connect(controller.address, read_only=True).close()
    assert moves(controller)
    assert is_owed(controller)
    connect(controller)
    assert not is_owed(controller)
    until(lambda: not moves(controller), TIMEOUT)
    assert controller.arm.setpoint.q[0] < 1.0


@pytest.mark.parametrize("connect", [anew, anew_with_asyncio])
def test_connect_discards_abandoned_statements(controller: Controller, connect: Callable[[Controller], None]) -> None:
    """The program that executes the statements has already ended, because the robot was closed."""
    give_up(controller, execute)
    connect(controller)
    assert not is_owed(controller)


@pytest.mark.slow
@pytest.mark.parametrize("connect", [anew, anew_with_asyncio])
def test_connect_stops_an_abandoned_gripper_move(controller: Controller, connect: Callable[[Controller], None]) -> None:
    give_up(controller, squeeze)
    until(lambda: controller.gripper.position > 20, TIMEOUT)
    connect(controller)
    assert not is_owed(controller)
    stopped = controller.gripper.position
    assert stopped < 250
    later = controller.time + 0.5
    until(lambda: controller.time > later, TIMEOUT)
    assert controller.gripper.position == stopped


@pytest.mark.slow
def test_connect_keeps_undoing_after_its_timeout(controller: Controller) -> None:
    give_up(controller, play)
    controller.faults.stall(5.0, "dashboard")
    with urlink.connect(controller.address, timeout=1.5) as robot:
        assert is_owed(controller)
        with pytest.raises(urlink.LinkTimeout, match="'power on' was not sent, because the abandoned command 'play'"):
            robot.dashboard.power_on()
        until(lambda: not is_owed(controller), TIMEOUT)
        until(lambda: not controller.is_running_program, TIMEOUT)


def test_newer_program_supersedes_an_abandoned_program(controller: Controller, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("urlink.command.channel._UNDO_TIMEOUT", 0.0)
    with urlink.connect(controller.address) as other:
        give_up(controller, play)
        controller.faults.stall(3.0, "dashboard")
        other.motion.move_joints(HOME)
        assert not is_owed(controller)


def dashboard_of(controller: Controller) -> urlink.Dashboard:
    return urlink.Dashboard(controller.host, controller.ports["dashboard"], lambda: Firmware(5, 11))


def gripper_of(controller: Controller) -> urlink.Gripper:
    return urlink.Gripper(controller.host, controller.ports["gripper"], timeout=ANSWER)


def give_up_alone(controller: Controller) -> None:
    """Check that `play` of a dashboard without a robot fails, and close the dashboard."""
    with dashboard_of(controller) as dashboard:
        dashboard.load("/p.urp")
        controller.faults.stall(HANGS, "dashboard")
        with pytest.raises(LinkError, match="it might still be executed"):
            dashboard.send("play", ANSWER)
    until(lambda: not [each for each in threading.enumerate() if each.name.endswith("undo")])
    assert is_owed(controller)
    until(lambda: moves(controller), TIMEOUT)


def dashboard_anew(controller: Controller) -> None:
    with dashboard_of(controller):
        until(lambda: not is_owed(controller), TIMEOUT)


@pytest.mark.parametrize("connect", [dashboard_anew, anew, anew_with_asyncio])
def test_next_client_undoes_the_play_of_a_standalone_dashboard(
    controller: Controller, connect: Callable[[Controller], None]
) -> None:
    give_up_alone(controller)
    connect(controller)
    assert not is_owed(controller)
    until(lambda: not moves(controller), TIMEOUT)
    assert controller.arm.setpoint.q[0] < 1.0


def test_standalone_dashboard_undoes_the_play_of_a_robot(controller: Controller) -> None:
    give_up(controller, play)
    until(lambda: moves(controller), TIMEOUT)
    dashboard_anew(controller)
    assert not is_owed(controller)
    until(lambda: not moves(controller), TIMEOUT)


def test_next_gripper_stops_the_move_of_a_standalone_gripper(controller: Controller) -> None:
    gripper = gripper_of(controller)
    gripper.activate()
    controller.faults.stall(HANGS, "gripper")
    with pytest.raises(LinkError, match="it might still be executed"):
        gripper.set(POS=255, SPE=0, GTO=1)
    gripper._disconnect()
    assert is_owed(controller)
    until(lambda: controller.gripper.position > 20, TIMEOUT)
    again = gripper_of(controller)
    until(lambda: not is_owed(controller), TIMEOUT)
    assert controller.gripper.position < 250
    again._disconnect()


def test_closed_robot_keeps_no_undo_for_its_simulator() -> None:
    with urlink.connect("sim://ur5e?firmware=5.11") as robot:
        place = parse_address(robot.controller.address)
        assert isinstance(place, RobotAddress)
        with pytest.raises(LinkError, match="it might still be executed"):
            execute(robot.controller, robot)
    assert not PendingUndos.is_owed(*peers_of(place))

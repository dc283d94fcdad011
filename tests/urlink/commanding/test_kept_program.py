"""A program that was given up during a stop is stopped after it: `play` at the pendant does not let it go on."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

import pytest

import urlink
from linkcore.handle import Handle
from tests.waiting import until
from urlink.simulator import Controller, Still

pytestmark = pytest.mark.simulated_time

HOME = (0.0, -1.57, 1.57, -1.57, -1.57, 0.0)
#: it takes some 15 s to get there
TARGET = [1.5, *HOME[1:]]
#: a program of the pendant's, as long
ELSEWHERE = f"def p():\n  movej({[*HOME[:5], 1.5]}, a=20, v=0.1)\nend\n"


@pytest.fixture(params=["3.5", "5.11"])
def controller(request: pytest.FixtureRequest) -> Iterator[Controller]:
    model = "UR5" if request.param == "3.5" else "UR5e"
    with Controller(model, request.param, motion=Still(HOME), files={"/p.urp": ELSEWHERE}) as controller:
        yield controller


@pytest.fixture
def robot(controller: Controller) -> Iterator[urlink.Robot]:
    with urlink.connect(controller.address) as robot:
        yield robot


def moves(controller: Controller) -> bool:
    return max(map(abs, controller.arm.setpoint.qd)) > 0.05


def move(robot: urlink.Robot) -> Handle:
    return robot.motion.move_joints(TARGET, speed=0.1)


def script(robot: urlink.Robot) -> Handle:
    return robot.script.run(f"def p():\n  movej({TARGET}, a=20, v=0.1)\nend\n")


def during(controller: Controller, robot: urlink.Robot, handle: Handle) -> None:
    controller.faults.protective_stop()
    robot.safety.wait_for_stop(5)
    handle.cancel()


def at_once(controller: Controller, robot: urlink.Robot, handle: Handle) -> None:
    """The stop is sent before that of the robot is known here, and arrives while it holds."""
    controller.faults.protective_stop()
    handle.cancel()
    robot.safety.wait_for_stop(5)


@pytest.mark.parametrize("give_up", [during, at_once])
@pytest.mark.parametrize("begin", [move, script])
def test_it_does_not_go_on(
    controller: Controller,
    robot: urlink.Robot,
    begin: Callable[[urlink.Robot], Handle],
    give_up: Callable[[Controller, urlink.Robot, Handle], None],
) -> None:
    handle = begin(robot)
    until(lambda: moves(controller))
    give_up(controller, robot, handle)
    assert handle.done
    until(lambda: not moves(controller))
    assert controller.program_name  # paused, and still there
    controller.faults.clear()
    until(lambda: not controller.program_name)
    controller.pendant.play()
    time.sleep(1.0)
    assert not moves(controller)


def test_a_script_that_nobody_gave_up_may_go_on(controller: Controller, robot: urlink.Robot) -> None:
    script(robot)
    until(lambda: moves(controller))
    controller.faults.protective_stop()
    robot.safety.wait_for_stop(5)
    controller.faults.clear()
    robot.safety.wait_enabled(5)
    time.sleep(1.0)
    controller.pendant.play()
    until(lambda: moves(controller))


@pytest.mark.parametrize("is_first", [False, True], ids=["programs first", "safety first"])
def test_a_program_that_the_pendant_began_instead_is_left_alone(
    controller: Controller, robot: urlink.Robot, is_first: bool
) -> None:
    """Whichever listens first to the interface that tells of both."""
    if is_first:
        robot.safety.wait_enabled(5)
    move(robot)
    until(lambda: moves(controller))
    controller.faults.protective_stop()
    robot.safety.wait_for_stop(5)
    controller.pendant.stop()
    controller.faults.clear()
    controller.pendant.load("/p.urp")
    controller.pendant.play()
    until(lambda: moves(controller))
    time.sleep(1.0)
    assert moves(controller)


def test_closing_after_a_stop_that_the_controller_goes_on_from_stops_it(
    controller: Controller, robot: urlink.Robot
) -> None:
    """As after a safety mode that is in no list, which stops nothing."""
    move(robot)
    until(lambda: moves(controller))
    controller.faults.safeguard_stop(resumes=True)
    robot.safety.wait_for_stop(5)
    controller.faults.clear()
    robot.close()
    until(lambda: not controller.program_name, 5.0)
    time.sleep(1.0)
    assert not moves(controller)


@pytest.mark.parametrize(("timeout", "longest"), [(2.0, 0.31), (0.0, 0.001)])
def test_closing_during_a_stop_waits_for_three_states(
    controller: Controller, robot: urlink.Robot, timeout: float, longest: float
) -> None:
    move(robot)
    until(lambda: moves(controller))
    controller.faults.protective_stop()
    robot.safety.wait_for_stop(5)
    began = time.monotonic()
    robot._control.made._programs.close(timeout)  # type: ignore[union-attr]
    assert time.monotonic() - began <= longest

"""Simulated time runs without the garbage collector, so commands must leave no reference cycles in the simulator."""

from __future__ import annotations

import time
from collections.abc import Callable

import pytest

import urlink
from linkcore.errors import Cancelled
from tests.garbage import no_garbage

HOME, AWAY = [0.0, -1.6, 1.6, -1.6, -1.6, 0.0], [0.1, -1.5, 1.5, -1.6, -1.6, 0.1]


def move(robot: urlink.Robot) -> None:
    for q in (AWAY, HOME):
        robot.motion.move_joints(q).wait()


def set_output(robot: urlink.Robot) -> None:
    robot.io.set_digital_out(0, True)
    time.sleep(2.0)  # so that the connection for settings is closed


def cancel(robot: urlink.Robot) -> None:
    handle = robot.motion.move_joints(AWAY, speed=0.2)
    robot.realtime.wait_until(lambda state: bool(state.qd_target.any()))
    handle.cancel()
    with pytest.raises(Cancelled):
        handle.wait()
    robot.realtime.wait_until(lambda state: not state.qd_target.any())


def servo(robot: urlink.Robot) -> None:
    with robot.motion.servo() as block:
        q = robot.realtime.wait(1.0).q_target
        for _ in range(20):
            robot.realtime.wait(1.0)
            block.send(q)


def read_variables(robot: urlink.Robot) -> None:
    with robot.rtde.outputs("actual_q") as outputs:
        outputs.wait(1.0)


def reconnect(robot: urlink.Robot) -> None:
    robot.realtime._connection.abort()
    time.sleep(2.0)
    robot.realtime.wait(1.0)


def secondary(robot: urlink.Robot) -> None:
    robot.script.run("sec on():\n  set_digital_out(1, True)\nend", wait=True)


@pytest.mark.parametrize("command", [move, set_output, cancel, servo, read_variables, reconnect, secondary])
@pytest.mark.parametrize("firmware", ["3.15", "5.11"])
def test_command_leaves_no_garbage_in_simulated_time(command: Callable[[urlink.Robot], None], firmware: str) -> None:
    with urlink.simulated_time(0), urlink.connect(f"sim://?firmware={firmware}") as robot:
        robot.realtime.wait(1.0)
        for _ in range(2):
            command(robot)
        time.sleep(2.0)
        with no_garbage():
            command(robot)
            time.sleep(2.0)

"""What a client of a world asks for: one function for each name of `drawn.ASKED`.

Each begins a motion and returns its handle, enters a block and returns it, or returns None for a call that is over.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from typing import Any

import numpy as np

import urlink

from .drawn import Ask

__all__ = ["BEGIN", "WATCHDOG"]

#: s: the least watchdog that is drawn.
WATCHDOG = 0.3
READY = np.array([0.0, -1.57, 1.57, -1.57, -1.57, 0.0])


def _move_joints(robot: Any, ask: Ask, block: contextlib.ExitStack) -> Any:
    return robot.motion.move_joints(READY + 0.4 * ask.size, speed=0.2 + ask.size)


def _move_linear(robot: Any, ask: Ask, block: contextlib.ExitStack) -> Any:
    pose = robot.realtime.wait(2.0).tool_vector_actual.copy()
    pose[2] += 0.1 * (ask.size - 0.5)
    return robot.motion.move_linear(pose, speed=0.05 + 0.1 * ask.size)


def _path(robot: Any, ask: Ask, block: contextlib.ExitStack) -> Any:
    return robot.motion.path([urlink.Joint(READY + 0.2), urlink.Joint(READY + 0.3 * ask.size)], speed=0.3)


def _speed_joints(robot: Any, ask: Ask, block: contextlib.ExitStack) -> Any:
    return robot.motion.speed_joints([0.3 * (ask.size - 0.5)] * 6, duration=0.5 * ask.size + 0.05)


def _speed_linear(robot: Any, ask: Ask, block: contextlib.ExitStack) -> Any:
    return robot.motion.speed_linear([0, 0, 0.1 * (ask.size - 0.5), 0, 0, 0], duration=0.5 * ask.size + 0.05)


def _follow(robot: Any, ask: Ask, block: contextlib.ExitStack, **how: Any) -> Any:
    q = robot.realtime.wait(2.0).q_target
    way = np.array([q, q + 0.1 * ask.size, q + 0.2 * ask.size])
    return robot.motion.follow(urlink.Trajectory.from_arrays([0.0, 0.5, 1.0], way), watchdog=WATCHDOG, **how)


def _servo(robot: Any, ask: Ask, block: contextlib.ExitStack, **how: Any) -> Any:
    servo = block.enter_context(robot.motion.servo(watchdog=WATCHDOG, **how))
    q = robot.realtime.wait(2.0).q_target
    for step in range(int(100 * ask.size)):
        servo.send(q + 0.0005 * step)
        robot.realtime.wait(2.0)
    return servo


def _jog(robot: Any, ask: Ask, block: contextlib.ExitStack) -> Any:
    jog = block.enter_context(robot.motion.jog("base", timeout=0.5, watchdog=WATCHDOG))
    jog.move([0, 0, 0.1 * (ask.size - 0.5), 0, 0, 0])
    time.sleep(ask.size)
    return jog


def _force_mode(robot: Any, ask: Ask, block: contextlib.ExitStack) -> Any:
    down = [0, 0, 1, 0, 0, 0], [0, 0, -10.0, 0, 0, 0], [0.05] * 6
    return block.enter_context(robot.motion.force_mode("base", *down, watchdog=WATCHDOG))


def _script(robot: Any, ask: Ask, block: contextlib.ExitStack) -> Any:
    return robot.script.run(f"def p():\n  movej({(READY + 0.2 * ask.size).tolist()}, v=0.5)\nend\n")


def _output(robot: Any, ask: Ask, block: contextlib.ExitStack) -> Any:
    robot.io.set_digital_out(0, ask.size > 0.5)
    return None


BEGIN: dict[str, Callable[[Any, Ask, contextlib.ExitStack], Any]] = {
    "move_joints": _move_joints,
    "move_linear": _move_linear,
    "path": _path,
    "speed_joints": _speed_joints,
    "speed_linear": _speed_linear,
    "follow": _follow,
    "follow_rtde": lambda robot, ask, block: _follow(robot, ask, block, link="rtde"),
    "servo": _servo,
    "servo_rtde": lambda robot, ask, block: _servo(robot, ask, block, link="rtde"),
    "jog": _jog,
    "force_mode": _force_mode,
    "script": _script,
    "output": _output,
}

"""Requests of the clients of a world: one function for each name of `world.ASKED`.

A function for a motion starts it and returns its handle. A function for a block returns the block before it is entered.
A function for a call returns when the call is complete.
"""

from __future__ import annotations

import itertools
import threading
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any

import numpy as np

import urlink
from linkcore.handle import Handle
from urlink.motion.teaching import Taught, TaughtPoint
from urlink_compat.rtde_control import RTDEControlInterface
from urlink_compat.urx import Robot as UrxRobot

from .world import Ask

__all__ = ["BLOCK", "CALL", "DURING", "MOTION", "PENDANT_PROGRAM", "URX", "UR_RTDE", "WATCHDOG"]

#: Shortest drawn watchdog, in s.
WATCHDOG = 0.3
READY = np.array([0.0, -1.57, 1.57, -1.57, -1.57, 0.0])
#: Path of the program that is saved on the pendant.
PENDANT_PROGRAM = "/programs/pick.urp"
_WAIT = 2.0
_DOWN = [0, 0, 1, 0, 0, 0], [0, 0, -10.0, 0, 0, 0], [0.05] * 6


def _raised(robot: Any, metres: float) -> Any:
    """Return the pose of the tool, raised by a distance."""
    pose = robot.realtime.wait(_WAIT).tool_vector_actual.copy()
    pose[2] += metres
    return pose


def _circle(robot: urlink.Robot, ask: Ask) -> Handle:
    via, to = _raised(robot, 0.02 + 0.03 * ask.size), _raised(robot, 0.0)
    via[1] += 0.03
    to[1] += 0.06
    return robot.motion.move_circular(via, to, speed=0.1 + 0.2 * ask.size)


def _path(robot: urlink.Robot, ask: Ask) -> Handle:
    ways = [urlink.Joint(READY + 0.1), urlink.Joint(READY + 0.2 * ask.size)]
    return robot.motion.path(ways, speed=0.3)


def _taught(robot: urlink.Robot, ask: Ask) -> Handle:
    state = robot.realtime.wait(_WAIT)
    ways = (state.q_actual + far * ask.size for far in (0.1, 0.2))
    return Taught(TaughtPoint(q, state.tool_vector_actual) for q in ways).play(robot)


def _speed(robot: urlink.Robot, ask: Ask, **how: Any) -> Handle:
    held = {"duration": 0.5 + ask.size, **how} if how else {"duration": 0.45 * ask.size + 0.05}
    return robot.motion.speed_joints([0.3 * (ask.size - 0.5)] * 6, **held)


def _follow(robot: urlink.Robot, ask: Ask, **how: Any) -> Handle:
    q = robot.realtime.wait(_WAIT).q_target
    way = np.array([q, q + 0.1 * ask.size, q + 0.2 * ask.size])
    return robot.motion.follow(urlink.Trajectory.from_arrays([0.0, 0.5, 1.0], way), watchdog=WATCHDOG, **how)


MOTION: dict[str, Callable[[Any, Ask], Handle]] = {
    "move_joints": lambda robot, ask: robot.motion.move_joints(READY + 0.3 * ask.size, speed=0.3 + ask.size),
    "move_linear": lambda robot, ask: robot.motion.move_linear(
        _raised(robot, 0.1 * (ask.size - 0.5)), speed=0.05 + 0.2 * ask.size
    ),
    "move_circular": _circle,
    "path": _path,
    "taught": _taught,
    "speed_joints": _speed,
    "speed_linear": lambda robot, ask: robot.motion.speed_linear(
        [0, 0, 0.1 * (ask.size - 0.5), 0, 0, 0], duration=0.5 * ask.size + 0.05
    ),
    "speed_held": lambda robot, ask: _speed(robot, ask, link="reverse"),
    "speed_held_rtde": lambda robot, ask: _speed(robot, ask, link="rtde"),
    "stop": lambda robot, ask: robot.motion.stop(),
    "until_contact": lambda robot, ask: robot.motion.until_contact([0, 0, -1], 0.05, distance=0.01 + 0.05 * ask.size),
    "follow": _follow,
    "follow_rtde": lambda robot, ask: _follow(robot, ask, link="rtde"),
    "follow_low_bandwidth": lambda robot, ask: _follow(robot, ask, low_bandwidth=True),
    "script": lambda robot, ask: robot.script.run(
        f"def p():\n  movej({(READY + 0.2 * ask.size).tolist()}, v=0.5)\n  textmsg(1)\nend\n"
    ),
    "misspelt_script": lambda robot, ask: robot.script.run(f"def p():\n  movj({READY.tolist()})\nend\n"),
    "failing_script": lambda robot, ask: robot.script.run(
        f"def p():\n  movej({(READY + 0.2 * ask.size).tolist()}, v=0.5)\n  movej([1, 2], v=0.5)\nend\n"
    ),
    "statements": lambda robot, ask: robot.script.run(
        f"movej({(READY + 0.2 * ask.size).tolist()}, v=0.5)\nsleep({ask.patience})\nmovej({READY.tolist()}, v=0.5)"
    ),
}


BLOCK: dict[str, Callable[[Any, Ask], AbstractContextManager[Any]]] = {
    "servo": lambda robot, ask: robot.motion.servo(watchdog=WATCHDOG),
    "servo_rtde": lambda robot, ask: robot.motion.servo(watchdog=WATCHDOG, link="rtde"),
    "servo_filtered": lambda robot, ask: robot.motion.servo(target_filter="jerk_limited", watchdog=WATCHDOG),
    "stream": lambda robot, ask: robot.motion.stream(buffer=0.1 + ask.size, watchdog=WATCHDOG),
    "stream_rtde": lambda robot, ask: robot.motion.stream(buffer=0.1 + ask.size, watchdog=WATCHDOG, link="rtde"),
    "jog": lambda robot, ask: robot.motion.jog("base", timeout=0.5, watchdog=WATCHDOG),
    "jog_rtde": lambda robot, ask: robot.motion.jog("joints", timeout=0.5, watchdog=WATCHDOG, link="rtde"),
    "force_mode": lambda robot, ask: robot.motion.force_mode("base", *_DOWN, watchdog=WATCHDOG),
    "force_mode_rtde": lambda robot, ask: robot.motion.force_mode("tool", *_DOWN, watchdog=WATCHDOG, link="rtde"),
    "torque": lambda robot, ask: robot.motion.torque(watchdog=WATCHDOG),
    "impedance": lambda robot, ask: robot.motion.impedance(watchdog=WATCHDOG),
    "torque_rtde": lambda robot, ask: robot.motion.torque(watchdog=WATCHDOG, link="rtde"),
    "freedrive": lambda robot, ask: robot.freedrive(watchdog=WATCHDOG),
    "freedrive_rtde": lambda robot, ask: robot.freedrive(watchdog=WATCHDOG, link="rtde"),
    "teach": lambda robot, ask: robot.teach(digital_input=0, watchdog=WATCHDOG),
    "interpreter": lambda robot, ask: robot.interpreter(start_timeout=3.0, finish_timeout=5.0),
}


def _servo(robot: Any, servo: Any, ask: Ask) -> None:
    q = robot.realtime.wait(_WAIT).q_target
    for step in range(int(60 * ask.size)):
        servo.send(q + 0.0005 * step)
        robot.realtime.wait(_WAIT)


def _servo_filtered(robot: Any, servo: Any, ask: Ask) -> None:
    servo.send(robot.realtime.wait(_WAIT).q_target + 0.2 * ask.size)
    time.sleep(0.3 * ask.size)


def _stream(robot: Any, stream: Any, ask: Ask) -> None:
    q = robot.realtime.wait(_WAIT).q_target
    speed = 0.3 * ask.size
    for step in range(1, int(20 * ask.size) + 1):  # the stream may run dry at any of these points
        stream.append(urlink.TrajectoryPoint(q + 0.05 * step * speed, 0.05 + stream.end, [speed] * 6), wait=2.0)
        if step == 10:
            stream.clear()
            stream.wait_until_dry(3.0)
            q = robot.realtime.wait(_WAIT).q_target - 0.55 * speed
        if step == 15:
            stream.replace(stream.time, [urlink.TrajectoryPoint(q + 0.6 * speed, 1.0 + stream.end, [0.0] * 6)])
            stream.wait_until_dry(3.0)
            break
        time.sleep(0.1 * ask.patience)


def _jog(robot: Any, jog: Any, ask: Ask) -> None:
    jog.move([0, 0, 0.1 * (ask.size - 0.5), 0, 0, 0])
    time.sleep(0.5 * ask.size)


def _force(robot: Any, pressing: Any, ask: Ask) -> None:
    pressing.set_wrench([0, 0, -20.0 * ask.size, 0, 0, 0])
    time.sleep(0.2 * ask.size)


def _torque(robot: Any, torque: Any, ask: Ask) -> None:
    for _ in range(int(30 * ask.size)):
        torque.send([0, 0, 0, 0, 0, 0.5 * ask.size])
        robot.realtime.wait(_WAIT)


def _impedance(robot: Any, impedance: Any, ask: Ask) -> None:
    q = robot.realtime.wait(_WAIT).q_actual
    for step in range(int(10 * ask.size)):
        impedance.send(q + 0.02 * step * ask.size)
        if step == 5:
            impedance.set_gains(300.0 * ask.size, ask.size)
        time.sleep(0.1 * ask.patience)


def _nothing(robot: Any, block: Any, ask: Ask) -> None:
    time.sleep(0.2 * ask.size)


def _teach(robot: Any, teaching: Any, ask: Ask) -> None:
    time.sleep(0.2 * ask.size)
    teaching.record()


def _interpreter(robot: Any, interpreter: Any, ask: Ask) -> None:
    interpreter.execute(f"movej({(READY + 0.2 * ask.size).tolist()}, v=0.5)")
    if ask.size > 0.5:
        interpreter.execute(f"movej({READY.tolist()}, v=0.5)", wait=5.0)
    elif ask.size > 0.3:
        interpreter.abort()


#: Actions within the block.
DURING: dict[str, Callable[[Any, Any, Ask], None]] = {
    "servo": _servo,
    "servo_rtde": _servo,
    "servo_filtered": _servo_filtered,
    "stream": _stream,
    "stream_rtde": _stream,
    "jog": _jog,
    "jog_rtde": _jog,
    "force_mode": _force,
    "force_mode_rtde": _force,
    "torque": _torque,
    "impedance": _impedance,
    "torque_rtde": _torque,
    "freedrive": _nothing,
    "freedrive_rtde": _nothing,
    "teach": _teach,
    "interpreter": _interpreter,
}


def _gripper(robot: urlink.Robot, ask: Ask) -> None:
    robot.gripper.activate(timeout=5.0)
    robot.gripper.move(int(255 * ask.size), wait=3.0 if ask.size > 0.5 else False)


def _registers(robot: urlink.Robot, ask: Ask) -> None:
    registers = robot.registers
    registers.write_integer(24 + int(23 * ask.size), 7)
    registers.write_float(24 + int(23 * ask.size), ask.size)
    registers.read_integer(3)


def _inputs(robot: urlink.Robot, ask: Ask) -> None:
    with robot.rtde.inputs("speed_slider_fraction", "standard_digital_output") as inputs:
        for _ in range(3):
            inputs.send(speed_slider_fraction=0.5 + 0.5 * ask.size, standard_digital_output={1: True})
            time.sleep(ask.patience)


def _outputs(robot: urlink.Robot, ask: Ask) -> None:
    with robot.rtde.outputs("actual_q", "output_int_register_47", frequency=25 + 100 * ask.size) as stream:
        for _ in itertools.islice(stream.iterate(timeout=_WAIT), int(5 * ask.size)):
            pass


def _subscribe(robot: urlink.Robot, ask: Ask) -> None:
    seen = threading.Event()
    with robot.realtime.subscribe(lambda state: seen.set(), policy=urlink.drop_oldest(2), deadline=0.05):
        seen.wait(ask.patience)


def _iterate(robot: urlink.Robot, ask: Ask) -> None:
    for _ in itertools.islice(robot.primary.iterate(timeout=_WAIT), int(1 + 3 * ask.size)):
        pass


def _cancel_current(robot: urlink.Robot, ask: Ask) -> None:
    motion = robot.motion.current
    if motion is not None:
        motion.cancel()


CALL: dict[str, Callable[[Any, Ask], object]] = {
    "output": lambda robot, ask: robot.io.set_digital_out(0, ask.size > 0.5),
    "analog_output": lambda robot, ask: robot.io.set_analog_out(0, ask.size),
    "slider": lambda robot, ask: robot.set_speed_slider(0.2 + 0.8 * ask.size),
    "payload": lambda robot, ask: robot.set_payload(ask.size),
    "tcp": lambda robot, ask: robot.set_tcp([0, 0, 0.1 * ask.size, 0, 0, 0]),
    "zero_force_sensor": lambda robot, ask: robot.zero_force_sensor(),
    "popup": lambda robot, ask: robot.popup("hello"),
    "secondary_script": lambda robot, ask: robot.script.run("sec s():\n  set_flag(1, True)\nend", wait=_WAIT),
    "line": lambda robot, ask: robot.script.send_line(f"movej({(READY + 0.1 * ask.size).tolist()}, v=0.5)"),
    "gripper": _gripper,
    "registers": _registers,
    "inputs": _inputs,
    "outputs": _outputs,
    "who_holds": lambda robot, ask: robot.rtde.who_holds(),
    "subscribe": _subscribe,
    "iterate": _iterate,
    "wait_state": lambda robot, ask: robot.realtime.wait(ask.patience),
    "enable": lambda robot, ask: robot.safety.enable(),
    "wait_until_clear": lambda robot, ask: robot.safety.wait_until_clear(1.0),
    "cancel_current": _cancel_current,
    "close": lambda robot, ask: robot.close(),
    "load": lambda robot, ask: robot.dashboard.load(PENDANT_PROGRAM),
    "play": lambda robot, ask: robot.dashboard.play(),
    "pause": lambda robot, ask: robot.dashboard.pause(),
    "stop_program": lambda robot, ask: robot.dashboard.stop(),
    "power_off": lambda robot, ask: robot.dashboard.power_off(),
    "start": lambda robot, ask: robot.dashboard.start(5.0),
    "unlock": lambda robot, ask: robot.dashboard.unlock_protective_stop(),
    "dashboard_popup": lambda robot, ask: robot.dashboard.popup("hello"),
    "program_state": lambda robot, ask: robot.dashboard.program_state(),
}

UR_RTDE: dict[str, Callable[[RTDEControlInterface, Ask, bool], object]] = {
    "moveJ": lambda robot, ask, lasts: robot.moveJ((READY + 0.3 * ask.size).tolist(), asynchronous=lasts),
    "moveL": lambda robot, ask, lasts: robot.moveL(_raised(robot._robot, 0.05 * ask.size).tolist(), asynchronous=lasts),
    "servoJ": lambda robot, ask, lasts: [
        robot.servoJ((READY + 0.001 * step).tolist(), 0, 0, 0.01, 0.03, 300) for step in range(int(20 * ask.size))
    ],
    "speedJ": lambda robot, ask, lasts: robot.speedJ([0.1 * ask.size] * 6, 0.5, ask.patience),
    "jogStart": lambda robot, ask, lasts: robot.jogStart([0, 0, 0.05 * ask.size, 0, 0, 0]),
    "forceMode": lambda robot, ask, lasts: robot.forceMode([0.0] * 6, _DOWN[0], _DOWN[1], 2, _DOWN[2]),
    "freedriveMode": lambda robot, ask, lasts: robot.freedriveMode(),
    "stopJ": lambda robot, ask, lasts: robot.stopJ(),
    "sendScript": lambda robot, ask, lasts: robot.sendCustomScript(f"movej({READY.tolist()}, v=0.5)"),
}
URX: dict[str, Callable[[UrxRobot, Ask, bool], object]] = {
    "movej": lambda robot, ask, lasts: robot.movej((READY + 0.3 * ask.size).tolist(), 1.0, 0.5, wait=not lasts),
    "movel": lambda robot, ask, lasts: robot.movel([0, 0, 0.05 * ask.size, 0, 0, 0], 0.5, 0.1, not lasts, True),
    "movejs": lambda robot, ask, lasts: robot.movejs(
        [(READY + 0.1).tolist(), (READY + 0.2 * ask.size).tolist()], 1.0, 0.5, 0.0, not lasts
    ),
    "speedj": lambda robot, ask, lasts: robot.speedj([0.1 * ask.size] * 6, 0.5, ask.patience + 0.05),
    "translate": lambda robot, ask, lasts: robot.translate([0, 0, 0.02], 0.5, 0.1, not lasts),
    "stopj": lambda robot, ask, lasts: robot.stopj(),
    "getj": lambda robot, ask, lasts: robot.getj(True),
}

"""Test that a forked process neither uses nor disturbs the connections of its parent."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests import platforms
from urlink.simulator import Controller

pytestmark = [
    pytest.mark.real_time,
    pytest.mark.slow,
    platforms.needs_fork,
]

#: Program that connects, opens every connection, moves the arm and forks. It prints the error that each call of the
#: child raises, and the phase in which the motion of the parent ends.
_PROGRAM = """
import os, sys, time, warnings
import urlink

warnings.simplefilter("ignore")
robot = urlink.connect(sys.argv[1], reverse_peer="127.0.0.1")
with robot:
    q = robot.realtime.wait().q_actual
    robot.primary.start()
    robot.dashboard.robot_mode()
    robot.gripper.activate()
    robot.registers.write_integer(24, 1)
    outputs = robot.rtde.outputs("timestamp")
    outputs.wait()
    goal = q.copy()
    goal[0] += 0.3
    servo = robot.motion.servo()
    with servo:
        servo.send(q)
    motion = robot.motion.move_joints(goal, speed=0.5)
    child = os.fork()
    if child == 0:
        calls = {
            "dashboard": lambda: robot.dashboard.robot_mode(),
            "gripper": lambda: robot.gripper.position(),
            "interpreter": lambda: robot.interpreter().__enter__(),
            "realtime": lambda: robot.realtime.wait(2.0),
            "subscribe": lambda: robot.primary.subscribe(print),
            "rtde": lambda: outputs.wait(2.0),
            "register": lambda: robot.registers.write_integer(24, 2),
            "move": lambda: robot.motion.move_joints(q),
            "servo": lambda: robot.motion.servo().__enter__(),
            "stop": lambda: robot.motion.stop(),
            "script": lambda: robot.script.send_line("set_digital_out(1, True)"),
            "output": lambda: robot.io.set_digital_out(2, True),
        }
        for name, call in calls.items():
            began = time.monotonic()
            try:
                result = repr(call())
            except Exception as error:
                result = type(error).__name__
            took = time.monotonic() - began
            print(name, result[:60], "late" if took > 1.0 else "at once", flush=True)
        motion.cancel()
        robot.close()
        os._exit(0)
    os.waitpid(child, 0)
    motion.wait(20.0)
    robot.dashboard.robot_mode()
    robot.registers.write_integer(24, 3)
    with robot.motion.servo() as servo:
        servo.send(goal)
    lost = [robot.realtime.stats.reconnects, robot.primary.stats.reconnects, outputs.stats.reconnects]
    print("parent", motion.phase.value, lost, flush=True)
    outputs.close()
"""


def test_forked_process_cannot_use_the_parents_connections() -> None:
    with Controller("UR5e", "5.11") as controller:
        command = [sys.executable, "-c", _PROGRAM, controller.address]
        root = Path(__file__).resolve().parents[2]
        process = subprocess.run(command, capture_output=True, text=True, timeout=100, cwd=root)
    *child, parent = process.stdout.splitlines() or [""]
    assert parent == "parent done [0, 0, 0]", process.stderr
    assert len(child) == 12
    assert [line for line in child if not line.endswith("LocalError at once")] == []

"""A box is grasped and put elsewhere, by a urlink program and by a ur_rtde program."""

from __future__ import annotations

import socket
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

import urlink
from packages.mujoco.tests.placing import DOWN
from urlink.simulator import Controller
from urlink_mujoco import MujocoWorld

WEIGHT = 0.3 * 9.81


def test_urlink_program_moves_box(table: Path) -> None:
    with urlink.simulated_time(1):
        controller = Controller("UR5e", noise=False)
        world = MujocoWorld(table, controller)
        with controller, urlink.connect(controller.address) as robot:

            def go(x: float, y: float, z: float) -> None:
                robot.motion.move_linear([x, y, z, *DOWN], speed=0.25, acceleration=1.0, wait=True)

            robot.gripper.activate()
            go(-0.45, 0.2, 0.15)
            go(-0.45, 0.2, 0.025)
            held = robot.gripper.close()
            assert held.object_detected
            assert held.opening() == pytest.approx(0.05, abs=0.003)
            go(-0.45, 0.2, 0.15)
            assert world.pose("box")[2] == pytest.approx(0.15, abs=0.005)
            assert controller.arm.sample.force[2] == pytest.approx(-WEIGHT, abs=0.5)
            go(-0.55, -0.2, 0.15)
            go(-0.55, -0.2, 0.026)
            assert not robot.gripper.open().object_detected
            go(-0.55, -0.2, 0.15)
        assert world.pose("box")[:3] == pytest.approx((-0.55, -0.2, 0.025), abs=0.003)
        assert controller.arm.sample.force[2] == pytest.approx(0.0, abs=0.01)
        assert not controller.gripper.holds_object


def test_gripper_detects_removal_of_object(table: Path) -> None:
    controller = Controller("UR5e", noise=False)
    world = MujocoWorld(table, controller)
    controller.gripper.exchange({"ACT": 1}, [])
    controller.step(1250)
    # Almost as wide as the box, which falls until the fingers hold it.
    controller.gripper.exchange({"GTO": 1, "POS": 95, "SPE": 255, "FOR": 100}, [])
    controller.step(250)
    world.place("box", (*controller.arm.sample.pose_target[:3], *controller.arm.sample.pose_target[3:]))
    controller.gripper.exchange({"POS": 255}, [])
    controller.step(100)
    held = controller.gripper.holds_object
    world.place("box", (0.0, 0.5, 0.025, 0.0, 0.0, 0.0))
    controller.step(250)
    assert (held, controller.gripper.holds_object) == (True, False)
    assert controller.gripper.position == 255


#: Run in a separate process, because threads of ur_rtde survive a failure.
PROGRAM = """
import socket, sys
from math import pi
from rtde_control import RTDEControlInterface
host = sys.argv[1]
gripper = socket.create_connection((host, 63352), timeout=30)
def ask(line):
    gripper.sendall(line.encode() + b"\\n")
    return gripper.recv(100).decode().split()[-1]
def until(name, wanted):
    import time
    end = time.monotonic() + 30
    while ask("GET " + name) not in wanted:
        assert time.monotonic() < end, name
        time.sleep(0.05)
ask("SET ACT 1"); until("STA", ["3"]); ask("SET GTO 1")
arm = RTDEControlInterface(host, 500.0)
def go(*place):
    assert arm.moveL([*place, pi, 0, 0], 0.25, 1.0)
go(-.45, .2, .15); go(-.45, .2, .025)
ask("SET POS 255"); until("OBJ", ["2"])
go(-.45, .2, .15); go(-.55, -.2, .15); go(-.55, -.2, .026)
ask("SET POS 0"); until("OBJ", ["3"])
go(-.55, -.2, .15)
arm.stopScript()
"""


def _free_host() -> str:
    """Return an address of this computer on which no controller listens."""
    for last in range(20, 250):
        host = f"127.0.7.{last}"
        try:
            with socket.socket() as probe:
                probe.bind((host, 30004))
        except OSError:
            continue
        return host
    raise AssertionError("no address is free")


@pytest.mark.real_time
@pytest.mark.skipif(
    find_spec("rtde_control") is None, reason="ur_rtde is not installed; there is no wheel for this Python"
)
@pytest.mark.skipif(sys.platform != "linux", reason="needs more than one loopback address")
def test_ur_rtde_program_moves_box(table: Path) -> None:
    host = _free_host()
    controller = Controller("UR5e", "5.11", noise=False, host=host, ports="standard")
    world = MujocoWorld(table, controller)
    with controller:
        done = subprocess.run([sys.executable, "-c", PROGRAM, host], timeout=200, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert world.pose("box")[:3] == pytest.approx((-0.55, -0.2, 0.025), abs=0.003)

"""The simulated gripper with pyrobotiqur 0.2.2, a third-party client of the Robotiq URCap."""

from __future__ import annotations

import pytest

from urlink.simulator import Controller, Still

pyrobotiqur = pytest.importorskip("pyrobotiqur", reason="pyrobotiqur is not installed; nox -s interop installs it")

pytestmark = pytest.mark.real_time


def test_pyrobotiqur_activates_grips_and_releases() -> None:
    with Controller("UR5e", "5.11", motion=Still()) as controller:
        client = pyrobotiqur.RobotiqGripper(controller.host, controller.ports["gripper"])
        with client as gripper:
            gripper.activate()
            assert controller.gripper.is_active
            assert gripper.move(100, speed=255, force=10)[0] == 100
            controller.gripper.place(width=0.03)
            position, stopped = gripper.move(255, speed=255)
            assert (position, int(stopped.value)) == (165, 2)
            assert controller.gripper.holds_object
            position, stopped = gripper.move(0, speed=255)
            assert (position, int(stopped.value)) == (0, 3)
            assert gripper.get_fault() == 0

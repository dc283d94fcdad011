"""Arms whose fingers are at a place, and what they feel."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from urlink.arm.kinematics import Arm
from urlink.simulator import HOME, Controller, Still
from urlink_mujoco import MujocoWorld

TCP = (0.0, 0.0, 0.145, 0.0, 0.0, 0.0)
#: The tool points down.
DOWN = (math.pi, 0.0, 0.0)


def arm_at(
    place: Sequence[float], *, turned: Sequence[float] = DOWN, firmware: str = "5.11", closed: bool = True
) -> Controller:
    """The controller of an arm whose fingers are at a place, closed or open."""
    arm = Arm("UR5e")
    q = arm.inverse([*place, *turned], tcp=TCP, near=HOME)
    controller = Controller(arm.model.name, firmware, noise=False, motion=Still(np.asarray(q).tolist()))
    controller.gripper.exchange({"ACT": 1, "GTO": 1}, [])
    controller.step(1250)  # as long as activating takes
    if closed:
        controller.gripper.exchange({"GTO": 1, "POS": 255, "SPE": 255, "FOR": 100}, [])
        controller.step(500)
    return controller


def forces(controller: Controller, cycles: int) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    """The force at the TCP in each of the coming cycles, (cycles, 6)."""
    rows = []
    for _ in range(cycles):
        controller.step()
        rows.append(controller.arm.sample.force)
    return np.array(rows)


def settled(world: MujocoWorld) -> None:
    """Let everything come to rest: half a second."""
    for arm in world.arms.values():
        arm.controller.step(250)

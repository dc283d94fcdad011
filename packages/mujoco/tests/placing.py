"""Arms with their fingers at a given position, and the forces on them."""

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
    """Return the controller of an arm whose fingers are at a position, closed or open."""
    arm = Arm("UR5e")
    q = arm.inverse([*place, *turned], tcp=TCP, near=HOME)
    controller = Controller(arm.model.name, firmware, noise=False, motion=Still(np.asarray(q).tolist()))
    controller.gripper.exchange({"ACT": 1, "GTO": 1}, [])
    controller.step(1250)  # duration of the activation
    if closed:
        controller.gripper.exchange({"GTO": 1, "POS": 255, "SPE": 255, "FOR": 100}, [])
        controller.step(500)
    return controller


def forces(controller: Controller, cycles: int) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    """Return the force at the TCP in each of the coming cycles, shape (cycles, 6)."""
    rows = []
    for _ in range(cycles):
        controller.step()
        rows.append(controller.arm.sample.force)
    return np.array(rows)


def settled(world: MujocoWorld) -> None:
    """Wait half a second until everything is at rest."""
    for arm in world.arms.values():
        arm.controller.step(250)

"""Simulated arms among bodies that MuJoCo moves.

    controller = Controller("UR5e", stepped=True)
    world = MujocoWorld("table.xml", controller)

`urlink sim --scene table.xml` and `sim://ur5e?scene=table.xml` find this package by an entry point.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

# Before urlink: the warning about another distribution named linkcore must come before an import fails.
import linkcore  # noqa: F401

from .arms import MountedArm
from .world import MujocoWorld

if TYPE_CHECKING:
    from urlink.simulator import Controller

__all__ = ["MountedArm", "MujocoWorld", "mount"]


def mount(path: str | os.PathLike[str], controller: Controller) -> MountedArm:
    """Place the arm of a controller in the scene of a file; `Controller(scene=path)` calls this.

    Raises:
        LocalError: If MuJoCo cannot read the file.
    """
    return MujocoWorld(path, controller).arms["arm"]

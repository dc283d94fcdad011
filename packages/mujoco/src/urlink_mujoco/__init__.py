"""Simulated arms among bodies, which MuJoCo moves.

    controller = Controller("UR5e", stepped=True)
    world = MujocoWorld("table.xml", controller)

`urlink sim --scene table.xml` and `sim://ur5e?scene=table.xml` find it by an entry point.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

# Before urlink, so that a warning about another distribution of that name comes before an import fails.
import linkcore  # noqa: F401

from .arms import MountedArm
from .world import MujocoWorld

if TYPE_CHECKING:
    from urlink.simulator import Controller

__all__ = ["MountedArm", "MujocoWorld", "mount"]


def mount(path: str | os.PathLike[str], controller: Controller) -> MountedArm:
    """The arm of a controller in the scene of a file, as `Controller(scene=path)` asks for it.

    Raises:
        LocalError: MuJoCo cannot read the file.
    """
    return MujocoWorld(path, controller).arms["arm"]

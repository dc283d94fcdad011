"""World of bodies around a simulated arm. An adapter or your own object computes it.

Contacts (`surroundings`) are forces at fixed places. A scene has bodies that move, and a state. Once in each cycle of
the controller, the scene receives the position of the arm and returns the forces on the arm. The controller moves the
arm in every mode. In freedrive, force mode and under direct torque, the arm yields to the forces that the scene
returned a cycle ago.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple, Protocol

from linkcore.errors import BadValue, LocalError
from linkcore.names import plugins

from .setpoint_sources import Setpoint

#: Entry-point group in which a distribution names its function that opens a scene, by the suffix of the file.
_GROUP = "urlink.scenes"
#: Adapters of this project: suffix -> distribution.
_DISTRIBUTIONS = {"xml": "urlink-mujoco"}


class Reaction(NamedTuple):
    """Forces of a scene on an arm.

    Attributes:
        wrench: Wrench on the tool and the bodies that it carries, shape (6,): forces in N along the axes of the base
            frame, and torques in Nm about the TCP.
        torques: Joint torques from contacts with the links before the flange, shape (6,), in Nm; without the wrench.
    """

    wrench: Sequence[float]
    torques: Sequence[float] = (0.0,) * 6


class Scene(Protocol):
    """Bodies around one arm."""

    def advance(self, setpoint: Setpoint, pose: Sequence[float], seconds: float) -> Reaction:
        """Advance the scene by one cycle, and return the forces on the arm at its end.

        The thread that owns the controller calls this.

        Args:
            setpoint: Joint targets at the end of the cycle. The targets at its beginning are those of the previous
                call.
            pose: Pose of the TCP at the end of the cycle in the base frame, shape (6,), in m and rotation vector in
                rad.
            seconds: Duration of the cycle, in s.
        """


def open_scene(path: str | os.PathLike[str], controller: object) -> Scene:
    """Return the scene of a file, with the arm of a `Controller` in it.

    The adapter that is installed for the suffix of the file opens it.

    Raises:
        LocalError: If no such adapter is installed, or it cannot open the file.
        BadValue: If there is no such file.
    """
    place = Path(path)
    if not place.is_file():
        raise BadValue(f"scene={os.fspath(path)!r} is not a file; expected a scene such as table.xml")
    ending = place.suffix.removeprefix(".").lower()
    installed = plugins(_GROUP)
    if ending not in installed:
        if ending in _DISTRIBUTIONS:
            raise LocalError(
                f"no adapter for the scene {place.name} is installed; use pip install {_DISTRIBUTIONS[ending]}"
            )
        known = ", ".join(f".{each}" for each in sorted({*installed, *_DISTRIBUTIONS}))
        raise LocalError(f"no adapter for the scene {place.name} is installed; expected one of {known}")
    mount: Callable[[Path, object], Scene] = installed[ending].load()
    return mount(place, controller)

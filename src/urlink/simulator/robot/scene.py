"""Protocol for a scene: moving bodies around a simulated arm, which an adapter or your own object simulates.

The objects in `surroundings` stay at fixed positions. A scene has a state, and its bodies can move. Once in each cycle
of the controller, the scene receives the position of the arm, and returns the forces on the arm. The scene never moves
the arm; the controller does so in every mode. In freedrive, force mode and under direct torque, the arm yields to the
forces that the scene returned in the previous cycle.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple, Protocol

from linkcore.errors import BadValue, LocalError
from linkcore.names import plugins

from .setpoint_sources import Setpoint

#: Entry-point group for functions that open a scene. The name of an entry point is the suffix of the file.
_GROUP = "urlink.scenes"
#: Adapters of this project: suffix of the file -> name of the distribution.
_DISTRIBUTIONS = {"xml": "urlink-mujoco"}


class Reaction(NamedTuple):
    """Forces that a scene exerts on an arm.

    Attributes:
        wrench: Wrench on the tool and on the bodies that the tool carries, shape (6,): forces in N along the axes of
            the base frame, and torques in Nm about the TCP.
        torques: Joint torques that contacts with the links cause, shape (6,), in Nm. They do not include the torques
            that `wrench` causes.
    """

    wrench: Sequence[float]
    torques: Sequence[float] = (0.0,) * 6


class Scene(Protocol):
    """Bodies around one arm."""

    def advance(self, setpoint: Setpoint, pose: Sequence[float], seconds: float) -> Reaction:
        """Advance the scene by one cycle, and return the forces on the arm at the end of the cycle.

        The thread that owns the controller calls this.

        Args:
            setpoint: Joint targets at the end of the cycle. The targets at the beginning of the cycle are the targets
                of the previous call.
            pose: Pose of the TCP at the end of the cycle in the base frame, shape (6,), in m and rotation vector in
                rad.
            seconds: Duration of the cycle, in s.
        """


def open_scene(path: str | os.PathLike[str], controller: object) -> Scene:
    """Open a file, and return a scene that contains the bodies of the file and the arm of a `Controller`.

    The adapter that is installed for the suffix of the file opens it.

    Raises:
        LocalError: If no such adapter is installed, or the adapter cannot open the file.
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

"""A world of bodies in which a simulated arm stands, by something that computes them: an adapter, or your own object.

Contacts (`surroundings`) are forces of a place; a scene has things that move, and a state. Once in each cycle of the
controller it receives where the arm goes and returns what acts on it. The controller leads the arm in every mode: in
freedrive, force mode and under direct torque it yields to what the scene returned a cycle ago.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple, Protocol

from linkcore.errors import BadValue, LocalError
from linkcore.names import plugins

from .setpoint_sources import Setpoint

#: The group of entry points in which a distribution names what opens a scene, by the ending of its file.
_GROUP = "urlink.scenes"
#: The adapters of this project: ending -> distribution.
_DISTRIBUTIONS = {"xml": "urlink-mujoco"}


class Reaction(NamedTuple):
    """What a scene does to an arm.

    Attributes:
        wrench: (6,) on the tool, what it carries included: N in the directions of the base frame, Nm about the TCP.
        torques: (6,) Nm on the joints by what touches the links before the flange; without the wrench.
    """

    wrench: Sequence[float]
    torques: Sequence[float] = (0.0,) * 6


class Scene(Protocol):
    """Bodies around one arm."""

    def advance(self, setpoint: Setpoint, pose: Sequence[float], seconds: float) -> Reaction:
        """Let a cycle pass, and say what acts on the arm at its end. Called by the thread that owns the controller.

        Args:
            setpoint: the joints at the end of the cycle; at its beginning they were at those of the call before.
            pose: (6,) of the TCP there, in the base frame, m and rotation vector in rad.
            seconds: of the cycle.
        """


def open_scene(path: str | os.PathLike[str], controller: object) -> Scene:
    """The scene of a file, with the arm of a `Controller` in it, by the adapter that is installed for its ending.

    Raises:
        LocalError: no such adapter is installed, or it cannot open the file.
        BadValue: there is no such file.
    """
    place = Path(path)
    if not place.is_file():
        raise BadValue(f"scene={os.fspath(path)!r} is no file; expected one such as table.xml")
    ending = place.suffix.removeprefix(".").lower()
    installed = plugins(_GROUP)
    if ending not in installed:
        if ending in _DISTRIBUTIONS:
            raise LocalError(
                f"nothing that opens a scene such as {place.name} is installed: pip install {_DISTRIBUTIONS[ending]}"
            )
        known = ", ".join(f".{each}" for each in sorted({*installed, *_DISTRIBUTIONS}))
        raise LocalError(f"nothing that opens a scene such as {place.name} is installed; expected one of {known}")
    mount: Callable[[Path, object], Scene] = installed[ending].load()
    return mount(place, controller)

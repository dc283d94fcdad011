"""The largest values that a tool or a joint may be asked for, and checks of poses and tool speeds.

A value beyond them has the wrong unit: millimetres or degrees. They hold for every arm; what one arm can do is less,
and is checked where the arm is known (`urlink.models`, `urlink.kinematics`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from linkcore.arguments import check_number, other_unit
from linkcore.errors import BadValue

from .parameters import number
from .vectors import FloatArray, six


class Bound(NamedTuple):
    """The range of a quantity.

    Attributes:
        most, least: the largest and the smallest value.
        unit: of both.
    """

    most: float
    unit: str
    least: float = 0.0

    def check(self, value: object, name: str, most: float | None = None, limit_of: str = "") -> float:
        """A number within the range.

        Args:
            value: what the caller was given.
            name: what the caller calls it.
            most: a smaller largest value; None for `Bound.most`.
            limit_of: whose that is, for the message.

        Raises:
            BadValue: see `linkcore.arguments.check_number`.
        """
        return check_number(value, name, self.least, self.most if most is None else most, self.unit, limit_of)


#: Slower and weaker than this is a mistake.
_LEAST = 1e-3

#: The largest limit of the tool's speed that the safety configuration takes (the vendor's manuals, Robot limits). Data
#: sheets have typical speeds of 1 to 2 m/s, which are not limits.
TOOL_SPEED = Bound(5.0, "m/s", _LEAST)
#: A guess: more than any wrist turns, at 6.3 rad/s.
TOOL_TURN = Bound(number("largest_tool_turn"), "rad/s", _LEAST)
#: A guess: the largest acceleration of a joint that a controller reports, at 1 m from the joint.
TOOL_ACCELERATION = Bound(number("largest_tool_acceleration"), "m/s²", _LEAST)
#: The wrists of UR3 and UR3e, the fastest joints in `urlink.models`.
JOINT_SPEED = Bound(math.tau, "rad/s", _LEAST)
#: The largest in `urlink.models`, which controllers report.
JOINT_ACCELERATION = Bound(40.0, "rad/s²", _LEAST)
#: From the base: the longest arm reaches 1.75 m, with a tool of `TOOL_LENGTH` not 10.
POSITION = Bound(10.0, "m")
#: A rotation vector of more than one turn is one in degrees. With room for a turn that was rounded to 6.2832.
TURN = Bound(math.tau + _LEAST, "rad")
#: From the flange to the TCP. A guess: no tool is longer.
TOOL_LENGTH = Bound(number("largest_tool"), "m")
#: From the flange to the centre of gravity of a payload. A guess: none is further.
COG = Bound(number("furthest_payload"), "m")


def check_pose(values: ArrayLike, name: str, furthest: Bound = POSITION) -> FloatArray:
    """A pose as (6,) numbers, read-only: m, and a rotation vector in rad.

    Args:
        values: what the caller was given.
        name: what the caller calls it.
        furthest: distance from the origin.

    Raises:
        BadValue: not six finite numbers, too far away, or a rotation vector of more than one turn.
    """
    pose = six(values, name)
    check_length(pose[:3].tolist(), f"the position in {name}", furthest)
    check_length(pose[3:].tolist(), f"the rotation vector in {name}", TURN)
    return pose


def check_speeds(values: ArrayLike, name: str) -> FloatArray:
    """A velocity of a tool as (6,) numbers, read-only: m/s along, and rad/s about three axes.

    Raises:
        BadValue: not six finite numbers, or beyond `TOOL_SPEED` or `TOOL_TURN`.
    """
    speeds = six(values, name)
    check_length(speeds[:3].tolist(), f"the speed in {name}", TOOL_SPEED)
    check_length(speeds[3:].tolist(), f"the turn in {name}", TOOL_TURN)
    return speeds


def check_rotations(poses: FloatArray, name: str) -> None:
    """Raise `BadValue` if the rotation vector of one of the poses (n, 6) is of more than one turn."""
    turns = np.sqrt(np.einsum("ij,ij->i", poses[:, 3:], poses[:, 3:]))
    if (turns > TURN.most).any():
        row = int(np.argmax(turns > TURN.most))
        check_length(poses[row, 3:].tolist(), f"the rotation vector in row {row} of {name}", TURN)


def check_length(vector: Sequence[float], name: str, bound: Bound) -> None:
    """Raise `BadValue` if a vector is longer than its bound."""
    length = math.hypot(*vector)
    if length > bound.most:
        raise BadValue(
            f"{name} has the length {length:g} {bound.unit}; expected at most {bound.most:.4g} {bound.unit}"
            f"{other_unit(length, bound.unit, bound.least, bound.most)}"
        )

"""Largest allowed values for a tool or a joint, and checks of poses and tool speeds.

A larger value probably has the wrong unit, such as millimetres or degrees. The bounds apply to every arm. The limits of
a particular arm are smaller. Other code checks them when it knows the arm (`urlink.models`, `urlink.kinematics`).
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
    """Range of a quantity.

    Attributes:
        most: Largest value.
        unit: Unit of both values.
        least: Smallest value.
    """

    most: float
    unit: str
    least: float = 0.0

    def check(self, value: object, name: str, most: float | None = None, limit_of: str = "") -> float:
        """Check that a number is within the range, and return it.

        Args:
            value: Value from the caller.
            name: Name of the argument, used in the message.
            most: Smaller upper limit to use instead of `Bound.most`; None for `Bound.most`.
            limit_of: Object that has the smaller limit, such as "a UR5e"; used in the message.

        Raises:
            BadValue: See `linkcore.arguments.check_number`.
        """
        return check_number(value, name, self.least, self.most if most is None else most, self.unit, limit_of)


#: Smallest allowed speed or acceleration. A smaller value is an error.
_LEAST = 1e-3

#: Largest tool speed limit that the safety configuration accepts, according to the vendor's manuals (Robot limits).
#: The speeds of 1 to 2 m/s in data sheets are typical speeds and not limits.
TOOL_SPEED = Bound(5.0, "m/s", _LEAST)
#: Largest rotation speed of a tool. Assumed: no tool turns faster, because wrists turn at 6.3 rad/s at most.
TOOL_TURN = Bound(number("largest_tool_turn"), "rad/s", _LEAST)
#: Largest acceleration of a tool. Assumed: the largest joint acceleration that a controller reports, at 1 m from the
#: joint.
TOOL_ACCELERATION = Bound(number("largest_tool_acceleration"), "m/s²", _LEAST)
#: Largest speed of a joint. The wrists of UR3 and UR3e, the fastest joints in `urlink.models`, have this speed.
JOINT_SPEED = Bound(math.tau, "rad/s", _LEAST)
#: Largest acceleration of a joint in `urlink.models`, as controllers report it.
JOINT_ACCELERATION = Bound(40.0, "rad/s²", _LEAST)
#: Largest distance of a position from the base. The longest arm reaches 1.75 m, so no arm reaches 10 m, even with a
#: tool of `TOOL_LENGTH`.
POSITION = Bound(10.0, "m")
#: Largest length of a rotation vector: one turn. A longer vector is probably in degrees. The limit includes a margin
#: for a full turn that was rounded to 6.2832.
TURN = Bound(math.tau + _LEAST, "rad")
#: Largest distance from the flange to the TCP. Assumed: no tool is longer.
TOOL_LENGTH = Bound(number("largest_tool"), "m")
#: Largest distance from the flange to the centre of gravity of a payload. Assumed: no payload is further away.
COG = Bound(number("furthest_payload"), "m")


def check_pose(values: ArrayLike, name: str, furthest: Bound = POSITION) -> FloatArray:
    """Check a pose in m and rad, and return it as a read-only array, shape (6,).

    Args:
        values: Pose from the caller: position and rotation vector.
        name: Name of the argument, used in the message.
        furthest: Largest allowed distance of the position from the origin.

    Raises:
        BadValue: If `values` is not six finite numbers, the position is too far away, or the rotation vector is longer
            than one turn.
    """
    pose = six(values, name)
    check_length(pose[:3].tolist(), f"the position in {name}", furthest)
    check_length(pose[3:].tolist(), f"the rotation vector in {name}", TURN)
    return pose


def check_speeds(values: ArrayLike, name: str) -> FloatArray:
    """Check a tool velocity in m/s and rad/s, and return it as a read-only array, shape (6,).

    Raises:
        BadValue: If `values` is not six finite numbers, or exceeds `TOOL_SPEED` or `TOOL_TURN`.
    """
    speeds = six(values, name)
    check_length(speeds[:3].tolist(), f"the speed in {name}", TOOL_SPEED)
    check_length(speeds[3:].tolist(), f"the turn in {name}", TOOL_TURN)
    return speeds


def check_rotations(poses: FloatArray, name: str) -> None:
    """Raise `BadValue` if the rotation vector of one of the poses, shape (n, 6), is longer than one turn."""
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

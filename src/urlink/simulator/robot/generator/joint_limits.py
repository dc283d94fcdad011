"""Arm with its tool, limits that a controller enforces, and checks of arguments.

A controller makes a protective stop in four cases: a joint would leave its range, a joint would exceed its maximum
speed, an acceleration is so high that no arm can follow, or a pose is out of reach. The tolerances are assumed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import repeat
from operator import le, mul, sub
from typing import NamedTuple

import numpy as np

from linkcore.errors import BadValue
from urlink.arm.kinematics import Arm, Unreachable
from urlink.arm.models import Model
from urlink.arm.parameters import number
from urlink.arm.poses import compose
from urlink.arm.vectors import JOINTS, FloatArray

from ..setpoint_sources import Setpoint

# Fraction by which a set-point may exceed the maximum speed of a joint. Rounding, and coarse interpolation in clients,
# cause such differences.
_TOLERANCE = number("joint_speed_tolerance")
# Factor by which an acceleration must exceed the maximum acceleration of a joint to count as impossible. Smaller
# accelerations are accepted.
_HARDEST = 10.0
# Distance in rad by which rounding can move a position out of the range of a joint.
_ROUNDING = 1e-9


#: Codes of the vendor's list, with which a controller reports a violation: number and argument. The list is evidence
#: for the meaning of each code. Which code a real controller sends for which violation is assumed.
DEVIATES, OUT_OF_RANGE, SINGULAR, SUDDEN = (153, 0), (150, 0), (154, 0), (204, 1)
#: Argument of C191, the code of a joint that is too fast, for the base. The next joints have the next arguments.
TOO_FAST_BASE = 32


class LimitViolation(Exception):
    """Error: a set-point exceeds a limit of the arm. The text of the error names the limit.

    The controller then makes a protective stop.

    Args:
        text: Text of the error.
        code: Number and argument of the code that the controller reports.

    Attributes:
        code: See the argument `code`.
    """

    def __init__(self, text: str, code: tuple[int, int] = DEVIATES) -> None:
        super().__init__(text)
        self.code = code


class OutOfReach(Exception):
    """Error: the target of a motion function is out of reach."""


class JointLimits:
    """Joint limits of one model, as plain numbers.

    Attributes:
        speed, acceleration: Limits of each joint, in rad/s and rad/s².
        allowed_speed: Speed limits including the tolerance, in rad/s.
    """

    def __init__(self, model: Model) -> None:
        self.speed: list[float] = model.max_speed.tolist()
        self.acceleration: list[float] = model.max_acceleration.tolist()
        self.allowed_speed = [(1.0 + _TOLERANCE) * speed for speed in self.speed]
        self._hardest = [_HARDEST * limit for limit in self.acceleration]
        self._lowest: list[float] = (model.position_limits[:, 0] - _ROUNDING).tolist()
        self._highest: list[float] = (model.position_limits[:, 1] + _ROUNDING).tolist()

    def check(self, last: Setpoint, new: Setpoint, seconds: float) -> None:
        """Raise if a set-point is too fast, differs too much from the last set-point, or is further out of range.

        A motion back into the range is allowed, because an arm might be out of range after braking.

        Raises:
            LimitViolation: If the set-point exceeds a limit.
        """
        # This check runs in each cycle. Python loops would need a tenth of the cycle's processor time, so `map` is
        # used. The condition is also true for NaN.
        if not all(map(le, map(abs, new.qd), self.allowed_speed)):
            raise self._too_fast(new.qd)
        if not all(map(le, map(abs, map(sub, new.qd, last.qd)), map(mul, self._hardest, repeat(seconds)))):
            raise LimitViolation(self._too_sudden(last.qd, new.qd, seconds), SUDDEN)
        if not any(new.qd) and new.q != last.q:
            # At the end of a path, the joints are corrected to the exact end. This correction is small, unless the path
            # ends in a singularity.
            way = [(b - a) / seconds for a, b in zip(last.q, new.q, strict=True)]
            if any(abs(speed) > allowed for speed, allowed in zip(way, self.allowed_speed, strict=True)):
                raise self._too_fast(way)
        if not (all(map(le, self._lowest, new.q)) and all(map(le, new.q, self._highest))):
            self._check_range(last, new)

    def count_allowed(self, last: Setpoint, course: FloatArray, seconds: float) -> int:
        """Return how many of the set-points, counted from the first one, `check` would accept.

        Args:
            last: Set-point before them.
            course: Positions, speeds and accelerations of moving joints, shape (3, n, 6).
            seconds: Duration of a cycle, in s.
        """
        q, qd, _ = course
        change = np.abs(np.diff(qd, axis=0, prepend=[last.qd]))
        allowed = (
            (np.abs(qd) <= self.allowed_speed)
            & (change <= [limit * seconds for limit in self._hardest])
            & (q >= self._lowest)
            & (q <= self._highest)
        ).all(axis=1) & qd.any(axis=1)
        return len(allowed) if allowed.all() else int(np.argmin(allowed))

    def check_target(self, q: Sequence[float]) -> None:
        """Raise if target positions of the joints are out of range.

        Raises:
            LimitViolation: If the target of a joint is out of range.
        """
        if all(map(le, self._lowest, q)) and all(map(le, q, self._highest)):
            return
        for joint, position, lowest, highest in zip(JOINTS, q, self._lowest, self._highest, strict=True):
            if not lowest <= position <= highest:
                raise LimitViolation(f"{joint}: the target of {position:.4f} rad is out of range", OUT_OF_RANGE)

    def _too_fast(self, qd: Sequence[float]) -> LimitViolation:
        ratios = [abs(speed) / limit for speed, limit in zip(qd, self.speed, strict=True)]
        joint = ratios.index(max(ratios))
        text = f"{JOINTS[joint]}: a speed of {qd[joint]:.3f} rad/s; at most {self.speed[joint]:.3f} is allowed"
        return LimitViolation(text, (191, TOO_FAST_BASE + joint))

    def _too_sudden(self, old: Sequence[float], new: Sequence[float], seconds: float) -> str:
        changes = [(b - a) / seconds for a, b in zip(old, new, strict=True)]
        ratios = [abs(change) / limit for change, limit in zip(changes, self.acceleration, strict=True)]
        joint = ratios.index(max(ratios))
        return f"{JOINTS[joint]}: an acceleration of {changes[joint]:.0f} rad/s², which no arm can follow"

    def _check_range(self, last: Setpoint, new: Setpoint) -> None:
        for joint, old, q, lowest, highest in zip(JOINTS, last.q, new.q, self._lowest, self._highest, strict=True):
            if (q > highest and q > old) or (q < lowest and q < old):
                raise LimitViolation(f"{joint}: a position of {q:.4f} rad is out of range", OUT_OF_RANGE)


class ArmWithTool(NamedTuple):
    """Arm with its joint limits and its tool.

    Attributes:
        kinematics, limits: Kinematics and joint limits of the arm.
        tcp: TCP in the flange frame, shape (6,), in m and rad.
    """

    kinematics: Arm
    limits: JointLimits
    tcp: list[float]

    def pose(self, q: Sequence[float]) -> list[float]:
        """Return the pose of the TCP at joint positions, in m and rad."""
        pose: list[float] = self.kinematics.forward(q, self.tcp).tolist()
        return pose

    def velocity(self, q: Sequence[float], qd: Sequence[float]) -> FloatArray:
        """Return the speed of the TCP at joint positions and speeds, in m/s and rad/s."""
        return self.kinematics.velocity(q, qd, self.tcp)

    def joints(self, pose: Sequence[float], near: Sequence[float]) -> list[float]:
        """Return the joint positions at which the TCP has this pose.

        If there are several solutions, the solution that is closest to `near` is returned.

        Raises:
            LimitViolation: If the pose is out of reach.
        """
        try:
            found: list[float] = self.kinematics.inverse(pose, near, self.tcp, is_limited=False).tolist()
        except Unreachable:
            text = f"the arm does not reach the pose {[round(number, 4) for number in pose]}"
            raise LimitViolation(text, SINGULAR) from None
        return found

    def setpoint(self, pose: Sequence[float], last: Setpoint, seconds: float) -> Setpoint:
        """Return the set-point for a pose of the TCP, one cycle after `last`.

        The speeds and accelerations are computed from the differences to `last`.

        Raises:
            LimitViolation: If the pose is out of reach.
        """
        q = self.joints(pose, last.q)
        qd = [(new - old) / seconds for new, old in zip(q, last.q, strict=True)]
        return Setpoint(q, qd, [(new - old) / seconds for new, old in zip(qd, last.qd, strict=True)])


def moved(pose: Sequence[float], step: Sequence[float]) -> list[float]:
    """Return a pose after a translation and a rotation (`step`) in the base frame, in m and rad."""
    place = [a + b for a, b in zip(pose[:3], step[:3], strict=True)]
    if not any(step[3:]):
        return [*place, *pose[3:]]
    turned: list[float] = compose((0.0, 0.0, 0.0, *step[3:]), (0.0, 0.0, 0.0, *pose[3:])).tolist()
    return place + turned[3:]


def checked(values: Sequence[float], what: str) -> list[float]:
    """Return six finite numbers as a list of floats.

    Raises:
        BadValue: If `values` is not six finite numbers.
    """
    numbers = list(map(float, values))
    if len(numbers) != 6 or not all(map(math.isfinite, numbers)):
        raise BadValue(f"{what} must be six finite numbers, not {values!r}")
    return numbers


def positive(value: float, what: str) -> float:
    """Return a finite number above zero.

    Raises:
        BadValue: If `value` is not such a number.
    """
    if not 0.0 < value < math.inf:
        raise BadValue(f"{what} must be a finite number above zero, not {value!r}")
    return float(value)

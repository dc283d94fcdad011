"""Kinds of actions: the meaning of their numbers, and conversion to joint positions and back."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from gymnasium.spaces import Box
from numpy.typing import NDArray

from urlink import BadValue, Unreachable
from urlink.arm import poses
from urlink.arm.kinematics import Arm

__all__ = ["KINDS", "Actions", "Blocked", "Steps", "within"]

Floats = NDArray[np.float64]
Numbers32 = NDArray[np.float32]

#: Kinds of actions, and how many numbers each has for the arm.
KINDS = {"joints": 6, "joint_deltas": 6, "pose_deltas": 6, "position_deltas": 3}
#: Largest angle, in rad, by which a change of the pose may turn a joint. A larger angle means a singularity or another
#: posture, because the largest step turns the tool by less.
_LEAP = 0.5
#: Distance in m from the faces of the box to which targets are clipped. Session limits refuse positions closer than
#: 1 mm.
_INSIDE = 0.002


class Blocked(Exception):
    """The arm keeps its target, because an action cannot be executed. `reason` is the word for `info["blocked"]`."""

    def __init__(self, reason: str) -> None:
        super().__init__(reason)
        self.reason = reason


def within(numbers: Floats, low: Floats | float, high: Floats | float) -> Floats:
    """Return the numbers, clipped to the bounds, without the overhead of `numpy.clip`."""
    return np.minimum(np.maximum(numbers, low), high)


@dataclass(frozen=True)
class Steps:
    """Largest change of the target by one action.

    Attributes:
        move: Translation of the tool along each axis, in m.
        turn: Rotation of the tool about each axis, in rad.
        joint: Angle of each joint, in rad.

    Raises:
        BadValue: If a step is not above 0, or is above 0.1 m or 0.3 rad.
    """

    move: float = 0.01
    turn: float = 0.05
    joint: float = 0.03

    def __post_init__(self) -> None:
        for name, most, unit in (("move", 0.1, "m"), ("turn", 0.3, "rad"), ("joint", 0.3, "rad")):
            value = getattr(self, name)
            if not (isinstance(value, (int, float)) and 0.0 < value <= most):
                raise BadValue(f"Steps({name}={value!r}); expected a number above 0 and at most {most:g} {unit}")


class Actions:
    """Actions of one kind for an arm.

    Args:
        kind: Kind of action, one of `KINDS`.
        arm: Kinematics of the arm.
        steps: Largest change of the target by one action.
        box: Lowest and highest corner of the box to which the position of the tool is clipped, in m in the base frame;
            None for no box. Only the kinds `pose_deltas` and `position_deltas` are clipped.

    Attributes:
        space: Gymnasium space of the numbers for the arm. The kind `joints` is in rad; all other kinds are fractions of
            a step, from -1 to 1.
        tcp: Pose of the TCP in the flange frame, shape (6,).

    Raises:
        BadValue: If the kind does not exist.
    """

    def __init__(self, kind: str, arm: Arm, steps: Steps, box: Any = None) -> None:
        if kind not in KINDS:
            raise BadValue(f"action={kind!r}; expected one of {', '.join(KINDS)}")
        self.kind = kind
        self.tcp: Floats = np.zeros(6)
        self._arm = arm
        self._steps = steps
        self._low, self._high = arm.position_limits.T
        self._corners: Floats | None = None if box is None else np.array(box) + np.array([[_INSIDE], [-_INSIDE]])
        self._scale: Floats = {
            "joints": np.ones(6),
            "joint_deltas": np.full(6, steps.joint),
            "pose_deltas": np.array([steps.move] * 3 + [steps.turn] * 3),
            "position_deltas": np.full(3, steps.move),
        }[kind]
        if kind == "joints":
            # Gymnasium warns about infinite bounds; some joints have no limits.
            low, high = np.maximum(self._low, -2.0 * np.pi), np.minimum(self._high, 2.0 * np.pi)
            self.space = Box(low.astype(np.float32), high.astype(np.float32), dtype=np.float32)
        else:
            self.space = Box(-1.0, 1.0, (KINDS[kind],), np.float32)
        #: bounds of the space with the type of the numbers, because conversions take time in each step
        self._least: Floats = self.space.low.astype(np.float64)
        self._most: Floats = self.space.high.astype(np.float64)

    def target(self, numbers: Floats, commanded: Floats) -> tuple[Floats, Numbers32]:
        """Return the joint positions to which an action moves the target, and the action that this motion is.

        The second differs from `numbers` if the target is clipped at a step, at a limit of a joint, or at the box.

        Args:
            numbers: Numbers of the action, within `space`.
            commanded: Current target of the joints, shape (6,), in rad.

        Returns:
            Joint positions, shape (6,), in rad, and the numbers of the executed action.

        Raises:
            Blocked: If the tool cannot reach the target, or a joint would have to jump.
        """
        if self.kind in ("joints", "joint_deltas"):
            away = numbers - commanded if self.kind == "joints" else self._scale * numbers
            away = within(away, -self._steps.joint, self._steps.joint)
            joints = within(commanded + away, self._low, self._high)
            done = joints if self.kind == "joints" else (joints - commanded) / self._scale
            return joints, self._within(done)
        pose = self._arm.forward(commanded, self.tcp)
        change = self._scale * numbers
        moved = pose[:3] + change[:3]
        if self._corners is not None:
            # A tool that is outside, for example after it was guided by hand, may come back, but not move further out.
            low, high = self._corners
            moved = within(moved, np.minimum(low, pose[:3]), np.maximum(high, pose[:3]))
        turned = pose[3:]
        if self.kind == "pose_deltas" and change[3:].any():
            turned = poses.compose((0.0, 0.0, 0.0, *change[3:]), (0.0, 0.0, 0.0, *pose[3:]))[3:]
        try:
            q: Floats = self._arm.inverse(np.concatenate((moved, turned)), commanded, self.tcp)
        except Unreachable:
            raise Blocked("reach") from None
        if np.abs(q - commanded).max() > _LEAP:
            raise Blocked("singularity")
        change[:3] = moved - pose[:3]
        return q, self._within(change / self._scale)

    def _within(self, numbers: Floats) -> Numbers32:
        clipped: Numbers32 = within(numbers, self._least, self._most).astype(np.float32)
        return clipped

    def between(self, q: Floats, pose: Floats, later_q: Floats, later_pose: Floats) -> Numbers32:
        """Return the action that moves an arm from one posture to another, clipped to `space`.

        Args:
            q, later_q: Joint positions before and after, shape (6,), in rad.
            pose, later_pose: Poses of the tool in the base frame before and after, shape (6,).
        """
        if self.kind == "joints":
            change = later_q
        elif self.kind == "joint_deltas":
            change = later_q - q
        else:
            change = later_pose[:3] - pose[:3]
            if self.kind == "pose_deltas":
                inverse = poses.invert((0.0, 0.0, 0.0, *pose[3:]))
                change = np.concatenate((change, poses.compose((0.0, 0.0, 0.0, *later_pose[3:]), inverse)[3:]))
        return self._within(change / self._scale)

    def rest(self, commanded: Floats) -> Numbers32:
        """Return the action that keeps the target."""
        if self.kind == "joints":
            return self._within(commanded)
        return np.zeros(KINDS[self.kind], np.float32)

"""Kinds of actions: the meaning of their numbers, and conversion to joint positions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from urlink import BadValue, Robot
from urlink.arm import poses
from urlink.packets import RealtimeState

from .joints import JOINT_DELTAS, POSE, POSE_DELTAS, POSITIONS, named

__all__ = ["KINDS", "Actions", "pose_numbers"]

#: Names of the numbers of each kind of action.
KINDS = {"joints": POSITIONS, "joint_deltas": JOINT_DELTAS, "pose": POSE, "pose_deltas": POSE_DELTAS}
#: Maximum angle, in rad, by which a pose may turn a joint; a larger angle means a singularity or another posture.
_LEAP = 1.5
#: Length below which a column of a rotation matrix has no usable direction.
_SHORT = 1e-3

Floats = NDArray[np.float64]


def pose_numbers(pose: Any) -> list[float]:
    """Return the nine numbers of `POSE` for a pose, shape (6,)."""
    matrix = poses.to_matrix(pose)
    found: list[float] = [*matrix[:3, 3].tolist(), *matrix[:3, 0].tolist(), *matrix[:3, 1].tolist()]
    return found


def _matrix(numbers: Floats) -> Floats:
    """Return the homogeneous matrix of the nine numbers; their columns need not be orthonormal."""
    first, second = numbers[3:6], numbers[6:]
    if np.linalg.norm(first) > _SHORT:
        first = first / np.linalg.norm(first)
        second = second - (first @ second) * first
    if min(np.linalg.norm(first), np.linalg.norm(second)) < _SHORT:
        raise BadValue(f"{', '.join(POSE[3:])} are {numbers[3:].tolist()}; expected two columns of a rotation")
    second = second / np.linalg.norm(second)
    matrix = np.eye(4)
    matrix[:3] = np.column_stack((first, second, np.cross(first, second), numbers[:3]))
    return matrix


@dataclass(frozen=True)
class Actions:
    """Actions of one kind, for an arm with its current tool.

    Attributes:
        kind: Kind of action, one of `KINDS`.
        robot: Robot whose kinematics are used.
        tcp: Pose of the TCP in the flange frame, shape (6,).
        max_step: Maximum change of a joint's set-point by one action, in rad.
    """

    kind: str
    robot: Robot
    tcp: Floats
    max_step: float

    @classmethod
    def of(cls, kind: str, robot: Robot, state: RealtimeState, max_step: float) -> Actions:
        """Return actions for the tool that a state shows."""
        flange = robot.kinematics.forward(state.q_actual)
        return cls(kind, robot, poses.compose(poses.invert(flange), state.tool_vector_actual), max_step)

    def read(self, action: dict[str, Any]) -> Floats:
        """Read the numbers of an action.

        Raises:
            BadValue: If a number is missing or not finite.
        """
        try:
            values = np.array([float(action[name]) for name in KINDS[self.kind]])
        except (KeyError, TypeError, ValueError) as error:
            raise BadValue(f"invalid action, {error!r}; expected the numbers {', '.join(KINDS[self.kind])}") from None
        if not np.isfinite(values).all():
            raise BadValue(f"the action is {values.tolist()}; expected finite numbers")
        return values

    def setpoints(self, values: Floats, commanded: Floats) -> Floats:
        """Return the joint set-points after an action, shape (6,), in rad.

        The motion starts at the set-points `commanded`. No joint moves by more than a step or beyond its limits. For a
        pose, all joints move by the same fraction of their distance, so that the tool stays close to its path.

        Raises:
            BadValue: If the pose is not valid, or would turn a joint by more than 1.5 rad.
            Unreachable: If the pose is out of reach.
        """
        low, high = self.robot.kinematics.position_limits.T
        if self.kind in ("joints", "joint_deltas"):
            wanted = values if self.kind == "joints" else commanded + values
            joints: Floats = np.clip(np.clip(wanted, low, high), commanded - self.max_step, commanded + self.max_step)
            return joints
        away = self.robot.kinematics.inverse(self._pose(values, commanded), commanded, self.tcp) - commanded
        furthest = float(np.abs(away).max())
        if furthest > _LEAP:
            raise BadValue(
                f"the pose of the action turns a joint by {furthest:.3f} rad; expected at most {_LEAP:g} rad (the "
                "pose is beyond a singularity or too far away)"
            )
        scaled: Floats = np.clip(commanded + away * min(1.0, self.max_step / max(furthest, self.max_step)), low, high)
        return scaled

    def _pose(self, values: Floats, commanded: Floats) -> Floats:
        if self.kind == "pose":
            return poses.from_matrix(_matrix(values))
        matrix = poses.to_matrix(self.robot.kinematics.forward(commanded, self.tcp))
        matrix[:3, 3] += values[:3]
        matrix[:3, :3] = poses.rotvec_to_matrix(values[3:]) @ matrix[:3, :3]
        return poses.from_matrix(matrix)

    def named(self, q: Floats, commanded: Floats) -> dict[str, float]:
        """Return the action that moves the set-points of the joints from `commanded` to `q`."""
        names = KINDS[self.kind]
        if self.kind == "joints":
            return named(names, q.tolist())
        if self.kind == "joint_deltas":
            return named(names, (q - commanded).tolist())
        there = self.robot.kinematics.forward(q, self.tcp)
        if self.kind == "pose":
            return named(names, pose_numbers(there))
        after, before = poses.to_matrix(there), poses.to_matrix(self.robot.kinematics.forward(commanded, self.tcp))
        turned = poses.matrix_to_rotvec(after[:3, :3] @ before[:3, :3].T)
        return named(names, [*(after[:3, 3] - before[:3, 3]).tolist(), *turned.tolist()])

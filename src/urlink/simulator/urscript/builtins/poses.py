"""Functions that compute with poses and joint positions.

The following is assumed. `pose_add` adds positions and multiplies rotations, both in the base frame, and `pose_sub` is
the inverse operation. `pose_dist` is the square root of the sum of two squares: of the distance and of the angle.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from urlink.arm import poses, rigid
from urlink.arm.kinematics import Unreachable

from ..errors import Fault, type_error
from ..machine import ScriptThread
from ..matrices import rows_of
from ..values import PoseValue, list_of
from .declaration import declare, is_list, joints, joints_or, number, pose, vector

# Work that is counted for each operation, in elements of a list.
_TRANSFORMATION, _FORWARD, _INVERSE = 20, 40, 400

_NOWHERE = (0.0, 0.0, 0.0)


@declare()
def pose_trans(thread: ScriptThread, p_from: Any, p_from_to: Any) -> PoseValue:
    return _transformed(thread, pose(p_from, "pose_trans: p_from"), pose(p_from_to, "pose_trans: p_from_to"))


@declare()
def pose_inv(thread: ScriptThread, p_from: Any) -> PoseValue:
    return _inverse(thread, pose(p_from, "pose_inv: p_from"))


@declare(since="3.0")
def inv(thread: ScriptThread, m: Any) -> Any:
    """Return the inverse of a pose, like `pose_inv`.

    In firmware 3.14, 5.9 and later, the function also inverts a square matrix.
    """
    if m.__class__ is PoseValue or not thread.machine.has_matrices:
        return _inverse(thread, pose(m, "inv: m"))
    rows = rows_of(m, thread.machine.charge)
    if len(rows) != len(rows[0]):
        raise type_error("inv: m must be a pose or a square matrix")
    thread.machine.charge(len(rows) ** 3)
    try:
        inverse = np.linalg.inv(np.array(rows)).tolist()
    except np.linalg.LinAlgError:
        raise Fault("inv: m has no inverse") from None
    return list_of([list_of(row, thread.machine.charge) for row in inverse], thread.machine.charge)


@declare(since="3.0")
def wrench_trans(thread: ScriptThread, T_from_to: Any, w_from: Any) -> tuple[float, ...]:
    """Return a wrench that is given in the first frame, expressed in the second frame.

    The torque of the result is about the origin of the second frame. It is assumed that a wrench is six numbers, first
    the force and then the torque.
    """
    there = pose(T_from_to, "wrench_trans: T_from_to")
    wrench = vector(w_from, "wrench_trans: w_from", 6)
    thread.machine.spend(_TRANSFORMATION)
    turn = poses.rotvec_to_matrix(there[3:]).T
    torque = np.subtract(wrench[3:], np.cross(there[:3], wrench[:3]))
    return (*(turn @ wrench[:3]).tolist(), *(turn @ torque).tolist())


@declare()
def pose_add(thread: ScriptThread, p_1: Any, p_2: Any) -> PoseValue:
    a, b = pose(p_1, "pose_add: p_1"), pose(p_2, "pose_add: p_2")
    turned = _transformed(thread, [*_NOWHERE, *a[3:]], [*_NOWHERE, *b[3:]])
    return PoseValue([a[0] + b[0], a[1] + b[1], a[2] + b[2], *turned[3:]])


@declare()
def pose_sub(thread: ScriptThread, p_to: Any, p_from: Any) -> PoseValue:
    a, b = pose(p_to, "pose_sub: p_to"), pose(p_from, "pose_sub: p_from")
    turned = _transformed(thread, [*_NOWHERE, *a[3:]], _inverse(thread, [*_NOWHERE, *b[3:]]))
    return PoseValue([a[0] - b[0], a[1] - b[1], a[2] - b[2], *turned[3:]])


@declare()
def pose_dist(thread: ScriptThread, p_from: Any, p_to: Any) -> float:
    between = _transformed(thread, _inverse(thread, pose(p_from, "pose_dist: p_from")), pose(p_to, "pose_dist: p_to"))
    return math.hypot(*between)


@declare()
def point_dist(thread: ScriptThread, p_from: Any, p_to: Any) -> float:
    return math.dist(pose(p_from, "point_dist: p_from")[:3], pose(p_to, "point_dist: p_to")[:3])


@declare()
def interpolate_pose(thread: ScriptThread, p_from: Any, p_to: Any, alpha: Any) -> PoseValue:
    a, b = pose(p_from, "interpolate_pose: p_from"), pose(p_to, "interpolate_pose: p_to")
    x = number(alpha, "interpolate_pose: alpha")
    thread.machine.spend(3 * _TRANSFORMATION)
    return PoseValue(poses.interpolate(a, b, x).tolist())


@declare()
def rotvec2rpy(thread: ScriptThread, rotation_vector: Any) -> tuple[float, ...]:
    """Return roll, pitch and yaw in rad: rotations about the fixed axes x, y and z, in this order."""
    return tuple(poses.rotvec_to_rpy(vector(rotation_vector, "rotvec2rpy: vector", 3)).tolist())


@declare()
def rpy2rotvec(thread: ScriptThread, rpy_vector: Any) -> tuple[float, ...]:
    thread.machine.spend(2 * _TRANSFORMATION)
    return tuple(poses.rpy_to_rotvec(vector(rpy_vector, "rpy2rotvec: vector", 3)).tolist())


@declare()
def get_forward_kin(thread: ScriptThread, q: Any = "current_joint_positions", tcp: Any = "active_tcp") -> PoseValue:
    world = thread.world
    thread.machine.spend(_FORWARD)
    where = world.q_actual if isinstance(q, str) else joints(q, "get_forward_kin: q")
    return PoseValue(world.kinematics.forward(list(where), tcp_of(thread, tcp, "tcp")).tolist())


@declare(name="get_inverse_kin", since="3.0")
def get_inverse_kin_tcp(
    thread: ScriptThread,
    x: Any,
    qnear: Any = None,
    maxPositionError: Any = 1e-10,
    maxOrientationError: Any = 1e-10,
    tcp: Any = "active_tcp",
) -> tuple[float, ...]:
    found = solution(thread, pose(x, "get_inverse_kin: x"), qnear, tcp)
    if found is None:
        raise Fault("get_inverse_kin: unable to find an inverse kinematics solution")
    return tuple(found)


@declare(until="3.0")
def get_inverse_kin(
    thread: ScriptThread, x: Any, qnear: Any = None, maxPositionError: Any = 1e-10, maxOrientationError: Any = 1e-10
) -> tuple[float, ...]:
    return get_inverse_kin_tcp(thread, x, qnear)


# According to the test matrix of a public project, 5.9.4 has this function and 5.8.2 does not. It is assumed that CB3
# has it since 3.14.
@declare(since="3.14/5.9")
def get_inverse_kin_has_solution(
    thread: ScriptThread,
    pose: Any,
    qnear: Any = None,
    maxPositionError: Any = 1e-10,
    maxOrientationError: Any = 1e-10,
    tcp: Any = "active_tcp",
) -> bool:
    return solution(thread, _pose(pose, "get_inverse_kin_has_solution: pose"), qnear, tcp) is not None


_pose = pose


@declare(since="3.0")
def is_within_safety_limits(thread: ScriptThread, pose: Any) -> bool:
    """Whether joint positions or a pose are within the joint limits.

    The simulator has no safety planes.
    """
    q: Sequence[float] | None
    if is_list(pose):
        q = joints(pose, "is_within_safety_limits: q")
    else:
        q = solution(thread, _pose(pose, "is_within_safety_limits: pose"))
    return q is not None and bool(thread.world.kinematics.within_limits(q))


def solution(
    thread: ScriptThread, x: Sequence[float], qnear: Any = None, tcp: Any = "active_tcp"
) -> list[float] | None:
    """Return the joint positions for a pose; None if the pose is out of reach.

    If there are several solutions, the solution closest to `qnear` is returned. The default of `qnear` is the current
    target.
    """
    near = joints_or(qnear, thread.world.q_target, "qnear")
    thread.machine.spend(_INVERSE)
    try:
        # Normalise the rotation vector: a controller accepts any rotation vector, but `Arm.inverse` only rotations of
        # up to one turn.
        turned = rigid.to_pose(rigid.from_pose(list(x)))
        found: list[float] = thread.world.kinematics.inverse(
            turned, near, tcp_of(thread, tcp, "tcp"), is_limited=False
        ).tolist()
    except Unreachable:
        return None
    return found


def tcp_of(thread: ScriptThread, tcp: Any, what: str) -> list[float]:
    """Return a TCP in the flange frame: the given pose, or the active TCP if the argument is a string."""
    return list(thread.world.tcp) if isinstance(tcp, str) else pose(tcp, what)


def _transformed(thread: ScriptThread, first: Sequence[float], second: Sequence[float]) -> PoseValue:
    thread.machine.spend(_TRANSFORMATION)
    return PoseValue(poses.compose(first, second).tolist())


def _inverse(thread: ScriptThread, of: Sequence[float]) -> PoseValue:
    thread.machine.spend(_TRANSFORMATION)
    return PoseValue(poses.invert(of).tolist())

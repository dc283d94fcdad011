"""Calculations with poses and rotations.

A pose has the format of Universal Robots: x, y, z in m, and a rotation vector in rad. The direction of the rotation
vector is the axis, and its length is the angle. A pose gives the position and orientation of one frame in another
frame. All functions accept one pose, shape (6,), or any number of poses, shape (..., 6). The functions broadcast like
those of numpy, and return new float64 arrays.

    >>> from urlink import poses
    >>> # in the base frame, turned by 90 degrees
    >>> table = [0.4, -0.2, 0.1, 0, 0, 1.5707963267948966]
    >>> # in the frame of the table
    >>> part = [0.05, 0, 0, 0, 0, 0]
    >>> # in the base frame
    >>> poses.compose(table, part).round(3).tolist()
    [0.4, -0.15, 0.1, 0.0, 0.0, 1.571]

Rotations convert from and to rotation vectors:

- **Matrices** have the shape (3, 3). Their columns are the axes of the turned frame.
- **Quaternions** are x, y, z, w, as in ROS and scipy. Many texts write w first.
- **rpy** is roll, pitch and yaw in rad: rotations about the fixed x axis, then the fixed y axis, then the fixed z axis,
  as in `rpy2rotvec` of URScript and in URDF.

The angle of a returned rotation vector is 0 to pi. At exactly pi, both directions of the axis describe the same
rotation. For a matrix or a pose, the functions then return the direction that has a positive largest component.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from linkcore.errors import BadValue

from . import rigid
from .rigid import Rigid
from .vectors import FloatArray

__all__ = [
    "compose",
    "from_matrix",
    "interpolate",
    "invert",
    "matrix_to_rotvec",
    "quaternion_to_rotvec",
    "rotvec_to_matrix",
    "rotvec_to_quaternion",
    "rotvec_to_rpy",
    "rpy_to_rotvec",
    "to_matrix",
    "transform",
]

#: Maximum deviation of the columns of a rotation matrix from orthonormal columns. Matrices of float32 deviate by 1e-7.
_ORTHONORMAL = 1e-4
# If the cosine of the pitch is smaller than this, the x axis points up or down, and roll and yaw turn about the same
# axis.
_GIMBAL_LOCK = 1e-14


def compose(first: ArrayLike, second: ArrayLike) -> FloatArray:
    """Transform `second` from the frame that `first` describes to the reference frame of `first`.

    This function is the equivalent of pose_trans in URScript.

    Args:
        first: Poses, shape (..., 6).
        second: Poses, shape (..., 6).

    Returns:
        Poses, shape (..., 6).

    Raises:
        BadValue: If the arguments are not poses, or their shapes do not broadcast.
    """
    if rigid.is_single(first) and rigid.is_single(second):
        return np.array(rigid.to_pose(rigid.product(_one(first), _one(second))))
    (a, b), shape = rigid.aligned(rigid.rows(first, (6,), "poses"), rigid.rows(second, (6,), "poses"))
    return rigid.to_poses(rigid.product(rigid.from_poses(a), rigid.from_poses(b))).reshape(*shape, 6)


def invert(pose: ArrayLike) -> FloatArray:
    """Return the inverse pose: the pose of the reference frame in the frame that `pose` describes.

    This function is the equivalent of pose_inv in URScript.

    Args:
        pose: Poses, shape (..., 6).

    Returns:
        Poses, shape (..., 6).

    Raises:
        BadValue: If the argument is not a pose.

    >>> invert([0.4, 0, 0, 0, 0, 0]).tolist()[:2]
    [-0.4, -0.0]
    """
    if rigid.is_single(pose):
        return np.array(rigid.to_pose(rigid.invert(_one(pose))))
    given = rigid.rows(pose, (6,), "poses")
    return rigid.to_poses(rigid.invert(rigid.from_poses(given.reshape(-1, 6)))).reshape(given.shape)


def interpolate(first: ArrayLike, second: ArrayLike, fraction: ArrayLike) -> FloatArray:
    """Interpolate between two poses: move the position on a straight line, and turn about one axis.

    The rotation is at most 180 degrees. The result is on the path of `movel`, and equals the result of interpolate_pose
    in URScript.

    Args:
        first: Poses at the fraction 0, shape (..., 6).
        second: Poses at the fraction 1, shape (..., 6).
        fraction: Fractions, shape (...). Values outside 0 to 1 extrapolate the path.

    Returns:
        Poses, shape (..., 6).

    Raises:
        BadValue: If the arguments are not poses and numbers, or their shapes do not broadcast.

    >>> interpolate([0, 0, 0, 0, 0, 0], [1, 0, 0, 0, 0, 2], [0.0, 0.25, 1.0]).tolist()[1]
    [0.25, 0.0, 0.0, 0.0, 0.0, 0.5]
    """
    if rigid.is_single(first) and rigid.is_single(second) and np.ndim(fraction) == 0:
        begin, end = _one(first), _one(second)
        (x,) = rigid.floats(np.array([fraction]), 1, "a fraction")
        turn = rigid.rotation_vector(rigid.product(rigid.invert(begin), end))
        turned = rigid.product(begin, rigid.from_pose([0.0, 0.0, 0.0, *(x * angle for angle in turn)]))
        there = [p + x * (q - p) for p, q in zip(begin[9:], end[9:], strict=True)]
        return np.array([*there, *rigid.rotation_vector(turned)])
    fractions = rigid.rows(fraction, (), "fractions")[..., np.newaxis]
    (a, b, s), shape = rigid.aligned(rigid.rows(first, (6,), "poses"), rigid.rows(second, (6,), "poses"), fractions)
    begins = rigid.from_poses(a)
    turns = s * rigid.to_poses(rigid.product(rigid.invert(begins), rigid.from_poses(b)))
    turns[:, :3] = 0.0
    found = rigid.to_poses(rigid.product(begins, rigid.from_poses(turns)))
    found[:, :3] = a[:, :3] + s * (b[:, :3] - a[:, :3])
    return found.reshape(*shape, 6)


def transform(pose: ArrayLike, points: ArrayLike) -> FloatArray:
    """Transform points from the frame that `pose` describes to the reference frame of the pose.

    Args:
        pose: Poses, shape (..., 6).
        points: Points, shape (..., 3), in m.

    Returns:
        Points, shape (..., 3), in m.

    Raises:
        BadValue: If the arguments are not poses and points, or their shapes do not broadcast.

    >>> transform([0, 0, 1, 0, 0, 0], [[0.1, 0, 0], [0.2, 0, 0]]).tolist()
    [[0.1, 0.0, 1.0], [0.2, 0.0, 1.0]]
    """
    (given, at), shape = rigid.aligned(rigid.rows(pose, (6,), "poses"), rigid.rows(points, (3,), "points"))
    r00, r01, r02, r10, r11, r12, r20, r21, r22, px, py, pz = rigid.from_poses(given)
    x, y, z = at.T
    moved = (
        r00 * x + r01 * y + r02 * z + px,
        r10 * x + r11 * y + r12 * z + py,
        r20 * x + r21 * y + r22 * z + pz,
    )
    return np.stack(moved, axis=-1).reshape(*shape, 3)


# --- matrices ---


def to_matrix(pose: ArrayLike) -> FloatArray:
    """Convert poses, shape (..., 6), to homogeneous matrices, shape (..., 4, 4).

    Raises:
        BadValue: If the argument is not a pose.
    """
    if rigid.is_single(pose):
        return rigid.to_matrix(_one(pose))
    given = rigid.rows(pose, (6,), "poses")
    return rigid.to_matrices(rigid.from_poses(given.reshape(-1, 6))).reshape(*given.shape[:-1], 4, 4)


def from_matrix(matrix: ArrayLike) -> FloatArray:
    """Convert homogeneous matrices, shape (..., 4, 4), to poses, shape (..., 6).

    Raises:
        BadValue: If a matrix is not homogeneous, or its upper left part is not a rotation.
    """
    given = rigid.rows(matrix, (4, 4), "homogeneous matrices")
    _check_rotations(given[..., :3, :3])
    if given.ndim == 2:
        return np.array(rigid.to_pose(rigid.from_matrix(given)))
    return rigid.to_poses(rigid.from_matrices(given.reshape(-1, 4, 4))).reshape(*given.shape[:-2], 6)


def rotvec_to_matrix(rotvec: ArrayLike) -> FloatArray:
    """Convert rotation vectors, shape (..., 3), in rad, to rotation matrices, shape (..., 3, 3).

    Raises:
        BadValue: If the argument is not a rotation vector.

    >>> rotvec_to_matrix([0, 0, 1.5707963267948966]).round(6).tolist()
    [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    """
    given = rigid.rows(rotvec, (3,), "rotation vectors")
    turns = np.broadcast_arrays(*_rotations(given)[:9])
    return np.stack(turns, axis=-1).reshape(*given.shape, 3)


def matrix_to_rotvec(matrix: ArrayLike) -> FloatArray:
    """Convert rotation matrices, shape (..., 3, 3), to rotation vectors, shape (..., 3), in rad.

    Raises:
        BadValue: If the shape is wrong, or a matrix is not a rotation.
    """
    given = rigid.rows(matrix, (3, 3), "rotation matrices")
    _check_rotations(given)
    r = np.moveaxis(given.reshape(-1, 9), -1, 0)
    none = np.zeros_like(r[0])
    return rigid.to_poses((r[0], r[1], r[2], r[3], r[4], r[5], r[6], r[7], r[8], none, none, none))[:, 3:].reshape(
        given.shape[:-1]
    )


# --- quaternions ---


def rotvec_to_quaternion(rotvec: ArrayLike) -> FloatArray:
    """Convert rotation vectors, shape (..., 3), in rad, to unit quaternions x, y, z, w, shape (..., 4).

    The component w is at least 0.

    Raises:
        BadValue: If the argument is not a rotation vector.

    >>> rotvec_to_quaternion([0, 0, 3.141592653589793]).round(6).tolist()
    [0.0, 0.0, 1.0, 0.0]
    """
    given = rigid.rows(rotvec, (3,), "rotation vectors")
    return rigid.quaternions(_rotations(given)).reshape(*given.shape[:-1], 4)


def quaternion_to_rotvec(quaternion: ArrayLike) -> FloatArray:
    """Convert quaternions x, y, z, w, shape (..., 4), to rotation vectors, shape (..., 3), in rad.

    The quaternions can have any length except 0.

    Raises:
        BadValue: If the argument is not a quaternion, or a quaternion has the length 0.
    """
    given = rigid.rows(quaternion, (4,), "quaternions")
    # Normalise before squaring, so that no length is too small or too large.
    largest = np.abs(given).max(axis=-1, keepdims=True)
    if not largest.all():
        at = list(np.argwhere(largest[..., 0] == 0.0)[0])
        raise BadValue(f"a quaternion of length 0 is not a rotation; its index is {at}")
    x, y, z, w = (given / largest).reshape(-1, 4).T
    length = np.sqrt(x * x + y * y + z * z)
    # Two quaternions describe the same rotation. Use the quaternion with an angle of at most pi.
    scale = 2.0 * np.arctan2(length, np.abs(w)) / np.where(length > 0.0, length, 1.0) * np.where(w < 0.0, -1.0, 1.0)
    return np.stack((scale * x, scale * y, scale * z), axis=-1).reshape(*given.shape[:-1], 3)


# --- roll, pitch, yaw ---


def rotvec_to_rpy(rotvec: ArrayLike) -> FloatArray:
    """Convert rotation vectors, shape (..., 3), in rad, to roll, pitch and yaw, shape (..., 3), in rad.

    The pitch is -pi/2 to pi/2. If the pitch is ±pi/2, roll and yaw turn about the same axis; the roll is then 0.

    Raises:
        BadValue: If the argument is not a rotation vector.
    """
    given = rigid.rows(rotvec, (3,), "rotation vectors")
    r00, r01, r02, r10, r11, r12, r20, _, _ = _rotations(given)[:9]
    level = np.hypot(r00, r10)
    locked = level < _GIMBAL_LOCK
    yaw = np.where(locked, np.arctan2(-r01, r11), np.arctan2(r10, r00))
    # Compute the roll of the rotation that remains after the yaw is removed. Close to a pitch of ±pi/2, the yaw has few
    # correct digits. Only a roll that is computed with the same yaw reproduces the rotation.
    s, c = np.sin(yaw), np.cos(yaw)
    roll = np.where(locked, 0.0, np.arctan2(s * r02 - c * r12, c * r11 - s * r01))
    return np.stack((roll, np.arctan2(-r20, level), yaw), axis=-1).reshape(given.shape)


def rpy_to_rotvec(rpy: ArrayLike) -> FloatArray:
    """Convert roll, pitch and yaw, shape (..., 3), in rad, to rotation vectors, shape (..., 3), in rad.

    Raises:
        BadValue: If a row does not have three finite numbers.

    >>> rpy_to_rotvec([[0.1, 0, 0], [0, 0, 0.2]]).round(6).tolist()
    [[0.1, 0.0, 0.0], [0.0, 0.0, 0.2]]
    """
    given = rigid.rows(rpy, (3,), "roll, pitch and yaw")
    half = 0.5 * given.reshape(-1, 3)
    (sr, sp, sy), (cr, cp, cy) = np.sin(half).T, np.cos(half).T
    turned = (
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    )
    return quaternion_to_rotvec(np.stack(turned, axis=-1)).reshape(given.shape)


# --- arguments ---


def _one(pose: ArrayLike) -> Rigid[float]:
    return rigid.from_pose(rigid.floats(pose, 6, "a pose"))


def _rotations(rotvecs: FloatArray) -> Rigid[FloatArray]:
    flat = rotvecs.reshape(-1, 3)
    return rigid.from_poses(np.concatenate((np.zeros_like(flat), flat), axis=1))


def _check_rotations(matrices: FloatArray) -> None:
    """Raise `BadValue` if a matrix is not a rotation."""
    off = np.abs(matrices @ np.swapaxes(matrices, -1, -2) - np.eye(3)).max(axis=(-1, -2))
    wrong = (off > _ORTHONORMAL) | (np.linalg.det(matrices) < 0.0)
    if wrong.any():
        at = [int(i) for i in np.argwhere(wrong)[0]]
        where = f" at {at}" if at else ""
        raise BadValue(f"the matrix{where} is not a rotation; its columns must be orthonormal and right-handed")

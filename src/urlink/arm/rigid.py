"""Rigid transforms as twelve numbers, for poses, kinematics and dynamics.

A transform is a tuple of twelve numbers: the rows of the rotation matrix, then the position in m. Each number is a
float, or an array of n floats for n transforms. The same formulas are used in both cases. A single transform is
computed without numpy, because calls into numpy would take longer than the arithmetic. With arrays, the number of calls
into numpy does not depend on the number of transforms.

Rotations are given and returned as rotation vectors, as in poses of Universal Robots. The direction of the vector is
the axis, and its length is the angle in rad. Conversions use the largest component of the unit quaternion, so they keep
their precision at every angle, including 0 and pi.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from linkcore.errors import BadValue

from .vectors import FloatArray

Number = TypeVar("Number", float, FloatArray)

#: Rotation matrix row by row, then position: r00 r01 r02 r10 r11 r12 r20 r21 r22 px py pz.
Rigid = tuple[Number, Number, Number, Number, Number, Number, Number, Number, Number, Number, Number, Number]
Six = tuple[Number, Number, Number, Number, Number, Number]
Quaternion = tuple[Number, Number, Number, Number]

# The most frequent types come first, because the check for `Sequence` takes ten times as long.
_LISTS = (list, tuple, Sequence)
_ROWS = (*_LISTS, np.ndarray)

IDENTITY: Rigid[float] = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)  # a NamedTuple cannot be generic before Python 3.11
class MathFunctions(Generic[Number]):
    """Mathematical functions for the formulas, either for floats or for arrays."""

    sin: Callable[[Number], Number]
    cos: Callable[[Number], Number]
    sqrt: Callable[[Number], Number]
    atan2: Callable[[Number | float, Number], Number]
    hypot: Callable[[Number, Number], Number]
    #: Function that returns `max(x, 0)`.
    positive: Callable[[Number], Number]


FLOATS: MathFunctions[float] = MathFunctions(
    math.sin, math.cos, math.sqrt, math.atan2, math.hypot, lambda x: x if x > 0.0 else 0.0
)
ROWS: MathFunctions[FloatArray] = MathFunctions(
    np.sin, np.cos, np.sqrt, np.arctan2, np.hypot, lambda x: np.maximum(x, 0.0)
)


def floats(values: ArrayLike, n: int, what: str) -> list[float]:
    """Convert `n` finite numbers to plain floats, because arithmetic with numpy scalars is several times slower.

    Raises:
        BadValue: If `values` is not `n` finite numbers.
    """
    try:
        plain = values.tolist() if isinstance(values, np.ndarray) else list(map(float, values))  # type: ignore[arg-type]
        usable = len(plain) == n and all(map(math.isfinite, plain))
    except (TypeError, ValueError):
        usable = False
    if not usable:
        raise BadValue(f"{what} must be {n} finite numbers; got {values!r}")
    return plain


def rows(values: ArrayLike, shape: tuple[int, ...], what: str) -> FloatArray:
    """Convert `values` to an array of finite float64 numbers; its last dimensions must be `shape`.

    Raises:
        BadValue: If the shape is different, or an element is not a finite number. The message names the first such
            element.
    """
    expected = f"{what} must have the shape (..., {', '.join(map(str, shape))}) and hold finite numbers"
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise BadValue(f"{expected} ({error})") from None
    if array.shape[array.ndim - len(shape) :] != shape or array.ndim < len(shape):
        raise BadValue(f"{expected}; got the shape {array.shape}")
    finite = np.isfinite(array)
    if not finite.all():
        at = tuple(int(i) for i in np.argwhere(~finite)[0])
        raise BadValue(f"{expected}; the value at {list(at)} is {array[at]}")
    return array


def is_single(values: ArrayLike) -> bool:
    """Return whether `values` is one row of numbers. Invalid values are rejected later, by `floats` and `rows`."""
    if isinstance(values, np.ndarray):
        return values.ndim <= 1
    # Converting to a numpy array first would take longer than the arithmetic.
    return not isinstance(values, _LISTS) or not len(values) or not isinstance(values[0], _ROWS)


def aligned(*arrays: FloatArray) -> tuple[list[FloatArray], tuple[int, ...]]:
    """Broadcast the leading dimensions of the arrays, and flatten these dimensions to n rows.

    Returns the flattened arrays, and the broadcast leading dimensions.

    Raises:
        BadValue: If the leading dimensions do not broadcast.
    """
    try:
        shape = np.broadcast_shapes(*(array.shape[:-1] for array in arrays))
    except ValueError:
        given = " and ".join(str(array.shape) for array in arrays)
        raise BadValue(f"the shapes {given} do not broadcast; expected equal leading dimensions, or 1") from None
    return [np.broadcast_to(a, (*shape, a.shape[-1])).reshape(-1, a.shape[-1]) for a in arrays], shape


def row(of: Rigid[FloatArray], i: int) -> Rigid[float]:
    """Return transform number `i` of n transforms."""
    r00, r01, r02, r10, r11, r12, r20, r21, r22, px, py, pz = (float(number[i]) for number in of)
    return r00, r01, r02, r10, r11, r12, r20, r21, r22, px, py, pz


def take(of: Rigid[FloatArray], chosen: NDArray[np.bool_] | NDArray[np.intp]) -> Rigid[FloatArray]:
    """Return some of n transforms, selected by a numpy index."""
    r00, r01, r02, r10, r11, r12, r20, r21, r22, px, py, pz = (number[chosen] for number in of)
    return r00, r01, r02, r10, r11, r12, r20, r21, r22, px, py, pz


# --- product and inverse ---


def product(first: Rigid[Number], second: Rigid[Number]) -> Rigid[Number]:
    """Transform `second` from the frame that `first` describes to the reference frame of `first`."""
    a00, a01, a02, a10, a11, a12, a20, a21, a22, ax, ay, az = first
    b00, b01, b02, b10, b11, b12, b20, b21, b22, bx, by, bz = second
    return (
        a00 * b00 + a01 * b10 + a02 * b20,
        a00 * b01 + a01 * b11 + a02 * b21,
        a00 * b02 + a01 * b12 + a02 * b22,
        a10 * b00 + a11 * b10 + a12 * b20,
        a10 * b01 + a11 * b11 + a12 * b21,
        a10 * b02 + a11 * b12 + a12 * b22,
        a20 * b00 + a21 * b10 + a22 * b20,
        a20 * b01 + a21 * b11 + a22 * b21,
        a20 * b02 + a21 * b12 + a22 * b22,
        a00 * bx + a01 * by + a02 * bz + ax,
        a10 * bx + a11 * by + a12 * bz + ay,
        a20 * bx + a21 * by + a22 * bz + az,
    )


def invert(rigid: Rigid[Number]) -> Rigid[Number]:
    """Return the inverse of the transform `rigid`."""
    r00, r01, r02, r10, r11, r12, r20, r21, r22, px, py, pz = rigid
    x, y, z = r00 * px + r10 * py + r20 * pz, r01 * px + r11 * py + r21 * pz, r02 * px + r12 * py + r22 * pz
    return r00, r10, r20, r01, r11, r21, r02, r12, r22, -x, -y, -z


# --- rotation vectors and poses ---


def _turned(px: Number, py: Number, pz: Number, x: Number, y: Number, z: Number, s: Number, v: Number) -> Rigid[Number]:
    """Return the rotation about the unit axis x, y, z (Rodrigues); `s` is the sine of the angle, `v` 1 - cosine."""
    sx, sy, sz = s * x, s * y, s * z
    vx, vy, vz = v * x, v * y, v * z
    xx, yy, zz, xy, yz, zx = vx * x, vy * y, vz * z, vx * y, vy * z, vz * x
    r00, r01, r02 = 1.0 - yy - zz, xy - sz, zx + sy
    r10, r11, r12 = xy + sz, 1.0 - xx - zz, yz - sx
    r20, r21, r22 = zx - sy, yz + sx, 1.0 - xx - yy
    return r00, r01, r02, r10, r11, r12, r20, r21, r22, px, py, pz


def from_pose(pose: Six[float] | list[float]) -> Rigid[float]:
    """Return the transform of a pose: x, y, z in m and a rotation vector in rad."""
    px, py, pz, rx, ry, rz = pose
    angle = math.hypot(rx, ry, rz)
    if angle == 0.0:
        return (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, px, py, pz)
    return _turned(px, py, pz, rx / angle, ry / angle, rz / angle, math.sin(angle), 1.0 - math.cos(angle))


def from_poses(poses: FloatArray) -> Rigid[FloatArray]:
    """Return the transforms of poses, shape (n, 6)."""
    px, py, pz, rx, ry, rz = poses.T
    angle = np.hypot(np.hypot(rx, ry), rz)
    # If the angle is 0, any axis is correct, and the axis 0, 0, 0 results in the identity.
    length = np.where(angle > 0.0, angle, 1.0)
    return _turned(px, py, pz, rx / length, ry / length, rz / length, np.sin(angle), 1.0 - np.cos(angle))


# Each of these functions multiplies one component of the unit quaternion by all four components (w, x, y, z), and
# returns four times the products. If this component is the largest of the four, the products are as precise as the
# matrix.
def _by_w(r: Rigid[Number]) -> Quaternion[Number]:
    return 1.0 + r[0] + r[4] + r[8], r[7] - r[5], r[2] - r[6], r[3] - r[1]


def _by_x(r: Rigid[Number]) -> Quaternion[Number]:
    return r[7] - r[5], 1.0 + r[0] - r[4] - r[8], r[3] + r[1], r[2] + r[6]


def _by_y(r: Rigid[Number]) -> Quaternion[Number]:
    return r[2] - r[6], r[3] + r[1], 1.0 + r[4] - r[0] - r[8], r[7] + r[5]


def _by_z(r: Rigid[Number]) -> Quaternion[Number]:
    return r[3] - r[1], r[2] + r[6], r[7] + r[5], 1.0 + r[8] - r[0] - r[4]


def _scaled_quaternion(rigid: Rigid[float]) -> Quaternion[float]:
    """Return a positive multiple of the quaternion w, x, y, z with w at least 0, so that its angle is at most pi."""
    r00, r11, r22 = rigid[0], rigid[4], rigid[8]
    if r00 + r11 + r22 > 0.0:
        return _by_w(rigid)
    w, x, y, z = _by_x(rigid) if r00 >= r11 and r00 >= r22 else _by_y(rigid) if r11 >= r22 else _by_z(rigid)
    # A quaternion and its negative describe the same rotation. Return the one with the smaller angle.
    return (-w, -x, -y, -z) if w < 0.0 else (w, x, y, z)


def _scaled_quaternions(rigid: Rigid[FloatArray]) -> FloatArray:
    """Apply `_scaled_quaternion` to n transforms; the result has the shape (4, n)."""
    r00, r11, r22 = rigid[0], rigid[4], rigid[8]
    by_y = (r11 >= r22) & (r11 > r00)
    by_x = (r00 >= r22) & (r00 >= r11)
    by_w = r00 + r11 + r22 > 0.0
    found = np.array(np.broadcast_arrays(*_by_w(rigid)))
    if not by_w.all():
        for chosen, formula in ((by_x & ~by_w, _by_x), (by_y & ~by_w, _by_y), (~(by_x | by_y | by_w), _by_z)):
            if chosen.any():
                found[:, chosen] = np.array(formula(rigid))[:, chosen]
        found *= np.where(found[0] < 0.0, -1.0, 1.0)
    return found


def rotation_vector(rigid: Rigid[float]) -> tuple[float, float, float]:
    """Return the rotation vector of a transform, with an angle of 0 to pi.

    At exactly pi, both directions of the axis describe the same rotation. In this case, the result is the direction
    that has a positive largest component.
    """
    w, x, y, z = _scaled_quaternion(rigid)
    sine = math.hypot(x, y, z)
    scale = 2.0 * math.atan2(sine, w) / sine if sine > 0.0 else 0.0
    return scale * x, scale * y, scale * z


def to_pose(rigid: Rigid[float]) -> Six[float]:
    """Return the pose of a transform: x, y, z in m, and the rotation vector in rad."""
    return (*rigid[9:], *rotation_vector(rigid))


def to_poses(rigid: Rigid[FloatArray]) -> FloatArray:
    """Return the poses of n transforms, shape (n, 6)."""
    w, x, y, z = _scaled_quaternions(rigid)
    sine = np.hypot(np.hypot(x, y), z)
    scale = 2.0 * np.arctan2(sine, w) / np.where(sine > 0.0, sine, 1.0)
    return np.stack(np.broadcast_arrays(*rigid[9:], scale * x, scale * y, scale * z), axis=-1)


def quaternions(rigid: Rigid[FloatArray]) -> FloatArray:
    """Return the unit quaternions x, y, z, w of n transforms, shape (n, 4). The component w is at least 0."""
    scaled = _scaled_quaternions(rigid)
    unit: FloatArray = (scaled / np.linalg.norm(scaled, axis=0)).T
    return unit[:, [1, 2, 3, 0]]


# --- homogeneous matrices ---


def to_matrix(rigid: Rigid[float]) -> FloatArray:
    """Return the homogeneous matrix of a transform, shape (4, 4)."""
    r00, r01, r02, r10, r11, r12, r20, r21, r22, px, py, pz = rigid
    flat = (r00, r01, r02, px, r10, r11, r12, py, r20, r21, r22, pz, 0.0, 0.0, 0.0, 1.0)
    return np.array(flat).reshape(4, 4)


def to_matrices(rigid: Rigid[FloatArray]) -> FloatArray:
    """Return the homogeneous matrices of n transforms, shape (n, 4, 4)."""
    parts = np.broadcast_arrays(*rigid)
    matrices = np.zeros((*parts[0].shape, 4, 4))
    matrices[..., :3, :3] = np.stack(parts[:9], axis=-1).reshape(*parts[0].shape, 3, 3)
    matrices[..., :3, 3] = np.stack(parts[9:], axis=-1)
    matrices[..., 3, 3] = 1.0
    return matrices


def from_matrix(matrix: FloatArray) -> Rigid[float]:
    """Return the transform of a homogeneous matrix, shape (4, 4). The last row of the matrix is ignored."""
    (r00, r01, r02, px), (r10, r11, r12, py), (r20, r21, r22, pz) = matrix[:3].tolist()
    return r00, r01, r02, r10, r11, r12, r20, r21, r22, px, py, pz


def from_matrices(matrices: FloatArray) -> Rigid[FloatArray]:
    """Return the transforms of homogeneous matrices, shape (n, 4, 4)."""
    (r00, r01, r02, px), (r10, r11, r12, py), (r20, r21, r22, pz) = np.moveaxis(matrices[:, :3], 0, -1)
    return r00, r01, r02, r10, r11, r12, r20, r21, r22, px, py, pz

"""Search for the joint positions of a calibrated arm, from seeds that almost put its flange at a pose.

A seed is a solution of the closed form, or the joint positions of the previous cycle. The closed form is exact only for
published arms. For a calibrated arm, its error is 0.1 mm to 1 mm. The joint positions of the previous cycle have an
error because the arm has moved since then. Newton's method converges from a seed to full precision: each step measures
the error of the wrist, and moves the joints by the inverse of the Jacobian times the error. The error after a step is
about the square of the error before it, so three steps are enough if the seed has an error of 0.01 rad. The inverse is
computed from the axes of the joints, without a matrix, in less time than the forward kinematics.

Close to a singularity, this method does not converge. In this case, the slower function `refine_anywhere` is used.
"""

from __future__ import annotations

import math

import numpy as np

from ..rigid import FLOATS, ROWS, MathFunctions, Number, Rigid, Six, product, take
from ..rigid import row as row_of
from ..vectors import FloatArray
from .geometry import Angles, Geometry, angles, chain, jacobian

#: Error in m and rad below which joint positions are a solution.
CONVERGED = 5e-14
# Bound of the second derivatives of the wrist's position and orientation: the error in m after a step of 1 rad. If
# this bound is ten times too small, the error is ten times `CONVERGED`, which is still less than 1e-12.
_CURVATURE = 2.0
# A step that is shorter than this, in rad, is the last one: the error after such a step is always below `CONVERGED`.
_LAST = math.sqrt(CONVERGED / _CURVATURE)
# Maximum number of steps of Newton's method, and its longest step in rad. Beyond these limits, `refine_anywhere` is
# used.
_STEPS = 8
_TOO_LONG = 0.5

# Up to this number of rows, solving them one by one is faster, because a step with arrays makes about 500 calls into
# numpy for any number of rows.
_FEW = 16

# Settings of `refine_anywhere`: maximum number of steps; largest step of a joint, in rad; fraction of a step at which
# the second derivative is measured; longest correction, relative to its step; and number of steps in a row that may
# reduce the error by less than one percent.
_ROBUST_STEPS = 100
_LONGEST = 0.5
_AHEAD = 0.1
_BENT = 0.75
_SLOW = 5


def refine(
    geometry: Geometry, seed: Angles[float], target: Rigid[float], within: float = math.inf
) -> Angles[float] | None:
    """Return the joint positions close to `seed` that put the flange at `target`.

    Args:
        geometry: Geometry of the arm.
        seed: Joint positions at the start, in rad.
        target: Pose of the flange in the base frame.
        within: Largest allowed error of the seed, in m and rad.

    Returns:
        Joint positions, in rad; None if the steps do not converge, or the error of the seed is larger than `within`.
    """
    wrist, there = geometry.to_wrist, product(target, geometry.wrist_in_flange)
    q = seed
    for n in range(_STEPS):
        frames = chain(wrist, FLOATS, q)
        error = _error(frames[5], there)
        size = max(map(abs, error))
        if n == 0 and not (size <= within and _cosine(frames[5], there) > 0.0):
            return None
        if size <= CONVERGED:
            return q
        try:
            step = _step(frames, error)
        except ZeroDivisionError:
            return None
        q = _moved(q, step)
        length = max(map(abs, step))
        if length <= _LAST:
            return q
        if not length <= _TOO_LONG:
            return None
    return None


def refine_rows(
    geometry: Geometry, seeds: FloatArray, targets: Rigid[FloatArray], within: float = math.inf
) -> FloatArray:
    """Apply `refine` to n seeds.

    Args:
        geometry: Geometry of the arm.
        seeds: Joint positions at the start, shape (6, n), in rad.
        targets: Poses of the flange, n transforms.
        within: Largest allowed error of a seed, in m and rad.

    Returns:
        Joint positions, shape (6, n), in rad; NaN if `refine` returns None.
    """
    found = np.full(seeds.shape, np.nan)
    wrist = geometry.to_wrist
    there: Rigid[FloatArray] = product(targets, geometry.wrist_in_flange)  # type: ignore[arg-type]
    at, q = np.arange(seeds.shape[1]), seeds
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        for n in range(_STEPS):
            frames = chain(wrist, ROWS, angles(q))
            error = _error(frames[5], there)
            size = np.max(np.abs(error), axis=0)
            step = np.where(size > CONVERGED, _step(frames, error), 0.0)
            q = q + step
            length = np.max(np.abs(step), axis=0)
            done = length <= _LAST
            going = ~done & (length <= _TOO_LONG)
            if n == 0:
                close = (size <= within) & (_cosine(frames[5], there) > 0.0)
                done, going = done & close, going & close
            found[:, at[done]] = q[:, done]
            if not going.all():
                at, q, there = at[going], q[:, going], take(there, going)
            if len(at) <= _FEW:
                break
    for i, row in enumerate(at.tolist() if len(at) <= _FEW else []):
        one = refine(geometry, angles(q[:, i].tolist()), row_of(targets, row))
        if one is not None:
            found[:, row] = one
    return found


def _error(flange: Rigid[Number], target: Rigid[Number]) -> Six[Number]:
    """Return the error of the flange in the base frame: distance in m, and rotation axis times sine of its angle."""
    a00, a01, a02, a10, a11, a12, a20, a21, a22, ax, ay, az = flange
    b00, b01, b02, b10, b11, b12, b20, b21, b22, bx, by, bz = target
    # Half the sum of the cross products of the axes of the two frames.
    return (
        bx - ax,
        by - ay,
        bz - az,
        0.5 * (a10 * b20 - a20 * b10 + a11 * b21 - a21 * b11 + a12 * b22 - a22 * b12),
        0.5 * (a20 * b00 - a00 * b20 + a21 * b01 - a01 * b21 + a22 * b02 - a02 * b22),
        0.5 * (a00 * b10 - a10 * b00 + a01 * b11 - a11 * b01 + a02 * b12 - a12 * b02),
    )


def _cosine(flange: Rigid[Number], target: Rigid[Number]) -> Number:
    """Return the cosine of the angle between two orientations, because the sine alone is also 0 for half a turn."""
    a00, a01, a02, a10, a11, a12, a20, a21, a22, _, _, _ = flange
    b00, b01, b02, b10, b11, b12, b20, b21, b22, _, _, _ = target
    trace = a00 * b00 + a01 * b01 + a02 * b02 + a10 * b10 + a11 * b11 + a12 * b12 + a20 * b20 + a21 * b21 + a22 * b22
    return 0.5 * (trace - 1.0)


def _moved(q: Angles[Number], step: Six[Number]) -> Angles[Number]:
    q1, q2, q3, q4, q5, q6 = q
    d1, d2, d3, d4, d5, d6 = step
    return q1 + d1, q2 + d2, q3 + d3, q4 + d4, q5 + d5, q6 + d6


def _step(frames: list[Rigid[Number]], error: Six[Number]) -> Six[Number]:
    """Return the joint motion that moves the wrist by `error`: the inverse of its Jacobian times `error`.

    Joint 6 does not move the wrist, and joint 5 hardly moves it, so these two are eliminated first. Joints 5 and 6
    perform the rotation that remains after the motion of joints 1 to 4. Joints 1 to 4 have to move the wrist, and to
    turn it about the direction m, because joints 5 and 6 cannot turn it about m. The axes of joints 2 to 4 are almost
    parallel. Therefore the unknowns are the motion of joint 2 with joint 4 turning back by the same angle, the motion
    of joint 3 with joint 4 turning back, and the sum of all three joints. The remaining system is three by three, and
    is solved by Cramer's rule. Each of the three divisors is zero in one of the singularities.

    Raises:
        ZeroDivisionError: If the arm is in a singularity (floats only).
    """
    vx, vy, vz, wx, wy, wz = error
    # Axis of each joint (i, j, k) and a point on it; then x, y, z: the movement of the wrist per rad.
    _, _, i2, _, _, j2, _, _, k2, x2, y2, z2 = frames[0]
    _, _, i3, _, _, j3, _, _, k3, x3, y3, z3 = frames[1]
    _, _, i4, _, _, j4, _, _, k4, x4, y4, z4 = frames[2]
    _, _, i5, _, _, j5, _, _, k5, x5, y5, z5 = frames[3]
    _, _, i6, _, _, j6, _, _, k6, px, py, pz = frames[4]
    x2, y2, z2, x3, y3, z3 = px - x2, py - y2, pz - z2, px - x3, py - y3, pz - z3
    x4, y4, z4, x5, y5, z5 = px - x4, py - y4, pz - z4, px - x5, py - y5, pz - z5
    x2, y2, z2 = j2 * z2 - k2 * y2, k2 * x2 - i2 * z2, i2 * y2 - j2 * x2
    x3, y3, z3 = j3 * z3 - k3 * y3, k3 * x3 - i3 * z3, i3 * y3 - j3 * x3
    x4, y4, z4 = j4 * z4 - k4 * y4, k4 * x4 - i4 * z4, i4 * y4 - j4 * x4
    x5, y5, z5 = j5 * z5 - k5 * y5, k5 * x5 - i5 * z5, i5 * y5 - j5 * x5
    # Joints 5 and 6: f times an angular velocity is the share of joint 5.
    mx, my, mz = j5 * k6 - k5 * j6, k5 * i6 - i5 * k6, i5 * j6 - j5 * i6
    square = mx * mx + my * my + mz * mz
    fx, fy, fz = (j6 * mz - k6 * my) / square, (k6 * mx - i6 * mz) / square, (i6 * my - j6 * mx) / square
    share = fx * wx + fy * wy + fz * wz
    share2, share3 = fx * i2 + fy * j2 + fz * k2, fx * i3 + fy * j3 + fz * k3
    share4 = fx * i4 + fy * j4 + fz * k4
    vx, vy, vz = vx - share * x5, vy - share * y5, vz - share * z5
    x1, y1, z1 = -fz * x5 - py, -fz * y5 + px, -fz * z5
    x4, y4, z4 = x4 - share4 * x5, y4 - share4 * y5, z4 - share4 * z5
    # Joints 2 and 3, with joint 4 turning back.
    x2, y2, z2 = x2 - share2 * x5 - x4, y2 - share2 * y5 - y4, z2 - share2 * z5 - z4
    x3, y3, z3 = x3 - share3 * x5 - x4, y3 - share3 * y5 - y4, z3 - share3 * z5 - z4
    m4 = mx * i4 + my * j4 + mz * k4
    m2, m3 = mx * i2 + my * j2 + mz * k2 - m4, mx * i3 + my * j3 + mz * k3 - m4
    # Joints 1 to 3: a, b and c times a velocity of the wrist are their shares; h is their rotation about m.
    ax, ay, az = y2 * z3 - z2 * y3, z2 * x3 - x2 * z3, x2 * y3 - y2 * x3
    volume = x1 * ax + y1 * ay + z1 * az
    ax, ay, az = ax / volume, ay / volume, az / volume
    x1, y1, z1 = x1 / volume, y1 / volume, z1 / volume
    bx, by, bz = y3 * z1 - z3 * y1, z3 * x1 - x3 * z1, x3 * y1 - y3 * x1
    cx, cy, cz = y1 * z2 - z1 * y2, z1 * x2 - x1 * z2, x1 * y2 - y1 * x2
    hx, hy, hz = mz * ax + m2 * bx + m3 * cx, mz * ay + m2 * by + m3 * cy, mz * az + m2 * bz + m3 * cz
    d234 = (mx * wx + my * wy + mz * wz - hx * vx - hy * vy - hz * vz) / (m4 - hx * x4 - hy * y4 - hz * z4)
    vx, vy, vz = vx - d234 * x4, vy - d234 * y4, vz - d234 * z4
    d1 = ax * vx + ay * vy + az * vz
    d2 = bx * vx + by * vy + bz * vz
    d3 = cx * vx + cy * vy + cz * vz
    d4 = d234 - d2 - d3
    # Joints 5 and 6 perform the remaining rotation.
    wx, wy, wz = (
        wx - d2 * i2 - d3 * i3 - d4 * i4,
        wy - d2 * j2 - d3 * j3 - d4 * j4,
        wz - d2 * k2 - d3 * k3 - d4 * k4 - d1,
    )
    d5 = fx * wx + fy * wy + fz * wz
    d6 = i6 * wx + j6 * wy + k6 * wz - d5 * (i5 * i6 + j5 * j6 + k5 * k6)
    return d1, d2, d3, d4, d5, d6


def refine_anywhere(geometry: Geometry, seed: Angles[float], target: Rigid[float]) -> Angles[float] | None:
    """Return joint positions that put the flange at `target`, even in a singularity; None if the search fails.

    The search starts at `seed`, and uses the Levenberg-Marquardt method: least squares with a penalty on long steps.
    The penalty grows while steps do not reduce the error. Close to a singular wrist, the minimum is at the end of a
    narrow curved valley, in which joints 4 and 6 turn against each other and the others follow. Therefore each step is
    corrected by the second derivative along it (Transtrum and Sethna, "Improvements to the Levenberg-Marquardt
    algorithm for nonlinear least-squares minimization", 2012).
    """
    q = np.array(seed)
    error, matrix = _linearised(geometry, q, target)
    size = float(np.linalg.norm(error))
    damping = 0.01 * size
    slow = 0
    for _ in range(_ROBUST_STEPS):
        if size < CONVERGED:
            return angles(q.tolist())
        u, s, vt = np.linalg.svd(matrix)
        pseudo_inverse = (vt.T * (s / (s * s + damping * damping))) @ u.T
        step = pseudo_inverse @ error
        step *= min(1.0, _LONGEST / float(np.abs(step).max()))
        ahead, _ = _linearised(geometry, q + _AHEAD * step, target)
        bend = pseudo_inverse @ (matrix @ step - (error - ahead) / _AHEAD) / _AHEAD
        tried, new_matrix = _linearised(geometry, q + step + bend, target)
        new_size = float(np.linalg.norm(tried))
        if np.linalg.norm(bend) > _BENT * np.linalg.norm(step) or not new_size < size:
            damping = max(4.0 * damping, 1e-12)
            if damping > 1.0:
                return None
            continue
        slow = slow + 1 if new_size > 0.99 * size else 0
        if slow == _SLOW:
            return None
        q, error, matrix, size = q + step + bend, tried, new_matrix, new_size
        damping = min(0.2 * damping, size)
    return None


def error_at(
    geometry: Geometry, q: Angles[Number], f: MathFunctions[Number], target: Rigid[Number]
) -> tuple[Number, ...]:
    """Return the error of the flange at `q`: distance in m, axis times sine of the angle, and 1 - cosine."""
    frames = chain(geometry, f, q)
    vx, vy, vz, wx, wy, wz = _error(frames[5], target)
    return vx, vy, vz, wx, wy, wz, 1.0 - _cosine(frames[5], target)


def _linearised(geometry: Geometry, q: FloatArray, target: Rigid[float]) -> tuple[FloatArray, FloatArray]:
    """Return the error of the flange, in m and rad, and the Jacobian of this error."""
    frames = chain(geometry, FLOATS, angles(q.tolist()))
    flange = frames[5]
    error = np.array(_error(flange, target))
    cosine = _cosine(flange, target)
    sine = float(np.linalg.norm(error[3:]))
    if sine > 0.0:
        error[3:] *= math.atan2(sine, cosine) / sine
    elif cosine < 0.0:
        error[3:] = math.pi, 0.0, 0.0
    return error, np.array(jacobian(frames, flange[9:])).T

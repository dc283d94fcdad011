"""Joint positions of a calibrated arm, from those of the published arm that is closest to it.

The closed form is exact for published arms only. For a calibrated arm it is off by some 0.1 mm to 1 mm. From there,
each step measures by how much the flange misses the pose and moves the joints by what would make up for it on an arm
whose axes 2, 3 and 4 are parallel and whose other twists are right angles. Such a Jacobian is inverted by hand; it
misses that of the true arm by as much as its axes are tilted, some mrad. So it is applied twice: what the first step
leaves, by the true Jacobian, is what the second one is for. Close to a singularity this does not converge: there
`refine_anywhere` takes over, which is slower.
"""

from __future__ import annotations

import math

import numpy as np

from ..rigid import FLOATS, ROWS, FloatArray, Functions, Number, Rigid, Six, take
from ..rigid import row as row_of
from .geometry import Angles, Geometry, chain, jacobian

__all__ = ["error_at", "refine", "refine_anywhere", "refine_rows"]

#: m and rad. What may be left of the error when joint positions are taken for a solution.
CONVERGED = 5e-14
# About the second derivatives of the flange's position and orientation: what a Newton step of 1 rad may leave, m. Where
# it is too small, what is left may be ten times as much as it should be, and still less than 1e-12.
_CURVATURE = 2.0
# While the error is larger, its square is more of what a step leaves than the tilt of the axes.
_COARSE = 1e-4
# More steps than this are needed only where they do not converge.
_STEPS = 8
# Steps that are longer, rad, or leave more of the error are for `refine_anywhere`.
_TOO_LONG, _TOO_LITTLE = 0.5, 0.1

# So few rows are quicker one by one: a step of rows takes some hundred calls into numpy, however few there are.
_FEW = 8

# Of `refine_anywhere`: the most steps; the largest step of a joint, rad; how far ahead the second derivative is
# measured, in steps; the most that a step may be bent, in its length; and how many steps in a row may gain less than a
# percent.
_ROBUST_STEPS = 100
_LONGEST = 0.5
_AHEAD = 0.1
_BENT = 0.75
_SLOW = 5


def refine(geometry: Geometry, seed: Angles[float], target: Rigid[float]) -> Angles[float] | None:
    """The joint positions close to `seed` that put the flange at `target`; None where the steps do not converge."""
    q = seed
    for _ in range(_STEPS):
        frames = chain(geometry, FLOATS, q)
        error = _error(frames[5], target)
        size = max(map(abs, error))
        if size <= CONVERGED:
            return q
        try:
            if size > _COARSE:
                q = _moved(q, _step(frames, error))
                continue
            step, left = _newton(frames, error)
        except ZeroDivisionError:
            return None
        q = _moved(q, step)
        length, rest = max(map(abs, step)), max(map(abs, left))
        if _CURVATURE * length * length + rest <= CONVERGED:
            return q
        if length > _TOO_LONG or rest > _TOO_LITTLE * size:
            return None
    return None


def refine_rows(geometry: Geometry, seeds: FloatArray, targets: Rigid[FloatArray]) -> FloatArray:
    """The same for n seeds.

    Args:
        seeds: (6, n) rad.
        targets: n transforms.

    Returns:
        (6, n) rad, NaN where the steps do not converge.
    """
    found = np.full(seeds.shape, np.nan)
    at, q = np.arange(seeds.shape[1]), seeds
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        for n in range(_STEPS):
            frames = chain(geometry, ROWS, _angles(q))
            error = _error(frames[5], targets)
            size = np.max(np.abs(error), axis=0)
            there = size <= CONVERGED
            found[:, at[there]] = q[:, there]
            if n == 0 and (size > _COARSE).any():
                q = np.where(there, q, q + _step(frames, error))
                continue
            step, left = _newton(frames, error)
            q = q + step
            length, rest = (np.max(np.abs(six), axis=0) for six in (step, left))
            done = ~there & (_CURVATURE * length * length + rest <= CONVERGED)
            found[:, at[done]] = q[:, done]
            going = ~there & ~done & (length <= _TOO_LONG) & (rest <= _TOO_LITTLE * size)
            at, q, targets = at[going], q[:, going], take(targets, going)
            if len(at) <= _FEW:
                break
    for i, row in enumerate(at.tolist() if len(at) <= _FEW else []):
        q1, q2, q3, q4, q5, q6 = q[:, i].tolist()
        one = refine(geometry, (q1, q2, q3, q4, q5, q6), row_of(targets, i))
        if one is not None:
            found[:, row] = one
    return found


def _angles(q: FloatArray) -> Angles[FloatArray]:
    q1, q2, q3, q4, q5, q6 = q
    return q1, q2, q3, q4, q5, q6


def _error(flange: Rigid[Number], target: Rigid[Number]) -> Six[Number]:
    """From the flange to the target, in the base frame: the distance, m, and the sine of the angle, along its axis."""
    a00, a01, a02, a10, a11, a12, a20, a21, a22, ax, ay, az = flange
    b00, b01, b02, b10, b11, b12, b20, b21, b22, bx, by, bz = target
    # Half the sum of the cross products of the axes of the one with those of the other.
    return (
        bx - ax,
        by - ay,
        bz - az,
        0.5 * (a10 * b20 - a20 * b10 + a11 * b21 - a21 * b11 + a12 * b22 - a22 * b12),
        0.5 * (a20 * b00 - a00 * b20 + a21 * b01 - a01 * b21 + a22 * b02 - a02 * b22),
        0.5 * (a00 * b10 - a10 * b00 + a01 * b11 - a11 * b01 + a02 * b12 - a12 * b02),
    )


def _cosine(flange: Rigid[Number], target: Rigid[Number]) -> Number:
    """Of the angle between two orientations; the sine is as small for half a turn as for none."""
    a00, a01, a02, a10, a11, a12, a20, a21, a22, _, _, _ = flange
    b00, b01, b02, b10, b11, b12, b20, b21, b22, _, _, _ = target
    trace = a00 * b00 + a01 * b01 + a02 * b02 + a10 * b10 + a11 * b11 + a12 * b12 + a20 * b20 + a21 * b21 + a22 * b22
    return 0.5 * (trace - 1.0)


def _moved(q: Angles[Number], step: Six[Number]) -> Angles[Number]:
    q1, q2, q3, q4, q5, q6 = q
    d1, d2, d3, d4, d5, d6 = step
    return q1 + d1, q2 + d2, q3 + d3, q4 + d4, q5 + d5, q6 + d6


def _newton(frames: list[Rigid[Number]], error: Six[Number]) -> tuple[Six[Number], Six[Number]]:
    """How to move the joints for the flange to move by `error`; and what of it is left to the first order.

    Raises:
        ZeroDivisionError: in a singularity (floats only).
    """
    first = _step(frames, error)
    left = _left(frames, error, first)
    second = _step(frames, left)
    return _moved(first, second), _left(frames, left, second)


def _left(frames: list[Rigid[Number]], error: Six[Number], step: Six[Number]) -> Six[Number]:
    """What of `error` is left when the joints move by `step`, as far as the Jacobian goes."""
    vx, vy, vz, wx, wy, wz = error
    _, _, _, _, _, _, _, _, _, px, py, pz = frames[5]
    d1 = step[0]
    vx, vy, wz = vx + d1 * py, vy - d1 * px, wz - d1
    for d, (_, _, zx, _, _, zy, _, _, zz, ox, oy, oz) in zip(step[1:], frames, strict=False):
        zx, zy, zz = d * zx, d * zy, d * zz
        lx, ly, lz = px - ox, py - oy, pz - oz
        vx, vy, vz = vx - (zy * lz - zz * ly), vy - (zz * lx - zx * lz), vz - (zx * ly - zy * lx)
        wx, wy, wz = wx - zx, wy - zy, wz - zz
    return vx, vy, vz, wx, wy, wz


def _step(frames: list[Rigid[Number]], error: Six[Number]) -> Six[Number]:
    """How to move the joints for the flange to move by `error`, as if the axes 2, 3 and 4 were parallel.

    Where the axes 5 and 6 meet, at the origin of frame 5, only joints 1 to 4 move anything, and joints 2 to 4 do so in
    the plane of the arm. So one joint after the other follows. Each of the three divisions is one of the singularities.

    Raises:
        ZeroDivisionError: in a singularity (floats only).
    """
    vx, vy, vz, wx, wy, wz = error
    _, _, nx, _, _, ny, _, _, nz, x1, y1, z1 = frames[0]
    _, _, _, _, _, _, _, _, _, x2, y2, z2 = frames[1]
    _, _, _, _, _, _, _, _, _, x3, y3, z3 = frames[2]
    _, _, ax, _, _, ay, _, _, az, _, _, _ = frames[3]
    _, _, bx, _, _, by, _, _, bz, x5, y5, z5 = frames[4]
    _, _, _, _, _, _, _, _, _, x6, y6, z6 = frames[5]
    # The velocity of the origin of frame 5.
    lx, ly, lz = x5 - x6, y5 - y6, z5 - z6
    vx, vy, vz = vx + wy * lz - wz * ly, vy + wz * lx - wx * lz, vz + wx * ly - wy * lx
    # Joint 1: what goes along the normal n of the plane of the arm, the axis of joint 2.
    d1 = (nx * vx + ny * vy + nz * vz) / (ny * x5 - nx * y5)
    vx, vy, wz = vx + d1 * y5, vy - d1 * x5, wz - d1
    # Joints 5 and 6, with the axes a and b, and the sum of joints 2 to 4, about n. u = n x a is upright to n and a.
    ux, uy, uz = ny * az - nz * ay, nz * ax - nx * az, nx * ay - ny * ax
    d6 = (ux * wx + uy * wy + uz * wz) / (ux * bx + uy * by + uz * bz)
    wx, wy, wz = wx - d6 * bx, wy - d6 * by, wz - d6 * bz
    d5 = ax * wx + ay * wy + az * wz
    d234 = nx * wx + ny * wy + nz * wz
    # Turned about the origin of frame 3 by that sum; the rest is for the triangle of the arm links.
    lx, ly, lz = x5 - x3, y5 - y3, z5 - z3
    vx, vy, vz = vx - d234 * (ny * lz - nz * ly), vy - d234 * (nz * lx - nx * lz), vz - d234 * (nx * ly - ny * lx)
    fx, fy, fz = x3 - x1, y3 - y1, z3 - z1
    gx, gy, gz = x3 - x2, y3 - y2, z3 - z2
    area = nx * (fy * gz - fz * gy) + ny * (fz * gx - fx * gz) + nz * (fx * gy - fy * gx)
    d2 = (vx * gx + vy * gy + vz * gz) / area
    d3 = -(vx * fx + vy * fy + vz * fz) / area
    return d1, d2, d3, d234 - d2 - d3, d5, d6


def refine_anywhere(geometry: Geometry, seed: Angles[float], target: Rigid[float]) -> Angles[float] | None:
    """Joint positions that put the flange at `target`, also in a singularity; None where `seed` leads to none.

    Levenberg-Marquardt: least squares in which long steps cost, the more, the less the last one helped. Close to a
    singular wrist the search goes along a narrow bent valley, in which joints 4 and 6 turn against each other and the
    others follow; so each step is bent by the second derivative along it (Transtrum and Sethna, "Improvements to the
    Levenberg-Marquardt algorithm for nonlinear least-squares minimization", 2012).
    """
    q = np.array(seed)
    error, matrix = _linearised(geometry, q, target)
    size = float(np.linalg.norm(error))
    damping = 0.01 * size
    slow = 0
    for _ in range(_ROBUST_STEPS):
        if size < CONVERGED:
            q1, q2, q3, q4, q5, q6 = q.tolist()
            return q1, q2, q3, q4, q5, q6
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


def error_at(geometry: Geometry, q: Angles[Number], f: Functions[Number], target: Rigid[Number]) -> tuple[Number, ...]:
    """By how much the flange misses a pose: the error, m and the sine of the angle, and 1 - the cosine of the angle."""
    frames = chain(geometry, f, q)
    vx, vy, vz, wx, wy, wz = _error(frames[5], target)
    return vx, vy, vz, wx, wy, wz, 1.0 - _cosine(frames[5], target)


def _linearised(geometry: Geometry, q: FloatArray, target: Rigid[float]) -> tuple[FloatArray, FloatArray]:
    """The error and the Jacobian of the flange."""
    q1, q2, q3, q4, q5, q6 = q.tolist()
    frames = chain(geometry, FLOATS, (q1, q2, q3, q4, q5, q6))
    flange = frames[5]
    error = np.array(_error(flange, target))
    cosine = _cosine(flange, target)
    sine = float(np.linalg.norm(error[3:]))
    if sine > 0.0:
        error[3:] *= math.atan2(sine, cosine) / sine
    elif cosine < 0.0:
        error[3:] = math.pi, 0.0, 0.0
    return error, np.array(jacobian(frames, flange[9:])).T

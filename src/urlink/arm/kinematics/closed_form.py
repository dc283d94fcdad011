"""Joint positions that put the flange of a published UR arm at a pose, in closed form.

An arm has up to eight solutions for a pose. These solutions are called branches: shoulder left or right, wrist flipped
or not, elbow up or down. The solution is the classic geometric one for arms with parallel axes of joints 2, 3 and 4.
The position of the wrist determines joint 1, the orientation determines joints 5 and 6, and the triangle of the two
arm links determines joints 2 and 3.

An arm has three singularities. In the first, the wrist is on a cylinder of radius d4 about the axis of the base, and
joint 1 is not determined. In the second, the axes of joints 4 and 6 are parallel, and joint 6 is not determined. In the
third, the arm is stretched or folded, and two branches meet. `solve` handles all three, one pose at a time.
`solve_rows` computes many poses at once, and marks poses that are too close to the second singularity for its formulas.
"""

from __future__ import annotations

import math

import numpy as np

from ..rigid import FLOATS, ROWS, MathFunctions, Number, Rigid
from ..vectors import FloatArray
from .geometry import Angles, Lengths

#: Number of branches.
BRANCHES = 8

# Orientation error, in rad, that is accepted so that joint 6 can have the wanted angle. Exactly in the wrist
# singularity, every angle is within this error.
SLACK = 1e-13
# A pose that is beyond the edge of the reach by at most this relative distance counts as on the edge, because of
# rounding errors.
_EDGE = 1e-13
# With `is_loose`: the relative distance beyond the edge, and the largest cosine of joint 3. A calibrated arm differs
# from the published arm by a few mm and mrad, which is a hundredth of its reach.
_LOOSE_EDGE = 0.05
_ALMOST_STRAIGHT = 0.999
# `solve_rows` does not solve rows with a sine of joint 5 below this; they need `solve`. At 1e-4, joint 6 is known to
# 1e-12 rad. This error is too small to change whether the arm reaches the pose.
SINGULAR = 1e-4


def solve(
    lengths: Lengths, target: Rigid[float], free_q6: float = 0.0, *, slack: float = SLACK, is_loose: bool = False
) -> list[Angles[float] | None]:
    """Return the eight branches that put the flange at `target`, in rad, not wrapped; None if out of reach.

    Args:
        lengths: Lengths of the arm, in m.
        target: Pose of the flange in the base frame.
        free_q6: Angle of joint 6, in rad, for poses in the wrist singularity. If the wrist is out of reach with this
            angle, the closest angle within reach is used.
        slack: Orientation error, in rad, that is accepted so that joint 6 can have this angle.
        is_loose: Whether to return also branches that are slightly out of reach. An elbow that is almost straight is
            then bent a little. Such branches are seeds of the search for a calibrated arm, because its reach differs
            slightly.

    Returns:
        Branches in the order of `Arm.branches`. If two branches meet in a singularity, both are given.
    """
    d1, a2, a3, d4, d5, _ = lengths
    r00, r01, _, r10, r11, _, r20, r21, _, _, _, _ = target
    found: list[Angles[float] | None] = []
    x5, y5, z5 = wrist_place(lengths, target)
    margin, straight = (_LOOSE_EDGE, _ALMOST_STRAIGHT) if is_loose else (_EDGE, 1.0)
    if x5 * x5 + y5 * y5 < d4 * d4 * (1.0 - margin):
        return [None] * BRANCHES  # the wrist is too close to the axis of the base
    for q1 in _shoulder(FLOATS, d4, x5, y5, margin if is_loose else 0.0):
        s1, c1, out5, up5, nx, ny, nz, sine = _plane(FLOATS, d1, target, q1, x5, y5, z5)
        q5, q6 = math.atan2(sine, nz), math.atan2(-ny, nx)
        for flip in (1.0, -1.0):
            if flip < 0.0:
                q5, q6 = -q5, math.atan2(ny, -nx)
            shift = wrapped(free_q6 - q6)
            if abs(shift) * sine < slack:
                q6 += shift
                s6, c6 = math.sin(q6), math.cos(q6)
            else:
                s6, c6 = -flip * ny / sine, flip * nx / sine
            # z4 = -y5 = -(s6 x6 + c6 y6) lies in the plane of the arm.
            zx, zy, zz = -(s6 * r00 + c6 * r01), -(s6 * r10 + c6 * r11), -(s6 * r20 + c6 * r21)
            along, across = zx * c1 + zy * s1, zz
            # Joint 6 also moves the origin of frame 4. Turn joint 6, within the slack, so that this origin is within
            # reach of the arm.
            bearing = math.atan2(across, along)
            if sine < SINGULAR:
                shift = _into_reach(bearing, out5, up5, d5, abs(a2) + abs(a3), abs(abs(a2) - abs(a3)))
                if abs(shift) * sine < slack:
                    bearing += shift
                    q6 -= math.copysign(1.0, nz) * shift
                along, across = math.cos(bearing), math.sin(bearing)
            out, up = out5 - d5 * along, up5 - d5 * across
            c3 = (out * out + up * up - a2 * a2 - a3 * a3) / (2.0 * a2 * a3)
            if abs(c3) > 1.0 + margin:
                found += (None, None)  # further than the stretched arm reaches, or closer than the folded arm
                continue
            q234 = bearing + 0.5 * math.pi
            for q2, q3 in _elbow(FLOATS, a2, a3, out, up, max(-straight, min(straight, c3))):
                found.append((q1, q2, q3, q234 - q2 - q3, q5, q6))
    return found


def solve_rows(lengths: Lengths, targets: Rigid[FloatArray], is_loose: bool) -> tuple[FloatArray, FloatArray]:
    """Return the eight branches for each of n poses.

    Args:
        lengths: Lengths of the arm, in m.
        targets: Poses of the flange in the base frame, n transforms.
        is_loose: See `solve`.

    Returns:
        Joint positions, shape (8, 6, n), in rad, not wrapped, in the order of `solve`; NaN if a branch does not reach
        the pose. Also the sine of joint 5, shape (8, n). If this sine is less than `SINGULAR`, the joint positions are
        not valid.
    """
    d1, a2, a3, d4, d5, _ = lengths
    r00, r01, _, r10, r11, _, r20, r21, _, _, _, _ = targets
    margin, straight = (_LOOSE_EDGE, _ALMOST_STRAIGHT) if is_loose else (_EDGE, 1.0)
    x5, y5, z5 = wrist_place(lengths, targets)
    found = np.empty((BRANCHES, 6, len(x5)))
    near = x5 * x5 + y5 * y5 < d4 * d4 * (1.0 - margin)
    sines = np.empty((BRANCHES, len(x5)))
    at = 0
    for q1 in _shoulder(ROWS, d4, x5, y5, margin if is_loose else 0.0):
        s1, c1, out5, up5, nx, ny, nz, sine = _plane(ROWS, d1, targets, q1, x5, y5, z5)
        sines[at : at + 4] = sine
        length = np.where(sine > 0.0, sine, 1.0)
        s6, c6 = -ny / length, nx / length
        zx, zy, zz = -(s6 * r00 + c6 * r01), -(s6 * r10 + c6 * r11), -(s6 * r20 + c6 * r21)
        along, across = d5 * (zx * c1 + zy * s1), d5 * zz
        q5, q6, q234 = np.arctan2(sine, nz), np.arctan2(s6, c6), np.arctan2(zz, zx * c1 + zy * s1) + 0.5 * np.pi
        for flip in (1.0, -1.0):
            out, up = out5 - flip * along, up5 - flip * across
            c3 = (out * out + up * up - (a2 * a2 + a3 * a3)) * (0.5 / (a2 * a3))
            out_of_reach = (np.abs(c3) > 1.0 + margin) | near
            c3 = np.maximum(np.minimum(c3, straight), -straight)
            for q2, q3 in _elbow(ROWS, a2, a3, out, up, c3):
                branch = found[at]
                branch[0], branch[1], branch[2], branch[3] = q1, q2, q3, q234 - q2 - q3
                branch[4], branch[5] = flip * q5, q6
                if out_of_reach.any():
                    branch[:, out_of_reach] = np.nan
                at += 1
            q6, q234 = q6 + np.pi, q234 + np.pi
    return found, sines


def wrist_place(lengths: Lengths, target: Rigid[Number]) -> tuple[Number, Number, Number]:
    """Return the origin of frame 5 in the base frame, in m."""
    d6 = lengths[5]
    _, _, r02, _, _, r12, _, _, r22, px, py, pz = target
    return px - d6 * r02, py - d6 * r12, pz - d6 * r22


def _shoulder(f: MathFunctions[Number], d4: float, x5: Number, y5: Number, apart: float) -> tuple[Number, Number]:
    """Return both solutions of joint 1. The origin of frame 5 is d4 off the plane of the arm, towards (s1, -c1, 0).

    The two solutions meet if this origin is at the distance d4 from the axis of the base. Then `apart` keeps the
    solutions separate by about 2 * `apart` rad.
    """
    bearing = f.atan2(y5, x5)
    lean = f.atan2(d4, f.sqrt(f.positive(x5 * x5 + y5 * y5 - d4 * d4) + (apart * d4) ** 2))
    return bearing + lean, bearing + (math.pi - lean)


def _plane(
    f: MathFunctions[Number], d1: float, target: Rigid[Number], q1: Number, x5: Number, y5: Number, z5: Number
) -> tuple[Number, Number, Number, Number, Number, Number, Number, Number]:
    """Return sine and cosine of joint 1, the origin of frame 5 (two numbers), and the normal of the plane of the arm.

    The origin is in the plane of the arm, relative to the shoulder. The normal is (c6 s5, -s6 s5, c5) in frame 6. The
    last returned number is the length of the first two components of the normal. This length is the sine of joint 5 to
    full precision. An arc cosine of c5 would lose half of the digits.
    """
    r00, r01, r02, r10, r11, r12, _, _, _, _, _, _ = target
    s1, c1 = f.sin(q1), f.cos(q1)
    nx, ny, nz = r00 * s1 - r10 * c1, r01 * s1 - r11 * c1, r02 * s1 - r12 * c1
    return s1, c1, x5 * c1 + y5 * s1, z5 - d1, nx, ny, nz, f.hypot(nx, ny)


def _elbow(
    f: MathFunctions[Number], a2: float, a3: float, out: Number, up: Number, c3: Number
) -> tuple[tuple[Number, Number], tuple[Number, Number]]:
    """Return both branches of joints 2 and 3. The arm links reach from the shoulder to the origin of frame 4."""
    s3 = f.sqrt((1.0 - c3) * (1.0 + c3))
    q3 = f.atan2(s3, c3)
    bearing = f.atan2(up, out)
    # a2 and a3 are negative, so the upper arm points away from (a2 + a3 c3, a3 s3).
    part = f.atan2(a3 * s3, a2 + a3 * c3)
    return (bearing - part, q3), (bearing + part, -q3)


def _into_reach(bearing: float, out: float, up: float, length: float, furthest: float, closest: float) -> float:
    """Return the rotation, in rad, of a link that ends at (out, up) so that its other end is within reach of (0, 0).

    The result is zero if the other end is already within reach. If no rotation moves it within reach, the result is the
    rotation that moves it closest.
    """
    distance = math.hypot(out, up)
    lever = 2.0 * length * distance
    if lever == 0.0:
        return 0.0
    # Law of cosines. The end is closest to (0, 0) when the link points straight away from it.
    squares = length * length + distance * distance
    widest = math.acos(max(-1.0, min(1.0, (squares - furthest * furthest) / lever)))
    narrowest = math.acos(max(-1.0, min(1.0, (squares - closest * closest) / lever)))
    angle = math.remainder(bearing - math.atan2(up, out), math.tau)
    return math.copysign(max(narrowest, min(widest, abs(angle))), angle) - angle


def wrapped(angle: float) -> float:
    """Return the same angle in (-pi, pi]."""
    around = math.remainder(angle, math.tau)
    return math.pi if around <= -math.pi else around

"""Fastest timing of a joint path within limits of speed and acceleration.

The path is divided into short steps of length ds, measured in joint space. At each place between two steps, x is the
square of the speed along the path; y is the same quantity at the next place. In a step, the acceleration along the path
is constant, (y - x) / (2 ds). Joint speeds are the tangent of the path times the square root of x. Joint accelerations
are the tangent times the acceleration along the path, plus the curvature times x or y. So all limits are straight lines
in the plane of x and y.

First, the method goes backwards from the end. At each place, it finds the largest x from which the arm can still come
to rest at the end. Then it goes forwards from the beginning, and accelerates as hard as these values allow. This is the
reachability analysis of Pham and Pham ("A New Approach to Time-Optimal Path Parameterization Based on Reachability
Analysis", IEEE Transactions on Robotics, 2018), which the package toppra implements. This module implements the
analysis again, because this takes only about a hundred lines and avoids a compiled package.

The result is a curve of cubic polynomials through the places. If the path bends much within a step, the accelerations
of the polynomials are higher than planned. In such steps, the limit is lowered, and the path is planned again. If a
limit is still exceeded after some rounds, the whole motion is slowed down. So the final curve is within the limits
everywhere.
"""

from __future__ import annotations

import math

import numpy as np

from linkcore.errors import BadValue

from ...arm.vectors import FloatArray

#: Shortest distance between two places, in rad. A place that is closer to the previous place is left out.
_SHORTEST = 1e-9
#: Fraction of the largest speed of the trajectory, below which the arm counts as at rest at a place.
_RESTING = 1e-6
#: Maximum number of planning rounds, and largest ratio of acceleration to limit at which no further round is needed.
_ROUNDS, _GOOD = 5, 1.005
#: Maximum number of steps of Newton's method in `_largest`. The function is piecewise linear, so two to four steps are
#: usual.
_MOST_STEPS = 50
#: Largest amount, relative to x, by which rounding may make the lower bound of y exceed the upper bound.
_ROUNDING = 1e-12


def retime(
    q: FloatArray, qd: FloatArray, speed: FloatArray, acceleration: FloatArray, closest: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the fastest timing of a path within limits, from rest to rest.

    Args:
        q: Places along the path, shape (n, 6), in rad, close to each other.
        qd: Joint speeds in another timing of the same path, shape (n, 6), in rad/s. The speeds define the direction of
            the path. If all speeds are zero at a place, the arm also stops there in the new timing.
        speed, acceleration: Limits, shape (6,), in rad/s and rad/s².
        closest: Shortest time between two places, in s. Places that would be closer in time are left out.

    Returns:
        Times (m,) in s, places (m, 6) in rad, and joint speeds (m, 6) in rad/s. The cubic curve through these places is
        within the limits.

    Raises:
        BadValue: If the path has no length.
    """
    end = q[-1]
    apart = np.concatenate([[True], np.linalg.norm(np.diff(q, axis=0), axis=1) > _SHORTEST])
    q, qd = q[apart], qd[apart]
    if len(q) < 2:
        raise BadValue("the trajectory does not move, so it cannot be retimed")
    q[-1] = end
    lowered = np.tile(acceleration, (len(q) - 1, 1))
    for _ in range(_ROUNDS):
        if len(q) > 2:
            time, speeds = _fastest(q, qd, speed, lowered)
        else:
            # A single step from rest to rest needs no planning. It is only slowed down until it is within the limits.
            time, speeds = np.array([0.0, closest]), np.zeros_like(q)
        if (np.diff(time) < closest).any():
            kept = _spread(time, closest)
            return retime(q[kept], qd[kept], speed, acceleration, closest)
        fastest, hardest = _peaks(time, q, speeds)
        excess = (hardest / acceleration).max(axis=1)
        if excess.max() < _GOOD:
            break
        lowered = lowered / np.maximum(excess, 1.0)[:, np.newaxis]
    slower = max(math.sqrt(float(excess.max())), float((fastest / speed).max()), 1.0)
    return time * slower, q, speeds / slower


def _spread(time: FloatArray, closest: float) -> list[int]:
    """Return the indices of places that are far enough apart in time, always with the first and the last place."""
    kept = [0]
    for i, t in enumerate(time.tolist()):
        if t - time[kept[-1]] >= closest:
            kept.append(i)
    # Replace the last kept place by the end: it is the end already, or is too close to the end.
    return [0, *kept[1:-1], len(time) - 1]


def _peaks(time: FloatArray, q: FloatArray, qd: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the largest speed and acceleration of the cubic curve in each step, (n - 1, 6)."""
    h = np.diff(time)[:, np.newaxis]
    v0, v1, mean = qd[:-1], qd[1:], np.diff(q, axis=0) / h
    first, last = (6.0 * mean - 4.0 * v0 - 2.0 * v1) / h, (2.0 * v0 + 4.0 * v1 - 6.0 * mean) / h
    # The acceleration of a joint changes linearly in a step. So the speed has an extremum at the place with zero
    # acceleration, if this place is within the step.
    change = last - first
    with np.errstate(divide="ignore", invalid="ignore"):
        peak = v0 - 0.5 * h * first * first / change
    is_within = (first * last < 0.0) & np.isfinite(peak)
    fastest = np.maximum(np.maximum(np.abs(v0), np.abs(v1)), np.where(is_within, np.abs(peak), 0.0))
    return fastest, np.maximum(np.abs(first), np.abs(last))


def _fastest(
    q: FloatArray, qd: FloatArray, speed: FloatArray, acceleration: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the times and the joint speeds at the places.

    The array `acceleration` contains the limits of each step, (n - 1, 6).
    """
    ds = np.linalg.norm(np.diff(q, axis=0), axis=1)
    chord = np.diff(q, axis=0) / ds[:, np.newaxis]
    sizes = np.linalg.norm(qd, axis=1)
    rests = sizes <= _RESTING * sizes.max()
    rests[0] = rests[-1] = True
    tangent = qd / np.where(rests, 1.0, sizes)[:, np.newaxis]
    # At a place where the arm is at rest, the direction of the path is that of the adjacent step.
    before = np.where(rests[:-1, np.newaxis], chord, tangent[:-1])
    after = np.where(rests[1:, np.newaxis], chord, tangent[1:])
    paces = np.sqrt(_squares(ds, before, after, rests, speed, acceleration))
    times = np.concatenate([[0.0], np.cumsum(2.0 * ds / (paces[:-1] + paces[1:]))])
    return times, tangent * paces[:, np.newaxis]


def _squares(
    ds: FloatArray,
    before: FloatArray,
    after: FloatArray,
    rests: np.ndarray[tuple[int], np.dtype[np.bool_]],
    speed: FloatArray,
    acceleration: FloatArray,
) -> FloatArray:
    """Return the square of the speed along the path at each place, as large as the limits permit."""
    count = len(ds)
    with np.errstate(divide="ignore"):
        largest = np.pad(((speed / np.abs(before[1:])) ** 2).min(axis=1), 1)
    largest[rests] = 0.0
    bend = (after - before) / ds[:, np.newaxis]
    # Inequalities a x + b y <= c for each step: limits of joint accelerations at its beginning and at its end.
    ramp_before, ramp_after = before / (2.0 * ds[:, np.newaxis]), after / (2.0 * ds[:, np.newaxis])
    a = np.concatenate([bend - ramp_before, ramp_before - bend, -ramp_after, ramp_after], axis=1)
    b = np.concatenate([ramp_before, -ramp_before, ramp_after + bend, -ramp_after - bend], axis=1)
    c = np.concatenate([acceleration] * 4, axis=1)
    reachable = largest.copy()
    for i in range(count - 1, 0, -1):
        reachable[i] = _largest(a[i], b[i], c[i], reachable[i + 1], largest[i])
    found = np.zeros(count + 1)
    for i in range(count):
        _, (highest, _) = _range(a[i], b[i], c[i], reachable[i + 1], found[i])
        found[i + 1] = max(highest, 0.0)
    return found


def _range(
    a: FloatArray, b: FloatArray, c: FloatArray, end: float, x: float
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the smallest and the largest permitted y for a given x, each with its derivative with respect to x.

    The range of y is limited to 0 to `end`.
    """
    left = c - a * x
    upper, lower = b > 0.0, b < 0.0
    low, high = (0.0, 0.0), (end, 0.0)
    if upper.any():
        highs = left[upper] / b[upper]
        least = int(highs.argmin())
        if highs[least] < end:
            high = float(highs[least]), float(-(a[upper] / b[upper])[least])
    if lower.any():
        lows = left[lower] / b[lower]
        most = int(lows.argmax())
        if lows[most] > 0.0:
            low = float(lows[most]), float(-(a[lower] / b[lower])[most])
    return low, high


def _largest(a: FloatArray, b: FloatArray, c: FloatArray, end: float, x: float) -> float:
    """Return the largest x up to the given value for which at least one y is within the limits.

    The length of the permitted range of y is a concave function of x, and is not negative at x = 0. Newton's method
    starts at the right and comes closer with each step. It needs at most as many steps as there are lines.
    """
    for _ in range(_MOST_STEPS):
        (low, low_slope), (high, high_slope) = _range(a, b, c, end, x)
        if high >= low - _ROUNDING * x:
            return x
        slope = high_slope - low_slope
        if slope >= 0.0:
            break
        x = max(x - (high - low) / slope, 0.0)
    return 0.0

"""The shortest time in which joints can follow a path within limits of speed and acceleration.

The path is cut into short steps of its length, measured in joint space. At each place, x is the square of the speed
along the path. Over a step from x to y the acceleration along it is constant, (y - x) / (2 ds). Joint speeds are the
tangent of the path times the root of x, and joint accelerations the tangent times that acceleration, plus the curvature
times x or y. So all limits are lines in the plane of x and y. From the end backwards, the largest x is found from which
rest can still be reached; then, from the beginning, the arm accelerates as hard as that allows. This is the
reachability analysis of Pham and Pham ("A New Approach to Time-Optimal Path Parameterization Based on Reachability
Analysis", IEEE Transactions on Robotics, 2018), which toppra implements. It is written out here, since it is a hundred
lines and needs no compiled package.

The result is a curve of cubic polynomials through the places. Where the path bends much within a step, these accelerate
harder than planned. There the limit is lowered, and the path is planned again; what is left after some rounds slows the
whole movement down. So the curve itself keeps the limits, everywhere.
"""

from __future__ import annotations

import math

import numpy as np

from linkcore.errors import BadValue

from ...arm.vectors import FloatArray

#: rad; a place that is closer than this to the one before is left out.
_SHORTEST = 1e-9
#: Fraction of the fastest joint speed of the trajectory below which all joints rest at a place.
_RESTING = 1e-6
#: Rounds of planning, and the factor of a limit that is good enough to end them.
_ROUNDS, _GOOD = 5, 1.005
#: Steps of Newton's method for one largest x; it is piecewise linear, and two to four are usual.
_MOST_STEPS = 50
#: Relative rounding error of x within which y counts as in its range.
_ROUNDING = 1e-12


def retime(
    q: FloatArray, qd: FloatArray, speed: FloatArray, acceleration: FloatArray, closest: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The fastest timing of a path within limits, from rest to rest.

    Args:
        q: (n, 6) places along the path, rad, close to each other.
        qd: (n, 6) rad/s in another timing of the same path: they give its direction, and where all are zero, the new
            timing stops as well.
        speed, acceleration: (6,) limits, rad/s and rad/s².
        closest: s; places closer in time than this are left out.

    Returns:
        (m,) times, s, (m, 6) places and (m, 6) joint speeds: the cubic curve through them keeps the limits.

    Raises:
        BadValue: the path has no length.
    """
    end = q[-1]
    apart = np.concatenate([[True], np.linalg.norm(np.diff(q, axis=0), axis=1) > _SHORTEST])
    q, qd = q[apart], qd[apart]
    if len(q) < 2:
        raise BadValue("the trajectory stays where it is: there is nothing to be retimed")
    q[-1] = end
    lowered = np.tile(acceleration, (len(q) - 1, 1))
    for _ in range(_ROUNDS):
        if len(q) > 2:
            time, speeds = _fastest(q, qd, speed, lowered)
        else:
            # One step from rest to rest needs no plan: it is only slowed down to the limits.
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
    """Numbers of the places to keep, which are far enough apart in time; the first and the last always."""
    kept = [0]
    for i, t in enumerate(time.tolist()):
        if t - time[kept[-1]] >= closest:
            kept.append(i)
    # The last of them is the end, or too close to it.
    return [0, *kept[1:-1], len(time) - 1]


def _peaks(time: FloatArray, q: FloatArray, qd: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(n - 1, 6) largest speed and acceleration of the cubic curve in each step."""
    h = np.diff(time)[:, np.newaxis]
    v0, v1, mean = qd[:-1], qd[1:], np.diff(q, axis=0) / h
    first, last = (6.0 * mean - 4.0 * v0 - 2.0 * v1) / h, (2.0 * v0 + 4.0 * v1 - 6.0 * mean) / h
    # Accelerations change linearly, so speeds have their peak where those are zero, if they are within the step.
    change = last - first
    with np.errstate(divide="ignore", invalid="ignore"):
        peak = v0 - 0.5 * h * first * first / change
    is_within = (first * last < 0.0) & np.isfinite(peak)
    fastest = np.maximum(np.maximum(np.abs(v0), np.abs(v1)), np.where(is_within, np.abs(peak), 0.0))
    return fastest, np.maximum(np.abs(first), np.abs(last))


def _fastest(
    q: FloatArray, qd: FloatArray, speed: FloatArray, acceleration: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Times and joint speeds at the places; `acceleration` has limits (n - 1, 6) for each step."""
    ds = np.linalg.norm(np.diff(q, axis=0), axis=1)
    chord = np.diff(q, axis=0) / ds[:, np.newaxis]
    sizes = np.linalg.norm(qd, axis=1)
    rests = sizes <= _RESTING * sizes.max()
    rests[0] = rests[-1] = True
    tangent = qd / np.where(rests, 1.0, sizes)[:, np.newaxis]
    # Beside a rest the direction is that of the step.
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
    """The square of the speed along the path at each place, as large as the limits allow."""
    count = len(ds)
    with np.errstate(divide="ignore"):
        largest = np.pad(((speed / np.abs(before[1:])) ** 2).min(axis=1), 1)
    largest[rests] = 0.0
    bend = (after - before) / ds[:, np.newaxis]
    # Of each step the lines a x + b y <= c: joint accelerations at its beginning, and at its end.
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
    """The least and the largest y at x, from 0 to `end`, each with its slope over x."""
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
    """The largest x, not above the one given, from which some y is within the limits.

    How much of y is left is a concave function of x, and not negative at 0: Newton's method from the right comes closer
    with each step, and gets there after as many steps as there are lines at most.
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

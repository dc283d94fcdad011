"""Speeds and accelerations from sampled positions, without bias in a fit.

A difference quotient is the average of the derivative over some time. A fit that compares this average with the value
of a moment at one time is biased: the average of a short acceleration is smaller. Here the moment is averaged with the
same weights, so both sides of a linear equation stay equal. The weights are a triangle of the half width `WIDTH`, and
the average of an acceleration over it is exactly a second difference of the positions. The time steps may differ.
"""

from __future__ import annotations

import numpy as np

from urlink.tools import FloatArray

#: Half width of the triangle of weights in s, and in time steps if they are long.
WIDTH, _STEPS = 0.04, 2.0


def averaged(times: FloatArray, values: FloatArray) -> FloatArray:
    """Return averages of values.

    Args:
        times: Increasing times, shape (n,), in s.
        values: Values, shape (n, k). They are linear between the rows.
    """
    return _second_difference(times, *_integral(times, *_integral(times, values, None)))


def averaged_speed(times: FloatArray, q: FloatArray) -> FloatArray:
    """Return averages of the derivative of values. The arguments are those of `averaged`."""
    return _second_difference(times, *_integral(times, q, None))


def averaged_acceleration(times: FloatArray, q: FloatArray) -> FloatArray:
    """Return averages of the second derivative of values. The arguments are those of `averaged`."""
    return _second_difference(times, q, None)


def _slopes(times: FloatArray, values: FloatArray) -> FloatArray:
    """Return the derivative in each row, from a parabola through three rows."""
    steps = np.diff(times)[:, np.newaxis]
    rises = np.diff(values, axis=0) / steps
    middle = (rises[:-1] * steps[1:] + rises[1:] * steps[:-1]) / (steps[1:] + steps[:-1])
    return np.concatenate((rises[:1], middle, rises[-1:]))


def _integral(times: FloatArray, values: FloatArray, slopes: FloatArray | None) -> tuple[FloatArray, FloatArray]:
    """Return the integral in each row, and its derivative. With slopes, the values are a cubic polynomial."""
    steps = np.diff(times)[:, np.newaxis]
    parts = 0.5 * steps * (values[1:] + values[:-1])
    if slopes is not None:
        parts = parts + steps**2 / 12.0 * (slopes[:-1] - slopes[1:])
    return np.concatenate((np.zeros((1, values.shape[1])), np.cumsum(parts, axis=0))), values


def _second_difference(times: FloatArray, values: FloatArray, slopes: FloatArray | None) -> FloatArray:
    """Return the second difference of values over `WIDTH`, shape (n, k). Rows near an end repeat the nearest one."""
    slopes = _slopes(times, values) if slopes is None else slopes
    width = min(max(WIDTH, _STEPS * float(np.median(np.diff(times)))), 0.4 * float(times[-1] - times[0]))
    inside = np.flatnonzero((times - times[0] >= width) & (times[-1] - times >= width))
    if not len(inside):
        inside = np.array([len(times) // 2])
    before, after = (_at(times, values, slopes, times[inside] + side * width) for side in (-1.0, 1.0))
    found = (after - 2.0 * values[inside] + before) / width**2
    nearest = np.clip(np.arange(len(times)), inside[0], inside[-1])
    return np.asarray(found[nearest - inside[0]])


def _at(times: FloatArray, values: FloatArray, slopes: FloatArray, at: FloatArray) -> FloatArray:
    """Return values between the rows, from the cubic polynomial through two rows with their slopes."""
    row = np.clip(np.searchsorted(times, at, side="right") - 1, 0, len(times) - 2)
    step = (times[row + 1] - times[row])[:, np.newaxis]
    x = (at - times[row])[:, np.newaxis] / step
    return np.asarray(
        (1.0 + 2.0 * x) * (1.0 - x) ** 2 * values[row]
        + x * (1.0 - x) ** 2 * step * slopes[row]
        + x**2 * (3.0 - 2.0 * x) * values[row + 1]
        + x**2 * (x - 1.0) * step * slopes[row + 1]
    )

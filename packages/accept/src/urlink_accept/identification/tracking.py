"""Identification of lag, noise, offsets, the ramp of programs, and the drift of the controller's clock."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from urlink.tools import FULL_SPEED, Estimate, FloatArray, number

from .intervals import blocks_of, fit, student, within
from .samples import Samples

#: Time in s that an arm needs to settle after a movement.
_SETTLING = 0.12
#: Minimum number of rows, and minimum time in s, of a settled rest that can be used. Time in s of its parts.
_ROWS, _SHORT, _PIECE = 4, 0.08, 1.0
#: Smallest difference of the targets of two rests, in rad.
_APART = 1e-3
#: Smallest relative error of the rate of one ramp. Number of blocks for the drift of a clock.
_RATE_ERROR, _CLOCK_BLOCKS = 1e-5, 20
#: Maximum time between two rows, in s, with which a ramp of 0.16 s can be measured.
_FINE = 0.05


def tracking_lag(samples: Samples) -> Estimate:
    """Return the lag of the actual joints behind their targets, in s."""
    if "actual_q" not in samples or "target_q" in samples.derived:
        return Estimate.unknown("target_q and actual_q in the recording, each measured by itself")
    qd, blocks = samples["target_qd"], blocks_of(samples.is_rest)
    off = samples["actual_q"] - samples["target_q"]
    columns, measured, numbers = [], [], []
    for joint in range(6):
        rows = np.abs(qd[:, joint]) > 10.0 * FULL_SPEED
        if rows.sum() > 30:
            # Offsets at rest and friction of the joint are not a lag.
            others = np.zeros((int(rows.sum()), 12))
            others[:, joint], others[:, 6 + joint] = np.sign(qd[rows, joint]), 1.0
            own = np.column_stack((-qd[rows, joint], others))
            alone = own[:, [0, 1 + joint, 7 + joint]]
            left = off[rows, joint] - alone @ np.linalg.lstsq(alone, off[rows, joint], rcond=None)[0]
            weight = 1.0 / max(float(left.std()), 1e-9)
            columns.append(weight * own)
            measured.append(weight * off[rows, joint])
            numbers.append(blocks[rows])
    if not columns:
        return Estimate.unknown(f"a joint that turns faster than {10.0 * FULL_SPEED} rad/s")
    return fit(np.concatenate(columns), np.concatenate(measured), np.concatenate(numbers)).estimate(0)


def noise(samples: Samples, coulomb: FloatArray) -> dict[str, Estimate]:
    """Return standard deviations, by their names in the table of parameters.

    Args:
        samples: Samples of the recording.
        coulomb: Coulomb friction, shape (6,), in A; used to recognise stiction.
    """
    rests, pieces = list(rests_of(samples)), list(_pieces(samples))
    needs = f"rests of {_SETTLING + _SHORT} s and more, at least two"
    names = ("position_noise", "position_offset", "current_noise_at_rest", "stiction", "force_noise", "torque_noise")
    found = dict.fromkeys(names, Estimate.unknown(needs))
    found["current_noise"] = Estimate.unknown(
        "actual_current and target_current or joint_control_output in the recording"
    )
    if "actual_q" in samples:
        # The targets of a rest are constant, whether they are recorded or not.
        off = samples["actual_q"] - (0.0 if "target_q" in samples.derived else samples["target_q"])
        found["position_noise"] = _deviation(off, pieces, needs)
        if len(rests) > 1 and "target_q" not in samples.derived:
            found["position_offset"] = _spread(np.array([off[rows].mean(axis=0) for rows in rests]))
    # The control current of a CB3 is the measured current, smoothed, so it cannot show the error of the current.
    expected = next((name for name in ("target_current", "joint_control_output") if name in samples), None)
    if expected is not None and "actual_current" in samples:
        off = samples["actual_current"] - samples[expected]
        found["current_noise_at_rest"] = _deviation(off, pieces, needs)
        if len(rests) > 1:
            found["stiction"] = _spread(np.array([off[rows].mean(axis=0) / coulomb for rows in rests]))
        # A joint at rest has less noise, even while other joints move.
        moving = np.abs(samples["target_qd"]) > FULL_SPEED
        found["current_noise"] = Estimate.unknown("an arm that moves")
        if moving.sum() > 30:
            # About zero: the error changes so slowly that its mean in a recording is not known.
            blocks = np.repeat(blocks_of(samples.is_rest)[:, np.newaxis], 6, axis=1)
            found["current_noise"] = _rms(off[moving] ** 2, blocks[moving])
    if "actual_TCP_force" in samples:
        force = samples["actual_TCP_force"]
        found["force_noise"] = _deviation(force[:, :3], pieces, needs)
        found["torque_noise"] = _deviation(force[:, 3:], pieces, needs)
    return found


def start_rate(samples: Samples) -> Estimate:
    """Return the rate, in 1/s, at which the speed scaling of a program rises from 0.

    The rate is computed from movements that start at rest, with the fastest joint of each movement. If the acceleration
    of the joint is a and the speed scaling is s, the speed of the joint after the distance x is s √(2 a x). Therefore s
    can be computed from each row. The ramp begins with the program, but the program might wait before it moves the arm.
    """
    if samples.derived:
        return Estimate.unknown("target_q, target_qd and target_qdd in the recording")
    times, rest = samples["timestamp"], samples.is_rest
    period = float(np.median(np.diff(times)))
    if period > _FINE:
        return Estimate.unknown(f"rows that follow each other within {_FINE} s")
    scaling = samples.get("speed_scaling", np.ones(len(times)))
    rates = []
    for begin in np.flatnonzero(rest[:-1] & ~rest[1:]).tolist():
        rows = slice(begin + 1, min(begin + 1 + int(1.0 / period), len(times)))
        lead = int(np.argmax(np.abs(samples["target_qd"][rows]).max(axis=0)))
        distance = np.abs(samples["target_q"][rows, lead] - samples["target_q"][begin, lead])
        speed, push = np.abs(samples["target_qd"][rows, lead]), np.abs(samples["target_qdd"][rows, lead])
        rate = _rate_of(times[rows] - times[begin], distance, speed, push, float(np.median(scaling[rows])))
        if rate is not None:
            rates.append(rate)
    if len(rates) < 2:
        return Estimate.unknown("two programs that each begin with a movej over 0.3 rad or more")
    rates_ = np.array(rates)
    middle = float(np.median(rates_))
    # Ramps of a computed target might be equal, but an interval must have a width.
    spread = max(1.4826 * float(np.median(np.abs(rates_ - middle))), _RATE_ERROR * middle)
    half = student(len(rates) - 1) * spread / np.sqrt(len(rates))
    return Estimate(middle, middle - half, middle + half)


def _rate_of(t: FloatArray, distance: FloatArray, speed: FloatArray, push: FloatArray, scale: float) -> float | None:
    """Return the rate of one ramp up to a speed scaling; None if the movement is too short to show it."""
    expected = scale / number("start_rate")
    top = int(np.argmax(speed))
    t, distance, speed, push = t[:top], distance[:top], speed[:top], push[:top]
    if top < 5 or t[-1] < 1.6 * expected:
        return None
    steady = (t > 1.3 * expected) & (np.abs(push - np.median(push[t > 1.3 * expected])) < 0.02 * push.max())
    if steady.sum() < 3 or np.ptp(speed[steady]) <= 0.0:
        return None
    a = float(np.polyfit(t[steady], speed[steady], 1)[0])
    if a <= 0.0 or abs(a - np.median(push[steady])) > 0.05 * a:
        return None
    reached = speed / np.sqrt(2.0 * a * np.maximum(distance, 1e-12))
    ramp = (reached > 0.3) & (np.arange(top) < np.argmax(reached > 0.9))
    if ramp.sum() < 3:
        return None
    rate = scale * float(np.polyfit(t[ramp], reached[ramp], 1)[0])
    return rate if rate > 0.0 else None


def clock_drift(samples: Samples) -> Estimate:
    """Return the drift of the controller's clock relative to the computer's clock, as a fraction.

    The drift is positive if the clock of the controller is faster.
    """
    if samples.arrival is None:
        return Estimate.unknown("arrival times, as recordings contain them")
    arrival, times = samples.arrival - samples.arrival[0], samples["timestamp"] - samples["timestamp"][0]
    if arrival[-1] < 5.0:
        return Estimate.unknown("5 s of recording")
    blocks = np.arange(len(times)) * _CLOCK_BLOCKS // len(times)
    found = fit(np.column_stack((arrival, np.ones(len(arrival)))), times, blocks).estimate(0)
    return Estimate(found.value - 1.0, found.low - 1.0, found.high - 1.0)


def rests_of(samples: Samples) -> Iterator[slice]:
    """Yield the rows of each rest, without the rows in which the arm settles."""
    times, rest = samples["timestamp"], samples.is_rest
    # If rows were left out, two rests may follow each other.
    places = np.flatnonzero(rest[1:] & rest[:-1] & (np.abs(np.diff(samples["target_q"], axis=0)).max(axis=1) > _APART))
    edges = np.flatnonzero(np.diff(np.concatenate(([False], rest, [False])).astype(int)))
    spans = np.sort(np.concatenate((edges, places + 1, places + 1))).reshape(-1, 2)
    for begin, end in spans.tolist():
        # A recording may begin while the arm settles.
        settled = begin + int(np.searchsorted(times[begin:end], times[begin] + _SETTLING))
        if end - settled >= _ROWS and times[end - 1] - times[settled] >= _SHORT:
            yield slice(settled, end)


def _pieces(samples: Samples) -> Iterator[slice]:
    """Yield parts of the rests, of 1 s or less, so that a slow drift is not noise."""
    times = samples["timestamp"]
    for rows in rests_of(samples):
        count = max(int((times[rows.stop - 1] - times[rows.start]) / _PIECE), 1)
        edges = np.linspace(rows.start, rows.stop, count + 1).astype(int)
        yield from map(slice, edges[:-1].tolist(), edges[1:].tolist())


def _deviation(values: FloatArray, pieces: list[slice], needs: str) -> Estimate:
    """Return the standard deviation within the pieces, about a line in each column.

    Pieces with an unusual deviation are left out, such as a rest in which a person touched the arm.
    """
    if len(pieces) < 2:
        return Estimate.unknown(needs)
    found, free = np.zeros(len(pieces)), np.zeros(len(pieces))
    for i, rows in enumerate(pieces):
        part = values[rows]
        line = np.column_stack((np.ones(len(part)), np.arange(len(part))))
        left = part - line @ np.linalg.lstsq(line, part, rcond=None)[0]
        free[i] = left.size - 2 * left.shape[1]
        found[i] = float((left**2).sum()) / free[i]
    logs = 0.5 * np.log(np.maximum(found, 1e-300))
    # Even equal pieces differ by this much.
    least = 1.0 / np.sqrt(2.0 * free)
    away = np.abs(logs - np.median(logs))
    usual = away <= 3.0 * np.maximum(1.4826 * np.median(away), least)
    value = float(np.sqrt((free * found)[usual].sum() / free[usual].sum()))
    count = int(usual.sum())
    spread = float(np.std(logs[usual])) / np.sqrt(max(count - 1, 1))
    half = student(count - 1) * max(spread, float((2.0 * free[usual].sum()) ** -0.5))
    return Estimate(value, value * float(np.exp(-half)), value * float(np.exp(half)))


def _spread(means: FloatArray) -> Estimate:
    """Return the root mean square of the means of all rests, shape (rests, k)."""
    return _rms((means**2).mean(axis=1), np.arange(len(means)))


def _rms(squares: FloatArray, blocks: NDArray[np.int_]) -> Estimate:
    """Return the root of a mean of squares, with its interval from the blocks."""
    found = fit(np.ones((len(squares), 1)), squares, blocks)
    # The interval is that of the logarithm, because a deviation is positive.
    value, *halves = 0.5 * np.log(np.maximum(np.concatenate((found.factors, found.halves[:, 0])), 1e-300))
    logs = within(float(value), np.array(halves), found.blocks)
    return Estimate(float(np.exp(logs.value)), float(np.exp(logs.low)), float(np.exp(logs.high)))

"""Identification of lag, noise, offsets, the ramp of programs, and the drift of the controller's clock."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from urlink.tools import FULL_SPEED, Estimate, FloatArray, number

from .joints import fit
from .samples import Samples

#: Time in s that an arm needs to settle after a movement.
_SETTLING = 0.3
#: Minimum number of rows of a rest that can be used.
_ROWS = 8
#: Maximum time in s between two rows that still show a ramp of 0.16 s.
_FINE = 0.05


def tracking_lag(samples: Samples) -> Estimate:
    """Return the lag of the actual joints behind their targets, in s."""
    if "actual_q" not in samples:
        return Estimate.unknown("actual_q in the recording")
    qd = samples["target_qd"]
    off = samples["actual_q"] - samples["target_q"]
    found = []
    for joint in range(6):
        rows = np.abs(qd[:, joint]) > 10.0 * FULL_SPEED
        if rows.sum() > 30:
            columns = np.column_stack((-qd[rows, joint], np.sign(qd[rows, joint]), np.ones(rows.sum())))
            factors, covariance, _ = fit(columns, off[rows, joint])
            found.append((factors[0], max(covariance[0, 0], 1e-18)))
    if not found:
        return Estimate.unknown(f"a joint that turns faster than {10.0 * FULL_SPEED} rad/s")
    values, variances = np.array(found).T
    weights = 1.0 / variances
    mean = float((weights * values).sum() / weights.sum())
    # Widen the interval if the joints differ by more than their noise.
    among = float(np.std(values)) / np.sqrt(len(values))
    return Estimate.around(mean, max(float(weights.sum() ** -0.5), among))


def noise(samples: Samples, coulomb: FloatArray) -> dict[str, Estimate]:
    """Return standard deviations, by their names in the table of parameters, and the offset of the force at rest.

    Args:
        samples: Samples of the recording.
        coulomb: Coulomb friction, shape (6,), in A, which identifies stiction.
    """
    rests = list(_rests(samples))
    needs = f"two rests of {_SETTLING} s and more"
    names = ("position_noise", "position_offset", "current_noise_at_rest", "stiction", "force_noise", "torque_noise")
    found = dict.fromkeys(names, Estimate.unknown(needs))
    if "actual_q" in samples and rests:
        off = samples["actual_q"] - samples["target_q"]
        found["position_noise"] = _deviation([off[rows] for rows in rests])
        if len(rests) > 1:
            found["position_offset"] = _spread(np.array([off[rows].mean(axis=0) for rows in rests]).ravel())
    # The control current of a CB3 is the measured current, smoothed, so it cannot show the error of the current.
    expected = next((name for name in ("target_current", "joint_control_output") if name in samples), None)
    if expected is not None and "actual_current" in samples:
        off = samples["actual_current"] - samples[expected]
        if rests:
            found["current_noise_at_rest"] = _deviation([off[rows] for rows in rests])
        if len(rests) > 1:
            found["stiction"] = _spread(np.array([off[rows].mean(axis=0) / coulomb for rows in rests]).ravel())
        # A joint that is held while others move has the error of its stiction instead.
        moving = np.abs(samples["target_qd"]) > FULL_SPEED
        parts = [off[rows, joint][:, None] for joint, rows in enumerate(moving.T) if rows.sum() > 30]
        found["current_noise"] = (
            _spread(np.concatenate(parts).ravel()) if parts else Estimate.unknown("an arm that moves")
        )
    if "actual_TCP_force" in samples and rests:
        force = samples["actual_TCP_force"]
        found["force_noise"] = _deviation([force[rows, :3] for rows in rests])
        found["torque_noise"] = _deviation([force[rows, 3:] for rows in rests])
    return found


def start_rate(samples: Samples) -> Estimate:
    """Return the rate in 1/s at which the scaling of a program rises from 0, from movements that start at rest.

    The fastest joint of each movement is used. While a joint accelerates by a, and the time of its program passes at a
    scaling of s, its speed after the distance x is s √(2 a x), so each row shows s. The ramp begins with the program,
    which may wait before it moves.
    """
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
    spread = 1.4826 * float(np.median(np.abs(rates_ - middle)))
    # Distance and speed may differ by half a cycle of 2 or 8 ms. The ramp takes 80 ms.
    unsure = 0.5 * float(np.clip(period, 0.002, 0.008)) * middle * middle
    found = Estimate.around(middle, spread / np.sqrt(len(rates)))
    return Estimate(middle, float(found.low - unsure), float(found.high + unsure))


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
    """Return how much faster the controller's clock is than the computer's clock, as a fraction."""
    if samples.arrival is None:
        return Estimate.unknown("arrival times, as recordings contain them")
    arrival, times = samples.arrival - samples.arrival[0], samples["timestamp"] - samples["timestamp"][0]
    if arrival[-1] < 5.0:
        return Estimate.unknown("5 s of recording")
    factors, covariance, _ = fit(np.column_stack((arrival, np.ones(len(arrival)))), times)
    found = Estimate.around(float(factors[0]), float(np.sqrt(covariance[0, 0])))
    return Estimate(found.value - 1.0, found.low - 1.0, found.high - 1.0)


def _rests(samples: Samples) -> Iterator[slice]:
    """Yield the rows of each rest, without the rows where the arm settles."""
    times, rest = samples["timestamp"], samples.is_rest
    edges = np.flatnonzero(np.diff(np.concatenate(([False], rest, [False])).astype(int))).reshape(-1, 2)
    for begin, end in edges.tolist():
        settled = begin + int(np.searchsorted(times[begin:end], times[begin] + (_SETTLING if begin else 0.0)))
        if end - settled >= _ROWS:
            yield slice(settled, end)


def _deviation(parts: list[FloatArray]) -> Estimate:
    """Return the standard deviation within parts, each about its own mean."""
    left = np.concatenate([(part - part.mean(axis=0)).ravel() for part in parts])
    free = max(len(left) - sum(part.shape[1] for part in parts), 1)
    value = float(np.sqrt((left**2).sum() / free))
    return Estimate.around(value, value / np.sqrt(2.0 * free))


def _spread(values: FloatArray) -> Estimate:
    value = float(np.sqrt((values**2).mean()))
    return Estimate.around(value, value / np.sqrt(2.0 * len(values)))

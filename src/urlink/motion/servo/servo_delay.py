"""Measurement of the lag of an arm behind its set-points. One joint moves to another position and back."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable

import numpy as np

from linkcore.errors import LinkError

from ...arm.vectors import FloatArray
from ...protocol.realtime.packets import RealtimeState

#: Maximum number of steps of Newton's method that finds the delay; four steps are usual.
_STEPS = 8
#: Longest delay in s. A longer delay means that the arm does not follow its set-points.
_LONGEST = 0.5
#: Largest accepted difference between the arm and the delayed wave, as a fraction of the amplitude.
_UNEXPLAINED = 0.2


def measure(
    states: Iterable[RealtimeState],
    send: Callable[[list[float]], object],
    joint: int,
    amplitude: float,
    duration: float,
) -> float:
    """Move a joint to another position and back, and measure the lag of the arm.

    Args:
        states: States of the robot, each when it arrives.
        send: Function that sends a set-point, (6,) rad.
        joint: Number of the joint.
        amplitude: Amplitude of the motion in rad, with its sign.
        duration: Duration of the motion in both directions together, in s.

    Returns:
        Time in s from a state until the arm reaches the set-point that answered this state.

    Raises:
        LinkError: If the arm does not follow.
    """
    rate = 2.0 * math.pi / duration

    def wave(t: FloatArray | float) -> FloatArray:
        return 0.5 * amplitude * (1.0 - np.cos(rate * np.clip(t, 0.0, duration)))

    q: list[float] = []
    seen: list[tuple[float, float]] = []
    for state in states:
        q = q or state.q_target.tolist()
        seen.append((state.time, float(state.q_actual[joint])))
        t = state.time - seen[0][0]
        send([*q[:joint], q[joint] + float(wave(t)), *q[joint + 1 :]])
        if t > duration + _LONGEST:
            break
    times, actual = np.array(seen).T
    # Make the positions relative to the first position, because sensors have an offset.
    times, actual = times - times[0], actual - actual[0]
    delay = 0.0
    for _ in range(_STEPS):
        speed = 0.5 * amplitude * rate * np.sin(rate * np.clip(times - delay, 0.0, duration))
        delay += float((wave(times - delay) - actual) @ speed / (speed @ speed))
    rest = float(np.abs(wave(times - delay) - actual).max())
    if not 0.0 <= delay <= _LONGEST or rest > _UNEXPLAINED * abs(amplitude):
        raise LinkError(
            f"the arm does not follow its set-points: with a delay of {delay:.3f} s, the arm deviates by up to "
            f"{rest:.4f} rad from a wave of {amplitude:g} rad"
        )
    return delay

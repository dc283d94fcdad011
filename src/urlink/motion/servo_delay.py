"""How long an arm takes to be where it is led: measured by a wave of one joint."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable

import numpy as np

from linkcore.errors import LinkError

from ..interfaces.realtime.packets import RealtimeState
from ..vectors import FloatArray

__all__ = ["measure"]

#: Steps of Newton's method for the delay; four are usual.
_STEPS = 20
#: s beyond which there is no delay to speak of: the arm does not follow.
_LONGEST = 0.5
#: Part of the wave that may be left unexplained by a delay.
_UNEXPLAINED = 0.2


def measure(
    states: Iterable[RealtimeState],
    send: Callable[[list[float]], object],
    joint: int,
    amplitude: float,
    duration: float,
) -> float:
    """Lead a joint there and back, and see when it follows.

    Args:
        states: of the robot, each as it arrives.
        send: sends a set-point (6, rad).
        joint: number of the joint.
        amplitude: rad that it goes away, with its sign.
        duration: s for the way there and back.

    Returns:
        s from a state to the one in which the arm is where the set-point that answered it was.

    Raises:
        LinkError: the arm does not follow.
    """
    q: list[float] = []
    begun = 0.0
    seen: list[tuple[float, float]] = []

    def wave(t: FloatArray | float) -> FloatArray:
        return 0.5 * amplitude * (1.0 - np.cos(2.0 * math.pi / duration * np.clip(t, 0.0, duration)))

    for state in states:
        if not q:
            q, begun = state.q_target.tolist(), state.time
        t = state.time - begun
        seen.append((t, float(state.q_actual[joint]) - q[joint]))
        send([*q[:joint], q[joint] + float(wave(t)), *q[joint + 1 :]])
        if t > duration + _LONGEST:
            break
    times, actual = np.array(seen).T
    # As it stood: sensors have an offset.
    actual = actual - actual[0]
    delay = 0.0
    for _ in range(_STEPS):
        ahead = (wave(times - delay + 1e-4) - wave(times - delay - 1e-4)) / 2e-4
        delay += float((wave(times - delay) - actual) @ ahead / (ahead @ ahead))
    rest = float(np.abs(wave(times - delay) - actual).max())
    if not 0.0 <= delay <= _LONGEST or rest > _UNEXPLAINED * abs(amplitude):
        raise LinkError(
            f"the arm does not follow: a wave of {amplitude:g} rad came back {rest:.4f} rad off, by {delay:.3f} s"
        )
    return delay

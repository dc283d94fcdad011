"""Steps of a stream: how long it takes to brake."""

from __future__ import annotations

import math

import numpy as np
import pytest

from urlink.motion.jerk_limited import JointLimit
from urlink.motion.stream_steps import JointMoment, Step
from urlink.urscript.buffering import BRAKING_FACTOR, STRAY

LIMITS = (JointLimit(3.0, 2.0, 50.0),) * 6


def moment(speed: float, acceleration: float) -> JointMoment:
    """One joint moves."""
    others = [0.0] * 5
    return JointMoment(np.zeros(6), np.array([speed, *others]), np.array([acceleration, *others]))


@pytest.mark.parametrize(
    ("speed", "acceleration", "seconds"),
    [
        (0.0, 0.0, 0.0),
        (2.0, 0.0, BRAKING_FACTOR * 2.0 / 2.0),  # by the largest acceleration
        (0.02, 0.0, math.sqrt(6.0 * 0.02 / 50.0)),  # by the largest jerk
        (0.0, 1.0, 4.0 / 50.0),  # so is an acceleration that dies away
        (0.0, 90.0, math.sqrt(12.0 * STRAY / 90.0)),  # which is to lead no joint further than it may stray
        (0.9, 90.0, math.sqrt(6.0 * 0.9 / 50.0)),
    ],
)
def test_how_long_braking_takes(speed: float, acceleration: float, seconds: float) -> None:
    slow = (JointLimit(3.0, 100.0, 50.0),) * 6 if acceleration or speed < 0.1 else LIMITS
    for sign in (1.0, -1.0):
        step = Step.braking(moment(sign * speed, sign * acceleration), slow)
        assert step.length == pytest.approx(seconds, rel=1e-9)
        assert step.end.qd == pytest.approx([0.0] * 6, abs=1e-9)
    if acceleration and not speed:
        assert abs(step.end.q[0]) <= STRAY + 1e-9

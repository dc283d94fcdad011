"""Jerk-limited profiles compared with the third-party library ruckig, between two states.

The tests do not use the waypoints of ruckig, because it sends them to a web service. `nox -f nightly.py -s kinematics`
installs ruckig. In other environments these tests are skipped.
"""

from __future__ import annotations

import random
from typing import Any

import pytest

from urlink.motion.servo.jerk_limited import JointLimit, JointProfile


def their_duration(x: float, v: float, a: float, target: float, limit: JointLimit) -> float:
    module: Any = pytest.importorskip("ruckig")
    given = module.InputParameter(1)
    given.current_position, given.current_velocity, given.current_acceleration = [x], [v], [a]
    given.target_position, given.target_velocity, given.target_acceleration = [target], [0.0], [0.0]
    given.max_velocity, given.max_acceleration, given.max_jerk = [limit.speed], [limit.acceleration], [limit.jerk]
    found = module.Trajectory(1)
    assert module.Ruckig(1).calculate(given, found) >= 0
    return float(found.duration)


def test_profile_duration_equals_ruckig_from_any_state() -> None:
    """Both libraries compute the shortest possible time, so only one answer is correct."""
    chosen = random.Random(1)
    compared = 0
    while compared < 5000:
        limit = JointLimit(chosen.uniform(0.1, 3), chosen.uniform(0.5, 10), chosen.uniform(1, 100))
        v = chosen.choice((0.0, chosen.uniform(-1, 1))) * limit.speed
        a = chosen.choice((0.0, chosen.uniform(-1, 1))) * limit.acceleration
        if abs(v + 0.5 * a * abs(a) / limit.jerk) > limit.speed:
            continue
        target = chosen.uniform(-2, 2) * chosen.choice((1, 0.1, 0.01))
        ours = JointProfile(0.3, v, a, 0.3 + target, limit).duration
        assert ours == pytest.approx(their_duration(0.3, v, a, 0.3 + target, limit), abs=1e-9)
        compared += 1

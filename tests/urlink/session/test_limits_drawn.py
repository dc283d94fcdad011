"""Drawn commands to a simulated arm with limits: a small number of each kind, and more in the slow test."""

from __future__ import annotations

import numpy as np
import pytest

import urlink
from linkcore import clock
from tests.matrix import trials
from tests.urlink.session.limits_drawn import DRAWN, READY, Bench, Seen, bench, measured
from urlink import Trajectory
from urlink.session.session_limits import WATCHED

#: Kinds that a few commands of which take the least time.
_QUICK = ("move_linear", "speed_joints", "jog", "until_contact")


@pytest.mark.parametrize("kind", _QUICK)
def test_drawn_commands_stay_within_the_limits(kind: str) -> None:
    tally = measured(kind, 3, 0, 4)
    assert tally.commands == 4
    assert not tally.escaped, tally.escaped


@pytest.mark.slow
@pytest.mark.matrix
@pytest.mark.parametrize("kind", DRAWN)
def test_many_drawn_commands_stay_within_limits(kind: str) -> None:
    tally = measured(kind, 45, 0, trials(5, 20))
    assert not tally.escaped, tally.escaped
    # Kinds that depend on forces are refused for what they might do, so some harmless commands are refused too.
    least = 0.7 * tally.inside if kind in WATCHED else tally.inside - 1
    assert tally.accepted_inside >= least, tally.refused


def test_seen_counts_each_limit() -> None:
    inside = Seen(-0.01, 0.25, 1.0)
    assert inside.is_inside
    for outside in (Seen(1e-6, 0.1, 0.1), Seen(-0.01, 0.26, 0.1), Seen(-0.01, 0.1, 1.1)):
        assert not outside.is_inside


def test_seen_is_proper_if_asked_values_keep_the_margins() -> None:
    kept = Seen(-0.0011, 0.25, 1.0)
    assert kept.is_proper
    for beyond in (Seen(-0.0009, 0.1, 0.1), Seen(-0.01, 0.2504, 0.1), Seen(-0.01, 0.1, 1.0015)):
        assert beyond.is_inside
        assert not beyond.is_proper
        assert not Seen(-0.01, 0.1, 0.1, asked=beyond).is_proper
    assert Seen(-0.01, 0.1, 0.1, asked=kept).is_proper


def test_bench_measures_the_values_that_were_asked_for() -> None:
    with urlink.simulated_time(), bench("ur5", "3.15", np.random.default_rng(1)) as on:
        on.place(READY)

        def jogged(on: Bench) -> None:
            with on.motion.jog("base", timeout=0.1) as handle:
                on.ask("base", np.array([0.0, 0.0, 0.24, 0.0, 0.0, 0.0]), 0.1)
                handle.move([0.0, 0.0, 0.24, 0.0, 0.0, 0.0])
                clock.sleep(0.3)

        jog = on.run(jogged, on.free)
        assert isinstance(jog, Seen)
        assert jog.asked is not None
        # The tool does not reach its speed in 0.1 s.
        assert jog.tool_speed < 0.2
        assert jog.asked.tool_speed == pytest.approx(0.24, rel=1e-3)
        on.place(READY)
        turned = READY + 0.2 * np.eye(6)[5]
        trajectory = Trajectory.from_arrays([0.0, 1.0], [READY, turned])
        follow = on.run(lambda on: on.motion.follow(trajectory).wait(60.0), on.free)
        assert isinstance(follow, Seen)
        assert follow.asked is not None
        # A cubic curve is 1.5 times as fast in its middle as on average.
        assert follow.asked.joint_speed == pytest.approx(0.3, rel=0.01)
        assert follow.joint_speed < follow.asked.joint_speed

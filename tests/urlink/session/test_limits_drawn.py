"""Drawn commands to a simulated arm with limits: a small number of each kind, and more in the slow test."""

from __future__ import annotations

import pytest

from tests.matrix import trials
from tests.urlink.session.limits_drawn import DRAWN, Seen, measured
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

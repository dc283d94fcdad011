"""Tests of `many_cycles`, which counts the reference cycles of many calls."""

from __future__ import annotations

import pytest

from linkcore.handle import Lifecycle
from tests.urlink import many_cycles


@pytest.mark.slow
@pytest.mark.parametrize(
    "key", ["call IO.set_flag", "refused Motions.servo", "awaited io.set_digital_out", "ur_rtde stopL", "urx stop"]
)
def test_tried_returns_the_number_of_calls_of_each_kind(key: str) -> None:
    kind, name = key.split()
    assert many_cycles.tried(kind, name, 3, 60.0) == (3, {})


@pytest.mark.slow
def test_tried_reports_the_types_in_a_cycle(monkeypatch: pytest.MonkeyPatch) -> None:
    """The defect injected here: after its end, the life cycle of a handle keeps the function that stops the arm."""
    settle = Lifecycle._settle

    def leaking(life: Lifecycle, error: Exception | None) -> None:
        brake = life.brake
        settle(life, error)
        life.brake = brake

    monkeypatch.setattr(Lifecycle, "_settle", leaking)
    count, found = many_cycles.tried("call", "Motions.move_joints", 3, 60.0)
    assert count == 3
    assert found["linkcore.handle.Lifecycle"] == 3

"""What counts the cycles of ten thousand calls sees them."""

from __future__ import annotations

import pytest

from linkcore.handle import Lifecycle
from tests.urlink import many_cycles


@pytest.mark.slow
@pytest.mark.parametrize(
    "key", ["call IO.set_flag", "refused Motions.servo", "awaited io.set_digital_out", "ur_rtde stopL", "urx stop"]
)
def test_each_kind_of_call_is_counted(key: str) -> None:
    kind, name = key.split()
    assert many_cycles.tried(kind, name, 3, 60.0) == (3, {})


@pytest.mark.slow
def test_a_cycle_is_counted_by_what_is_in_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Here a handle's life keeps what stops the arm after its end."""
    settle = Lifecycle._settle

    def leaking(life: Lifecycle, error: Exception | None) -> None:
        brake = life.brake
        settle(life, error)
        life.brake = brake

    monkeypatch.setattr(Lifecycle, "_settle", leaking)
    count, found = many_cycles.tried("call", "Motions.move_joints", 3, 60.0)
    assert count == 3
    assert found["linkcore.handle.Lifecycle"] == 3

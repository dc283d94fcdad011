"""Streams whose program is paused; the arm might be moved meanwhile."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from linkcore.handle import Phase
from tests.urlink.motion.test_paused import comes_to_rest, moved_after, pressed
from tests.urlink.motion.test_scaled import READY, Cell
from urlink import TrajectoryPoint
from urlink.errors import ToleranceExceeded

pytestmark = pytest.mark.simulated_time

TIMEOUT = 120.0
FIRMWARES = [("UR5", "3.15"), ("UR5e", "5.11")]


@pytest.fixture
def cell() -> Iterator[Callable[[str, str], Cell]]:
    made: list[Cell] = []

    def make(arm: str, firmware: str) -> Cell:
        made.append(Cell(arm, firmware))
        return made[-1]

    yield make
    for each in made:
        each.close()


def points() -> list[TrajectoryPoint]:
    """Return points that move wrist 3 from rest to rest, by 2 rad in 4 s."""
    made = []
    for t in np.arange(0.1, 4.05, 0.1).tolist():
        u = t / 4.0
        q = [*READY[:5], 2.0 * (6 * u**5 - 15 * u**4 + 10 * u**3)]
        qd = [0.0] * 5 + [0.5 * (30 * u**4 - 60 * u**3 + 30 * u**2)]
        made.append(TrajectoryPoint(q, t, qd, [0.0] * 5 + [0.125 * (120 * u**3 - 180 * u**2 + 60 * u)]))
    return made


@pytest.mark.slow
@pytest.mark.matrix(3)
@pytest.mark.parametrize(("arm", "firmware"), FIRMWARES)
@pytest.mark.parametrize("moved", [0.0, 0.03, -0.03])
def test_stream_resumes_smoothly_from_current_position(
    cell: Callable[[str, str], Cell], arm: str, firmware: str, moved: float
) -> None:
    one = cell(arm, firmware)
    with one.robot.motion.stream() as stream:
        stream.append(points(), wait=False)
        time.sleep(1.5)
        pressed(one, one.controller.pendant.pause)
        here = comes_to_rest(one)
        if moved:
            pressed(one, lambda: one.controller.pendant.jog([*here[:5], here[5] + moved]))
            time.sleep(0.2)
            here = comes_to_rest(one)
        before = stream.time
        time.sleep(5.0)
        assert stream.time == before
        count = len(one.path)
        pressed(one, one.controller.pendant.play)
        stream.wait_until_dry(TIMEOUT)
        assert stream.starved == 0
        assert stream.time == pytest.approx(4.0)
        went = np.array(one.path[count:])[:, 5]
        # The arm moves onto its path, but never back to the position where it was paused.
        assert went.min() > here[5] - max(moved, 0.0) - 0.005
        rate = one.controller.firmware.rate
        assert np.abs(np.diff(went, 2)).max() * rate**2 < 15.0
        time.sleep(0.5)
        assert one.controller.arm.setpoint.q[5] == pytest.approx(2.0, abs=1e-3)
    assert stream.phase is Phase.DONE


@pytest.mark.slow
@pytest.mark.parametrize(("arm", "firmware"), FIRMWARES)
def test_arm_jogged_away_in_pause_is_not_moved_back(cell: Callable[[str, str], Cell], arm: str, firmware: str) -> None:
    one = cell(arm, firmware)
    with one.robot.motion.stream() as stream:
        stream.append(points(), wait=False)
        time.sleep(1.5)
        pressed(one, one.controller.pendant.pause)
        here = comes_to_rest(one)
        pressed(one, lambda: one.controller.pendant.jog([*here[:5], here[5] + 0.3]))
        time.sleep(0.2)
        comes_to_rest(one)
        assert moved_after(one, lambda: pressed(one, one.controller.pendant.play)) < 5e-3
        with pytest.raises(ToleranceExceeded, match=r"wrist 3 .* was moved by 0\.3"):
            stream.wait_until_dry()

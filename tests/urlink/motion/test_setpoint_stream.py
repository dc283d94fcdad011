"""Messages in each cycle of the controller, and the expected motion of the program without messages."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from linkcore.errors import LinkTimeout
from tests.urlink.motion.bench import PLAYING
from urlink.arm.models import model
from urlink.motion.moves.speed_limit import EARLY, largest_speeds
from urlink.motion.servo.jerk_limited import TargetFilter, joint_limits
from urlink.motion.servo.resampling import FilteredTargets, ResampledSetpoints
from urlink.motion.servo.setpoints import Servoing, SetpointStream
from urlink.protocol.firmware import Firmware
from urlink.protocol.realtime.packets import RealtimeState
from urlink.script.links import STOP, WAIT
from urlink.script.messages import STOP_MESSAGE, WAIT_MESSAGE, dated, read_message, setpoint

UR5E = model("UR5e")
#: Speed limit of each joint of a UR5e, in rad/s.
TOP = float(UR5E.max_speed[5])
#: A program with these options coasts for 50 cycles of 2 ms.
SERVOING = Servoing(Firmware.parse("5.11"), largest_speeds(UR5E), 0.1, 0.03, 300.0)
CYCLE = 0.002
REST = [0.0] * 6


def at(angle: float) -> list[float]:
    """Return values for six joints, zero except for wrist 3, in rad or rad/s."""
    return [0.0] * 5 + [angle]


def test_stop_and_wait_messages_contain_only_zeros() -> None:
    assert read_message(STOP_MESSAGE) == (REST, REST, STOP)
    assert read_message(WAIT_MESSAGE) == (REST, REST, WAIT)


@pytest.mark.parametrize("last", [0.0, 3e-6, 0.5])
def test_set_point_contains_number_of_pauses(last: float) -> None:
    message = setpoint(at(0.3), at(last))
    assert dated(message, 7) == message + bytes([0, 0, 0, 7])
    assert dated(message, 7, 2) == message[:-4] + (WAIT + 2).to_bytes(4, "big") + bytes([0, 0, 0, 7])
    for other in (WAIT_MESSAGE, STOP_MESSAGE, dated(message, 6)):
        assert dated(other, 7, 2) == other + bytes([0, 0, 0, 7])


# -- the stream ------------------------------------------------------------------------------------------


@pytest.fixture
def stream() -> SetpointStream:
    stream = SetpointStream(SERVOING)
    stream.begin(at(0.3))
    return stream


def test_program_waits_at_first_and_coasts_after_set_point(stream: SetpointStream) -> None:
    assert stream.coasted_to(20) == (at(0.3), REST)
    message = stream.send(at(0.301), at(0.5), 10.0)
    assert read_message(message)[:2] == (at(0.301), at(0.5))
    # The first of 10 cycles runs at 98 % of that speed, and the last at 80 %.
    q, qd = stream.coasted_to(10)
    assert q == pytest.approx(at(0.301 + 0.5 * 8.9 * CYCLE))
    assert qd == pytest.approx(at(0.4))
    assert stream.coasted_time(10) == pytest.approx(8.9 * CYCLE)
    assert stream.coasted_time(70) == stream.coasted_time(50) == pytest.approx(24.5 * CYCLE)
    assert stream.coasted_to(70)[1] == REST


def test_next_set_point_is_due_half_a_cycle_after_the_last(
    stream: SetpointStream,
) -> None:
    for _ in range(2):
        assert (stream.is_due, stream.missed) == (False, 0)
        stream.advance(0.49 * CYCLE, 0.49 * CYCLE)
        assert not stream.is_due
        stream.advance(0.01 * CYCLE, 0.01 * CYCLE)
        assert (stream.is_due, stream.missed) == (True, 0)
        stream.advance(0.9 * CYCLE, 0.9 * CYCLE)
        assert stream.missed == 0
        stream.advance(0.2 * CYCLE, 0.2 * CYCLE)
        assert stream.missed == 1
        stream.advance(10.0 * CYCLE, 10.0 * CYCLE)
        assert (stream.is_due, stream.missed) == (True, 11)
        stream.send(at(0.3), REST, 10.0)


def test_late_set_point_may_be_as_far_away_as_the_program_coasts(stream: SetpointStream) -> None:
    stream.send(at(0.3), REST, 10.0)
    for later, seconds in ((CYCLE, CYCLE + EARLY), (0.05, 0.05 + EARLY), (60.0, 0.1 + CYCLE + EARLY)):
        assert stream.excess(at(0.3 + 0.999 * TOP * seconds), 10.0 + later) is None
        assert "q[5]" in (stream.excess(at(0.3 + 1.001 * TOP * seconds), 10.0 + later) or "")
    # A sent set-point uses up the budget.
    stream.send(at(0.3 + TOP * CYCLE), REST, 10.0 + CYCLE)
    assert stream.excess(at(0.3 + TOP * (CYCLE + 2.0 * EARLY)), 10.0 + CYCLE) is not None


# -- set-points from a source ----------------------------------------------------------------------------


class Source:
    """Source that moves wrist 3 at `speed`; `called` lists the calls, except calls of `at`."""

    def __init__(self) -> None:
        self.has_targets = True
        self.speed = 0.0
        self.called: list[tuple[object, ...]] = []
        #: result of `skip`, for a time with missed set-points
        self.skipped = (REST, REST)

    def begin(self, time: float, q: Sequence[float]) -> None:
        self.called.append(("begin", time, q))

    def skip(self, time: float, seconds: float) -> tuple[list[float], list[float]]:
        self.called.append(("skip", time, seconds))
        return self.skipped

    def restart(self, time: float, q: Sequence[float], qd: Sequence[float]) -> None:
        self.called.append(("restart", time, q, qd))

    def at(self, time: float, rate: float) -> tuple[list[float], list[float]]:
        return at(self.speed * (time - 50.0)), at(self.speed)

    def accept(self, time: float, rate: float) -> None:
        self.called.append(("accept", time))


class Fed:
    """Resampled set-points that receive states of an arm at rest at 0, at times since the start."""

    def __init__(self) -> None:
        self.source = Source()
        self.resampled = ResampledSetpoints(SERVOING, self.source)

    def state(self, passed: float, *, now: float | None = None, speed: float = 0.0) -> bytes:
        joints, speeds = np.zeros(6), np.array(at(speed))
        state = SimpleNamespace(time=50.0 + passed, q_target=joints, q_actual=joints, qd_target=speeds, **PLAYING)
        return self.resampled.answer(cast(RealtimeState, state), 1000.0 + (passed if now is None else now))

    def led(self, passed: float, *, now: float | None = None) -> tuple[float, float]:
        """Return the set-point of wrist 3, and the speed at which the program coasts."""
        q, qd, _ = read_message(self.state(passed, now=now))
        assert q[:5] == qd[:5] == [0.0] * 5
        return q[5], qd[5]


@pytest.fixture
def fed() -> Fed:
    fed = Fed()
    assert fed.led(0.0) == (0.0, 0.0)
    assert fed.source.called == [("begin", 50.0, REST)]
    fed.source.called.clear()
    return fed


def test_source_begins_at_rest_when_target_exists() -> None:
    fed = Fed()
    assert fed.state(0.0, speed=0.5) == WAIT_MESSAGE
    fed.source.has_targets = False
    assert fed.state(CYCLE) == WAIT_MESSAGE
    assert fed.source.called == []
    fed.source.has_targets = True
    assert fed.led(2 * CYCLE) == (0.0, 0.0)
    assert fed.source.called == [("begin", 50.0 + 2 * CYCLE, REST)]
    fed = Fed()
    fed.state(0.0, speed=0.5)
    with pytest.raises(LinkTimeout, match="the servo did not begin"):
        fed.state(1.6, speed=0.5)


def test_each_cycle_is_answered_once_with_set_point(fed: Fed) -> None:
    fed.source.speed = 1.0
    assert fed.led(CYCLE) == (0.002, 1.0)
    assert fed.state(CYCLE) == b""
    assert fed.led(2 * CYCLE) == (0.004, 1.0)
    assert fed.source.called == [("accept", 50.0 + CYCLE), ("accept", 50.0 + 2 * CYCLE)]


def test_impossible_set_point_is_not_sent(fed: Fed) -> None:
    fed.source.speed = 2.0 * TOP
    assert fed.state(CYCLE) == b""
    assert fed.source.called == []
    fed.source.speed = 0.0
    assert fed.led(2 * CYCLE) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("there", "speed", "is_faded"),
    [(-0.005, 0.2, True), (0.005, -0.2, True), (-0.00501, 0.0, False), (0.0, 0.201, False), (0.0, -0.201, False)],
)
def test_small_gap_to_coasted_position_is_faded_out(fed: Fed, there: float, speed: float, is_faded: bool) -> None:
    """If the gap is larger, the source restarts from the coasted position."""
    fed.source.skipped = (at(there), at(speed))
    q, qd = fed.led(6 * CYCLE)
    time, skipped = 50.0 + 6 * CYCLE, ("skip", 50.0 + 6 * CYCLE, 5 * CYCLE * 0.94)
    if not is_faded:
        assert fed.source.called == [skipped, ("restart", time, REST, REST), ("accept", time)]
        assert (q, qd) == (0.0, 0.0)
        return
    assert fed.source.called == [skipped, ("accept", time)]
    for cycles in range(1, 4):
        gap = -there * 0.98**cycles
        assert (q, qd) == pytest.approx((gap, -10.0 * gap), abs=1e-6)
        q, qd = fed.led((6 + cycles) * CYCLE)


def test_source_restarts_at_position_of_arm_after_pause(fed: Fed) -> None:
    """The source starts at rest, without the rest of a gap, and the time of the program starts slowly."""
    fed.source.skipped = (at(-0.004), at(0.0))
    assert fed.led(6 * CYCLE)[0] > 0.0
    fed.source.called.clear()
    state = SimpleNamespace(time=60.0, q_target=np.array(at(0.3)))
    fed.resampled.resume(cast(RealtimeState, state))
    assert fed.source.called == [("restart", 60.0, at(0.3), REST)]
    fed.source.called.clear()
    fed.source.speed = 0.3 / (7 * CYCLE)
    q, _ = fed.led(7 * CYCLE)
    assert q == pytest.approx(0.3)  # it is near the arm at rest, and without a gap
    assert fed.resampled._timer.rate == 0.0


def test_pause_before_start_does_not_restart_source() -> None:
    fed = Fed()
    fed.source.has_targets = False
    fed.state(0.0)
    fed.resampled.resume(cast(RealtimeState, SimpleNamespace(time=60.0, q_target=np.array(at(0.3)))))
    assert fed.source.called == []
    fed.source.has_targets = True
    fed.state(CYCLE)
    assert fed.led(2 * CYCLE) == (0.0, 0.0)


def test_source_restarts_with_remaining_speed(fed: Fed) -> None:
    fed.source.speed = 1.0
    fed.led(CYCLE)
    fed.source.skipped = (at(0.1), at(1.0))
    fed.led(12 * CYCLE)
    _, (name, time, q, qd), _ = fed.source.called[-3:]
    assert (name, time) == ("restart", 50.0 + 12 * CYCLE)
    there = at(0.002 + 8.9 * CYCLE)
    assert q == pytest.approx(there)
    assert qd == pytest.approx(at(0.8))
    # There is no restart if the source has the same position and speed.
    fed = Fed()
    fed.source.speed = 1.0
    fed.led(0.0)
    fed.led(CYCLE)
    fed.source.skipped = (there, at(0.8))
    fed.led(12 * CYCLE)
    assert fed.source.called[-2][0] == "skip"


def test_impossible_number_of_missed_cycles_is_ignored(fed: Fed) -> None:
    """The time of the state is wrong, but by less than the gap that is allowed between states that arrive together."""
    fed.source.speed = 1.0
    fed.led(CYCLE)
    assert fed.state(0.09, now=2 * CYCLE) == b""
    assert fed.source.called == [("accept", 50.0 + CYCLE)]


# -- targets ---------------------------------------------------------------------------------------------


def test_targets_are_filtered_from_position_of_arm() -> None:
    """The filter runs at the pace of the program. After a delay or a pause, it continues from the new position."""
    limits = joint_limits(UR5E, 2.0, 10.0, 200.0)
    targets, alone = FilteredTargets(limits, CYCLE), TargetFilter(at(0.1), limits)
    found = [targets.has_targets]
    targets.newest = at(0.5)
    assert [*found, targets.has_targets] == [False, True]
    targets.begin(50.0, at(0.1))
    alone.aim(at(0.5))
    for rate in (1.0, 0.5):
        assert targets.at(50.0, rate) == alone.after(rate * CYCLE)
        targets.accept(50.0, rate)
        alone.advance(rate * CYCLE)
        assert targets.skip(50.0, 0.01)[0] == pytest.approx(alone.after(0.01)[0])
        alone.advance(0.01)
    targets.restart(51.0, at(0.3), at(0.2))
    alone.restart(at(0.3), at(0.2))
    q, qd = targets.at(51.0, 1.0)
    assert (q, qd) == alone.after(CYCLE)
    assert q[5] == pytest.approx(0.3 + 0.2 * CYCLE, abs=1e-4)
    assert qd[5] == pytest.approx(0.2, abs=0.05)

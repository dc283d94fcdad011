"""The time of a program, state by state, and its pauses. `test_follower.py` tests the controller's clock."""

from __future__ import annotations

import itertools
import math
import threading
from collections.abc import Callable
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from linkcore.handle import Lifecycle
from linkcore.streaming.stream import Stream
from tests.fakes.line import Desk
from urlink.command.program_time import Pause, ProgramTimer, end_where_moved, is_paused, reported_scaling
from urlink.errors import ToleranceExceeded
from urlink.protocol.enums import ProgramState
from urlink.protocol.realtime.packets import RealtimeState

PLAYING, PAUSING, PAUSED = ProgramState.PLAYING, ProgramState.PAUSING, ProgramState.PAUSED


def state(scaling: float | None, program: ProgramState | None = PLAYING, time: float = 50.0) -> RealtimeState:
    return cast(RealtimeState, SimpleNamespace(time=time, speed_scaling=scaling, program_state=program))


@pytest.mark.parametrize(
    ("scaling", "program", "rate"),
    [
        (None, None, 1.0),  # CB2
        (0.3, None, 0.3),  # 3.0
        (0.3, PLAYING, 0.3),
        (0.0, PLAYING, 0.0),
        (1.0, PAUSED, 0.0),  # 3.2 to 3.9
        (1.0, PAUSING, 0.0),
        (math.nan, PLAYING, 1.0),
        (-0.1, PLAYING, 1.0),
        (1.5, PLAYING, 1.0),
    ],
)
def test_rate_is_the_reported_scaling(scaling: float | None, program: ProgramState | None, rate: float) -> None:
    assert reported_scaling(state(scaling, program)) == rate
    assert is_paused(state(scaling, program)) == (program in (PAUSED, PAUSING))


def test_program_time_uses_mean_scaling_of_two_states() -> None:
    clock, wall = ProgramTimer(0.002), ProgramTimer(0.002, "ignore")
    seen = [(0.5, 0.0), (0.5, 0.002), (1.0, 0.002), (0.0, 0.01), (0.0, 1.0), (0.2, 0.002)]
    expected, now = [0.0, 0.001, 0.0015, 0.005, 0.0, 0.0002], 0.0
    for (scaling, later), scaled in zip(seen, expected, strict=True):
        now += later
        each = state(scaling, time=50.0 + now)
        assert clock.passed(each, now) == pytest.approx((later, scaled))
        assert clock.rate == scaling
        assert wall.passed(each, now) == pytest.approx((later, later))
        assert wall.rate == 1.0


def test_resumed_program_is_slow_at_first() -> None:
    clock = ProgramTimer(0.008)
    clock.passed(state(1.0, time=50.0), 0.0)
    clock.passed(state(1.0, time=50.008), 0.008)
    assert clock.rate == 1.0
    clock.restart()
    rates, scaled = [], []
    for n in range(2, 24):
        seconds, passed = clock.passed(state(1.0, time=50.0 + 0.008 * n), 0.008 * n)
        assert seconds == pytest.approx(0.008)
        rates.append(clock.rate)
        scaled.append(passed)
    assert rates == pytest.approx([min(0.05 * n, 1.0) for n in range(22)])
    assert scaled[0] == 0.0
    assert scaled[1:] == pytest.approx([0.008 * 0.5 * (a + b) for a, b in itertools.pairwise(rates)])
    assert (clock.beginning(), clock.after(3.0, 0.25)) == (0.0, 3.25)


# -- pauses ------------------------------------------------------------------------------------------------


def arm(turned: float = 0.0, speed: float = 0.0, program: ProgramState = PAUSED) -> RealtimeState:
    """Return a state with joint 4 turned, at some speed."""
    q, qd = np.zeros(6), np.zeros(6)
    q[4], qd[4] = turned, speed
    return cast(RealtimeState, SimpleNamespace(q_target=q, qd_target=qd, program_state=program))


def test_motion_may_resume_if_arm_is_at_its_rest_position() -> None:
    pause = Pause("a motion", 0.05)
    assert [pause.look(arm(0.1 * n, program=PLAYING)) for n in range(3)] == [False] * 3
    assert (pause.holds, pause.is_over, pause.count) == (False, False, 0)
    for _ in range(2):
        assert pause.look(arm(0.3, 1.0, PAUSING))
        assert pause.look(arm(0.4, -1.1e-4))
        assert pause.look(arm(0.5, 0.9e-4))  # the arm is at rest here
        assert pause.look(arm(0.9, 0.0))  # the arm is pushed, and returns in time
        assert pause.holds
        assert not pause.look(arm(0.5 + 0.0499, program=PLAYING))
        assert pause.is_over
        pause.is_over = False
    assert pause.count == 2


@pytest.mark.parametrize("moved", [0.0501, -0.0501])
def test_motion_may_not_resume_if_arm_was_moved_in_the_pause(moved: float) -> None:
    pause = Pause("a motion", 0.05)
    pause.look(arm(0.5))
    pause.look(arm(0.5 + moved))
    moved_by = (
        r"^wrist 2 \(joint 4\) was moved by 0\.0501 rad while the program of a motion was paused; at most 0\.05 rad"
    )
    with pytest.raises(ToleranceExceeded, match=moved_by):
        pause.look(arm(0.5 + moved, program=PLAYING))
    assert (pause.holds, pause.is_over, pause.count) == (False, True, 1)


def test_displaced_arm_ends_motion_during_the_pause_with_at_once() -> None:
    pause = Pause("a motion", 0.05, at_once=True)
    pause.look(arm(0.2, 1.0, PAUSING))
    pause.look(arm(0.5))
    pause.look(arm(0.549))
    with pytest.raises(ToleranceExceeded):
        pause.look(arm(0.551))


def test_pause_ignores_the_position_until_the_arm_is_at_rest() -> None:
    pause = Pause("a motion", 0.05)
    pause.look(arm(0.2, 1.0, PAUSING))
    assert not pause.look(arm(0.5, program=PLAYING))
    # The position of the previous pause does not count.
    pause.look(arm(0.6))
    pause.look(arm(0.6, program=PLAYING))
    pause.look(arm(0.9, 1.0, PAUSING))
    assert not pause.look(arm(0.9, program=PLAYING))


class Watched:
    """Motion whose states are passed to the look of `end_where_moved` by the test, in its own thread.

    Attributes:
        closed: Arguments of the calls that close the subscription.
    """

    def __init__(self, brake: Callable[[], object]) -> None:
        self.closed: list[float] = []
        self.life = Lifecycle("a motion", Desk().callbacks)
        self.life.brake = brake
        self.life.begin()
        connection = SimpleNamespace(subscribe_inline=self._subscribe)
        end_where_moved(self.life, cast("Stream[RealtimeState]", SimpleNamespace(_connection=connection)))

    def _subscribe(self, kind: type, look: Callable[[RealtimeState], None], only_changes: Callable[[], bool]) -> object:
        assert kind is RealtimeState
        self.look, self.needs_only_changes = look, only_changes
        return SimpleNamespace(close=self.closed.append)


@pytest.mark.simulated_time
@pytest.mark.parametrize(("moved", "is_ended"), [(0.0499, False), (0.0501, True)])
def test_controller_motion_ends_when_arm_is_moved(moved: float, is_ended: bool) -> None:
    """Stop the program before it resumes."""
    braked: list[int] = []
    motion = Watched(lambda: braked.append(1))
    motion.look(arm(0.1, 1.0, PLAYING))
    assert motion.needs_only_changes()
    motion.look(arm(0.5))
    assert not motion.needs_only_changes()
    motion.look(arm(0.5 + moved))
    if is_ended:
        assert isinstance(motion.life.future.exception(60.0), ToleranceExceeded)
    assert motion.life.is_over is is_ended
    assert (braked, motion.closed) == (([1], [0]) if is_ended else ([], []))
    motion.life.finish()
    assert motion.closed == [0]


@pytest.mark.simulated_time
def test_reader_receives_states_while_the_stop_is_sent() -> None:
    is_sending, has_room = threading.Event(), threading.Event()
    stops: list[str] = []

    def brake() -> None:
        stops.append(threading.current_thread().name)
        is_sending.set()
        assert has_room.wait(60.0)

    motion = Watched(brake)
    motion.look(arm(0.5))
    motion.look(arm(0.6))
    assert is_sending.wait(60.0)
    # Further states arrive meanwhile; they end nothing again.
    motion.look(arm(0.6))
    motion.look(arm(0.6, program=PLAYING))
    assert not motion.life.future.done()
    has_room.set()
    assert isinstance(motion.life.future.exception(60.0), ToleranceExceeded)
    assert stops == ["a motion stop"]


@pytest.mark.simulated_time
def test_stop_is_sent_by_reader_when_no_thread_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(thread: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    stops: list[str] = []
    motion = Watched(lambda: stops.append(threading.current_thread().name))
    motion.look(arm(0.5))
    monkeypatch.setattr(threading.Thread, "start", refuse)
    motion.look(arm(0.6))
    assert motion.life.is_over
    assert stops == [threading.current_thread().name]

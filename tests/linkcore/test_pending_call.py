"""Calls that start motions: their order, and the end of their motions when a call fails."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest
from hypothesis import given
from hypothesis import strategies as st

from linkcore.errors import Cancelled, LinkTimeout, LocalError
from linkcore.handle import Handle, Lifecycle, Phase, waited
from linkcore.pending_call import PendingCall, current_call, next_order, regardless, starts_motion, stopped_here
from linkcore.threads import CallbackThread

CALLBACKS = cast(CallbackThread, SimpleNamespace(call=lambda function, *arguments: function(*arguments)))


class Arm:
    """Arm with methods that start motions."""

    def __init__(self) -> None:
        self.brakes = 0
        self.started: list[Handle] = []

    def begin(self) -> Handle:
        life = Lifecycle("motion", CALLBACKS)
        life.brake = self._brake
        self.started.append(Handle(life))
        return self.started[-1]

    def _brake(self) -> None:
        self.brakes += 1

    @starts_motion
    def move(self, *, error: BaseException | None = None, wait: float = 0.0) -> Handle:
        """Start a motion."""
        handle = self.begin()
        if error is not None:
            raise error
        return waited(handle, wait)

    @starts_motion
    def order(self) -> int:
        call = current_call()
        assert call is not None
        assert call.order is not None
        return call.order

    @starts_motion
    def orders(self, stops: bool = False) -> tuple[int, int]:
        """Return the order numbers of this call and of a nested call.

        If `stops`, this thread stops the robot between the two calls.
        """
        call = current_call()
        assert call is not None
        if stops:
            stopped_here()
        return cast(int, call.order), self.order()


@pytest.fixture
def arm() -> Arm:
    return Arm()


@pytest.mark.parametrize("error", [KeyboardInterrupt(), LocalError("no thread is left"), ValueError("a defect")])
def test_call_cancels_its_motion_when_it_raises(arm: Arm, error: BaseException) -> None:
    with pytest.raises(type(error)):
        arm.move(error=error)
    assert arm.started[0].phase is Phase.CANCELLED
    assert arm.brakes == 1


def test_call_leaves_the_motion_running_when_its_wait_times_out(arm: Arm) -> None:
    with pytest.raises(LinkTimeout):
        arm.move(wait=1e-9)
    assert arm.started[0].phase is Phase.SENT
    assert arm.brakes == 0


def test_call_cancels_the_motion_when_it_cannot_wait_for_it(arm: Arm, monkeypatch: pytest.MonkeyPatch) -> None:
    def overflow(life: Lifecycle, timeout: float) -> bool:
        raise OverflowError("timestamp out of range")

    monkeypatch.setattr(Lifecycle, "wait", overflow)
    with pytest.raises(OverflowError):
        arm.move(wait=1.0)
    assert arm.brakes == 1


def test_call_leaves_earlier_motions_alone_when_it_raises(arm: Arm) -> None:
    earlier = arm.move()
    with pytest.raises(KeyboardInterrupt):
        arm.move(error=KeyboardInterrupt())
    assert earlier.phase is Phase.SENT


def test_call_is_current_only_while_it_runs(arm: Arm) -> None:
    assert current_call() is None
    arm.order()
    with pytest.raises(ValueError, match="a defect"):
        arm.move(error=ValueError("a defect"))
    assert current_call() is None


def test_order_increases_from_call_to_call(arm: Arm) -> None:
    first, stop, second = arm.order(), next_order(), arm.order()
    assert first < stop < second


def test_nested_call_has_the_order_number_of_the_outer_call(arm: Arm) -> None:
    outer, inner = arm.orders()
    assert outer == inner


def test_nested_call_has_higher_order_after_a_stop_in_its_thread(arm: Arm) -> None:
    outer, inner = arm.orders(stops=True)
    assert outer < inner


def test_pending_call_takes_its_order_when_created(arm: Arm) -> None:
    pending = PendingCall()
    stop = next_order()
    assert pending.make(arm.order) < stop


def test_unordered_pending_call_gives_nested_call_a_new_order(arm: Arm) -> None:
    pending = PendingCall(is_ordered=False)
    stop = next_order()
    assert pending.make(arm.order) > stop


def test_abandoned_pending_call_does_not_start_motions(arm: Arm) -> None:
    pending = PendingCall()
    pending.give_up(lambda call: call())
    with pytest.raises(Cancelled):
        pending.make(arm.move)
    assert not arm.started


def test_abandoned_pending_call_cancels_its_motion(arm: Arm) -> None:
    pending = PendingCall()
    handle = pending.make(arm.move)
    pending.give_up(lambda call: call())
    assert handle.phase is Phase.CANCELLED
    assert arm.brakes == 1


def test_regardless_hides_the_current_call_temporarily(arm: Arm) -> None:
    pending = PendingCall()
    seen: list[Any] = []
    pending.make(lambda: seen.extend([regardless(current_call), current_call()]))
    assert seen == [None, pending]


@given(st.lists(st.sampled_from(["call", "stop"]), max_size=30))
def test_stop_has_a_higher_order_than_earlier_calls_only(events: list[str]) -> None:
    arm, last_stop, calls = Arm(), 0, []
    for at, event in enumerate(events):
        if event == "stop":
            last_stop = next_order()
        else:
            calls.append((at, arm.order()))
    last = max((at for at, event in enumerate(events) if event == "stop"), default=-1)
    assert [order < last_stop for _, order in calls] == [at < last for at, _ in calls]

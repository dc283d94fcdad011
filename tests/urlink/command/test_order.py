"""A program does not begin if its call was made before a stop of the robot."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from linkcore.errors import Cancelled
from linkcore.handle import Phase
from linkcore.pending_call import PendingCall
from tests.fakes.line import Programming, Run, fast, slow
from urlink.command.safety import Safety
from urlink.errors import SafetyStop
from urlink.protocol.enums import SafetyMode


@pytest.fixture
def desk() -> Programming:
    return Programming()


def stop(desk: Programming) -> None:
    desk.channel.overtake("the robot was stopped")


def safety_stop(desk: Programming) -> None:
    desk.realtime.deliver(fast(SafetyMode.PROTECTIVE_STOP))
    desk.realtime.deliver(fast())


def change_of_policy(desk: Programming) -> None:
    safety = Safety(desk.monitor)
    safety.policy = "always"
    safety.enable()


STOPS = [stop, safety_stop, change_of_policy]


def started(desk: Programming, call: PendingCall, **options: Any) -> Run:
    return call.make(lambda: desk.motion(**options))


@pytest.mark.parametrize("overtake", STOPS)
@pytest.mark.parametrize("asks", [True, False])
def test_program_is_not_sent_after_a_stop(
    desk: Programming, overtake: Callable[[Programming], None], asks: bool
) -> None:
    call = PendingCall()
    overtake(desk)
    with pytest.raises(Cancelled, match=r"after this call began, so it sends nothing$"):
        started(desk, call, asks=asks)
    assert desk.sent == []


@pytest.mark.parametrize("overtake", STOPS)
def test_program_is_sent_when_its_call_comes_after_the_stop(
    desk: Programming, overtake: Callable[[Programming], None]
) -> None:
    overtake(desk)
    started(desk, PendingCall())
    assert len(desk.sent) == 1


@pytest.mark.parametrize("overtake", [stop, change_of_policy])
def test_program_gets_no_permission_after_a_stop(desk: Programming, overtake: Callable[[Programming], None]) -> None:
    run = started(desk, PendingCall())
    sent = len(desk.sent)
    overtake(desk)
    run.begins()
    assert isinstance(run.error, Cancelled)
    assert not any("write_output_integer_register" in text for text in desk.sent[sent:])


def test_stop_is_sent_even_after_a_later_stop(desk: Programming) -> None:
    call = PendingCall()
    stop(desk)
    started(desk, call, is_stop=True, asks=False)
    assert len(desk.sent) == 1


def test_call_during_an_active_stop_raises_safety_stop(desk: Programming) -> None:
    call = PendingCall()
    desk.realtime.deliver(fast(SafetyMode.PROTECTIVE_STOP))
    with pytest.raises(SafetyStop, match="protective stop"):
        started(desk, call)


def test_setpoint_is_not_sent_after_a_stop(desk: Programming) -> None:
    call, sent = PendingCall(), []
    stop(desk)
    with pytest.raises(Cancelled):
        call.make(lambda: desk.channel.setpoint(lambda: sent.append(1)))
    desk.channel.setpoint(lambda: sent.append(2))  # belongs to no call, but to a program that the stop replaces
    assert sent == [2]


def test_output_is_sent_after_a_stop(desk: Programming) -> None:
    call = PendingCall()
    stop(desk)
    call.make(lambda: desk.channel.command("set_digital_out(0, True)"))
    assert len(desk.sent) == 1


def test_cancel_of_one_motion_does_not_affect_another(desk: Programming) -> None:
    first, call = desk.motion(), PendingCall()
    first.cancel()
    second = started(desk, call)
    assert second.phase is Phase.SENT


def test_call_is_sent_when_the_last_stop_was_before_it(desk: Programming) -> None:
    desk.primary.deliver(slow(SafetyMode.SAFEGUARD_STOP))
    call = PendingCall()
    desk.primary.deliver(slow())
    started(desk, call)
    assert len(desk.sent) == 1

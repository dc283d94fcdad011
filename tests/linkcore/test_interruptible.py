"""Interruptible waits: a thread waits on behalf of a task, and the wait ends when the task is cancelled."""

from __future__ import annotations

import threading
from collections.abc import Callable

import pytest

from linkcore.errors import Cancelled
from linkcore.pending_call import PendingCall, interruptible, regardless

pytestmark = pytest.mark.simulated_time


def at_once(call: Callable[[], object]) -> None:
    call()


def test_give_up_wakes_an_interruptible_wait() -> None:
    call, waits, woken = PendingCall(), threading.Event(), threading.Event()
    ended: list[Exception] = []

    def wait() -> None:
        with interruptible(woken.set):
            waits.set()
            assert woken.wait(60.0)

    def make() -> None:
        try:
            call.make(wait)
        except Cancelled as error:
            ended.append(error)

    thread = threading.Thread(target=make)
    thread.start()
    assert waits.wait(60.0)
    call.give_up(at_once)
    thread.join(60.0)
    assert len(ended) == 1


def test_interruptible_raises_cancelled_after_give_up() -> None:
    call = PendingCall()
    call.give_up(at_once)

    def wait() -> None:
        with interruptible(lambda: None):
            raise AssertionError("the abandoned call has waited")

    with pytest.raises(Cancelled):
        call.make(wait)


def test_give_up_does_not_wake_an_ended_wait() -> None:
    call, woken = PendingCall(), threading.Event()

    def wait() -> None:
        with interruptible(woken.set):
            pass

    call.make(wait)
    call.give_up(at_once)
    assert not woken.is_set()


def test_interruptible_has_no_effect_outside_a_call() -> None:
    call, woken = PendingCall(), threading.Event()

    def wait() -> None:
        with interruptible(woken.set):
            call.give_up(at_once)

    wait()
    call = PendingCall()
    call.make(lambda: regardless(wait))
    assert not woken.is_set()


def test_give_up_undoes_a_call_that_has_returned() -> None:
    call, undone = PendingCall(), threading.Event()
    call.make(lambda: call.on_give_up(undone.set))
    assert not undone.is_set()
    call.give_up(at_once)
    assert undone.is_set()


def test_on_give_up_runs_immediately_after_give_up() -> None:
    call, undone = PendingCall(), threading.Event()
    call.give_up(at_once)
    call.on_give_up(undone.set)
    assert undone.is_set()

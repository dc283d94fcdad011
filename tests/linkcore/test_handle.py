"""Life cycle of a motion, program or mission: its transition table for any order of events, and its handle."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import sys
import threading
from collections.abc import Iterator
from types import FrameType
from typing import Any

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from linkcore import clock
from linkcore.errors import BadValue, Cancelled, ConnectionLost, LinkTimeout, LocalError
from linkcore.handle import AFTER, TRANSITIONS, Event, Handle, Lifecycle, Motion, Occurrence, Phase
from linkcore.pending_call import PendingCall
from linkcore.threads import CallbackThread
from tests.waiting import interrupted, until

pytestmark = pytest.mark.simulated_time

OVER = (Phase.DONE, Phase.CANCELLED, Phase.FAILED)
ENDS = (Event.FINISH, Event.CANCEL, Event.FAIL)


@pytest.fixture
def callbacks() -> Iterator[CallbackThread]:
    thread = CallbackThread("callbacks of a test")
    yield thread
    thread.close(5)
    assert "callbacks of a test" not in [each.name for each in threading.enumerate()]


@pytest.fixture
def life(callbacks: CallbackThread) -> Lifecycle:
    return Lifecycle("job", callbacks)


def happen(life: Lifecycle, event: Event) -> bool:
    if event is Event.BEGIN:
        return life.begin()
    if event is Event.FINISH:
        return life.finish()
    if event is Event.CANCEL:
        return life.cancel("cancelled", brake=True)
    if event is Event.FAIL:
        return life.fail(ConnectionLost("pulled"))
    return life.fire(event)


#: The table as printed in the docstring of the module.
TABLE = """
SEND       SENT      -            -         -
BEGIN      RUNNING   -            -         -
LINK       SENT      RUNNING      SEND      -
LOSE       SENT      RUNNING      SEND      -
BRAKE      SENT      RUNNING      SEND      -
REPORT     -         RUNNING      -         -
STOP       SENT      RUNNING      -         -
SETTLE     -         RUNNING      REPORT    -
FINISH     DONE      DONE         -         -
CANCEL     CANCELLED CANCELLED    -         -
FAIL       FAILED    FAILED       -         -
"""


def test_transition_table_equals_module_docstring() -> None:
    said, needed = {}, {}
    for row in TABLE.strip().splitlines():
        event, *phases, before, _ = row.split()
        for phase, after in zip((Phase.SENT, Phase.RUNNING), phases, strict=True):
            if after != "-":
                said[phase, Event[event]] = Phase[after]
        if before != "-":
            needed[Event[event]] = Event[before]
    assert said == TRANSITIONS
    assert needed == AFTER
    assert TABLE.strip() in str(sys.modules[Lifecycle.__module__].__doc__)


class Modelled:
    """Second implementation of the transition table, which keeps the past events in a set."""

    def __init__(self) -> None:
        self.phase = Phase.SENT
        self.events: set[Event] = set()

    def happen(self, event: Event) -> bool | None:
        """Whether the event has an effect; None if it must raise an error."""
        if self.phase in OVER or (event in self.events and event is not Event.REPORT):
            return False
        after, needs = TRANSITIONS.get((self.phase, event)), AFTER.get(event, event)
        if after is None or needs not in {*self.events, event}:
            return None
        self.phase = after
        self.events.add(event)
        return True


def compare(life: Lifecycle, modelled: Modelled, event: Event) -> None:
    before, wanted = set(modelled.events), modelled.happen(event)
    if wanted is None:
        with pytest.raises(RuntimeError, match=f"job: '{event.value}' cannot happen while it is {life.phase.value}"):
            happen(life, event)
        assert modelled.events == before
    else:
        assert happen(life, event) == wanted
    assert life.phase is modelled.phase
    for each in Event:
        assert (life.happened(each) is not None) == (each in modelled.events and each not in ENDS)


def test_lifecycle_behaves_like_its_model_for_three_events(callbacks: CallbackThread) -> None:
    for events in itertools.product(Event, repeat=3):
        life, modelled = Lifecycle("job", callbacks), Modelled()
        for event in events:
            compare(life, modelled, event)


def test_event_keeps_its_time_and_error(life: Lifecycle) -> None:
    assert life.fire(Event.SEND)
    assert life.begin(at=2.0)
    assert not life.begin(at=3.0)
    assert life.happened(Event.BEGIN) == (Event.BEGIN, 2.0, None)
    assert life.fire(Event.LOSE, ConnectionLost("pulled"), at=4.0)
    assert life.fire(Event.REPORT, at=5.0)
    assert life.fire(Event.REPORT, ConnectionLost("too"), at=6.0)
    report = life.happened(Event.REPORT)
    assert report is not None
    assert (report.at, str(report.error)) == (6.0, "too")
    lost = life.happened(Event.LOSE)
    assert lost is not None
    assert (lost.at, str(lost.error), life.error) == (4.0, "pulled", None)


def test_event_is_recorded_once_when_two_threads_fire_it(life: Lifecycle) -> None:
    """The other thread reports the event after this thread has read the table, and before it has fired."""

    class Interrupted(dict[Event | None, Occurrence]):
        def setdefault(self, key: Event | None, mark: Occurrence) -> Occurrence:
            if key not in self:
                self[key] = Occurrence(Event.LOSE, 1.0, None)
            return self[key]

    life.fire(Event.SEND)
    life._marks = Interrupted(life._marks)
    assert not life.fire(Event.LOSE, ConnectionLost("pulled"), at=2.0)
    assert life.happened(Event.LOSE) == (Event.LOSE, 1.0, None)


class Life(RuleBasedStateMachine):
    """Events in any order, with waiters, callbacks and releases that are notified of them."""

    @initialize()
    def begin(self) -> None:
        self.callbacks = CallbackThread("callbacks of a state machine")
        self.life = Lifecycle("job", self.callbacks)
        self.handle = Motion(self.life)
        self.brakes = 0
        self.life.brake = lambda: setattr(self, "brakes", self.brakes + 1)
        self.modelled = Modelled()
        self.releases = self.wanted_releases = self.wanted_calls = self.wanted_brakes = 0
        self.calls: list[Handle] = []

    def teardown(self) -> None:
        if not hasattr(self, "callbacks"):
            return
        self.callbacks.close(5)
        if self.modelled.phase in OVER:
            assert self.calls == [self.handle] * self.wanted_calls

    @rule(event=st.sampled_from(Event))
    def happen(self, event: Event) -> None:
        self.wanted_brakes += event is Event.CANCEL and self.modelled.phase not in OVER
        compare(self.life, self.modelled, event)

    @rule()
    def release(self) -> None:
        self.life.on_end(lambda: setattr(self, "releases", self.releases + 1))
        self.wanted_releases += 1

    @rule()
    def call_back(self) -> None:
        self.handle.add_done_callback(self.calls.append)
        self.wanted_calls += 1

    @rule()
    def cancel(self) -> None:
        self.handle.cancel()
        self.wanted_brakes += bool(self.modelled.happen(Event.CANCEL))

    @invariant()
    def as_modelled(self) -> None:
        if not hasattr(self, "life"):
            return
        phase = self.modelled.phase
        is_over = phase in OVER
        assert self.handle.phase is phase
        assert self.handle.done == self.life.future.done() == is_over
        assert (self.handle.error is None) == (phase not in (Phase.CANCELLED, Phase.FAILED))
        assert self.releases == (self.wanted_releases if is_over else 0)
        assert self.brakes == self.wanted_brakes
        assert self.handle.progress == (1.0 if phase is Phase.DONE else 0.0)


TestLife = pytest.mark.property(Life.TestCase)
TestLife.settings = settings(deadline=None, stateful_step_count=15)


# -- waits and callbacks ---------------------------------------------------------------------------------


def test_wait_times_out_returns_at_the_end_and_checks_timeout(life: Lifecycle) -> None:
    handle = Handle(life)
    with pytest.raises(LinkTimeout, match=r"job has not ended within 0\.01 s, and continues; its phase is sent"):
        handle.wait(0.01)
    waiter = threading.Thread(target=handle.wait, args=(10,))
    waiter.start()
    life.begin()
    life.finish()
    waiter.join(10)
    assert not waiter.is_alive()
    handle.wait(0)
    for timeout in (None, -1, "soon", float("nan")):
        with pytest.raises(BadValue, match="timeout"):
            handle.wait(timeout)  # type: ignore[arg-type]


def test_wait_raises_the_first_error_each_time(life: Lifecycle) -> None:
    handle = Handle(life)
    life.fail(ConnectionLost("pulled"))
    life.cancel("cancelled", brake=False)
    for _ in range(2):
        with pytest.raises(ConnectionLost, match="pulled"):
            handle.wait()
    assert repr(handle) == "<Handle job failed: pulled>"


def test_wait_raises_local_error_in_the_reporting_thread(callbacks: CallbackThread) -> None:
    def refusing() -> contextlib.AbstractContextManager[object]:
        raise LocalError("this thread has to report the end")

    life = Lifecycle("job", callbacks, refusing)
    with pytest.raises(LocalError, match="has to report the end"):
        Handle(life).wait(10)
    life.finish()
    Handle(life).wait(10)  # returns, because the job has ended


@pytest.mark.real_time
def test_interrupted_wait_cancels(life: Lifecycle) -> None:
    brakes: list[None] = []
    life.brake = lambda: brakes.append(None)
    handle = Handle(life)
    with pytest.raises(LinkTimeout):
        handle.wait(0.0)
    interrupted(lambda: handle.wait(10, cancel=False))
    assert (handle.done, len(brakes)) == (False, 0)
    interrupted(lambda: handle.wait(10))
    assert (handle.phase, len(brakes)) == (Phase.CANCELLED, 1)


class InterruptedTwice(Handle):
    """Handle whose first `cancel` is interrupted at line `number` of the lines executed in the module and in `brake`.

    Attributes:
        left: Number of lines left until the interrupt. It stays above 0 if `cancel` executes fewer lines.
    """

    def __init__(self, life: Lifecycle, number: int) -> None:
        super().__init__(life)
        self.left = number
        self.brakes = 0
        self._is_first = True
        life.brake = self.brake

    def brake(self) -> None:
        self.brakes += 1

    def cancel(self) -> None:
        if self._is_first:
            self._is_first = False
            sys.settrace(self._trace)  # removed again when it raises
        super().cancel()

    def _trace(self, frame: FrameType, event: str, _: object) -> Any:
        here = (Lifecycle.cancel.__code__.co_filename, __file__)
        if frame.f_code.co_filename not in here:
            return None
        if event == "line":
            self.left -= 1
            if not self.left:
                raise KeyboardInterrupt
        return self._trace


@pytest.mark.real_time
def test_second_interrupt_does_not_prevent_braking(callbacks: CallbackThread) -> None:
    tracing = sys.gettrace()
    for number in range(1, 100):
        handle = InterruptedTwice(Lifecycle(f"job {number}", callbacks), number)
        try:
            interrupted(lambda: handle.wait(10))  # noqa: B023 - called within this iteration
        finally:
            sys.settrace(tracing)
        assert handle.phase is Phase.CANCELLED, number
        assert handle.brakes, number
        if handle.left > 0:
            break
    assert 10 < number < 99


def test_cancelled_await_cancels_the_handle(life: Lifecycle, callbacks: CallbackThread) -> None:
    other = Lifecycle("other", callbacks)

    async def use() -> None:
        with pytest.raises(asyncio.TimeoutError):
            await asyncio.wait_for(asyncio.shield(Handle(other)), 0.01)
        assert not other.is_over
        handle = Handle(life)
        with pytest.raises(asyncio.TimeoutError):
            await asyncio.wait_for(_awaited(handle), 0.01)
        assert handle.phase is Phase.CANCELLED
        with pytest.raises(Cancelled, match="job was cancelled"):
            await handle

    asyncio.run(use())


async def _awaited(handle: Handle) -> None:
    await handle


def test_await_raises_local_error_without_asyncio_loop(life: Lifecycle) -> None:
    """For example in trio, which runs coroutines without asyncio."""
    waiting = _awaited(Handle(life))
    with pytest.raises(LocalError, match="awaiting job needs a running asyncio event loop"):
        waiting.send(None)
    assert not life.is_over


def test_leaving_the_block_cancels(life: Lifecycle) -> None:
    with Handle(life) as handle:
        assert not handle.done
    assert handle.phase is Phase.CANCELLED


def test_done_callbacks_run_in_the_callback_thread(life: Lifecycle) -> None:
    handle = Handle(life)
    threads: list[str] = []

    def fail(each: Handle) -> None:
        raise RuntimeError("on purpose")

    def leave(each: Handle) -> None:
        sys.exit("on purpose")

    def command(each: Handle) -> None:
        each.wait(10)  # returns at once, because it has ended
        other = Lifecycle("other", CallbackThread("others"))
        threading.Timer(0.01, other.finish).start()
        Handle(other).wait(10)  # a callback can also wait for another motion that is still running
        threads.append(threading.current_thread().name)

    for callback in (fail, leave, command):
        handle.add_done_callback(callback)
    life.finish()
    until(lambda: threads)
    handle.add_done_callback(command)
    until(lambda: len(threads) == 2)
    assert set(threads) == {"callbacks of a test"}
    with pytest.raises(BadValue, match="callback=3"):
        handle.add_done_callback(3)  # type: ignore[arg-type]


def test_cancel_succeeds_when_the_brake_has_no_connection(life: Lifecycle) -> None:
    def brake() -> None:
        raise ConnectionLost("gone")

    life.brake = brake
    handle = Handle(life)
    handle.cancel()
    with pytest.raises(Cancelled):
        handle.wait(0)


def test_error_in_brake_still_ends_the_handle(life: Lifecycle) -> None:
    def brake() -> None:
        raise RuntimeError("a mistake")

    life.brake = brake
    released = threading.Event()
    life.on_end(released.set)
    with pytest.raises(RuntimeError, match="a mistake"):
        Handle(life).cancel()
    assert released.is_set()
    with pytest.raises(Cancelled):
        Handle(life).wait(0)


def test_release_callbacks_run_when_the_ending_call_is_abandoned(life: Lifecycle) -> None:
    """A release may join a thread, even with a timeout of 0. In an abandoned call such a wait would raise."""
    pending, released = PendingCall(), []

    def release() -> None:
        clock.join(threading.main_thread(), 0)
        released.append(True)

    def end() -> None:
        pending.give_up()
        life.fail(ConnectionLost("pulled"))

    life.on_end(release)
    in_thread = threading.Thread(target=lambda: pending.make(end))
    in_thread.start()
    in_thread.join()
    assert released == [True]
    assert isinstance(life.error, ConnectionLost)


def test_lifecycle_ends_once_when_two_threads_end_it(callbacks: CallbackThread) -> None:
    for _ in range(200):
        life = Lifecycle("job", callbacks)
        ends: list[bool] = []
        start = threading.Barrier(2)

        def end(by: Event, life: Lifecycle = life, ends: list[bool] = ends, start: threading.Barrier = start) -> None:
            start.wait(10)
            ends.append(happen(life, by))

        threads = [threading.Thread(target=end, args=(event,)) for event in (Event.FINISH, Event.FAIL)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(10)
        assert sorted(ends) == [False, True]
        assert (life.phase is Phase.DONE) == (life.error is None)


# -- the thread for callbacks ----------------------------------------------------------------------------


def test_callback_thread_restarts_for_calls_after_its_end() -> None:
    name = "callbacks that come and go"
    callbacks = CallbackThread(name)
    assert name not in [each.name for each in threading.enumerate()]
    called: list[int] = []
    for n in range(3):
        callbacks.call(called.append, n)
        if n == 0:
            callbacks.close(5)
            assert name not in [each.name for each in threading.enumerate()]
        until(lambda: name not in [each.name for each in threading.enumerate()])
    assert called == [0, 1, 2]


def test_callback_thread_close_times_out_when_a_callback_hangs() -> None:
    callbacks = CallbackThread("callbacks that hang")
    go_on = threading.Event()
    called: list[int] = []
    callbacks.call(go_on.wait, 10)
    callbacks.call(called.append, 1)
    callbacks.close(0.01)
    assert called == []
    go_on.set()
    until(lambda: called == [1])


def test_callback_can_close_its_callback_thread() -> None:
    callbacks = CallbackThread("callbacks that close")
    done = threading.Event()

    def close() -> None:
        callbacks.close(10)
        done.set()

    callbacks.call(close)
    assert done.wait(5)


def test_callback_is_skipped_and_logged_when_no_thread_starts(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def refuse(thread: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    callbacks = CallbackThread("callbacks without a thread")
    called: list[int] = []
    with monkeypatch.context() as patch:
        patch.setattr(threading.Thread, "start", refuse)
        callbacks.call(called.append, 1)
    assert "is not called" in caplog.text
    callbacks.call(called.append, 2)
    callbacks.close(5)
    assert called == [2]

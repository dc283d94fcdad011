"""Callbacks that exit, raise or are slow: they affect their own subscription only."""

from __future__ import annotations

import sys
import threading
from typing import Any, cast

import pytest

from linkcore.net.transport import Finished
from linkcore.streaming.fanout import FanOut
from linkcore.streaming.packet_queue import PacketQueue, block
from linkcore.streaming.stream import Stream
from linkcore.streaming.subscription import ThreadedDelivery
from linkcore.threads import CallbackThread, started
from tests.fakes.link import Count, ScriptedTransport, counts
from tests.waiting import until

pytestmark = pytest.mark.simulated_time


@pytest.mark.parametrize("error", [SystemExit(1), KeyboardInterrupt(), GeneratorExit()])
def test_exit_in_a_callback_is_counted_and_logged(
    stream: Stream[Count], transport: ScriptedTransport, caplog: pytest.LogCaptureFixture, error: BaseException
) -> None:
    """Otherwise Python would end the thread silently, and the queue would fill up and drop packets."""
    got: list[int] = []

    def leave(count: Count) -> None:
        got.append(count.number)
        raise error

    leaving = stream.subscribe(leave, policy=block)
    transport.put(counts(1, 2), counts(3), Finished())
    assert stream.join(10)
    assert got == [1, 2, 3]
    assert (leaving.stats.offered, leaving.stats.raised, leaving.stats.dropped) == (3, 3, 0)
    assert "callback of script Count raised" in caplog.text


def test_sys_exit_in_on_deadline_is_logged(stream: Stream[Count], caplog: pytest.LogCaptureFixture) -> None:
    subscription = stream.subscribe(lambda count: None, deadline=0.01, on_deadline=lambda age: sys.exit(1))
    until(lambda: "on_deadline of script Count raised" in caplog.text)
    assert subscription.stats.missed_deadlines == 1


def test_callback_thread_can_close_while_it_starts(monkeypatch: pytest.MonkeyPatch) -> None:
    """One thread is starting the callback thread when another thread closes it."""
    callbacks = CallbackThread("callbacks")
    threads: list[threading.Thread] = []

    def start_late(thread: threading.Thread) -> threading.Thread:
        callbacks.close(0.0)
        threads.append(started(thread))
        return thread

    monkeypatch.setattr("linkcore.threads.started", start_late)
    callbacks.call(print)
    threads[0].join(10)
    assert not threads[0].is_alive()


def test_call_after_close_runs_and_leaves_no_thread() -> None:
    """A reader that is just ending may still report the end of a program (world 170528)."""
    callbacks, called = CallbackThread("late callbacks"), threading.Event()
    callbacks.close(1.0)
    callbacks.call(called.set)
    assert called.wait(10)
    until(lambda: "late callbacks" not in [thread.name for thread in threading.enumerate()])


class ClosedBefore:
    """Queue of a `CallbackThread` that is closed just before each call is put."""

    def __init__(self, callbacks: CallbackThread) -> None:
        self._callbacks = callbacks
        self._calls = callbacks._calls
        self.get = self._calls.get

    def put(self, call: Any) -> None:
        if call is not None:
            self._callbacks.close(0.0)
        self._calls.put(call)


def test_call_runs_when_its_thread_ends_just_before() -> None:
    callbacks, called = CallbackThread("ended callbacks"), threading.Event()
    callbacks.call(print)
    callbacks._calls = cast(Any, ClosedBefore(callbacks))
    callbacks.call(called.set)
    assert called.wait(10)
    until(lambda: "ended callbacks" not in [thread.name for thread in threading.enumerate()])


class Packet:
    def __init__(self, *parts: Packet) -> None:
        self.parts = parts


class Part(Packet):
    pass


def test_callback_error_for_one_part_does_not_skip_other_parts() -> None:
    fan_out = FanOut(Packet, parts=lambda packet: packet.parts, others=(Part,))
    parts = [Part(), Part(), Part()]
    got: list[Part] = []

    def fail_once(part: Part) -> None:
        got.append(part)
        if part is parts[0]:
            raise ValueError("on purpose")

    queue = PacketQueue(block)
    delivery = ThreadedDelivery(queue, fail_once, name="parts", expand=fan_out.expander(Part))
    fan_out.add(queue, Part)
    fan_out.publish([Packet(*parts), Packet(), Packet(parts[1])])
    fan_out.end()
    assert delivery.join(10)
    assert got == [*parts, parts[1]]
    stats = delivery.statistics
    assert (stats.offered, stats.raised, stats.delivered) == (2, 1, 1), "the counters count packets, not parts"


def test_newest_packet_is_available_while_others_arrive() -> None:
    """Another thread that reads the newest packet while packets arrive never gets None."""
    fan_out = FanOut(Packet, parts=lambda packet: packet.parts, others=(Part,))
    fan_out.publish([Packet(Part())])
    stop = threading.Event()

    def publish() -> None:
        while not stop.is_set():
            fan_out.publish([Packet(Part())])

    publisher = threading.Thread(target=publish, daemon=True)
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        publisher.start()
        missing = sum(fan_out.newest(kind) is None for _ in range(20_000) for kind in (Packet, Part))
    finally:
        sys.setswitchinterval(interval)
        stop.set()
        publisher.join(10)
    assert missing == 0


def test_newest_of_a_base_class_returns_last_subclass_packet() -> None:
    class Other(Packet):
        pass

    fan_out = FanOut(Packet, parts=lambda packet: packet.parts, others=(Part, Other))
    first, second = Other(), Part()
    fan_out.publish([first, second])
    assert fan_out.newest(Packet) is second
    again = Other()
    fan_out.publish([again])
    assert fan_out.newest(Packet) is again
    assert fan_out.newest(Part) is second
    fan_out.forget()
    assert fan_out.newest(Packet) is None

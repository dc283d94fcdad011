"""Waiting for a packet that meets a condition."""

from __future__ import annotations

import threading
from collections.abc import Callable

import pytest

from linkcore.errors import BadValue, Closed, ConnectionLost, LinkTimeout, LocalError
from linkcore.net.transport import Finished
from linkcore.streaming.connection_life import ConnectionEvent, ConnectionState
from linkcore.streaming.stream import Stream
from tests.fakes.link import Count, ScriptedTransport, counts
from tests.waiting import until

pytestmark = pytest.mark.simulated_time


def at_once(call: Callable[[], object]) -> threading.Thread:
    thread = threading.Thread(target=call)
    thread.start()
    return thread


def test_wait_until_checks_packets_in_order_until_one_matches(
    stream: Stream[Count], transport: ScriptedTransport
) -> None:
    seen: list[int] = []

    def is_forty(count: Count) -> bool:
        if not seen:
            transport.put(counts(*range(1, 99)))
        seen.append(count.number)
        return count.number == 40

    transport.put(counts(0))
    assert stream.wait_until(is_forty, 10).number == 40
    # The first packet may be checked twice: as the newest one, and when it arrives.
    assert list(dict.fromkeys(seen)) == list(range(41))
    assert len(seen) <= 42


def test_wait_until_accepts_the_newest_packet(stream: Stream[Count], transport: ScriptedTransport) -> None:
    transport.put(counts(7))
    until(lambda: stream.latest is not None)
    assert stream.wait_until(lambda count: count.number == 7, 0).number == 7
    with pytest.raises(LinkTimeout, match=r"no Count from script within 0 s"):
        stream.wait_until(lambda count: count.number == 8, 0)


def test_wait_until_ignores_past_events(stream: Stream[Count], transport: ScriptedTransport) -> None:
    stream.start()
    feed = stream.of(ConnectionEvent)
    found = threading.Event()

    def cut() -> None:
        # Repeat it, because an event that arrives before the wait starts does not count.
        while not found.wait(0.01):
            transport.put(ConnectionLost("cut"), counts(1))

    thread = at_once(cut)
    lost = feed.wait_until(lambda event: event.state is ConnectionState.LOST, 10)
    found.set()
    thread.join()
    assert isinstance(lost.error, ConnectionLost)
    transport.put(counts(77))
    stream.wait_until(lambda count: count.number == 77, 10)
    with pytest.raises(LinkTimeout):
        feed.wait_until(lambda event: event.state is ConnectionState.LOST, 0.01)


def test_wait_until_error_counts_the_checked_packets(stream: Stream[Count], transport: ScriptedTransport) -> None:
    seen: list[Count] = []

    def never(count: Count) -> bool:
        seen.append(count)
        return False

    transport.put(counts(1, 2, 3))
    with pytest.raises(LinkTimeout, match=r"no packet met the condition within 0\.2 s; examined \d Count from script"):
        stream.wait_until(never, 0.2)
    assert seen


def test_wait_until_ends_on_errors_and_on_the_end_of_the_stream(
    stream: Stream[Count], transport: ScriptedTransport
) -> None:
    stream.start()

    def fail(count: Count) -> bool:
        raise RuntimeError("on purpose")

    thread = at_once(lambda: transport.put(counts(1)))
    with pytest.raises(RuntimeError, match="on purpose"):
        stream.wait_until(fail, 10)
    thread.join()
    refused: list[str] = []

    def inside(count: Count) -> None:
        try:
            stream.wait_until(bool, 1)
        except LocalError as error:
            refused.append(str(error))

    with stream.subscribe(inside, inline=True):
        transport.put(counts(2))
        until(lambda: refused)
    for condition, timeout in ((3, 1.0), (bool, -1.0)):
        with pytest.raises(BadValue):
            stream.wait_until(condition, timeout)  # type: ignore[arg-type]
    transport.put(Finished())
    with pytest.raises(Closed):
        stream.wait_until(lambda count: False, 10)

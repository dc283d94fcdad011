"""Silence of the peer: the reader distinguishes it from a stall of this process."""

from __future__ import annotations

import threading

import pytest

from linkcore.errors import BadValue, LinkTimeout
from linkcore.streaming.connection_life import Backoff, ConnectionEvent, ConnectionState
from linkcore.streaming.silence import SilenceMonitor
from linkcore.streaming.stream import Stream
from tests import platforms
from tests.fakes.link import Count, ScriptedTransport, connection_over, counts, output_of, scripted
from tests.waiting import until

pytestmark = pytest.mark.simulated_time


def monitor(limit: float | None = 2.0) -> SilenceMonitor:
    silence = SilenceMonitor("script", limit)
    silence.end(100.0)
    return silence


# -- the monitor, without clock or thread ----------------------------------------------------------------


def test_timed_out_waits_add_up_to_silence() -> None:
    silence, reported = monitor(), list[float]()
    silence.watch(0.5, reported.append)
    assert silence.wait == 0.5
    silence.timed_out()
    assert reported == [0.5]
    assert silence.wait == pytest.approx(1.5)
    with pytest.raises(LinkTimeout, match="script: nothing was received for 2 s"):
        silence.timed_out()
    assert reported == [0.5], "the watcher must be called once for each silence"


def test_a_packet_ends_the_silence() -> None:
    silence, reported = monitor(), list[float]()
    silence.watch(0.5, reported.append)
    for _ in range(3):
        before = silence.is_quiet
        silence.timed_out()
        during = silence.is_quiet
        silence.end(101.0)
        assert (before, during, silence.is_quiet) == (False, True, False)
        assert silence.wait == 0.5
    assert reported == [0.5] * 3


def test_suspended_time_does_not_count_as_silence() -> None:
    """The process was suspended for an hour. No wait expired, and then a packet arrives."""
    silence, reported = monitor(), list[float]()
    silence.watch(0.5, reported.append)
    silence.last = 3700.0
    assert reported == []
    assert not silence.is_quiet


def test_silence_watchers_are_called_in_order_of_their_limits() -> None:
    silence, reported = monitor(), list[str]()
    silence.watch(1.0, lambda seconds: reported.append(f"one {seconds:g}"))
    silence.watch(0.25, lambda seconds: reported.append(f"quarter {seconds:g}"))
    waits = []
    for _ in range(2):
        waits.append(silence.wait)
        silence.timed_out()
    assert waits == [0.25, 0.75]
    assert reported == ["quarter 0.25", "one 1"]
    assert silence.wait == 1.0
    with pytest.raises(LinkTimeout):
        silence.timed_out()


def test_silence_limit_is_reached_despite_rounding_errors() -> None:
    silence, reported = monitor(0.3), list[float]()
    silence.watch(0.1, reported.append)
    silence.watch(0.2, reported.append)
    silence.timed_out()
    silence.timed_out()
    assert reported == [pytest.approx(0.1), pytest.approx(0.2)]
    with pytest.raises(LinkTimeout):
        silence.timed_out()


def test_silence_without_limit_calls_watchers_but_raises_nothing() -> None:
    silence, reported = monitor(None), list[float]()
    assert silence.wait is None
    silence.timed_out()  # a transport that times out on its own, after an unknown time
    remove = silence.watch(0.5, reported.append)
    silence.timed_out()
    silence.timed_out()
    assert reported == [0.5]
    remove()
    silence.end(101.0)
    assert silence.wait is None


def test_removed_silence_watcher_is_not_called() -> None:
    silence, reported = monitor(), list[float]()
    remove = silence.watch(0.5, reported.append)
    remove()
    remove()
    assert silence.wait == 0.5, "the wait changes only with the next packet"
    silence.timed_out()
    assert reported == []


def test_bytes_without_a_packet_count_as_silence() -> None:
    silence, reported = monitor(), list[float]()
    silence.watch(0.5, reported.append)
    for now in (100.2, 100.4, 100.6):
        silence.no_packet(now)
    assert reported == []
    silence.no_packet(100.8)
    assert reported == [pytest.approx(0.6)]
    silence.no_packet(102.1)
    with pytest.raises(LinkTimeout, match="bytes, but no complete packet, were received for 2 s"):
        silence.no_packet(102.2)


def test_partial_packet_read_late_does_not_count_as_silence() -> None:
    """The packet was read late, and its other half is still in the socket."""
    silence, reported = monitor(), list[float]()
    silence.watch(0.5, reported.append)
    before = silence.is_quiet
    silence.no_packet(160.0)
    # The flag makes the reader end the silence at the next packet.
    assert (before, silence.is_quiet) == (False, True)
    silence.end(160.001)
    silence.no_packet(160.1)
    silence.no_packet(160.2)
    assert reported == []


def test_error_in_a_watcher_is_logged_only(caplog: pytest.LogCaptureFixture) -> None:
    silence, reported = monitor(), list[float]()

    def fail(seconds: float) -> None:
        raise ValueError("on purpose")

    silence.watch(0.5, fail)
    silence.watch(0.5, reported.append)
    silence.timed_out()
    assert reported == [0.5]
    assert "on purpose" in caplog.text


@pytest.mark.parametrize("seconds", [0, -1, 2.1, float("nan")])
def test_watch_rejects_limits_beyond_the_silence(seconds: float) -> None:
    with pytest.raises(BadValue, match="expected a positive number, at most silence=2"):
        monitor().watch(seconds, print)


# -- in a stream ----------------------------------------------------------------------------------------


def test_silence_is_reported_before_the_connection_is_lost() -> None:
    transport = ScriptedTransport()
    here = connection_over(transport, silence=0.1, backoff=Backoff(first=60, most=60))
    stream = Stream(here, Count)
    reported: list[tuple[float, bool]] = []
    events: list[ConnectionEvent] = []
    stream.subscribe(events.append, ConnectionEvent, inline=True)
    here.silence.watch(0.03, lambda seconds: reported.append((seconds, here.reads_here())))
    transport.put(counts(1))
    until(lambda: any(event.state is ConnectionState.LOST for event in events))
    (lost,) = (event for event in events if event.state is ConnectionState.LOST)
    assert isinstance(lost.error, LinkTimeout)
    ((seconds, in_the_reader),) = reported
    assert seconds == pytest.approx(0.03)
    assert in_the_reader
    stream.close()


def test_stream_with_bytes_but_no_packets_raises_link_timeout() -> None:
    transport = ScriptedTransport()
    stream = scripted(transport, silence=0.5, backoff=Backoff(tries=0))
    stop = threading.Event()

    def babble() -> None:
        while not stop.wait(0.002):
            transport.put(b"x")

    babbler = threading.Thread(target=babble, daemon=True)
    babbler.start()
    try:
        with pytest.raises(LinkTimeout, match="bytes, but no complete packet"):
            next(stream.iterate(timeout=10))
    finally:
        stop.set()
        babbler.join(10)
        stream.close()


#: Program that reads a stream while a C call holds the interpreter lock for 1 s, five times the silence limit.
_STALLED = """
import ctypes, sys, threading
from linkcore.net.transport import TcpTransport
from linkcore.streaming.connection_life import ConnectionEvent
from tests.fakes.link import Count, scripted

stream = scripted(TcpTransport("127.0.0.1", int(sys.argv[1]), silence=60), silence=0.2)
events, reported = [], []
stream.subscribe(lambda event: events.append(event.state.value), ConnectionEvent, inline=True)
stream._connection.silence.watch(0.1, reported.append)
stream.wait(10)
before = stream.stats.received
ctypes.PyDLL(None).usleep(1_000_000)
stream.wait(10)
print(stream.stats.received - before > 20, stream.stats.reconnects, events[-1], reported)
stream.close()
"""


@pytest.mark.real_time
@pytest.mark.slow
@platforms.needs_signals
def test_stall_of_this_process_is_not_silence() -> None:
    out = output_of(_STALLED)
    assert out.split("\n")[0] == "True 0 connected []"

"""Streams that are never closed, threads that cannot be started, and processes that fork."""

from __future__ import annotations

import gc
import threading
import weakref
from typing import Any

import pytest

from linkcore.errors import LocalError
from linkcore.net.transport import Finished
from linkcore.streaming.connection import Connection
from linkcore.streaming.connection_life import ConnectionState
from linkcore.streaming.stream import Stream
from tests import platforms
from tests.fakes.link import Count, ScriptedTransport, connection_over, counts, output_of, scripted
from tests.waiting import until

pytestmark = pytest.mark.simulated_time


def let_go(held: list[Any]) -> None:
    held.clear()
    gc.collect()


def test_unreferenced_stream_is_closed_with_a_warning(transport: ScriptedTransport) -> None:
    stream = scripted(transport)
    stream.subscribe(lambda count: None)
    stream.subscribe(lambda count: None, inline=True)
    transport.put(counts(1))
    assert stream.wait(10).number == 1
    seen, held = weakref.ref(stream), [stream]
    del stream
    with pytest.warns(ResourceWarning, match=r"Stream of Count from script.*was not closed"):
        let_go(held)
    assert seen() is None
    until(lambda: not [thread for thread in threading.enumerate() if thread.name.startswith("script")])


@pytest.mark.parametrize("how", ["feed", "subscription", "iterator"])
def test_reference_to_a_part_keeps_the_stream_open(transport: ScriptedTransport, how: str) -> None:
    connection = connection_over(transport)
    stream = Stream(connection, Count)
    got: list[int] = []
    part: Any
    if how == "feed":
        part = stream.of(Count)
        stream.start()
    elif how == "subscription":
        part = stream.subscribe(lambda count: got.append(count.number))
    else:
        part = stream.iterate()
        transport.put(counts(0))
        assert next(part).number == 0
    held = [part]
    del stream, part
    gc.collect()
    assert connection.state is ConnectionState.CONNECTED
    with pytest.warns(ResourceWarning, match="was not closed"):
        let_go(held)


@pytest.mark.parametrize("how", ["never used", "closed", "over"])
def test_unreferenced_stream_without_connection_gives_no_warning(transport: ScriptedTransport, how: str) -> None:
    stream = scripted(transport)
    if how == "closed":
        stream.start()
        stream.close()
    elif how == "over":
        transport.put(Finished())
        assert list(stream) == []
    del stream
    gc.collect()


def no_more_threads(monkeypatch: pytest.MonkeyPatch, first: str) -> None:
    """Make the start of every thread fail whose name starts with `first`."""
    start = threading.Thread.start

    def refuse(self: threading.Thread) -> None:
        if self.name.startswith(first):
            raise RuntimeError("can't start new thread")
        start(self)

    monkeypatch.setattr(threading.Thread, "start", refuse)


def test_use_raises_local_error_if_reader_thread_cannot_start(
    stream: Stream[Count], transport: ScriptedTransport, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        no_more_threads(patch, "script reader")
        for use in (stream.start, stream.wait, lambda: stream.subscribe(print), lambda: stream.latest):
            with pytest.raises(LocalError, match=r"no thread could be started for script reader \(can't start"):
                use()
        stream.of(Count)
    # The stream works again when threads can be started again.
    transport.put(counts(7))
    assert stream.wait(10).number == 7


@pytest.mark.parametrize("inline", [False, True])
def test_subscribe_raises_local_error_without_a_thread(
    stream: Stream[Count],
    connection: Connection,
    transport: ScriptedTransport,
    monkeypatch: pytest.MonkeyPatch,
    inline: bool,
) -> None:
    stream.start()
    with monkeypatch.context() as patch:
        no_more_threads(patch, "script Count")
        with pytest.raises(LocalError, match="no thread could be started"):
            stream.subscribe(print, deadline=1.0, inline=inline)
    assert stream.connection is ConnectionState.CONNECTED
    assert connection.fan_out.sinks == ()
    stream.close()


def test_close_works_when_no_thread_can_start(transport: ScriptedTransport, monkeypatch: pytest.MonkeyPatch) -> None:
    stream = scripted(transport)
    no_more_threads(monkeypatch, "script")
    with pytest.raises(LocalError):
        stream.subscribe(print)
    stream.close()
    stream.close()


_FORKED = """
import os, sys
from linkcore.net.transport import TcpTransport
from tests.fakes.link import scripted

stream = scripted(TcpTransport("127.0.0.1", int(sys.argv[1]), silence=60))
first = stream.wait(20).number
child = os.fork()
if child == 0:
    stream.close(0.5)
    os._exit(0)
os.waitpid(child, 0)
for _ in range(3):
    assert stream.wait(20).number > first
print(stream.stats.reconnects)
stream.close()
"""


@pytest.mark.real_time
@pytest.mark.slow
@platforms.needs_fork
def test_close_in_a_forked_child_does_not_affect_the_parent() -> None:
    out = output_of(_FORKED)
    assert out == "0\n"

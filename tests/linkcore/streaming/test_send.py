"""Sending on a stream's own connection: at once or not at all."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from linkcore.errors import Closed, ConnectFailed, ConnectionLost, LinkTimeout, LocalError
from linkcore.recording.file import Recording
from linkcore.recording.player import ReplayClock, ReplayTransport
from linkcore.recording.recorder import Recorder
from linkcore.streaming.backoff import Backoff
from linkcore.streaming.events import ConnectionState
from linkcore.streaming.stream import Stream
from tests.linkcore.script import Count, CountProtocol, ScriptedTransport, counts
from tests.waiting import until


@pytest.fixture
def transport() -> ScriptedTransport:
    return ScriptedTransport()


@pytest.fixture
def stream(transport: ScriptedTransport) -> Iterator[Stream[Count]]:
    stream = Stream("script", transport, CountProtocol, Count, backoff=Backoff(first=0, most=0), silence=None)
    yield stream
    stream.close()


def test_connects_if_nothing_has_yet(stream: Stream[Count], transport: ScriptedTransport) -> None:
    stream.send(b"text\n", 1.0)
    assert transport.sent == [b"text\n"]
    assert stream.connection is ConnectionState.CONNECTED


def test_nobody_there() -> None:
    transport = ScriptedTransport(ConnectFailed("refused"))
    stream = Stream("script", transport, CountProtocol, Count, silence=None)
    with pytest.raises(ConnectFailed):
        stream.send(b"text\n", 1.0)
    assert transport.sent == []
    stream.close()


def test_nothing_is_kept_for_the_next_connection() -> None:
    transport = ScriptedTransport(None, ConnectFailed("gone for now"))
    stream = Stream("script", transport, CountProtocol, Count, backoff=Backoff(first=30, most=30), silence=None)
    stream.send(b"one\n", 1.0)
    transport.put(ConnectionLost("pulled"))
    until(lambda: stream.connection is ConnectionState.LOST)
    with pytest.raises(ConnectionLost, match="not connected: pulled"):
        stream.send(b"two\n", 1.0)
    assert transport.sent == [b"one\n"]
    stream.close()


def test_half_a_text_ends_the_connection(stream: Stream[Count], transport: ScriptedTransport) -> None:
    stream.send(b"one\n", 1.0)
    transport.refusal = LinkTimeout("it is not taken")
    with pytest.raises(LinkTimeout):
        stream.send(b"two\n", 1.0)
    until(lambda: transport.opened == 2 and stream.connection is ConnectionState.CONNECTED)
    stream.send(b"three\n", 1.0)
    assert transport.sent == [b"one\n", b"three\n"]


def test_closed(stream: Stream[Count], transport: ScriptedTransport) -> None:
    stream.close()
    with pytest.raises(Closed):
        stream.send(b"text\n", 1.0)
    assert transport.sent == []


def test_a_recording_takes_nothing(stream: Stream[Count], transport: ScriptedTransport, tmp_path: Path) -> None:
    with Recorder(tmp_path / "run.log") as recorder:
        recorder.add(stream, {"name": "script"})
        transport.put(counts(1, 2))
        until(lambda: stream.stats.received == 2)
    recording = Recording(tmp_path / "run.log")
    played = Stream(
        "played",
        ReplayTransport(recording, "script", ReplayClock(recording, 0)),
        CountProtocol,
        Count,
        backoff=Backoff(first=0, most=0),
        silence=None,
        lossless=True,
    )
    with pytest.raises(LocalError, match=r"recording|is over"):
        played.send(b"text\n", 1.0)
    played.close()

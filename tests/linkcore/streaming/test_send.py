"""Sending on the connection of a stream: data is sent immediately or not at all."""

from __future__ import annotations

from pathlib import Path

import pytest

from linkcore.errors import Closed, ConnectFailed, ConnectionLost, LinkTimeout, LocalError
from linkcore.recording.file import RecordingFile
from linkcore.recording.player import ReplayTimeline, ReplayTransport
from linkcore.recording.recorder import Recorder
from linkcore.streaming.connection import Connection
from linkcore.streaming.connection_life import Backoff, ConnectionState
from linkcore.streaming.stream import Stream
from tests.fakes.link import Count, ScriptedTransport, connection_over, counts
from tests.waiting import until

pytestmark = pytest.mark.simulated_time


def test_send_connects_an_idle_stream(
    stream: Stream[Count], connection: Connection, transport: ScriptedTransport
) -> None:
    connection.send(b"text\n", 1.0)
    assert transport.sent == [b"text\n"]
    assert stream.connection is ConnectionState.CONNECTED


def test_send_raises_when_the_connection_is_refused() -> None:
    transport = ScriptedTransport(ConnectFailed("refused"))
    connection = connection_over(transport)
    with pytest.raises(ConnectFailed):
        connection.send(b"text\n", 1.0)
    assert transport.sent == []
    connection.close(2.0)


def test_send_does_not_keep_data_for_the_next_connection() -> None:
    transport = ScriptedTransport(None, ConnectFailed("gone for now"))
    connection = connection_over(transport, backoff=Backoff(first=30, most=30))
    connection.send(b"one\n", 1.0)
    transport.put(ConnectionLost("pulled"))
    until(lambda: connection.state is ConnectionState.LOST)
    with pytest.raises(ConnectionLost, match="not connected: pulled"):
        connection.send(b"two\n", 1.0)
    assert transport.sent == [b"one\n"]
    connection.close(2.0)


def test_partly_sent_text_ends_the_connection(
    stream: Stream[Count], connection: Connection, transport: ScriptedTransport
) -> None:
    connection.send(b"one\n", 1.0)
    transport.make_room(2)
    with pytest.raises(LinkTimeout, match="did not accept"):
        connection.send(b"two\n", 0.05)
    until(lambda: transport.opened == 2 and stream.connection is ConnectionState.CONNECTED)
    transport.make_room(None)
    connection.send(b"three\n", 1.0)
    assert transport.sent == [b"one\n", b"tw", b"three\n"]


def test_send_raises_closed_after_close(
    stream: Stream[Count], connection: Connection, transport: ScriptedTransport
) -> None:
    stream.close()
    with pytest.raises(Closed):
        connection.send(b"text\n", 1.0)
    assert transport.sent == []


def test_send_raises_for_a_recording(stream: Stream[Count], transport: ScriptedTransport, tmp_path: Path) -> None:
    with Recorder(tmp_path / "run.log") as recorder:
        recorder.add(stream, {"name": "script"})
        transport.put(counts(1, 2))
        until(lambda: stream.stats.received == 2)
    recording = RecordingFile(tmp_path / "run.log")
    played = connection_over(ReplayTransport(recording, "script", ReplayTimeline(recording, 0)), name="played")
    with pytest.raises(LocalError, match=r"recording|has ended"):
        played.send(b"text\n", 1.0)
    played.close(2.0)

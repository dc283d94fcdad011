"""Replay of recordings: times of the chunks, losses and reconnections, and completeness."""

from __future__ import annotations

import json
import tempfile
import threading
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

import linkcore.clock
from linkcore.clock import Stamp
from linkcore.errors import BadRecording, BadValue, ConnectFailed, ConnectionLost, LinkTimeout
from linkcore.net.transport import Finished
from linkcore.recording.file import Kind, RecordingFile, RecordingWriter
from linkcore.recording.player import ReplayTimeline, ReplayTransport
from linkcore.recording.recorder import Recorder
from linkcore.streaming.connection_life import ConnectionEvent, ConnectionState
from linkcore.streaming.stream import Stream
from tests.fakes.link import Count, ScriptedTransport, counts, scripted
from tests.waiting import threads_named, until

#: Seconds, and the received bytes or the state of an event.
Line = tuple[float, bytes | str]


def write(path: Path, *channels: Iterable[Line]) -> RecordingFile:
    """Write a recording of these channels, named "0", "1", ..., with monotonic stamps that start at 5000."""
    writer = RecordingWriter(path)
    for number, lines in enumerate(channels):
        writer.add_channel({"name": str(number)})
        for seconds, what in lines:
            stamp = Stamp(5000 + seconds, 1e9 + seconds)
            if isinstance(what, bytes):
                writer.write(Kind.BYTES, number, stamp, what)
            else:
                event = {"state": what, "error": f"at {seconds:g}" if what == "lost" else None}
                writer.write(Kind.EVENT, number, stamp, json.dumps(event).encode())
    writer.close()
    return RecordingFile(path)


class Elapsed:
    """Simulated seconds since the creation of this object."""

    def __init__(self) -> None:
        self._begun = linkcore.clock.now()

    def __call__(self) -> float:
        return linkcore.clock.now() - self._begun


def about(seconds: Any) -> Any:
    """Return an approximation for simulated time, in which each reading of a clock takes a microsecond."""
    return pytest.approx(seconds, abs=1e-4)


def opened(recording: RecordingFile, rate: float = 1.0, channel: str = "0") -> ReplayTransport:
    transport = ReplayTransport(recording, channel, ReplayTimeline(recording, rate))
    transport.open(5)
    return transport


# -- times --------------------------------------------------------------------------------------------


@pytest.mark.simulated_time
@pytest.mark.parametrize("rate", [1.0, 2.0, 0.5, 20.0])
def test_replayed_chunks_arrive_at_their_times(tmp_path: Path, rate: float) -> None:
    recording = write(tmp_path / "run", [(0, b"a"), (0.25, b"b"), (2, b"c")])
    elapsed = Elapsed()
    transport = opened(recording, rate)
    came = []
    for expected in (b"a", b"b", b"c"):
        data, stamp = transport.receive()
        assert data == expected
        assert stamp.monotonic == about(linkcore.clock.now()), "the monotonic stamp is the time of the replay"
        came.append(elapsed())
    assert came == about([0, 0.25 / rate, 2 / rate])
    with pytest.raises(Finished):
        transport.receive()


@pytest.mark.simulated_time
def test_replayed_stamps_have_the_recorded_wall_time(tmp_path: Path) -> None:
    transport = opened(write(tmp_path / "run", [(0, b"a"), (3, b"b")]))
    assert [transport.receive()[1].wall for _ in range(2)] == [1e9, 1e9 + 3]


@pytest.mark.simulated_time
def test_slow_consumer_does_not_delay_later_chunks(tmp_path: Path) -> None:
    """Deadlines are absolute: chunks are on time again after a slow consumer has caught up."""
    recording = write(tmp_path / "run", [(n * 0.1, bytes([n])) for n in range(10)])
    elapsed = Elapsed()
    transport = opened(recording)
    came = []
    for number in range(10):
        transport.receive()
        came.append(elapsed())
        time.sleep(0.25 if number == 2 else 0.03)
    # The consumer needs 0.25 s for the third chunk. So two chunks are late, and the next is on time again.
    assert came == about([0, 0.1, 0.2, 0.45, 0.48, 0.51, 0.6, 0.7, 0.8, 0.9])


@pytest.mark.simulated_time
def test_replay_at_rate_zero_does_not_wait(tmp_path: Path) -> None:
    recording = write(tmp_path / "run", [(0, b"a"), (5, "lost"), (50, "connected"), (1000, b"b")])
    elapsed = Elapsed()
    transport = opened(recording, rate=0)
    assert transport.receive()[0] == b"a"
    with pytest.raises(ConnectionLost):
        transport.receive()
    transport.open(5)
    assert transport.receive()[0] == b"b"
    assert elapsed() == about(0)


@pytest.mark.simulated_time
def test_channels_are_replayed_on_one_time_line(tmp_path: Path) -> None:
    recording = write(tmp_path / "run", [(0, b"a"), (4, b"b")], [(1, b"c"), (3, b"d")])
    shared = ReplayTimeline(recording)
    left, right = (ReplayTransport(recording, name, shared) for name in "01")
    came: dict[bytes, float] = {}
    elapsed = Elapsed()
    left.open(5)
    for transport in (left, right, right, left):
        if transport is right and len(came) == 1:
            time.sleep(0.5)
            right.open(5)  # opens later and joins the timeline, without restarting it
        data = transport.receive()[0]
        came[data] = elapsed()
    assert came == about({b"a": 0, b"c": 1, b"d": 3, b"b": 4})


@pytest.mark.parametrize("rate", [-1, float("inf"), float("nan")])
def test_timeline_rejects_invalid_rates(tmp_path: Path, rate: float) -> None:
    with pytest.raises(BadValue, match="rate"):
        ReplayTimeline(write(tmp_path / "run", []), rate)


# -- lost connections ---------------------------------------------------------------------------------


@pytest.mark.simulated_time
def test_replay_repeats_losses_and_reconnections_in_time(tmp_path: Path) -> None:
    recording = write(
        tmp_path / "run",
        [(0, b"a"), (2, "lost"), (2.1, "connecting"), (3, "lost"), (3.5, "connecting"), (4, "connected"), (4.5, b"b")],
    )
    elapsed = Elapsed()
    transport = opened(recording)
    transport.receive()
    with pytest.raises(ConnectionLost, match="as recorded: at 2"):
        transport.receive()
    assert elapsed() == about(2)
    with pytest.raises(ConnectFailed, match="as recorded: at 3"):
        transport.open(5)
    assert elapsed() == about(3)
    transport.open(5)
    assert elapsed() == about(4)
    assert transport.receive()[0] == b"b"
    assert elapsed() == about(4.5)


@pytest.mark.simulated_time
def test_open_times_out_during_a_long_recorded_loss(tmp_path: Path) -> None:
    elapsed = Elapsed()
    transport = opened(write(tmp_path / "run", [(0, b"a"), (1, "lost"), (9, "connected"), (9, b"b")]))
    transport.receive()
    with pytest.raises(ConnectionLost):
        transport.receive()
    with pytest.raises(LinkTimeout, match="within 5 s"):
        transport.open(5)
    assert elapsed() == about(6)
    transport.open(5)
    assert elapsed() == about(9)
    assert transport.receive()[0] == b"b"


@pytest.mark.simulated_time
def test_replay_finishes_after_the_last_recorded_connection_loss(tmp_path: Path) -> None:
    transport = opened(write(tmp_path / "run", [(0, b"a"), (1, "lost"), (2, "connecting"), (3, "lost")]))
    transport.receive()
    with pytest.raises(ConnectionLost):
        transport.receive()
    with pytest.raises(ConnectFailed):
        transport.open(5)
    with pytest.raises(Finished):
        transport.open(5)


@pytest.mark.simulated_time
def test_replayed_channel_opens_at_once_if_it_was_connected_late(tmp_path: Path) -> None:
    lines: list[Line] = [(60, "connecting"), (61, "connected"), (62, b"c")]
    elapsed = Elapsed()
    transport = opened(write(tmp_path / "run", [(0, b"a")], lines), channel="1")
    assert elapsed() == about(0)
    assert transport.receive()[0] == b"c"
    assert elapsed() == about(62)


def test_replay_repeats_a_failed_first_connection(tmp_path: Path) -> None:
    recording = write(tmp_path / "run", [(0, "connecting"), (1, "lost")])
    transport = ReplayTransport(recording, "0", ReplayTimeline(recording))
    with pytest.raises(ConnectFailed, match="as recorded: at 1"):
        transport.open(5)


@pytest.mark.simulated_time
def test_close_ends_a_waiting_receive_and_loses_no_chunk(tmp_path: Path) -> None:
    recording = write(tmp_path / "run", [(0, b"a"), (3600, b"b")])
    clock = ReplayTimeline(recording)
    transport = ReplayTransport(recording, "0", clock)
    transport.open(5)
    assert transport.receive()[0] == b"a"
    outcome: list[Exception] = []

    def receive() -> None:
        try:
            transport.receive()
        except ConnectionLost as error:
            outcome.append(error)

    thread = threading.Thread(target=receive)
    thread.start()
    transport.close()
    thread.join(10)
    assert ["closed" in str(error) for error in outcome] == [True]
    clock.rate = 0
    transport.open(5)
    assert transport.receive()[0] == b"b"


def test_send_to_a_recording_raises_bad_value(tmp_path: Path) -> None:
    recording = write(tmp_path / "run", [(0, b"a")])
    with pytest.raises(BadValue, match="is a recording"):
        ReplayTransport(recording, "0", ReplayTimeline(recording)).send(b"stopj(1)\n", 1)


def test_missing_channel_raises_bad_recording(tmp_path: Path) -> None:
    recording = write(tmp_path / "run", [(0, b"a")])
    with pytest.raises(BadRecording, match="has no channel 'realtime'; its channels are 0"):
        ReplayTransport(recording, "realtime", ReplayTimeline(recording))


def test_empty_channel_finishes_immediately(tmp_path: Path) -> None:
    recording = write(tmp_path / "run", [])
    transport = ReplayTransport(recording, "0", ReplayTimeline(recording))
    transport.open(5)
    with pytest.raises(Finished):
        transport.receive()


# -- with a stream ------------------------------------------------------------------------------------


def replaying(path: Path, rate: float = 0) -> Stream[Count]:
    recording = RecordingFile(path)
    transport = ReplayTransport(recording, "0", ReplayTimeline(recording, rate))
    lossless = rate == 0
    return scripted(transport, name="replay", lossless=lossless)


@pytest.mark.parametrize("size", [1, 7, 500])
@pytest.mark.simulated_time
def test_replay_at_rate_zero_loses_no_packet(tmp_path: Path, size: int) -> None:
    """The recording has more packets than any queue holds, and is read with a plain `for`."""
    numbers = range(1000, 4000)
    write(tmp_path / "run", [(at, counts(*numbers[at : at + size])) for at in range(0, 3000, size)])
    stream = replaying(tmp_path / "run")
    assert [count.number for count in stream] == list(numbers)
    assert (stream.stats.received, stream.stats.decoded) == (3000, 3000)
    stream.close()


@pytest.mark.simulated_time
def test_replay_loses_no_packet_when_a_callback_is_slow(tmp_path: Path) -> None:
    write(tmp_path / "run", [(n, counts(1000 + n)) for n in range(3000)])
    stream = replaying(tmp_path / "run")
    got: list[int] = []

    def take(count: Count) -> None:
        if not got:
            # The queue fills up, and the replay waits.
            until(lambda: stream.stats.received > 1000)
        got.append(count.number)

    stream.subscribe(take)
    assert stream.join(30)
    assert got == list(range(1000, 4000))
    stream.close()


@pytest.mark.simulated_time
def test_recorded_loss_is_reported_and_subscriptions_continue(tmp_path: Path) -> None:
    """The recorded stream loses its connection twice, the second time with a failed attempt to reconnect."""
    script = ScriptedTransport(None, None, ConnectFailed("refused"), None)
    stream = scripted(script)
    with Recorder(tmp_path / "run") as recorder:
        recorder.add(stream, {"name": "0"})
        script.put(counts(1) + counts(9)[:2], ConnectionLost("cable"), counts(2), ConnectionLost("again"), counts(3))
        script.put(Finished())
        assert stream.join(10)
    stream.close()
    replayed = replaying(tmp_path / "run")
    events: list[ConnectionEvent] = []
    replayed.subscribe(events.append, ConnectionEvent)
    # The first subscription starts the replay, so it gets all events.
    assert replayed.join(10)
    states = [event.state.value for event in events]
    assert states[:3] == ["connecting", "connected", "lost"]
    assert states.count("lost") == 3
    assert states.count("connected") == 3
    assert states[-1] == "closed"
    reasons = [str(event.error) for event in events if event.state is ConnectionState.LOST]
    assert ["cable" in reasons[0], "again" in reasons[1], "refused" in reasons[2]] == [True, True, True]
    assert (replayed.stats.received, replayed.stats.reconnects) == (3, 2)
    assert replayed.stats.skipped == 2  # the bytes of the packet that the first loss cut off
    again = replaying(tmp_path / "run")
    assert [count.number for count in again] == [1, 2, 3]
    again.close()
    replayed.close()


@pytest.mark.simulated_time
def test_truncated_recording_replays_up_to_its_end(tmp_path: Path) -> None:
    write(tmp_path / "whole", [(n, counts(n)) for n in range(20)])
    data = (tmp_path / "whole").read_bytes()
    (tmp_path / "run").write_bytes(data[: len(data) // 2])
    stream = replaying(tmp_path / "run")
    numbers = [count.number for count in stream]
    assert numbers == list(range(len(numbers)))
    assert 5 < len(numbers) < 15
    stream.close()


@pytest.mark.simulated_time
def test_close_of_a_waiting_replay_is_quick(tmp_path: Path) -> None:
    write(tmp_path / "run", [(0, counts(1)), (3600, counts(2))])
    stream = replaying(tmp_path / "run", rate=1)
    assert stream.wait(10).number == 1
    stream.close()
    assert not threads_named("replay")


@pytest.mark.property
@given(st.lists(st.binary(min_size=1, max_size=30), max_size=20), st.data())
@pytest.mark.simulated_time
def test_recording_of_a_replay_equals_the_original(chunks: list[bytes], data: st.DataObject) -> None:
    """A recording of a replay has the same contents as the replayed file, for any bytes and chunks."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        lost = data.draw(st.sets(st.integers(0, 19)))
        lines: list[Line] = []
        for number, chunk in enumerate(chunks):
            lines.append((number, chunk))
            if number in lost:
                lines += [(number, "lost"), (number, "connecting"), (number, "connected")]
        write(folder / "one", lines)
        stream = replaying(folder / "one")
        with Recorder(folder / "two") as recorder:
            recorder.add(stream, {"name": "0"})
            assert stream.join(30)
        stream.close()
        assert contents(folder / "two") == contents(folder / "one")


def contents(path: Path) -> list[tuple[Kind, bytes]]:
    """Return the chunks, with a mark between the chunks where a connection was lost."""
    kept: list[tuple[Kind, bytes]] = []
    for record in RecordingFile(path):
        if record.kind is Kind.BYTES:
            kept.append((record.kind, record.payload))
        elif record.kind is Kind.EVENT and json.loads(record.payload)["state"] == "lost":
            kept.append((record.kind, b"lost"))
    return kept

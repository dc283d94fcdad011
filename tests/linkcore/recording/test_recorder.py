"""Recorder: it writes every byte once and in order, even if connections break or disks fail."""

from __future__ import annotations

import errno
import json
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from linkcore.errors import BadRecording, BadValue, Closed, ConnectFailed, ConnectionLost, LinkTimeout
from linkcore.net.transport import Finished
from linkcore.recording.file import Kind, Record, RecordingFile, RecordingWriter
from linkcore.recording.recorder import Recorder
from linkcore.streaming.packet_queue import block
from linkcore.streaming.stream import Stream
from tests.fakes.link import Count, ScriptedTransport, counts, scripted
from tests.waiting import until

pytestmark = pytest.mark.simulated_time

SCRIPT = {"name": "script"}


@pytest.fixture
def make_stream() -> Iterator[Callable[[ScriptedTransport], Stream[Count]]]:
    streams: list[Stream[Count]] = []

    def make(transport: ScriptedTransport) -> Stream[Count]:
        streams.append(scripted(transport))
        return streams[-1]

    yield make
    for stream in streams:
        stream.close()


@pytest.fixture
def transport() -> ScriptedTransport:
    return ScriptedTransport()


@pytest.fixture
def stream(transport: ScriptedTransport, make_stream: Callable[[ScriptedTransport], Stream[Count]]) -> Stream[Count]:
    return make_stream(transport)


def recorded(path: Path, channel: int = 0) -> bytes:
    return b"".join(each.payload for each in RecordingFile(path) if each.kind is Kind.BYTES and each.channel == channel)


def events(path: Path) -> list[dict[str, Any]]:
    return [json.loads(each.payload) for each in RecordingFile(path) if each.kind is Kind.EVENT]


class Gate:
    """Gate that delays the thread of the writer, as a slow disk does."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.open = threading.Event()
        self.waiting = threading.Event()
        write = RecordingWriter.write

        def slow(writer: RecordingWriter, kind: Kind, *rest: Any) -> None:
            if kind is Kind.BYTES:
                self.waiting.set()
                assert self.open.wait(30)
            write(writer, kind, *rest)

        monkeypatch.setattr(RecordingWriter, "write", slow)


# -- every byte once ----------------------------------------------------------------------------------


def test_every_chunk_is_recorded_once_in_order(
    stream: Stream[Count], transport: ScriptedTransport, tmp_path: Path
) -> None:
    whole = counts(*range(300))
    chunks = [whole[at : at + size] for at, size in zip(range(0, 1500, 7), [7] * 215, strict=True)]
    with Recorder(tmp_path / "run") as recorder:
        subscription = recorder.add(stream, {"name": "script", "firmware": "5.11"})
        transport.put(*chunks, Finished())
        assert stream.join(10)
        assert subscription.stats.dropped == subscription.stats.raised == subscription.stats.waiting == 0
    recording = RecordingFile(tmp_path / "run")
    assert recording.is_complete
    assert recording.channels == {0: {"name": "script", "firmware": "5.11"}}
    # The boundaries of the chunks are kept, too.
    assert [each.payload for each in recording if each.kind is Kind.BYTES] == chunks
    assert recorded(tmp_path / "run") == whole


@pytest.mark.parametrize("info", [{}, {"name": 3}, {"name": "script", "firmware": b"5.11"}, {"name": "x", "y": {1, 2}}])
def test_add_rejects_invalid_info(stream: Stream[Count], tmp_path: Path, info: dict[str, Any]) -> None:
    with Recorder(tmp_path / "run") as recorder:
        with pytest.raises(BadValue, match=r"info=.*expected"):
            recorder.add(stream, info)
        assert repr(recorder) == f"<Recorder {tmp_path / 'run'}: 0 streams>"
        recorder.add(stream, {"name": "script"})
        assert repr(recorder) == f"<Recorder {tmp_path / 'run'}: 1 streams>"
    assert RecordingFile(tmp_path / "run").channels == {0: {"name": "script"}}


def test_recorded_stamps_equal_packet_stamps(
    stream: Stream[Count], transport: ScriptedTransport, tmp_path: Path
) -> None:
    packets: list[Count] = []
    with Recorder(tmp_path / "run") as recorder:
        recorder.add(stream, SCRIPT)
        stream.subscribe(packets.append, policy=block)
        transport.put(*(counts(number) for number in range(20)), Finished())
        assert stream.join(10)
    written = [each for each in RecordingFile(tmp_path / "run") if each.kind is Kind.BYTES]
    assert len(packets) == 20
    for packet, each in zip(packets, written, strict=True):
        assert packet.received is not None
        assert each.stamp.monotonic == pytest.approx(packet.received.monotonic, abs=1e-6)
        assert each.stamp.wall == pytest.approx(packet.received.wall, abs=1e-6)


def test_bytes_before_and_after_a_reconnect_are_recorded(
    stream: Stream[Count], transport: ScriptedTransport, tmp_path: Path
) -> None:
    with Recorder(tmp_path / "run") as recorder:
        recorder.add(stream, SCRIPT)
        # The half packet is recorded once and never completed, because the second connection starts with a new packet.
        transport.put(counts(1), counts(2)[:3], ConnectionLost("cut"), counts(3), b"junk" + counts(4), Finished())
        assert stream.join(10)
    assert recorded(tmp_path / "run") == counts(1) + counts(2)[:3] + counts(3) + b"junk" + counts(4)
    assert [(event["state"], event["error"]) for event in events(tmp_path / "run")] == [
        ("connecting", None),
        ("connected", None),
        ("lost", "cut"),
        ("connecting", None),
        ("connected", None),
        ("closed", None),
    ]
    kinds = [each.kind for each in RecordingFile(tmp_path / "run")]
    assert kinds[3:6] == [Kind.BYTES, Kind.BYTES, Kind.EVENT], "the loss must be recorded where it happened"


@pytest.mark.parametrize("cut", range(6))
def test_recording_started_within_a_packet_has_the_whole_packet(
    stream: Stream[Count], transport: ScriptedTransport, tmp_path: Path, cut: int
) -> None:
    packet = counts(0x01020304)
    transport.put(counts(1) + packet[:cut])
    stream.start()
    until(lambda: stream.stats.received == 1 + cut // 5)
    with Recorder(tmp_path / "run") as recorder:
        recorder.add(stream, SCRIPT)
        transport.put(packet[cut:] + counts(2), counts(3), Finished())
        assert stream.join(10)
    # A packet that had arrived completely before the recorder was added is not recorded.
    assert recorded(tmp_path / "run") == (packet if cut < 5 else b"") + counts(2, 3)


def test_streams_in_one_file_have_separate_channels(
    make_stream: Callable[[ScriptedTransport], Stream[Count]], tmp_path: Path
) -> None:
    transports = [ScriptedTransport(), ScriptedTransport()]
    streams = [make_stream(transport) for transport in transports]
    with Recorder(tmp_path / "run") as recorder:
        for name, stream in zip(("left", "right"), streams, strict=True):
            recorder.add(stream, {"name": name})
        for number in range(200):
            transports[0].put(counts(number))
            transports[1].put(counts(number + 1000))
        for transport, stream in zip(transports, streams, strict=True):
            transport.put(Finished())
            assert stream.join(10)
    recording = RecordingFile(tmp_path / "run")
    assert recorded(tmp_path / "run", recording.channel("left")) == counts(*range(200))
    assert recorded(tmp_path / "run", recording.channel("right")) == counts(*range(1000, 1200))


def test_two_recorders_of_one_stream_record_the_same(
    stream: Stream[Count], transport: ScriptedTransport, tmp_path: Path
) -> None:
    with Recorder(tmp_path / "one") as one, Recorder(tmp_path / "two") as two:
        one.add(stream, SCRIPT)
        two.add(stream, SCRIPT)
        transport.put(*(counts(number) for number in range(50)), Finished())
        assert stream.join(10)
    assert recorded(tmp_path / "one") == recorded(tmp_path / "two") == counts(*range(50))


def test_undecodable_bytes_are_recorded(stream: Stream[Count], transport: ScriptedTransport, tmp_path: Path) -> None:
    with Recorder(tmp_path / "run") as recorder:
        recorder.add(stream, SCRIPT)
        transport.put(b"junk", counts(666), b"\x00", Finished())
        assert stream.join(10)
    assert recorded(tmp_path / "run") == b"junk" + counts(666) + b"\x00"


def test_slow_disk_delays_the_stream_but_loses_no_packet(
    stream: Stream[Count], transport: ScriptedTransport, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    gate = Gate(monkeypatch)
    with Recorder(tmp_path / "run") as recorder:
        subscription = recorder.add(stream, SCRIPT)
        transport.put(*(counts(number) for number in range(1500)), Finished())
        assert gate.waiting.wait(10)
        # The writer has one chunk and the queue of 1024 is full, so the reader waits until half of it is written.
        until(lambda: subscription.stats.waiting >= 1024)
        assert stream.stats.received <= 1025
        gate.open.set()
        assert stream.join(30)
    assert recorded(tmp_path / "run") == counts(*range(1500))


def test_close_writes_queued_chunks(
    stream: Stream[Count], transport: ScriptedTransport, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    gate = Gate(monkeypatch)
    recorder = Recorder(tmp_path / "run")
    recorder.add(stream, SCRIPT)
    transport.put(*(counts(number) for number in range(100)))
    until(lambda: stream.stats.received == 100)
    closer = threading.Thread(target=recorder.close)
    closer.start()
    gate.open.set()
    closer.join(10)
    transport.put(counts(1000))  # arrives after the end of the recording
    until(lambda: stream.stats.received == 101)
    assert recorded(tmp_path / "run") == counts(*range(100))
    assert RecordingFile(tmp_path / "run").is_complete


def test_closing_the_stream_first_loses_no_chunk(
    stream: Stream[Count], transport: ScriptedTransport, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    gate = Gate(monkeypatch)
    recorder = Recorder(tmp_path / "run")
    recorder.add(stream, SCRIPT)
    transport.put(*(counts(number) for number in range(100)))
    until(lambda: stream.stats.received == 100)
    stream.close(timeout=0.1)
    gate.open.set()
    recorder.close()
    assert recorded(tmp_path / "run") == counts(*range(100))


# -- failures -----------------------------------------------------------------------------------------


def test_close_times_out_and_leaves_an_incomplete_file(
    stream: Stream[Count], transport: ScriptedTransport, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    gate = Gate(monkeypatch)
    recorder = Recorder(tmp_path / "run")
    subscription = recorder.add(stream, SCRIPT)
    transport.put(counts(1), counts(2))
    assert gate.waiting.wait(10)
    with pytest.raises(LinkTimeout, match="could not write all data"):
        recorder.close(timeout=0.01)
    recorder.close()  # does nothing, because the failure was reported
    gate.open.set()
    assert subscription.join(10)
    recording = RecordingFile(tmp_path / "run")
    assert not recording.is_complete
    assert recorded(tmp_path / "run") == b""


def test_disk_failure_is_reported_and_the_stream_continues(
    stream: Stream[Count],
    transport: ScriptedTransport,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    got: list[int] = []
    recorder = Recorder(tmp_path / "run")
    recorder.add(stream, SCRIPT)
    stream.subscribe(lambda count: got.append(count.number), policy=block)
    transport.put(counts(1))
    until(lambda: recorded(tmp_path / "run") == counts(1))
    file = recorder._writer._file

    class Full:
        closed = False

        def write(self, data: bytes) -> int:
            raise OSError(errno.ENOSPC, "No space left on device")

        def close(self) -> None:
            file.close()

    monkeypatch.setattr(recorder._writer, "_file", Full())
    transport.put(*(counts(number) for number in range(2, 20)), Finished())
    assert stream.join(10)
    assert got == list(range(1, 20))
    with pytest.raises(BadRecording, match="No space left"):
        recorder.close()
    assert "No space left" in caplog.text
    assert not RecordingFile(tmp_path / "run").is_complete
    assert recorded(tmp_path / "run") == counts(1)


def test_existing_file_is_not_overwritten(tmp_path: Path) -> None:
    (tmp_path / "run").write_bytes(b"mine")
    with pytest.raises(BadRecording, match="never overwrites"):
        Recorder(tmp_path / "run")
    assert (tmp_path / "run").read_bytes() == b"mine"


def test_add_raises_when_the_stream_cannot_connect(
    make_stream: Callable[[ScriptedTransport], Stream[Count]], tmp_path: Path
) -> None:
    stream = make_stream(ScriptedTransport(ConnectFailed("refused")))
    with Recorder(tmp_path / "run") as recorder, pytest.raises(ConnectFailed, match="refused"):
        recorder.add(stream, SCRIPT)


def test_add_raises_closed_after_close(stream: Stream[Count], tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "run")
    recorder.close()
    with pytest.raises(Closed):
        recorder.add(stream, SCRIPT)


def test_recorder_leaves_no_thread(stream: Stream[Count], transport: ScriptedTransport, tmp_path: Path) -> None:
    before: set[threading.Thread] = set()
    with Recorder(tmp_path / "run") as recorder:
        stream.start()
        before = set(threading.enumerate())
        recorder.add(stream, SCRIPT)
        assert set(threading.enumerate()) > before
    assert set(threading.enumerate()) <= before


def test_records_have_the_number_of_their_channel(
    stream: Stream[Count], transport: ScriptedTransport, tmp_path: Path
) -> None:
    with Recorder(tmp_path / "run") as recorder:
        recorder.add(stream, SCRIPT)
        transport.put(counts(1), Finished())
        assert stream.join(10)
    records: list[Record] = list(RecordingFile(tmp_path / "run"))
    assert records[0].kind is Kind.CHANNEL
    assert records[-1].kind is Kind.END
    assert {record.channel for record in records} == {0}

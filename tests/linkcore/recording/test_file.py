"""Recording files: written records can be read, whatever happens to the writer, the disk or the bytes."""

from __future__ import annotations

import errno
import json
import struct
import subprocess
import sys
import tempfile
import threading
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from linkcore.clock import Stamp
from linkcore.errors import BadRecording, BadValue, Closed
from linkcore.recording.file import Kind, Record, RecordingFile, RecordingWriter

MAGIC = b"LINKREC1"

stamps = st.builds(Stamp, st.floats(0, 1e7), st.floats(0, 4e9))
payloads = st.tuples(stamps, st.binary(max_size=200))


@contextmanager
def folder() -> Iterator[Path]:
    """Yield a separate folder, for each example of a property."""
    with tempfile.TemporaryDirectory() as name:
        yield Path(name)


def record(kind: int, channel: int, payload: bytes) -> bytes:
    """Pack a record by hand, as the format is documented."""
    body = struct.pack(">BBqq", kind, channel, 1_000_000_000, 2_000_000_000) + payload
    return struct.pack(">II", len(body), zlib.crc32(body)) + body


def sample(path: Path) -> tuple[bytes, list[Record], list[int]]:
    """Write a small recording; return its bytes, its records, and the end offset of each record."""
    writer = RecordingWriter(path)
    ends = []
    steps: list[Callable[[], object]] = [
        lambda: writer.add_channel({"name": "left", "firmware": "5.11"}),
        lambda: writer.write(Kind.BYTES, 0, Stamp(1.0, 100.0), b"first"),
        lambda: writer.write(Kind.EVENT, 0, Stamp(1.5, 100.5), b'{"state": "lost", "error": "cut"}'),
        lambda: writer.write(Kind.BYTES, 0, Stamp(2.0, 101.0), bytes(range(40))),
        writer.close,
    ]
    for step in steps:
        step()
        ends.append(path.stat().st_size)
    return path.read_bytes(), list(RecordingFile(path)), ends


# -- writing and reading -----------------------------------------------------------------------------


@pytest.mark.property
@given(st.lists(st.lists(payloads, max_size=5), min_size=1, max_size=3))
def test_written_records_are_read_back(channels: list[list[tuple[Stamp, bytes]]]) -> None:
    with folder() as path:
        writer = RecordingWriter(path / "run")
        expected = []
        for number, contents in enumerate(channels):
            assert writer.add_channel({"name": f"channel {number}"}) == number
            for stamp, payload in contents:
                writer.write(Kind.BYTES, number, stamp, payload)
                expected.append((number, stamp, payload))
        writer.close()
        recording = RecordingFile(path / "run")
        read = [each for each in recording if each.kind is Kind.BYTES]
    assert [(each.channel, each.payload) for each in read] == [(number, payload) for number, _, payload in expected]
    for each, (_, stamp, _) in zip(read, expected, strict=True):
        # Stamps are whole nanoseconds, within the resolution of a float of seconds since 1970.
        assert each.stamp.monotonic == pytest.approx(stamp.monotonic, rel=1e-15, abs=1e-9)
        assert each.stamp.wall == pytest.approx(stamp.wall, rel=1e-15, abs=1e-9)
    assert recording.is_complete
    assert recording.left_out == 0
    assert [info["name"] for info in recording.channels.values()] == [f"channel {n}" for n in range(len(channels))]


def test_reader_reads_the_documented_format(tmp_path: Path) -> None:
    info = json.dumps({"name": "left"}).encode()
    (tmp_path / "run").write_bytes(MAGIC + record(0, 0, info) + record(1, 0, b"abc") + record(3, 0, b""))
    recording = RecordingFile(tmp_path / "run")
    assert recording.channels == {0: {"name": "left"}}
    assert list(recording)[1] == Record(Kind.BYTES, 0, Stamp(1.0, 2.0), b"abc")
    assert recording.is_complete


def test_writer_writes_the_documented_format(tmp_path: Path) -> None:
    with_it = RecordingWriter(tmp_path / "run")
    with_it.write(Kind.BYTES, 7, Stamp(1.0, 2.0), b"abc")
    with_it.close(complete=False)
    assert (tmp_path / "run").read_bytes() == MAGIC + record(1, 7, b"abc")


def test_records_of_unknown_kinds_are_skipped(tmp_path: Path) -> None:
    info = json.dumps({"name": "left"}).encode()
    data = MAGIC + record(0, 0, info) + record(200, 0, b"?") + record(1, 0, b"abc") + record(3, 0, b"")
    (tmp_path / "run").write_bytes(data)
    recording = RecordingFile(tmp_path / "run")
    assert [each.kind for each in recording] == [Kind.CHANNEL, Kind.BYTES, Kind.END]
    assert recording.left_out == 0


def test_unknown_channel_error_lists_the_channels(tmp_path: Path) -> None:
    writer = RecordingWriter(tmp_path / "run")
    writer.add_channel({"name": "left"})
    writer.add_channel({"name": "right"})
    writer.close()
    recording = RecordingFile(tmp_path / "run")
    assert recording.channel("right") == 1
    with pytest.raises(BadRecording, match="has no channel 'middle'; its channels are left, right"):
        recording.channel("middle")


@pytest.mark.real_time
def test_several_threads_can_write_one_file(tmp_path: Path) -> None:
    writer = RecordingWriter(tmp_path / "run")
    begin = threading.Barrier(4)

    def write(number: int) -> None:
        channel = writer.add_channel({"name": str(number)})
        begin.wait(10)
        for count in range(200):
            writer.write(Kind.BYTES, channel, Stamp.now(), count.to_bytes(2, "big") * (count % 7 + 1))

    threads = [threading.Thread(target=write, args=(number,)) for number in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(30)
    writer.close()
    recording = RecordingFile(tmp_path / "run")
    assert recording.is_complete
    assert recording.left_out == 0
    for channel in range(4):
        counts = [
            int.from_bytes(each.payload[:2], "big")
            for each in recording
            if each.kind is Kind.BYTES and each.channel == channel
        ]
        assert counts == list(range(200))


def test_file_can_be_read_while_being_written(tmp_path: Path) -> None:
    writer = RecordingWriter(tmp_path / "run")
    writer.add_channel({"name": "left"})
    recording = RecordingFile(tmp_path / "run")
    writer.write(Kind.BYTES, 0, Stamp(1, 1), b"one")
    records = iter(recording)
    assert next(records).kind is Kind.CHANNEL
    assert next(records).payload == b"one"
    # Records that are written after the reader has started are read too, and do not count as left out.
    writer.write(Kind.BYTES, 0, Stamp(1, 1), b"two")
    assert [each.payload for each in records] == [b"two"]
    assert recording.left_out == 0
    assert not recording.is_complete
    writer.close()


# -- errors of the writer -----------------------------------------------------------------------------


def test_existing_file_is_not_overwritten(tmp_path: Path) -> None:
    (tmp_path / "run").write_bytes(b"somebody's work")
    with pytest.raises(BadRecording, match="never overwrites"):
        RecordingWriter(tmp_path / "run")
    assert (tmp_path / "run").read_bytes() == b"somebody's work"


@pytest.mark.parametrize("name", ["no/such/folder/run", "nul\0", "x" * 5000])
def test_path_that_cannot_be_written_raises_bad_recording(tmp_path: Path, name: str) -> None:
    with pytest.raises(BadRecording, match="cannot write"):
        RecordingWriter(tmp_path / name)
    with pytest.raises(BadRecording, match="cannot read"):
        RecordingFile(tmp_path / name)


def test_folder_raises_bad_recording(tmp_path: Path) -> None:
    with pytest.raises(BadRecording):
        RecordingFile(tmp_path)


def test_write_after_close_raises_closed(tmp_path: Path) -> None:
    writer = RecordingWriter(tmp_path / "run")
    writer.close()
    writer.close()
    with pytest.raises(Closed):
        writer.write(Kind.BYTES, 0, Stamp(1, 1), b"late")
    with pytest.raises(Closed):
        writer.add_channel({"name": "late"})
    assert [each.kind for each in RecordingFile(tmp_path / "run")] == [Kind.END]


def test_file_holds_256_channels(tmp_path: Path) -> None:
    writer = RecordingWriter(tmp_path / "run")
    for number in range(256):
        assert writer.add_channel({"name": str(number)}) == number
    for _ in range(2):
        with pytest.raises(BadValue, match="256"):
            writer.add_channel({"name": "one too many"})
    writer.close()
    assert len(RecordingFile(tmp_path / "run").channels) == 256


class Disk:
    """Fake disk between a writer and its file, which accepts `room` bytes."""

    def __init__(self, writer: RecordingWriter, room: int, error: int | None = None) -> None:
        self.file = writer._file
        self.room = room
        self.error = error

    @property
    def closed(self) -> bool:
        return self.file.closed

    def write(self, data: bytes) -> int:
        if self.error is not None and len(data) > self.room:
            raise OSError(self.error, "No space left on device")
        written = self.file.write(data[: self.room])
        assert written is not None
        self.room -= written
        return written

    def close(self) -> None:
        self.file.close()


@pytest.mark.parametrize("error", [None, errno.ENOSPC])
def test_full_disk_ends_the_file_before_the_failed_record(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: int | None
) -> None:
    writer = RecordingWriter(tmp_path / "run")
    writer.add_channel({"name": "left"})
    disk = Disk(writer, 60, error)
    monkeypatch.setattr(writer, "_file", disk)
    writer.write(Kind.BYTES, 0, Stamp(1, 1), b"fits")
    for _ in range(2):
        with pytest.raises(BadRecording, match=r"disk full|No space"):
            writer.write(Kind.BYTES, 0, Stamp(1, 1), b"does not fit" * 5)
        disk.room = 1000  # there is room again, but a record after half a record could not be read
    writer.close()
    assert disk.closed
    recording = RecordingFile(tmp_path / "run")
    assert [each.payload for each in recording if each.kind is Kind.BYTES] == [b"fits"]
    assert not recording.is_complete
    assert recording.left_out == (60 - 30 if error is None else 0)


def test_writer_closes_its_file_when_the_disk_is_full(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(RecordingWriter, "_append", lambda self, data: (_ for _ in ()).throw(BadRecording("full")))
    with pytest.raises(BadRecording, match="full"):
        RecordingWriter(tmp_path / "run")


# -- damage -------------------------------------------------------------------------------------------


def test_truncated_file_yields_all_complete_records(tmp_path: Path) -> None:
    data, records, ends = sample(tmp_path / "whole")
    for cut in range(len(data)):
        (tmp_path / "cut").write_bytes(data[:cut])
        if cut < len(MAGIC):
            with pytest.raises(BadRecording, match="not a recording"):
                RecordingFile(tmp_path / "cut")
            continue
        whole = sum(end <= cut for end in ends)
        recording = RecordingFile(tmp_path / "cut")
        assert list(recording) == records[:whole], cut
        assert recording.left_out == cut - ([len(MAGIC), *ends][whole]), cut
        assert not recording.is_complete
    assert RecordingFile(tmp_path / "whole").is_complete


@pytest.mark.slow
def test_flipped_byte_never_gives_a_wrong_record(tmp_path: Path) -> None:
    data, records, ends = sample(tmp_path / "whole")
    for at in range(len(data)):
        for mask in (0x01, 0x80, 0xFF):
            damaged = bytearray(data)
            damaged[at] ^= mask
            (tmp_path / "damaged").write_bytes(damaged)
            if at < len(MAGIC):
                with pytest.raises(BadRecording, match="not a recording"):
                    RecordingFile(tmp_path / "damaged")
                continue
            whole = sum(end <= at for end in ends)
            recording = RecordingFile(tmp_path / "damaged")
            assert list(recording) == records[:whole], (at, mask)
            assert recording.left_out == len(data) - [len(MAGIC), *ends][whole], (at, mask)
            assert not recording.is_complete


@pytest.mark.property
@given(st.binary(max_size=100), st.booleans())
def test_arbitrary_bytes_are_rejected_or_read_as_incomplete(data: bytes, with_magic: bool) -> None:
    data = MAGIC + data if with_magic else data
    begins_well = data.startswith(MAGIC)
    with folder() as path:
        (path / "run").write_bytes(data)
        try:
            recording = RecordingFile(path / "run")
        except BadRecording:
            assert not begins_well
        else:
            assert begins_well
            assert not recording.is_complete
            assert recording.left_out == len(data) - len(MAGIC)
            assert list(recording) == []


@pytest.mark.property
@given(st.integers(0, 255), st.integers(0, 255), st.binary(max_size=50) | st.text(max_size=50).map(str.encode))
def test_arbitrary_records_are_read_or_rejected(kind: int, channel: int, payload: bytes) -> None:
    """The checksum of the record is correct, so the reader checks its contents."""
    with folder() as path:
        (path / "run").write_bytes(MAGIC + record(kind, channel, payload))
        try:
            recording = RecordingFile(path / "run")
        except BadRecording:
            assert kind in (Kind.CHANNEL, Kind.EVENT)
        else:
            assert recording.left_out == 0
            assert recording.is_complete == (kind == Kind.END)


@pytest.mark.parametrize("kind", [Kind.CHANNEL, Kind.EVENT])
@pytest.mark.parametrize("payload", [b"[" * 100_000, b"\xff", b"[]", b"{}", b"null", b'{"name": 5, "state": 5}'])
def test_invalid_descriptions_raise_bad_recording(tmp_path: Path, kind: Kind, payload: bytes) -> None:
    (tmp_path / "run").write_bytes(MAGIC + record(kind, 0, payload))
    with pytest.raises(BadRecording, match="channel 0"):
        RecordingFile(tmp_path / "run")


def test_record_with_impossible_length_is_skipped(tmp_path: Path) -> None:
    (tmp_path / "run").write_bytes(MAGIC + struct.pack(">II", 0xFFFFFFFF, 0) + b"x" * 50)
    assert RecordingFile(tmp_path / "run").left_out == 58


def test_removed_file_raises_bad_recording(tmp_path: Path) -> None:
    sample(tmp_path / "run")
    recording = RecordingFile(tmp_path / "run")
    (tmp_path / "run").unlink()
    with pytest.raises(BadRecording, match="cannot read"):
        next(iter(recording))


WRITE_FOREVER = """
import itertools, sys
from linkcore.recording.file import Kind, RecordingWriter
from linkcore.clock import Stamp
writer = RecordingWriter(sys.argv[1])
writer.add_channel({"name": "left"})
for number in itertools.count():
    writer.write(Kind.BYTES, 0, Stamp.now(), number.to_bytes(4, "big") * 50)
    print(number, flush=True)
"""


@pytest.mark.slow
@pytest.mark.real_time
def test_killed_program_keeps_all_written_records(tmp_path: Path) -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", WRITE_FOREVER, str(tmp_path / "run")], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    with process, process.stdout:
        for _ in range(500):
            process.stdout.readline()
        process.kill()
        # Count the lines too that it had printed before it was killed.
        said = 499 + sum(1 for line in process.stdout if line.endswith("\n"))
    recording = RecordingFile(tmp_path / "run")
    numbers = [int.from_bytes(each.payload[:4], "big") for each in recording if each.kind is Kind.BYTES]
    assert numbers == list(range(len(numbers)))
    assert len(numbers) > said
    assert not recording.is_complete

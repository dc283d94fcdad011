"""Index of a recording: the records that the reader finds, and the records after damage, without one object each."""

from __future__ import annotations

import struct
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from linkcore.clock import Stamp
from linkcore.errors import BadRecording
from linkcore.recording.file import HEAD, MAGIC, Kind, Record, RecordingFile, pack
from linkcore.recording.index import RecordIndex, intact


def record(number: int, size: int) -> bytes:
    return pack(Kind.BYTES, number % 3, Stamp(number * 0.002, 1.7e9 + number), bytes([number % 251]) * size)


def records(index: RecordIndex) -> list[Record]:
    return [
        Record(
            Kind(index.kind[number]),
            int(index.channel[number]),
            Stamp(index.monotonic[number].item() / 1e9, index.wall[number].item() / 1e9),
            index.payload(number),
        )
        for number in range(len(index.kind))
    ]


#: Runs of records of one size: number of records, and bytes of each.
runs = st.lists(st.tuples(st.integers(1, 40), st.integers(0, 30)), max_size=6)


@pytest.mark.property
@given(runs, st.integers(0, 30))
def test_index_finds_the_records_of_the_reader(runs: list[tuple[int, int]], cut: int) -> None:
    sizes = [size for count, size in runs for _ in range(count)]
    data = MAGIC + b"".join(record(number, size) for number, size in enumerate(sizes))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.urlog"
        path.write_bytes(data[: max(len(data) - cut, len(MAGIC))])
        reader, index = RecordingFile(path), RecordIndex(path)
        assert records(index) == list(reader)
        assert (index.left_out, index.is_complete) == (reader.left_out, reader.is_complete)
        del index  # before the folder, because some systems cannot remove a mapped file


@pytest.mark.property
@given(st.integers(1, 300), st.integers(0, 20), st.integers(0, 10_000), st.integers(1, 255))
@example(count=23, size=0, place=445, change=104)  # the damaged length leads to another record
def test_damaged_byte_invalidates_only_its_record(count: int, size: int, place: int, change: int) -> None:
    whole = [record(number, size) for number in range(count)]
    data = bytearray(MAGIC + b"".join(whole))
    at = len(MAGIC) + place % (len(data) - len(MAGIC))
    data[at] ^= change
    hit = (at - len(MAGIC)) // len(whole[0])
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.urlog"
        path.write_bytes(bytes(data))
        index = RecordIndex(path)
        assert [pack(*each) for each in records(index)] == whole[:hit] + whole[hit + 1 :]
        assert [(gap.record, gap.offset, gap.size) for gap in index.gaps] == [
            (hit, len(MAGIC) + hit * len(whole[0]), len(whole[0]))
        ]
        del index


@pytest.mark.property
@given(st.integers(0, 1500), st.integers(0, 60), st.lists(st.integers(0, 1499), max_size=4))
@pytest.mark.simulated_time
def test_intact_marks_exactly_the_damaged_records(count: int, size: int, damaged: list[int]) -> None:
    stride = len(record(0, size))
    data = bytearray(b"?" + b"".join(record(number, size) for number in range(count)))
    hit = {number for number in damaged if number < count}
    for number in hit:
        data[1 + number * stride + stride // 2] ^= 1
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("linkcore.recording.index._SHARE", 2)  # so that several threads get work
        good = intact(np.frombuffer(bytes(data), np.uint8), 1, stride, count)
    assert set(np.flatnonzero(~good).tolist()) == hit


def test_index_skips_bytes_that_are_not_records(tmp_path: Path) -> None:
    path = tmp_path / "run.urlog"
    noise = struct.pack(">II", HEAD.size, 1) * 40 + b"\0" * 7
    path.write_bytes(MAGIC + record(1, 5) + noise + record(2, 5) + noise)
    index = RecordIndex(path)
    assert [each.payload for each in records(index)] == [b"\1" * 5, b"\2" * 5]
    assert [gap.size for gap in index.gaps] == [len(noise)] * 2
    assert index.left_out == 2 * len(noise)


@pytest.mark.parametrize("data", [b"", b"LINK", b"something else"])
def test_index_rejects_files_that_are_not_recordings(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "other"
    path.write_bytes(data)
    with pytest.raises(BadRecording, match="is not a recording"):
        RecordIndex(path)
    with pytest.raises(BadRecording, match="cannot read"):
        RecordIndex(tmp_path / "none")

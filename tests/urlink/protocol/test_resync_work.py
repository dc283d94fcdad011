"""The work to find a lost frame boundary is linear in the number of bytes.

The work is counted as executed lines of code, scanned bytes and copied bytes, because times are reliable only on an
idle computer. The streams are the worst cases for this code: headers that stay plausible for as long as possible, as
close to each other as possible.
"""

from __future__ import annotations

import re
import struct
import sys
from collections.abc import Iterator
from types import FrameType
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from linkcore.wire import framing
from urlink.packets import RealtimeState, VersionMessage
from urlink.protocol.primary import protocol as primary
from urlink.protocol.primary.protocol import PrimaryProtocol
from urlink.protocol.realtime import protocol as realtime
from urlink.protocol.realtime.protocol import RealtimeProtocol

FILES = {module.__file__ for module in (framing, primary, realtime)}
Kind = type[RealtimeProtocol] | type[PrimaryProtocol]
FIRST = {
    RealtimeProtocol: bytes(RealtimeState("5.10", time=5.0)),
    PrimaryProtocol: bytes(VersionMessage("5.8", project_name="URControl", major=5, minor=8, build_date="x" * 20)),
}


class Work:
    """Counts of executed lines, bytes scanned by regular expressions, and copied bytes."""

    def __init__(self) -> None:
        self.lines = 0
        self.scanned = 0
        self.copied = 0

    def trace(self, frame: FrameType, event: str, argument: object) -> Any:
        if frame.f_code.co_filename not in FILES:
            return None
        self.lines += event == "line"
        return self.trace


class Pattern:
    """Regular expression that counts the scanned bytes."""

    def __init__(self, pattern: re.Pattern[bytes], work: Work) -> None:
        self._pattern = pattern
        self._work = work

    def finditer(self, buffer: bytes, start: int, end: int = sys.maxsize) -> Iterator[re.Match[bytes]]:
        at = start
        for match in self._pattern.finditer(buffer, start, end):
            self._work.scanned += match.start() - at
            at = match.start()
            yield match
        self._work.scanned += min(len(buffer), end) - at


class Chunk(bytes):
    """Bytes that count how many of them are searched."""

    work: Work

    def find(self, wanted: Any, start: Any = None, end: Any = None) -> int:
        at = super().find(wanted, start, end)
        self.work.scanned += (min(end, len(self)) if at < 0 else at) - start
        return at


class Kept(bytearray):
    """Buffer that counts the bytes that are added to it, copied from it and searched in it."""

    work: Work

    def __iadd__(self, data: Any) -> Kept:  # type: ignore[misc]  # accepts other types than `__add__`
        self.work.copied += len(data)
        self.extend(data)
        return self

    def __getitem__(self, at: Any) -> Any:
        if isinstance(at, slice):
            self.work.copied += len(range(*at.indices(len(self))))
        return super().__getitem__(at)

    def find(self, wanted: Any, start: Any = None, end: Any = None) -> int:
        at = super().find(wanted, start, end)
        self.work.scanned += (min(end, len(self)) if at < 0 else at) - start
        return at


def cost(kind: Kind, stream: bytes, chunk: int, monkeypatch: pytest.MonkeyPatch) -> Work:
    """Measure the work for a stream after a good packet, fed in chunks of one size."""
    work = Work()
    monkeypatch.setattr(primary, "_CANDIDATE", Pattern(CANDIDATE, work))
    monkeypatch.setattr(realtime, "_SIZE", Pattern(SIZE, work))
    framer = kind().framer
    assert framer.feed(FIRST[kind]) == [FIRST[kind]]
    framer._kept = Kept()
    framer._kept.work = work
    # Append enough zeros that every header in the stream can be decided.
    chunks = [Chunk(stream[at : at + chunk]) for at in range(0, len(stream), chunk)] + [Chunk(LARGEST)]
    for each in chunks:
        each.work = work
    before = sys.gettrace()
    sys.settrace(work.trace)
    try:
        for each in chunks:
            framer.feed(each)
    finally:
        sys.settrace(before)
    return work


CANDIDATE, SIZE = primary._CANDIDATE, realtime._SIZE
LARGEST = 1 << 16


def package(size: int, kind: int) -> bytes:
    return struct.pack(">iB", size, kind)


STATE = package(20, 16) + package(15, 99) + bytes(10)
WORST = [
    (RealtimeProtocol, struct.pack(">i", 1220)),
    (RealtimeProtocol, struct.pack(">i", 4092)),
    (RealtimeProtocol, struct.pack(">iiii", 4084, 3812, 500, 2044)),
    (RealtimeProtocol, struct.pack(">id", 1220, 5.5) + bytes(9)),
    (PrimaryProtocol, package(10, 99) + package(8191, 16)),
    (PrimaryProtocol, package(8192, 16) + package(10, 16)),
    (PrimaryProtocol, package(8192, 16) + package(6, 16) + package(250, 16)),
    (PrimaryProtocol, package(8192, 16)),
    (PrimaryProtocol, package(8192, 20)),
    (PrimaryProtocol, b"\0\0\0\x10\x10\x10\x14"),
    (PrimaryProtocol, STATE + b"\xff"),
    # A false state of 64 KiB at a known boundary; its sub-packages are long enough to be shared by all such states.
    (PrimaryProtocol, STATE + package(65536, 16) + package(2900, 99)),
]


@pytest.mark.slow
@pytest.mark.matrix(5)
@pytest.mark.parametrize(("kind", "element"), WORST)
@pytest.mark.parametrize("chunk", [1, 1 << 20], ids=["bytewise", "at once"])
def test_work_doubles_with_number_of_bytes(
    kind: Kind, element: bytes, chunk: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    size = 1 << 13
    short, long = (cost(kind, b"\xff" + (element * n)[:n], chunk, monkeypatch) for n in (size, 2 * size))
    assert long.lines <= 2.2 * short.lines
    assert long.scanned <= 2.2 * short.scanned
    assert long.copied <= 2.2 * short.copied
    assert long.lines <= 20 * (2 * size + LARGEST)
    assert long.scanned <= 3 * (2 * size + LARGEST)
    assert long.copied <= 5 * (2 * size + LARGEST)


#: Bytes that are headers, or become headers when they are joined.
PIECES = {
    RealtimeProtocol: [
        *(struct.pack(">i", size) for size in (1220, 500, 1108, 2044, 4092)),
        struct.pack(">d", 5.001),
        struct.pack(">d", 9.0),
        b"\0\0",
        b"\0",
        b"\xff",
    ],
    PrimaryProtocol: [
        *(package(size, kind) for size in (5, 10, 20, 300, 8192, 65536) for kind in (16, 20, 99)),
        b"\0\0",
        b"\0",
        b"\x10",
        b"\xff",
    ],
}


@pytest.mark.slow
@pytest.mark.property
@pytest.mark.parametrize("kind", [RealtimeProtocol, PrimaryProtocol])
@settings(max_examples=max(settings().max_examples // 5, 1))
@given(data=st.data())
def test_work_per_byte_is_bounded(kind: Kind, data: st.DataObject) -> None:
    pieces = st.lists(st.sampled_from(PIECES[kind]), min_size=1, max_size=6).map(b"".join)
    parts = data.draw(st.lists(pieces, min_size=1, max_size=3))
    size = 1 << 13
    stream = b"\xff" + b"".join((part * size)[: size // len(parts)] for part in parts)
    chunk = data.draw(st.sampled_from([1, 3, 100, 1460, 1 << 20]))
    with pytest.MonkeyPatch.context() as monkeypatch:
        work = cost(kind, stream, chunk, monkeypatch)
    assert work.lines <= 30 * (size + LARGEST)
    assert work.scanned <= 4 * (size + LARGEST)
    assert work.copied <= 6 * (size + LARGEST)

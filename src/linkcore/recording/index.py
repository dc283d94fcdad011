"""Index of a recording: the offsets of its records, found without a Python object for each record.

Recordings contain long runs of records of one size. If the next records declare the same size as the current record,
they are checked together. Damage is skipped, and reading continues with the next record that has a correct checksum.

The checksums of many records of one size are checked at once, on several processors. A call of `zlib.crc32` for each
record would take as long as the checksum itself. CRC-32 is linear, so the checksum of many consecutive records can be
computed from the checksums that are written in them. One call of `zlib.crc32` over all bytes of the records then checks
all of them. crc(A + B) is crc(A), advanced by the length of B, xor crc(B). Advancing a CRC by zero bytes is a
multiplication by a matrix over GF(2). See zlib's `crc32_combine`. `benchmarks/loading.py` measures the gain.
"""

from __future__ import annotations

import os
import zlib
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..errors import BadRecording
from .file import FRAME, HEAD, LARGEST, MAGIC, Kind, Progress, unseen

_ALL = 0xFFFFFFFF
#: Number of records that one checksum covers: some hundred kB, which fit into the cache of a processor.
_BATCH = 256
#: Minimum number of batches for which starting a thread saves time: some MB.
_SHARE = 16

Crcs = NDArray[np.uint32]


def intact(data: Any, start: int, stride: int, count: int) -> NDArray[np.bool_]:
    """Return whether the checksum of each record is correct, for several records of the same size.

    Args:
        data: Buffer with the bytes of the records.
        start: Offset of the first record.
        stride: Size of each record in bytes, checksum included.
        count: Number of records.
    """
    good = np.zeros(count, np.bool_)
    if not count:
        return good
    view = memoryview(data)
    written: Any = np.ndarray((count,), ">u4", data, start + 4, (stride,))
    batches = count // _BATCH
    whole = batches * _BATCH
    if batches:
        size = _BATCH * stride

        def checksums(begin: int, end: int) -> list[int]:
            places = range(start + begin * size, start + end * size, size)
            return [zlib.crc32(view[at : at + size]) for at in places]

        found = np.array(list(chain(*side_by_side(checksums, 0, batches, _SHARE))), np.uint32)
        good[:whole] = np.repeat(found == _joined(written[:whole].astype(np.uint32), stride), _BATCH)
    single = np.flatnonzero(~good)
    crcs = written[single].tolist()
    places = (start + FRAME.size + single * stride).tolist()
    rest = stride - FRAME.size
    good[single] = [zlib.crc32(view[at : at + rest]) == crc for at, crc in zip(places, crcs, strict=True)]
    return good


def _joined(written: Crcs, stride: int) -> Crcs:
    """Compute the checksum of each batch of `_BATCH` records from the checksums that are written in them."""
    rest = stride - FRAME.size
    # A record consists of its length, its checksum, and the rest. The length is the same in all records. The four bytes
    # of the checksum are xored into the CRC before them, and advanced with it. CRC-32 processes the lowest byte of a
    # word first, but the bytes are stored in the opposite order.
    state = written.byteswap() ^ np.uint32(zlib.crc32(rest.to_bytes(4, "big")) ^ _ALL)
    moved = _moved(state, _filled(_columns(4 + rest)))
    crcs = (moved ^ written ^ np.uint32(zlib.crc32(bytes(rest)) ^ _ALL)).reshape(-1, _BATCH)
    columns = _columns(stride)
    while crcs.shape[1] > 1:
        tables = _filled(columns)
        crcs = _moved(crcs[:, 0::2], tables) ^ crcs[:, 1::2]
        columns = _moved(columns, tables)  # for twice as many bytes
    joined: Crcs = crcs[:, 0]
    return joined


def _columns(size: int) -> Crcs:
    """Return the value of each bit of a CRC after it is advanced by `size` zero bytes, shape (32,)."""
    zeros = bytes(size)
    none = zlib.crc32(zeros)
    return np.array([zlib.crc32(zeros, 1 << bit) ^ none for bit in range(32)], np.uint32)


def _filled(columns: Crcs) -> Crcs:
    """Return the advanced CRC for each value of each byte of a CRC, shape (4, 256), lowest byte first."""
    tables = np.zeros((4, 256), np.uint32)
    for bit in range(8):
        tables[:, 1 << bit : 2 << bit] = tables[:, : 1 << bit] ^ columns[bit::8, None]
    return tables


def _moved(crcs: Crcs, tables: Crcs) -> Crcs:
    """Return the CRCs advanced by the number of zero bytes of the tables."""
    moved: Crcs = tables[0][crcs & 0xFF]
    for number in (1, 2, 3):
        moved ^= tables[number][(crcs >> np.uint32(8 * number)) & 0xFF]
    return moved


T = TypeVar("T")

#: Maximum number of threads. With more threads, the memory is the bottleneck.
_THREADS = 4


def side_by_side(part: Callable[[int, int], T], begin: int, end: int, share: int) -> list[T]:
    """Return the results of `part` for each share of a range, in order.

    Args:
        part: Function that is called with the begin and the end of a share, in several threads if there are several
            processors.
        begin: Begin of the range.
        end: End of the range.
        share: Length of a share.

    Raises:
        Exception: If `part` raises it. The error of the first failed share is raised.
    """
    shares = [(at, min(at + share, end)) for at in range(begin, end, share)]
    threads = min(os.cpu_count() or 1, _THREADS, len(shares))
    if threads <= 1:
        return [part(*each) for each in shares]
    with ThreadPoolExecutor(threads, "linkcore recording") as pool:
        return list(pool.map(part, *zip(*shares, strict=True)))


#: Number of records of one size after which the next records are checked together.
_FEW = 16
#: Number of records that are checked together at first; each further group is four times as large.
_FIRST_RUN = 64
#: Maximum number of records that are checked together.
_MOST = 1 << 16
#: Number of bytes that are searched at a time for a record after damage.
_SEARCHED = 1 << 20
#: Budget of bytes for the checksums of supposed records that are not records: a constant, plus a number for each byte
#: of the file before them. A supposed record that exceeds the budget is skipped. Otherwise the time for a file that
#: consists only of such lengths would grow with the square of the file's size.
_TRIED, _TRIED_EACH = 1 << 20, 16

Numbers = NDArray[np.int64]


class Damage(NamedTuple):
    """Bytes of a file that belong to no record.

    Attributes:
        record: Number of the next record.
        offset: Offset in the file, in bytes.
        size: Size in bytes.
    """

    record: int
    offset: int
    size: int


class RecordIndex:
    """Index of the intact records of a recording.

    Args:
        path: Path of the file.
        progress: Function that is called with the fraction that has been read, 0 to 1.

    Raises:
        BadRecording: If there is no such file, or it is not a recording.

    Attributes:
        data: Bytes of the file, shape (n,), uint8. They are mapped into memory, and read from the disk when used.
        kind: Kind of each record, shape (n,).
        channel: Channel of each record, shape (n,).
        offset: Offset of the payload of each record in `data`, shape (n,), in bytes.
        size: Size of the payload of each record, shape (n,), in bytes.
        monotonic: Monotonic time of each record, shape (n,), in ns.
        wall: Wall time of each record, shape (n,), in ns.
        gaps: Bytes between or after the records that belong to no record.
    """

    def __init__(self, path: str | os.PathLike[str], progress: Progress = unseen) -> None:
        self.path = Path(path)
        self._progress = progress
        self.data = _mapped(self.path)
        self.gaps: list[Damage] = []
        begin = bytes(self.data[: len(MAGIC)])
        if begin != MAGIC:
            raise BadRecording(f"{self.path} is not a recording: it begins with {begin!r}, not {MAGIC!r}")
        self._tried = 0
        starts, strides, counts = np.array(self._runs(), np.int64).reshape(-1, 3).T
        stride = np.repeat(strides, counts)
        within = np.arange(len(stride)) - np.repeat(np.cumsum(counts) - counts, counts)
        start: Numbers = np.repeat(starts, counts) + stride * within
        self.size: Numbers = stride - FRAME.size - HEAD.size
        self.offset: Numbers = start + FRAME.size + HEAD.size
        heads = self._heads(start)
        self.kind: Numbers = heads["kind"].astype(np.int64)
        self.channel: Numbers = heads["channel"].astype(np.int64)
        self.monotonic: Numbers = heads["monotonic"].astype(np.int64)
        self.wall: Numbers = heads["wall"].astype(np.int64)

    @property
    def left_out(self) -> int:
        """Number of unfinished or damaged bytes."""
        return sum(gap.size for gap in self.gaps)

    @property
    def is_complete(self) -> bool:
        """Whether the recording was closed properly."""
        return bool((self.kind == Kind.END).any())

    def payload(self, record: int) -> bytes:
        """Return the payload of a record."""
        offset = int(self.offset[record])
        return self.data[offset : offset + int(self.size[record])].tobytes()

    def of(self, channel: int) -> Numbers:
        """Return the numbers of the records of a channel, in order."""
        return np.flatnonzero(self.channel == channel)

    def _heads(self, start: Numbers) -> NDArray[np.void]:
        head = np.dtype([("kind", "u1"), ("channel", "u1"), ("monotonic", ">i8"), ("wall", ">i8")])
        if not len(start):
            return np.empty(0, head)
        last = int(start[-1])
        every = np.ndarray((last + 1,), np.dtype((np.void, head.itemsize)), self.data, FRAME.size, (1,))
        found: NDArray[np.void] = every[start].view(head)
        return found

    def _runs(self) -> list[tuple[int, int, int]]:
        """Return runs of records of one size, as offset of the first record, size, and number of records."""
        runs: list[tuple[int, int, int]] = []
        view = memoryview(self.data.data)
        end, at, records = len(view), len(MAGIC), 0
        start = stride = count = 0  # the current run
        while at < end:
            after = self._end_of_record(view, at)
            if not after:
                length = FRAME.unpack_from(view, at)[0] if end - at >= FRAME.size else 0
                after = at + FRAME.size + length
                found = self._next(view, at, after)
                self.gaps.append(Damage(records, at, found - at))
                at = found
                continue
            if after - at != stride or at != start + count * stride:
                runs.append((start, stride, count))
                start, stride, count = at, after - at, 0
            # The first records are checked one by one, which is faster for a short run.
            more = self._same(after, stride) if count == _FEW else 0
            count, records, at = count + 1 + more, records + 1 + more, after + more * stride
            self._progress(at / end)
        return [*runs[1:], (start, stride, count)] if count else []

    def _same(self, at: int, stride: int) -> int:
        """Return the number of intact records of `stride` bytes that follow each other from `at`."""
        most = (len(self.data) - at) // stride
        if not most:
            return 0
        lengths: NDArray[np.int64] = np.ndarray((most,), ">u4", self.data, at, (stride,))
        done, window = 0, _FIRST_RUN
        while done < most:
            same = lengths[done : done + window] == stride - FRAME.size
            there = len(same) if same.all() else int(np.argmin(same))
            good = intact(self.data, at + done * stride, stride, there)
            if not good.all():
                return done + int(np.argmin(good))
            done += there
            self._progress((at + done * stride) / len(self.data))
            if there < len(same):
                break
            window = min(4 * window, _MOST)
        return done

    def _next(self, view: memoryview, at: int, after: int) -> int:
        """Return the offset of the next intact record after damage at `at`; the end of the file if there is none."""
        # Every record has a valid length and kind. Usually the next record begins at `after`, where the damaged one
        # ends. But the length of the damaged record might itself be wrong.
        last = len(view) - FRAME.size - HEAD.size + 1
        begin, stop = at + 1, after + 1
        while begin < last:
            stop = min(stop, begin + _SEARCHED, last)
            lengths = np.ndarray((stop - begin,), ">u4", self.data, begin, (1,))
            kinds = self.data[begin + FRAME.size : stop + FRAME.size]
            likely = (lengths >= HEAD.size) & (lengths <= LARGEST) & (kinds <= int(Kind.END))
            for place in (np.flatnonzero(likely) + begin).tolist():
                if self._end_of_record(view, place):
                    return int(place)
            begin, stop = stop, stop + _SEARCHED
        return len(view)

    def _end_of_record(self, view: memoryview, at: int) -> int:
        """Return the offset after the intact record at `at`; 0 if there is none."""
        if len(view) - at < FRAME.size + HEAD.size:
            return 0
        length, crc = FRAME.unpack_from(view, at)
        after: int = at + FRAME.size + length
        if not HEAD.size <= length <= LARGEST or after > len(view):
            return 0
        if self._tried and self._tried + length > _TRIED + _TRIED_EACH * at:
            return 0
        if zlib.crc32(view[at + FRAME.size : after]) == crc:
            return after
        self._tried += length
        return 0


def _mapped(path: Path) -> NDArray[np.uint8]:
    try:
        if path.stat().st_size == 0:
            return np.empty(0, np.uint8)
        mapped: Any = np.memmap(path, np.uint8, "r")
    except (OSError, ValueError) as error:
        raise BadRecording(f"cannot read {path}: {getattr(error, 'strerror', None) or error}") from error
    return mapped.view(np.ndarray)  # type: ignore[no-any-return]  # slicing a memmap is slow

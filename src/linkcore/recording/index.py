"""The offsets of the records of a recording, found without a Python object for each record.

Recordings contain long runs of records of one size. Where the next records declare the size of this one, they are
checked together. Damage is skipped, and reading goes on with the next record whose checksum is right.
"""

from __future__ import annotations

import os
import zlib
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import BadRecording
from ..progress import Progress, unseen
from .checksums import intact
from .records import FRAME, HEAD, LARGEST, MAGIC, Kind

__all__ = ["Gap", "Index"]

#: After so many records of one size, those that follow are checked together.
_FEW = 16
#: Records that are checked together at first; each time four times as many.
_FIRST_RUN = 64
#: Records that are checked together at most.
_MOST = 1 << 16
#: Bytes that are searched at a time for a record after damage.
_SEARCHED = 1 << 20
#: Bytes that are summed up for records which turn out to be none: so many, and so many for each byte of the file before
#: them. What begins like a longer one is passed over, or a file of lengths would take time by the square of its size.
_TRIED, _TRIED_EACH = 1 << 20, 16

Numbers = NDArray[np.int64]


class Gap(NamedTuple):
    """Bytes of a file that belong to no record.

    Attributes:
        record: number of the next record.
        offset: in the file, bytes.
        size: in bytes.
    """

    record: int
    offset: int
    size: int


class Index:
    """The intact records of a recording.

    Args:
        path: of the file.
        progress: called with the fraction that has been read, 0 to 1.

    Raises:
        BadRecording: no such file, or not a recording.

    Attributes:
        data: the bytes of the file, (n,) uint8, mapped into memory, so that they are read from the disk when used.
        kind, channel: of each record, (n,).
        offset, size: of its payload in `data`, (n,), bytes.
        monotonic, wall: its stamps, (n,), ns.
        gaps: bytes between or after the records that belong to none.
    """

    def __init__(self, path: str | os.PathLike[str], progress: Progress = unseen) -> None:
        self.path = Path(path)
        self._progress = progress
        self.data = _mapped(self.path)
        self.gaps: list[Gap] = []
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
        """Bytes that are unfinished or damaged."""
        return sum(gap.size for gap in self.gaps)

    @property
    def is_complete(self) -> bool:
        """Whether the recording was closed properly."""
        return bool((self.kind == Kind.END).any())

    def payload(self, record: int) -> bytes:
        """The payload of a record."""
        offset = int(self.offset[record])
        return self.data[offset : offset + int(self.size[record])].tobytes()

    def of(self, channel: int) -> Numbers:
        """The numbers of the records of a channel, in order."""
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
        """Runs of records of one size: offset of the first, bytes from one record to the next, number of records."""
        runs: list[tuple[int, int, int]] = []
        view = memoryview(self.data.data)
        end, at, records = len(view), len(MAGIC), 0
        start = stride = count = 0  # of the run that is being found
        while at < end:
            after = self._end_of_record(view, at)
            if not after:
                length = FRAME.unpack_from(view, at)[0] if end - at >= FRAME.size else 0
                after = at + FRAME.size + length
                found = self._next(view, at, after)
                self.gaps.append(Gap(records, at, found - at))
                at = found
                continue
            if after - at != stride or at != start + count * stride:
                runs.append((start, stride, count))
                start, stride, count = at, after - at, 0
            # One by one at first, which is quicker in a short run.
            more = self._same(after, stride) if count == _FEW else 0
            count, records, at = count + 1 + more, records + 1 + more, after + more * stride
            self._progress(at / end)
        return [*runs[1:], (start, stride, count)] if count else []

    def _same(self, at: int, stride: int) -> int:
        """How many intact records of `stride` bytes begin at `at`."""
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
        """The offset of the next intact record after damage at `at`; the end of the file if there is none."""
        # Any record has a valid length and kind. Usually the next one begins at `after`, where the damaged one ends;
        # but the damaged bytes may be its length.
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
        """The offset behind the intact record at `at`; 0 if there is none."""
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
    return mapped.view(np.ndarray)  # type: ignore[no-any-return]  # slices of a memmap are slow to make

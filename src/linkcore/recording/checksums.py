"""The checksums of many records of one size at once.

One call of `zlib.crc32` per record costs as much as the checksum itself. CRC-32 is linear, so the checksum of many
consecutive records follows from the checksums that are written in them, and one call over all their bytes checks all of
them. crc(A + B) is crc(A), advanced by the length of B, xor crc(B). To advance a CRC by some zero bytes is to multiply
it by a matrix over GF(2). See zlib's `crc32_combine`.
"""

from __future__ import annotations

import zlib
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .records import FRAME
from .side_by_side import side_by_side

__all__ = ["intact"]

_ALL = 0xFFFFFFFF
#: Records that one checksum covers: some hundred kB, which fit into the cache of a processor.
_BATCH = 256
#: Batches that are worth a thread: some MB.
_SHARE = 16

Crcs = NDArray[np.uint32]


def intact(data: Any, start: int, stride: int, count: int) -> NDArray[np.bool_]:
    """Which of `count` records of `stride` bytes each, checksum included, have the checksum that is written in them.

    Args:
        data: a buffer of bytes that holds them.
        start: offset of the first.
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
    """The checksum of each `_BATCH` whole records, computed from the checksums that are written in them."""
    rest = stride - FRAME.size
    # A record is its length, its checksum, and the rest. The length is the same in all records. The four bytes of the
    # checksum are xored into the CRC before them and advanced with it; CRC-32 takes the least byte of a word first, and
    # they are stored in the other order.
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
    """What each bit of a CRC becomes when it is advanced by `size` zero bytes, (32,)."""
    zeros = bytes(size)
    none = zlib.crc32(zeros)
    return np.array([zlib.crc32(zeros, 1 << bit) ^ none for bit in range(32)], np.uint32)


def _filled(columns: Crcs) -> Crcs:
    """The same for each value of each byte of a CRC, (4, 256), least byte first."""
    tables = np.zeros((4, 256), np.uint32)
    for bit in range(8):
        tables[:, 1 << bit : 2 << bit] = tables[:, : 1 << bit] ^ columns[bit::8, None]
    return tables


def _moved(crcs: Crcs, tables: Crcs) -> Crcs:
    """CRCs advanced by the number of zero bytes that the tables are for."""
    moved: Crcs = tables[0][crcs & 0xFF]
    for number in (1, 2, 3):
        moved ^= tables[number][(crcs >> np.uint32(8 * number)) & 0xFF]
    return moved

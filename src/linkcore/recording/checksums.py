"""The checksums of many records of one size at once.

One call of `zlib.crc32` for each record costs more than the checksum. CRC-32 is linear, so the checksum of many records
one after the other follows from those that are written in them: one call for all of their bytes then checks all.
crc(A + B) is crc(A), moved on by the bytes of B, xor crc(B); moved on by one zero bit, a CRC is multiplied by x modulo
the polynomial. See zlib's `crc32_combine`.
"""

from __future__ import annotations

import zlib
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .records import FRAME

__all__ = ["intact"]

_POLYNOMIAL = 0xEDB88320
_ALL = 0xFFFFFFFF
#: Records that one checksum covers: some hundred kB, which the cache of a processor holds.
_BATCH = 256

Crcs = NDArray[np.uint32]


def intact(data: Any, start: int, stride: int, count: int) -> NDArray[np.bool_]:
    """Which of `count` records of `stride` bytes each, checksum included, have the checksum that is written in them.

    Args:
        data: a buffer of bytes that holds them.
        start: where the first begins.
    """
    view = memoryview(data)
    good = np.zeros(count, np.bool_)
    batches = count // _BATCH
    whole = batches * _BATCH
    if batches:
        head: Any = np.ndarray((whole, 2), ">u4", data, start, (stride, 4))
        expected = _joined(head, stride).tolist()
        size = _BATCH * stride
        for number, crc in enumerate(expected):
            at = start + number * size
            good[number * _BATCH : (number + 1) * _BATCH] = zlib.crc32(view[at : at + size]) == crc
    for number in np.flatnonzero(~good).tolist():
        at = start + number * stride
        (crc,) = np.ndarray(1, ">u4", data, at + 4).tolist()
        good[number] = zlib.crc32(view[at + FRAME.size : at + stride]) == crc
    return good


def _joined(head: Any, stride: int) -> Crcs:
    """The checksum of each `_BATCH` records, from the lengths and checksums (n, 2) that they begin with."""
    # A word of four bytes moves the inner state on by four bytes, after it was added to it; least byte first.
    word = head[:, 1].astype(">u4").view("<u4").astype(np.uint32)
    length = int.from_bytes((stride - FRAME.size).to_bytes(4, "big"), "little")
    state = _moved(np.array([_ALL ^ length], np.uint32), 4)[0]
    crcs = _moved(_moved(state ^ word, 4) ^ np.uint32(_ALL), stride - FRAME.size) ^ head[:, 1].astype(np.uint32)
    crcs = crcs.reshape(-1, _BATCH)
    size = stride
    while crcs.shape[1] > 1:
        crcs = _moved(crcs[:, 0::2], size) ^ crcs[:, 1::2]
        size *= 2
    joined: Crcs = crcs[:, 0]
    return joined


def _moved(crcs: Crcs, size: int) -> Crcs:
    """CRCs moved on by so many zero bytes."""
    tables = _tables(size)
    moved: Crcs = tables[0][crcs & 0xFF]
    for number in (1, 2, 3):
        moved ^= tables[number][(crcs >> np.uint32(8 * number)) & 0xFF]
    return moved


@lru_cache(maxsize=64)
def _tables(size: int) -> Crcs:
    """What becomes of each byte of a CRC that is moved on by so many zero bytes, shape (4, 256)."""
    # Column i is what becomes of bit i: first of one zero bit, then by squaring of a power of two of them.
    power = np.array([_POLYNOMIAL] + [1 << bit for bit in range(31)], np.uint32)
    columns = np.uint32(1) << np.arange(32, dtype=np.uint32)
    bits = 8 * size
    while bits:
        if bits & 1:
            columns = _product(power, columns)
        bits >>= 1
        power = _product(power, power)
    number = np.arange(256, dtype=np.uint32)
    return np.stack([_product(columns, number << np.uint32(8 * byte)) for byte in range(4)])


def _product(columns: Crcs, vectors: Crcs) -> Crcs:
    """A matrix over GF(2), by its columns, applied to vectors."""
    product = np.zeros_like(vectors)
    for bit, column in enumerate(columns.tolist()):
        product ^= np.where((vectors >> np.uint32(bit)) & 1, np.uint32(column), np.uint32(0))
    return product

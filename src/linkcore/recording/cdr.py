"""Messages of ROS 2 in CDR, many at a time.

Most messages differ only in a few numbers; the names of joints and frames, and the lengths, are always the same. Such
messages have one size and each number has a fixed offset, so many of them are one array.

CDR (OMG, Common Data Representation, version 1, little-endian): 4 bytes of encapsulation ``00 01 00 00``; numbers at
multiples of their size, counted from the end of the encapsulation; text as a uint32 with its length, the final NUL
included, then the bytes and the NUL; sequences as a uint32 with their length, then the elements.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["Message"]

_ENCAPSULATION = b"\x00\x01\x00\x00"


class Message:
    """Builds `count` messages of one type, part by part, in the order of its definition."""

    def __init__(self, count: int) -> None:
        self._count = count
        self._size = len(_ENCAPSULATION)
        self._constants: list[tuple[int, bytes]] = [(0, _ENCAPSULATION)]
        self._columns: list[tuple[int, NDArray[Any]]] = []

    def _align(self, size: int) -> None:
        self._size += -(self._size - len(_ENCAPSULATION)) % size

    def length(self, length: int) -> Message:
        """The length of a sequence."""
        self._align(4)
        self._constants.append((self._size, length.to_bytes(4, "little")))
        self._size += 4
        return self

    def text(self, text: str) -> Message:
        """A text that is the same in all messages."""
        data = text.encode() + b"\0"
        self.length(len(data))
        self._constants.append((self._size, data))
        self._size += len(data)
        return self

    def texts(self, texts: Sequence[str]) -> Message:
        """A sequence of texts."""
        self.length(len(texts))
        for text in texts:
            self.text(text)
        return self

    def numbers(self, values: NDArray[Any]) -> Message:
        """One number, (n,), or several, (n, k), for each message; coded in the type of the array."""
        values = np.asarray(values)
        self._align(values.dtype.itemsize)
        self._columns.append((self._size, values))
        self._size += values.dtype.itemsize * (1 if values.ndim == 1 else values.shape[1])
        return self

    def sequence(self, values: NDArray[Any]) -> Message:
        """A sequence of numbers (n, k) for each message."""
        self.length(values.shape[1])
        return self.numbers(values) if values.shape[1] else self

    def stamp(self, wall: NDArray[np.datetime64]) -> Message:
        """A time: seconds and nanoseconds since 1970."""
        nanoseconds = wall.astype("M8[ns]").astype(np.int64)
        self.numbers((nanoseconds // 10**9).astype("<i4"))
        return self.numbers((nanoseconds % 10**9).astype("<u4"))

    def header(self, wall: NDArray[np.datetime64], frame: str) -> Message:
        """A `std_msgs/Header`: stamp and frame."""
        return self.stamp(wall).text(frame)

    def encoded(self) -> list[bytes]:
        """The messages."""
        every = np.zeros((self._count, self._size), np.uint8)
        for offset, data in self._constants:
            every[:, offset : offset + len(data)] = np.frombuffer(data, np.uint8)
        for offset, values in self._columns:
            little = np.ascontiguousarray(values, values.dtype.newbyteorder("<"))
            size = little.nbytes // max(self._count, 1)
            every[:, offset : offset + size] = little.view(np.uint8).reshape(self._count, size)
        data = every.tobytes()
        return [data[begin : begin + self._size] for begin in range(0, len(data), self._size)]

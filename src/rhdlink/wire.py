"""The RHD byte format, sans-IO, both directions.

Encoders make bytes. `ServerStream` reads what a server sends, `ClientStream` what a client sends: feed
them bytes as they come, cut anywhere, and take whole batches out. A batch is what the protocol answers
and waits for: packages up to an end package (section 2 of the protocol reference). Nothing of it is
handed out, and nothing allocated for it, before its counts, ids and lengths have been checked.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import NamedTuple, NoReturn

import numpy as np

from linkcore.errors import BadValue, PacketError

from .entries import Data, Entries, Layout, Stamps, Words
from .limits import Limits
from .trial import WIDTHS, Trial
from .walk import Walk

__all__ = [
    "END",
    "LONGEST_NAME",
    "Batch",
    "ClientStream",
    "Handshake",
    "Request",
    "Row",
    "ServerStream",
    "encode_access",
    "encode_data",
    "encode_ready",
    "encode_table",
]

#: Bytes of a name that a symbol table can hold, besides the terminating NUL.
LONGEST_NAME = 32
#: The end of a batch.
END = b"ee"

_INT = struct.Struct(">i")
_ROW = struct.Struct(f">i{LONGEST_NAME + 1}s")
_WIRE = np.dtype(">i4")
#: Bytes of a package before its rows or entries: type, direction, count.
_HEAD = 6
#: Sets of entries that a stream remembers, one for each number of entries.
_REMEMBERED = 8
_NO_WORDS: Words = np.empty(0, np.int32)


class Row(NamedTuple):
    """A variable in a symbol table.

    Attributes:
        name: at most 32 characters, each a byte on the wire (Latin-1).
        length: 32-bit words.
    """

    name: str
    length: int


class Handshake(NamedTuple):
    """What a server says first.

    Attributes:
        granted: the access it gives, "r" or "w"; None if it names none, which is how the original
            refuses a second writer (section 6).
        width: words of a time stamp.
        write: the variables from program to robot, by id.
        read: the variables from robot to program, by id.
        data: a value for each of them: the write table's, then the read table's.
    """

    granted: str | None
    width: int
    write: tuple[Row, ...]
    read: tuple[Row, ...]
    data: tuple[Data, Data]


class Batch(NamedTuple):
    """What a server says at a sync.

    Attributes:
        data: its data packages, in order.
        size: its bytes.
    """

    data: tuple[Data, ...]
    size: int


class Request(NamedTuple):
    """What a client says at a sync.

    Attributes:
        ready: "r" or "w", as what it asks for the next batch; None if it asks for none.
        data: its data packages, in order; only of write variables.
        size: its bytes.
    """

    ready: str | None
    data: tuple[Data, ...]
    size: int


# -- encoding ----------------------------------------------------------------------------------


def encode_access(access: str) -> bytes:
    """An access request, or its acknowledgement."""
    return b"a" + _direction(access)


def encode_ready(access: str) -> bytes:
    """A client's request for the next batch; an end has to follow."""
    return b"r" + _direction(access)


def encode_table(direction: str, rows: Sequence[Row]) -> bytes:
    """A symbol table.

    Raises:
        BadValue: a name that is longer than 32 bytes or holds a NUL, or a length below 1.
    """
    parts = [b"t" + _direction(direction) + _INT.pack(len(rows))]
    for name, length in rows:
        try:
            raw = name.encode("latin-1")
        except UnicodeEncodeError:
            raise BadValue(f"{name!r} cannot be a variable: it holds characters beyond Latin-1") from None
        if len(raw) > LONGEST_NAME or b"\0" in raw:
            raise BadValue(
                f"{name!r} cannot be a variable: expected at most {LONGEST_NAME} characters, none of them NUL"
            )
        if not 0 < length < 1 << 31:
            raise BadValue(f"variable {name!r} has {length} words; expected at least 1")
        parts.append(_ROW.pack(length, raw))
    return b"".join(parts)


def encode_data(direction: str, entries: Entries, values: Words, stamps: Stamps) -> bytes:
    """A data package.

    Args:
        direction: "r" or "w".
        entries: which variables.
        values: the flat storage of their table.
        stamps: the stamps of their table, shape (variables, 2).
    """
    count = len(entries.ids)
    head = b"d" + _direction(direction) + _INT.pack(count)
    return head + entries.pack(values, stamps) if count else head


def _direction(letter: str) -> bytes:
    if letter == "r":
        return b"r"
    if letter == "w":
        return b"w"
    raise BadValue(f"{letter!r} is neither 'r' nor 'w'")


# -- decoding ----------------------------------------------------------------------------------


class _Stream:
    """Bytes of one connection in one direction, cut into batches.

    Args:
        limits: what the peer may ask for.

    Attributes:
        offset: bytes of the batches taken so far.
    """

    def __init__(self, limits: Limits | None) -> None:
        self.limits = limits or Limits()
        self.offset = 0
        self._buffer: bytes | bytearray = b""
        self._start = 0  # of the batch in the buffer
        self._at = 0  # of the package in the buffer
        self._walk: Walk | None = None
        self._known: dict[tuple[str, int], Entries] = {}
        self._data: list[Data] = []
        self._failure: PacketError | None = None

    @property
    def waiting(self) -> int:
        """Bytes that came and belong to no batch taken so far."""
        return len(self._buffer) - self._start

    def feed(self, data: bytes) -> None:
        """Take bytes as they came, cut anywhere."""
        if self._failure is not None:
            return
        if self._start == len(self._buffer):
            self._buffer, self._start, self._at = data, 0, 0
            return
        if self._start:
            # What was taken makes room, so that the buffer never holds more than a batch and a chunk.
            self._buffer = self._buffer[self._start :]
            self._at -= self._start
            self._start = 0
        if isinstance(self._buffer, bytes):
            self._buffer = bytearray(self._buffer)
        self._buffer += data

    def _refuse(self, reason: str, at: int | None = None) -> NoReturn:
        """The peer cannot be understood from here on."""
        offset = (self._at if at is None else at) - self._start
        packet = f"batch at byte {self.offset} of the connection"
        self._failure = PacketError(reason, packet=packet, offset=offset)
        self._buffer = b""  # it is of no more use, and may be large
        raise self._failure

    def _check(self) -> None:
        """Raise again what was wrong."""
        if self._failure is not None:
            raise self._failure

    def _bound(self, size: int) -> None:
        """Refuse a batch that is, or is going to be, larger than it may be."""
        if size > self.limits.batch:
            self._refuse(f"no end within {self.limits.batch} bytes")

    def _count(self, what: str, most: int) -> int | None:
        """The count of the package at hand, None if it has not come."""
        if len(self._buffer) - self._at < _HEAD:
            return None
        (count,) = _INT.unpack_from(self._buffer, self._at + 2)
        if not 0 <= count <= most:
            self._refuse(f"{what} counts {count}; expected 0 to {most}", self._at + 2)
        return int(count)

    def _take_data(self, direction: str, layout: Layout, width: int) -> Data | None:
        """The data package at hand, None if it has not come whole."""
        buffer, start = self._buffer, self._at + _HEAD
        walk = self._walk
        if walk is None:
            count = self._count(f"data package 'd{direction}'", layout.count)
            if count is None:
                return None
            if count == 0:
                self._at = start
                return Data(direction, Entries(layout, np.empty(0, np.int64), width), _NO_WORDS)
            guess = self._known.get((direction, count))
            if guess is not None and len(buffer) - start >= 4 * guess.size:
                words = np.frombuffer(buffer, _WIRE, guess.size, start).astype(np.int32)
                if guess.fits(words):
                    self._at = start + 4 * guess.size
                    return Data(direction, guess, words)
            walk = self._walk = Walk(layout, width, count, guess)
        wrong = walk.advance(buffer, start)
        if wrong is not None:
            (identity,) = _INT.unpack_from(buffer, wrong)
            self._refuse(f"entry of variable {identity} in 'd{direction}'; expected 0 to {layout.count - 1}", wrong)
        self._bound(start + walk.at - self._start)
        if not walk.is_done(buffer, start):
            return None
        entries = walk.entries()
        self._walk = None
        self._remember(direction, entries)
        self._at = start + 4 * entries.size
        return Data(direction, entries, np.frombuffer(buffer, _WIRE, entries.size, start).astype(np.int32))

    def _remember(self, direction: str, entries: Entries) -> None:
        key = (direction, len(entries.ids))
        self._known.pop(key, None)
        if len(self._known) >= _REMEMBERED:
            del self._known[next(iter(self._known))]
        self._known[key] = entries

    def _end_batch(self, at: int) -> tuple[tuple[Data, ...], int]:
        """The batch ends before `at`: its data packages and its size."""
        size = at - self._start
        self._bound(size)
        data, self._data = tuple(self._data), []
        self.offset += size
        self._start = self._at = at
        return data, size


class ServerStream(_Stream):
    """What a server sends: one `Handshake`, then a `Batch` for each sync.

    Args:
        width: words of a time stamp, 2 or 4; None finds it out from the handshake.
        limits: what the server may ask for.

    Attributes:
        handshake: once it has been taken.

    Raises:
        BadValue: no such width.
    """

    def __init__(self, *, width: int | None = None, limits: Limits | None = None) -> None:
        super().__init__(limits)
        if width is not None and width not in WIDTHS:
            raise BadValue(f"width is {width}; expected 2 or 4 words")
        self.handshake: Handshake | None = None
        self._widths = WIDTHS if width is None else (width,)
        self._granted: str | None = None
        self._rows: dict[str, tuple[Row, ...]] = {}
        self._layouts: dict[str, Layout] = {}
        self._trials: list[Trial] = []

    def take_handshake(self) -> Handshake | None:
        """The handshake, or None if it has not come whole.

        Raises:
            PacketError: what came is none. Every further call raises it again.
        """
        self._check()
        if self.handshake is not None:
            return self.handshake
        buffer = self._buffer
        if self._at == 0 and len(buffer) >= 2 and buffer[:1] == b"a":
            if buffer[1:2] not in (b"r", b"w"):
                self._refuse(f"access {bytes(buffer[:2])!r} is granted; expected 'ar' or 'aw'", 1)
            self._granted = buffer[1:2].decode()
            self._at = 2
        for direction in "wr":
            if direction not in self._rows:
                table = self._take_table(direction) if self._is_at(f"t{direction}") else None
                if table is None:
                    self._bound(self.waiting)
                    return None
                self._rows[direction] = table
                self._layouts[direction] = Layout([row.length for row in table])
        width = self._find_width()
        if width is None:
            self._bound(self.waiting)
            return None
        data = []
        for direction in "wr":
            layout = self._layouts[direction]
            if layout.count:
                self._remember(direction, Entries(layout, np.arange(layout.count), width))
            package = self._take_data(direction, layout, width)
            assert package is not None  # the trial has seen it
            data.append(package)
        self._end_batch(self._at + 2)
        self.handshake = Handshake(self._granted, width, self._rows["w"], self._rows["r"], (data[0], data[1]))
        return self.handshake

    def take_batch(self) -> Batch | None:
        """The next batch after the handshake, or None if it has not come whole.

        A symbol table in it is tolerated if it says what the handshake said: the original's threads
        mix their output up (section 13, defect 5).

        Raises:
            PacketError: what came is none. Every further call raises it again.
        """
        handshake = self.handshake
        if handshake is None:
            raise BadValue("take_batch() before the handshake has been taken")
        self._check()
        if self._start == len(self._buffer):
            return None
        while len(self._buffer) - self._at >= 2:
            kind, direction = self._buffer[self._at], chr(self._buffer[self._at + 1])
            if kind == 0x65:  # e
                return Batch(*self._end_batch(self._at + 2))
            if kind not in (0x64, 0x74) or direction not in "rw":  # d, t
                self._refuse(_unexpected(self._buffer, self._at, "'dr', 'dw' or 'ee'"))
            if kind == 0x64:
                data = self._take_data(direction, self._layouts[direction], handshake.width)
                if data is None:
                    break
                self._data.append(data)
            else:
                start = self._at
                table = self._take_table(direction)
                if table is None:
                    break
                if table != self._rows[direction]:
                    self._refuse(f"another table 't{direction}' than in the handshake", start)
            self._bound(self._at - self._start)
        self._bound(self.waiting)
        return None

    def _is_at(self, package: str) -> bool:
        """Whether this package begins here; False if that has not come."""
        there = bytes(self._buffer[self._at : self._at + 2])
        if len(there) == 2 and there != package.encode():
            self._refuse(_unexpected(self._buffer, self._at, repr(package)))
        return len(there) == 2

    def _take_table(self, direction: str) -> tuple[Row, ...] | None:
        """The symbol table at hand, None if it has not come whole."""
        name = f"table 't{direction}'"
        count = self._count(name, self.limits.variables)
        start = self._at + _HEAD
        if count is None or len(self._buffer) - start < count * _ROW.size:
            return None
        rows, total = [], 0
        for number in range(count):
            at = start + number * _ROW.size
            length, raw = _ROW.unpack_from(self._buffer, at)
            if not 1 <= length <= self.limits.length:
                self._refuse(f"{name}: variable {number} has {length} words; expected 1 to {self.limits.length}", at)
            text, end, _ = raw.partition(b"\0")
            if not end:
                self._refuse(f"{name}: the name of variable {number} has no end within {len(raw)} bytes", at + 4)
            total += length
            rows.append(Row(text.decode("latin-1"), length))
        if total > self.limits.words:
            self._refuse(f"{name} has {total} words; expected at most {self.limits.words}")
        self._at = start + count * _ROW.size
        return tuple(rows)

    def _find_width(self) -> int | None:
        """Words of a time stamp, by the structure of what follows the tables; None if more has to come.

        Section 12: of the widths that are known, the one with which ids, counts and markers stand where
        they must. Two words are taken as soon as they fit, since four that look like it would need some
        48 bits to coincide.
        """
        if not self._trials:
            self._trials = [Trial(width, self._layouts["w"], self._layouts["r"]) for width in self._widths]
            self._bound(self._at - self._start + self._trials[0].size)
        for trial in self._trials:
            trial.advance(self._buffer, self._at)
        for trial in self._trials:
            if trial.wrong is None:
                return trial.width if trial.is_complete else None
        last = max(self._trials, key=lambda trial: (trial.wrong or 0, -trial.width))
        assert last.wrong is not None
        widths = " or ".join(str(width) for width in self._widths)
        self._refuse(
            f"the values after the tables fit stamps of {widths} words no longer; expected {last.expected!r}",
            self._at + last.wrong,
        )


class ClientStream(_Stream):
    """What a client sends: one access request, then a `Request` for each sync.

    Args:
        layout: of the write table, which is all that clients send values for.
        width: words of a time stamp, 2 or 4. A server cannot learn it (section 12).
        limits: what the client may ask for.

    Attributes:
        access: what it asked for, once that has been taken: "r" or "w".

    Raises:
        BadValue: no such width.
    """

    def __init__(self, layout: Layout, *, width: int = 2, limits: Limits | None = None) -> None:
        super().__init__(limits)
        if width not in WIDTHS:
            raise BadValue(f"width is {width}; expected 2 or 4 words")
        self.width = width
        self.access: str | None = None
        self._layout = layout
        self._ready: str | None = None

    def take_access(self) -> str | None:
        """The access that the client asks for, "r" or "w", or None if that has not come whole.

        Raises:
            PacketError: what came is no access request. Every further call raises it again.
        """
        self._check()
        if self.access is None and self._buffer:
            if self._buffer[0] != 0x61:  # a; the second byte may never come
                self._refuse(_unexpected(self._buffer[:1], 0, "'ar' or 'aw'"))
            if len(self._buffer) >= 2:
                if self._buffer[1:2] not in (b"r", b"w"):
                    self._refuse(_unexpected(self._buffer, 0, "'ar' or 'aw'"), 1)
                self.access = self._buffer[1:2].decode()
                self._end_batch(2)
        return self.access

    def take_request(self) -> Request | None:
        """The next request after the access request, or None if it has not come whole.

        Raises:
            PacketError: what came is none. Every further call raises it again.
        """
        if self.access is None:
            raise BadValue("take_request() before the access request has been taken")
        self._check()
        if self._start == len(self._buffer):
            return None
        while len(self._buffer) - self._at >= 2:
            kind, direction = self._buffer[self._at], chr(self._buffer[self._at + 1])
            if kind == 0x65:  # e
                data, size = self._end_batch(self._at + 2)
                ready, self._ready = self._ready, None
                return Request(ready, data, size)
            if kind == 0x72 and direction in "rw":  # r
                self._ready = direction
                self._at += 2
            elif kind == 0x64 and direction == "w":  # d
                data_package = self._take_data("w", self._layout, self.width)
                if data_package is None:
                    break
                self._data.append(data_package)
            else:
                self._refuse(_unexpected(self._buffer, self._at, "'rr', 'rw', 'dw' or 'ee'"))
            self._bound(self._at - self._start)
        self._bound(self.waiting)
        return None


def _unexpected(buffer: bytes | bytearray, at: int, expected: str) -> str:
    return f"{bytes(buffer[at : at + 2])!r} cannot begin a package here; expected {expected}"

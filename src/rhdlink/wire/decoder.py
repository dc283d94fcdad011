"""Decoders from bytes to checked batches, for both directions, without sockets (sans-IO).

`ServerDecoder` reads the bytes of a server, and `ClientDecoder` reads the bytes of a client. Feed them bytes in chunks
of any size, and take whole batches out. A decoder checks counts, ids and lengths before it returns a part of a batch or
allocates memory for it. The original has no such checks, so a single hostile number can crash it
(docs/protocols/rhd.md, Defects).
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import NoReturn

from linkcore.errors import BadValue, PacketError

from .data import Cursor, DataPackage, Selection, TableLayout, remember
from .messages import Batch, Handshake, Request, SymbolRow
from .schema import ACCESS, DATA, END, HEAD_SIZE, INT, READY, TABLE, WIDTHS, WORD

_ACCESS, _TABLE, _DATA, _READY, _END = (ord(package.letter) for package in (ACCESS, TABLE, DATA, READY, END))
_ROW = TABLE.item_struct


@dataclass(frozen=True)
class Limits:
    """Limits on data that arrives over the wire.

    The defaults are far above any known robot, which has about 100 variables with at most 127 words.

    Attributes:
        variables: Maximum number of variables in one table.
        length: Maximum number of 32-bit words of one variable.
        words: Maximum number of words of all variables of one table together.
        batch: Maximum size of one batch in bytes. The handshake is a batch too.

    Raises:
        BadValue: If a limit is below 1.
    """

    variables: int = 8192
    length: int = 4096
    words: int = 1 << 20
    batch: int = 16 << 20

    def __post_init__(self) -> None:
        for field in fields(self):
            if getattr(self, field.name) < 1:
                raise BadValue(f"Limits.{field.name} is {getattr(self, field.name)}; expected 1 or more")


class _Decoder:
    """Decoder that splits the bytes of one direction of a connection into batches.

    Args:
        limits: Limits on the data of the peer.

    Attributes:
        offset: Total number of bytes of the batches taken so far.
    """

    def __init__(self, limits: Limits | None) -> None:
        self.limits = limits or Limits()
        self.offset = 0
        self._buffer: bytes | bytearray = b""
        self._start = 0  # start of the batch in the buffer
        self._at = 0  # start of the package in the buffer
        self._cursor: Cursor | None = None
        self._known: dict[tuple[str, int], Selection] = {}  # by direction and number of entries
        self._data: list[DataPackage] = []
        self._failure: PacketError | None = None

    @property
    def waiting(self) -> int:
        """Number of received bytes that are not part of a taken batch."""
        return len(self._buffer) - self._start

    def feed(self, data: bytes) -> None:
        """Add received bytes, in a chunk of any size."""
        if self._failure is not None:
            return
        if self._start == len(self._buffer):
            self._buffer, self._start, self._at = data, 0, 0
            return
        if self._start:
            # Drop the taken batches, so that the buffer never holds more than a batch and a chunk.
            self._buffer = self._buffer[self._start :]
            self._at -= self._start
            self._start = 0
        if isinstance(self._buffer, bytes):
            self._buffer = bytearray(self._buffer)
        self._buffer += data

    def _refuse(self, reason: str, at: int | None = None) -> NoReturn:
        """Reject all further data of the connection."""
        offset = (self._at if at is None else at) - self._start
        packet = f"batch at byte {self.offset} of the connection"
        self._failure = PacketError(reason, packet=packet, offset=offset)
        self._buffer = b""  # the buffer is no longer needed, and might be large
        raise self._failure

    def _refuse_package(self, expected: str, at: int | None = None, *, letters: int = 2) -> NoReturn:
        """Reject the next bytes, because their first letters do not begin a package that is allowed here."""
        there = bytes(self._buffer[self._at : self._at + letters])
        self._refuse(f"{there!r} cannot begin a package here; expected {expected}", at)

    def _check(self) -> None:
        """Raise an earlier error again."""
        if self._failure is not None:
            raise self._failure

    def _bound(self, size: int) -> None:
        """Reject a batch that is, or will be, larger than the limit."""
        if size > self.limits.batch:
            self._refuse(f"no end within {self.limits.batch} bytes")

    def _take_count(self, what: str, most: int) -> int | None:
        """Return the count of the current package; None if it has not arrived."""
        if len(self._buffer) - self._at < HEAD_SIZE:
            return None
        (count,) = INT.unpack_from(self._buffer, self._at + 2)
        if not 0 <= count <= most:
            self._refuse(f"{what} counts {count}; expected 0 to {most}", self._at + 2)
        return int(count)

    def _take_data(self, direction: str, layout: TableLayout, width: int) -> DataPackage | None:
        """Return the current data package; None if it has not arrived completely."""
        buffer, start = self._buffer, self._at + HEAD_SIZE
        cursor = self._cursor
        if cursor is None:
            count = self._take_count(f"data package 'd{direction}'", layout.count)
            if count is None:
                return None
            # In the common case, the package has the same variables as the last package with this count. Compare all
            # ids at once instead of checking the entries one by one.
            guess = self._known.get((direction, count))
            if guess is not None and len(buffer) - start >= WORD * guess.size:
                package = DataPackage.read(direction, guess, buffer, start)
                if guess.fits(package.words):
                    self._at = start + WORD * guess.size
                    return package
            cursor = self._cursor = Cursor(layout, width, count, guess)
        wrong = cursor.advance(buffer, start)
        if wrong is not None:
            (identity,) = INT.unpack_from(buffer, wrong)
            self._refuse(f"entry of variable {identity} in 'd{direction}'; expected 0 to {layout.count - 1}", wrong)
        self._bound(start + cursor.at - self._start)
        if not cursor.is_done(buffer, start):
            return None
        selection = cursor.selection()
        self._cursor = None
        remember(self._known, (direction, cursor.count), selection)
        self._at = start + WORD * selection.size
        return DataPackage.read(direction, selection, buffer, start)

    def _end_batch(self, at: int) -> tuple[tuple[DataPackage, ...], int]:
        """End the batch before `at`. Return its data packages and its size."""
        size = at - self._start
        self._bound(size)
        data, self._data = tuple(self._data), []
        self.offset += size
        self._start = self._at = at
        return data, size


class ServerDecoder(_Decoder):
    """Decoder of the bytes of a server: one `Handshake`, then a `Batch` for each sync.

    Args:
        width: Number of 32-bit words of a time stamp, 2 or 4. If None, it is detected from the handshake.
        limits: Limits on the data of the server.

    Attributes:
        handshake: Handshake, after it was taken.

    Raises:
        BadValue: If `width` is not valid.
    """

    def __init__(self, *, width: int | None = None, limits: Limits | None = None) -> None:
        super().__init__(limits)
        if width is not None and width not in WIDTHS:
            raise BadValue(f"width is {width}; expected 2 or 4 words")
        self.handshake: Handshake | None = None
        self._widths = WIDTHS if width is None else (width,)
        self._granted: str | None = None
        self._rows: dict[str, tuple[SymbolRow, ...]] = {}
        self._layouts: dict[str, TableLayout] = {}
        self._probes: list[_WidthProbe] = []

    def take_handshake(self) -> Handshake | None:
        """Return the handshake, or None if it has not arrived completely.

        Raises:
            PacketError: If the bytes are not a handshake. Every further call raises it again.
        """
        self._check()
        if self.handshake is not None:
            return self.handshake
        buffer = self._buffer
        # If the original refuses a writer, it sends no access at all (docs/protocols/rhd.md, Access).
        if self._at == 0 and len(buffer) >= 2 and buffer[0] == _ACCESS:
            if buffer[1:2] not in (b"r", b"w"):
                self._refuse(f"access {bytes(buffer[:2])!r} is granted; expected 'ar' or 'aw'", 1)
            self._granted = buffer[1:2].decode()
            self._at = 2
        # The write table always comes before the read table (docs/protocols/rhd.md, Handshake).
        for direction in "wr":
            if direction not in self._rows:
                table = self._take_table(direction) if self._is_at(f"{TABLE.letter}{direction}") else None
                if table is None:
                    self._bound(self.waiting)
                    return None
                self._rows[direction] = table
                self._layouts[direction] = TableLayout([row.length for row in table])
        width = self._find_width()
        if width is None:
            self._bound(self.waiting)
            return None
        data = []
        for direction in "wr":
            package = self._take_data(direction, self._layouts[direction], width)
            assert package is not None  # the probe has checked all of it
            data.append(package)
        self._end_batch(self._at + 2)
        self.handshake = Handshake(self._granted, width, self._rows["w"], self._rows["r"], (data[0], data[1]))
        return self.handshake

    def take_batch(self) -> Batch | None:
        """Return the next batch after the handshake, or None if it has not arrived completely.

        A symbol table in the batch is accepted if it equals the table of the handshake, because the original's threads
        mix up their output (docs/protocols/rhd.md, Defects, 5).

        Raises:
            PacketError: If the bytes are not a batch. Every further call raises it again.
        """
        handshake = self.handshake
        if handshake is None:
            raise BadValue("take_batch() was called before take_handshake() returned the handshake")
        self._check()
        while len(self._buffer) - self._at >= 2:
            letter, direction = self._buffer[self._at], chr(self._buffer[self._at + 1])
            if letter == _END:  # with any second letter
                return Batch(*self._end_batch(self._at + 2))
            if letter not in (_DATA, _TABLE) or direction not in "rw":
                self._refuse_package("'dr', 'dw' or 'ee'")
            if letter == _DATA:
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
                    self._refuse(f"table 't{direction}' differs from the table in the handshake", start)
        self._bound(self.waiting)
        return None

    def _is_at(self, package: str) -> bool:
        """Whether this package begins here; False if its letters have not arrived."""
        there = bytes(self._buffer[self._at : self._at + 2])
        if len(there) == 2 and there != package.encode():
            self._refuse_package(repr(package))
        return len(there) == 2

    def _take_table(self, direction: str) -> tuple[SymbolRow, ...] | None:
        """Return the current symbol table; None if it has not arrived completely."""
        name = f"table 't{direction}'"
        count = self._take_count(name, self.limits.variables)
        start = self._at + HEAD_SIZE
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
                self._refuse(f"{name}: the name of variable {number} has no end within {len(raw)} bytes", at + WORD)
            total += length
            rows.append(SymbolRow(text.decode("latin-1"), length))
        if total > self.limits.words:
            self._refuse(f"{name} has {total} words; expected at most {self.limits.words}")
        self._at = start + count * _ROW.size
        return tuple(rows)

    def _find_width(self) -> int | None:
        """Return the number of words of a time stamp, detected from the data after the tables.

        Return None if more bytes are needed.

        The result is the width for which all ids, counts and letters are at the right positions. Two words are accepted
        as soon as they fit. A stream of four looks like a stream of two only if about 48 bits happen to match
        (docs/protocols/rhd.md, Time stamps).
        """
        if not self._probes:
            self._probes = [_WidthProbe(width, self._layouts["w"], self._layouts["r"]) for width in self._widths]
            self._bound(self._at - self._start + self._probes[0].size)
        for probe in self._probes:
            probe.advance(self._buffer, self._at)
        for probe in self._probes:
            if probe.wrong is None:
                return probe.width if probe.is_complete else None
        offset, expected = max(probe.wrong for probe in self._probes if probe.wrong is not None)
        widths = " or ".join(str(width) for width in self._widths)
        self._refuse(
            f"the values after the tables do not fit time stamps of {widths} words; expected {expected!r}",
            self._at + offset,
        )


class _WidthProbe:
    """Check of a handshake: whether its data packages fit time stamps of `width` words.

    Attributes:
        width: Number of words.
        wrong: Offset of the first letter, count or id that does not fit, and the expected bytes; or None.
        size: Number of bytes of the data packages, including the end.
        is_complete: Whether all bytes have arrived and fit.
    """

    def __init__(self, width: int, write: TableLayout, read: TableLayout) -> None:
        self.width = width
        self.wrong: tuple[int, bytes] | None = None
        self._marks: list[tuple[int, bytes]] = []
        at = 0
        for direction, layout in (("w", write), ("r", read)):
            self._marks.append((at, f"{DATA.letter}{direction}".encode() + INT.pack(layout.count)))
            at += HEAD_SIZE
            for identity, length in enumerate(layout.sizes):
                self._marks.append((at, INT.pack(identity)))
                at += WORD * (1 + width + length)
        self._marks.append((at, END.letter.encode()))
        self.size = at + 2
        self._next = 0
        self.is_complete = False

    def advance(self, buffer: bytes | bytearray, start: int) -> None:
        """Check the bytes that have arrived since the last call. The data packages begin at `start`."""
        end = len(buffer) - start
        marks = self._marks
        while self.wrong is None and self._next < len(marks):
            at, expected = marks[self._next]
            if at + len(expected) > end:
                return
            if buffer[start + at : start + at + len(expected)] != expected:
                self.wrong = at, expected
            self._next += 1
        self.is_complete = self.wrong is None and self.size <= end


class ClientDecoder(_Decoder):
    """Decoder of the bytes of a client: one access request, then a `Request` for each sync.

    Args:
        layout: Layout of the write table. Clients send values only for this table.
        width: Number of 32-bit words of a time stamp, 2 or 4. The bytes of a client do not show it
            (docs/protocols/rhd.md, Time stamps).
        limits: Limits on the data of the client.

    Attributes:
        access: Requested access, "r" or "w", after it was taken.

    Raises:
        BadValue: If `width` is not valid.
    """

    def __init__(self, layout: TableLayout, *, width: int = 2, limits: Limits | None = None) -> None:
        super().__init__(limits)
        if width not in WIDTHS:
            raise BadValue(f"width is {width}; expected 2 or 4 words")
        self.width = width
        self.access: str | None = None
        self._layout = layout
        self._ready: str | None = None

    def take_access(self) -> str | None:
        """Return the access that the client requests, "r" or "w".

        None if it has not arrived completely.

        Raises:
            PacketError: If the bytes are not an access request. Every further call raises it again.
        """
        self._check()
        if self.access is None and self._buffer:
            if self._buffer[0] != _ACCESS:  # report the error now, because the second byte might never arrive
                self._refuse_package("'ar' or 'aw'", letters=1)
            if len(self._buffer) >= 2:
                if self._buffer[1:2] not in (b"r", b"w"):
                    self._refuse_package("'ar' or 'aw'", 1)
                self.access = self._buffer[1:2].decode()
                self._end_batch(2)
        return self.access

    def take_request(self) -> Request | None:
        """Return the next request after the access request.

        None if it has not arrived completely.

        Raises:
            PacketError: If the bytes are not a request. Every further call raises it again.
        """
        if self.access is None:
            raise BadValue("take_request() was called before take_access() returned the access")
        self._check()
        while len(self._buffer) - self._at >= 2:
            letter, direction = self._buffer[self._at], chr(self._buffer[self._at + 1])
            if letter == _END:
                data, size = self._end_batch(self._at + 2)
                ready, self._ready = self._ready, None
                return Request(ready, data, size)
            if letter == _READY and direction in "rw":
                # The ready package can come before or after the values; a request has no order (docs/protocols/rhd.md,
                # Sync cycle).
                self._ready = direction
                self._at += 2
            elif letter == _DATA and direction == "w":
                package = self._take_data("w", self._layout, self.width)
                if package is None:
                    break
                self._data.append(package)
            else:
                self._refuse_package("'rr', 'rw', 'dw' or 'ee'")
        self._bound(self.waiting)
        return None

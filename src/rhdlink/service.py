"""A variable database served to many clients, sans-IO: who may write, and who is told what.

`Server` brings the bytes of each connection and takes the replies away. A request is answered at the next `sync`, as by
the original: what it writes is seen by the plugins in the round that follows, and what they set then goes out with the
reply after it (section 7 of the protocol reference).
"""

from __future__ import annotations

import logging
from typing import Literal

import numpy as np

from linkcore.errors import BadValue, PacketError

from .database import Database, Table
from .entries import Data, Ids
from .limits import Limits
from .pending import Pending
from .wire import END, ClientStream, Request, encode_data

__all__ = ["Guest", "Resend", "Service"]

_log = logging.getLogger(__name__)

#: What of the read variables a reply holds: those set since the client's last one, or, as in the original, all that
#: were ever set.
Resend = Literal["changed", "original"]

#: Bytes kept of a client that sends ahead of the replies.
AHEAD = 4096


class Guest:
    """One client.

    Attributes:
        name: address and port, for messages.
        access: "r" or "w" once it has been granted.
        request: what it asks for, until the next sync; None if nothing is complete.
        requests: how many requests it has completed.
        refused_writes: values that it sent without the right to.
        failure: why its connection is to be closed, or None.
        is_reading: whether it has taken all that was sent to it; until then it gets no more.
    """

    __slots__ = (
        "access",
        "failure",
        "is_reading",
        "name",
        "read_news",
        "refused_writes",
        "request",
        "requests",
        "seat",
        "stream",
        "write_news",
    )

    def __init__(self, name: str, stream: ClientStream) -> None:
        self.name = name
        self.stream = stream
        self.seat: int | None = None
        self.access: str | None = None
        self.request: Request | None = None
        self.requests = 0
        self.refused_writes = 0
        self.failure: str | None = None
        self.is_reading = True
        self.read_news = Pending(0)
        self.write_news = Pending(0)

    @property
    def is_midway(self) -> bool:
        """Whether a handshake or a request is begun and not complete."""
        return self.access is None or (self.request is None and self.stream.waiting > 0)

    @property
    def is_asking(self) -> bool:
        """Whether it has a request that the next sync will take."""
        return self.request is not None and self.is_reading

    @property
    def wants_more(self) -> bool:
        """Whether more of what it sends is to be read, with one request complete."""
        return self.request is None or self.stream.waiting <= AHEAD


class Service:
    """Serves one database.

    Args:
        database: the variables; frozen from now on.
        clients: how many may be connected.
        allwriters: whether every client that asks for it may write, rather than the first only.
        resend: what of the read variables a reply holds.
        width: words of a time stamp, 2 or 4; what the clients have, since nothing they send tells.
        limits: what a client may ask for; by default no more than all write variables at once, and a little.

    Attributes:
        refused_writes: values sent by clients that may not write, and not taken.
        refused_clients: connections beyond the seats.
        bad_clients: connections closed because of what they sent.

    Raises:
        BadValue: no such width, or no seats.
    """

    def __init__(
        self,
        database: Database,
        *,
        clients: int = 10,
        allwriters: bool = False,
        resend: Resend = "changed",
        width: int = 2,
        limits: Limits | None = None,
    ) -> None:
        if clients < 1:
            raise BadValue(f"a host for {clients} clients serves nobody")
        if resend not in ("changed", "original"):
            raise BadValue(f"resend={resend!r} is neither 'changed' nor 'original'")
        database.freeze()
        self._database = database
        self._allwriters = allwriters
        self._resend = resend
        self._width = width
        # All variables once, and room for empty packages: nobody needs more, and it is the longest that is parsed.
        layout = database.write.layout
        self._limits = limits or Limits(batch=1024 + 4 * (layout.words + layout.count * (1 + width)))
        ClientStream(layout, width=width, limits=self._limits)
        self._seats: list[Guest | None] = [None] * clients
        self._sole_writer: Guest | None = None
        self._last_words: list[Data] = []
        self.refused_writes = 0
        self.refused_clients = 0
        self.bad_clients = 0

    @property
    def guests(self) -> list[Guest]:
        """The clients that have been granted access, by seat."""
        return [guest for guest in self._seats if guest is not None]

    @property
    def writers(self) -> int:
        """How many of them may write: `isMasterAlive` of the original."""
        return sum(guest.access == "w" for guest in self.guests)

    @property
    def is_asked(self) -> bool:
        """Whether the sole writer asks for the next tick; or any client, while there is none."""
        sole = self._sole_writer
        if sole is not None:
            return sole.is_asking
        return any(guest is not None and guest.is_asking for guest in self._seats)

    # -- connections -----------------------------------------------------------------------------------

    def arrive(self, name: str) -> Guest | None:
        """A client has connected; None if there is no seat for it."""
        if None not in self._seats:
            self.refused_clients += 1
            return None
        return Guest(name, ClientStream(self._database.write.layout, width=self._width, limits=self._limits))

    def receive(self, guest: Guest, data: bytes) -> bytes:
        """Bytes have come from a client; what is to be sent to it at once: the handshake, or nothing.

        Sets `failure` of the guest where it is to be closed.
        """
        stream = guest.stream
        stream.feed(data)
        try:
            if guest.access is None:
                wanted = stream.take_access()
                return b"" if wanted is None else self._admit(guest, wanted)
            if guest.request is None:
                self._take_request(guest)
        except PacketError as error:
            self._fail(guest, str(error))
        return b""

    def leave(self, guest: Guest) -> None:
        """A client is gone. What it had written completely still counts: it may be the command to stop."""
        if guest.seat is None:
            return
        self._seats[guest.seat] = None
        guest.seat = None
        self._find_sole_writer()
        while guest.failure is None and guest.access == "w" and guest.request is not None:
            if guest.request.ready != "r":
                self._last_words += guest.request.data
            guest.request = None
            try:
                self._take_request(guest)
            except PacketError:
                break
        guest.request = None

    def _admit(self, guest: Guest, wanted: str) -> bytes:
        if None not in self._seats:
            self.refused_clients += 1
            guest.failure = "all seats were taken meanwhile"
            return b""
        # A second writer becomes a reader and is told so; the original leaves the answer out (defect 7).
        guest.access = "w" if wanted == "w" and (self._allwriters or not self.writers) else "r"
        guest.seat = self._seats.index(None)
        self._seats[guest.seat] = guest
        self._find_sole_writer()
        database = self._database
        # Others may not have been told yet of what was set before now. This client is told by the handshake.
        self._spread_news()
        guest.read_news, guest.write_news = Pending(len(database.read)), Pending(len(database.write))
        self._take_request(guest)
        return database.encode_handshake(guest.access, self._width)

    def _find_sole_writer(self) -> None:
        writers = [guest for guest in self.guests if guest.access == "w"]
        self._sole_writer = writers[0] if len(writers) == 1 else None

    def _take_request(self, guest: Guest) -> None:
        request = guest.request = guest.stream.take_request()
        if request is not None:
            guest.requests += 1
            if request.ready == "w" and guest.access != "w":
                # As the original does (section 6).
                self._fail(guest, "asks as a writer without being one")

    def _fail(self, guest: Guest, reason: str) -> None:
        guest.failure = reason
        self.bad_clients += 1

    # -- one round ------------------------------------------------------------------------------------

    def sync(self) -> list[tuple[Guest, bytes]]:
        """Take what clients have written, and answer those who asked: one request of each client."""
        database = self._database
        database.write.begin_round()
        written: list[tuple[Guest | None, Data]] = []
        for data in self._last_words:
            self._write(None, data, written)
        self._last_words.clear()
        taken, ready = [], []
        for guest in self._seats:
            if guest is None or guest.request is None or not guest.is_reading or guest.failure is not None:
                continue
            request, guest.request = guest.request, None
            taken.append(guest)
            if request.data:
                if guest.access == "w":
                    for data in request.data:
                        self._write(guest, data, written)
                else:
                    self._refuse(guest, sum(map(len, request.data)))
            if request.ready is not None:
                ready.append(guest)
        self._spread_news()
        for author, data in written:
            for guest in self._seats:
                # The sole writer knows what it wrote (section 4).
                if guest is not None and not (guest is author and guest is self._sole_writer):
                    guest.write_news.add_many(data.ids, ordered=data.entries.is_ordered)
        replies = self._replies(ready)
        for guest in taken:
            # It may have sent ahead.
            if guest.stream.waiting:
                try:
                    self._take_request(guest)
                except PacketError as error:
                    self._fail(guest, str(error))
        return replies

    def _write(self, author: Guest | None, data: Data, written: list[tuple[Guest | None, Data]]) -> None:
        self._database.write.receive(data)
        written.append((author, data))

    def _refuse(self, guest: Guest, count: int) -> None:
        if not guest.refused_writes:
            _log.warning("%s may only read, and sends values: they are not taken", guest.name)
        guest.refused_writes += count
        self.refused_writes += count

    def _spread_news(self) -> None:
        news = self._database.read.pending.take()
        if len(news) and self._resend == "changed":
            for guest in self._seats:
                if guest is not None:
                    guest.read_news.add_many(news, ordered=True)

    def _replies(self, ready: list[Guest]) -> list[tuple[Guest, bytes]]:
        read, write = self._database.read, self._database.write
        packages = _Packages(self._width)
        all_read = np.flatnonzero(read.updated) if self._resend == "original" and ready else None
        replies = []
        for guest in ready:
            # What others had written before it became the sole writer waits until it is not the only one.
            own = b"" if guest is self._sole_writer else packages.of(write, guest.write_news.take())
            ids = guest.read_news.take() if all_read is None else all_read
            replies.append((guest, own + packages.of(read, ids) + END))
        return replies


class _Packages:
    """The data packages of one round, each made once, however many clients are sent it."""

    def __init__(self, width: int) -> None:
        self._width = width
        self._made: list[tuple[Table, Ids, bytes]] = []

    def of(self, table: Table, ids: Ids) -> bytes:
        for known, known_ids, data in self._made:
            if known is table and (known_ids is ids or np.array_equal(known_ids, ids)):
                return data
        data = encode_data(table.direction, table.select(ids, self._width), table.values, table.stamps)
        self._made.append((table, ids, data))
        return data

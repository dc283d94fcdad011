"""Service that offers a variable database to many clients, without sockets (sans-IO).

The service decides which clients may write, and makes the reply to each client. `Server` delivers the bytes of each
connection and sends the replies. A request is answered at the next `sync`, as in the original. Plugins see the written
values in the tick that follows, and the values that they set then are part of the next reply (docs/protocols/rhd.md,
Server tick).
"""

from __future__ import annotations

import logging
from typing import Literal

import numpy as np

from linkcore.arguments import check_choice, check_whole
from linkcore.errors import BadValue, PacketError

from ..variables.database import Database, VariableTable
from ..variables.dirty_set import DirtySet
from ..wire.data import DataPackage, Ids
from ..wire.decoder import ClientDecoder, Limits
from ..wire.messages import END, Request
from ..wire.schema import WORD

_log = logging.getLogger(__name__)

#: Read variables in a reply: "changed" for variables that were set since the client's last reply, or "original" for all
#: variables that were ever set, as in the original.
Resend = Literal["changed", "original"]

#: Maximum number of bytes that are stored for a client that sends requests ahead of the replies.
AHEAD = 4096


class Client:
    """Client of a service.

    Attributes:
        name: Address and port, used in messages.
        slot: Number of the client's slot; None until access has been granted, and after the client has disconnected.
        access: Granted access, "r" or "w"; None before.
        request: Request for the next sync; None if no request is complete.
        requests: Number of requests that the client has completed.
        refused_writes: Number of values that the client has sent without permission to write.
        failure: Reason why the connection must be closed, or None.
        is_reading: Whether the client has read all sent data. If not, nothing more is sent.
        dirty_read: Read variables that were not sent to the client yet; exists after access has been granted.
        dirty_write: The same for write variables that other clients have set.
    """

    dirty_read: DirtySet
    dirty_write: DirtySet

    def __init__(self, name: str, decoder: ClientDecoder) -> None:
        self.name = name
        self.decoder = decoder
        self.slot: int | None = None
        self.access: str | None = None
        self.request: Request | None = None
        self.requests = 0
        self.refused_writes = 0
        self.failure: str | None = None
        self.is_reading = True

    @property
    def is_incomplete(self) -> bool:
        """Whether a handshake or a request has begun and is not complete."""
        return self.access is None or (self.request is None and self.decoder.waiting > 0)

    @property
    def is_asking(self) -> bool:
        """Whether the client has a request that the next sync will answer."""
        return self.request is not None and self.is_reading

    @property
    def may_send(self) -> bool:
        """Whether more data of the client should be read although one request is complete."""
        return self.request is None or self.decoder.waiting <= AHEAD


class Service:
    """Service for one database.

    Args:
        database: Variables; frozen from now on.
        clients: Maximum number of connected clients.
        allwriters: Whether every client that requests write access may write. If False, only the first such client may
            write.
        resend: Read variables in a reply: "changed" or "original".
        width: Number of words of a time stamp, 2 or 4. It applies to all clients, because their requests do not show
            their width.
        limits: Limits of a request; by default slightly more than all write variables at once.

    Attributes:
        refused_writes: Number of rejected values from clients that may not write.
        refused_clients: Number of connections without a free slot.
        bad_clients: Number of connections that were closed because of invalid data.

    Raises:
        BadValue: If the width is invalid, or there are no slots.
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
        check_whole(clients, "clients", 1, 10_000)
        check_choice(resend, "resend", ("changed", "original"))
        if limits is not None and not isinstance(limits, Limits):
            raise BadValue(f"limits={limits!r}; expected rhdlink.variables.Limits(...)")
        database.freeze()
        self._database = database
        self._allwriters = allwriters
        self._resend = resend
        self._width = width
        # All variables once, and a kilobyte of empty packages. A longer batch is not needed, and is not parsed.
        layout = database.write.layout
        self._limits = limits or Limits(batch=WORD * (256 + layout.words + layout.count * (1 + width)))
        ClientDecoder(layout, width=width, limits=self._limits)
        self._slots: list[Client | None] = [None] * clients
        self._final_writes: list[DataPackage] = []
        self.refused_writes = 0
        self.refused_clients = 0
        self.bad_clients = 0

    @property
    def clients(self) -> list[Client]:
        """Clients that have been granted access, in the order of their slots."""
        return [client for client in self._slots if client is not None]

    @property
    def slots(self) -> int:
        """Maximum number of connected clients."""
        return len(self._slots)

    @property
    def is_full(self) -> bool:
        """Whether every slot is taken."""
        return None not in self._slots

    @property
    def most_output(self) -> int:
        """Maximum number of pending bytes for one client: the size of a handshake.

        No batch is longer, and no batch is made before the handshake is sent.
        """
        return len(self._database.encode_handshake("r", self._width))

    @property
    def writers(self) -> int:
        """Number of clients that may write: `isMasterAlive` of the original."""
        return sum(client.access == "w" for client in self.clients)

    @property
    def is_asked(self) -> bool:
        """Whether the only writer requests the next tick, or any client while there is no writer."""
        sole = self._sole_writer
        if sole is not None:
            return sole.is_asking
        return any(client.is_asking for client in self.clients)

    @property
    def _sole_writer(self) -> Client | None:
        """Client that may write, if no other client may."""
        writers = [client for client in self.clients if client.access == "w"]
        return writers[0] if len(writers) == 1 else None

    # -- connections -----------------------------------------------------------------------------------

    def connect(self, name: str) -> Client | None:
        """Return a new client for a connection; None if there is no slot for it."""
        if self.is_full:
            self.refused_clients += 1
            return None
        return Client(name, ClientDecoder(self._database.write.layout, width=self._width, limits=self._limits))

    def receive(self, client: Client, data: bytes) -> bytes:
        """Process bytes of a client; return the immediate answer, which is the handshake or nothing.

        If the client must be closed, its `failure` is set.
        """
        decoder = client.decoder
        decoder.feed(data)
        try:
            if client.access is None:
                wanted = decoder.take_access()
                return b"" if wanted is None else self._grant(client, wanted)
            if client.request is None:
                self._take_request(client)
        except PacketError as error:
            self._fail(client, str(error))
        return b""

    def disconnect(self, client: Client) -> None:
        """Remove a client. Its complete requests still count, because one may be the command to stop."""
        if client.slot is None:
            return
        # The slot is free immediately; in the original it is free at the next tick (docs/rhd-differences.md).
        self._slots[client.slot] = None
        client.slot = None
        while client.failure is None and client.access == "w" and client.request is not None:
            self._final_writes += client.request.data
            try:
                self._take_request(client)
            except PacketError:
                break

    def _grant(self, client: Client, wanted: str) -> bytes:
        if self.is_full:
            self.refused_clients += 1
            client.failure = "no free slot was left when access was requested"
            return b""
        # A second writer becomes a reader, and the reply shows this. The original does not answer
        # (docs/protocols/rhd.md, Defects, 7).
        client.access = "w" if wanted == "w" and (self._allwriters or not self.writers) else "r"
        # Mark earlier values as new only for the other clients, because this client gets all values with its handshake.
        self._spread_dirty()
        # Take the lowest free slot, as in the original, because the replies of a tick are sent in the order of the
        # slots.
        client.slot = self._slots.index(None)
        self._slots[client.slot] = client
        database = self._database
        client.dirty_read, client.dirty_write = DirtySet(len(database.read)), DirtySet(len(database.write))
        self._take_request(client)
        return database.encode_handshake(client.access, self._width)

    def _take_request(self, client: Client) -> None:
        request = client.request = client.decoder.take_request()
        if request is not None:
            client.requests += 1
            if request.ready == "w" and client.access != "w":
                # The original also closes the connection (docs/protocols/rhd.md, Access).
                self._fail(client, "requests as a writer without permission to write")

    def _fail(self, client: Client, reason: str) -> None:
        client.failure = reason
        self.bad_clients += 1

    # -- one tick -------------------------------------------------------------------------------------

    def sync(self) -> list[tuple[Client, bytes]]:
        """Take the values that clients have written, and answer one request of each client."""
        database = self._database
        # Values written in the previous tick are no longer news to the plugins (docs/protocols/rhd.md, Server tick).
        database.write.begin_round()
        written: list[tuple[Client | None, DataPackage]] = []
        for data in self._final_writes:
            self._write(None, data, written)
        self._final_writes.clear()
        taken, ready = [], []
        for client in self.clients:
            if client.request is None or not client.is_reading or client.failure is not None:
                continue
            # Answer one request of each client per tick; requests that were sent ahead are answered in the next tick
            # (Sync cycle).
            request, client.request = client.request, None
            taken.append(client)
            if request.data:
                # The kind of the request does not matter, because a writer may also send `rr`.
                if client.access == "w":
                    for data in request.data:
                        self._write(client, data, written)
                else:
                    self._refuse(client, sum(map(len, request.data)))
            if request.ready is not None:
                ready.append(client)
        self._spread_dirty()
        sole = self._sole_writer
        for author, data in written:
            for client in self.clients:
                # The only writer knows its own values (docs/protocols/rhd.md, Sync cycle).
                if not (client is author and client is sole):
                    client.dirty_write.add_many(data.ids, ordered=data.selection.is_ordered)
        replies = self._replies(ready, sole)
        for client in taken:
            # The client may have sent the next request ahead.
            if client.decoder.waiting:
                try:
                    self._take_request(client)
                except PacketError as error:
                    self._fail(client, str(error))
        return replies

    def _write(
        self, author: Client | None, data: DataPackage, written: list[tuple[Client | None, DataPackage]]
    ) -> None:
        self._database.write.receive(data)
        written.append((author, data))

    def _refuse(self, client: Client, count: int) -> None:
        if not client.refused_writes:
            _log.warning("%s: values rejected: the client may only read", client.name)
        client.refused_writes += count
        self.refused_writes += count

    def _spread_dirty(self) -> None:
        """Mark the variables that the robot has set as unsent for every client."""
        dirty = self._database.read.dirty.take()
        for client in self.clients:
            client.dirty_read.add_many(dirty, ordered=True)

    def _replies(self, ready: list[Client], sole: Client | None) -> list[tuple[Client, bytes]]:
        read, write = self._database.read, self._database.write
        packages = _Packages(self._width)
        ever_set = np.flatnonzero(read.updated) if self._resend == "original" else None
        replies = []
        for client in ready:
            # Values that others wrote before the client became the only writer stay pending until there are other
            # writers again.
            own = b"" if client is sole else packages.of(write, client.dirty_write.take())
            news = client.dirty_read.take()
            ids = news if ever_set is None else ever_set
            replies.append((client, own + packages.of(read, ids) + END))
        return replies


class _Packages:
    """Data packages of one tick. Each package is made only once, even if many clients receive it."""

    def __init__(self, width: int) -> None:
        self._width = width
        self._made: list[tuple[VariableTable, Ids, bytes]] = []

    def of(self, table: VariableTable, ids: Ids) -> bytes:
        for known, known_ids, data in self._made:
            if known is table and np.array_equal(known_ids, ids):
                return data
        data = table.encode(ids, self._width)
        self._made.append((table, ids, data))
        return data

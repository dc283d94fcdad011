"""A variable database served to many clients, sans-IO: which of them may write, and what each is sent.

`Server` brings the bytes of each connection and takes the replies away. A request is answered at the next `sync`, as by
the original: what it writes is seen by the plugins in the round that follows, and what they set then goes out with the
reply after it (docs/protocols/rhd.md, Server tick).
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

#: The read variables in a reply: those set since the client's last one, or, as in the original, all that
#: were ever set.
Resend = Literal["changed", "original"]

#: Bytes kept of a client that sends ahead of the replies.
AHEAD = 4096


class Client:
    """One client.

    Attributes:
        name: address and port, for messages.
        slot: number of its slot, None until access has been granted and after it has gone.
        access: "r" or "w" once it has been granted.
        request: what it asks for, until the next sync; None if nothing is complete.
        requests: how many requests it has completed.
        refused_writes: values that it sent without the right to.
        failure: why its connection is to be closed, or None.
        is_reading: whether it has taken all that was sent to it; until then it gets no more.
        dirty_read: the read variables that it has not been sent yet; there once access has been granted.
        dirty_write: likewise the write variables, set by others.
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
        """Whether a handshake or a request is begun and not complete."""
        return self.access is None or (self.request is None and self.decoder.waiting > 0)

    @property
    def is_asking(self) -> bool:
        """Whether it has a request that the next sync will take."""
        return self.request is not None and self.is_reading

    @property
    def may_send(self) -> bool:
        """Whether more of what it sends is to be read, with one request complete."""
        return self.request is None or self.decoder.waiting <= AHEAD


class Service:
    """Serves one database.

    Args:
        database: the variables; frozen from now on.
        clients: how many may be connected.
        allwriters: whether every client that asks for it may write, rather than the first only.
        resend: what of the read variables a reply holds.
        width: words of a time stamp, 2 or 4; that of all clients, since their requests do not show it.
        limits: what a client may ask for; by default no more than all write variables at once, and a little.

    Attributes:
        refused_writes: values sent by clients that may not write, and not taken.
        refused_clients: connections for which there was no slot.
        bad_clients: connections closed because of what they sent.

    Raises:
        BadValue: no such width, or no slots.
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
        # All variables once, and a kilobyte of empty packages: a longer batch is not needed, and not parsed.
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
        """The clients that have been granted access, by slot."""
        return [client for client in self._slots if client is not None]

    @property
    def slots(self) -> int:
        """How many clients may be connected."""
        return len(self._slots)

    @property
    def is_full(self) -> bool:
        """Whether every slot is taken."""
        return None not in self._slots

    @property
    def most_output(self) -> int:
        """Bytes that can wait for one client: a handshake. No batch is longer, and none is made before it has gone."""
        return len(self._database.encode_handshake("r", self._width))

    @property
    def writers(self) -> int:
        """How many of them may write: `isMasterAlive` of the original."""
        return sum(client.access == "w" for client in self.clients)

    @property
    def is_asked(self) -> bool:
        """Whether the sole writer asks for the next tick; or any client, while there is none."""
        sole = self._sole_writer
        if sole is not None:
            return sole.is_asking
        return any(client.is_asking for client in self.clients)

    @property
    def _sole_writer(self) -> Client | None:
        """The client that may write, if no other one may."""
        writers = [client for client in self.clients if client.access == "w"]
        return writers[0] if len(writers) == 1 else None

    # -- connections -----------------------------------------------------------------------------------

    def connect(self, name: str) -> Client | None:
        """A client has connected; None if there is no slot for it."""
        if self.is_full:
            self.refused_clients += 1
            return None
        return Client(name, ClientDecoder(self._database.write.layout, width=self._width, limits=self._limits))

    def receive(self, client: Client, data: bytes) -> bytes:
        """Bytes have come from a client; what is to be sent to it at once: the handshake, or nothing.

        Sets `failure` of the client where it is to be closed.
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
        """A client is gone. What it had written completely still counts: it may be the command to stop."""
        if client.slot is None:
            return
        # The slot is free at once; in the original it is at the next tick (docs/rhd-differences.md).
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
            client.failure = "all slots were taken meanwhile"
            return b""
        # A second writer becomes a reader and is sent that; the original leaves the answer out (docs/protocols/rhd.md,
        # Defects, 7).
        client.access = "w" if wanted == "w" and (self._allwriters or not self.writers) else "r"
        # What was set before now is news to the others only: this client gets all that with its handshake.
        self._spread_dirty()
        # The lowest free one, as in the original: replies of a round go out in the order of slots.
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
                # As the original does (docs/protocols/rhd.md, Access).
                self._fail(client, "asks as a writer without being one")

    def _fail(self, client: Client, reason: str) -> None:
        client.failure = reason
        self.bad_clients += 1

    # -- one round ------------------------------------------------------------------------------------

    def sync(self) -> list[tuple[Client, bytes]]:
        """Take what clients have written, and answer one request of each client."""
        database = self._database
        # What was written in the round before is news to the plugins no longer (docs/protocols/rhd.md, Server tick).
        database.write.begin_round()
        written: list[tuple[Client | None, DataPackage]] = []
        for data in self._final_writes:
            self._write(None, data, written)
        self._final_writes.clear()
        taken, ready = [], []
        for client in self.clients:
            if client.request is None or not client.is_reading or client.failure is not None:
                continue
            # One request of each client in a round: what it has sent ahead is taken in the next (Sync cycle).
            request, client.request = client.request, None
            taken.append(client)
            if request.data:
                # Whether it asks as a reader or as a writer does not matter: a writer may ask with `rr`.
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
                # The sole writer knows what it wrote (docs/protocols/rhd.md, Sync cycle).
                if not (client is author and client is sole):
                    client.dirty_write.add_many(data.ids, ordered=data.selection.is_ordered)
        replies = self._replies(ready, sole)
        for client in taken:
            # It may have sent ahead.
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
            _log.warning("%s may only read, and sends values: they are not taken", client.name)
        client.refused_writes += count
        self.refused_writes += count

    def _spread_dirty(self) -> None:
        """Variables that the robot has set are to be sent to every client."""
        dirty = self._database.read.dirty.take()
        for client in self.clients:
            client.dirty_read.add_many(dirty, ordered=True)

    def _replies(self, ready: list[Client], sole: Client | None) -> list[tuple[Client, bytes]]:
        read, write = self._database.read, self._database.write
        packages = _Packages(self._width)
        ever_set = np.flatnonzero(read.updated) if self._resend == "original" else None
        replies = []
        for client in ready:
            # What others had written before it became the sole writer waits until it is not the only one.
            own = b"" if client is sole else packages.of(write, client.dirty_write.take())
            news = client.dirty_read.take()
            ids = news if ever_set is None else ever_set
            replies.append((client, own + packages.of(read, ids) + END))
        return replies


class _Packages:
    """The data packages of one round, each made once, however many clients are sent it."""

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

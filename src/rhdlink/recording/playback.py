"""Playing a recording of a robot, batch by batch, into a database."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass

from linkcore.progress import Progress
from linkcore.recording.file import Kind, Record, Recording
from linkcore.stamp import Stamp

from ..variables.database import Database
from ..variables.snapshot import Change, Update
from ..wire.decoder import ServerDecoder
from .recorder import CHANNEL

__all__ = ["Moment", "play", "received"]


@dataclass(frozen=True)
class Moment:
    """A batch of a recording.

    Attributes:
        received: when it came.
        database: all that was known then; it changes with the next moment.
        width: words of a time stamp.
        connection: number of the connection, from 1.
        is_handshake: whether it is the first batch of its connection.
    """

    received: Stamp
    database: Database
    width: int
    connection: int
    is_handshake: bool

    def update(self, names: frozenset[str] | None = None) -> Update:
        """The variables whose time stamp or value has changed; of these, or of all."""
        changes: dict[str, Change] = {}
        # Of a read and a write variable with the same name the read variable stands.
        for table in (self.database.write, self.database.read):
            for identity in table.fresh.nonzero()[0].tolist():
                name = table.rows[identity].name
                if names is None or name in names:
                    changes[name] = Change(table.words(identity), table.stamp(identity), bool(table.changed[identity]))
        return Update(changes, self.received)


def received(recording: Recording, progress: Progress | None = None) -> Iterator[tuple[int, Record]]:
    """The bytes of a robot, as they were received: the number of the connection, from 1, and the record.

    Args:
        progress: called with the part that is read, 0 to 1.

    Raises:
        BadRecording: it holds no robot that runs RHD.
    """
    number, connection = recording.channel(CHANNEL), 1
    for record in recording.records(progress):
        if record.channel != number:
            continue
        if record.kind is Kind.BYTES:
            yield connection, record
        elif record.kind is Kind.EVENT and json.loads(record.payload)["state"] == "lost":
            connection += 1


def play(recording: Recording, progress: Progress | None = None) -> Iterator[Moment]:
    """Every batch, in order.

    Args:
        progress: called with the part that is read, 0 to 1.

    Raises:
        BadRecording: it holds no robot that runs RHD.
        PacketError: it holds bytes that are no batch.
    """
    decoder, database, current = ServerDecoder(), Database(), 1
    for connection, record in received(recording, progress):
        if connection != current:
            decoder, current = ServerDecoder(), connection
        decoder.feed(record.payload)
        if decoder.handshake is None:
            handshake = decoder.take_handshake()
            if handshake is None:
                continue
            database = Database(handshake.read, handshake.write)
            for data in handshake.data:
                database.table(data.direction).receive(data)
            yield Moment(record.stamp, database, handshake.width, connection, True)
        assert decoder.handshake is not None
        while (batch := decoder.take_batch()) is not None:
            database.read.begin_round()
            database.write.begin_round()
            for data in batch.data:
                database.table(data.direction).receive(data)
            yield Moment(record.stamp, database, decoder.handshake.width, connection, False)

"""What a recording of a robot tells, batch by batch: a database that lives through it again."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass

from linkcore.recording.file import Kind, Recording
from linkcore.stamp import Stamp

from .database import Database
from .tape import CHANNEL
from .update import Change, Update
from .wire import ServerStream

__all__ = ["Moment", "play"]


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
        """What came with another time stamp or value than before; of these variables, or of all."""
        changes: dict[str, Change] = {}
        # Of a read and a write variable with the same name the read variable stands.
        for table in (self.database.write, self.database.read):
            for identity in table.fresh.nonzero()[0].tolist():
                name = table.rows[identity].name
                if names is None or name in names:
                    words = table.value(identity).copy()
                    words.flags.writeable = False
                    changes[name] = Change(words, table.stamp(identity), bool(table.changed[identity]))
        return Update(changes, self.received)


def play(recording: Recording) -> Iterator[Moment]:
    """Every batch, in order.

    Raises:
        BadRecording: it holds no robot that runs RHD.
        PacketError: it holds bytes that are no batch.
    """
    number = recording.channel(CHANNEL)
    stream, database, connection = ServerStream(), Database(), 1
    for record in recording:
        if record.channel != number:
            continue
        if record.kind is Kind.EVENT and json.loads(record.payload)["state"] == "lost":
            stream, connection = ServerStream(), connection + 1
        if record.kind is not Kind.BYTES:
            continue
        stream.feed(record.payload)
        if stream.handshake is None:
            handshake = stream.take_handshake()
            if handshake is None:
                continue
            database = Database(handshake.read, handshake.write)
            for data in handshake.data:
                database.table(data.direction).receive(data)
            yield Moment(record.stamp, database, handshake.width, connection, True)
        assert stream.handshake is not None
        while (batch := stream.take_batch()) is not None:
            database.read.begin_round()
            database.write.begin_round()
            for data in batch.data:
                database.table(data.direction).receive(data)
            yield Moment(record.stamp, database, stream.handshake.width, connection, False)

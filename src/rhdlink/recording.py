"""Recording of connections in the format of linkcore.

The bytes are written when they arrive, and are replayed batch by batch.
"""

from __future__ import annotations

import json
import logging
import os
from collections.abc import Iterator
from dataclasses import dataclass

from linkcore.clock import Stamp
from linkcore.errors import BadRecording, Closed
from linkcore.recording.file import Kind, Progress, Record, RecordingFile, RecordingWriter
from linkcore.streaming.connection_life import Chunk, ConnectionEvent, ConnectionState

from .variables.database import Database, VariableTable, database_of
from .variables.snapshot import Update, changes_in
from .wire.decoder import ServerDecoder
from .wire.transport import Transport

_log = logging.getLogger(__name__)

#: Name of the channel that holds a robot's bytes.
CHANNEL = "rhd"


class RecordedTransport:
    """Transport that records the bytes which another transport receives.

    The file is created when the first connection is made, so that a failed attempt leaves no file. If the disk fails
    later, the connection continues, and `finish` raises the error.

    Args:
        transport: Transport that carries the bytes.
        path: Path of a file that does not exist yet.
    """

    def __init__(self, transport: Transport, path: str | os.PathLike[str]) -> None:
        self.name = transport.name
        self._transport = transport
        self._path = path
        self._writer: RecordingWriter | None = None
        self._channel = 0
        self._failure: BadRecording | None = None

    def open(self, timeout: float) -> None:
        """Connect.

        Raises:
            BadRecording: If the file already exists or cannot be created.
        """
        self._transport.open(timeout)
        if self._writer is None:
            self._writer = RecordingWriter(self._path)
            self._channel = self._writer.add_channel({"name": CHANNEL, "interface": "rhd", "address": self.name})
        else:
            self._note(ConnectionState.LOST)
        self._note(ConnectionState.CONNECTED)

    def receive(self, timeout: float | None = None) -> tuple[bytes, Stamp]:
        """Wait for bytes."""
        arrived = self._transport.receive(timeout)
        self._add(Chunk(*arrived))
        return arrived

    def receive_waiting(self) -> tuple[bytes, Stamp] | None:
        """Return bytes that have already arrived, or None. Does not wait."""
        arrived = self._transport.receive_waiting()
        if arrived is not None:
            self._add(Chunk(*arrived))
        return arrived

    def send(self, data: bytes, timeout: float) -> None:
        """Send all bytes."""
        self._transport.send(data, timeout)

    def abort(self) -> None:
        """Disconnect immediately. The file stays open for the next connection."""
        self._transport.abort()

    def close(self) -> None:
        """Disconnect. The file stays open for the next connection."""
        self._transport.close()

    def finish(self) -> None:
        """Close the file. Idempotent.

        Raises:
            BadRecording: If the disk failed. The file contains the bytes that arrived before the failure.
        """
        if self._writer is not None:
            self._writer.close()
        failure, self._failure = self._failure, None
        if failure is not None:
            raise failure

    def _note(self, state: ConnectionState) -> None:
        self._add(ConnectionEvent(state, self.name, None, Stamp.now()))

    def _add(self, item: Chunk | ConnectionEvent) -> None:
        if self._writer is None or self._failure is not None:
            return
        try:
            self._writer.add(self._channel, item)
        except Closed:
            pass  # the file was closed during the last sync
        except BadRecording as error:
            _log.error("%s; the connection continues without recording", error)
            self._failure = error


@dataclass(frozen=True)
class Moment:
    """One batch of a recording, and the values at its time.

    Attributes:
        received: Time at which the batch arrived.
        database: All values known at that time. The next moment changes this object.
        width: Number of 32-bit words of a time stamp.
        connection: Number of the connection, counted from 1.
        is_handshake: Whether the batch is the first of its connection.
    """

    received: Stamp
    database: Database
    width: int
    connection: int
    is_handshake: bool

    def update(self, names: frozenset[str] | None = None) -> Update:
        """Return the variables whose time stamp or value has changed; only `names`, unless it is None."""
        return Update(changes_in(self.database, names, VariableTable.words), self.received)


def received(recording: RecordingFile, progress: Progress | None = None) -> Iterator[tuple[int, Record]]:
    """Yield the recorded bytes of a robot: the number of the connection and the record.

    Connections are counted from 1.

    Args:
        recording: Recording to read.
        progress: Function that is called with the finished part, 0 to 1.

    Raises:
        BadRecording: If the recording contains no RHD robot.
    """
    number, connection = recording.channel(CHANNEL), 1
    for record in recording.records(progress):
        if record.channel != number:
            continue
        if record.kind is Kind.BYTES:
            yield connection, record
        elif record.kind is Kind.EVENT and json.loads(record.payload)["state"] == "lost":
            connection += 1


def play(recording: RecordingFile, progress: Progress | None = None) -> Iterator[Moment]:
    """Yield every batch of a recording, in order.

    Args:
        recording: Recording to read.
        progress: Function that is called with the finished part, 0 to 1.

    Raises:
        BadRecording: If the recording contains no RHD robot.
        PacketError: If the recording contains bytes that are not a batch.
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
            database = database_of(handshake)
            yield Moment(record.stamp, database, handshake.width, connection, True)
        assert decoder.handshake is not None
        while (batch := decoder.take_batch()) is not None:
            database.read.begin_round()
            database.write.begin_round()
            for data in batch.data:
                database.table(data.direction).receive(data)
            yield Moment(record.stamp, database, decoder.handshake.width, connection, False)

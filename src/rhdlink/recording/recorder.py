"""Connection recording: the bytes that a robot sends, written down as they come in linkcore's recording format."""

from __future__ import annotations

import json
import logging
import os

from linkcore.errors import BadRecording, Closed
from linkcore.recording.file import Kind, RecordingWriter
from linkcore.stamp import Stamp

from ..connection import Transport

__all__ = ["CHANNEL", "RecordedTransport"]

_log = logging.getLogger(__name__)

#: The name of the channel that holds a robot's bytes.
CHANNEL = "rhd"


class RecordedTransport:
    """A transport that writes down what another one receives.

    The file is made when the first connection stands, so that one that fails leaves none behind. Should the disk fail
    later, the connection goes on, and `finish` says so.

    Args:
        transport: what carries the bytes.
        path: a file that does not exist yet.
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
            BadRecording: the file exists, or cannot be made.
        """
        self._transport.open(timeout)
        if self._writer is None:
            self._writer = RecordingWriter(self._path)
            self._channel = self._writer.add_channel({"name": CHANNEL, "interface": "rhd", "address": self.name})
        else:
            self._note("lost")
        self._note("connected")

    def receive(self, timeout: float | None = None) -> tuple[bytes, Stamp]:
        """Wait for bytes."""
        data, stamp = self._transport.receive(timeout)
        self._write(Kind.BYTES, stamp, data)
        return data, stamp

    def receive_waiting(self) -> tuple[bytes, Stamp] | None:
        """Bytes that have come already."""
        arrived = self._transport.receive_waiting()
        if arrived is not None:
            self._write(Kind.BYTES, arrived[1], arrived[0])
        return arrived

    def send(self, data: bytes, timeout: float) -> None:
        """Send all of it."""
        self._transport.send(data, timeout)

    def abort(self) -> None:
        """Disconnect at once; the file stays open for the next connection."""
        self._transport.abort()

    def close(self) -> None:
        """Disconnect; the file stays open for the next connection."""
        self._transport.close()

    def finish(self) -> None:
        """Close the file; idempotent.

        Raises:
            BadRecording: the disk failed; the file holds what came before.
        """
        if self._writer is not None:
            self._writer.close(complete=self._failure is None)
        failure, self._failure = self._failure, None
        if failure is not None:
            raise failure

    def _note(self, state: str) -> None:
        self._write(Kind.EVENT, Stamp.now(), json.dumps({"state": state, "error": None}).encode())

    def _write(self, kind: Kind, stamp: Stamp, payload: bytes) -> None:
        if self._writer is None or self._failure is not None:
            return
        try:
            self._writer.write(kind, self._channel, stamp, payload)
        except Closed:
            pass  # while the last sync was under way
        except BadRecording as error:
            _log.error("%s; the connection goes on without it", error)
            self._failure = error

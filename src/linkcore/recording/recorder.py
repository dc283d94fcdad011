"""Recorder: a subscriber that writes received bytes and connection events to a file."""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Mapping
from typing import Any

from .. import clock
from ..errors import BadRecording, LinkTimeout
from ..names import StrictAttributes
from ..streaming.connection_life import Traffic
from ..streaming.packet_queue import block
from ..streaming.stream import Stream
from ..streaming.subscription import Subscription
from ..threads import Closing
from .file import RecordingWriter

#: Time in s for which bytes are collected before they are written. A killed program loses at most these bytes.
_GATHER = 0.02


class Recorder(StrictAttributes, Closing):
    """Recorder of streams into one file, from now until it is closed; a context manager.

    The reader of a stream only puts bytes into a queue, and the recorder writes the file in its own threads. Nothing is
    dropped: if 1024 chunks of bytes wait to be written, the stream waits for the disk. If the disk fails, the streams
    continue, and `close` raises an error.

    Args:
        path: Path of a file that does not exist yet.

    Raises:
        BadRecording: If the file exists, or cannot be created.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self._writer = self._open(path)
        self.path = self._writer.path
        self._subscriptions: list[Subscription] = []

    def _open(self, path: str | os.PathLike[str]) -> RecordingWriter:
        """Return the writer of the file. Recorders of other formats override this."""
        return RecordingWriter(path)

    def add(self, stream: Stream[Any], info: Mapping[str, Any]) -> Subscription:
        """Start to record a stream.

        Args:
            stream: Stream.
            info: Description of the stream for readers. It must be representable in JSON, and have at least "name".

        Raises:
            BadValue: If `info` has no name, or has a value that JSON cannot represent.
            BadRecording: If the file cannot be written.
            Closed: If the recorder or the stream was closed.
            RemoteError: If the stream cannot connect.
        """
        writer = self._writer
        channel = writer.add_channel(info)
        return self._subscribe(stream, Traffic, functools.partial(writer.add, channel), _GATHER)

    def _kind_of(self, stream: Stream[Any]) -> type:
        """Return the class of the states of a stream, for recorders that write states."""
        return stream._kind

    def _subscribe(
        self, stream: Stream[Any], kind: type, write: Callable[[Any], object], gather: float
    ) -> Subscription:
        """Subscribe `write` to all packets of a class; recorders of other formats use other classes."""
        subscription = stream._connection.subscribe(kind, write, policy=block, gather=gather, owner=stream)
        self._subscriptions.append(subscription)
        return subscription

    @property
    def failure(self) -> str | None:
        """Reason why the file could not be written; None if there was no error."""
        return self._writer.failure

    def close(self, timeout: float = 5.0) -> None:
        """Write all queued bytes, and close the file, within `timeout` seconds; idempotent.

        Raises:
            LinkTimeout: If the disk is too slow. The file then ends like the file of a program that has crashed.
            BadRecording: If the file could not be written. It contains the records before the error.
        """
        until = clock.now() + timeout
        subscriptions, self._subscriptions = self._subscriptions, []
        done = [subscription.finish(clock.left(until)) for subscription in subscriptions]
        self._writer.close(complete=all(done))
        if subscriptions and self._writer.failure is not None:
            raise BadRecording(self._writer.failure)
        if not all(done):
            raise LinkTimeout(f"{self.path}: could not write all data within {timeout:g} s; the end is missing")

    def __repr__(self) -> str:
        state = self.failure or f"{len(self._subscriptions)} streams"
        return f"<Recorder {self.path}: {state}>"

"""The recorder: a subscriber that writes bytes and connection events to a file."""

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

#: Seconds for which bytes are gathered before they are written: the most that a killed program loses.
_GATHER = 0.02


class Recorder(StrictAttributes, Closing):
    """Records streams into one file, from now until closed; a context manager.

    The reader only puts bytes into a queue; the recorder writes the file in its own threads. Nothing is
    dropped: if the disk is 1024 chunks behind, the stream waits for it. If the disk fails, the streams go
    on, and `close` raises.

    Args:
        path: a file that does not exist yet.

    Raises:
        BadRecording: the file exists, or cannot be made.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self._writer = self._open(path)
        self.path = self._writer.path
        self._subscriptions: list[Subscription] = []

    def _open(self, path: str | os.PathLike[str]) -> RecordingWriter:
        """The writer of the file; recorders of other formats return another."""
        return RecordingWriter(path)

    def add(self, stream: Stream[Any], info: Mapping[str, Any]) -> Subscription:
        """Record `stream` too; `info` describes it for readers: it can be written as JSON and has at least "name".

        Raises:
            BadValue: `info` has no name, or a value that JSON cannot hold.
            BadRecording: the file could not be written.
            Closed: the recorder, or the stream, was closed.
            RemoteError: the stream could not be opened.
        """
        writer = self._writer
        channel = writer.add_channel(info)
        return self._subscribe(stream, Traffic, functools.partial(writer.add, channel), _GATHER)

    def _kind_of(self, stream: Stream[Any]) -> type:
        """The class of the states of a stream, for recorders that write states."""
        return stream._kind

    def _subscribe(
        self, stream: Stream[Any], kind: type, write: Callable[[Any], object], gather: float
    ) -> Subscription:
        """Have `write` called with every packet of a class; recorders of other formats want another class."""
        subscription = stream._connection.subscribe(kind, write, policy=block, gather=gather, owner=stream)
        self._subscriptions.append(subscription)
        return subscription

    @property
    def failure(self) -> str | None:
        """Why the file could not be written; None if it could."""
        return self._writer.failure

    def close(self, timeout: float = 5.0) -> None:
        """Write what is still queued, and close the file, within `timeout` seconds; idempotent.

        Raises:
            LinkTimeout: the disk was too slow; the file is as after a crash.
            BadRecording: the file could not be written; it holds the records before that.
        """
        until = clock.now() + timeout
        subscriptions, self._subscriptions = self._subscriptions, []
        done = [subscription.finish(clock.left(until)) for subscription in subscriptions]
        self._writer.close(complete=all(done))
        if subscriptions and self._writer.failure is not None:
            raise BadRecording(self._writer.failure)
        if not all(done):
            raise LinkTimeout(f"{self.path}: not everything was written within {timeout:g} s")

    def __repr__(self) -> str:
        state = self.failure or f"{len(self._subscriptions)} streams"
        return f"<Recorder {self.path}: {state}>"

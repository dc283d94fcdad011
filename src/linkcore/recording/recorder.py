"""The recorder: a subscriber that writes bytes and connection events to a file."""

from __future__ import annotations

import functools
import os
import time
from collections.abc import Mapping
from typing import Any

from ..errors import BadRecording, LinkTimeout
from ..streaming.events import Traffic
from ..streaming.policy import block
from ..streaming.stream import Stream
from ..streaming.subscription import Subscription
from .file import RecordingWriter

__all__ = ["Recorder"]


#: Seconds for which bytes gather before they are written; what a killed program can lose at most.
_GATHER = 0.02


class Recorder:
    """Records streams into one file, from now until closed; a context manager.

    In the receive path it costs one hand-over to a queue; the file is written in its own threads.
    Nothing is lost: should the disk fall 1024 chunks behind, the stream waits for it. Should the disk
    fail, the streams go on, and `close` raises.

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
        """What writes the file; recorders of other formats have another."""
        return RecordingWriter(path)

    def add(self, stream: Stream[Any], info: Mapping[str, Any]) -> Subscription:
        """Record `stream` too; `info` says of it what a reader needs, and has at least "name".

        Raises:
            BadValue: `info` has no name, or holds what JSON cannot.
            BadRecording: the disk failed.
            Closed: the recorder, or the stream, was closed.
            RemoteError: the stream could not be opened.
        """
        writer = self._writer
        channel = writer.add_channel(info)
        write = functools.partial(writer.add, channel)
        subscription = stream._connection.subscribe(Traffic, write, policy=block, gather=_GATHER, owner=stream)
        self._subscriptions.append(subscription)
        return subscription

    @property
    def failure(self) -> str | None:
        """Why the disk took no more, or None while all is well."""
        return self._writer.failure

    def close(self, timeout: float = 5.0) -> None:
        """Write what still waits, and close the file, within `timeout` seconds; idempotent.

        Raises:
            LinkTimeout: the disk did not take it in time; the file is as after a crash.
            BadRecording: the disk failed; the file holds what came before.
        """
        until = time.monotonic() + timeout
        subscriptions, self._subscriptions = self._subscriptions, []
        done = [subscription.finish(max(until - time.monotonic(), 0.0)) for subscription in subscriptions]
        self._writer.close(complete=all(done))
        if subscriptions and self._writer.failure is not None:
            raise BadRecording(self._writer.failure)
        if not all(done):
            raise LinkTimeout(f"{self.path}: not everything was written within {timeout:g} s")

    def __repr__(self) -> str:
        state = self.failure or f"{len(self._subscriptions)} streams"
        return f"<Recorder {self.path}: {state}>"

    def __enter__(self) -> Recorder:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

"""Replay of a recording as a transport. Each chunk has an absolute time, so delays do not accumulate."""

from __future__ import annotations

import json
import math
import threading
from collections.abc import Iterator

from .. import clock
from ..clock import Stamp
from ..errors import BadValue, ConnectFailed, ConnectionLost, LinkTimeout
from ..net.transport import Finished
from ..threads import ReentrantEvent
from .file import Kind, Record, RecordingFile


class ReplayTimeline:
    """Timeline that all channels of a replay share. It starts when the first channel is opened.

    Args:
        recording: Recording to replay.
        rate: Speed relative to the recording; 2 is twice as fast, and 0 as fast as possible.

    Raises:
        BadValue: If `rate` is negative or not finite.
    """

    def __init__(self, recording: RecordingFile, rate: float = 1.0) -> None:
        if not 0 <= rate < float("inf"):
            raise BadValue(f"rate is {rate}; expected 0 (as fast as possible) or a positive number")
        self.rate = rate
        self._lock = threading.RLock()
        self._started: float | None = None
        first = next((record for record in recording if record.kind is Kind.BYTES), None)
        self._first = 0.0 if first is None else first.stamp.monotonic

    def start(self) -> None:
        """Start the time line if it has not started yet."""
        with self._lock:
            if self._started is None:
                self._started = clock.now()

    def delay(self, stamp: Stamp) -> float:
        """Return the seconds until bytes with this stamp are due; negative if they are late."""
        if self.rate == 0 or self._started is None:
            return 0.0
        return self._started + (stamp.monotonic - self._first) / self.rate - clock.now()


class ReplayTransport:
    """Transport that replays one channel of a recording.

    Chunks have their recorded sizes, and arrive at their recorded times. Their stamps have the recorded wall time, and
    the current monotonic time. Connections are lost and made again at the recorded times.
    """

    def __init__(self, recording: RecordingFile, channel: str, timeline: ReplayTimeline) -> None:
        number = recording.channel(channel)
        self.name = f"{recording.path.name} ({channel})"
        self.round_trip = math.inf
        self._timeline = timeline
        self._records: Iterator[Record] = (record for record in recording if record.channel == number)
        self._next: Record | None = None  # read, but not yet due
        self._was_open = False
        self._closed = ReentrantEvent()

    def open(self, timeout: float) -> None:
        """Start the replay; after a lost connection, wait for the recorded reconnection.

        Raises:
            Finished: If the recording has no reconnection.
            ConnectFailed: If the recorded attempt failed.
            LinkTimeout: If the recorded reconnection is not due within `timeout` seconds.
        """
        self._closed.clear()
        self._timeline.start()
        # The first connection is made at once, even if the recording of this channel began later than other channels.
        again, self._was_open = self._was_open, True
        while (record := self._peek()) is not None and record.kind is not Kind.BYTES:
            state, error = self._event(record)
            if state in ("connected", "lost"):
                if again and not self._wait(record.stamp, timeout):
                    raise LinkTimeout(f"{self.name}: no reconnection within {timeout:g} s in the recording")
                self._next = None
                if state == "lost":
                    raise ConnectFailed(f"{self.name}: connecting failed, as recorded: {error}")
                return
            self._next = None
        if record is None and again:
            raise Finished

    def receive(self, timeout: float | None = None) -> tuple[bytes, Stamp]:
        """Wait until the next chunk is due, and return it; `timeout` is ignored.

        Raises:
            Finished: If the recording has ended.
            ConnectionLost: If the recorded connection was lost, or this transport was closed.
        """
        while (record := self._peek()) is not None:
            state, error = self._event(record)
            if record.kind is Kind.BYTES or state == "lost":
                self._wait(record.stamp)
                if self._closed.is_set():
                    raise ConnectionLost(f"{self.name} was closed by this program")
            self._next = None
            if state == "lost":
                raise ConnectionLost(f"{self.name}: connection lost, as recorded: {error}")
            if record.kind is Kind.BYTES:
                return record.payload, Stamp(clock.now(), record.stamp.wall)
        raise Finished

    def _peek(self) -> Record | None:
        if self._next is None:
            self._next = next(self._records, None)
        return self._next

    @staticmethod
    def _event(record: Record) -> tuple[str | None, object]:
        if record.kind is not Kind.EVENT:
            return None, None
        event = json.loads(record.payload)
        return event["state"], event.get("error")

    def _wait(self, stamp: Stamp, most: float = float("inf")) -> bool:
        """Wait until bytes with this stamp are due.

        Return False if they are not due within `most` seconds.
        """
        delay = self._timeline.delay(stamp)
        if delay > 0:
            clock.wait(self._closed.wait, min(delay, most))
        return delay <= most

    def send(self, data: bytes, timeout: float) -> None:
        """Raise an error, because a recording has no peer.

        Raises:
            BadValue: If called.
        """
        raise BadValue(f"{self.name} is a recording; nothing can be sent to it")

    def send_some(self, data: bytes | memoryview) -> int:
        """Raise an error; see `send`."""
        raise BadValue(f"{self.name} is a recording; nothing can be sent to it")

    def wait_for_room(self, timeout: float) -> bool:
        """Return False, because nothing can be sent to a recording."""
        return False

    def abort(self) -> None:
        """Wake the threads that are waiting."""
        self._closed.set()

    def close(self) -> None:
        """Do the same as `abort`, because no sent bytes have to be delivered."""
        self.abort()

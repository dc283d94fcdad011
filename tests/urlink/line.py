"""A connection without thread, socket and clock: its subscribers are called by the test, and what is sent is kept."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

from linkcore.streaming.events import ConnectionState


class Subscriber:
    """What was subscribed, in place of a `Subscription`."""

    def __init__(self, kind: type, callback: Callable[[Any], object], among: list[Subscriber]) -> None:
        self.kind = kind
        self.callback = callback
        self._among = among
        among.append(self)

    def close(self, timeout: float = 0.0) -> None:
        self._among.remove(self)

    def __enter__(self) -> None:
        pass

    def __exit__(self, *exc: object) -> None:
        self.close()


class Line:
    """In place of a `Connection`.

    Args:
        waits: called instead of waiting for room, with the seconds that may be waited.
    """

    name = "line"

    def __init__(self, waits: Callable[[float], object] = lambda seconds: None) -> None:
        self.state = ConnectionState.CONNECTED
        self.counters = SimpleNamespace(connections=1)
        self.subscribers: list[Subscriber] = []
        #: seconds of silence, and who wants to be told of it
        self.watches: list[tuple[float, Callable[[float], object]]] = []
        self.silence = SimpleNamespace(limit=None, watch=self.watch)
        self.fan_out = SimpleNamespace(newest=lambda kind: None)
        self.sent: list[str] = []
        self.aborts = 0
        #: bytes that it takes; None for all
        self.room: int | None = None
        self._waits = waits

    def subscribe_inline(self, kind: type, callback: Callable[[Any], object]) -> Subscriber:
        return Subscriber(kind, callback, self.subscribers)

    def watch(self, seconds: float, hook: Callable[[float], object]) -> Callable[[], None]:
        watch = (seconds, hook)
        self.watches.append(watch)
        return lambda: self.watches.remove(watch)

    def reads_here(self) -> bool:
        """Every thread: nothing waits, since nothing could come."""
        return True

    def tell(self, packet: Any) -> None:
        for each in tuple(self.subscribers):
            if isinstance(packet, each.kind):
                each.callback(packet)

    def be_silent(self) -> None:
        """For as long as is watched for."""
        for seconds, hook in tuple(self.watches):
            hook(seconds)

    def send_some(self, data: memoryview) -> int:
        count = len(data) if self.room is None else min(self.room, len(data))
        if self.room is not None:
            self.room -= count
        if count:
            self.sent.append(bytes(data[:count]).decode())
        return count

    def wait_for_room(self, timeout: float) -> bool:
        self._waits(timeout)
        return self.room != 0

    def abort(self) -> None:
        self.aborts += 1

"""The bounded queue between the reader thread and one consumer.

The queue itself is `queue.SimpleQueue`, whose hand-over happens in C. What stands here is what it has
not: a bound, the choice of what happens at the bound, an end, and exact counts. Each counter has one
writer at a time, so that none needs a lock.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Sequence
from typing import Any

from .policy import Policy

__all__ = ["Inbox"]

#: Stands last in the queue of an inbox that gets no more.
_END = object()


class Inbox:
    """Packets waiting for one consumer.

    Args:
        policy: what to do when the consumer falls behind.
        wants: which packets it is for; None takes all.
        lost: told of each packet that is dropped.

    Attributes:
        received: packets offered and wanted.
        dropped: packets thrown away.
        evicts: drops the oldest when it is full, rather than making the reader wait.
        closed: nothing more will be taken.
    """

    def __init__(
        self,
        policy: Policy,
        wants: Callable[[Any], bool] | None = None,
        lost: Callable[[Any], None] | None = None,
    ) -> None:
        self.received = 0
        self.dropped = 0
        self.closed = False
        self._ended = False
        self._limit = policy.limit
        self.evicts = policy.evicts
        self._wants = wants
        self._lost = lost
        self._queue: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._put, self._size = self._queue.put, self._queue.qsize
        self._room = threading.Semaphore(0)
        self._blocked = False
        self._dropping = threading.Lock()

    @property
    def waiting(self) -> int:
        """Packets in the queue."""
        return max(self._size() - self._ended, 0)

    # -- the reader's side ---------------------------------------------------------------------

    def offer(self, items: Sequence[Any]) -> None:
        """Hand packets over; waits only under the policy `block`."""
        if self._wants is not None:
            items = list(filter(self._wants, items))
        if self._ended:
            return
        self.received += len(items)
        for item in items:
            if self._size() >= self._limit:
                self._make_room()
            self._put(item)
        if self.closed:
            self._drop_all()

    def put(self, item: Any) -> None:
        """Hand over one packet that is wanted: `offer` without the detours."""
        if self._size() >= self._limit or self._ended:
            self.offer((item,))
            return
        self.received += 1
        self._put(item)
        if self.closed:
            self._drop_all()

    def _make_room(self) -> None:
        if self.evicts:
            self._drop_one()
            return
        while self._size() >= self._limit and not self.closed:
            self._wait_for_room()

    def _wait_for_room(self) -> None:
        self._blocked = True
        # The timeout covers a consumer that made room just before this was set.
        self._room.acquire(timeout=0.05)
        self._blocked = False

    def end(self) -> None:
        """No more will come; what waits can still be taken. Idempotent."""
        with self._dropping:
            if not self._ended:
                self._ended = True
                self._put(_END)

    # -- the consumer's side -------------------------------------------------------------------

    def next(self, timeout: float | None = None) -> Any | None:
        """Wait for a packet and take it; None when time is up, or when no more will come.

        `is_over` tells which.
        """
        try:
            item = self._queue.get(True, timeout)
            while item is _END:
                behind = self._size()
                self._put(_END)  # whoever asks again is told again
                if not behind:
                    return None
                item = self._queue.get()  # the reader was in the middle of an offer when the end came
        except queue.Empty:
            return None
        if self._blocked and self._size() <= self._limit // 2:
            self._room.release()  # not for each packet: the two threads would take turns
        return item

    @property
    def is_over(self) -> bool:
        """No more will come, and nothing waits."""
        return self._ended and self.waiting == 0

    def close(self) -> None:
        """Drop what waits, take nothing more; idempotent."""
        self.closed = True
        self.end()
        self._drop_all()
        self._room.release()

    # ------------------------------------------------------------------------------------------

    def _drop_one(self) -> bool:
        try:
            item = self._queue.get_nowait()
        except queue.Empty:  # the consumer was quicker
            return False
        if item is _END:
            self._put(_END)
            return False
        self.dropped += 1
        if self._lost is not None:
            self._lost(item)
        return True

    def _drop_all(self) -> None:
        with self._dropping:  # the reader and whoever closes may both come here
            for _ in range(self._size()):
                # At most one of them is the end mark, which goes to the back.
                self._drop_one()

"""The bounded queue between the reader thread and one consumer.

Lock-free where it counts: `deque` operations are atomic, and each counter has one writer. The two
locks are used as binary semaphores, the cheapest way for one thread to wake another.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

from .policy import Policy

__all__ = ["Inbox"]


class Inbox:
    """Packets waiting for one consumer.

    Args:
        policy: what to do when the consumer falls behind.
        wants: which packets it is for; None takes all.
        lost: told of each packet that is dropped.
    """

    def __init__(
        self,
        policy: Policy,
        wants: Callable[[Any], bool] | None = None,
        lost: Callable[[Any], None] | None = None,
    ) -> None:
        self._limit = policy.limit
        self._evicts = policy.evicts
        self.received = 0
        self.dropped = 0
        #: No more will come: what waits can still be taken.
        self.ended = False
        #: Nothing more will be taken.
        self.closed: bool = False
        self._wants = wants
        self._lost = lost
        self._queue: deque[Any] = deque()
        self._filled = threading.Lock()
        self._filled.acquire()
        self._room = threading.Lock()
        self._room.acquire()
        self._blocked = False
        self._closing = threading.Lock()

    @property
    def waiting(self) -> int:
        """Packets in the queue."""
        return len(self._queue)

    # -- the reader's side ---------------------------------------------------------------------

    def offer(self, items: Sequence[Any]) -> None:
        """Hand packets over; waits only under the policy `block`."""
        if self._wants is not None:
            items = list(filter(self._wants, items))
            if not items:
                return
        if self.closed:
            return
        self.received += len(items)
        queue, limit = self._queue, self._limit
        if self._evicts:
            queue.extend(items)
            while len(queue) > limit:
                self._drop_one()
        else:
            for item in items:
                while len(queue) >= limit and not self.closed:
                    self._blocked = True
                    self._signal(self._filled)
                    # The timeout covers a consumer that took the last one just before we asked.
                    self._room.acquire(timeout=0.05)
                queue.append(item)
            self._blocked = False
        self._drop_if_closed()
        # Last of all: the consumer wants the interpreter now, and the reader is about to let go of it.
        self._signal(self._filled)

    def end(self) -> None:
        """No more will come."""
        self.ended = True
        self._signal(self._filled)

    # -- the consumer's side -------------------------------------------------------------------

    def wait(self, timeout: float | None = None) -> bool:
        """Wait until something may be there, or the inbox has ended; False when time is up."""
        if timeout is None:
            return self._filled.acquire()
        return self._filled.acquire(timeout=max(timeout, 0.0))

    def take(self) -> Any | None:
        """The oldest packet that waits, or None."""
        if not self._queue:
            return None
        try:
            item = self._queue.popleft()
        except IndexError:  # evicted this very moment
            return None
        if self._blocked and len(self._queue) <= self._limit // 2:
            self._signal(self._room)  # not for each one: the two threads would take turns
        return item

    def next(self, timeout: float | None = None) -> Any | None:
        """Wait for a packet and take it; None when time is up, or when no more will come."""
        until = None if timeout is None else time.monotonic() + timeout
        while True:
            item = self.take()
            if item is not None:
                return item
            if self.ended or self.closed:
                # The last ones may have come between the look and the end.
                return self.take()
            if not self.wait(None if until is None else until - time.monotonic()):
                return self.take()

    def close(self) -> None:
        """Drop what waits, take nothing more; idempotent."""
        self.closed = True
        self._drop_all()
        self._signal(self._filled)
        self._signal(self._room)

    # ------------------------------------------------------------------------------------------

    def _drop_one(self) -> None:
        try:
            item = self._queue.popleft()
        except IndexError:  # the consumer was quicker
            return
        self.dropped += 1
        if self._lost is not None:
            self._lost(item)

    def _drop_if_closed(self) -> None:
        if self.closed:
            self._drop_all()

    def _drop_all(self) -> None:
        with self._closing:  # the reader and whoever closes may both come here
            while self._queue:
                self._drop_one()

    @staticmethod
    def _signal(semaphore: threading.Lock) -> None:
        if semaphore.locked():
            # Two threads may signal at once: once is enough.
            with contextlib.suppress(RuntimeError):
                semaphore.release()

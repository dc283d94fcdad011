"""A callback with its own queue and its own thread, so that it can be slow or fail by itself."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterable
from typing import Any

from .inbox import Inbox
from .statistics import SubscriptionStatistics

__all__ = ["Subscription"]

_log = logging.getLogger(__name__)


class Subscription:
    """Delivers packets to a callback in a thread of its own, until closed.

    Made by `Stream.subscribe`; a context manager that closes itself.
    """

    def __init__(
        self,
        inbox: Inbox,
        callback: Callable[[Any], object],
        *,
        name: str,
        expand: Callable[[Any], Iterable[Any]] | None = None,
        deadline: float | None = None,
        on_deadline: Callable[[float], object] | None = None,
        linger: float = 0.0,
        detach: Callable[[Subscription], object],
    ) -> None:
        self.name = name
        self.inbox = inbox
        self._callback = callback
        self._expand = expand
        self._deadline = deadline
        self._on_deadline = on_deadline
        self._linger = linger
        self._detach = detach
        self._delivered = 0
        self._failed = 0
        self._missed = 0
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    @property
    def stats(self) -> SubscriptionStatistics:
        """The counters at this moment."""
        delivered, failed = self._delivered, self._failed
        dropped, received = self.inbox.dropped, self.inbox.received
        return SubscriptionStatistics(
            received=received,
            delivered=delivered,
            dropped=dropped,
            failed=failed,
            waiting=received - delivered - dropped - failed,
            missed_deadlines=self._missed,
        )

    def close(self, timeout: float = 1.0) -> None:
        """Stop delivering; what waits is dropped and counted. Idempotent, may be called from the callback.

        Waits up to `timeout` seconds for a callback that is running; the callback is left to end by
        itself after that.
        """
        self.inbox.close()
        self._detach(self)
        self.join(timeout)

    def finish(self, timeout: float = 5.0) -> bool:
        """Take no more, but deliver what waits; False when time is up before that is done."""
        self._detach(self)
        self.inbox.end()
        return self.join(timeout)

    def join(self, timeout: float | None) -> bool:
        """Wait until the subscription has ended and delivered everything; False when time is up."""
        if self._thread is not threading.current_thread():
            self._thread.join(None if timeout is None else max(timeout, 0.0))
        return not self._thread.is_alive()

    def runs_in(self, thread: threading.Thread) -> bool:
        """Whether its callback is called in this thread."""
        return thread is self._thread

    def __enter__(self) -> Subscription:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def _run(self) -> None:
        take, expand, callback, deadline = self.inbox.next, self._expand, self._callback, self._deadline
        since, timeout = time.monotonic(), 0.0 if self._linger else deadline
        while True:
            item = take(timeout)
            if item is None:
                if self.inbox.is_over:
                    return
                if self._linger:
                    # Nobody waits on the queue meanwhile, so nobody has to be woken by the reader.
                    time.sleep(self._linger)
                    continue
                # Told once for each silence: a flood of calls would tell no more.
                timeout = None
                self._miss(time.monotonic() - since)
                continue
            try:
                if expand is None:
                    callback(item)
                else:
                    for part in expand(item):
                        callback(part)
                self._delivered += 1
            except Exception:
                self._failed += 1
                self._complain(f"callback of {self.name} raised; its subscription goes on")
            if deadline is not None:
                since, timeout = time.monotonic(), deadline

    def _miss(self, age: float) -> None:
        self._missed += 1
        if self._on_deadline is None:
            _log.warning("%s: nothing came for %.3f s", self.name, age)
            return
        try:
            self._on_deadline(age)
        except Exception:
            self._complain(f"on_deadline of {self.name} raised")

    def _complain(self, text: str) -> None:
        # The first with its traceback, then each power of two: a failing callback at 500 Hz must not
        # fill the disk.
        count = self._failed
        if count & (count - 1) == 0:
            _log.exception("%s (%d so far)", text, count)

"""A callback with its own queue and its own thread, so that it can be slow or fail by itself."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from threading import get_ident
from typing import Any

from .packet_queue import Inbox
from .statistics import SubscriptionStatistics

__all__ = ["QUICK", "Subscription"]

_log = logging.getLogger(__name__)


#: Seconds that a call may last to count as quick.
QUICK = 0.5e-3
#: Calls in a row that have to be quick before the reader makes them itself.
_TRUST = 64
_MOST_TRUST = 1024


class Subscription:
    """Delivers packets to a callback, in order and one at a time, until closed.

    In a thread of its own; a callback that has proved quick is called by the stream's reader thread
    instead, see `linkcore.streaming.shortcut`.
    Made by `Stream.subscribe`; a context manager that closes itself.
    """

    def __init__(
        self,
        inbox: Inbox,
        callback: Callable[[Any], object],
        *,
        name: str,
        detach: Callable[[Subscription], object],
        trust: Callable[[Subscription], object] | None = None,
        expand: Callable[[Any], Iterable[Any]] | None = None,
        deadline: float | None = None,
        on_deadline: Callable[[float], object] | None = None,
        linger: float = 0.0,
    ) -> None:
        self.name = name
        self.inbox = inbox
        self._callback = callback
        self._detach = detach
        self._trust = trust
        self._expand = expand
        self._deadline = deadline
        self._on_deadline = on_deadline
        self._linger = linger
        self._delivered = 0
        self._failed = 0
        self._missed = 0
        self._last = time.monotonic()
        self._quick = 0
        self._needed = _TRUST
        # Whoever calls back holds the turn, so that there is never more than one call at a time.
        self._turn = threading.Lock()
        self._holder = 0
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
        until = None if timeout is None else time.monotonic() + max(timeout, 0.0)
        if self.runs_in(get_ident()):
            return not self._thread.is_alive()
        self._thread.join(timeout if timeout is None else max(timeout, 0.0))
        if self._thread.is_alive():
            return False
        # The reader may be in the callback.
        left = -1 if until is None else max(until - time.monotonic(), 0.0)
        if not self._turn.acquire(timeout=left):
            return False
        self._turn.release()
        return True

    def runs_in(self, thread: int) -> bool:
        """Whether its callback is called in the thread of this identity."""
        return thread in (self._thread.ident, self._holder)

    def __enter__(self) -> Subscription:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    # -- the reader's side ---------------------------------------------------------------------

    def deliver(self, packets: Sequence[Any]) -> bool:
        """Call back with each packet here and now; False where others have to come first."""
        if not self._turn.acquire(False):
            return False
        try:
            inbox = self.inbox
            # What the own thread has taken but not called back with yet comes first too.
            if inbox.received != self._delivered + self._failed + inbox.dropped or inbox.closed:
                return False
            self._holder = get_ident()
            inbox.received += len(packets)
            self._call(packets)
            self._holder = 0
            if self._deadline is not None:
                self._last = time.monotonic()
            return True
        finally:
            self._turn.release()

    def distrust(self) -> None:
        """It was slow: it has to prove itself anew, and for longer."""
        self._needed = min(self._needed * 4, _MOST_TRUST)

    # -- its own thread ------------------------------------------------------------------------

    def _run(self) -> None:
        take, deadline = self.inbox.next, self._deadline
        timeout = 0.0 if self._linger else deadline
        told = -1.0
        while True:
            packet = take(timeout)
            if packet is not None:
                began = time.monotonic()
                with self._turn:
                    self._call((packet,))
                self._last = time.monotonic()
                timeout = 0.0 if self._linger else deadline
                if self._trust is not None:
                    self._judge(self._trust, self._last - began)
            elif self.inbox.is_over:
                return
            elif self._linger:
                # Nobody waits on the queue meanwhile, so nobody has to be woken by the reader.
                time.sleep(self._linger)
            elif deadline is not None:
                last = self._last
                age = time.monotonic() - last
                # The reader may have called back in the meantime. Told once for each silence.
                timeout = deadline - age if age < deadline else deadline
                if age >= deadline and told != last:
                    told = last
                    self._miss(age)

    def _judge(self, trust: Callable[[Subscription], object], seconds: float) -> None:
        self._quick = self._quick + 1 if seconds < QUICK else 0
        if self._quick >= self._needed and self.inbox.waiting == 0:
            self._quick = 0
            trust(self)

    def _call(self, packets: Iterable[Any]) -> None:
        callback, expand = self._callback, self._expand
        for packet in packets:
            try:
                if expand is None:
                    callback(packet)
                else:
                    for part in expand(packet):
                        callback(part)
                self._delivered += 1
            except Exception:
                self._failed += 1
                self._complain(f"callback of {self.name} raised; its subscription goes on")

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

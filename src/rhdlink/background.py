"""A thread that keeps a robot in sync."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable

from linkcore.errors import BadValue, Closed, RemoteError
from linkcore.streaming.backoff import Backoff

__all__ = ["Background"]

_log = logging.getLogger(__name__)


class Background:
    """Syncs from a thread of its own until closed; a context manager that closes itself.

    Made by `Variables.background`.

    Attributes:
        syncs: how many there were.
        failures: how many failed.
        failure: what ended it, where it was not closed; None while it goes on.

    Raises:
        BadValue: a period that is no positive number.
    """

    def __init__(
        self, sync: Callable[[], object], period: float | None, backoff: Backoff | None = None, *, name: str
    ) -> None:
        if period is not None and not 0 < period < threading.TIMEOUT_MAX:
            raise BadValue(f"period is {period}; expected a positive number of seconds, or None for every tick")
        self.syncs = 0
        self.failures = 0
        self.failure: RemoteError | None = None
        self._sync = sync
        self._period = period
        self._backoff = backoff or Backoff()
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    @property
    def is_running(self) -> bool:
        """Whether it goes on."""
        return self._thread.is_alive()

    def close(self, timeout: float = 2.0) -> None:
        """Sync no more; waits up to `timeout` seconds for a sync that is under way. Idempotent."""
        self._closing.set()
        if self._thread is not threading.current_thread():
            self._thread.join(max(timeout, 0.0))

    def __enter__(self) -> Background:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def _run(self) -> None:
        waits = self._backoff.waits()
        due = time.monotonic()
        while not self._closing.is_set():
            try:
                self._sync()
            except Closed:
                return
            except RemoteError as error:
                if self._closing.is_set():
                    return
                self.failures += 1
                if self.failures & (self.failures - 1) == 0:  # each power of two: the disk must not fill
                    _log.warning("%s failed, %d so far: %s", self._thread.name, self.failures, error)
                wait = next(waits, None)
                if wait is None:
                    self.failure = error
                    return
                self._closing.wait(wait)
                due = time.monotonic()
                continue
            self.syncs += 1
            waits = self._backoff.waits()
            if self._period is not None:
                # On absolute deadlines; one that was missed is not made up for.
                due = max(due + self._period, time.monotonic())
                self._closing.wait(due - time.monotonic())

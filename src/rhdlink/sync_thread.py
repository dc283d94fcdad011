"""A thread that keeps a robot in sync."""

from __future__ import annotations

import logging
import threading
import time
import weakref
from collections.abc import Callable

from linkcore.arguments import check_seconds
from linkcore.errors import BadValue, Closed, RemoteError
from linkcore.streaming.backoff import Backoff
from linkcore.threads import started

__all__ = ["SyncThread"]

_log = logging.getLogger(__name__)


class SyncThread:
    """Syncs from a thread of its own until closed; a context manager that closes itself.

    Made by `Variables.background`. It does not keep the robot alive: when the program drops its last reference to the
    robot, it ends.

    Attributes:
        syncs: how many there were.
        failures: how many failed because of the robot or the network.
        failure: what ended it, where it was not closed: the last `RemoteError` when the back-off gave up, or whatever
            else `sync` raised; None while it goes on, and after `close`.

    Raises:
        BadValue: a period that is no positive number.
        LocalError: the system has no thread left.
    """

    def __init__(
        self, sync: Callable[[], object], period: float | None, backoff: Backoff | None = None, *, name: str
    ) -> None:
        if period is not None:
            period = check_seconds(period, "period", positive=True, finite=True)
        if backoff is not None and not isinstance(backoff, Backoff):
            raise BadValue(f"backoff={backoff!r}; expected rhdlink.Backoff(...)")
        self.syncs = 0
        self.failures = 0
        self.failure: BaseException | None = None
        self._sync = weakref.WeakMethod(sync)
        self._period = period
        self._backoff = backoff or Backoff()
        self._closing = threading.Event()
        # Known before it runs: it may fail, and say who it is, before `started` returns.
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        started(self._thread)

    @property
    def is_running(self) -> bool:
        """Whether it goes on."""
        return self.failure is None and self._thread.is_alive()

    def close(self, timeout: float = 2.0) -> None:
        """Sync no more; waits up to `timeout` seconds for a sync that is under way. Idempotent."""
        self._closing.set()
        if self._thread is not threading.current_thread():
            self._thread.join(max(timeout, 0.0))

    def __enter__(self) -> SyncThread:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def __repr__(self) -> str:
        state = "running" if self.is_running else "ended" if self.failure is None else f"ended by {self.failure!r}"
        return f"<{type(self).__name__} {self._thread.name}, {state}, {self.syncs} syncs, {self.failures} failed>"

    def _run(self) -> None:
        try:
            self._sync_until_closed()
        except BaseException as error:  # SystemExit too: nobody but this thread would ever know of it
            _log.exception("%s ended", self._thread.name)
            self.failure = error

    def _sync_until_closed(self) -> None:
        waits = self._backoff.waits()
        due = time.monotonic()
        while not self._closing.is_set():
            sync = self._sync()
            if sync is None:  # the program has dropped the robot
                return
            try:
                sync()
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
            else:
                wait = None
                self.syncs += 1
                waits = self._backoff.waits()  # after a success it begins with the shortest wait again
            finally:
                del sync  # or the robot would live as long as this thread waits
            if wait is not None:
                self._closing.wait(wait)
                due = time.monotonic()
            elif self._period is not None:
                # On absolute deadlines; one that was missed is not made up for.
                due = max(due + self._period, time.monotonic())
                self._closing.wait(due - time.monotonic())

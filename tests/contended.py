"""A lock that another thread holds first: what was read before the lock was taken is old by the time it is taken."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

__all__ = ["Contended", "Meeting", "beside"]


def beside(call: Callable[[], object], seconds: float = 0.2) -> threading.Thread:
    """Call in another thread, and wait up to `seconds` for its end, which a lock of the caller may delay."""
    thread = threading.Thread(target=call, daemon=True)
    thread.start()
    thread.join(seconds)
    return thread


class Contended:
    """A lock for which the first thread has to wait, and after which another one is at once at work.

    Args:
        lock: the lock itself.
        before: what another thread does under the lock, before the first thread gets it.
        after: what another thread does once the first thread has released it.
    """

    def __init__(
        self, lock: Any, before: Callable[[], object] | None = None, after: Callable[[], object] | None = None
    ) -> None:
        self._lock = lock
        self._before, self._after = before, after

    def acquire(self, blocking: bool = True, timeout: float = -1) -> bool:
        before, self._before = self._before, None
        if before is not None:
            before()
        return bool(self._lock.acquire(blocking, timeout))

    def release(self) -> None:
        self._lock.release()
        after, self._after = self._after, None
        if after is not None:
            after()

    def __enter__(self) -> bool:
        return self.acquire()

    def __exit__(self, *exc: object) -> None:
        self.release()

    def locked(self) -> bool:
        return bool(self._lock.locked())

    def _is_owned(self) -> bool:
        owned: Callable[[], bool] = getattr(self._lock, "_is_owned", self.locked)
        return owned()


class Meeting(tuple[Any, ...]):
    """A tuple: whoever goes through it first meets another thread that does `meanwhile`, unless a lock delays that."""

    meanwhile: Callable[[], object] | None = None
    _thread: threading.Thread | None = None

    def __iter__(self) -> Any:
        meanwhile, self.meanwhile = self.meanwhile, None
        if meanwhile is not None:
            self._thread = beside(meanwhile)
        return super().__iter__()

    def join(self) -> None:
        """Wait for the other thread."""
        assert self._thread is not None, "nobody went through it"
        self._thread.join()

"""Locks that another thread gets first, so that values read before acquiring the lock are outdated afterwards."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator
from typing import Any, Literal

import pytest

__all__ = ["Contended", "Meeting", "beside", "contended_lock"]


def beside(call: Callable[[], object], seconds: float = 0.2) -> threading.Thread:
    """Call a function in another thread, and wait up to `seconds`; a lock of the caller may delay its end."""
    thread = threading.Thread(target=call, daemon=True)
    thread.start()
    thread.join(seconds)
    return thread


class Contended:
    """Lock with actions of another thread immediately before and after it is held.

    Args:
        lock: Lock that is wrapped.
        before: Action of another thread under the lock, before the next acquisition.
        after: Action of another thread after the first release.
    """

    def __init__(
        self, lock: Any, before: Callable[[], object] | None = None, after: Callable[[], object] | None = None
    ) -> None:
        self._lock = lock
        self.before, self._after = before, after

    def acquire(self, blocking: bool = True, timeout: float = -1) -> bool:
        before, self.before = self.before, None
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


@contextlib.contextmanager
def contended_lock(
    kind: Literal["Lock", "RLock"] = "RLock", before: Callable[[], object] | None = None
) -> Iterator[Contended]:
    """Make the first lock that is created within the block a `Contended`, and provide it."""
    make = getattr(threading, kind)
    lock = Contended(make(), before)
    first = [lock]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(threading, kind, lambda: first.pop() if first else make())
        yield lock


class Meeting(tuple[Any, ...]):
    """Tuple whose first iteration makes another thread call `meanwhile`, unless a lock delays that call."""

    meanwhile: Callable[[], object] | None = None
    _thread: threading.Thread | None = None

    def __iter__(self) -> Any:
        meanwhile, self.meanwhile = self.meanwhile, None
        if meanwhile is not None:
            self._thread = beside(meanwhile)
        return super().__iter__()

    def join(self) -> None:
        """Wait for the other thread."""
        assert self._thread is not None, "the tuple was never iterated over"
        self._thread.join()

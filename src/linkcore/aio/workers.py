"""The threads in which calls that wait are made, for a program that itself never waits."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

from ..errors import Closed, LocalError

__all__ = ["Workers"]

T = TypeVar("T")


class Workers:
    """Threads of one robot. The first call starts one, which stays; another is started only while all are busy.

    Args:
        name: of the threads.
        most: so many at once. What moves the arm must not stand behind what waits for an input, so not 1 where calls
            may wait long; 1 has calls follow each other.
    """

    def __init__(self, name: str, most: int) -> None:
        self._name = name
        self._threads = ThreadPoolExecutor(most, thread_name_prefix=name)
        self.is_used = False
        self._is_closed = False

    def submit(self, call: Callable[[], T]) -> Future[T]:
        """Call in a thread.

        Raises:
            Closed: it was closed.
            LocalError: the system has no thread left.
        """
        if self._is_closed:
            raise Closed(f"{self._name} was closed")
        self.is_used = True
        try:
            return self._threads.submit(call)
        except RuntimeError as error:
            raise LocalError(f"no thread could be started: {error}") from error

    def close(self) -> None:
        """Make no more calls; the threads end with what they do. Does not wait. Idempotent."""
        self._is_closed = True
        self._threads.shutdown(wait=False, cancel_futures=True)

"""What runs once: in the thread that calls `run`, or in one of its own, from `start` to `close`."""

from __future__ import annotations

import logging
import os
import threading
from abc import ABC, abstractmethod
from typing import TYPE_CHECKING

from .errors import Closed, LinkTimeout, LocalError
from .threads import started

if TYPE_CHECKING:
    from typing_extensions import Self

__all__ = ["Runnable"]

_log = logging.getLogger(__name__)


class Runnable(ABC):
    """A server of one robot: begun, run and ended once. A context manager that starts and closes itself.

    Args:
        kind: what it is, in errors and as the name of its thread.
        close_timeout: s that `close` waits for its thread.
        holds: what keeps it where `close` has waited in vain.

    Attributes:
        failure: what ended it by itself; None while it goes on, and after `stop`.
    """

    failure: Exception | None

    def __init__(self, kind: str, close_timeout: float, holds: str) -> None:
        self.failure = None
        self._kind = kind
        self._close_timeout = close_timeout
        self._holds = holds
        self._thread: threading.Thread | None = None
        self._process = os.getpid()
        self._is_stopping = False
        self._is_used = False
        self._ended = threading.Event()

    # -- what it does ----------------------------------------------------------------------------------

    @abstractmethod
    def _begin(self) -> None:
        """Open everything; where that fails, `_give_up` is called, and the error raised."""

    @abstractmethod
    def _serve(self) -> None:
        """Go on until `_is_stopping`; then end in order. What ended it by itself is kept in `failure`."""

    @abstractmethod
    def _give_up(self) -> None:
        """Close what `_begin` has opened: it will not be served."""

    @abstractmethod
    def _wake(self) -> None:
        """Have `_serve` look whether it is to stop. May be called in a signal handler: takes no lock."""

    # -- life ------------------------------------------------------------------------------------------

    def _begin_once(self) -> None:
        if self._is_used:
            raise Closed(f"a {self._kind} runs once; make another")
        # Before anything that may fail: what has begun once may have left devices open, and is not begun again.
        self._is_used = True
        try:
            self._begin()
        except BaseException:
            self._abandon()
            raise

    def _abandon(self) -> None:
        try:
            self._give_up()
        finally:
            self._ended.set()

    def _serve_to_end(self) -> None:
        try:
            self._serve()
        finally:
            self._ended.set()

    def run(self) -> None:
        """Run in this thread until `stop`; then end in order.

        What a signal handler raises meanwhile, such as KeyboardInterrupt, ends it in order too, and is raised again.

        Raises:
            Closed: it has run already.
            LinkError: what kept it from beginning, or ended it by itself: see the class.
        """
        self._begin_once()
        self._serve_to_end()
        if self.failure is not None:
            raise self.failure

    def start(self) -> Self:
        """Run in a thread; its port is open when this returns.

        Raises:
            as `run`, for what goes wrong until then; later, `failure` says what did.
        """
        self._begin_once()
        self._thread = threading.Thread(target=self._in_thread, name=self._kind, daemon=True)
        try:
            started(self._thread)
        except LocalError:
            self._thread = None
            self._abandon()
            raise
        return self

    def _in_thread(self) -> None:
        # The exception that ended it is kept in `failure`. Raised here it would only be printed.
        try:
            self._serve_to_end()
        except BaseException:
            _log.exception("the %s has ended", self._kind)

    def stop(self) -> None:
        """Have it end after this round; from any thread, from its own callbacks and plugins, from a signal handler."""
        # A plain flag and a byte into a pipe: a lock could be held by the very code that a signal handler interrupts.
        self._is_stopping = True
        self._wake()

    def wait(self, timeout: float | None = None) -> bool:
        """Wait until it has ended; False when time is up.

        Raises:
            LinkError: what ended it by itself: see the class.
        """
        if not self._ended.wait(timeout):
            return False
        if self.failure is not None:
            raise self.failure
        return True

    def close(self) -> None:
        """Stop, and wait until all has ended in order; idempotent.

        In a process that was forked from the one which started it this does nothing: the robot is not that process's
        to stop.

        Raises:
            LinkTimeout: it does not end.
        """
        if os.getpid() != self._process:
            return
        self.stop()
        thread = self._thread
        if thread is not None and thread is not threading.current_thread():
            thread.join(self._close_timeout)
            if thread.is_alive():
                raise LinkTimeout(
                    f"the {self._kind} has not ended within {self._close_timeout:g} s: {self._holds} does not answer"
                )

    def __enter__(self) -> Self:
        return self.start()

    def __exit__(self, *exc: object) -> None:
        self.close()

"""The critical section of one robot: a decision made in it holds until its consequence has been executed.

Python calls signal handlers in the main thread between any two instructions, so also between two within the section.
A handler that stops the arm must get in: the lock is re-entrant. If the handler then waits for the stop to be done,
other threads have to enter too, or the event that it waits for could never be delivered: `waiting` releases the lock
meanwhile.

No other code of this package waits while it is in the section, so only a signal handler can release it.
The decision of the interrupted main thread may be out of date when it goes on. It then sends at most one text or one
set-point too many, and both are harmless: a text asks for permission before it moves the arm
(`urlink.script.wrapping`), and the program that reads set-points has been stopped by the handler.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator

from linkcore.errors import LocalError
from linkcore.process import free_in_child


class Section:
    """A lock around decisions: ``with section.lock: ...``.

    Args:
        reads_here: each returns whether the current thread is the reader of a stream, which must not wait.

    Attributes:
        lock: re-entrant. It is entered directly, and not through a method of this class: Ctrl-C between the acquisition
            in a method and the block of the ``with`` would leave it locked for ever.
    """

    def __init__(self, *reads_here: Callable[[], bool]) -> None:
        self.lock = threading.RLock()
        # Streams of the robot enter the section for each state. A child that is forked meanwhile gets an error for each
        # command, but only if it can enter too.
        free_in_child(self.lock)
        self._reads_here = reads_here

    @property
    def may_wait(self) -> bool:
        """The current thread can wait for what a robot says: it is not the one that has to receive it."""
        return not any(reads_here() for reads_here in self._reads_here)

    def check_waiting(self) -> None:
        """Refuse to wait where that would be in vain.

        Raises:
            LocalError: the current thread would wait for itself.
        """
        if not self.may_wait:
            raise LocalError(
                "this thread reads a stream of the robot (a callback that was subscribed with inline=True runs in it), "
                "so what is waited for could not be received; await it in asyncio, wait in another thread, or use "
                "add_done_callback"
            )

    @contextlib.contextmanager
    def waiting(self) -> Iterator[None]:
        """Let others in for as long as this thread waits.

        Raises:
            LocalError: the current thread would wait for itself.
        """
        self.check_waiting()
        depth = 0
        try:
            while True:
                self.lock.release()
                depth += 1
        except RuntimeError:  # not held by this thread, or not any more
            pass
        try:
            yield
        finally:
            for _ in range(depth):
                self.lock.acquire()

"""Critical section of a robot: a decision made in it remains valid until its consequence has been executed.

Python calls signal handlers in the main thread between any two instructions, even inside the section. A handler that
stops the arm must be able to enter, so the lock is re-entrant. If the handler then waits for the stop to finish, other
threads must be able to enter too. Otherwise the event that it waits for could never be delivered. `waiting` therefore
releases the lock during the wait.

No other code of this package waits inside the section, so only a signal handler can release the lock there. The
decision of the interrupted main thread might be outdated when it continues. It then sends at most one unwanted text or
set-point. Both are harmless: a text asks for permission before it moves the arm (`urlink.script.wrapping`), and the
program that reads set-points has already been stopped by the handler.
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
        reads_here: Functions that return whether the current thread is the reader of a stream, which must not wait.

    Attributes:
        lock: Re-entrant lock. Use it directly in a ``with`` statement, without a method of this class around it:
            Ctrl-C between the acquisition in a method and the block of the ``with`` would leave it locked forever.
    """

    def __init__(self, *reads_here: Callable[[], bool]) -> None:
        self.lock = threading.RLock()
        # Streams of the robot enter the section for each state. A child process that is forked meanwhile must be able
        # to enter too; otherwise its commands would wait forever instead of raising an error.
        free_in_child(self.lock)
        self._reads_here = reads_here

    @property
    def is_held(self) -> bool:
        """Whether a thread is in the section. It is known only in simulated time, and False otherwise."""
        locked: Callable[[], bool] | None = getattr(self.lock, "locked", None)
        return locked is not None and locked()

    @property
    def may_wait(self) -> bool:
        """Whether the current thread can wait for data of the robot, because another thread receives them."""
        return not any(reads_here() for reads_here in self._reads_here)

    def check_waiting(self) -> None:
        """Raise an error if waiting in this thread would never end.

        Raises:
            LocalError: If the current thread would wait for itself.
        """
        if not self.may_wait:
            raise LocalError(
                "cannot wait in this thread: it reads a stream of the robot (a callback that was subscribed with "
                "inline=True runs in it), so the awaited data could not be received; await it in asyncio, wait in "
                "another thread, or use add_done_callback"
            )

    @contextlib.contextmanager
    def waiting(self) -> Iterator[None]:
        """Release the lock while this thread waits, so that other threads can enter.

        Raises:
            LocalError: If the current thread would wait for itself.
        """
        self.check_waiting()
        depth = 0
        try:
            while True:
                self.lock.release()
                depth += 1
        except RuntimeError:  # this thread does not hold the lock, or no longer holds it
            pass
        try:
            yield
        finally:
            for _ in range(depth):
                self.lock.acquire()

"""A call that a thread makes for a task of an event loop, which may give it up at any moment.

A thread cannot be interrupted. So a call that was given up goes on to its own end or timeout, but sends nothing more:
`check_wanted` is asked where bytes leave this computer. What it has begun on a robot is cancelled.
"""

from __future__ import annotations

import threading
import weakref
from collections.abc import Callable
from typing import TYPE_CHECKING, TypeVar

from .errors import Cancelled

if TYPE_CHECKING:
    from .handle import Lifecycle

T = TypeVar("T")

_here = threading.local()


class PendingCall:
    """One call.

    Attributes:
        is_given_up: the task does not want it any more.
    """

    def __init__(self) -> None:
        self.is_given_up = False
        # Weakly: what nobody holds does not run. Appending is one step, for two threads too.
        self._lives: list[weakref.ref[Lifecycle]] = []

    def make(self, call: Callable[[], T]) -> T:
        """Make it, in this thread.

        Raises:
            Cancelled: it was given up, and would have sent something.
        """
        _here.call = self
        try:
            return call()
        finally:
            _here.call = None

    def has_begun(self, life: Lifecycle) -> None:
        """It is about to begin something on a robot.

        Raises:
            Cancelled: it was given up.
        """
        self._lives.append(weakref.ref(life))
        self.check()

    def check(self) -> None:
        """Raise where it was given up.

        Raises:
            Cancelled: it was.
        """
        if self.is_given_up:
            raise Cancelled("the task that awaited this call has given it up; nothing more is sent")

    def give_up(self, submit: Callable[[Callable[[], object]], object]) -> None:
        """Send nothing more, and cancel what it has begun. Returns at once; idempotent.

        Args:
            submit: has a thread cancel it: the robot is sent a stop, which may wait.
        """
        self.is_given_up = True
        for life in filter(None, (each() for each in tuple(self._lives))):
            if not life.is_over:
                submit(life.give_up)


def current_call() -> PendingCall | None:
    """The call that this thread makes for a task, if it does."""
    call: PendingCall | None = getattr(_here, "call", None)
    return call


def check_wanted() -> None:
    """Raise where this thread makes a call that was given up; called before anything is sent.

    Raises:
        Cancelled: it was given up.
    """
    call = current_call()
    if call is not None:
        call.check()


def regardless(call: Callable[[], T]) -> T:
    """Make a call that may send whatever happens: it has the robot stop, or carries out what was decided before."""
    pending, _here.call = current_call(), None
    try:
        return call()
    finally:
        _here.call = pending

"""A call that a thread makes for a task of an event loop, which may give it up at any moment.

Python cannot interrupt a thread from outside. So every wait of the library is entered with `interruptible`, which
wakes the wait when the call is cancelled; the call then ends with `Cancelled`. A cancelled call sends nothing more:
`check_wanted` is asked where bytes leave this computer. What it has begun on a robot is cancelled.
"""

from __future__ import annotations

import contextlib
import threading
import weakref
from collections.abc import Callable, Iterator
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
        self._undos: list[Callable[[], object]] = []
        self._wakes: list[Callable[[], object]] = []
        #: held while waits are woken, so that no wait is woken after it has ended
        self._waking = threading.RLock()

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

    def on_give_up(self, undo: Callable[[], object]) -> None:
        """Call `undo` if the call is cancelled, even after its function has returned: nobody received the result then.

        Args:
            undo: Called in a thread, or here if the call was cancelled before. Must be idempotent.
        """
        self._undos.append(undo)
        if self.is_given_up:
            undo()

    @contextlib.contextmanager
    def interruptible(self, wake: Callable[[], object]) -> Iterator[None]:
        """Around a wait: `wake` is called when the call is cancelled, and must end the wait without waiting itself.

        Raises:
            Cancelled: The call was cancelled, whatever else the wait ended with.
        """
        with self._waking:
            self._wakes.append(wake)
        try:
            self.check()
            yield
        finally:
            with self._waking:
                self._wakes.remove(wake)
            self.check()

    def check(self) -> None:
        """Raise where it was given up.

        Raises:
            Cancelled: it was.
        """
        if self.is_given_up:
            raise Cancelled("the task that awaited this call has given it up; nothing more is sent")

    def give_up(self, submit: Callable[[Callable[[], object]], object]) -> None:
        """Send nothing more, wake its waits, and cancel what it has begun. Returns at once; idempotent.

        Args:
            submit: has a thread cancel it: the robot is sent a stop, which may wait.
        """
        self.is_given_up = True
        with self._waking:
            for wake in self._wakes:
                wake()
        for life in filter(None, (each() for each in tuple(self._lives))):
            if not life.is_over:
                submit(life.give_up)
        for undo in tuple(self._undos):
            submit(undo)


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


def interruptible(wake: Callable[[], object]) -> contextlib.AbstractContextManager[None]:
    """Around a wait in any thread; see `PendingCall.interruptible`. Without effect outside the call of a task."""
    call = current_call()
    return contextlib.nullcontext() if call is None else call.interruptible(wake)


def regardless(call: Callable[[], T]) -> T:
    """Make a call that may send whatever happens: it has the robot stop, or carries out what was decided before."""
    pending, _here.call = current_call(), None
    try:
        return call()
    finally:
        _here.call = pending

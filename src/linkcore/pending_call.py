"""Calls that can start something on a robot, their order among the stops of that robot, and how they are abandoned.

Each call gets a number when it is entered (`Call`, `PendingCall`), and each stop of a robot gets a number too. What a
call wants to send is compared with the last stop where bytes leave this computer: a call that was entered before the
stop sends nothing after it. So a motion that is still being prepared, or that waits in a queue, does not begin after a
stop. A call that was entered later is not affected.

Python cannot interrupt a thread from outside. So each wait of the library that can take long is entered with
`interruptible`, which wakes the wait when the call is abandoned; the call then ends with `Cancelled`. An abandoned
call sends nothing more: `check_wanted` is asked where bytes leave this computer. What it has started is cancelled.
"""

from __future__ import annotations

import contextlib
import functools
import itertools
import threading
import weakref
from collections.abc import Callable, Iterator
from typing import Concatenate, ParamSpec, Protocol, TypeVar

from .errors import Cancelled, LinkTimeout

P = ParamSpec("P")
S = TypeVar("S")
T = TypeVar("T")

_here = threading.local()
_orders = itertools.count(1)


def next_order() -> int:
    """Number of a call or a stop: larger than each number before, in every thread and in signal handlers."""
    return next(_orders)


class Started(Protocol):
    """The life of something that a call has started on a robot; `linkcore.handle.Lifecycle` is one."""

    @property
    def is_over(self) -> bool:
        """Whether it has ended."""

    def give_up(self) -> bool:
        """Cancel it: nobody waits for it any more."""

    def cancel(self, why: str, *, brake: bool = False) -> bool:
        """Cancel it, and stop the arm at once if `brake`."""


class _Lives:
    """The lives of what one call has started, which it does not keep alive: an abandoned handle may be collected."""

    def __init__(self) -> None:
        # Appending is one step, for two threads too.
        self._lives: list[weakref.ref[Started]] = []

    def add(self, life: Started) -> None:
        self._lives.append(weakref.ref(life))

    def live(self) -> list[Started]:
        """Those that have not ended."""
        return [life for life in (each() for each in tuple(self._lives)) if life is not None and not life.is_over]


class PendingCall:
    """A call that one thread makes for another party: a task of an event loop, or a client of a server.

    Make this object when the call is requested, not when a thread gets to it: the call counts as entered then. The
    party may abandon the call at any moment, before and while it is made.

    Args:
        is_ordered: whether everything in it counts as entered now. False for a function of the user that gives several
            commands: each of them is entered when it is given.

    Attributes:
        order: number of this call; None if not `is_ordered`.
        is_given_up: whether the call was abandoned.
        has_stopped: see `stopped_here`.
    """

    def __init__(self, *, is_ordered: bool = True) -> None:
        self.order: int | None = next_order() if is_ordered else None
        self.is_given_up = False
        self.has_stopped = False
        self._started = _Lives()
        self._undos: list[Callable[[], object]] = []
        self._wakes: list[Callable[[], object]] = []
        #: held while waits are woken, so that no wait is woken after it has ended
        self._waking = threading.RLock()

    def make(self, call: Callable[[], T]) -> T:
        """Make the call in this thread.

        Raises:
            Cancelled: If it was abandoned and would have sent something, or if the robot was stopped meanwhile.
        """
        outer, _here.call = current_call(), self
        try:
            return call()
        finally:
            _here.call = outer

    def has_begun(self, life: Started) -> None:
        """Record something that it is about to start on a robot.

        Raises:
            Cancelled: If it was abandoned.
        """
        self._started.add(life)
        self.check()

    def on_give_up(self, undo: Callable[[], object]) -> None:
        """Call `undo` if the call is abandoned, even after its function has returned: nobody received the result then.

        Args:
            undo: Called in a thread, or here if the call was abandoned before. Must be idempotent.
        """
        self._undos.append(undo)
        if self.is_given_up:
            regardless(undo)

    @contextlib.contextmanager
    def interruptible(self, wake: Callable[[], object]) -> Iterator[None]:
        """Around a wait: `wake` is called when the call is abandoned, and must end the wait without waiting itself.

        Raises:
            Cancelled: If the call was abandoned, whatever else the wait ended with.
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
        """Raise `Cancelled` if it was abandoned."""
        if self.is_given_up:
            raise Cancelled("the task that awaited this call was cancelled; nothing more is sent")

    def give_up(self, submit: Callable[[Callable[[], object]], object] = lambda call: call()) -> None:
        """Send nothing more, wake its waits, and cancel what it has started; the robot brakes. Idempotent.

        From any thread.

        Args:
            submit: Runs a function, which sends the robot a stop and may wait for that; by default in this thread.
        """
        self.is_given_up = True
        with self._waking:
            for wake in self._wakes:
                wake()
        for life in self._started.live():
            submit(life.give_up)
        for undo in tuple(self._undos):
            submit(undo)


class Call:
    """One call of a public method that can start a motion, from its entry to its return; see `starts_motion`.

    Args:
        outer: The call in which this one is entered, or None. This one counts as entered with it.

    Attributes:
        order: number of this call.
        has_started: whether it only waits for the end of what it has started. If that wait times out, nothing is
            cancelled.
        outer: as given.
    """

    def __init__(self, outer: PendingCall | Call | None) -> None:
        entered_before = None if outer is None or outer.has_stopped else outer.order
        self.order: int = next_order() if entered_before is None else entered_before
        self.has_started = False
        self.has_stopped: bool = False
        self.outer = outer
        self._task: PendingCall | None = outer._task if isinstance(outer, Call) else outer
        self._started = _Lives()

    @property
    def is_given_up(self) -> bool:
        """Whether the pending call that it is made for was abandoned."""
        return self._task is not None and self._task.is_given_up

    def has_begun(self, life: Started) -> None:
        """See `PendingCall.has_begun`."""
        self._started.add(life)
        if self._task is not None:
            self._task.has_begun(life)

    def check(self) -> None:
        """See `PendingCall.check`."""
        if self._task is not None:
            self._task.check()

    def abandon(self, error: BaseException) -> None:
        """Cancel what it has started, since it does not return a handle; the robot brakes."""
        if self.has_started and isinstance(error, LinkTimeout):
            return  # the wait for it has timed out
        what = "could not return its handle" if isinstance(error, Exception) else "was interrupted"
        for life in self._started.live():
            life.cancel(f"cancelled: the call that started it {what} ({type(error).__name__})", brake=True)


def starts_motion(method: Callable[Concatenate[S, P], T]) -> Callable[Concatenate[S, P], T]:
    """Decorate a public method that can start a motion.

    The call is ordered among the stops of the robot from its entry on. If it raises before it has handed over what it
    started (an exception, or Ctrl-C at any point), that is cancelled and the robot brakes: nobody has its handle.
    """

    @functools.wraps(method)
    def call(self: S, /, *args: P.args, **kwargs: P.kwargs) -> T:
        outer = current_call()
        mine = Call(outer)
        try:
            _here.call = mine
            return method(self, *args, **kwargs)
        except BaseException as error:
            mine.abandon(error)
            raise
        finally:
            _here.call = outer

    return call


def current_call() -> PendingCall | Call | None:
    """The call that this thread is in, or None."""
    call: PendingCall | Call | None = getattr(_here, "call", None)
    return call


def stopped_here() -> int:
    """Number of a stop that this thread makes now.

    A signal handler may stop the robot in the middle of a call, and then start another motion. That one is entered
    after the stop, although it is entered within the interrupted call.
    """
    call = current_call()
    while call is not None:
        call.has_stopped = True
        call = call.outer if isinstance(call, Call) else None
    return next_order()


def has_started() -> None:
    """The call of this thread has started what it is for, and can only wait now."""
    call = current_call()
    if isinstance(call, Call):
        call.has_started = True


def check_wanted() -> None:
    """Raise if this thread makes a call that was abandoned; called before anything is sent.

    Raises:
        Cancelled: If it was.
    """
    call = current_call()
    if call is not None:
        call.check()


def pending_call() -> PendingCall | None:
    """The pending call that this thread makes, or None."""
    call = current_call()
    return call._task if isinstance(call, Call) else call


def interruptible(wake: Callable[[], object]) -> contextlib.AbstractContextManager[None]:
    """Around a wait; see `PendingCall.interruptible`. No effect unless this thread makes a pending call."""
    call = pending_call()
    return contextlib.nullcontext() if call is None else call.interruptible(wake)


def on_give_up(undo: Callable[[], object]) -> None:
    """See `PendingCall.on_give_up`. No effect unless this thread makes a pending call."""
    call = pending_call()
    if call is not None:
        call.on_give_up(undo)


def regardless(call: Callable[[], T]) -> T:
    """Make a call that may send whatever happens: it stops the robot, or executes what was decided before."""
    outer, _here.call = current_call(), None
    try:
        return call()
    finally:
        _here.call = outer

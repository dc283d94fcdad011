"""Calls that can start a motion or program on a robot: their order relative to stops, and how to abandon a call.

Each call gets a number when it is entered (`Call`, `PendingCall`), and each stop of a robot gets a number too. Before
bytes leave this computer, the number of the call is compared with the number of the last stop. A call that was entered
before a stop sends nothing after this stop. So a motion that is still being prepared, or that waits in a queue, does
not start after the stop. A call that was entered later is not affected.

In Python, a thread cannot be interrupted by another thread. So each long wait of the library is surrounded by
`interruptible`. When the call is abandoned, `interruptible` ends the wait, and the call raises `Cancelled`. An
abandoned call sends nothing more, because `check_wanted` is called before bytes leave this computer. The motions and
programs that it has started are cancelled.
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
    """Return the next number for a call or a stop.

    The number is larger than every earlier number in any thread.
    """
    return next(_orders)


class Started(Protocol):
    """Protocol of a motion, program or mission that a call has started, such as `linkcore.handle.Lifecycle`."""

    @property
    def is_over(self) -> bool:
        """Whether the motion, program or mission has ended."""

    def give_up(self) -> bool:
        """Cancel the motion, program or mission, because the awaiting task was cancelled."""

    def cancel(self, why: str, *, brake: bool = False) -> bool:
        """Cancel the motion, program or mission; with `brake`, stop the arm at once."""


class _Lives:
    """Motions, programs and missions that one call has started.

    The references are weak, so an abandoned handle may be collected.
    """

    def __init__(self) -> None:
        # Appending to a list is one step, even if two threads do it.
        self._lives: list[weakref.ref[Started]] = []

    def add(self, life: Started) -> None:
        self._lives.append(weakref.ref(life))

    def live(self) -> list[Started]:
        """Return the lives that have not ended."""
        return [life for life in (each() for each in tuple(self._lives)) if life is not None and not life.is_over]


class PendingCall:
    """Call that one thread makes for another party, such as a task of an event loop or a client of a server.

    Create this object when the call is requested, not when a thread begins to make it, because the call counts as
    entered when the object is created. The party may abandon the call at any moment, before or during the call.

    Args:
        is_ordered: Whether everything in the call counts as entered now. Pass False for a function of the user that
            gives several commands, because each command is entered when it is given.

    Attributes:
        order: Number of this call; None if not `is_ordered`.
        is_given_up: Whether the call was abandoned.
        has_stopped: Whether this thread has stopped the robot during the call. See `stopped_here`.
    """

    def __init__(self, *, is_ordered: bool = True) -> None:
        self.order: int | None = next_order() if is_ordered else None
        self.is_given_up = False
        self.has_stopped = False
        self._started = _Lives()
        self._undos: list[Callable[[], object]] = []
        self._wakes: list[Callable[[], object]] = []
        #: Lock that is held while waits are woken, so that no wait is woken after it has ended.
        self._waking = threading.RLock()

    def make(self, call: Callable[[], T]) -> T:
        """Make the call in this thread.

        Raises:
            Cancelled: If the call was abandoned before it could send anything, or if the robot was stopped in the
                meantime.
        """
        outer, _here.call = current_call(), self
        try:
            return call()
        finally:
            _here.call = outer

    def has_begun(self, life: Started) -> None:
        """Record a motion or program that the call is about to start on a robot.

        Raises:
            Cancelled: If it was abandoned.
        """
        self._started.add(life)
        self.check()

    def on_give_up(self, undo: Callable[[], object]) -> None:
        """Call `undo` if the call is abandoned, even if its function has returned.

        In this case the result of the call is lost.

        Args:
            undo: Idempotent function that undoes the call. It is called in a thread, or in this thread if the call was
                already abandoned.
        """
        self._undos.append(undo)
        if self.is_given_up:
            regardless(undo)

    @contextlib.contextmanager
    def interruptible(self, wake: Callable[[], object]) -> Iterator[None]:
        """Context for a wait: if the call is abandoned, `wake` is called to end the wait.

        `wake` itself must not wait.

        Raises:
            Cancelled: If the call was abandoned, even if the wait ended with another error or with a result.
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
        """Raise `Cancelled` if the call was abandoned."""
        if self.is_given_up:
            raise Cancelled("the task that awaited this call was cancelled; nothing more is sent")

    def give_up(self, submit: Callable[[Callable[[], object]], object] = lambda call: call()) -> None:
        """Abandon the call, so that it sends nothing more, its waits end, and its motions are cancelled. Idempotent.

        Everything that the call has started is cancelled, and the robot brakes. Any thread may call this.

        Args:
            submit: Function that runs a given function, which sends a stop to the robot and may wait for the result.
                By default it runs in this thread.
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
    """Call of a public method that can start a motion, from its entry to its return.

    See `starts_motion`.

    Args:
        outer: Call that is being made when this call is entered, or None. If given, both count as entered together.

    Attributes:
        order: Number of this call.
        has_started: Whether the call has started its motion or program, and is only waiting for the end. If this wait
            times out, nothing is cancelled.
        outer: Outer call, or None.
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
        """Whether the pending call to which this call belongs was abandoned."""
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
        """Cancel everything that the call has started, because the call does not return a handle.

        The robot brakes.
        """
        if self.has_started and isinstance(error, LinkTimeout):
            return  # the wait for it has timed out
        what = "could not return its handle" if isinstance(error, Exception) else "was interrupted"
        for life in self._started.live():
            life.cancel(f"cancelled: the call that started it {what} ({type(error).__name__})", brake=True)


def starts_motion(method: Callable[Concatenate[S, P], T]) -> Callable[Concatenate[S, P], T]:
    """Decorate a public method that can start a motion.

    The moment of its entry determines whether the call was made before or after a stop of the robot. If the call raises
    before it returns a handle, because of an error or Ctrl-C, everything that it has started is cancelled. The robot
    then brakes, because the program has no handle with which it could stop the motion.
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
    """Return the call that this thread is making, or None."""
    call: PendingCall | Call | None = getattr(_here, "call", None)
    return call


def stopped_here() -> int:
    """Return the number of the stop that this thread is making now.

    A signal handler may stop the robot in the middle of a call, and then start another motion. This motion counts as
    entered after the stop, although it is entered within the interrupted call.
    """
    call = current_call()
    while call is not None:
        call.has_stopped = True
        call = call.outer if isinstance(call, Call) else None
    return next_order()


def has_started() -> None:
    """Record that the call of this thread has started its motion or program, and that it only waits from now on."""
    call = current_call()
    if isinstance(call, Call):
        call.has_started = True


def check_wanted() -> None:
    """Raise if this thread is making a call that was abandoned.

    Call this function before anything is sent.

    Raises:
        Cancelled: If the call was abandoned.
    """
    call = current_call()
    if call is not None:
        call.check()


def pending_call() -> PendingCall | None:
    """Return the pending call that this thread is making, or None."""
    call = current_call()
    return call._task if isinstance(call, Call) else call


def interruptible(wake: Callable[[], object]) -> contextlib.AbstractContextManager[None]:
    """Surround a wait; see `PendingCall.interruptible`.

    No effect unless this thread is making a pending call.
    """
    call = pending_call()
    return contextlib.nullcontext() if call is None else call.interruptible(wake)


def on_give_up(undo: Callable[[], object]) -> None:
    """Call `undo` if the pending call of this thread is abandoned; see `PendingCall.on_give_up`.

    It has no effect unless this thread is making a pending call.
    """
    call = pending_call()
    if call is not None:
        call.on_give_up(undo)


def regardless(call: Callable[[], T]) -> T:
    """Make a call that may send data even if the current call was abandoned.

    Use this function for calls that stop the robot, or that complete an earlier decision.
    """
    outer, _here.call = current_call(), None
    try:
        return call()
    finally:
        _here.call = outer

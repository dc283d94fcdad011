"""What something that runs on a robot is held by, and the one state machine of its life.

========== ========= ============ ===================================
event      in SENT   in RUNNING   in DONE, CANCELLED, FAILED
========== ========= ============ ===================================
BEGIN      RUNNING   -            -
FINISH     DONE      DONE         -
CANCEL     CANCELLED CANCELLED    -
FAIL       FAILED    FAILED       -
========== ========= ============ ===================================

A dash is no transition: there is no way back, and what ends it first is what it ends with.

`Lifecycle` is the library's side of it, `Handle` what users hold. Both work without a lock: what has ended a life is
put into a dictionary with `setdefault`, which is one step for threads and for signal handlers alike.
"""

from __future__ import annotations

import enum
from collections import deque
from collections.abc import Callable, Generator, Mapping
from concurrent.futures import Future
from concurrent.futures import TimeoutError as FutureTimeout
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar

from .arguments import check_callable, check_seconds
from .callbacks import CallbackThread
from .errors import Cancelled, LinkTimeout

if TYPE_CHECKING:
    from typing_extensions import Self

__all__ = ["TRANSITIONS", "Event", "Handle", "Lifecycle", "Phase"]


class Phase(enum.Enum):
    """How far something has got that was begun on a robot."""

    SENT = "sent"
    RUNNING = "running"
    DONE = "done"
    CANCELLED = "cancelled"
    FAILED = "failed"


class Event(enum.Enum):
    """What can happen to it."""

    BEGIN = "begin"
    FINISH = "finish"
    CANCEL = "cancel"
    FAIL = "fail"


#: (phase, event) -> the phase after it; nothing happens where there is none.
TRANSITIONS: Mapping[tuple[Phase, Event], Phase] = MappingProxyType(
    {
        (Phase.SENT, Event.BEGIN): Phase.RUNNING,
        **{
            (phase, event): after
            for phase in (Phase.SENT, Phase.RUNNING)
            for event, after in (
                (Event.FINISH, Phase.DONE),
                (Event.CANCEL, Phase.CANCELLED),
                (Event.FAIL, Phase.FAILED),
            )
        },
    }
)

#: Key of what has ended a life.
_END = "end"


class Lifecycle:
    """What becomes of one thing that runs on a robot.

    Args:
        name: for messages.
        callbacks: where users are called back.

    Attributes:
        brake: tells the robot to stop it. Called where it ends before its time and the robot has to be stopped.
    """

    def __init__(self, name: str, callbacks: CallbackThread) -> None:
        self.name = name
        self.brake: Callable[[], object] = lambda: None
        self._callbacks = callbacks
        self._is_running = False
        self._end: dict[str, tuple[Phase, Exception | None]] = {}
        self._future: Future[None] = Future()
        # So that nobody who awaits it can cancel the future instead of the motion.
        self._future.set_running_or_notify_cancel()
        self._done_callbacks: deque[Callable[[], object]] = deque()

    @property
    def phase(self) -> Phase:
        """How far it has got."""
        end = self._end.get(_END)
        if end is not None:
            return end[0]
        return Phase.RUNNING if self._is_running else Phase.SENT

    @property
    def is_over(self) -> bool:
        """It has ended, whichever way."""
        return _END in self._end

    @property
    def error(self) -> Exception | None:
        """What ended it before its time."""
        end = self._end.get(_END)
        return None if end is None else end[1]

    # -- what happens --------------------------------------------------------------------------------

    def begin(self) -> bool:
        """The robot has begun it. As all of these: False where the table has no such transition."""
        return self._apply(Event.BEGIN)

    def finish(self) -> bool:
        """It has come to its own end."""
        return self._apply(Event.FINISH)

    def cancel(self, why: str, *, brake: bool = False) -> bool:
        """It was given up here; with `brake` the robot is stopped."""
        return self._apply(Event.CANCEL, Cancelled(f"{self.name} was {why}"), brake)

    def fail(self, error: Exception, *, brake: bool = False) -> bool:
        """It cannot go on; with `brake` the robot is stopped."""
        return self._apply(Event.FAIL, error, brake)

    def _apply(self, event: Event, error: Exception | None = None, brake: bool = False) -> bool:
        after = TRANSITIONS.get((self.phase, event))
        if after is None:
            return False
        if after is Phase.RUNNING:
            self._is_running = True
            return True
        mine = (after, error)
        if self._end.setdefault(_END, mine) is not mine:
            return False
        try:
            if brake:
                self.brake()
        finally:
            if error is None:
                self._future.set_result(None)
            else:
                self._future.set_exception(error)
            self._call_back()
        return True

    def _call_back(self) -> None:
        while True:
            try:
                callback = self._done_callbacks.popleft()
            except IndexError:
                return
            self._callbacks.call(callback)

    # -- who wants to know ---------------------------------------------------------------------------

    def call_back(self, callback: Callable[[], object]) -> None:
        """Call `callback` when it has ended, in the thread for callbacks."""
        self._done_callbacks.append(callback)
        if self._future.done():
            self._call_back()

    def wait(self, timeout: float) -> bool:
        """Wait until it has ended; False when time is up."""
        if not self.is_over:
            try:
                self._future.exception(timeout)
            except (FutureTimeout, TimeoutError):
                return self.is_over
        return True

    @property
    def future(self) -> Future[None]:
        """Settled when it has ended; not to be cancelled."""
        return self._future


class Handle:
    """Something that was begun on a robot.

    Wait for it, await it, or leave it alone: it goes on all the same. As a context manager it is cancelled where the
    block is left before it is over. Awaiting it and giving that up does not stop the robot; `cancel` does.
    """

    #: Seconds that `wait` waits unless it is told otherwise.
    TIMEOUT: ClassVar[float] = 60.0

    def __init__(self, life: Lifecycle) -> None:
        self._life = life

    @property
    def name(self) -> str:
        """What it is."""
        return self._life.name

    @property
    def phase(self) -> Phase:
        """How far it has got."""
        return self._life.phase

    @property
    def done(self) -> bool:
        """It is over, however it ended."""
        return self._life.is_over

    @property
    def error(self) -> Exception | None:
        """Why it did not come to its own end: what `wait` raises; None if it did, or is not over."""
        return self._life.error

    def wait(self, timeout: float | None = None) -> None:
        """Wait until it is over; in done callbacks too.

        Args:
            timeout: seconds; by default `TIMEOUT`.

        Raises:
            BadValue: `timeout` is no number of seconds.
            LinkTimeout: it was not over in time; it goes on.
            Cancelled: it was cancelled, or preempted by another.
            LinkError: what else ended it.
        """
        seconds = check_seconds(self.TIMEOUT if timeout is None else timeout, "timeout", finite=True)
        if not self._life.wait(seconds):
            raise LinkTimeout(f"{self.name} is {self.phase.value}, and not over within {seconds:g} s; it goes on")
        error = self._life.error
        if error is not None:
            raise error

    def cancel(self) -> None:
        """End it, and stop the robot. Returns at once; without effect if it is over."""
        self._life.cancel("cancelled", brake=True)

    def add_done_callback(self, callback: Callable[[Self], object]) -> None:
        """Call back once it is over, in the robot's thread for callbacks; soon if it is over already.

        The callback may command the robot, and wait. One that is slow keeps other callbacks of the same robot waiting.

        Raises:
            BadValue: nothing that can be called.
        """
        check_callable(callback, "callback")
        self._life.call_back(lambda: callback(self))

    def __await__(self) -> Generator[Any, None, None]:
        import asyncio

        return asyncio.wrap_future(self._life.future).__await__()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.cancel()

    def __repr__(self) -> str:
        error = "" if self.error is None else f": {self.error}"
        return f"<{type(self).__name__} {self.name} {self.phase.value}{error}>"

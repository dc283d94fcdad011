"""Handles of motions, programs and missions on a robot, and the state machine of their life.

========== ========= ============ ========= ===================================
event      in SENT   in RUNNING   after     in DONE, CANCELLED, FAILED
========== ========= ============ ========= ===================================
SEND       SENT      -            -         -
BEGIN      RUNNING   -            -         -
LINK       SENT      RUNNING      SEND      -
LOSE       SENT      RUNNING      SEND      -
BRAKE      SENT      RUNNING      SEND      -
REPORT     -         RUNNING      -         -
STOP       SENT      RUNNING      -         -
SETTLE     -         RUNNING      REPORT    -
FINISH     DONE      DONE         -         -
CANCEL     CANCELLED CANCELLED    -         -
FAIL       FAILED    FAILED       -         -
========== ========= ============ ========= ===================================

The table shows the next phase for each event; the column "after" names an event that must have happened before. A life
is the sequence of phases from the start of a motion, program or mission to its end. Each event is recorded once, even
if two connections report it. REPORT is the exception: the last report is kept. A life never returns to an earlier
phase, and the first end is final. An event that cannot happen in a phase raises an error. After the end, events have no
effect. docs/architecture.md shows the same table. The phase alone is not the whole state, because a program has two
connections, which deliver their events in any order. The primary connection reports BEGIN, REPORT and STOP. The link to
the program causes LINK, LOSE and BRAKE.

The library uses the class `Lifecycle`, and users get a `Handle`. Both classes work without a lock: each event is put
into a dictionary with `setdefault`, which neither another thread nor a signal handler can interrupt.

A life that has ended must not be part of a reference cycle, because a program might have switched off the garbage
collector. Therefore a life releases its handle and its brake function at the end. It stores and returns only copies of
its error that have never been raised. A raised exception refers to the frames that it passes, and the variables of
these frames refer to the handle.
"""

from __future__ import annotations

import contextlib
import enum
import logging
import math
from collections import deque
from collections.abc import Callable, Generator, Mapping
from concurrent.futures import Future
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

from . import clock
from .arguments import check_callable, check_seconds
from .errors import Cancelled, LinkError, LinkTimeout, unraised
from .names import StrictAttributes
from .pending_call import current_call, has_started, next_order, pending_call, regardless
from .threads import CallbackThread

if TYPE_CHECKING:
    from typing_extensions import Self

_log = logging.getLogger(__name__)


class Phase(enum.Enum):
    """Phase of a motion, program or mission."""

    SENT = "sent"
    RUNNING = "running"
    DONE = "done"
    CANCELLED = "cancelled"
    FAILED = "failed"


class Event(enum.Enum):
    """Event in the life of a motion, program or mission."""

    SEND = "send"  # it was sent to the robot, or its thread was started
    BEGIN = "begin"  # the robot has started it
    LINK = "link"  # its program has connected, and receives messages
    LOSE = "lose"  # the link to its program was lost
    BRAKE = "brake"  # from now on, only messages that end it are sent
    REPORT = "report"  # its program has reported the result
    STOP = "stop"  # the controller has ended it, and the reason is not known yet
    SETTLE = "settle"  # its program has ended, and the arm is still moving
    FINISH = "finish"
    CANCEL = "cancel"
    FAIL = "fail"


_LIVE = (Phase.SENT, Phase.RUNNING)
_ENDS = {Event.FINISH: Phase.DONE, Event.CANCEL: Phase.CANCELLED, Event.FAIL: Phase.FAILED}

#: (phase, event) -> the next phase. In SENT and RUNNING a missing event is an error; in other phases it has no effect.
TRANSITIONS: Mapping[tuple[Phase, Event], Phase] = MappingProxyType(
    {
        (Phase.SENT, Event.SEND): Phase.SENT,
        (Phase.SENT, Event.BEGIN): Phase.RUNNING,
        **{(phase, event): phase for phase in _LIVE for event in (Event.LINK, Event.LOSE, Event.BRAKE, Event.STOP)},
        (Phase.RUNNING, Event.REPORT): Phase.RUNNING,
        (Phase.RUNNING, Event.SETTLE): Phase.RUNNING,
        **{(phase, event): after for phase in _LIVE for event, after in _ENDS.items()},
    }
)
#: event -> the event that must have happened before it.
AFTER: Mapping[Event, Event] = MappingProxyType(
    {Event.LINK: Event.SEND, Event.LOSE: Event.SEND, Event.BRAKE: Event.SEND, Event.SETTLE: Event.REPORT}
)


class Occurrence(NamedTuple):
    """Record of an event with its time and its error.

    Attributes:
        event: The event.
        at: Time of the event in s, on the clock of the object that noticed it; NaN if that object has no clock.
        error: Error of the event, or None.
    """

    event: Event
    at: float
    error: Exception | None


class Lifecycle:
    """Life of one motion, program or mission on a robot.

    Args:
        name: Name, used in log and error messages.
        callbacks: Thread that calls the callbacks of users.
        waiting: Context that surrounds each wait for the end. It may release a lock during the wait, or refuse to wait.

    Attributes:
        brake: Function that stops the robot; may raise `LinkError`. It is called if the life ends early and the robot
            has to be stopped. It is released at the end.
        future: Future that is done at the end of the life. It must not be cancelled.
        handle: Handle of the user; None if there is no handle, and after the end.
    """

    def __init__(
        self,
        name: str,
        callbacks: CallbackThread,
        waiting: Callable[[], contextlib.AbstractContextManager[object]] = contextlib.nullcontext,
    ) -> None:
        self.name = name
        self.brake: Callable[[], object] = _nothing
        self.handle: Handle | None = None
        self._callbacks = callbacks
        self._waiting = waiting
        #: event -> its record. The event that has ended the life is recorded under the key None.
        self._marks: dict[Event | None, Occurrence] = {}
        self.future: Future[None] = Future()
        # Set the future to running, so that it cannot be cancelled: if an awaiting task is cancelled, it must cancel
        # the motion instead.
        self.future.set_running_or_notify_cancel()
        self._releases: deque[Callable[[], object]] = deque()
        self._done_callbacks: deque[Callable[[], object]] = deque()
        self.enter()

    def enter(self) -> None:
        """Record that the current call of this thread starts the motion, program or mission.

        If a handle is used in a `with` statement, one call creates the handle, and another call enters the block,
        possibly much later.

        Raises:
            Cancelled: If the current call was abandoned.
        """
        self._call = current_call()
        order = None if self._call is None else self._call.order
        #: Number of this call, which is compared with the number of a stop. See `linkcore.pending_call`.
        self.order = next_order() if order is None else order
        if self._call is not None:
            self._call.has_begun(self)

    @property
    def phase(self) -> Phase:
        """Current phase."""
        end = self._marks.get(None)
        if end is not None:
            return _ENDS[end.event]
        return Phase.RUNNING if Event.BEGIN in self._marks else Phase.SENT

    def happened(self, event: Event) -> Occurrence | None:
        """Return the record of an event other than an end.

        Return None if the event has not happened before the end.
        """
        return self._marks.get(event)

    @property
    def is_over(self) -> bool:
        """Whether the motion, program or mission has ended, as DONE, CANCELLED or FAILED."""
        return None in self._marks

    @property
    def is_wanted(self) -> bool:
        """Whether the robot might still start it: it has not ended, and the call that sent it was not abandoned."""
        return not (self.is_over or (self._call is not None and self._call.is_given_up))

    @property
    def error(self) -> Exception | None:
        """Error that has ended the motion, program or mission early, or None.

        The error is a copy that may be raised.
        """
        end = self._marks.get(None)
        return None if end is None or end.error is None else unraised(end.error)

    # -- events --------------------------------------------------------------------------------------

    def begin(self, at: float = math.nan) -> bool:
        """Record that the robot has begun the motion, program or mission.

        Like every method that records an event, return False if the event was recorded before, or after the end.
        """
        return self.fire(Event.BEGIN, at=at)

    def finish(self) -> bool:
        """Record that the motion, program or mission has finished normally."""
        return self.fire(Event.FINISH)

    def cancel(self, why: str, *, brake: bool = False) -> bool:
        """Record that this process has cancelled the motion, program or mission. With `brake`, also stop the robot."""
        return self.fire(Event.CANCEL, Cancelled(f"{self.name} was {why}"), brake)

    def give_up(self) -> bool:
        """Cancel the motion, program or mission, and stop the robot, because the awaiting task was cancelled."""
        return self.cancel("cancelled, because the task that awaited it was cancelled", brake=True)

    def fail(self, error: Exception, *, brake: bool = False) -> bool:
        """Record the error that has ended the motion, program or mission early. With `brake`, also stop the robot."""
        return self.fire(Event.FAIL, error, brake)

    def fire(self, event: Event, error: Exception | None = None, brake: bool = False, *, at: float = math.nan) -> bool:
        """Record an event. Return False if the event was recorded before, or if the life has ended.

        Args:
            event: The event.
            error: Error of the event; a copy is kept.
            brake: Whether to stop the robot; only for events that end the life.
            at: Time of the event. See `Occurrence`.

        Raises:
            RuntimeError: If the event cannot happen now.
        """
        phase = self.phase
        if phase not in _LIVE or (event in self._marks and event is not Event.REPORT):
            return False
        before = AFTER.get(event)
        if (phase, event) not in TRANSITIONS or not (before is None or before in self._marks):
            raise RuntimeError(f"{self.name}: {event.value!r} cannot happen while it is {phase.value}")
        mine = Occurrence(event, at, None if error is None else unraised(error))
        if event is Event.REPORT:
            self._marks[event] = mine
            return True
        if event not in _ENDS:
            return self._marks.setdefault(event, mine) is mine
        try:
            if self._marks.setdefault(None, mine) is not mine:
                return False
            if brake:
                regardless(self.brake)
        except LinkError as failure:
            # The robot has already stopped for another reason, or the connection is lost.
            _log.info("%s: could not send a stop to the robot: %s", self.name, failure)
        except Exception:
            raise
        except BaseException:  # a second Ctrl-C: the stop that it interrupted might not have been sent
            if brake and self._marks.get(None) is mine:
                with contextlib.suppress(LinkError):
                    regardless(self.brake)
            raise
        finally:
            if self._marks.get(None) is mine:
                self._settle(mine.error)
        return True

    def _settle(self, error: Exception | None) -> None:
        # `regardless`, because resources must be released even if the call that ends it was abandoned.
        _drain(self._releases, regardless)
        if error is None:
            self.future.set_result(None)
        else:
            self.future.set_exception(error)
        _drain(self._done_callbacks, self._callbacks.call)
        self.brake, self.handle = _nothing, None

    # -- waiting for the end -------------------------------------------------------------------------

    def on_end(self, release: Callable[[], object]) -> None:
        """Call `release` when the motion, program or mission ends, in the thread that ends it.

        Use this only for functions of the library that neither wait nor raise.
        """
        self._releases.append(release)
        if self.is_over:
            _drain(self._releases, regardless)

    def call_back(self, callback: Callable[[], object]) -> None:
        """Call `callback` when the motion, program or mission has ended, in the thread for callbacks."""
        self._done_callbacks.append(callback)
        if self.future.done():
            _drain(self._done_callbacks, self._callbacks.call)

    def wait(self, timeout: float) -> bool:
        """Wait for the end of the motion, program or mission; return False after `timeout` seconds.

        Raises:
            LocalError: If called from the thread that would have to deliver the result.
        """
        if not self.is_over:
            with self._waiting():
                if not clock.is_done(self.future, timeout):
                    return self.is_over
        return True


def _nothing() -> None:
    pass


def _drain(waiting: deque[Callable[[], object]], use: Callable[[Callable[[], object]], object]) -> None:
    """Remove and use each item exactly once, even if two threads do so at the same time."""
    while True:
        try:
            each = waiting.popleft()
        except IndexError:
            return
        use(each)


class Handle(StrictAttributes):
    """Handle of a motion, program or mission on a robot.

    You can wait for the motion, program or mission, await it, or ignore it; it keeps running in each case. **An
    interrupted wait cancels it**, and the robot brakes. This happens on Ctrl-C in `wait`, and when a task that awaits
    the handle is cancelled. In three cases only the wait ends, and the robot continues: when the `timeout` of `wait`
    has passed, on Ctrl-C in ``wait(cancel=False)``, and when a task is cancelled in ``await asyncio.shield(handle)``.
    In a `with` statement, the motion, program or mission is cancelled if the block ends first.
    """

    def __init__(self, life: Lifecycle) -> None:
        self._life = life
        life.handle = self

    @property
    def name(self) -> str:
        """Name of the motion, program or mission."""
        return self._life.name

    @property
    def phase(self) -> Phase:
        """Current phase."""
        return self._life.phase

    @property
    def done(self) -> bool:
        """Whether the motion, program or mission has ended, for whatever reason."""
        return self._life.is_over

    @property
    def error(self) -> Exception | None:
        """Error that has ended the motion, program or mission early. `wait` raises this error.

        It is None after a normal end, and before the end.
        """
        return self._life.error

    def wait(self, timeout: float = 60.0, *, cancel: bool = True) -> None:
        """Wait until the motion, program or mission has ended. Done callbacks may call this too.

        Args:
            timeout: Maximum wait in seconds. After a timeout, the motion, program or mission keeps running, and you can
                wait again.
            cancel: Whether an exception that interrupts the wait (Ctrl-C: `KeyboardInterrupt`) cancels the motion,
                program or mission.

        Raises:
            BadValue: If `timeout` is not a number of seconds.
            LocalError: If called in a callback that was subscribed to a stream of the arm with ``inline=True``. This
                thread would have to receive the end.
            LinkTimeout: If it has not ended in time; it keeps running.
            Cancelled: If it was cancelled, or preempted by another one.
            LinkError: If something else has ended the motion, program or mission. For an arm: `SafetyStop`,
                `NotRunning`, `ConnectFailed`, `ConnectionLost`, `ProgramStopped`, `ScriptError`, `ToleranceExceeded`.
        """
        seconds = check_seconds(timeout, "timeout", finite=True)
        try:
            if not self._life.wait(seconds):
                raise LinkTimeout(
                    f"{self.name} has not ended within {seconds:g} s, and continues; its phase is {self.phase.value}"
                )
        except BaseException as error:
            if cancel:
                self._give_up(error)
            raise
        if self._life.error is not None:
            raise self._life.error

    def _give_up(self, interruption: BaseException) -> None:
        """Cancel if the wait was interrupted by Ctrl-C or a cancelled task, rather than ended by an error."""
        call = pending_call()
        if not isinstance(interruption, Exception) or (call is not None and call.is_given_up):
            try:
                self.cancel()
            finally:
                self.cancel()  # has an effect only if a second Ctrl-C has interrupted the first call

    def cancel(self) -> None:
        """Cancel the motion, program or mission, and let the robot brake.

        The call returns before the robot is at rest. It has no effect after the end.
        """
        if self._life.cancel("cancelled", brake=True):
            _log.info("%s was cancelled", self.name)

    def add_done_callback(self, callback: Callable[[Self], object]) -> None:
        """Call `callback` in the robot's callback thread when the motion, program or mission has ended.

        If it has already ended, the callback is called soon. The callback may command the robot, and may wait. A slow
        callback delays other callbacks of the same robot.

        Raises:
            BadValue: If `callback` is not callable.
        """
        check_callable(callback, "callback")
        self._life.call_back(lambda: callback(self))

    def __await__(self) -> Generator[Any, None, None]:
        from .event_loop import ended, running_loop

        loop = running_loop(f"awaiting {self.name}")
        try:
            yield from ended(self._life.future, loop)
        except BaseException as error:
            self._give_up(error)
            raise
        if self._life.error is not None:
            raise self._life.error

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.cancel()

    def _shown(self) -> list[tuple[str, str]]:
        """Return the rows that a notebook shows."""
        return [("phase", self.phase.value), ("error", "" if self.error is None else str(self.error))]

    def _repr_html_(self) -> str:
        from .text import html_table  # imported here: importing the library stays fast

        return html_table(f"{type(self).__name__} {self.name}", (), [row for row in self._shown() if row[1]])

    def __repr__(self) -> str:
        error = "" if self.error is None else f": {self.error}"
        return f"<{type(self).__name__} {self.name} {self.phase.value}{error}>"


H = TypeVar("H", bound=Handle)


def waited(handle: H, seconds: float) -> H:
    """Return `handle`; if `seconds` is not 0, first wait for its end, for at most `seconds`.

    Raises:
        LinkTimeout: If it has not ended in time; it keeps running.
        LinkError: If something else has ended it. See `Handle.wait`.
    """
    has_started()
    if seconds:
        handle.wait(seconds)
    return handle


class Motion(Handle):
    """Handle of a motion.

    Args:
        life: Life of the motion.
        measure: Function that returns the completed part, from 0 to 1; values outside this range are clipped.
    """

    def __init__(self, life: Lifecycle, measure: Callable[[], float] = lambda: 0.0) -> None:
        super().__init__(life)
        self._measure = measure

    @property
    def progress(self) -> float:
        """Completed part of the motion, from 0 to 1; 1 only after it has finished normally."""
        return 1.0 if self.phase is Phase.DONE else min(max(self._measured(), 0.0), 1.0)

    def _measured(self) -> float:
        return self._measure()

    def _shown(self) -> list[tuple[str, str]]:
        return [*super()._shown(), ("progress", f"{self.progress:.0%}")]

"""`Handle`: a motion, program or mission that runs on a robot, and the state machine of its life.

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

Each happens once, also where two connections report it, but REPORT: of several the last holds. There is no transition
back, and what ends it first is what it ends with. An event that cannot happen raises; after the end all are without
effect. docs/architecture.md shows the table. A phase does not say all: what the primary connection reports of a program
(BEGIN, REPORT, STOP) and what its link does (LINK, LOSE, BRAKE) come over two connections, in any order.

`Lifecycle` is the library's side of it, `Handle` what users hold. Both work without a lock: each event is put into a
dictionary with `setdefault`, which is one step for threads and for signal handlers alike.

A life that has ended is in no reference cycle, since a program may have switched the garbage collector off. So it lets
go of its handle and of its brake then. Its error is kept, and handed out, as copies that have never been raised: an
exception that is raised refers to the frames that it passes, and these to the handle in their variables.
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
    """How far something has got that was begun on a robot."""

    SENT = "sent"
    RUNNING = "running"
    DONE = "done"
    CANCELLED = "cancelled"
    FAILED = "failed"


class Event(enum.Enum):
    """What can happen to it."""

    SEND = "send"  # it leaves this computer, or its thread is started
    BEGIN = "begin"  # the robot has begun it
    LINK = "link"  # its program takes what it is sent
    LOSE = "lose"  # the link to its program is lost
    BRAKE = "brake"  # nothing more is sent to it but what ends it
    REPORT = "report"  # its program has reported how it ends
    STOP = "stop"  # the controller has ended it, and the reason is not known yet
    SETTLE = "settle"  # its program has ended, and the arm is still on its way
    FINISH = "finish"
    CANCEL = "cancel"
    FAIL = "fail"


_LIVE = (Phase.SENT, Phase.RUNNING)
_ENDS = {Event.FINISH: Phase.DONE, Event.CANCEL: Phase.CANCELLED, Event.FAIL: Phase.FAILED}

#: (phase, event) -> the phase after it. What is missing cannot happen; in the other phases nothing has an effect.
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
#: event -> the one that has to have happened before it.
AFTER: Mapping[Event, Event] = MappingProxyType(
    {Event.LINK: Event.SEND, Event.LOSE: Event.SEND, Event.BRAKE: Event.SEND, Event.SETTLE: Event.REPORT}
)


class Occurrence(NamedTuple):
    """That an event has happened.

    Attributes:
        event: which.
        at: when, s on the clock of what has noticed it; NaN where that has none.
        error: what it brought.
    """

    event: Event
    at: float
    error: Exception | None


class Lifecycle:
    """What becomes of one thing that runs on a robot.

    Args:
        name: for messages.
        callbacks: where users are called back.
        waiting: a context in which a thread waits for the end. It may let others in meanwhile, or refuse to wait.

    Attributes:
        brake: tells the robot to stop it; may raise `LinkError`. Called where it ends before its time and the robot has
            to be stopped; let go of at the end.
        future: settled when it has ended; not to be cancelled.
        handle: what users hold of it; None where they hold nothing, and after the end.
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
        #: by event; what has ended it under None, whichever it was
        self._marks: dict[Event | None, Occurrence] = {}
        self.future: Future[None] = Future()
        # So that a task that is cancelled while it awaits cannot cancel the future instead of the motion.
        self.future.set_running_or_notify_cancel()
        self._releases: deque[Callable[[], object]] = deque()
        self._done_callbacks: deque[Callable[[], object]] = deque()
        self.enter()

    def enter(self) -> None:
        """Count it as started by the call that this thread is in now.

        A block is made by one call and entered by another one, perhaps much later.

        Raises:
            Cancelled: If that call was abandoned.
        """
        self._call = current_call()
        order = None if self._call is None else self._call.order
        #: number of that call, to be compared with that of a stop; see `linkcore.pending_call`
        self.order = next_order() if order is None else order
        if self._call is not None:
            self._call.has_begun(self)

    @property
    def phase(self) -> Phase:
        """How far it has got."""
        end = self._marks.get(None)
        if end is not None:
            return _ENDS[end.event]
        return Phase.RUNNING if Event.BEGIN in self._marks else Phase.SENT

    def happened(self, event: Event) -> Occurrence | None:
        """That this has happened, which is not an end; None if it has not, or only after the end."""
        return self._marks.get(event)

    @property
    def is_over(self) -> bool:
        """It has ended, as DONE, CANCELLED or FAILED."""
        return None in self._marks

    @property
    def is_wanted(self) -> bool:
        """It may begin: it is not over, and no task has given up the call that it was begun by."""
        return not (self.is_over or (self._call is not None and self._call.is_given_up))

    @property
    def error(self) -> Exception | None:
        """What ended it before its time: a copy, which may be raised."""
        end = self._marks.get(None)
        return None if end is None or end.error is None else unraised(end.error)

    # -- what happens --------------------------------------------------------------------------------

    def begin(self, at: float = math.nan) -> bool:
        """The robot has begun it. As all of these: False where it has happened before, or it is over."""
        return self.fire(Event.BEGIN, at=at)

    def finish(self) -> bool:
        """It has come to its own end."""
        return self.fire(Event.FINISH)

    def cancel(self, why: str, *, brake: bool = False) -> bool:
        """It was given up here; with `brake` the robot is stopped."""
        return self.fire(Event.CANCEL, Cancelled(f"{self.name} was {why}"), brake)

    def give_up(self) -> bool:
        """The task that awaited it was cancelled."""
        return self.cancel("given up by the task that awaited it", brake=True)

    def fail(self, error: Exception, *, brake: bool = False) -> bool:
        """It cannot go on; with `brake` the robot is stopped."""
        return self.fire(Event.FAIL, error, brake)

    def fire(self, event: Event, error: Exception | None = None, brake: bool = False, *, at: float = math.nan) -> bool:
        """Something has happened. False where it has happened before, or it is over.

        Args:
            event: what.
            error: what it brought; kept as a copy.
            brake: the robot is stopped; for what ends it.
            at: see `Occurrence`.

        Raises:
            RuntimeError: it cannot happen now.
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
            # It was stopped by other means, or the link is gone.
            _log.info("%s: the robot was sent no stop: %s", self.name, failure)
        except Exception:
            raise
        except BaseException:  # a second Ctrl-C: what it has interrupted may not have been sent
            if brake and self._marks.get(None) is mine:
                with contextlib.suppress(LinkError):
                    regardless(self.brake)
            raise
        finally:
            if self._marks.get(None) is mine:
                self._settle(mine.error)
        return True

    def _settle(self, error: Exception | None) -> None:
        # Also if the call that ends it was abandoned: what it holds must not stay open.
        _drain(self._releases, regardless)
        if error is None:
            self.future.set_result(None)
        else:
            self.future.set_exception(error)
        _drain(self._done_callbacks, self._callbacks.call)
        self.brake, self.handle = _nothing, None

    # -- who wants to know ---------------------------------------------------------------------------

    def on_end(self, release: Callable[[], object]) -> None:
        """Call `release` when it ends, in the thread that ends it: the library's own, which neither wait nor raise."""
        self._releases.append(release)
        if self.is_over:
            _drain(self._releases, regardless)

    def call_back(self, callback: Callable[[], object]) -> None:
        """Call `callback` when it has ended, in the thread for callbacks."""
        self._done_callbacks.append(callback)
        if self.future.done():
            _drain(self._done_callbacks, self._callbacks.call)

    def wait(self, timeout: float) -> bool:
        """Wait until it has ended; False when time is up.

        Raises:
            LocalError: in a thread that would have to tell itself.
        """
        if not self.is_over:
            with self._waiting():
                if not clock.is_done(self.future, timeout):
                    return self.is_over
        return True


def _nothing() -> None:
    pass


def _drain(waiting: deque[Callable[[], object]], use: Callable[[Callable[[], object]], object]) -> None:
    """Use each once, also where two threads do so at the same time."""
    while True:
        try:
            each = waiting.popleft()
        except IndexError:
            return
        use(each)


class Handle(StrictAttributes):
    """Something that was begun on a robot.

    Wait for it, await it, or leave it alone: it goes on all the same. **An interrupted wait cancels it**, and the robot
    brakes: Ctrl-C in `wait`, or the cancellation of a task that awaits it. The `timeout` of `wait` only ends the
    waiting; so does Ctrl-C in ``wait(cancel=False)``, and a cancellation of ``await asyncio.shield(handle)``. As a
    context manager it is cancelled where the block is left before it is over.
    """

    def __init__(self, life: Lifecycle) -> None:
        self._life = life
        life.handle = self

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

    def wait(self, timeout: float = 60.0, *, cancel: bool = True) -> None:
        """Wait until it is over; in done callbacks too.

        Args:
            timeout: seconds; after that it goes on, and can be waited for again.
            cancel: whether an exception that interrupts the waiting (Ctrl-C: `KeyboardInterrupt`) cancels it.

        Raises:
            BadValue: `timeout` is not a number of seconds.
            LocalError: in a callback of an arm's stream that was subscribed with ``inline=True``: this is the thread
                that would have to receive the end.
            LinkTimeout: it was not over in time; it goes on.
            Cancelled: it was cancelled, or preempted by another.
            LinkError: what else ended it. Of an arm: `SafetyStop`, `NotRunning`, `ConnectFailed`, `ConnectionLost`,
                `ProgramStopped`, `ScriptError`, `ToleranceExceeded`.
        """
        seconds = check_seconds(timeout, "timeout", finite=True)
        try:
            if not self._life.wait(seconds):
                raise LinkTimeout(f"{self.name} is {self.phase.value}, and not over within {seconds:g} s; it goes on")
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
                self.cancel()  # without effect, unless a second Ctrl-C has interrupted the first

    def cancel(self) -> None:
        """End it, and let the robot brake. Returns at once, which is before it stands; without effect if it is over."""
        if self._life.cancel("cancelled", brake=True):
            _log.info("%s was cancelled", self.name)

    def add_done_callback(self, callback: Callable[[Self], object]) -> None:
        """Call back once it is over, in the robot's thread for callbacks; soon if it is over already.

        The callback may command the robot, and wait. One that is slow keeps other callbacks of the same robot waiting.

        Raises:
            BadValue: nothing that can be called.
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
        """What a notebook shows of it."""
        return [("phase", self.phase.value), ("error", "" if self.error is None else str(self.error))]

    def _repr_html_(self) -> str:
        from .text import html_table  # imported here: importing the library stays cheap

        return html_table(f"{type(self).__name__} {self.name}", (), [row for row in self._shown() if row[1]])

    def __repr__(self) -> str:
        error = "" if self.error is None else f": {self.error}"
        return f"<{type(self).__name__} {self.name} {self.phase.value}{error}>"


H = TypeVar("H", bound=Handle)


def waited(handle: H, seconds: float) -> H:
    """Return the handle of what was started; if `seconds` is not 0, wait for its end first, for so long at most.

    Raises:
        LinkTimeout: If it has not ended in time; it keeps running.
        LinkError: If something else ended it. See `Handle.wait`.
    """
    has_started()
    if seconds:
        handle.wait(seconds)
    return handle


class Motion(Handle):
    """A movement under way.

    Args:
        life: what becomes of it.
        measure: tells which part of it is behind the robot, from 0 to 1; what is beyond counts as the nearest of them.
    """

    def __init__(self, life: Lifecycle, measure: Callable[[], float] = lambda: 0.0) -> None:
        super().__init__(life)
        self._measure = measure

    @property
    def progress(self) -> float:
        """How much of it is behind the robot, from 0 to 1; 1 only once it has come to its own end."""
        return 1.0 if self.phase is Phase.DONE else min(max(self._measured(), 0.0), 1.0)

    def _measured(self) -> float:
        return self._measure()

    def _shown(self) -> list[tuple[str, str]]:
        return [*super()._shown(), ("progress", f"{self.progress:.0%}")]

"""`Motion`: the handle of a movement that was begun.

    MOVING ──┬── its program, or its trajectory, came to its end ──> DONE
             ├── cancel(), or another motion took over ────────────> CANCELLED   (error: MotionCancelled)
             └── a stop, a lost link, a tolerance, a program error ─> FAILED     (error: what it was)

There is no way back. What ends a motion first is what it ends with.
"""

from __future__ import annotations

import enum
import logging
import threading
from collections.abc import Callable, Generator
from concurrent.futures import Future
from concurrent.futures import TimeoutError as FutureTimeout
from typing import TYPE_CHECKING

from linkcore.errors import LinkError, LinkTimeout, LocalError

from ..errors import MotionCancelled
from ..urscript.text import checked
from .equipment import Equipment

if TYPE_CHECKING:
    from typing_extensions import Self

__all__ = ["Motion", "MotionPhase"]

_log = logging.getLogger(__name__)


class MotionPhase(enum.Enum):
    """How a motion stands."""

    MOVING = "moving"
    DONE = "done"
    CANCELLED = "cancelled"
    FAILED = "failed"


class Motion:
    """A movement under way; made by `robot.motion`.

    Wait for it, await it, or leave it alone: it goes on all the same. As a context manager it is cancelled where the
    block is left before it is over. Awaiting it and giving that up does not stop the arm; `cancel` does.

    Attributes:
        name: which motion, such as "move_joints".
    """

    def __init__(self, name: str, equipment: Equipment) -> None:
        self.name = name
        self._equipment = equipment
        self._future: Future[None] = Future()
        # So that nobody who awaits it can cancel the future instead of the motion.
        self._future.set_running_or_notify_cancel()
        self._lock = threading.Lock()
        self._phase = MotionPhase.MOVING
        self._error: Exception | None = None
        self._has_begun = False
        self._is_yielding = False
        self._held: Exception | None = None
        self._ignore_stops: Callable[[], None] = lambda: None

    # -- what users hold -----------------------------------------------------------------------------

    @property
    def phase(self) -> MotionPhase:
        """How it stands."""
        return self._phase

    @property
    def done(self) -> bool:
        """It is over, however it ended."""
        return self._phase is not MotionPhase.MOVING

    @property
    def error(self) -> Exception | None:
        """Why it did not come to its own end: what `wait` raises; None if it did, or is not over."""
        return self._error

    @property
    def progress(self) -> float:
        """How much of it is behind the arm, from 0 to 1; 1 only once it has come to its own end."""
        return 1.0 if self._phase is MotionPhase.DONE else min(max(self._measure(), 0.0), 1.0)

    def wait(self, timeout: float = 60.0) -> None:
        """Wait until it is over.

        Raises:
            BadValue: `timeout` is no number of seconds.
            LinkTimeout: it was not within `timeout` seconds; it goes on.
            MotionCancelled: it was cancelled, or superseded by another.
            SafetyStop, NotRunning: a stop ended it, or the robot stopped running.
            ConnectFailed, ConnectionLost, ProgramStopped, ScriptError, ToleranceExceeded: what else ended it.
        """
        try:
            error = self._future.exception(checked(timeout, "timeout", 0.0))
        except (FutureTimeout, TimeoutError):
            raise LinkTimeout(f"{self.name} is not over within {timeout:g} s; it goes on") from None
        if error is not None:
            raise error

    def cancel(self) -> None:
        """End it, and let the arm brake. Returns at once; without effect if it is over."""
        if self._end(MotionPhase.CANCELLED, MotionCancelled(f"{self.name} was cancelled"), brake=True):
            _log.info("%s was cancelled", self.name)

    def add_done_callback(self, callback: Callable[[Motion], object]) -> None:
        """Call back once it is over, from the thread in which that is noticed; at once if it already is."""
        self._future.add_done_callback(lambda future: callback(self))

    def __await__(self) -> Generator[object, None, None]:
        import asyncio

        return asyncio.wrap_future(self._future).__await__()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.cancel()

    def __repr__(self) -> str:
        return f"<Motion {self.name} {self._phase.value}{'' if self._error is None else f': {self._error}'}>"

    # -- what kinds of motions fill in ---------------------------------------------------------------

    def _begin(self) -> None:
        """Send what makes the arm move. Raises where nothing was, or could be, sent."""
        raise NotImplementedError

    def _brake(self) -> None:
        """Tell the robot to stop; may raise `LinkError`."""

    def _release(self) -> None:
        """Close what was opened. Called once, when it is over."""

    def _measure(self) -> float:
        """How much of it is behind the arm."""
        return 0.0

    # -- how it is begun and ended -------------------------------------------------------------------

    def start(self) -> None:
        """Begin; for `Motions`, which sees to it that only one motion runs.

        Raises:
            LinkError: it could not begin; it is over then.
            LocalError: it has been begun before.
        """
        with self._lock:
            if self._has_begun:
                raise LocalError(f"{self.name} has been begun before; each motion is good for one time")
            self._has_begun = True
        self._ignore_stops = self._equipment.safety.on_stop(self._fail_at_once)
        try:
            self._begin()
        except BaseException as error:
            ended_by = error if isinstance(error, Exception) else MotionCancelled(f"{self.name} was interrupted")
            self._end(MotionPhase.FAILED, ended_by)
            raise

    def make_way(self) -> None:
        """Another motion is about to take over: what ends this one from now on may be its doing."""
        with self._lock:
            self._is_yielding = True

    def go_on(self) -> None:
        """The other motion did not begin after all."""
        with self._lock:
            self._is_yielding = False
            held, self._held = self._held, None
        if held is not None:
            self._fail(held)

    def supersede(self, by: Motion) -> None:
        """The other motion has begun."""
        self._end(MotionPhase.CANCELLED, MotionCancelled(f"{self.name} was superseded by {by.name}"))

    def _complete(self) -> None:
        self._end(MotionPhase.DONE, None)

    def _fail(self, error: Exception, brake: bool = False) -> None:
        with self._lock:
            if self._is_yielding:
                self._held = self._held or error
                return
        self._end(MotionPhase.FAILED, error, brake)

    def _fail_at_once(self, error: LinkError) -> None:
        self._end(MotionPhase.FAILED, error)

    def _end(self, phase: MotionPhase, error: Exception | None, brake: bool = False) -> bool:
        """Over; False if it already was. From here on it sends nothing but, with `brake`, the word to stop."""
        with self._lock:
            if self._phase is not MotionPhase.MOVING:
                return False
            self._phase, self._error = phase, error
        self._ignore_stops()
        if brake:
            try:
                self._brake()
            except LinkError as failure:
                # The gate is closed, or the link gone: then the robot has been stopped by other means.
                _log.info("%s: the robot was not told to stop: %s", self.name, failure)
        self._release()
        if error is None:
            self._future.set_result(None)
        else:
            self._future.set_exception(error)
        return True

"""A program that was sent to the controller, and what has become of it."""

from __future__ import annotations

import enum
import logging
import threading
from collections.abc import Callable

from linkcore.errors import LinkError, LinkTimeout

from ..urscript.text import checked

__all__ = ["Program", "ProgramPhase"]

_log = logging.getLogger(__name__)

#: Lines of `textmsg` that are kept.
_TEXTS = 1000


class ProgramPhase(enum.Enum):
    """How far a program has got."""

    SENT = "sent"
    RUNNING = "running"
    FINISHED = "finished"
    STOPPED = "stopped"
    FAILED = "failed"


class Program:
    """What the controller says of a program that was sent to it; made by `robot.script.run`.

    Attributes:
        name: as the controller calls it.
    """

    def __init__(self, name: str, stop: Callable[[Program], object]) -> None:
        self.name = name
        self._stop = stop
        self._lock = threading.Lock()
        self._over = threading.Event()
        self._phase = ProgramPhase.SENT
        self._error: LinkError | None = None
        self._texts: list[str] = []
        self._callbacks: list[Callable[[Program], object]] = []

    @property
    def phase(self) -> ProgramPhase:
        """How far it has got."""
        return self._phase

    @property
    def done(self) -> bool:
        """It has come to an end, whichever."""
        return self._over.is_set()

    @property
    def error(self) -> LinkError | None:
        """Why it did not come to its own end: `CompileError`, `ScriptFailed`, `ProgramStopped`, `SafetyStop`,
        `NotRunning`, `ConnectionLost` or `LinkTimeout`; None if it did, or is not done."""
        return self._error

    @property
    def texts(self) -> tuple[str, ...]:
        """The lines that its `textmsg` sent, the last thousand.

        A controller does not say which program a line is from: those of a `sec` that runs beside are here too.
        """
        with self._lock:
            return tuple(self._texts)

    def wait(self, timeout: float = 60.0) -> None:
        """Wait until it is done.

        Raises:
            BadValue: `timeout` is no number of seconds.
            LinkTimeout: it was not within `timeout` seconds; it goes on.
            LinkError: `error`, if it did not come to its own end.
        """
        if not self._over.wait(checked(timeout, "timeout", 0.0)):
            raise LinkTimeout(f"program {self.name} is {self._phase.value}, not over within {timeout:g} s")
        if self._error is not None:
            raise self._error

    def stop(self) -> None:
        """Stop it, without waiting until it has; the arm brakes. Without effect if it is done.

        Raises:
            NotRunning: nothing is known of the robot, so it cannot be stopped from here.
            RemoteError: it could not be told.
        """
        if not self.done:
            self._stop(self)

    def add_done_callback(self, callback: Callable[[Program], object]) -> None:
        """Call back once it is done, from the thread that reads; at once and from here if it is already."""
        with self._lock:
            if not self._over.is_set():
                self._callbacks.append(callback)
                return
        callback(self)

    # -- the library's side ----------------------------------------------------------------------

    def add_text(self, text: str) -> None:
        """A line of its `textmsg`."""
        with self._lock:
            self._texts.append(text)
            del self._texts[:-_TEXTS]

    def set_running(self) -> None:
        """It has begun."""
        with self._lock:
            if not self._over.is_set():
                self._phase = ProgramPhase.RUNNING

    def set_done(self, phase: ProgramPhase, error: LinkError | None = None) -> None:
        """It has come to an end. Without effect if it had already."""
        with self._lock:
            if self._over.is_set():
                return
            self._phase, self._error = phase, error
            self._over.set()
            callbacks, self._callbacks = self._callbacks, []
        for callback in callbacks:
            try:
                callback(self)
            except Exception:
                _log.exception("a done callback of program %s raised", self.name)

    def __repr__(self) -> str:
        return f"<Program {self.name} {self._phase.value}{'' if self._error is None else f': {self._error}'}>"

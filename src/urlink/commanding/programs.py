"""`robot.script`: programs and lines to the controller, and what it says of them.

The controller tells of a program by name: PROGRAM_XXX_STARTED and PROGRAM_XXX_STOPPED, whatever ended it. That it
came to its end is told by the program itself, see `urlink.urscript.source`. Whether CB2 sends the key messages is not
known, so there a program begins with its own first word, and is over once the flag in the robot mode data falls.

Runtime exceptions carry no name. One that comes while a program is awaited is taken for that program's; else it is
the running program's, unless its text is a compiler's.
"""

from __future__ import annotations

import contextlib
import itertools
import logging
import os
import threading
import time
from collections.abc import Callable, Sequence

from linkcore.errors import BadValue, ConnectionLost, LinkError, LinkTimeout
from linkcore.streaming.events import ConnectionEvent, ConnectionState
from linkcore.streaming.stream import Stream
from linkcore.streaming.subscription import Subscription
from linkcore.wire.packet import State

from ..errors import CompileError, ProgramStopped, SafetyStop, ScriptError, ScriptFailed
from ..interfaces.primary.robot_message import KeyMessage, RuntimeExceptionMessage, TextMessage
from ..interfaces.primary.robot_state import RobotModeData, RobotState
from ..urscript import source as sources
from ..urscript.source import Wrapped
from .channel import Outlet
from .handle import Program, ProgramPhase
from .safety import Safety

__all__ = ["Scripts"]

_log = logging.getLogger(__name__)

#: Seconds within which a program has to begin, and a `sec`, which takes no time, to be over.
START_TIMEOUT = 5.0
#: Seconds after an error within which the controller says that the program is over; then it is taken to be.
_AFTERMATH = 1.0
#: Seconds after the beginning of a program by which the flag in the robot mode data shows it: five states.
_FLAG_LAG = 0.5
#: Seconds that news of a stop may come after the end of the program that it stopped.
_STOP_LAG = 0.3

_STARTED = "PROGRAM_XXX_STARTED"
_STOPPED = "PROGRAM_XXX_STOPPED"
_COMPILER = ("compile_error", "syntax_error")


class _Run:
    """A program that is not over yet."""

    def __init__(self, wrapped: Wrapped, program: Program, on_text: Callable[[str], object] | None) -> None:
        self.wrapped = wrapped
        self.program = program
        self.on_text = on_text
        self.sent = time.monotonic()
        self.has_begun = False
        self.begun = 0.0
        self.is_finished = False  # it has said its last word
        self.is_asked_to_stop = False
        self.was_seen = False  # in the robot mode data
        self.error: ScriptError | None = None
        self.failed = 0.0

    @property
    def name(self) -> str:
        return self.wrapped.name


class Scripts:
    """Sends URScript, and keeps account of the programs that it sent.

    Args:
        primary: makes the primary stream.
        outlet: by which everything leaves.
        safety: knows of stops.
    """

    def __init__(self, primary: Callable[[], Stream[RobotState]], outlet: Outlet, safety: Safety) -> None:
        self._primary = primary
        self._outlet = outlet
        self._safety = safety
        self._token = os.urandom(2).hex()  # another process may be sending programs too
        self._numbers = itertools.count(1)
        self._lock = threading.RLock()
        self._sending = threading.Lock()
        self._runs: list[_Run] = []  # in the order in which they were sent
        self._subscriptions: list[Subscription] = []
        self._mode: RobotModeData | None = None
        self._has_keys = False  # this controller sends key messages

    # -- what users call ---------------------------------------------------------------------------

    def run(
        self, source: str, *, wait: bool | float = False, on_text: Callable[[str], object] | None = None
    ) -> Program:
        """Send a program; it stops the one that runs, unless it is a `sec`, which runs beside it.

        Args:
            source: URScript: a whole ``def``, a ``sec``, or bare statements. Where the last thing at the top is a
                ``def``, which may take no arguments, it is called after what stands above it.
            wait: until it is over: False not at all, True for up to 60 s, a number for so many seconds.
            on_text: called with each line of its `textmsg`, from the thread that reads.

        Returns:
            the handle. Lines in its errors are those of `source`.

        Raises:
            BadValue: it cannot be a program: nothing was sent.
            SafetyStop, NotRunning: the arm may not be moved now: nothing was sent.
            LinkError: it could not be sent; with `wait`, also what ended it.
        """
        token = f"{self._token}_{next(self._numbers)}"
        return self._send(sources.wrap(source, token), on_text, wait)

    def start(
        self,
        body: Sequence[str],
        *,
        prefix: str = "urlink",
        on_text: Callable[[str], object] | None = None,
        brakes: bool = False,
    ) -> Program:
        """Send a program of the library's own; it stops the one that runs.

        Args:
            body: its lines, without the ``def`` around them.
            prefix: what its name begins with.
            on_text: called with each line of `textmsg` while it runs, from the thread that reads.
            brakes: it can only bring the arm to rest; see `Outlet.motion`.

        Raises:
            SafetyStop, NotRunning: the arm may not be moved now: nothing was sent.
            RemoteError: it could not be sent.
        """
        name = f"{prefix}_{self._token}_{next(self._numbers)}"
        return self._send(sources.program(name, body), on_text, False, brakes)

    def send_line(self, line: str) -> None:
        """Send one line as it is, such as ``set speed 0.5``; what the controller makes of it is not told.

        It goes through the gate as programs do, since it may move the arm.

        Raises:
            BadValue: it is not one line.
            SafetyStop, NotRunning: the arm may not be moved now: nothing was sent.
            RemoteError: it could not be sent.
        """
        if not isinstance(line, str) or not line.strip():
            raise BadValue(f"{line!r} is no line of URScript")
        if not all(character == "\t" or character.isprintable() for character in line):
            raise BadValue(f"{line!r} holds a line break or a control character; expected one line")
        self._outlet.motion(line)

    def close(self) -> None:
        """Follow programs no longer."""
        with self._lock:
            subscriptions, self._subscriptions = self._subscriptions, []
        for subscription in subscriptions:
            subscription.close()
        self._end_all(lambda run: ConnectionLost(f"closed here while program {run.name} ran; it may still run"))

    # -- sending -----------------------------------------------------------------------------------

    def _send(
        self, wrapped: Wrapped, on_text: Callable[[str], object] | None, wait: bool | float, brakes: bool = False
    ) -> Program:
        if not isinstance(wait, bool) and not wait > 0:
            raise BadValue(f"wait is {wait!r}; expected True, False or a positive number of seconds")
        self._listen()
        program = Program(wrapped.name, self._stop)
        run = _Run(wrapped, program, on_text)
        with self._sending:  # so that they are known in the order in which they leave
            with self._lock:
                run.sent = time.monotonic()
                self._runs.append(run)
            try:
                self._outlet.motion(wrapped.text, brakes=brakes)
            except BaseException:
                with self._lock, contextlib.suppress(ValueError):  # the connection may have been lost meanwhile
                    self._runs.remove(run)
                raise
        if wait:
            program.wait(60.0 if wait is True else wait)
        return program

    def _stop(self, program: Program) -> None:
        with self._lock:
            run = next((each for each in self._runs if each.program is program), None)
        if run is None:
            return
        if run.wrapped.is_secondary:
            raise BadValue(f"{program.name} is a sec, which takes no time and cannot be stopped")
        run.is_asked_to_stop = True
        # A new program stops the one that runs. Where a stop holds, the arm stands already and the gate refuses.
        name = f"urlink_stop_{self._token}_{next(self._numbers)}"
        with contextlib.suppress(SafetyStop):
            self._outlet.motion(f"def {name}():\n  stopj(2.0)\nend", brakes=True)

    # -- what the controller says --------------------------------------------------------------------

    def _listen(self) -> None:
        with self._lock:
            if self._subscriptions:
                return
            stream = self._primary()
            subscriptions: list[Subscription] = []
            try:
                subscriptions.append(
                    stream.subscribe(self._on_packet, State, deadline=START_TIMEOUT, on_deadline=self._on_silence)
                )
                subscriptions.append(stream.subscribe(self._on_event, ConnectionEvent))
            except BaseException:
                for subscription in subscriptions:
                    subscription.close(0)
                raise
            self._subscriptions = subscriptions

    def _on_event(self, event: ConnectionEvent) -> None:
        if event.state in (ConnectionState.CONNECTING, ConnectionState.CONNECTED):
            return
        why = f": {event.error}" if event.error is not None else ""
        at = event.received.monotonic
        self._end_all(
            lambda run: ConnectionLost(f"the connection was lost while program {run.name} ran; it may still run{why}"),
            before=at,
        )
        if event.state in (ConnectionState.IDLE, ConnectionState.CLOSED):  # given up: listen anew if asked
            with self._lock:
                self._subscriptions = []

    def _on_silence(self, seconds: float) -> None:
        self._check_time()

    def _on_packet(self, packet: State) -> None:
        if isinstance(packet, RobotState):
            mode = packet.robot_mode_data
            if mode is not None:
                self._on_mode(mode)
        elif isinstance(packet, KeyMessage):
            self._on_key(packet.title.strip(), packet.text.strip("\0 \n"))
        elif isinstance(packet, TextMessage):
            self._on_text(packet.text.strip("\0\n"))
        elif isinstance(packet, RuntimeExceptionMessage):
            self._on_exception(packet)

    def _on_key(self, title: str, name: str) -> None:
        run = self._named(name)
        self._has_keys |= title in (_STARTED, _STOPPED)
        if title == _STARTED and run is not None:
            self._begin(run)
        elif title == _STARTED:
            self._replace(name, None)
        elif title == _STOPPED and run is not None:
            self._end(run)

    def _on_text(self, text: str) -> None:
        for run in self._pending():
            if text == sources.start_marker(run.name):
                self._begin(run)
                return
            if text == sources.finish_marker(run.name):
                self._begin(run)
                run.is_finished = True
                if run.wrapped.is_secondary:
                    self._end(run)
                return
        for run in self._pending():
            if run.has_begun and not run.wrapped.is_secondary:
                run.program.add_text(text)
                if run.on_text is not None:
                    try:
                        run.on_text(text)
                    except Exception:
                        _log.exception("on_text of program %s raised", run.name)

    def _on_exception(self, message: RuntimeExceptionMessage) -> None:
        awaited = [run for run in self._pending() if not run.has_begun]
        running = [run for run in self._pending() if run.has_begun]
        is_compiler = message.text.startswith(_COMPILER)
        candidates = awaited or ([] if is_compiler else running)
        if not candidates:
            _log.warning("the controller complains: %d:%d: %s", message.line, message.column, message.text)
            return
        run = candidates[-1]
        place = run.wrapped.place(message.line, message.column)
        kind = ScriptFailed if run.has_begun and not is_compiler else CompileError
        run.error = kind(*place, run.wrapped.words(message.text.strip("\0\n")))
        run.failed = time.monotonic()
        if not run.has_begun or run.wrapped.is_secondary:
            self._end(run)

    def _on_mode(self, mode: RobotModeData) -> None:
        self._mode = mode
        for run in self._pending():
            if run.wrapped.is_secondary or not run.has_begun:
                continue
            if mode.is_program_running or mode.is_program_paused:
                run.was_seen = True
            elif run.was_seen or run.is_finished or run.error is not None or self._was_missed(run):
                self._end(run)
        self._check_time()

    def _was_missed(self, run: _Run) -> bool:
        """It was over before a state could show it, and no key message tells: the flag has been down for too long."""
        return not self._has_keys and time.monotonic() - run.begun > _FLAG_LAG

    def _check_time(self) -> None:
        now = time.monotonic()
        for run in self._pending():
            if run.error is not None and now - run.failed > _AFTERMATH:
                self._end(run)
            elif (not run.has_begun or run.wrapped.is_secondary) and now - run.sent > START_TIMEOUT:
                self._finish(run, ProgramPhase.FAILED, self._never_began(run))

    def _never_began(self, run: _Run) -> LinkError:
        mode = self._mode
        if mode is None:
            situation = "it has told no robot mode either"
        else:
            runs = "a program runs" if mode.is_program_running else "no program runs"
            situation = f"the robot mode is {mode.robot_mode.name}, {runs}"
        what = "has not ended" if run.has_begun else "has not begun"
        hint = "" if run.has_begun else "; an e-Series controller takes no programs while it is in local control"
        return LinkTimeout(
            f"program {run.name} {what} within {START_TIMEOUT:g} s, and no error was told; {situation}{hint}"
        )

    # -- what becomes of programs ------------------------------------------------------------------

    def _pending(self) -> list[_Run]:
        with self._lock:
            return list(self._runs)

    def _named(self, name: str) -> _Run | None:
        return next((run for run in self._pending() if run.name == name), None)

    def _begin(self, run: _Run) -> None:
        if run.has_begun:
            return
        if not run.wrapped.is_secondary:
            self._replace(run.name, run)
        run.has_begun, run.begun = True, time.monotonic()
        run.program.set_running()

    def _replace(self, name: str, successor: _Run | None) -> None:
        """A program has begun: those sent before it are over, whether told so or not."""
        for run in self._pending():
            if run is successor:
                return
            if run.wrapped.is_secondary or (successor is None and not run.has_begun):
                continue
            if run.is_finished or run.error is not None or run.is_asked_to_stop:
                self._end(run)
            else:
                self._finish(run, ProgramPhase.STOPPED, ProgramStopped(f"program {run.name} was replaced by {name}"))

    def _end(self, run: _Run) -> None:
        """The controller has ended a program; why follows from what was heard before."""
        if run.error is not None:
            self._finish(run, ProgramPhase.FAILED, run.error)
        elif run.is_finished:
            self._finish(run, ProgramPhase.FINISHED, None)
        elif run.is_asked_to_stop:
            self._finish(run, ProgramPhase.STOPPED, ProgramStopped(f"program {run.name} was stopped as asked"))
        else:
            newer = any(each is not run and each.sent >= run.sent for each in self._pending())
            stop = None if newer else self._safety.wait_for_stop(_STOP_LAG)
            error = stop or ProgramStopped(
                f"program {run.name} was stopped before its end" + (", by the next one" if newer else "")
            )
            self._finish(run, ProgramPhase.STOPPED, error)

    def _end_all(self, why: Callable[[_Run], LinkError], before: float = float("inf")) -> None:
        for run in self._pending():
            if run.sent < before:
                self._finish(run, ProgramPhase.FAILED, why(run))

    def _finish(self, run: _Run, phase: ProgramPhase, error: LinkError | None) -> None:
        with self._lock:
            if run not in self._runs:
                return
            self._runs.remove(run)
        run.program.set_done(phase, error)

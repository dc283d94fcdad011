"""Programs that a robot object runs on the controller; its messages are turned into events of their handles.

The controller reports a program by name, with PROGRAM_XXX_STARTED, and with PROGRAM_XXX_STOPPED for whatever reason it
ended. Each program of this library has a unique name, so these messages also show which program preempted another one.
A program that ran to its end reports that with a `textmsg` (`urlink.script.wrapping`). It is unknown whether CB2 sends
the key messages. On CB2, a program has therefore begun with its first `textmsg`, and has ended when the program flag in
the robot mode data is cleared.

Runtime exceptions do not contain a name. If an exception arrives while a sent program has not begun, it is assigned to
that program. Otherwise it is assigned to the running program, unless its text is a compiler error.
"""

from __future__ import annotations

import itertools
import logging
import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from linkcore import clock
from linkcore.errors import Cancelled, Closed, ConnectionLost, LinkError, LinkTimeout
from linkcore.handle import Event, Lifecycle
from linkcore.process import abandon_at_end, forget
from linkcore.streaming.connection import Connection
from linkcore.streaming.connection_life import ConnectionEvent, ConnectionState
from linkcore.streaming.subscription import Subscription
from linkcore.text import printable
from linkcore.threads import CallbackThread, MadeOnce
from linkcore.wire.packet import State

from ..errors import CompileError, NotRunning, ProgramStopped, SafetyStop, ScriptError, ScriptFailed
from ..protocol.primary.robot_message import KeyMessage, RuntimeExceptionMessage, TextMessage
from ..protocol.primary.robot_state import RobotModeData, RobotState
from ..script import commands, wrapping
from ..script.wrapping import Permission, StartPlace, Wrapped
from ..session.identity import KnownIdentity
from ..session.session_limits import SessionLimits
from .channel import CommandChannel
from .given_up import GivenUpEvent, GivenUpPhase, GivenUpProgram
from .interlock import raise_if
from .safety_monitor import SafetyMonitor
from .section import Section

_log = logging.getLogger(__name__)

#: Time, in seconds, from an error to the controller's report of the program's end. Then the program counts as ended.
_AFTERMATH = 1.0
#: Delay, in seconds, of the flag in the robot mode data that shows that a program has begun: five states.
_FLAG_LAG = 0.5
#: The same if key messages report the end, unless the controller drops them, as it does for a slow client.
_KEY_LAG = 5.0
#: Delay, in seconds, between the end of a program and the report of the stop that ended it: three states.
_STOP_LAG = 0.3
#: Time, in seconds, from sending a stop until its program has ended: more than two states.
_IGNORED = 0.25
#: Time, in seconds, that `close` waits for a stop to end, and for programs abandoned meanwhile to stop: three states.
_CLOSING = 0.3
#: Time before a silence, in seconds. A text that was sent in this time might not have arrived.
_BEFORE = 0.5
#: Deceleration, in rad/s², of the arm when its motion is cancelled.
_DECELERATION = 2.0

_STARTED = "PROGRAM_XXX_STARTED"
_STOPPED = "PROGRAM_XXX_STOPPED"
_COMPILER = ("compile_error", "syntax_error")


@dataclass(eq=False)
class _Run:
    """A program that has not ended yet.

    Attributes:
        wrapped: The program as it was sent.
        life: Life cycle behind the handle (`linkcore.handle`), with the time of each event. The error of its REPORT is
            None if the program ran to its end.
        is_motion: Whether the program ends when the interlock closes. A user's program that has begun ends only when
            the controller reports its end, because it might only be paused. A user's program that still has to ask for
            permission ends at a stop.
        moves_late: Whether the program can move the arm even if it begins after its life has ended, because it neither
            asks for permission nor connects back to this computer.
        left_alone: Behaviour of the program after a lost connection, used in messages.
        on_text: Function called with each line of its `textmsg`, in the reader thread.
        on_finish: Function called when the program has run to its end.
        is_detached: Whether the program keeps running when the robot object is closed, or this process ends.
        sent: Time when the program was sent.
        was_seen: Whether the flag in the robot mode data, which lags behind the program, has shown it running.
    """

    wrapped: Wrapped
    life: Lifecycle
    is_motion: bool
    moves_late: bool
    left_alone: str
    on_text: Callable[[str], object]
    on_finish: Callable[[], object]
    is_detached: bool
    sent: float
    was_seen: bool = False

    @property
    def name(self) -> str:
        return self.wrapped.name

    @property
    def has_begun(self) -> bool:
        return self.life.happened(Event.BEGIN) is not None

    @property
    def is_settled(self) -> bool:
        """Whether the program is known to run, and only a change of the robot's mode can end it."""
        happened = self.life.happened
        return self.was_seen and not (happened(Event.STOP) or happened(Event.REPORT) or self.wrapped.is_secondary)


class Programs:
    """Sends programs, and keeps a record of the programs that have not ended.

    Args:
        primary: Connection whose messages report programs.
        channel: Channel that sends their text.
        monitor: Safety monitor, which notifies when the interlock closes.
        section, callbacks: Parts of the robot.
        start_timeout: Timeout for a program to begin and get its permission, in seconds.
        start_place: Place of the start permission. If it is empty, programs need no permission, however late they
            begin.
        who: Identity of the controller.
        clock: Monotonic clock, in seconds.
        limits: Limits of the session; None if it has none.
    """

    def __init__(
        self,
        primary: Connection,
        channel: CommandChannel,
        monitor: SafetyMonitor,
        section: Section,
        callbacks: CallbackThread,
        *,
        start_timeout: float,
        start_place: StartPlace,
        who: KnownIdentity,
        clock: Callable[[], float] = clock.now,
        limits: SessionLimits | None = None,
    ) -> None:
        self._primary = primary
        self._channel = channel
        self._monitor = monitor
        self._section = section
        self._callbacks = callbacks
        self._start_timeout = start_timeout
        self._start_place = start_place
        self._who = who
        self._clock = clock
        self._limits = limits
        self._token = os.urandom(2).hex()  # distinguishes these programs from programs of other processes
        self._numbers = itertools.count(1)
        self._start_tokens = itertools.count(int.from_bytes(os.urandom(4), "big"))
        #: Programs by name, in the order of sending. Each change is a single step, for signal handlers.
        self._runs: dict[str, _Run] = {}
        self._subscriptions: MadeOnce[list[Subscription]] = MadeOnce()
        self._mode: RobotModeData | None = None
        self._has_keys = False  # whether this controller sends key messages
        self._given_up = GivenUpProgram()
        #: Time when the last program ended. States received before that might show values from before its end.
        self.ended = -math.inf
        self._is_closed = False
        monitor.on_close(self._interlock_closed)
        # A text that was sent during the silence might not have arrived yet, and must not be executed later.
        monitor.on_silence(lambda seconds: channel.discard(seconds + _BEFORE))

    # -- sending -----------------------------------------------------------------------------------

    def allow(self, kind: str) -> None:
        """Raise `LimitExceeded` if this session does not allow a kind of command."""
        if self._limits is not None:
            self._limits.allow(kind)

    def life(self, name: str, kind: str | None = None) -> Lifecycle:
        """Return the life cycle of a program to be sent. By default, its brake stops the program.

        Args:
            name: Name of the program or motion, used in messages.
            kind: Kind of command that the session must allow; None for `name`.

        Raises:
            LimitExceeded: If this session does not allow this kind of command.
        """
        self.allow(kind or name)
        life = Lifecycle(name, self._callbacks, self._section.waiting)
        life.brake = lambda: self.stop(life)
        return life

    def wrap(self, source: str) -> Wrapped:
        """Wrap a user's source as a program.

        Raises:
            BadValue: If the source cannot be a program.
        """
        return wrapping.wrap(source, f"{self._token}_{next(self._numbers)}", self._permission)

    def own(self, body: Sequence[str], *, asks: bool = True) -> Wrapped:
        """Wrap lines generated by this library as a program; without `asks`, it begins without a permission."""
        return wrapping.program(self._name("urlink"), body, self._permission if asks else None)

    def _name(self, prefix: str) -> str:
        return f"{prefix}_{self._token}_{next(self._numbers)}"

    @property
    def _permission(self) -> Permission | None:
        firmware = self._who.identity.firmware
        place = self._start_place.on(firmware)
        if not place.tokens:
            return None
        token = 1 + next(self._start_tokens) % place.tokens
        return Permission(place, token, max(round(self._start_timeout * firmware.rate), 1))

    def start(
        self,
        wrapped: Wrapped,
        life: Lifecycle,
        *,
        is_motion: bool = True,
        is_stop: bool = False,
        is_linked: bool = False,
        is_detached: bool = False,
        left_alone: str = "it might still move the arm",
        on_text: Callable[[str], object] = lambda text: None,
        on_finish: Callable[[], object] | None = None,
    ) -> None:
        """Send a program, which preempts the running one unless it is a `sec`. See `_Run` for the other arguments.

        Args:
            is_stop: Whether the program can only bring the arm to rest; see `CommandChannel.motion`.
            is_linked: Whether the program connects back before it moves the arm.

        Raises:
            SafetyStop, NotRunning: If the arm may not be moved now. Nothing is sent.
            Closed: If the robot was closed.
            RemoteError: If the program could not be sent.
        """
        moves_late = not (wrapped.permission or is_linked or is_stop)
        finish = on_finish or life.finish
        run = _Run(wrapped, life, is_motion, moves_late, left_alone, on_text, finish, is_detached, self._clock())

        def claim() -> None:
            if self._is_closed:
                raise Closed("the robot was closed")
            if life.error is not None:
                raise life.error
            if not is_stop:
                raise_if(self._monitor.overtaken(life.order))
            run.sent = self._clock()
            self._runs[run.name] = run
            if self._monitor.flight is not None:
                self._monitor.flight.own(run.name)
            newest = self._newest()
            if newest is not run and newest is not None and not wrapped.is_secondary:
                # A signal handler sent that program between these lines. It is the newer one, although sent first.
                raise Cancelled(f"{life.name} was preempted by {newest.life.name}")

        def end() -> None:
            self.ended = self._clock()
            if self._runs.pop(run.name, None) is run and not wrapped.is_secondary:
                self._stop_kept()  # if this program has not begun, it has replaced nothing

        life.fire(Event.SEND)
        life.on_end(end)
        try:
            self._listen()
            replaces = not (is_stop or wrapped.is_secondary)
            self._channel.motion(wrapped.text, is_stop=is_stop, replaces=replaces, claim=claim)
        except Exception as error:
            life.fail(error)
            raise
        except BaseException:
            # The whole text, or a part of it, might have been sent.
            life.fail(Cancelled(f"{life.name} was interrupted"), brake=True)
            raise

    def stop(self, life: Lifecycle) -> None:
        """Stop the program of a life. If a later program was sent, its beginning stops the program instead.

        If the later program does not begin, because it does not compile or is abandoned too, the stop is sent at that
        moment.

        Raises:
            SafetyStop: If a stop is active, so the controller accepts no program. The program is stopped when the stop
                has ended, if it still exists.
            NotRunning: If the robot's state is unknown, so the program cannot be stopped from here.
            RemoteError: If the stop could not be sent.
        """
        run = next((run for run in self._pending() if run.life is life), None)
        if run is None or run.wrapped.is_secondary:
            return
        self._given_up.stop_sent = self._clock()
        self._note(GivenUpEvent.GIVE_UP, run.name)
        try:
            self._send_stop(lambda: self._newest() in (None, run))
            self._note(GivenUpEvent.DELIVER)  # this stops whichever program was running
        except Cancelled:
            self._note(GivenUpEvent.KEEP, run.name)
        except SafetyStop:
            self._note(GivenUpEvent.KEEP, run.name)
            raise

    def _note(self, event: GivenUpEvent, name: str | None = None) -> None:
        """Record an event of the abandoned program."""
        if name is None and self._given_up.phase is GivenUpPhase.NONE:
            return  # the usual case for each state; it needs no lock
        with self._section.lock:
            self._given_up.fire(event, name)

    def _send_stop(self, is_wanted: Callable[[], bool], *, wait: bool = True) -> None:
        def claim() -> None:
            if not is_wanted():
                raise Cancelled("the program has ended, or another program was sent after it")

        claim()  # and again after the channel has waited for data: another thread might send a program meanwhile
        text = wrapping.program(self._name("urlink_stop"), commands.stop(_DECELERATION)).text
        self._channel.motion(text, is_stop=True, claim=claim, wait=wait)

    @property
    def current(self) -> Lifecycle | None:
        """Life of the last motion, unless it has ended or a user's program was sent after it."""
        newest = self._newest()
        return newest.life if newest is not None and newest.is_motion and not newest.life.is_over else None

    @property
    def permitted(self) -> list[Lifecycle]:
        """Lives that have not ended and may move the arm: they have begun, or need no permission and no link."""
        runs = [run for run in self._pending() if run.has_begun or run.moves_late]
        return [run.life for run in runs if not run.life.is_over]

    def _newest(self) -> _Run | None:
        """Return the program that was sent last, unless it has ended."""
        return next((run for run in reversed(self._pending()) if not run.wrapped.is_secondary), None)

    def close(self, timeout: float) -> None:
        """Cancel the running program unless it is detached, start no more, and stop following programs. Idempotent.

        A program that was abandoned during a stop would continue when the stop ends. It would also continue if there
        was no real stop, because a safety mode that is in no list stops nothing. Such a program is given `timeout` or
        0.3 s, whichever is shorter, to be stopped.
        """
        if self._is_closed:
            return
        self._is_closed = True
        self._cancel_all("the robot was closed")
        forget(self)
        if self._section.may_wait:
            self._monitor.wait_for(lambda interlock: not self._given_up.is_kept, min(timeout, _CLOSING))
        if self._given_up.is_kept and self._mode is not None and self._mode.is_program_paused:
            name = self._given_up.name
            _log.warning("closed during a stop: %s is paused on the controller and might resume later", name)
        _close(self._subscriptions.take() or [])
        for run in self._pending():
            run.life.fail(
                ConnectionLost(f"the robot was closed while {run.life.name} was running; {self._what_if(run)}")
            )

    def abandon(self, why: str, is_end: bool) -> None:
        """See `linkcore.process`."""
        if is_end:
            self._is_closed = True  # before cancelling: another thread might be sending a program
        self._monitor.overtake(why)
        for run in self._cancel_all(why):
            _log.warning("%s was cancelled: %s and its robot was not closed", run.life.name, why)

    def _cancel_all(self, why: str) -> list[_Run]:
        """Cancel each program that would keep running; return the programs that were running.

        A `sec` cannot be stopped. It is short and runs in addition to the main program.
        """
        runs = [run for run in self._pending() if not (run.is_detached or run.wrapped.is_secondary)]
        return [run for run in runs if run.life.cancel(f"cancelled, since {why}", brake=True)]

    # -- messages of the controller ------------------------------------------------------------------

    def _listen(self) -> None:
        if self._subscriptions.made is not None:
            return
        abandon_at_end(self)
        subscriptions: list[Subscription] = []

        def only_once(on_packet: Callable[[Any], None], packet: Any) -> None:
            """Ignore packets of a second subscription, which another thread or a signal handler might add."""
            if self._subscriptions.made is subscriptions:
                on_packet(packet)

        try:
            on_packet = partial(only_once, self.on_packet)
            subscriptions.append(
                self._primary.subscribe_inline(State, on_packet, only_changes=self._needs_only_changes)
            )
            subscriptions.append(self._primary.subscribe_inline(ConnectionEvent, partial(only_once, self.on_event)))
        except BaseException:
            _close(subscriptions)
            raise
        if self._subscriptions.keep(subscriptions) is not subscriptions:
            _close(subscriptions)

    def on_event(self, event: ConnectionEvent) -> None:
        """Handle an event of the connection."""
        if event.state in (ConnectionState.CONNECTING, ConnectionState.CONNECTED):
            return
        self._note(GivenUpEvent.END)  # it is unknown which program the controller runs at the next connection
        why = f": {event.error}" if event.error is not None else ""
        for run in self._pending():
            if run.sent < event.received.monotonic:
                what = f"the connection was lost while {run.life.name} was running; {self._what_if(run)}{why}"
                # A motion ends as if by the interlock, which receives this event slightly earlier or later.
                run.life.fail(NotRunning(what) if run.is_motion else ConnectionLost(what))
        if event.state in (ConnectionState.IDLE, ConnectionState.CLOSED):  # gave up: subscribe again when needed
            self._subscriptions.take()

    def _needs_only_changes(self) -> bool:
        """Whether a robot state with the same modes as the previous one has no effect.

        This is so if each program is known to run, and none has to be stopped.
        """
        return self._given_up.phase is GivenUpPhase.NONE and all(run.is_settled for run in self._pending())

    def on_packet(self, packet: State) -> None:
        """Handle a packet of the primary interface."""
        if isinstance(packet, RobotState):
            mode = packet.robot_mode_data
            if mode is not None:
                self._on_mode(mode)
                self._after_stop(mode)
        elif isinstance(packet, KeyMessage):
            self._on_key(packet.title.strip(), packet.text.strip("\0 \n"))
        elif isinstance(packet, TextMessage):
            self._on_text(packet.text.strip("\0\n"))
        elif isinstance(packet, RuntimeExceptionMessage):
            self._on_exception(packet)

    def _on_key(self, title: str, name: str) -> None:
        run = self._runs.get(name)
        self._has_keys |= title in (_STARTED, _STOPPED)
        if title == _STOPPED and name == self._given_up.name:
            self._note(GivenUpEvent.END)
        if title == _STARTED and run is not None:
            self._begin(run)
        elif title == _STARTED:
            self._replace(name, None)
        elif title == _STOPPED and run is not None:
            self._end(run)

    def _on_text(self, text: str) -> None:
        for run in self._pending():
            if text == wrapping.start_marker(run.name):
                self._begin(run)
                if run.wrapped.permission is not None:
                    self._permit(run, run.wrapped.permission)
                return
            if text == wrapping.finish_marker(run.name):
                self._begin(run)
                self._report(run, None)
                return
            if text == wrapping.expiry_marker(run.name):
                why = f"got no start permission within {self._start_timeout:g} s, and has ended without moving the arm"
                run.life.fail(LinkTimeout(f"{run.life.name} {why}"))
                return
        for run in self._pending():
            if run.has_begun and not run.wrapped.is_secondary:
                run.on_text(text)

    def _permit(self, run: _Run, permission: Permission) -> None:
        """Give a program its start permission, if it is still wanted."""

        def claim() -> None:
            if not run.life.is_wanted:
                raise Cancelled(f"{run.life.name} has ended or was abandoned")
            raise_if(self._monitor.overtaken(run.life.order))

        try:
            # Do not wait: this is the reader thread.
            self._channel.motion(wrapping.grant(permission), claim=claim, wait=False)
        except LinkError as error:
            run.life.fail(error)

    def _on_exception(self, message: RuntimeExceptionMessage) -> None:
        awaited = [run for run in self._pending() if not run.has_begun]
        running = [run for run in self._pending() if run.has_begun]
        text = message.text.strip("\0\n")
        is_compiler = text.startswith(_COMPILER)
        candidates = awaited or ([] if is_compiler else running)
        if not candidates:
            _log.warning("the controller reports: %d:%d: %s", message.line, message.column, printable(text))
            return
        run = candidates[-1]
        place = run.wrapped.place(message.line, message.column)
        kind = ScriptFailed if run.has_begun and not is_compiler else CompileError
        error = kind(*place, run.wrapped.words(text))
        if run.has_begun:
            self._report(run, error)
        else:
            run.life.fail(error)

    def _on_mode(self, mode: RobotModeData) -> None:
        self._mode = mode
        # After this time, a cleared flag means that the program ended before a state could show that it was running.
        lag = _KEY_LAG if self._has_keys else _FLAG_LAG
        for run in self._pending():
            begun = run.life.happened(Event.BEGIN)
            if run.wrapped.is_secondary or begun is None:
                continue
            if mode.is_program_running or mode.is_program_paused:
                run.was_seen = True
            elif run.was_seen or run.life.happened(Event.REPORT) or self._clock() - begun.at > lag:
                self._end(run)
        self._check_time()

    def _after_stop(self, mode: RobotModeData) -> None:
        """Stop a program that was abandoned during a safety stop when that stop has ended; `play` would resume it.

        This also repeats the stop for a program that continues in spite of it, because an e-Series in local control
        ignores what it is sent.
        """
        if self._has_keys and self._clock() - self._given_up.stop_sent > _IGNORED:
            self._note(GivenUpEvent.MISS)
        was_clear = self._given_up.phase is GivenUpPhase.CLEAR
        self._note(GivenUpEvent.FREE if self._may_stop_kept() else GivenUpEvent.HINDER)
        # Wait for the second state without a stop: the controller reports the running program after the first one.
        if not (was_clear and self._given_up.phase is GivenUpPhase.CLEAR):
            return
        if mode.is_program_running or mode.is_program_paused:
            self._stop_kept()
        else:
            self._note(GivenUpEvent.END)

    def _stop_kept(self) -> None:
        """Send a stop to the kept program. If that is not possible now, the next state tries again."""
        if not self._may_stop_kept():
            return
        try:
            self._send_stop(self._may_stop_kept, wait=False)  # this might be the reader thread
            self._given_up.stop_sent = self._clock()
            # Without key messages, the end of the program is not reported.
            self._note(GivenUpEvent.DELIVER if self._has_keys else GivenUpEvent.END)
        except LinkError as error:
            _log.info("%s, which was abandoned, is not stopped yet: %s", self._given_up.name, error)

    def _may_stop_kept(self) -> bool:
        """Whether there is a kept program, no stop is active, and no newer program would be stopped instead."""
        return self._given_up.is_kept and self._newest() is None and self._monitor.refusal_to_stop() is None

    def _check_time(self) -> None:
        now = self._clock()
        for run in self._pending():
            stopped, report = run.life.happened(Event.STOP), run.life.happened(Event.REPORT)
            if stopped and now - stopped.at > _STOP_LAG:
                run.life.fail(ProgramStopped(f"{run.life.name} was stopped early by another client or a person"))
            elif report and report.error is not None and now - report.at > _AFTERMATH:
                self._end(run)
            elif not (run.has_begun and not run.wrapped.is_secondary) and now - run.sent > self._start_timeout:
                run.life.fail(self._never_began(run))

    def _never_began(self, run: _Run) -> LinkError:
        mode = self._mode
        if mode is None:
            situation = "the robot has not reported its mode either"
        else:
            runs = "a program is running" if mode.is_program_running else "no program is running"
            situation = f"the robot mode is {mode.robot_mode.name}, {runs}"
        what, hint = "end", ""
        if not run.has_begun:
            what = "begin"
            hint = f"; {self._what_if(run)}; an e-Series controller accepts no programs while it is in local control"
        return LinkTimeout(
            f"{run.life.name} did not {what} within {self._start_timeout:g} s; no error was reported; {situation}{hint}"
        )

    # -- progress of programs ----------------------------------------------------------------------

    def _pending(self) -> list[_Run]:
        return list(self._runs.values())

    def _begin(self, run: _Run) -> None:
        if run.has_begun:
            return
        if not run.wrapped.is_secondary:
            self._replace(run.name, run)
        run.life.begin(self._clock())

    def _replace(self, name: str, successor: _Run | None) -> None:
        """Handle the beginning of a program: all earlier programs have ended, even if no end was reported."""
        if name != self._given_up.name:
            self._note(GivenUpEvent.END)
        for run in self._pending():
            if run is successor:
                return
            if run.wrapped.is_secondary or (successor is None and not run.has_begun):
                continue
            if run.life.happened(Event.REPORT):
                self._end(run)
            elif successor is not None:
                run.life.cancel(f"preempted by {successor.life.name}")
            elif f"_{self._token}_" in name:  # a program of this object that was abandoned after it was sent
                run.life.cancel(f"preempted by {name}")
            else:
                run.life.fail(ProgramStopped(f"{run.life.name} was replaced by {name}, a program of another client"))

    def _report(self, run: _Run, error: ScriptError | None) -> None:
        """Record how a program ends. The controller reports the end itself later, except for a `sec`."""
        run.life.fire(Event.REPORT, error, at=self._clock())
        if run.wrapped.is_secondary:
            self._end(run)

    def _end(self, run: _Run) -> None:
        """Handle the end of a program. Its reason follows from earlier messages."""
        report = run.life.happened(Event.REPORT)
        if report and report.error is not None:
            run.life.fail(report.error)
        elif report:
            run.on_finish()
        elif (newest := self._newest()) is not None and newest is not run and not run.wrapped.is_secondary:
            run.life.cancel(f"preempted by {newest.life.name}")
        elif (stop := self._monitor.refusal_to_stop()) is not None:
            run.life.fail(stop)
        else:
            # The report of the stop might follow later.
            run.life.fire(Event.STOP, at=self._clock())

    def _interlock_closed(self, error: LinkError) -> None:
        if isinstance(error, SafetyStop):
            self._note(GivenUpEvent.MISS)  # the robot might have stopped before the stop was sent
        for run in self._pending():
            # After a stop, only programs that are requested again may begin.
            is_held = not run.has_begun and run.wrapped.permission is not None and isinstance(error, SafetyStop)
            if run.life.happened(Event.STOP) or is_held:
                run.life.fail(error)
            elif run.is_motion:
                if isinstance(error, SafetyStop) and not run.wrapped.is_secondary:
                    self._note(GivenUpEvent.KEEP, run.name)
                run.life.fail(NotRunning(f"{error}; {self._what_if(run)}") if isinstance(error, NotRunning) else error)

    def _what_if(self, run: _Run) -> str:
        """Describe what an abandoned program might still do, for messages."""
        if run.has_begun:
            return run.left_alone
        return f"if it begins later, {run.left_alone}" if run.moves_late else "it moves nothing if it begins later"


def _close(subscriptions: list[Subscription]) -> None:
    while subscriptions:  # emptied, because their callbacks refer to the list
        subscriptions.pop().close(0)

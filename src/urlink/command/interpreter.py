"""`robot.interpreter()`: a running program executes statements one by one (interpreter mode, port 30020).

This library generates the program. The program asks for permission as motions do, calls `interpreter_mode()`, and ends
when that call returns. Each statement might move the arm. Therefore statements are sent through the interlock, and only
until the life of the program has ended. At that moment the program on the robot is stopped, which also ends the mode.
"""

from __future__ import annotations

import contextlib
import logging
import threading
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

from linkcore import clock
from linkcore.arguments import check_callable, check_seconds, check_wait
from linkcore.errors import Cancelled, Closed, ConnectionLost, LinkError, LinkTimeout, LocalError, RemoteError
from linkcore.handle import Lifecycle
from linkcore.net.dialogue import Dialogue
from linkcore.net.transport import TcpTransport
from linkcore.net.undo import PendingUndos, Undo
from linkcore.pending_call import starts_motion
from linkcore.threads import CallbackThread
from linkcore.wire.fields import Since

from ..errors import NotRunning, SafetyStop, StatementDiscarded
from ..protocol.firmware import Firmware
from ..protocol.interpreter import InterpreterProtocol, parse_reply, statement_line
from ..protocol.ports import refusal_hint
from ..script import commands
from .channel import CommandChannel
from .programs import Programs
from .scripts import Program

_SINCE = Since("5.10")
#: Number of statements after which earlier statements are cleared on the controller, which keeps a limited number of
#: them. Public clients do the same.
CLEAR_AFTER = 500
#: Interval, in seconds, between two queries while waiting for the controller.
_POLL = 0.02
#: Timeouts for each reply, in seconds. The second one is for replies that no caller waits for any more.
_REPLY, _LAST_WORDS = 5.0, 0.5
#: Maximum time, in seconds, until the primary interface reports why interpreter mode has ended.
_REASON = 1.5

_log = logging.getLogger(__name__)


class InterpreterState(NamedTuple):
    """Progress of the controller. Statements are numbered from 1; 0 means no statement.

    Attributes:
        last_interpreted: Number of the last accepted statement.
        last_executed: Number of the last statement whose execution has begun.
        last_cleared: Number of the last cleared statement.
        unexecuted: Number of statements that were accepted but have not begun.
    """

    last_interpreted: int
    last_executed: int
    last_cleared: int
    unexecuted: int


class Interpreter(Program):
    """Handle of a program in interpreter mode; returned by `robot.interpreter()`.

    As a context manager, it ends the mode when every statement has been executed. If the block ends by an exception,
    the program is stopped and the arm brakes. `wait`, `done`, `error`, `cancel` and `texts` refer to the program that
    is in interpreter mode. Several threads can use the object; they take turns.
    """

    def __init__(
        self,
        life: Lifecycle,
        dialogue: Dialogue,
        channel: CommandChannel,
        undos: PendingUndos,
        undo: Undo[Any],
        finish_timeout: float,
    ) -> None:
        super().__init__(life)
        self._dialogue = dialogue
        self._channel = channel
        self._undos = undos
        self._undo = undo
        self._finish_timeout = finish_timeout
        #: Numbers of the statements that are not cleared. Several threads may add a number, each in one step.
        self._uncleared: list[int] = []

    @starts_motion
    def execute(self, statement: str, *, wait: bool | float = False) -> int:
        """Send a statement, which is executed when the statements before it have ended.

        If the controller does not reply, the statement **might still be executed** when a hung controller resumes; the
        error message then contains these words. The statement is undone at the first contact: a current motion is
        aborted, and statements that have not begun are discarded. This affects all statements sent so far.

        Args:
            statement: Complete URScript statement: a call, an assignment, or a whole ``if`` or ``def``. Its variables
                and functions are available to later statements.
            wait: Whether to wait until the statement has ended: False (not at all), True (up to 60 s), or a number of
                seconds.

        Returns:
            Number of the statement.

        Raises:
            BadValue: If `statement` is not a statement. Nothing is sent.
            StatementDiscarded: If the statement does not compile, or the program is not in interpreter mode.
            SafetyStop, NotRunning: If the arm may not be moved now. Nothing is sent.
            LinkTimeout: If the statement did not end in time (only with `wait`); it continues. Also if no reply
                arrives (see above), or if an abandoned command could not be undone yet; then nothing is sent.
            ConnectionLost: If the connection is lost before a reply arrives (see above).
            LinkError: If the statement could not be sent, or the program has ended with an error.
        """
        seconds = check_wait(wait)
        line = statement_line(statement)
        if len(self._uncleared) >= CLEAR_AFTER:
            self.wait_executed(self._finish_timeout)
            self.clear()
        number = self._hand_over(line, undo=self._undo)
        if seconds:
            self.wait_executed(seconds)
        return number

    def wait_executed(self, timeout: float = 60.0) -> None:
        """Wait until all sent statements have ended. As in `wait`, Ctrl-C during the wait cancels the mode.

        Raises:
            LinkTimeout: If the statements did not end in time; they continue.
            LinkError: If the program has ended with an error.
        """
        seconds = check_seconds(timeout, "timeout", finite=True)
        until = clock.now() + seconds
        # `last_executed` has begun, but might not have ended. The next statement begins when it has ended.
        try:
            barrier = self._hand_over("sync()")
            while self._ask("statelastexecuted") < barrier:
                left = until - clock.now()
                if left <= 0:
                    raise LinkTimeout(f"statements did not end within {seconds:g} s: {self.state}; they continue")
                clock.sleep(min(_POLL, left))
        except BaseException as error:
            self._give_up(error)
            raise

    def clear(self) -> int:
        """Clear executed statements on the controller, which keeps a limited number of them; return the number.

        This is itself a statement, executed in its turn. `execute` does it automatically after every 500 statements.
        """
        number = self._hand_over("clear_interpreter()")
        self._uncleared.clear()
        return number

    def abort(self) -> None:
        """End the current motion: the arm brakes, or begins the next statement. The interlock cannot refuse this."""
        self._ask("abort")

    def skip(self) -> None:
        """Discard the statements that have not begun. The interlock cannot refuse this."""
        self._ask("skipbuffer")

    @property
    def state(self) -> InterpreterState:
        """Progress of the controller: numbers of the last statements."""
        # These are separate requests, and statements are executed meanwhile. In this order, no statement is missed: a
        # statement that is no longer unexecuted is already among the executed statements.
        words = ("stateunexecuted", "statelastcleared", "statelastexecuted", "statelastinterpreted")
        unexecuted, cleared, executed, interpreted = map(self._ask, words)
        return InterpreterState(interpreted, executed, cleared, unexecuted)

    def end(self, timeout: float | None = None) -> None:
        """End the mode when every statement has been executed, and wait until its program has ended.

        It has no effect if the program has already ended.

        Args:
            timeout: Timeout in seconds; by default the `finish_timeout` of `robot.interpreter`.

        Raises:
            LinkTimeout: If the program did not end in time. It is cancelled, and the arm brakes.
            LinkError: If the program has ended with another error.
        """
        seconds = self._finish_timeout if timeout is None else check_seconds(timeout, "timeout", finite=True)
        try:
            if not self.done:
                self._hand_over("end_interpreter()")
            self.wait(seconds)
        finally:
            self._close()

    def __exit__(self, *exc: object) -> None:
        try:
            if exc[0] is None:
                self.end()
        finally:
            self._close()

    def _close(self) -> None:
        """End the program, if it has not ended, and close the connection."""
        # The handle can fail before the program ends: a program that was paused by a stop could be resumed later.
        is_left = isinstance(self.error, (SafetyStop, NotRunning, ConnectionLost))
        self.cancel()
        try:
            if is_left:
                for line in ("skipbuffer", "abort", "end_interpreter()"):
                    self._dialogue.ask(line, _LAST_WORDS)
        except LinkError as error:
            _log.info("%s: its program might still be waiting for statements: %s", self.name, error)
        finally:
            self._dialogue.close()

    # -- requests -------------------------------------------------------------------------------------

    def _hand_over(self, line: str, reason_within: float = _REASON, undo: Undo[Any] | None = None) -> int:
        """Send a statement through the interlock and return its number.

        Args:
            reason_within: Time to wait, in seconds, for the reason if no program accepts statements.
            undo: Undo of the statement, for the case that it is abandoned.
        """

        def gate(send: Callable[[], object]) -> None:
            def send_if_wanted() -> None:
                if self._life.is_over:
                    raise self._life.error or Cancelled(f"{self.name} has ended")
                send()

            self._channel.setpoint(send_if_wanted)

        with self._undos.command("interpreter", _REPLY, undo) as given_up:
            reply = parse_reply(self._dialogue.ask(line, _REPLY, gate=gate, given_up=given_up))
        if reply.word != "ack":
            if not reply.number:
                # No program accepts statements any more. The primary interface reports the reason a little later.
                with contextlib.suppress(LinkTimeout, LocalError):
                    self.wait(reason_within)
            if self._life.error is not None:
                raise self._life.error
            raise StatementDiscarded(line, reply.number)
        self._uncleared.append(reply.number)
        return reply.number

    def _ask(self, word: str) -> int:
        """Send a command word; return the number in the controller's reply."""
        if self._life.error is not None:
            raise self._life.error
        return parse_reply(self._dialogue.ask(word, _REPLY)).number


class Interpreters:
    """Starts interpreter mode.

    Args:
        host: Host name or IP address of the controller.
        port: Port of its interpreter mode; None if the controller does not serve it.
        programs, channel, callbacks: Parts of the robot.
        firmware: Function that returns the current firmware of the controller.
        undos: Pending undos of the commands to this controller.
        timeout: Timeout for a connection, in seconds.
        sent: Function that is called with the sent statements; None for none.
    """

    def __init__(
        self,
        host: str,
        port: int | None,
        programs: Programs,
        channel: CommandChannel,
        callbacks: CallbackThread,
        firmware: Callable[[], Firmware],
        undos: PendingUndos,
        timeout: float,
        sent: Callable[[bytes | memoryview], object] | None = None,
    ) -> None:
        self._sent = sent
        self._host = host
        self._port = port
        self._programs = programs
        self._channel = channel
        self._callbacks = callbacks
        self._firmware = firmware
        self._undos = undos
        self._timeout = timeout
        #: Connections of the interpreters that were started and have not ended.
        self._open: list[Dialogue] = []
        self._opening = threading.RLock()  # held while `_open` is replaced; re-entrant for signal handlers
        self._is_closed = False

    def close(self) -> None:
        """Close the remaining connections; their programs have already been stopped."""
        with self._opening:
            self._is_closed = True
            opened, self._open = self._open, []
        for dialogue in opened:
            dialogue.close()

    @starts_motion
    def begin(
        self, start_timeout: float, finish_timeout: float, on_text: Callable[[str], object] | None
    ) -> Interpreter:
        """See `Robot.interpreter`."""
        until = clock.now() + check_seconds(start_timeout, "start_timeout", positive=True, finite=True)
        check_seconds(finish_timeout, "finish_timeout", finite=True)
        if on_text is not None:
            check_callable(on_text, "on_text")
        if self._is_closed:
            raise Closed(f"the robot at {self._host} was closed")
        firmware = self._firmware()
        if firmware not in _SINCE:
            raise LocalError(f"firmware {firmware} has no interpreter mode; 5.10 or later is required")
        if self._port is None:
            raise LocalError("the controller does not serve interpreter mode")
        self._programs.allow("interpreter.execute")
        connection = partial(_connection, self._host, self._port, self._firmware, self._timeout, self._sent)
        dialogue = connection()
        with self._opening:
            if self._is_closed:
                raise Closed(f"the robot at {self._host} was closed")
            self._open = [each for each in self._open if not each.is_closed] + [dialogue]
        life = self._programs.life("interpreter mode", "interpreter.execute")
        undo = Undo(connection, partial(_undo_statements, life))
        interpreter = Interpreter(life, dialogue, self._channel, self._undos, undo, finish_timeout)
        receive = interpreter._receiver(self._callbacks, on_text)
        try:
            # If the service is switched off, this fails before the running program is replaced.
            parse_reply(dialogue.ask("statelastexecuted", _REPLY))
            wrapped = self._programs.own(commands.interpreter_mode())
            self._programs.start(
                wrapped, life, left_alone="it continues with the statements that were sent", on_text=receive
            )
            self._await_mode(interpreter, until, start_timeout)
        except BaseException:
            interpreter._close()
            raise
        return interpreter

    def _await_mode(self, interpreter: Interpreter, until: float, timeout: float) -> None:
        """Wait until the controller accepts a statement."""
        while True:
            if interpreter.done:
                interpreter.wait()
                raise RemoteError(f"{interpreter.name} ended before it accepted a statement")
            try:
                # The program might not be in the mode yet, which is not a failure.
                interpreter._hand_over("sync()", reason_within=0.0)
                return
            except StatementDiscarded:
                left = until - clock.now()
            if left <= 0:
                raise LinkTimeout(f"{interpreter.name} did not begin within {timeout:g} s")
            clock.sleep(min(_POLL, left))


def _connection(
    host: str,
    port: int,
    firmware: Callable[[], Firmware],
    timeout: float,
    sent: Callable[[bytes | memoryview], object] | None,
) -> Dialogue:
    """Return a client of interpreter mode, which connects when it is first used."""
    transport = TcpTransport(host, port, silence=_REPLY, refused=lambda: refusal_hint(firmware()))
    transport.sent = sent
    return Dialogue(transport, InterpreterProtocol, f"interpreter mode at {transport.name}", timeout)


def _undo_statements(life: Lifecycle, dialogue: Dialogue, is_wanted: Callable[[], bool]) -> None:
    """Abort the current motion and discard statements that have not begun; end an abandoned program."""
    if is_wanted():
        dialogue.ask("statelastexecuted", _REPLY)  # any reply counts as contact
    for line in ("skipbuffer", "abort", *(("end_interpreter()",) if life.is_over else ())):
        if is_wanted():
            dialogue.ask(line, _REPLY)

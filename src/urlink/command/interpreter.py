"""`robot.interpreter()`: statements that a running program takes one by one (interpreter mode, port 30020).

The program is one of the library's own: it asks for permission as motions do, calls `interpreter_mode()`, and ends when
that returns. Each statement may move the arm, so it leaves through the interlock, and only as long as the program's
life is not over. What ends the life ends the program on the robot, and with it the mode.
"""

from __future__ import annotations

import contextlib
import logging
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
#: Statements after which those before are cleared on the controller, which keeps a limited number of them. As public
#: clients do it.
CLEAR_AFTER = 500
#: Seconds between two queries while waiting for the controller.
_POLL = 0.02
#: Seconds for each reply, also for one whose caller waits no longer.
_REPLY, _LAST_WORDS = 5.0, 0.5
#: Seconds within which the primary interface has to report why interpreter mode has ended.
_REASON = 1.5

_log = logging.getLogger(__name__)


class InterpreterState(NamedTuple):
    """The controller's progress; statements are numbered from 1, and 0 stands for none.

    Attributes:
        last_interpreted: the last statement that it has accepted.
        last_executed: the last that it has begun to execute.
        last_cleared: the last that it has cleared.
        unexecuted: how many it has accepted and not begun.
    """

    last_interpreted: int
    last_executed: int
    last_cleared: int
    unexecuted: int


class Interpreter(Program):
    """Interpreter mode while it lasts; made by `robot.interpreter()`.

    As a context manager it ends the mode once every statement has been executed; where the block is left by an
    exception the program is stopped, and the arm brakes. It is the handle of the program that is in the mode, so
    `wait`, `done`, `error`, `cancel` and `texts` are that program's. Threads may share it; they take turns.
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
        self._since_clear = 0

    @starts_motion
    def execute(self, statement: str, *, wait: bool | float = False) -> int:
        """Hand a statement over; it begins once those before it are over.

        If no answer comes, it **may still be carried out**, when a controller that hung goes on; the error says so. It
        is undone at the first contact: what moves then is aborted, and what was not begun is thrown away, which is
        all that was handed over.

        Args:
            statement: of URScript, complete: a call, an assignment, a whole ``if`` or ``def``. What it assigns and
                defines is there for later statements.
            wait: until it is over: False not at all, True for up to 60 s, a number for so many seconds.

        Returns:
            its number.

        Raises:
            BadValue: it is not a statement; nothing was sent.
            StatementDiscarded: it does not compile, or the program is not in interpreter mode.
            SafetyStop, NotRunning: the arm may not be moved now; nothing was sent.
            LinkTimeout: with `wait`, it was not over in time; it goes on.
            LinkTimeout, ConnectionLost: no answer came, see above; or what was given up before could not be undone
                yet, and this was not sent.
            LinkError: it could not be sent, or what has ended the program.
        """
        seconds = check_wait(wait)
        line = statement_line(statement)
        if self._since_clear >= CLEAR_AFTER:
            self.wait_executed(self._finish_timeout)
            self.clear()
        number = self._hand_over(line, undo=self._undo)
        if seconds:
            self.wait_executed(seconds)
        return number

    def wait_executed(self, timeout: float = 60.0) -> None:
        """Wait until everything that was handed over is over; Ctrl-C meanwhile cancels the mode, as in `wait`.

        Raises:
            LinkTimeout: it was not in time; it goes on.
            LinkError: what has ended the program.
        """
        seconds = check_seconds(timeout, "timeout", finite=True)
        until = clock.now() + seconds
        # `last_executed` is the statement that has begun, not one that has ended; a later one begins when it has ended.
        try:
            barrier = self._hand_over("sync()")
            while self._ask("statelastexecuted") < barrier:
                left = until - clock.now()
                if left <= 0:
                    raise LinkTimeout(f"statements were not executed within {seconds:g} s: {self.state}; they go on")
                clock.sleep(min(_POLL, left))
        except BaseException as error:
            self._give_up(error)
            raise

    def clear(self) -> int:
        """Let the controller forget the statements that were executed, of which it keeps a limited number.

        It is a statement of its own and has its turn; `execute` does it after each 500 by itself. Returns its number.
        """
        number = self._hand_over("clear_interpreter()")
        self._since_clear = 0
        return number

    def abort(self) -> None:
        """End the motion that is being executed: the arm brakes, or goes over to the next statement. Without asking the
        interlock."""
        self._ask("abort")

    def skip(self) -> None:
        """Throw away the statements that were not begun. Without asking the interlock."""
        self._ask("skipbuffer")

    @property
    def state(self) -> InterpreterState:
        """How far the controller is."""
        # One request after the other, and statements go on meanwhile. In this order no statement is missing from all:
        # what has left the unexecuted is among the executed.
        words = ("stateunexecuted", "statelastcleared", "statelastexecuted", "statelastinterpreted")
        unexecuted, cleared, executed, interpreted = map(self._ask, words)
        return InterpreterState(interpreted, executed, cleared, unexecuted)

    def end(self, timeout: float | None = None) -> None:
        """End the mode once everything is executed, and wait for the end of its program. Without effect if it is over.

        Args:
            timeout: seconds; by default what `robot.interpreter` was given as `finish_timeout`.

        Raises:
            LinkTimeout: it was not over in time; it was cancelled, and the arm brakes.
            LinkError: what else has ended the program.
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
        """End the program where it has not ended, and the connection."""
        # Its handle can fail before the program is over: a program that a stop has paused could be resumed later.
        is_left = isinstance(self.error, (SafetyStop, NotRunning, ConnectionLost))
        self.cancel()
        try:
            if is_left:
                for line in ("skipbuffer", "abort", "end_interpreter()"):
                    self._dialogue.ask(line, _LAST_WORDS)
        except LinkError as error:
            _log.info("%s: its program may still wait for statements: %s", self.name, error)
        finally:
            self._dialogue.close()

    # -- what is reported -----------------------------------------------------------------------------

    def _hand_over(self, line: str, reason_within: float = _REASON, undo: Undo[Any] | None = None) -> int:
        """A statement, through the interlock; its number.

        Args:
            reason_within: seconds to wait for the reason where no program takes statements.
            undo: undoes it where it is given up.
        """

        def gate(send: Callable[[], object]) -> None:
            def send_if_wanted() -> None:
                if self._life.is_over:
                    raise self._life.error or Cancelled(f"{self.name} is over")
                send()

            self._channel.setpoint(send_if_wanted)

        with self._undos.command("interpreter", _REPLY, undo) as given_up:
            reply = parse_reply(self._dialogue.ask(line, _REPLY, gate=gate, given_up=given_up))
        if reply.word != "ack":
            if not reply.number:
                # No program takes statements any more. What ended it comes over the primary interface, a little later.
                with contextlib.suppress(LinkTimeout, LocalError):
                    self.wait(reason_within)
            if self._life.error is not None:
                raise self._life.error
            raise StatementDiscarded(line, reply.number)
        self._since_clear += 1
        return reply.number

    def _ask(self, word: str) -> int:
        """The number with which the controller answers a command word."""
        if self._life.error is not None:
            raise self._life.error
        return parse_reply(self._dialogue.ask(word, _REPLY)).number


class Interpreters:
    """Begins interpreter mode.

    Args:
        host: of the controller.
        port: of its interpreter mode; None where it is not served.
        programs, channel, callbacks: of the robot.
        firmware: of the controller at present.
        undos: of the commands to this controller.
        timeout: seconds for a connection.
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
    ) -> None:
        self._host = host
        self._port = port
        self._programs = programs
        self._channel = channel
        self._callbacks = callbacks
        self._firmware = firmware
        self._undos = undos
        self._timeout = timeout
        #: the connections of those that were begun and not ended
        self._open: list[Dialogue] = []
        self._is_closed = False

    def close(self) -> None:
        """Disconnect what was not ended; its programs have been stopped."""
        self._is_closed = True
        for dialogue in self._open:
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
            raise LocalError(f"firmware {firmware} has no interpreter mode; the first that has it is 5.10")
        if self._port is None:
            raise LocalError("the controller does not serve interpreter mode")
        connection = partial(_connection, self._host, self._port, self._firmware, self._timeout)
        dialogue = connection()
        self._open = [each for each in self._open if not each.is_closed] + [dialogue]
        life = self._programs.life("interpreter mode")
        undo = Undo(connection, partial(_undo_statements, life))
        interpreter = Interpreter(life, dialogue, self._channel, self._undos, undo, finish_timeout)
        receive = interpreter._receiver(self._callbacks, on_text)
        try:
            # Refused before the arm's program is replaced, where the service is switched off.
            parse_reply(dialogue.ask("statelastexecuted", _REPLY))
            wrapped = self._programs.own(commands.interpreter_mode())
            self._programs.start(wrapped, life, left_alone="its program executes what it has taken", on_text=receive)
            self._await_mode(interpreter, until, start_timeout)
        except BaseException:
            interpreter._close()
            raise
        return interpreter

    def _await_mode(self, interpreter: Interpreter, until: float, timeout: float) -> None:
        """Until the controller takes a statement."""
        while True:
            if interpreter.done:
                interpreter.wait()
                raise RemoteError(f"{interpreter.name} was over before it began")
            try:
                # It may not be in the mode yet, which is not a failure.
                interpreter._hand_over("sync()", reason_within=0.0)
                return
            except StatementDiscarded:
                left = until - clock.now()
            if left <= 0:
                raise LinkTimeout(f"{interpreter.name} has not begun within {timeout:g} s")
            clock.sleep(min(_POLL, left))


def _connection(host: str, port: int, firmware: Callable[[], Firmware], timeout: float) -> Dialogue:
    """Talks to interpreter mode, over a connection that is made when it is needed."""
    transport = TcpTransport(host, port, silence=_REPLY, refused=lambda: refusal_hint(firmware()))
    return Dialogue(transport, InterpreterProtocol, f"interpreter mode at {transport.name}", timeout)


def _undo_statements(life: Lifecycle, dialogue: Dialogue, is_wanted: Callable[[], bool]) -> None:
    """Abort what moves and throw away what has not begun; where the program was given up too, end it."""
    if is_wanted():
        dialogue.ask("statelastexecuted", _REPLY)  # the contact
    for line in ("skipbuffer", "abort", *(("end_interpreter()",) if life.is_over else ())):
        if is_wanted():
            dialogue.ask(line, _REPLY)

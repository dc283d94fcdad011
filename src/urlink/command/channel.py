"""The command channel: the only path by which text that can move the arm is sent.

The decision is made in the robot's critical section (`urlink.command.section`), and within the same section the
bytes go to the kernel by a system call that does not wait: after a stop was received, nothing is sent. A text nearly
always fits into the kernel's buffer whole. Where it does not, because the controller does not read, the section is
left, the sender waits for room, and the decision is made anew. If sending is refused by then, the connection is
aborted: the controller never receives the rest of that text, nor another text in the middle of it.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable

from linkcore import clock
from linkcore.errors import ConnectionLost, LinkTimeout
from linkcore.net.undo import PendingUndos
from linkcore.pending_call import check_wanted, regardless
from linkcore.streaming.connection import Connection

from .safety_monitor import SafetyMonitor
from .section import Section

#: Seconds that the controller may take to accept text.
SEND_TIMEOUT = 0.5
#: Seconds for what was given up to be undone, before what is newer supersedes it.
_UNDO_TIMEOUT = 1.0
#: Seconds between two looks whether another thread has got rid of its text.
_PAUSE = 0.001


class CommandChannel:
    """Sends to a robot, if the interlock lets it.

    Args:
        connection: takes URScript text: of the primary interface.
        monitor: asked before anything is sent.
        section: the critical section of the robot.
        clock: seconds that only grow.
        undos: of the commands to this controller; None for one of its own.
    """

    def __init__(
        self,
        connection: Connection,
        monitor: SafetyMonitor,
        section: Section,
        clock: Callable[[], float] = clock.now,
        undos: PendingUndos | None = None,
    ) -> None:
        self._undos = PendingUndos(connection.name) if undos is None else undos
        self._connection = connection
        self._monitor = monitor
        self._section = section
        self._clock = clock
        #: the text of which only a part has left
        self._unfinished: _Text | None = None
        self._sent_at = -math.inf

    def check(self) -> None:
        """Raise what a motion would be refused with now; waits for what is not known yet of the robot.

        Raises:
            SafetyStop: a stop holds; NotEnabled if only `safety.enable()` is missing.
            NotRunning: the robot does not run, or nothing is known of it.
        """
        self._prepare(moves=True)
        self._monitor.require()

    def _prepare(self, moves: bool) -> None:
        self._monitor.listen(closely=moves)
        self._monitor.await_news(moves)

    def motion(
        self,
        text: str,
        *,
        is_stop: bool = False,
        replaces: bool = False,
        claim: Callable[[], object] = lambda: None,
        wait: bool = True,
    ) -> None:
        """Send URScript that may move the arm.

        What was given up and may still be carried out is undone before, where that can be done within a second.

        Args:
            text: whole lines; the last newline may be left out.
            is_stop: it can only bring the arm to rest. An arm that nobody has enabled can move all the same, by a
                program that went on while nothing could be received from it, and can then be stopped.
            replaces: it is a program that replaces the one that runs, and with it what was given up and was not
                undone.
            claim: called in the section, whenever it has been decided that the text may leave; what it raises keeps
                the text from leaving.
            wait: for what is not known yet of the robot, and for room; False sends now or not at all.

        Raises:
            SafetyStop: a stop holds; NotEnabled if only `safety.enable()` is missing.
            NotRunning: the robot does not run, or nothing is known of it.
            RemoteError: it could not be sent.
        """
        if wait:
            self._prepare(moves=True)
            if not is_stop and self._section.may_wait:
                self._undos.settle(_UNDO_TIMEOUT)

        def decide() -> None:
            self._monitor.require(is_stop)
            claim()

        self._send(text, decide, SEND_TIMEOUT if wait else 0.0)
        if replaces:
            self._undos.drop()

    def overtake(self, why: str) -> None:
        """Send no motion whose call was entered before this moment; `why` names the stop, for messages."""
        self._monitor.overtake(why)

    def command(self, text: str) -> None:
        """Send URScript that moves nothing: outputs, payload, popups. It needs no more than a running robot.

        Raises:
            NotRunning: the robot does not run, or nothing is known of it.
            RemoteError: it could not be sent.
        """
        self._prepare(moves=False)
        self._send(text, self._monitor.require_running, SEND_TIMEOUT)

    def check_running(self) -> None:
        """Raise what a command would be refused with now; waits for what is not known yet of the robot.

        Raises:
            NotRunning: the robot does not run, or nothing is known of it.
        """
        self._prepare(moves=False)
        self._monitor.require_running()

    def beside(self, send: Callable[[], object]) -> None:
        """Let `send` send a command, which moves nothing, over another connection; it must not wait.

        Raises:
            NotRunning: the robot does not run; `send` was not called.
            Exception: whatever `send` raises.
        """
        with self._section.lock:
            self._monitor.require_running()
            send()

    def setpoint(self, send: Callable[[], object], *, is_stop: bool = False) -> None:
        """Let `send` send something that moves the arm, or that stops it, over another connection; it must not wait.

        Raises:
            SafetyStop, NotRunning: as `motion`; `send` was not called.
            Exception: whatever `send` raises.
        """
        with self._section.lock:
            refusal = self._monitor.refusal_to_stop() if is_stop else self._monitor.refusal_to_begin()
            if refusal is None:
                send()
                return
        # This process may have been held up, and has states to read that arrived meanwhile.
        self._monitor.await_news(moves=True)
        with self._section.lock:
            self._monitor.require(is_stop)
            send()

    def discard(self, seconds: float) -> None:
        """Where anything was sent in the last `seconds`, see to it that it does not arrive any more.

        The connection is aborted, which the stream makes again. What has arrived has arrived.
        """
        if self._clock() - self._sent_at <= seconds:
            self._sent_at = -math.inf
            self._connection.abort()

    def _send(self, text: str, decide: Callable[[], object], timeout: float) -> None:
        outgoing = _Text((text.rstrip("\n") + "\n").encode())
        until = self._clock() + timeout
        try:
            while True:
                with self._section.lock:
                    if self._has_turn(outgoing):
                        self._send_some(outgoing, decide)
                if not outgoing.rest:
                    return
                left = until - self._clock()
                if left <= 0.0:
                    break
                if self._unfinished in (None, outgoing):
                    self._connection.wait_for_room(left)
                else:
                    clock.sleep(_PAUSE)
        finally:
            # Part of it has left, and time is up, the rest is refused, or the waiting for room was interrupted.
            if self._unfinished is outgoing:
                with self._section.lock:
                    self._give_up()
        raise LinkTimeout(
            f"the controller has not taken a text of {outgoing.size} bytes within {timeout:g} s; it was not sent"
        )

    def _has_turn(self, text: _Text) -> bool:
        """Nobody else is in the middle of a text. With the section."""
        if self._unfinished in (None, text):
            return True
        if self._unfinished.thread == threading.get_ident():
            # A signal handler has interrupted its thread, which waits for room: the controller does not read.
            self._give_up()
            raise ConnectionLost(
                "the controller had taken only a part of the text before this one, so the connection was aborted"
            )
        return False

    def _send_some(self, text: _Text, decide: Callable[[], object]) -> None:
        """Send what the kernel takes. With the section."""
        connection = self._connection
        number = connection.counters.connections
        if text.is_begun and (self._unfinished is not text or number != text.number):
            raise ConnectionLost(f"{connection.name} was connected anew while a text was sent")
        text.number = number
        # Not between the decision and the sending: what is claimed would never leave.
        check_wanted()
        decide()
        self._sent_at = self._clock()
        text.rest = text.rest[regardless(lambda: connection.send_some(text.rest)) :]
        self._unfinished = text if text.is_begun and text.rest else None

    def _give_up(self) -> None:
        """Part of a text has left: nobody must see the rest of it, or take what follows for the rest."""
        unfinished, self._unfinished = self._unfinished, None
        if unfinished is not None and unfinished.number == self._connection.counters.connections:
            self._connection.abort()


class _Text:
    """A text that is being sent; `rest` is what has not left."""

    def __init__(self, data: bytes) -> None:
        self.rest = memoryview(data)
        self.size = len(data)
        self.thread = threading.get_ident()
        #: which connection it leaves by
        self.number: int | None = None

    @property
    def is_begun(self) -> bool:
        """A part of it has left."""
        return len(self.rest) < self.size

"""The command channel: the only path by which text that can move the arm is sent.

The decision whether to send is made in the robot's critical section (`urlink.command.section`). Within the same
section, the bytes are passed to the kernel by a system call that does not block. Therefore nothing is sent after a stop
was received. The kernel's buffer nearly always has room for the whole text. If the controller does not read, so that
there is no room, the sender leaves the section, waits for room, and makes the decision again. If sending is refused by
then, the connection is aborted. So the controller never receives the rest of that text, and never receives another text
in the middle of it.
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

#: Maximum time, in seconds, for the controller to accept a text.
SEND_TIMEOUT = 0.5
#: Maximum time, in seconds, to wait for pending undos before a newer command is sent.
_UNDO_TIMEOUT = 1.0
#: Interval, in seconds, for checking whether another thread has finished sending its text.
_PAUSE = 0.001


class CommandChannel:
    """Sends URScript text to a robot, if the interlock permits it.

    Args:
        connection: Connection to the primary interface, which receives the URScript text.
        monitor: Safety monitor that decides whether a text may be sent.
        section: Critical section of the robot.
        clock: Monotonic clock, in seconds.
        undos: Pending undos of the commands to this controller. If None, a new `PendingUndos` is created.
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
        #: The text that was sent only partly.
        self._unfinished: _Text | None = None
        self._sent_at = -math.inf

    def check(self) -> None:
        """Raise the error that would refuse a motion now, after waiting for missing safety data.

        Raises:
            SafetyStop: If a stop is active; its subclass `NotEnabled` if only `safety.enable()` is missing.
            NotRunning: If the robot is not running, or its state is unknown.
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
        """Send URScript that might move the arm.

        If possible within one second, abandoned commands that might still be executed are undone first.

        Args:
            text: Whole lines of URScript; the last newline can be omitted.
            is_stop: Whether the text can only bring the arm to rest. Such a text needs no `enable()`: an arm that is
                not enabled can still move if its program continued while no data arrived from the robot.
            replaces: Whether the text is a program that replaces the running one. It then also replaces the abandoned
                commands that were not undone.
            claim: Function that is called in the section after each decision that the text may be sent. If the function
                raises, the text is not sent.
            wait: Whether to wait for missing safety data and for room in the buffer. With False, the text is sent
                immediately or not at all.

        Raises:
            SafetyStop: If a stop is active; its subclass `NotEnabled` if only `safety.enable()` is missing.
            NotRunning: If the robot is not running, or its state is unknown.
            RemoteError: If the text could not be sent.
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
        """Block every motion that was called before this moment; `why` names the stop in error messages."""
        self._monitor.overtake(why)

    def command(self, text: str) -> None:
        """Send URScript that moves nothing, such as outputs, payload or popups. It needs only a running robot.

        Raises:
            NotRunning: If the robot is not running, or its state is unknown.
            RemoteError: If the text could not be sent.
        """
        self._prepare(moves=False)
        self._send(text, self._monitor.require_running, SEND_TIMEOUT)

    def check_running(self) -> None:
        """Raise the error that would refuse a command now, after waiting for missing safety data.

        Raises:
            NotRunning: If the robot is not running, or its state is unknown.
        """
        self._prepare(moves=False)
        self._monitor.require_running()

    def beside(self, send: Callable[[], object]) -> None:
        """Call `send` to send a command that moves nothing over another connection; `send` must not wait.

        Raises:
            NotRunning: If the robot is not running; `send` is not called.
            Exception: If `send` raises an exception, it is passed on.
        """
        with self._section.lock:
            self._monitor.require_running()
            send()

    def setpoint(self, send: Callable[[], object], *, is_stop: bool = False) -> None:
        """Call `send` to move or stop the arm over another connection; `send` must not wait.

        Raises:
            SafetyStop, NotRunning: See `motion`; `send` is not called.
            Exception: If `send` raises an exception, it is passed on.
        """
        with self._section.lock:
            refusal = self._monitor.refusal_to_stop() if is_stop else self._monitor.refusal_to_begin()
            if refusal is None:
                send()
                return
        # This process might have been delayed, and might have to read states that arrived meanwhile.
        self._monitor.await_news(moves=True)
        with self._section.lock:
            self._monitor.require(is_stop)
            send()

    def discard(self, seconds: float) -> None:
        """Abort the connection if a text was sent in the last `seconds`, so that this text does not arrive later.

        The stream reconnects afterwards. Text that has already arrived is not affected.
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
            # A part of the text was sent, and then the time ran out, the rest was refused, or the wait was interrupted.
            if self._unfinished is outgoing:
                with self._section.lock:
                    self._give_up()
        raise LinkTimeout(
            f"the controller did not accept a text of {outgoing.size} bytes within {timeout:g} s; it was not sent"
        )

    def _has_turn(self, text: _Text) -> bool:
        """Whether no other text is partly sent. The caller must hold the section's lock."""
        if self._unfinished in (None, text):
            return True
        if self._unfinished.thread == threading.get_ident():
            # This signal handler has interrupted a thread that is waiting for room, so the controller does not read.
            self._give_up()
            raise ConnectionLost(
                "the controller accepted only a part of the previous text, so the connection was aborted"
            )
        return False

    def _send_some(self, text: _Text, decide: Callable[[], object]) -> None:
        """Send as many bytes as the kernel accepts. The caller must hold the section's lock."""
        connection = self._connection
        number = connection.counters.connections
        if text.is_begun and (self._unfinished is not text or number != text.number):
            raise ConnectionLost(f"{connection.name} was reconnected while a text was sent")
        text.number = number
        # Check before `decide()`: raising after it would leave a claim without its text being sent.
        check_wanted()
        decide()
        self._sent_at = self._clock()
        text.rest = text.rest[regardless(lambda: connection.send_some(text.rest)) :]
        self._unfinished = text if text.is_begun and text.rest else None

    def _give_up(self) -> None:
        """Abort the connection after a partly sent text, whose rest must not arrive.

        Otherwise the controller would also take the next text for that rest.
        """
        unfinished, self._unfinished = self._unfinished, None
        if unfinished is not None and unfinished.number == self._connection.counters.connections:
            self._connection.abort()


class _Text:
    """A text that is being sent; `rest` is the part that has not been sent."""

    def __init__(self, data: bytes) -> None:
        self.rest = memoryview(data)
        self.size = len(data)
        self.thread = threading.get_ident()
        #: Number of the connection over which the text is sent.
        self.number: int | None = None

    @property
    def is_begun(self) -> bool:
        """Whether a part of the text has been sent."""
        return len(self.rest) < self.size

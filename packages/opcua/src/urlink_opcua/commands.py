"""Commands of clients to one robot: permission, order, deadlines, and the report of each command.

Each command passes the same checks in the same order. Then a thread executes it. A stop has a separate thread, so that
it never waits for another command. A stop also abandons the commands that were requested before it.
"""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import logging
import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from concurrent.futures import TimeoutError as FutureTimeout

from asyncua import ua
from asyncua.crypto.permission_rules import User

from urlink import (
    BadValue,
    Cancelled,
    ConnectFailed,
    ConnectionLost,
    Expiry,
    LimitExceeded,
    LinkError,
    LinkTimeout,
    LocalError,
    PendingCall,
    Robot,
)

from .access import Operator

__all__ = ["PROGRAMS", "STOP", "Outcome", "RobotCommands"]

_log = logging.getLogger("urlink.opcua")

#: Time, in s, for which a request waits for its command. Other requests on the same connection wait as long.
_PATIENCE = 0.5
#: Maximum number of requested commands that have not ended.
_MOST = 32

STOP = "StopProgram"


def _play(robot: Robot) -> None:
    # The dashboard does not check the interlock, so that `--require-enable` would have no effect on programs.
    refusal = robot.safety.refusal
    if refusal is not None:
        raise refusal
    robot.dashboard.play()


def _stop(robot: Robot) -> None:
    dashboard = ThreadPoolExecutor(1, "stop program")
    answer = dashboard.submit(robot.dashboard.stop)
    dashboard.shutdown(wait=False)
    try:
        answer.result(_PATIENCE)
    except (FutureTimeout, LinkError) as error:
        # An e-Series in local mode refuses, and a dashboard might hang or be lost. Then a script stops the arm.
        _log.info("the dashboard did not stop a program (%r); stopping the arm with a script", error)
        robot.motion.stop()


#: Methods without arguments: name -> function that executes it.
PROGRAMS: dict[str, Callable[[Robot], object]] = {
    "PlayProgram": _play,
    "PauseProgram": lambda robot: robot.dashboard.pause(),
    STOP: _stop,
}


@dataclasses.dataclass(frozen=True)
class Outcome:
    """Result of a command.

    Attributes:
        name: Name of the command.
        client: Name and address of the client.
        status: Status code that the client receives, or would have received.
        message: Text of the error; "" for none.
    """

    name: str
    client: str
    status: int = ua.StatusCodes.Good
    message: str = ""


class RobotCommands:
    """Commands to one robot.

    Args:
        name: Name of the robot.
        robot: Robot to command.
        allow: Whether to accept commands.
        expiry: Check that rejects commands after an interruption of this process.
        report: Function that receives the outcome of each command of a client with credentials. It is called in the
            thread that executed the command, or in the thread of the server.
    """

    def __init__(
        self, name: str, robot: Robot, *, allow: bool, expiry: Expiry, report: Callable[[Outcome], object]
    ) -> None:
        self._name = name
        self._robot = robot
        self._allow = allow
        self._expiry = expiry
        self._report = report
        self._is_closed = False
        self._pending: set[PendingCall] = set()
        self._lock = threading.RLock()  # for `_pending`, which several threads change
        self._played: str | None = None
        self._lanes = {lane: ThreadPoolExecutor(1, f"{name} {lane}") for lane in ("programs", "registers", "stops")}

    async def execute(self, name: str, user: User, client: str, lane: str, call: Callable[[], object]) -> ua.StatusCode:
        """Check a command, and execute it; return the status for its client.

        If the command takes longer than half a second, the status is GoodCompletesAsynchronously. If the connection
        that requested the command is lost, the command is abandoned.

        Args:
            name: Name of the command, for messages.
            user: User of the session.
            client: Address of the client.
            lane: Thread that executes the command: "programs", "registers" or "stops".
            call: Function that executes the command.
        """
        who = f"{getattr(user, 'name', None) or 'unknown'} ({client})"
        error = self._refusal(user, is_stop=lane == "stops")
        if error is not None:
            status, text = error
            _log.warning("%s: refused %s of %s: %s", self._name, name, who, text)
            if isinstance(user, Operator):  # other clients must not overwrite the last outcome
                self._report(Outcome(name, who, status, text))
            return ua.StatusCode(status)
        pending = PendingCall()
        if lane == "stops":
            self._abandon()
        with self._lock:
            self._pending.add(pending)
        if self._is_closed:  # closed in the meantime, by another thread
            pending.give_up()
        task = asyncio.current_task()
        lost = _give_up(pending)
        if task is not None and lane != "stops":
            # asyncua serves each connection in one task, which ends with the connection.
            task.add_done_callback(lost)
        try:
            future: Future[Outcome] = self._lanes[lane].submit(self._work, name, who, pending, call)
        except RuntimeError:
            self._forget(pending)
            return ua.StatusCode(ua.StatusCodes.BadServerHalted)
        if task is not None:
            future.add_done_callback(_forget_lost(task, lost, asyncio.get_running_loop()))
        done, _ = await asyncio.wait([asyncio.wrap_future(future)], timeout=_PATIENCE)
        if not done:
            return ua.StatusCode(ua.StatusCodes.GoodCompletesAsynchronously)
        return ua.StatusCode(future.result().status)

    def _refusal(self, user: User, *, is_stop: bool) -> tuple[int, str] | None:
        if self._is_closed:
            return ua.StatusCodes.BadServerHalted, "the server is ending"
        if not self._allow:
            return (
                ua.StatusCodes.BadNotExecutable,
                "this server accepts no commands; start it with --allow and without --read-only",
            )
        if not isinstance(user, Operator):
            return ua.StatusCodes.BadUserAccessDenied, "the client has not logged in with a password or certificate"
        if user.has_expired:
            return ua.StatusCodes.BadUserAccessDenied, "the certificate of the client has expired"
        if is_stop:
            return None  # a late stop is better than no stop
        try:
            self._expiry.check()
        except LinkTimeout as error:
            return ua.StatusCodes.BadTimeout, str(error)
        if len(self._pending) >= _MOST:
            return ua.StatusCodes.BadTooManyOperations, f"{_MOST} commands have not ended yet"
        return None

    def _work(self, name: str, who: str, pending: PendingCall, call: Callable[[], object]) -> Outcome:
        """Execute a command in the thread of its lane."""
        outcome = Outcome(name, who)
        try:
            if pending.is_given_up:
                raise Cancelled("abandoned before it was executed, by a stop or because its client was lost")
            pending.make(call)
        except Exception as error:
            if not isinstance(error, LinkError):
                _log.exception("%s: %s failed", self._name, name)
            outcome = Outcome(name, who, _status(error), str(error))
        finally:
            self._forget(pending)
        if outcome.message:
            _log.warning("%s: %s of %s failed: %s", self._name, name, who, outcome.message)
        else:
            _log.info("%s: %s of %s was executed", self._name, name, who)
            if name == "PlayProgram":
                self._played = who
            elif name == STOP:
                self._played = None
        self._report(outcome)
        return outcome

    def _forget(self, pending: PendingCall) -> None:
        with self._lock:
            self._pending.discard(pending)

    def _abandon(self) -> None:
        """Abandon every command that has not ended."""
        with self._lock:
            pending = tuple(self._pending)
        for each in pending:
            _give_up(each)(None)

    def close(self) -> None:
        """Refuse further commands, abandon pending ones, and report a program that is still running. Idempotent.

        It does not wait for a command that is being executed. Each of them has a deadline.
        """
        if self._is_closed:
            return
        self._is_closed = True
        self._abandon()
        for lane in self._lanes.values():
            lane.shutdown(wait=False, cancel_futures=True)
        if self._played is None:
            return
        with contextlib.suppress(LinkError):
            state = self._robot.realtime.latest
            if state is not None and state.program_state is not None and state.program_state.name == "PLAYING":
                _log.warning(
                    "%s: the program that %s started is still running; this server no longer stops it",
                    self._name,
                    self._played,
                )


def _give_up(pending: PendingCall) -> Callable[[object], None]:
    """Return a function that abandons the command in another thread, because this might send a stop to the robot."""

    def give_up(task: object) -> None:
        pending.give_up(lambda call: threading.Thread(target=call, name="undo", daemon=True).start())

    return give_up


def _forget_lost(
    task: asyncio.Task[object], lost: Callable[[object], None], loop: asyncio.AbstractEventLoop
) -> Callable[[object], None]:
    """Return a function that detaches an ended command from its connection."""

    def forget(future: object) -> None:
        with contextlib.suppress(RuntimeError):  # the loop has ended
            loop.call_soon_threadsafe(task.remove_done_callback, lost)

    return forget


def _status(error: Exception) -> int:
    for kind, status in (
        (BadValue, ua.StatusCodes.BadInvalidArgument),
        (Cancelled, ua.StatusCodes.BadOperationAbandoned),
        (LinkTimeout, ua.StatusCodes.BadTimeout),
        ((ConnectFailed, ConnectionLost), ua.StatusCodes.BadCommunicationError),
        (LimitExceeded, ua.StatusCodes.BadInvalidState),
        (LocalError, ua.StatusCodes.BadNotSupported),
        (LinkError, ua.StatusCodes.BadInvalidState),
    ):
        if isinstance(error, kind):
            return int(status)
    return int(ua.StatusCodes.BadInternalError)

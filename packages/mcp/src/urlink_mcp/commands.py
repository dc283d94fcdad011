"""Requests that change something on one robot: checks, the question to a person, checks again, and execution.

Everything here is called in the event loop of the server. Calls of the robot block, so they run in threads. A stop has
its own thread, so that it never waits for another request. A stop also abandons the requests that came before it.
"""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections.abc import Awaitable, Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

import anyio
import numpy as np

from linkcore import clock
from urlink import Cancelled, Expiry, LinkError, LinkTimeout, LocalError, Motion, PendingCall, Robot
from urlink.packets import ProgramState, RealtimeState
from urlink.tools import shown_tcp

from .actions import Action, OfRobot, SetDigitalOutput, prepare
from .questions import Question, Questions, check_answer
from .readings import fresh_state
from .request_log import Client, RequestLog

__all__ = ["Answer", "RobotCommands"]

T = TypeVar("T")

#: Largest turn of a joint in rad, and largest change of an element of the TCP in m and rad, at which the arm counts as
#: unmoved since the question. Chosen: ten times the noise of the encoders in recordings of real arms.
_UNMOVED, _SAME_TCP = 2e-3, 1e-3
#: Maximum time, in s, for the arm to come to rest after a stop, and for the state to show that a program has ended.
_BRAKING, _ENDING = 5.0, 1.0

#: What a person did with a question, and the values of the form.
Answer = tuple[str, Mapping[str, Any] | None]


class RobotCommands:
    """Commands of clients to one robot.

    Args:
        name: Name of the robot.
        robot: Robot to command. It must have limits of the session.
        expiry: Check that rejects requests after an interruption of this process.
        log: Log of requests.
        consent_time: Seconds for which a person can answer.
        motion_time: Seconds after which a motion is stopped.
        now: Monotonic clock, in seconds.

    Raises:
        LocalError: If the robot has no limits of the session, or was connected with ``read_only=True``.
    """

    def __init__(
        self,
        name: str,
        robot: Robot,
        *,
        expiry: Expiry,
        log: RequestLog,
        consent_time: float,
        motion_time: float,
        now: Callable[[], float] = clock.now,
    ) -> None:
        if robot.limits is None:
            raise LocalError(f"{name} has no limits of the session; connect with limits=, or start with --limits")
        self._motions = robot.motion
        self.name = name
        self._robot = robot
        self._expiry = expiry
        self._log = log
        self._motion_time = motion_time
        self._questions = Questions(consent_time, now)
        self._mover: Client | None = None
        self._calls: set[PendingCall] = set()
        self._is_closed = False
        self._lanes = {lane: ThreadPoolExecutor(1, f"{name} {lane}") for lane in ("checks", "commands", "stops")}

    # -- question --------------------------------------------------------------------------------------

    async def prepare(self, client: Client, tool: str, given: OfRobot, arguments: Mapping[str, Any]) -> Question:
        """Check a request, and return the question to the person who decides.

        Nothing is sent to the robot. Impossible requests are refused here, before a person is asked.

        Raises:
            LinkError: If the request is refused.
        """
        call = PendingCall()
        self._check_accepting()
        self._expiry.check()
        self._log.check()
        action = await self._in_lane("checks", lambda: self._checked(given))
        question = Question(client, tool, arguments, action, call, self._questions.now() + self._questions.time)
        self._questions.add(question)
        self._note(question, "question", text=action.sentence)
        return question

    def text(self, question: Question) -> str:
        """Return the question in plain sentences."""
        robot = self._robot
        return (
            f"{self.name} ({robot.model or 'an arm'} at {robot.address}): {question.action.sentence} "
            f"Requested by {question.client}. Do you allow this? "
            f"An answer counts for {self._questions.time:g} s."
        )

    def _checked(self, given: OfRobot) -> Action:
        refusal = self._robot.safety.refusal
        if refusal is not None:
            raise refusal
        state = fresh_state(self._robot) if isinstance(given, SetDigitalOutput) else self._idle_state()
        return prepare(self._robot, state, given)

    def _idle_state(self) -> RealtimeState:
        """Return the state of a robot without a running program, because a motion would end this program."""
        until = clock.now() + _ENDING
        while True:
            state = fresh_state(self._robot)
            if state.program_state in (None, ProgramState.STOPPED):
                return state
            if clock.now() >= until:
                raise LocalError(
                    f"a program or another motion is {state.program_state.name} on {self.name}, and a motion would end "
                    "it; wait for its end, or call stop"
                )
            clock.sleep(0.01)

    # -- answer and execution --------------------------------------------------------------------------

    async def decide(self, question: Question, ask: Callable[[str, float], Awaitable[Answer | None]]) -> dict[str, Any]:
        """Ask a person while the request waits, and execute the request if the person consents.

        Args:
            question: Question that `prepare` returned.
            ask: Function that shows a text for some seconds. It returns the answer, or None if there was none.

        Raises:
            LinkError: If the request is refused, or its motion fails.
        """
        try:
            answer = await ask(self.text(question), max(question.until - self._questions.now(), 0.0))
        except BaseException:
            self._forget(question)
            self._note(question, "abandoned before an answer")
            raise
        if answer is None:
            self._forget(question)
            self._note(question, "no answer")
            raise LinkTimeout(f"no person answered within {self._questions.time:g} s; nothing was sent")
        return await self.answered(question.client, question.id, question.tool, question.arguments, answer)

    async def answered(
        self, client: Client, id: str, tool: str, arguments: Mapping[str, Any], answer: Answer
    ) -> dict[str, Any]:
        """Execute a request if a person has consented; return how it ended.

        Args:
            client: Client that sends the answer.
            id: Secret of the question.
            tool, arguments: Request of the client, which must be the one of the question.
            answer: What the person did with the question.

        Raises:
            LinkError: If the request is refused, or its motion fails.
        """
        try:
            question = self._questions.take(id, tool, arguments)
        except LinkError as error:
            self._log.note(client, self.name, tool, "refused", acts=True, reason=str(error))
            raise
        try:
            check_answer(*answer)
            self._note(question, "consented")
            self._check_accepting()
            self._questions.check(question)
            self._expiry.check()
            self._log.check()
            said = await self._execute(question)
        except LinkError as error:
            self._note(question, "refused or failed", reason=str(error))
            raise
        except asyncio.CancelledError:
            self._note(question, "cancelled by its client, or by a lost connection")
            raise
        self._note(question, "done", **said)
        return said

    async def _execute(self, question: Question) -> dict[str, Any]:
        call, moves = question.call, question.action.moves
        if moves and self._mover is not None:
            raise LocalError(f"{self._mover} is moving the arm; wait for the end of this motion, or call stop")
        if moves:
            self._mover = question.client
        self._calls.add(call)
        try:
            motion = await self._in_lane("commands", lambda: self._start(question))
            if motion is None:
                return {"phase": "done"}
            self._note(question, "started")
            await self._end_of(motion, call)
            return {"phase": motion.phase.value}
        except BaseException:
            # Also if the client cancels, or its connection is lost: no client waits for this motion.
            _give_up(call)
            raise
        finally:
            self._calls.discard(call)
            if moves:
                self._mover = None

    def _start(self, question: Question) -> Motion | None:
        if question.action.moves:
            self._check_unmoved(question.action)
        return question.call.make(question.action.execute)

    def _check_unmoved(self, action: Action) -> None:
        state = self._idle_state()
        turned = float(np.abs(state.q_actual - action.q).max())
        if not turned <= _UNMOVED or state.qd_target.any():
            raise LocalError("the arm has moved since the question; the consent was for a motion from another position")
        changed = float(np.abs(shown_tcp(self._robot.kinematics, state) - action.tcp).max())
        if not changed <= _SAME_TCP:
            raise LocalError("the TCP has changed since the question; send the request again")

    async def _end_of(self, motion: Motion, call: PendingCall) -> None:
        """Wait for the end of a motion, and stop the motion after its time.

        Raises:
            LinkError: If the motion did not reach its end.
        """
        loop, ended = asyncio.get_running_loop(), asyncio.Event()

        def tell(motion: Motion) -> None:
            with contextlib.suppress(RuntimeError):  # the loop has ended
                loop.call_soon_threadsafe(ended.set)

        motion.add_done_callback(tell)
        with anyio.move_on_after(self._motion_time):
            await ended.wait()
        if not ended.is_set():
            _give_up(call)
            with anyio.move_on_after(_BRAKING):
                await ended.wait()
            raise LinkTimeout(
                f"the motion did not end within {self._motion_time:g} s; it was cancelled, and the arm brakes"
            )
        if motion.error is not None:
            raise motion.error

    # -- stop ------------------------------------------------------------------------------------------

    async def stop(self, client: Client) -> dict[str, Any]:
        """Stop the arm, and abandon all requests that came before. It needs no consent, and is never too late.

        Raises:
            LinkError: If the stop cannot be sent, for example during a safety stop, in which the arm is at rest.
        """
        self._abandon()
        self._log.note(client, self.name, "stop", "asked", acts=True)
        # Shielded, because a stop must not be abandoned with its client.
        stopped = asyncio.ensure_future(
            self._in_lane("stops", lambda: self._motions.stop(wait=_BRAKING)),
        )
        try:
            await asyncio.shield(stopped)
        except LinkError as error:
            self._log.note(client, self.name, "stop", "failed", acts=True, reason=str(error))
            raise
        self._log.note(client, self.name, "stop", "done", acts=True)
        return {"phase": "done", "at_rest": True}

    def close(self) -> None:
        """Refuse further requests, abandon pending ones, and stop their motions; idempotent."""
        self._is_closed = True
        self._abandon()
        for lane in self._lanes.values():
            lane.shutdown(wait=False, cancel_futures=True)

    def _abandon(self) -> None:
        self._questions.abandon(_give_up)
        for call in tuple(self._calls):
            _give_up(call)

    # -- used by several -------------------------------------------------------------------------------

    def _check_accepting(self) -> None:
        if self._is_closed:
            raise Cancelled("the server is ending; nothing was sent")

    def _forget(self, question: Question) -> None:
        _give_up(question.call)
        with contextlib.suppress(LocalError):
            self._questions.take(question.id, question.tool, question.arguments)

    def _note(self, question: Question, event: str, **details: Any) -> None:
        self._log.note(question.client, self.name, question.tool, event, acts=True, **details)

    async def _in_lane(self, lane: str, call: Callable[[], T]) -> T:
        try:
            future = self._lanes[lane].submit(call)
        except RuntimeError:
            raise Cancelled("the server is ending; nothing was sent") from None
        return await asyncio.wrap_future(future)


def _give_up(call: PendingCall) -> None:
    """Abandon a call. What this sends to the robot is sent in other threads, so that the event loop never waits."""
    call.give_up(lambda undo: threading.Thread(target=undo, name="undo", daemon=True).start())

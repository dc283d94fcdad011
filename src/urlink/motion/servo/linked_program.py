"""Program on the robot with a link to this computer, and the messages to this program.

In each cycle of the controller, a real-time state arrives and is answered with a message. So the controller's clock
sets the pace. A `LinkDialogue` decides the messages. Each message contains the cycle of the newest state. The program
compares this cycle with its own cycle count, and ignores messages that are too old (`urlink.script.links`). Therefore
messages that were delayed in the socket of a hung controller do not move the arm.

If no states arrive, the interlock ends every motion after one second. The program on the robot brakes earlier.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, Protocol

from linkcore.errors import ConnectionLost, LinkError, LocalError
from linkcore.handle import Event, Lifecycle, Phase
from linkcore.streaming.packet_queue import latest
from linkcore.streaming.subscription import Subscription

from ...command.program_time import MOVED, ControllerTimer, Pause, is_paused
from ...errors import ProgramStopped, ToleranceExceeded
from ...protocol.realtime.packets import RealtimeState
from ...script import links
from ...script.messages import dated
from ...session.session_limits import WATCHED
from ..context import MotionContext
from ..limited import LimitedArm
from .following import stands
from .setpoints import LinkDialogue

#: Time in s within which the program must connect.
CONNECT_TIMEOUT = 5.0
#: Time in s to wait after a lost connection, because the reason may still arrive over the other interfaces.
_GRACE = 1.0
#: Time in s after the last message, on the controller's clock. After this time, the motion ends if the arm is at rest,
#: even if the end of the program was not reported.
_END_TIMEOUT = 1.0
#: Events after which a motion will end.
_ENDING = (Event.LOSE, Event.BRAKE, Event.SETTLE)


def _nothing() -> None:
    pass


class Link(Protocol):
    """Link to the program: `ReverseLink`, `RegisterLink` or `PointRegisterLink`. None of its methods waits."""

    @property
    def endpoint(self) -> Any:
        """Address or registers, and token, for the text of the program.

        The dialogue determines the type.
        """

    @property
    def is_up(self) -> bool:
        """Whether the program can receive messages."""

    def poll(self, has_begun: bool) -> bool:
        """Check whether the link is up now.

        Args:
            has_begun: Whether the controller has started the program.
        """

    def send(self, data: bytes) -> None:
        """Send a message; raise `LinkError` if the connection is lost."""

    def received(self) -> bytes:
        """Return the bytes from the program since the last call; raise `ConnectionLost` if the connection is lost."""

    def absence(self, why: str) -> LinkError:
        """Return the error for a link that does not come up."""

    def close(self, *, farewell: bool) -> None:
        """Close the link; with `farewell`, deliver the last message first. Idempotent."""


class LinkedProgram:
    """Program of one motion on the robot, its link to this computer, and the messages over this link.

    Args:
        life: Life cycle of the motion.
        context: The robot.
        dialogue: Dialogue that decides the messages.
        open_link: Function that opens the link to the program. It may raise `LinkError`.
        tolerance: Largest distance of any joint, in rad, that the arm may be moved during a pause. After the pause, the
            position is compared with the position where the arm came to rest.
        on_linked: Function that urlink calls when the first message has been sent, and when no more messages will be
            sent. The function may be called more than once.
    """

    def __init__(
        self,
        life: Lifecycle,
        context: MotionContext,
        dialogue: LinkDialogue,
        open_link: Callable[[], Link],
        *,
        tolerance: float = MOVED,
        on_linked: Callable[[], object] = _nothing,
    ) -> None:
        self._life = life
        self._context = context
        self._dialogue = dialogue
        self._open_link = open_link
        self._on_linked = on_linked
        self._pause = Pause(life.name, tolerance)
        self._clock = context.clock
        self._link: Link | None = None
        self._subscription: Subscription | None = None
        self._cycle = 1.0 / context.who.identity.firmware.rate
        self._controller = ControllerTimer(self._cycle)
        #: time in s on the controller's clock from the first state to the newest one
        self._passed = 0.0
        #: monotonic time in s at which the newest state was processed; set after the first state
        self._seen: float
        #: the arm of a session with limits, during a motion that cannot be predicted
        self._watched: LimitedArm | None = None
        self._owes_farewell = False  # whether the link has to deliver its last message when it is closed

    def begin(self) -> None:
        """Open the link, and send the program.

        Raises:
            SafetyStop, NotRunning: If the arm may not be moved now. No port is opened and nothing is sent.
            LinkError: If the program cannot be started for another reason. The life cycle of the motion has then ended.
        """
        life, context = self._life, self._context
        life.brake = self._brake
        try:
            context.channel.check()
            if life.name in WATCHED:
                self._watched = context.limited_at_rest()
            self._link = link = self._open_link()
            on_state = partial(self._on_state, link, self._clock())
            self._subscription = context.realtime._connection.subscribe(
                RealtimeState, on_state, policy=latest, in_place=partial(self._takes_steady, link)
            )
            life.on_end(self._release)
            context.programs.start(
                # The program needs no start permission, because it cannot move the arm after the end of the motion: its
                # connection is then refused, or its token is not written.
                context.programs.own(self._dialogue.body(link.endpoint), asks=False),
                life,
                is_linked=True,
                left_alone="its program on the robot brakes on its own",
                on_text=self._on_text,
                on_finish=self._on_finish,
            )
        except BaseException as error:
            if isinstance(error, Exception):
                life.fail(error)
            else:
                life.fail(LocalError(f"{life.name} was interrupted"), brake=True)
            self._release()
            raise

    def say(self, data: bytes) -> None:
        """Send data to the program if the interlock permits it and the motion is running.

        Raises:
            SafetyStop, NotRunning: If the arm may not be moved now.
            ConnectionLost: If the connection is lost.
            LinkError: If the motion has ended. The error states the reason.
        """
        self._context.channel.setpoint(lambda: self._transmit(data))

    def feed(self, data: bytes, watchdog: float) -> None:
        """Send a message from the user's loop, unless the newest state is too old.

        If no state has arrived for `watchdog` seconds, the message is not sent, because it would be too old for the
        program. A hung controller would read such a message later, and would drive the arm at full speed to the
        set-point. If no state has arrived for twice this time, the program has braked or the controller hangs.
        Therefore the motion ends.

        Raises:
            ConnectionLost: If no state has arrived for twice the time of the watchdog.
            LinkError: If `say` raises this error.
        """
        silence = self._clock() - self._seen
        if silence > 2.0 * watchdog:
            error = ConnectionLost(
                f"the robot has sent no state for {silence:.2f} s, more than twice watchdog={watchdog:g} s, so the "
                "program on the robot accepts no messages; it brakes on its own. A larger watchdog= tolerates "
                "longer delays"
            )
            self._life.fail(error, brake=True)
            raise error
        if silence <= watchdog and not self._pause.holds:
            self.say(data)

    @property
    def is_paused(self) -> bool:
        """Whether the program is paused. A paused program accepts no messages.

        The newest state is also checked, because a user's loop may receive a state before the thread that answers
        states.
        """
        newest = self._context.realtime.latest
        return self._pause.holds or (newest is not None and is_paused(newest))

    def _transmit(self, data: bytes) -> None:
        if self._life.error is not None:
            raise self._life.error
        # Another thread may have ended the program after this message was composed. In a register, the message would
        # then overwrite the stop. A task that started the motion may also have been cancelled meanwhile. Then only the
        # stop may be sent.
        if (self.is_finishing or not self._life.is_wanted) and data != self._dialogue.farewell:
            return
        assert self._link is not None
        self._link.send(self._dated(data))

    def _dated(self, data: bytes) -> bytes:
        """Add the date of the newest state and the number of pauses to a message of the dialogue.

        A program that ends on its own requests each point by its number. Messages to such a program need no date.
        """
        if not self._dialogue.farewell:
            return data
        return dated(data, round(self._passed / self._cycle), self._pause.count)

    def finish(self) -> None:
        """End the program. The motion ends when the program has ended.

        Raises:
            LinkError: If the message could not be sent.
        """
        # Fire the event before sending, because the program may end before this thread continues.
        if self._life.fire(Event.BRAKE, at=self._passed) and self._dialogue.farewell:
            self._owes_farewell = True
            self.say(self._dialogue.farewell)

    @property
    def is_finishing(self) -> bool:
        """Whether the message that ends the program was sent."""
        return self._life.happened(Event.BRAKE) is not None

    def lose(self, error: LinkError) -> None:
        """Handle a lost connection. The primary interface might still report the reason why the program stopped."""
        lost = ConnectionLost(f"the connection of the program on the robot was lost; it brakes on its own: {error}")
        self._life.fire(Event.LOSE, lost, at=self._clock())

    # -- events --------------------------------------------------------------------------------------

    def _on_state(self, link: Link, sent: float, state: RealtimeState) -> None:
        if self._life.is_over:
            return
        try:
            self._look(link, sent, state)
        except LinkError as error:
            self._life.fail(error, brake=True)
        except Exception as error:
            # After an unexpected exception, the arm must not be left without set-points, and no thread may wait
            # forever.
            self._life.fail(error, brake=True)
            raise

    def _takes_steady(self, link: Link, state: RealtimeState) -> bool:
        """Process a steady state of a simulated controller in place of the thread that answers states.

        Return False if this thread must do it, because a message might have to be sent, or the motion might end.
        """
        life, pause = self._life, self._pause
        if not (self._dialogue.is_mute and life.happened(Event.LINK)) or pause.holds or pause.is_over:
            return False
        if self._watched is not None or life.is_over or any(map(life.happened, _ENDING)):
            return False
        try:
            received = link.received()
        except ConnectionLost:
            return False
        self._dialogue.step(received, state, self._note(state))
        return True

    def _note(self, state: RealtimeState) -> float:
        """Record the arrival of a state; return its time, in s of the monotonic clock."""
        now = self._seen = self._clock()
        self._passed += self._controller.passed(state.time, now)
        return now

    def _look(self, link: Link, sent: float, state: RealtimeState) -> None:
        now = self._note(state)
        if self._watched is not None and not self.is_finishing:
            self._watched.watch(state.q_actual, state.qd_actual, yields=self._life.name == "force_mode")
        lost, braked = self._life.happened(Event.LOSE), self._life.happened(Event.BRAKE)
        if self._life.happened(Event.SETTLE):
            self._dialogue.step(b"", state, now)
            if self._dialogue.is_over:
                self._life.finish()
        elif lost and lost.error is not None:
            if now - lost.at > _GRACE:
                self._life.fail(lost.error)
        elif braked:
            if self._passed - braked.at > _END_TIMEOUT and stands(state.qd_actual):
                if self.is_paused:
                    self._context.programs.stop(self._life)
                self._life.finish()
        elif link.is_up or link.poll(self._life.phase is Phase.RUNNING):
            self._talk(link, state, now)
        elif now - sent > CONNECT_TIMEOUT:
            self._life.fail(link.absence(f"it did not connect within {CONNECT_TIMEOUT:g} s"), brake=True)

    def _talk(self, link: Link, state: RealtimeState, now: float) -> None:
        if self._pause.look(state):
            # A paused program reads no messages. A message would be queued, and would be too old when the program
            # continues.
            return
        if self._pause.is_over:
            self._pause.is_over = False
            self._dialogue.resume(state)
        try:
            answer = self._dialogue.step(link.received(), state, now)
            if answer:
                self.say(answer)
            self._life.fire(Event.LINK)
            self._on_linked()
            if self._dialogue.is_over:
                self.finish()
        except ConnectionLost as error:
            self.lose(error)

    def _on_text(self, text: str) -> None:
        error: LinkError
        if text.startswith(links.NO_CONNECTION):
            assert self._link is not None
            error = self._link.absence("it reported that it was refused, or found no route")
        elif text.startswith(links.LINK_ENDED):
            error = ConnectionLost("the program on the robot reported that its connection ended; it brakes on its own")
        elif text.startswith(links.STARVED):
            watchdog = self._dialogue.watchdog
            within = "" if watchdog is None else f" (watchdog={watchdog:g} s)"
            error = ConnectionLost(
                f"no message reached the program on the robot in time{within}; it brakes on its own. Send more often, "
                "or pass a larger watchdog="
            )
        elif text.startswith(links.TOO_FAR):
            error = ToleranceExceeded("the program on the robot reported that the first point is too far away")
        else:
            return
        if not self.is_finishing:
            self._life.fail(error)

    def _on_finish(self) -> None:
        lost = self._life.happened(Event.LOSE)
        if self.is_finishing:
            self._life.finish()
        elif self._dialogue.survives_its_program:
            self._dialogue.conclude()
            self._life.fire(Event.SETTLE)
        elif lost and lost.error is not None:
            self._life.fail(lost.error)
        else:
            self._life.fail(ProgramStopped(f"the program of {self._life.name} ended unexpectedly"))

    def _brake(self) -> None:
        link = self._link
        if link is not None and link.is_up and self._dialogue.farewell:
            self._owes_farewell = True
            self._context.channel.setpoint(lambda: link.send(self._dated(self._dialogue.farewell)), is_stop=True)
            if not self.is_paused:
                return
        # A paused program reads no messages. After the pause, it would continue for some cycles before it reads this
        # one.
        self._context.programs.stop(self._life)

    def _release(self) -> None:
        self._on_linked()
        self._on_linked = _nothing  # breaks a reference cycle through the handle
        subscription, self._subscription = self._subscription, None
        if subscription is not None:
            # Do not wait for the callback of the subscription, because it may be running in this thread.
            subscription.close(0)
        if self._link is not None:
            self._link.close(farewell=self._owes_farewell)

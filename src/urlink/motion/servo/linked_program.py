"""A program on the robot that is linked to this computer, and the messages that are sent to it.

Each real-time state that arrives, one per cycle of the controller, is answered with a message, so the controller's
clock sets the pace. A `LinkDialogue` decides the messages. Each message carries the cycle of the newest
state, by which the program counts one as none that is too old (`urlink.script.links`): so messages that waited in the
socket of a controller that hung do not lead the arm. If no state arrives, the interlock closes after a second, which
ends every motion; the program on the robot brakes sooner.
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
from ..context import MotionContext
from ..links.messages import dated
from .following import stands
from .setpoints import LinkDialogue

#: Seconds within which the program must connect.
CONNECT_TIMEOUT = 5.0
#: Seconds after a lost connection in which its reason may arrive over the other interfaces.
_GRACE = 1.0
#: Seconds on the controller's clock after the last message, from which on an arm that stands still ends the motion
#: though the end of the program was not reported.
_END_TIMEOUT = 1.0


def _nothing() -> None:
    pass


class Link(Protocol):
    """The link to the program: `ReverseLink`, `RegisterLink` or `PointRegisterLink`. None of its methods waits."""

    @property
    def endpoint(self) -> Any:
        """Its address or registers, and its token, for the text of the program: of the kind that the dialogue takes."""

    @property
    def is_up(self) -> bool:
        """Whether the program can receive messages."""

    def poll(self, has_begun: bool) -> bool:
        """Check whether it is up now; `has_begun`: whether the controller has begun the program."""

    def send(self, data: bytes) -> None:
        """Send a message; raises `LinkError` if the connection is lost."""

    def received(self) -> bytes:
        """The bytes from the program since the last call; raises `ConnectionLost` if the connection is lost."""

    def absence(self, why: str) -> LinkError:
        """The error for a link that does not come up."""

    def close(self, *, farewell: bool) -> None:
        """Close the link; with `farewell` the last message is still delivered. Idempotent."""


class LinkedProgram:
    """The program of one motion.

    Args:
        life: life cycle of the motion.
        context: the robot.
        dialogue: decides its messages.
        open_link: opens the link to it; may raise `LinkError`.
        tolerance: rad by which any joint may be away, after a pause, from where the arm came to rest in it.
        on_linked: called, possibly more than once, when the first message has been sent, and when no more messages will
            be sent.
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
        #: s on the controller's clock from the first state to the newest one
        self._passed = 0.0
        #: when the newest state was looked at, monotonic s; from the first one on
        self._seen: float
        self._owes_farewell = False  # of the link: what it still has to deliver when it is closed

    def begin(self) -> None:
        """Open the link, and send the program.

        Raises:
            SafetyStop, NotRunning: the arm may not be moved now: no port was opened and nothing was sent.
            LinkError: another reason why it cannot begin. Its life cycle is over then.
        """
        life, context = self._life, self._context
        life.brake = self._brake
        try:
            context.channel.check()
            self._link = link = self._open_link()
            on_state = partial(self._on_state, link, self._clock())
            self._subscription = context.realtime.subscribe(on_state, policy=latest)
            life.on_end(self._release)
            context.programs.start(
                # It needs no start permission: once the motion is over, its connection is refused or its token not
                # written.
                context.programs.own(self._dialogue.body(link.endpoint), asks=False),
                life,
                is_linked=True,
                left_alone="its program on the robot brakes by itself",
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
        """Send to the program, through the interlock and only while the motion runs.

        Raises:
            SafetyStop, NotRunning: the arm may not be moved now.
            ConnectionLost: the connection is lost.
            LinkError: the motion is over; the error says why.
        """
        self._context.channel.setpoint(lambda: self._transmit(data))

    def feed(self, data: bytes, watchdog: float) -> None:
        """Send a message that answers no state, but comes from a loop of the user, unless no state comes either.

        Without a state for `watchdog` seconds it would be too old for the program, and is not sent: read at once, after
        a controller has hung, it would be where the arm has to go with all its speed. After twice that time the program
        has braked, or the controller hangs, and the motion is over.

        Raises:
            ConnectionLost: no state has come for twice the watchdog's time.
            LinkError: as for `say`.
        """
        silence = self._clock() - self._seen
        if silence > 2.0 * watchdog:
            error = ConnectionLost(
                f"the robot has sent no state for {silence:.2f} s, more than twice watchdog={watchdog:g} s, so its "
                "program takes no message; it brakes by itself. A larger watchdog= tolerates longer delays"
            )
            self._life.fail(error, brake=True)
            raise error
        if silence <= watchdog and not self._pause.holds:
            self.say(data)

    @property
    def is_paused(self) -> bool:
        """Whether the program is paused: it takes no messages.

        By the newest state too: a loop of the user may have it before the thread that answers states.
        """
        newest = self._context.realtime.latest
        return self._pause.holds or (newest is not None and is_paused(newest))

    def _transmit(self, data: bytes) -> None:
        if self._life.error is not None:
            raise self._life.error
        # Composed before another thread ended the program: a register holds its newest message only. Or before the
        # thread that stops it for a task that was cancelled has come to do so: nothing follows that task but the stop.
        if (self.is_finishing or not self._life.is_wanted) and data != self._dialogue.farewell:
            return
        assert self._link is not None
        self._link.send(self._dated(data))

    def _dated(self, data: bytes) -> bytes:
        """What the dialogue sends, with the date of the newest state and the number of pauses.

        A program that ends by itself asks for each of its points by number, so they need no date.
        """
        if not self._dialogue.farewell:
            return data
        return dated(data, round(self._passed / self._cycle), self._pause.count)

    def finish(self) -> None:
        """End the program; the motion is over once it has ended.

        Raises:
            LinkError: the message could not be sent.
        """
        # Fired before sending: the program may end before this thread goes on.
        if self._life.fire(Event.BRAKE, at=self._passed) and self._dialogue.farewell:
            self._owes_farewell = True
            self.say(self._dialogue.farewell)

    @property
    def is_finishing(self) -> bool:
        """Whether the message that ends the program was sent."""
        return self._life.happened(Event.BRAKE) is not None

    def lose(self, error: LinkError) -> None:
        """Handle a lost connection. The primary interface may still report what stopped the program."""
        lost = ConnectionLost(f"the connection of the program on the robot was lost; it brakes by itself: {error}")
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
            # An unexpected exception must not leave the arm without set-points, nor a thread that waits for ever.
            self._life.fail(error, brake=True)
            raise

    def _look(self, link: Link, sent: float, state: RealtimeState) -> None:
        now = self._clock()
        self._seen = now
        self._passed += self._controller.passed(state.time, now)
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
            self._life.fail(link.absence(f"it has not within {CONNECT_TIMEOUT:g} s"), brake=True)

    def _talk(self, link: Link, state: RealtimeState, now: float) -> None:
        if self._pause.look(state):
            # A program that is paused reads nothing: what is sent to it would wait, and be old when it goes on.
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
            error = self._link.absence("it says that it was refused, or found no way")
        elif text.startswith(links.LINK_ENDED):
            error = ConnectionLost("the program on the robot says that its connection ended; it brakes by itself")
        elif text.startswith(links.STARVED):
            watchdog = self._dialogue.watchdog
            within = "" if watchdog is None else f" (watchdog={watchdog:g} s)"
            error = ConnectionLost(
                f"nothing came to the program on the robot in time{within}; it brakes by itself. Send more often, or "
                "pass a larger watchdog="
            )
        elif text.startswith(links.TOO_FAR):
            error = ToleranceExceeded("the program on the robot says that the first point is too far away")
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
            self._life.fail(ProgramStopped(f"the program of {self._life.name} ended before its time"))

    def _brake(self) -> None:
        link = self._link
        if link is not None and link.is_up and self._dialogue.farewell:
            self._owes_farewell = True
            self._context.channel.setpoint(lambda: link.send(self._dated(self._dialogue.farewell)), is_stop=True)
            if not self.is_paused:
                return
        # One that is paused reads nothing, and would go on for some cycles before it reads that message.
        self._context.programs.stop(self._life)

    def _release(self) -> None:
        self._on_linked()
        self._on_linked = _nothing  # which refers to the handle, and this to the program
        subscription, self._subscription = self._subscription, None
        if subscription is not None:
            # Without waiting: this may be the thread of its callback.
            subscription.close(0)
        if self._link is not None:
            self._link.close(farewell=self._owes_farewell)

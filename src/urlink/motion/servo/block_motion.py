"""A motion that lasts as long as a ``with`` block, linked to its program on the robot.

`KeptMessage` is the dialogue with a program that runs while messages come: the same message answers each state, until
it changes.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from concurrent.futures import Future, InvalidStateError
from typing import TYPE_CHECKING

from linkcore import clock
from linkcore.errors import Closed, LinkError, LinkTimeout, LocalError
from linkcore.handle import Event, Motion
from linkcore.pending_call import starts_motion
from linkcore.streaming.scheduling import urgent

from ...protocol.realtime.packets import RealtimeState
from ...script.links import Writer
from ..context import MotionContext
from ..links.messages import WAIT_MESSAGE, setpoint
from .linked_program import Link, LinkedProgram
from .setpoints import LinkDialogue

if TYPE_CHECKING:
    from typing_extensions import Self

#: Seconds to wait for the program to connect if no states come; if they do, `CONNECT_TIMEOUT` ends it before.
_LONGEST = 6.0
#: Seconds to wait for the reason of a lost connection.
_REASON = 1.5
#: Seconds to wait for the end of the program when the block is left. Chosen: a controller that runs at a fifth of its
#: speed has two seconds of its own to brake; where it sends no states, the interlock ends the motion after one.
_END_TIMEOUT = 10.0


class BlockMotion(Motion):
    """The base of the motions that last for one ``with`` block, such as a servo and a jog.

    Args:
        context: the robot.
        name: of the motion, for messages.
        dialogue: decides the messages that are sent to the program.
        open_link: opens the link to it.
    """

    def __init__(
        self, context: MotionContext, name: str, dialogue: LinkDialogue, open_link: Callable[[], Link]
    ) -> None:
        life = context.programs.life(name)
        super().__init__(life)
        self._context = context
        self._block = contextlib.ExitStack()
        #: what `__enter__` waits for: resolved once the program has connected, or cannot connect any more
        self._linked: Future[None] = Future()
        self._program = LinkedProgram(life, context, dialogue, open_link, on_linked=self._link_up)

    @starts_motion
    def __enter__(self) -> Self:
        """Upload the program and wait until it has connected.

        Raises:
            ConnectFailed: it did not connect.
            SafetyStop, NotRunning: the arm may not be moved now.
            LocalError: it was used before; or this is a callback that was subscribed with ``inline=True``.
            LinkError: another reason why it cannot begin.
        """
        if not self._life.fire(Event.SEND):
            raise LocalError(f"the {self.name} has been used before; each is good for one block")
        self._life.enter()
        self._program.begin()
        try:
            with self._context.section.waiting():
                if not clock.is_done(self._linked, _LONGEST):
                    raise LinkTimeout(f"{self.name}: no connection within {_LONGEST:g} s")
            self._linked.result()
        except BaseException:
            self.cancel()
            raise
        if self.error is not None:
            raise self.error
        self._block.enter_context(urgent())  # the user's loop has a message to send in each cycle
        return self

    def __exit__(self, *exc: object) -> None:
        """Stop the arm, and wait until it stands still, ten seconds at most. Raises no earlier error."""
        try:
            with self._block:
                try:
                    self._program.finish()
                    self.wait(_END_TIMEOUT)
                except LinkError:
                    self.cancel()
        except BaseException as error:
            self._give_up(error)
            raise

    def _check_open(self) -> None:
        """Raise unless the block is open.

        Raises:
            LocalError: not within the block.
            LinkError: the motion is over; the error says why.
        """
        if not (self._life.happened(Event.LINK) or self.done):
            raise LocalError(
                f"a {self.name} is told something within its block: with robot.motion.{self.name}() as {self.name}: ..."
            )
        if self.done or self._program.is_finishing:
            raise self.error or Closed(f"the block of the {self.name} was left")

    def _say(self, data: bytes, watchdog: float) -> None:
        """Send a message of the user's loop to the program; `watchdog`: s without a message after which that brakes.

        Raises:
            LinkError: why nothing can be sent; the reason that the robot reports, if that comes in time.
        """
        try:
            self._program.feed(data, watchdog)
        except LinkError as error:
            if not self.done:
                self._program.lose(error)
                with contextlib.suppress(LinkError):
                    self.wait(_REASON)
            raise (self.error or error) from error

    def _link_up(self) -> None:
        if not self._linked.done():
            # Two threads may get here at once.
            with contextlib.suppress(InvalidStateError):
                self._linked.set_result(None)


_NO_SPEEDS = (0.0,) * 6


def message(values: Sequence[float]) -> bytes:
    """Six values, as a program by `urlink.script.force_control` reads them."""
    return setpoint(values, _NO_SPEEDS)


class KeptMessage(LinkDialogue):
    """A dialogue with one such program.

    Args:
        write: makes the lines of the program, for its link.
        values: (6,) of the message; None for a message that only shows that this computer is alive.

    Attributes:
        values: as given; may be set by any thread.
        is_mute: whether states are no longer answered, because the user's loop sends the messages.
    """

    def __init__(self, write: Writer, values: Sequence[float] | None = None) -> None:
        super().__init__(write)
        self.values = values
        self.is_mute = False

    def step(self, received: bytes, state: RealtimeState, now: float) -> bytes:
        if self.is_mute:
            return b""
        return WAIT_MESSAGE if self.values is None else message(self.values)

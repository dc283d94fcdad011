"""Base class of motions that last as long as a ``with`` block, with a link to a program on the robot.

`KeptMessage` is the dialogue with a program that needs messages to keep running. It answers each state with the same
message, until the message is changed.
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
from ...script.messages import WAIT_MESSAGE, setpoint
from ..context import MotionContext
from .linked_program import Link, LinkedProgram
from .setpoints import LinkDialogue

if TYPE_CHECKING:
    from typing_extensions import Self

#: Time in s to wait for the connection of the program if no states arrive. If states arrive, `CONNECT_TIMEOUT` ends
#: this wait earlier.
_LONGEST = 6.0
#: Time in s to wait for a report of the reason after a lost connection.
_REASON = 1.5
#: Time in s to wait for the end of the program when the block is left. Chosen: even a controller that runs at a fifth
#: of its normal speed has two seconds of its own time to brake. If the controller sends no states, the interlock ends
#: the motion after one second.
_END_TIMEOUT = 10.0


class BlockMotion(Motion):
    """Base class of the motions that last for one ``with`` block, such as a servo and a jog.

    Args:
        context: The robot.
        name: Name of the motion, used in error messages.
        dialogue: Dialogue that decides the messages for the program.
        open_link: Function that opens the link to the program.
    """

    def __init__(
        self, context: MotionContext, name: str, dialogue: LinkDialogue, open_link: Callable[[], Link]
    ) -> None:
        life = context.programs.life(name)
        super().__init__(life)
        self._context = context
        self._block = contextlib.ExitStack()
        #: Future that `__enter__` waits for. It is resolved when the program has connected or can no longer connect.
        self._linked: Future[None] = Future()
        self._program = LinkedProgram(life, context, dialogue, open_link, on_linked=self._link_up)

    @starts_motion
    def __enter__(self) -> Self:
        """Upload the program and wait until it has connected.

        Raises:
            ConnectFailed: If the program did not connect.
            SafetyStop, NotRunning: If the arm may not be moved now.
            LocalError: If this object was used before, or if called in a callback that was subscribed with
                ``inline=True``.
            LinkError: If the motion cannot start for another reason.
        """
        if not self._life.fire(Event.SEND):
            raise LocalError(f"this {self.name} was used before; make a new one for each block")
        self._life.enter()
        self._program.begin()
        try:
            with self._context.section.waiting():
                if not clock.is_done(self._linked, _LONGEST):
                    raise LinkTimeout(f"{self.name}: the program on the robot did not connect within {_LONGEST:g} s")
            self._linked.result()
        except BaseException:
            self.cancel()
            raise
        if self.error is not None:
            raise self.error
        self._block.enter_context(urgent())  # the user's loop must send a message in each cycle
        return self

    def __exit__(self, *exc: object) -> None:
        """Stop the arm, and wait up to ten seconds until it is at rest. Earlier errors are not raised."""
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
        """Raise an error if the ``with`` block is not open.

        Raises:
            LocalError: If called outside the ``with`` block.
            LinkError: If the motion has ended; the error states the reason.
        """
        if not (self._life.happened(Event.LINK) or self.done):
            raise LocalError(
                f"this {self.name} is not open; use it within its block: "
                f"with robot.motion.{self.name}() as {self.name}: ..."
            )
        if self.done or self._program.is_finishing:
            raise self.error or Closed(f"the block of this {self.name} was left")

    def _say(self, data: bytes, watchdog: float) -> None:
        """Send a message from the user's loop to the program.

        Args:
            data: The message.
            watchdog: Longest time without a message, in s. After this time, the program brakes.

        Raises:
            LinkError: If nothing can be sent. If the robot reports the reason in time, the error is this reason.
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
            # Two threads may reach this line at the same time.
            with contextlib.suppress(InvalidStateError):
                self._linked.set_result(None)


_NO_SPEEDS = (0.0,) * 6


def message(values: Sequence[float]) -> bytes:
    """Pack six values in the format that the programs in `urlink.script.force_control` read."""
    return setpoint(values, _NO_SPEEDS)


class KeptMessage(LinkDialogue):
    """Dialogue with a program from `urlink.script.force_control`.

    Args:
        write: Function that returns the lines of the program for its link.
        values: Values of the message, shape (6,). If None, the message only shows that this computer is still
            connected.

    Attributes:
        values: Values of the message. Any thread may set them.
    """

    def __init__(self, write: Writer, values: Sequence[float] | None = None) -> None:
        super().__init__(write)
        self.values = values

    def step(self, received: bytes, state: RealtimeState, now: float) -> bytes:
        if self.is_mute:
            return b""
        return WAIT_MESSAGE if self.values is None else message(self.values)

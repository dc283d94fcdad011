"""Teaching: a person moves the arm, and waypoints are recorded by a call, a digital input, or the arm's own button."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from linkcore.errors import LocalError
from linkcore.streaming.stream import Stream

from ..interfaces.enums import RobotStatusBits
from ..interfaces.realtime.packets import RealtimeState
from ..vectors import six
from .taught import Taught, TaughtPoint
from .yielding import Freedrive

if TYPE_CHECKING:
    from typing_extensions import Self

#: Seconds after a waypoint in which an input that bounces does not record another one.
_BOUNCE = 0.2


@dataclass(frozen=True)
class Triggers:
    """The events that record a waypoint, besides a call.

    Attributes:
        input_bit: of the digital inputs; switching it on records one. None for none.
        buttons: the stream with `robot_status_bits`; releasing the arm's own button, as these show it, records one.
            None for no button.
        on_point: called with each waypoint, in the thread that has recorded it.
    """

    input_bit: int | None
    buttons: Stream[Any] | None
    on_point: Callable[[TaughtPoint], object]


class Teaching:
    """Teaching of waypoints while a ``with`` block is open; made by `robot.teach`.

    Attributes:
        taught: the waypoints so far; they remain after the block.
    """

    def __init__(
        self, realtime: Stream[RealtimeState], model: str | None, freedrive: Freedrive | None, triggers: Triggers
    ) -> None:
        self.taught = Taught(model=model)
        self._realtime = realtime
        self._freedrive = freedrive
        self._triggers = triggers
        #: closed when the block is left; None outside of it
        self._open: contextlib.ExitStack | None = None
        # An input that is on, or a button that is not held, in the first state is not an event.
        self._was_on, self._was_held = True, False
        self._kept_at = -math.inf

    @property
    def freedrive(self) -> Freedrive | None:
        """The freedrive of this block; None if the arm is moved with its own button."""
        return self._freedrive

    def __enter__(self) -> Self:
        """Begin freedrive.

        Raises:
            SafetyStop, NotRunning: the arm may not be moved now.
            LinkError: another reason why it cannot begin.
            LocalError: it was used before.
        """
        with contextlib.ExitStack() as opened:
            if self._freedrive is not None:
                opened.enter_context(self._freedrive)
            if self._triggers.input_bit is not None:
                subscription = self._realtime.subscribe(self._look_at_input)
                opened.callback(subscription.close)
            if self._triggers.buttons is not None:
                opened.callback(self._triggers.buttons.close)
                watch = self._triggers.buttons.subscribe(self._look_at_button)
                opened.callback(watch.close)
            self._open = opened.pop_all()
        return self

    def __exit__(self, *exc: object) -> None:
        """End freedrive; the waypoints stay."""
        opened, self._open = self._open, None
        assert opened is not None, "a block is left that was entered"
        opened.close()

    def record(self) -> TaughtPoint:
        """Record the present position of the arm as the next waypoint.

        Raises:
            LocalError: not within the block.
            LinkError: freedrive is over, and the error says why; or no state comes.
        """
        if self._open is None:
            raise LocalError("waypoints are recorded within the block: with robot.teach() as teaching: ...")
        if self._freedrive is not None and self._freedrive.error is not None:
            raise self._freedrive.error
        return self._keep(self._realtime.wait())

    def _keep(self, state: RealtimeState) -> TaughtPoint:
        point = TaughtPoint(six(state.q_actual, "q_actual"), six(state.tool_vector_actual, "tool_vector_actual"))
        self.taught.add(point)
        self._triggers.on_point(point)
        return point

    def _look_at_input(self, state: RealtimeState) -> None:
        assert self._triggers.input_bit is not None
        is_on = bool(state.digital_input_bits >> self._triggers.input_bit & 1)
        if is_on and not self._was_on and state.time - self._kept_at > _BOUNCE:
            self._kept_at = state.time
            self._keep(state)
        self._was_on = is_on

    def _look_at_button(self, state: Any) -> None:
        is_held = bool(state.robot_status_bits & RobotStatusBits.TEACH_BUTTON_PRESSED)
        if self._was_held and not is_held:
            self._keep(self._realtime.wait())
        self._was_held = is_held

    def __repr__(self) -> str:
        return f"<Teaching {len(self.taught)} waypoints>"

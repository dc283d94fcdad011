"""Direct torque: torques of the joints from the user's own loop."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from numpy.typing import ArrayLike

from linkcore.arguments import check_number
from linkcore.errors import BadValue, LocalError
from linkcore.wire.fields import Since

from ..urscript import yielding
from ..vectors import JOINTS, six
from .context import MotionContext
from .linked import Link
from .linked_block import KeptMessage, LinkedBlock, message

_DIRECT_TORQUE = Since("5.23/10.11")
#: Nm, for an arm that is not known.
_LARGEST = 1000.0


class Torque(LinkedBlock):
    """Sends the torques of a loop; made by `robot.motion.torque`, and open within a ``with`` block.

    Args:
        context: the robot.
        limits: (6,) Nm; None for what the joints of this arm can exert.
        friction_compensation: whether the controller compensates the friction of the joints.
        watchdog: s without a torque after which the arm brakes.
        open_link: opens the link to the program.

    Raises:
        BadValue: a number out of range.
        LocalError: this firmware has no direct torque.
    """

    def __init__(
        self,
        context: MotionContext,
        limits: ArrayLike | None,
        friction_compensation: bool,
        watchdog: float,
        open_link: Callable[[], Link],
    ) -> None:
        firmware, model = context.who.identity.firmware, context.who.identity.arm
        if firmware not in _DIRECT_TORQUE:
            raise LocalError(f"firmware {firmware} has no direct torque: 5.23 and 10.11 are the first")
        most = [_LARGEST] * 6 if model is None else model.max_torque.tolist()
        self._limits = most
        if limits is not None:
            self._limits = six(limits, "limits").tolist()
            for joint, (limit, largest) in enumerate(zip(self._limits, most, strict=True)):
                check_number(limit, f"limits[{joint}] ({JOINTS[joint]})", 0.0, largest)
        self._watchdog = check_number(watchdog, "watchdog", 0.01, 1.0)
        self._message = KeptMessage(
            partial(
                yielding.torque,
                firmware,
                friction_compensation=bool(friction_compensation),
                watchdog=self._watchdog,
            )
        )
        super().__init__(context, "torque", self._message, open_link)

    def send(self, torque: ArrayLike) -> None:
        """Apply these torques from the next cycle on; if no others follow, they fade over the watchdog time.

        Args:
            torque: (6,) Nm, added to those that hold the arm up against gravity.

        Raises:
            BadValue: not six finite numbers, or beyond a limit; nothing was sent.
            SafetyStop, NotRunning, ConnectionLost, ProgramStopped, Cancelled: the mode is over.
            LocalError: not within the block.
        """
        self._check_open()
        values = six(torque, "torque").tolist()
        for joint, (value, most) in enumerate(zip(values, self._limits, strict=True)):
            if abs(value) > most:
                raise BadValue(f"torque[{joint}] ({JOINTS[joint]}) is {value:g} Nm; at most {most:g} Nm")
        self._message.is_mute = True
        self._say(message(values), self._watchdog)

"""Jogging: speeds of the joints or of the tool, each of which expires unless it is sent again."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from ..bounds import check_speeds
from ..interfaces.realtime.packets import RealtimeState
from ..urscript.jogging import jogging
from ..urscript.links import InputRegisters, ReverseSocket
from ..vectors import FloatArray
from .context import MotionContext
from .linked import Link
from .linked_block import LinkedBlock
from .setpoints import STOP_WORD, WAIT_WORD, setpoint
from .speed_limit import check_joint_speeds

__all__ = ["FrameName", "Jog"]

#: The frame of the six speeds.
FrameName = Literal["joints", "base", "tool"]

_REST = np.zeros(6)


class _Jogging:
    """Answers each state with the newest speeds, or with `WAIT_WORD` if they have expired.

    Args:
        frame: of the speeds.
        timeout: s after which they expire.
        write: makes the lines of the program.
    """

    farewell = STOP_WORD
    is_over = False
    survives_its_program = False

    def __init__(
        self, frame: FrameName, timeout: float, write: Callable[[ReverseSocket | InputRegisters], list[str]]
    ) -> None:
        self._frame = frame
        self._timeout = timeout
        self._write = write
        #: the speeds, and when they were set, monotonic s; one assignment, by any thread
        self.told: tuple[FloatArray, float] | None = None

    def body(self, link: ReverseSocket | InputRegisters) -> list[str]:
        return self._write(link)

    def step(self, received: bytes, state: RealtimeState, now: float) -> bytes:
        told = self.told
        if told is None:
            return WAIT_WORD
        speeds, at = told
        if now - at > self._timeout:
            speeds = _REST
        elif self._frame == "tool":
            from ..poses import rotvec_to_matrix

            # From the axes of the tool, in its present orientation, to those of the base.
            turned = rotvec_to_matrix(state.tool_vector_actual[3:])
            speeds = np.concatenate([turned @ speeds[:3], turned @ speeds[3:]])
        return setpoint(speeds.tolist(), _REST.tolist())

    def conclude(self) -> None: ...


class Jog(LinkedBlock):
    """Speeds by hand; made by `robot.motion.jog`, and open within a ``with`` block. Leaving the block stops the arm.

    Attributes:
        frame: of the speeds: "joints", "base" or "tool".
        timeout: seconds after which a speed expires.
    """

    def __init__(
        self,
        context: MotionContext,
        frame: FrameName,
        acceleration: float,
        timeout: float,
        watchdog: float,
        open_link: Callable[[], Link],
    ) -> None:
        identity = context.who.identity

        def write(link: ReverseSocket | InputRegisters) -> list[str]:
            return jogging(
                identity.firmware, link, is_tool=frame != "joints", acceleration=acceleration, watchdog=watchdog
            )

        self._dialogue = _Jogging(frame, timeout, write)
        super().__init__(context, "jog", self._dialogue, open_link)
        self.frame: FrameName = frame
        self.timeout = timeout
        self._arm = identity.arm

    def move(self, speeds: ArrayLike) -> None:
        """Move at these speeds until others come, or `timeout` seconds are over. Does not wait.

        Args:
            speeds: (6,) rad/s of the joints; or of the tool, m/s along and rad/s about the axes of the frame.

        Raises:
            BadValue: not six finite numbers, or faster than the arm can be; the speeds before stay.
            SafetyStop, NotRunning, ConnectionLost, ProgramStopped, Cancelled: the jog is over.
            LocalError: not within the block.
        """
        self._check_open()
        values = (
            check_joint_speeds(speeds, "speeds", self._arm)
            if self.frame == "joints"
            else check_speeds(speeds, "speeds")
        )
        self._dialogue.told = values, self._context.clock()

    def stop(self) -> None:
        """Brake; the next `move` moves again.

        Raises:
            LinkError: as for `move`.
        """
        self.move(_REST)

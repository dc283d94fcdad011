"""Speeds of the joints or of the tool over a link: jogging, and a speed for a while (`HeldSpeed`)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from functools import partial
from typing import Literal

import numpy as np

from linkcore.handle import Motion

from ...arm.bounds import check_speeds
from ...arm.vectors import FloatArray, Numbers
from ...protocol.realtime.packets import RealtimeState
from ...script.links import Writer
from ...script.streaming import jogging
from ..context import MotionContext
from ..links.messages import WAIT_MESSAGE
from ..moves.speed_limit import check_joint_speeds
from ..slider import SliderEffect, slider
from .block_motion import BlockMotion, message
from .linked_program import Link, LinkedProgram
from .setpoints import LinkDialogue

#: The frame of the six speeds.
FrameName = Literal["joints", "base", "tool"]

_JOINTS, _TOOL = (1.05,) * 6, (0.25,) * 3 + (0.8,) * 3
#: What keys and buttons take for the whole speed in each frame, rad/s; m/s and rad/s: the defaults of the vendor's
#: `movej` and `movel`.
FULL_SPEED: Mapping[FrameName, tuple[float, ...]] = {"joints": _JOINTS, "base": _TOOL, "tool": _TOOL}

_REST = np.zeros(6)
#: Seconds for which an arm may go on at a speed that nobody wants any more: the longest time of a speed that is sent as
#: one program, and the watchdog of a longer one.
UNLED = 0.5


class _Jogging(LinkDialogue):
    """Answers each state with the newest speeds, or with `WAIT_MESSAGE` if they have expired.

    Args:
        frame: of the speeds.
        timeout: s after which they expire.
        write: makes the lines of the program.
    """

    def __init__(self, frame: FrameName, timeout: float, write: Writer) -> None:
        super().__init__(write)
        self._frame = frame
        self._timeout = timeout
        #: the speeds, and when they were set, monotonic s; one assignment, by any thread
        self.newest: tuple[FloatArray, float] | None = None

    def step(self, received: bytes, state: RealtimeState, now: float) -> bytes:
        newest = self.newest
        if newest is None:
            return WAIT_MESSAGE
        speeds, at = newest
        if now - at > self._timeout:
            speeds = _REST
        elif self._frame == "tool":
            from ...arm.poses import rotvec_to_matrix

            # From the axes of the tool, in its present orientation, to those of the base.
            turned = rotvec_to_matrix(state.tool_vector_actual[3:])
            speeds = np.concatenate([turned @ speeds[:3], turned @ speeds[3:]])
        return message(speeds.tolist())


@slider(jog=SliderEffect.SCALED)
class Jog(BlockMotion):
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
        is_tool = frame != "joints"
        write = partial(jogging, identity.firmware, is_tool=is_tool, acceleration=acceleration, watchdog=watchdog)
        self._dialogue = _Jogging(frame, timeout, write)
        super().__init__(context, "jog", self._dialogue, open_link)
        self.frame: FrameName = frame
        self.timeout = timeout
        self._arm = identity.arm

    def move(self, speeds: Numbers) -> None:
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
        self._dialogue.newest = values, self._context.clock()

    def stop(self) -> None:
        """Brake; the next `move` moves again.

        Raises:
            LinkError: as for `move`.
        """
        self.move(_REST)


class _Holding(LinkDialogue):
    """Answers each state with one speed, until it has been held for its time.

    Args:
        section: lock of the robot.
        write: makes the lines of the program.
        speeds: (6,) of the joints, or of the tool in the base frame.
        duration: s from the first message on.
    """

    def __init__(
        self, section: AbstractContextManager[object], write: Writer, speeds: FloatArray, duration: float
    ) -> None:
        super().__init__(write)
        self._section = section
        self._speeds = speeds
        self._duration = duration
        self._began: float | None = None

    def change(self, speeds: FloatArray, duration: float) -> bool:
        """Hold another speed from the next state on; False if the last message has been decided on."""
        with self._section:
            if not self.is_over:
                self._speeds, self._duration, self._began = speeds, duration, None
            return not self.is_over

    def step(self, received: bytes, state: RealtimeState, now: float) -> bytes:
        with self._section:
            if self._began is None:
                self._began = now
            self.is_over = now - self._began >= self._duration
            return message(self._speeds.tolist())

    def part(self, now: float) -> float:
        """The part of its time that is over."""
        with self._section:
            return 0.0 if self._began is None else (now - self._began) / self._duration


@slider(speed_joints=SliderEffect.SCALED)
class HeldSpeed(Motion):
    """A speed for longer than `UNLED`: the robot brakes by itself that long after the last message from this computer.

    Args:
        context: the robot.
        name: of the motion.
        is_tool: a speed of the tool in the base frame, rather than of the joints.
        speeds, acceleration, duration: see `Motions.speed_joints`.
        open_link: opens the link to its program.
    """

    def __init__(
        self,
        context: MotionContext,
        name: str,
        is_tool: bool,
        speeds: FloatArray,
        acceleration: float,
        duration: float,
        open_link: Callable[[], Link],
    ) -> None:
        firmware = context.who.identity.firmware
        write = partial(jogging, firmware, is_tool=is_tool, acceleration=acceleration, watchdog=UNLED)
        self._acceleration = acceleration
        self._dialogue = _Holding(context.section.lock, write, speeds, duration)
        life = context.programs.life(name)
        super().__init__(life, lambda: self._dialogue.part(context.clock()))
        LinkedProgram(life, context, self._dialogue, open_link).begin()

    def change(self, name: str, speeds: FloatArray, acceleration: float, duration: float) -> bool:
        """Go on at another speed, without a stop; False if another program is needed for it."""
        if self.done or (name, acceleration) != (self.name, self._acceleration):
            return False
        return self._dialogue.change(speeds, duration)

"""Motions at speeds of the joints or of the tool, over a link: jogging, and a speed for a given time (`HeldSpeed`)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from functools import partial
from typing import Literal

import numpy as np

from linkcore.handle import Motion

from ...arm.bounds import check_speeds
from ...arm.vectors import FloatArray, Numbers
from ...errors import LimitExceeded
from ...protocol.realtime.packets import RealtimeState
from ...script.links import Writer
from ...script.messages import WAIT_MESSAGE
from ...script.streaming import jogging
from ..context import MotionContext
from ..moves.speed_limit import check_joint_speeds
from ..slider import SliderEffect, slider
from .block_motion import BlockMotion, message
from .linked_program import Link, LinkedProgram
from .setpoints import LinkDialogue
from .speed_watch import SpeedWatch

#: Frame of the six speeds.
FrameName = Literal["joints", "base", "tool"]

_JOINTS, _TOOL = (1.05,) * 6, (0.25,) * 3 + (0.8,) * 3
#: Full speed for keys and buttons in each frame, in rad/s for joints, in m/s and rad/s for the tool. The values are the
#: defaults of the vendor's `movej` and `movel`.
FULL_SPEED: Mapping[FrameName, tuple[float, ...]] = {"joints": _JOINTS, "base": _TOOL, "tool": _TOOL}

_REST = np.zeros(6)
#: Longest time in s for which an arm may continue at a speed without a message from this computer. A speed with a
#: duration up to this time is sent as one program. For a longer duration, this time is the watchdog.
UNLED = 0.5
#: Watchdog of a speed in a session with limits, in s. Chosen: the default of `Motions.jog`.
_WATCHED = 0.2


def in_base(speeds: FloatArray, state: RealtimeState) -> FloatArray:
    """Convert speeds along and about the axes of the tool, in its current orientation, to the axes of the base."""
    from ...arm.poses import rotvec_to_matrix

    turned = rotvec_to_matrix(state.tool_vector_actual[3:])
    return np.concatenate([turned @ speeds[:3], turned @ speeds[3:]])


class _Jogging(LinkDialogue):
    """Dialogue that answers each state with the newest speeds, or with zero speeds if they have expired.

    Before the first speeds, it answers with `WAIT_MESSAGE`. At a limit of the session, it answers with zero speeds
    until other speeds are set.

    Args:
        frame: Frame of the speeds.
        timeout: Time in s until the speeds expire.
        write: Function that returns the lines of the program.
    """

    def __init__(self, frame: FrameName, timeout: float, write: Writer) -> None:
        super().__init__(write)
        self._frame = frame
        self._timeout = timeout
        #: the speeds, and the monotonic time in s at which they were set; any thread may assign both together
        self.newest: tuple[FloatArray, float] | None = None
        #: watch of the arm; None if the session has no limits
        self.watch: SpeedWatch | None = None
        #: the newest speeds at which a limit was reached, and the limit; assigned together
        self.reached: tuple[FloatArray, LimitExceeded] | None = None

    def step(self, received: bytes, state: RealtimeState, now: float) -> bytes:
        newest = self.newest
        if newest is None:
            return WAIT_MESSAGE
        speeds, at = newest
        if now - at > self._timeout:
            speeds = _REST
        elif self._frame == "tool":
            speeds = in_base(speeds, state)
        return message(self._watched(newest[0], speeds, state).tolist())

    def _watched(self, asked: FloatArray, speeds: FloatArray, state: RealtimeState) -> FloatArray:
        """Return the speeds, or zero speeds if a limit of the session has been reached since they were asked for."""
        if self.watch is None or not speeds.any():
            return speeds
        if self.reached is None or self.reached[0] is not asked:
            try:
                self.watch.check(state, speeds)
            except LimitExceeded as error:
                self.reached = asked, error
            else:
                return speeds
        return _REST


@slider(jog=SliderEffect.SCALED)
class Jog(BlockMotion):
    """Motion at speeds that a person sets, for example with keys; see `robot.motion.jog`.

    Use it as a ``with`` block. Leaving the block stops the arm.

    Attributes:
        frame: Frame of the speeds: "joints", "base" or "tool".
        timeout: Time in seconds until a speed expires.
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
        self._acceleration = acceleration

    @property
    def limit(self) -> LimitExceeded | None:
        """Limit of the session at which the arm brakes instead of moving at the newest speeds; None if there is none.

        The next `move` may move the arm again, away from the limit.
        """
        reached, newest = self._dialogue.reached, self._dialogue.newest
        return reached[1] if reached is not None and newest is not None and reached[0] is newest[0] else None

    def move(self, speeds: Numbers) -> None:
        """Move at these speeds until other speeds are set, or until `timeout` seconds have passed.

        This method does not wait.

        Args:
            speeds: Speeds, shape (6,): of the joints in rad/s, or of the tool in m/s along the axes of the frame and in
                rad/s about these axes.

        Raises:
            BadValue: If `speeds` is not six finite numbers, or if a speed is faster than the arm can move. The previous
                speeds remain.
            LimitExceeded: If the arm cannot begin to move at these speeds, because it would exceed a limit of the
                session. The previous speeds remain. If the arm reaches a limit later, it brakes there (`limit`).
            SafetyStop, NotRunning, ConnectionLost, ProgramStopped, Cancelled: If the jog has ended.
            LocalError: If called outside the ``with`` block.
        """
        self._check_open()
        values = (
            check_joint_speeds(speeds, "speeds", self._arm)
            if self.frame == "joints"
            else check_speeds(speeds, "speeds")
        )
        self._check_limits(values)
        self._dialogue.newest = values, self._context.clock()

    def _check_limits(self, speeds: FloatArray) -> None:
        """Check that the arm can begin to move at these speeds; from then on, the dialogue watches the arm."""
        context = self._context
        limited = context.limited()
        if limited is None or not speeds.any():
            return
        limited.check_inside()
        state = context.state()
        watch = SpeedWatch(limited, self._acceleration, is_tool=self.frame != "joints")
        watch.check(state, in_base(speeds, state) if self.frame == "tool" else speeds)
        self._dialogue.watch = watch

    def stop(self) -> None:
        """Brake. The next `move` moves the arm again.

        Raises:
            LinkError: If `move` raises this error.
        """
        self.move(_REST)


class _Holding(LinkDialogue):
    """Dialogue that answers each state with the same speeds, until their duration has passed.

    Args:
        section: Lock of the robot.
        write: Function that returns the lines of the program.
        speeds: Speeds of the joints, or of the tool in the base frame, shape (6,).
        duration: Duration after the first message, in s.
        watch: Watch of the arm; None if the session has no limits.
    """

    def __init__(
        self,
        section: AbstractContextManager[object],
        write: Writer,
        speeds: FloatArray,
        duration: float,
        watch: SpeedWatch | None,
    ) -> None:
        super().__init__(write)
        self._watch = watch
        self._section = section
        self._speeds = speeds
        self._duration = duration
        self._began: float | None = None

    def change(self, speeds: FloatArray, duration: float) -> bool:
        """Answer with other speeds from the next state on; return False if the last message was already decided."""
        with self._section:
            if not self.is_over:
                self._speeds, self._duration, self._began = speeds, duration, None
            return not self.is_over

    def step(self, received: bytes, state: RealtimeState, now: float) -> bytes:
        with self._section:
            if self._began is None:
                self._began = now
            self.is_over = now - self._began >= self._duration
            if self._watch is not None and not self.is_over:
                self._watch.check(state, self._speeds)
            return message(self._speeds.tolist())

    def part(self, now: float) -> float:
        """Return the fraction of the duration that has passed."""
        with self._section:
            return 0.0 if self._began is None else (now - self._began) / self._duration


@slider(speed_joints=SliderEffect.SCALED)
class HeldSpeed(Motion):
    """Motion at one speed over a link: for a duration longer than `UNLED`, or in a session with limits.

    The robot brakes on its own if it has received no message from this computer for `UNLED` seconds, or for `_WATCHED`
    seconds in a session with limits. If the arm comes too close to a limit of the session, it brakes, and the motion
    ends with `LimitExceeded`.

    Args:
        context: The robot.
        name: Name of the motion.
        is_tool: Whether the speeds are those of the tool in the base frame, rather than those of the joints.
        speeds, acceleration, duration: See `Motions.speed_joints`.
        open_link: Function that opens the link to the program.
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
        limited = context.limited()
        watch = None if limited is None else SpeedWatch(limited, acceleration, is_tool=is_tool)
        watchdog = UNLED if watch is None else _WATCHED
        write = partial(jogging, firmware, is_tool=is_tool, acceleration=acceleration, watchdog=watchdog)
        self._acceleration = acceleration
        self._dialogue = _Holding(context.section.lock, write, speeds, duration, watch)
        life = context.programs.life(name)
        super().__init__(life, lambda: self._dialogue.part(context.clock()))
        LinkedProgram(life, context, self._dialogue, open_link).begin()

    def change(self, name: str, speeds: FloatArray, acceleration: float, duration: float) -> bool:
        """Continue at another speed without a stop; return False if the other speed needs another program."""
        if self.done or (name, acceleration) != (self.name, self._acceleration):
            return False
        return self._dialogue.change(speeds, duration)

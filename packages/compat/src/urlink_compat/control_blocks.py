"""Set-points, speeds, force mode, freedrive and torques of ur_rtde's control interface."""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum
from typing import Literal

import numpy as np

from urlink.arm.poses import rotvec_to_matrix
from urlink.motion import ForceMode, Freedrive, Jog, Servo, Torque
from urlink.tools import six, text

from .control_moves import ControlMoves
from .interface import succeeds

__all__ = ["ControlBlocks", "Feature"]

#: Seconds without a set-point after which the robot brakes. With the other client the arm holds still for ever; here a
#: loop that pauses for longer opens the servo again.
_WATCHDOG = 0.5
#: Seconds for which a speed holds unless a call changes or stops it. With the other client it holds for ever.
_SPEED_HOLDS = 60.0
#: m after which `moveUntilContact` ends without contact.
_NO_CONTACT = 2.0
_ORIGIN = (0.0,) * 6
_ALL = (1,) * 6


class Feature(IntEnum):
    """The frame of the speeds of `jogStart`."""

    FEATURE_BASE = 0
    FEATURE_TOOL = 1
    FEATURE_CUSTOM = 2


class ControlBlocks(ControlMoves):
    """Modes that last until another call. See `ControlMoves` for the arguments."""

    def __init__(self, hostname: str, frequency: float = -1.0) -> None:
        super().__init__(hostname, frequency)
        self._watchdog = _WATCHDOG
        self._damping: float | None = None
        self._gain: float | None = None

    # -- set-points and speeds ---------------------------------------------------------------------------

    def servoJ(
        self, q: Sequence[float], speed: float, acceleration: float, time: float, lookahead_time: float, gain: float
    ) -> bool:
        """Send joint positions, rad, as a set-point; does not wait. Speed, acceleration and time have no effect, as
        on the robot. Look-ahead 0.03 to 0.2 s, gain 100 to 2000.

        Raises:
            BadValue: further away than the joints can move in the time since the last set-point.
        """

        def send() -> None:
            self._servo(lookahead_time, gain).send(q)
            self._last = list(q), lookahead_time, gain

        return succeeds(send)

    def _servo(self, lookahead_time: float, gain: float) -> Servo:
        watchdog = self._watchdog
        return self._blocks.opened(
            Servo,
            (watchdog, lookahead_time, gain),
            lambda link: self._robot.motion.servo(
                watchdog=watchdog, lookahead_time=lookahead_time, gain=gain, link=link
            ),
        )

    def servoL(
        self, pose: Sequence[float], speed: float, acceleration: float, time: float, lookahead_time: float, gain: float
    ) -> bool:
        """Send a pose of the tool as a set-point; see `servoJ`.

        Raises:
            Unreachable: the pose is out of reach.
            BadValue: as for `servoJ`.
        """
        near = () if self._last is None else self._last[0]
        return self.servoJ(self.getInverseKinematics(pose, near), speed, acceleration, time, lookahead_time, gain)

    def servoStop(self, a: float = 10.0) -> bool:
        """End the servo and stop the arm, as fast as the servo does."""
        return succeeds(self._end_block)

    def speedJ(self, qd: Sequence[float], acceleration: float = 0.5, time: float = 0.0) -> bool:
        """Accelerate to joint speeds, rad/s, at rad/s², and keep them until another call, for a minute at most; does
        not wait.

        `time` has no effect: on the robot it is how long the function takes, and not how long the arm moves.
        """
        return self._speed("joints", qd, acceleration)

    def speedL(self, xd: Sequence[float], acceleration: float = 0.25, time: float = 0.0) -> bool:
        """Accelerate to a speed of the tool in the base frame, m/s and rad/s, at m/s²; see `speedJ`."""
        return self._speed("base", xd, acceleration)

    def _speed(self, frame: Literal["joints", "base", "tool"], speeds: Sequence[float], acceleration: float) -> bool:
        def go() -> None:
            self._last = None
            jog = self._blocks.opened(
                Jog,
                (frame, acceleration),
                lambda link: self._robot.motion.jog(
                    frame, acceleration=acceleration, timeout=_SPEED_HOLDS, watchdog=_WATCHDOG, link=link
                ),
            )
            jog.move(speeds)

        return succeeds(go)

    def speedStop(self, a: float = 10.0) -> bool:
        """Stop a movement of `speedJ`, `speedL` or `jogStart`, with the acceleration of that call."""
        return succeeds(self._end_block)

    def jogStart(
        self,
        speeds: Sequence[float],
        feature: int = Feature.FEATURE_BASE,
        acc: float = 0.5,
        custom_frame: Sequence[float] = _ORIGIN,
    ) -> bool:
        """Move the tool at a speed in m/s and rad/s, along the axes of a frame; another call changes the speed.

        The other client's documentation says mm/s, but its program uses m/s.
        """
        values = six(speeds, "speeds")
        if feature == Feature.FEATURE_TOOL:
            return self._speed("tool", values.tolist(), acc)
        if feature == Feature.FEATURE_CUSTOM:
            turn = rotvec_to_matrix(six(custom_frame, "custom_frame")[3:])
            values = np.concatenate([turn @ values[:3], turn @ values[3:]])
        return self._speed("base", values.tolist(), acc)

    def jogStop(self) -> bool:
        """Stop a movement of `jogStart`."""
        return self.speedStop()

    def setWatchdog(self, min_frequency: float = 10.0) -> bool:
        """From the next servo on, brake if set-points come less often than this, Hz. Without this call: after 0.5 s."""
        self._watchdog = 1.0 / float(text.number(min_frequency, "min_frequency", 0.1, 100.0))
        return True

    def kickWatchdog(self) -> bool:
        """Send the last set-point again."""
        last = self._last
        return last is None or not self._blocks.is_open or succeeds(lambda: self._servo(*last[1:]).send(last[0]))

    # -- force mode, freedrive, torques, contact ---------------------------------------------------------

    def forceMode(
        self,
        task_frame: Sequence[float],
        selection_vector: Sequence[int],
        wrench: Sequence[float],
        type: int,
        limits: Sequence[float],
    ) -> bool:
        """Force mode: yield along the selected axes of a frame until the tool exerts a wrench there, N and Nm. It lasts
        until another call; another wrench changes the one that is exerted."""

        def press() -> None:
            self._last = None
            pressing = self._blocks.opened(
                ForceMode,
                (*task_frame, *selection_vector, type, *limits, self._damping, self._gain),
                lambda link: self._robot.motion.force_mode(
                    task_frame,
                    selection_vector,
                    wrench,
                    limits,
                    kind=type,
                    damping=self._damping,
                    gain=self._gain,
                    watchdog=_WATCHDOG,
                    link=link,
                ),
            )
            pressing.set_wrench(wrench)

        return succeeds(press)

    def forceModeSetDamping(self, damping: float) -> bool:
        """Set the damping of force mode, 0 to 1; it holds from the next force mode on."""
        self._damping = float(text.number(damping, "damping", 0.0, 1.0))
        return True

    def forceModeSetGainScaling(self, scaling: float) -> bool:
        """Set the gain of force mode, 0 to 2; it holds from the next force mode on."""
        self._gain = float(text.number(scaling, "scaling", 0.0, 2.0))
        return True

    def forceModeStop(self) -> bool:
        """End force mode."""
        return succeeds(self._end_block)

    def freedriveMode(self, free_axes: Sequence[int] = _ALL, feature: Sequence[float] = _ORIGIN) -> bool:
        """Freedrive: let a person move the arm by hand, along the free axes of a frame."""

        def free() -> None:
            self._last = None
            axes = None if all(free_axes) else free_axes
            self._blocks.opened(
                Freedrive,
                (*free_axes, *feature),
                lambda link: self._robot.freedrive(axes, frame=feature, watchdog=_WATCHDOG, link=link),
            )

        return succeeds(free)

    def endFreedriveMode(self) -> bool:
        """End freedrive."""
        return succeeds(self._end_block)

    def teachMode(self) -> bool:
        """Freedrive with all axes free."""
        return self.freedriveMode()

    def endTeachMode(self) -> bool:
        """End the freedrive of `teachMode`."""
        return self.endFreedriveMode()

    def directTorque(
        self,
        torque: Sequence[float],
        viscous_scale: Sequence[float] = (0.9, 0.9, 0.8, 0.9, 0.9, 0.9),
        coulomb_scale: Sequence[float] = (0.8, 0.8, 0.7, 0.8, 0.8, 0.8),
    ) -> bool:
        """Add torques of the joints, Nm, to those that hold the arm up; from 5.23 and 10.11 on.

        Of the scales only this has an effect: if any is not zero, the controller compensates friction.
        """
        compensates = any([*viscous_scale, *coulomb_scale])

        def send() -> None:
            self._last = None
            line = self._blocks.opened(
                Torque,
                (compensates,),
                lambda link: self._robot.motion.torque(friction_compensation=compensates, link=link),
            )
            line.send(torque)

        return succeeds(send)

    def moveUntilContact(
        self, xd: Sequence[float], direction: Sequence[float] = _ORIGIN, acceleration: float = 1.2
    ) -> bool:
        """Move the tool straight, m/s in the base frame, until it touches something, then back to where that began.

        False if there is no contact within 2 m. `direction` has no effect: contact is a force against the movement.
        """
        way = six(xd, "xd")[:3]
        speed = float(np.linalg.norm(way))
        return self._move(
            lambda: self._robot.motion.until_contact(way, speed, acceleration=acceleration, distance=_NO_CONTACT), False
        )

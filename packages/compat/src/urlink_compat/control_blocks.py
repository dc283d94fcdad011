"""Set-points, speeds, force mode, freedrive and torques of ur_rtde's control interface."""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum
from typing import Literal

import numpy as np

from urlink import SessionLimits
from urlink.arm.poses import rotvec_to_matrix
from urlink.motion import ForceMode, Freedrive, Jog, Servo, Torque
from urlink.tools import six, text

from .control_moves import ControlMoves
from .interface import succeeds

__all__ = ["ControlBlocks", "Feature"]

#: Time in s without a set-point after which the robot brakes. In the other client, the arm holds its position forever.
#: Here, a loop that pauses for longer opens the servo again.
_WATCHDOG = 0.5
#: Maximum time in s that a speed is kept unless a call changes or stops it. In the other client, it is kept forever.
_SPEED_HOLDS = 60.0
#: Distance in m after which `moveUntilContact` ends without contact.
_NO_CONTACT = 2.0
_ORIGIN = (0.0,) * 6
_ALL = (1,) * 6


class Feature(IntEnum):
    """Frame of the speeds of `jogStart`."""

    FEATURE_BASE = 0
    FEATURE_TOOL = 1
    FEATURE_CUSTOM = 2


class ControlBlocks(ControlMoves):
    """Modes that last until another call. See `ControlMoves` for the arguments."""

    def __init__(self, hostname: str, frequency: float = -1.0, *, limits: SessionLimits | None = None) -> None:
        super().__init__(hostname, frequency, limits=limits)
        self._watchdog = _WATCHDOG
        self._damping: float | None = None
        self._gain: float | None = None

    # -- set-points and speeds ---------------------------------------------------------------------------

    def servoJ(
        self, q: Sequence[float], speed: float, acceleration: float, time: float, lookahead_time: float, gain: float
    ) -> bool:
        """Send joint positions in rad as a set-point, without waiting.

        Speed, acceleration and time have no effect, as on the robot. The look-ahead time is 0.03 to 0.2 s, the gain 100
        to 2000.

        Raises:
            BadValue: If the set-point is further away than the joints can move in the time since the last one.
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
            Unreachable: If the pose is out of reach.
            BadValue: See `servoJ`.
        """
        near = () if self._last is None else self._last[0]
        return self.servoJ(self.getInverseKinematics(pose, near), speed, acceleration, time, lookahead_time, gain)

    def servoStop(self, a: float = 10.0) -> bool:
        """End the servo and stop the arm, as fast as the servo does."""
        return succeeds(self._end_block)

    def speedJ(self, qd: Sequence[float], acceleration: float = 0.5, time: float = 0.0) -> bool:
        """Accelerate to joint speeds in rad/s, at rad/s², and keep them until another call, for up to a minute.

        The method does not wait. `time` has no effect: on the robot, it is the duration of the function rather than of
        the motion.
        """
        return self._speed("joints", qd, acceleration)

    def speedL(self, xd: Sequence[float], acceleration: float = 0.25, time: float = 0.0) -> bool:
        """Accelerate to a tool speed in the base frame (m/s and rad/s), at m/s²; see `speedJ`."""
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
        """Stop a motion of `speedJ`, `speedL` or `jogStart`, with the acceleration of that call."""
        return succeeds(self._end_block)

    def jogStart(
        self,
        speeds: Sequence[float],
        feature: int = Feature.FEATURE_BASE,
        acc: float = 0.5,
        custom_frame: Sequence[float] = _ORIGIN,
    ) -> bool:
        """Move the tool at a speed in m/s and rad/s along the axes of a frame. Another call changes the speed.

        The documentation of the other client states mm/s, but its program uses m/s.
        """
        values = six(speeds, "speeds")
        if feature == Feature.FEATURE_TOOL:
            return self._speed("tool", values.tolist(), acc)
        if feature == Feature.FEATURE_CUSTOM:
            turn = rotvec_to_matrix(six(custom_frame, "custom_frame")[3:])
            values = np.concatenate([turn @ values[:3], turn @ values[3:]])
        return self._speed("base", values.tolist(), acc)

    def jogStop(self) -> bool:
        """Stop a motion of `jogStart`."""
        return self.speedStop()

    def setWatchdog(self, min_frequency: float = 10.0) -> bool:
        """Set the watchdog of later servos, as the minimum frequency of set-points in Hz. The default is 0.5 s."""
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
        """Start force mode: the tool yields along the selected axes of a frame until it exerts a wrench there (N, Nm).

        It lasts until another call. A call with another wrench changes the exerted wrench.
        """

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
        """Set the damping of force mode, 0 to 1. It applies to later force modes."""
        self._damping = float(text.number(damping, "damping", 0.0, 1.0))
        return True

    def forceModeSetGainScaling(self, scaling: float) -> bool:
        """Set the gain of force mode, 0 to 2. It applies to later force modes."""
        self._gain = float(text.number(scaling, "scaling", 0.0, 2.0))
        return True

    def forceModeStop(self) -> bool:
        """End force mode."""
        return succeeds(self._end_block)

    def freedriveMode(self, free_axes: Sequence[int] = _ALL, feature: Sequence[float] = _ORIGIN) -> bool:
        """Start freedrive: a person can move the arm by hand along the free axes of a frame."""

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
        """Start freedrive with all axes free."""
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
        """Add joint torques in Nm to the gravity-compensation torques (firmware 5.23 and 10.11, or later).

        The scales have only one effect: if any scale is not zero, the controller compensates for friction.
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
        """Move the tool straight in m/s in the base frame until it touches something, then back to where the contact
        began.

        Return False if there is no contact within 2 m. `direction` has no effect: a contact is a force against the
        motion.
        """
        way = six(xd, "xd")[:3]
        speed = float(np.linalg.norm(way))
        return self._move(
            lambda: self._robot.motion.until_contact(way, speed, acceleration=acceleration, distance=_NO_CONTACT), False
        )

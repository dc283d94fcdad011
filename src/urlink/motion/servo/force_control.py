"""Force control: force mode, freedrive, direct torque, and motions that end at a contact."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

from numpy.typing import ArrayLike

from linkcore.arguments import check_number
from linkcore.errors import BadValue, LocalError
from linkcore.handle import Lifecycle, Motion
from linkcore.wire.fields import Since

from ...arm.bounds import POSITION, TOOL_SPEED, TOOL_TURN, TURN, check_pose
from ...arm.vectors import JOINTS, FloatArray, Numbers, six
from ...errors import NoContact
from ...protocol.firmware import Firmware
from ...script import force_control
from ...script.force_control import Pressing
from ..context import MotionContext
from ..slider import SliderEffect, slider
from .block_motion import BlockMotion, KeptMessage, message
from .linked_program import Link

#: Largest force in N and torque in Nm; no arm exerts more.
_LARGEST = 1000.0
#: Smallest accepted limit of an axis: speed in m/s or rad/s, deviation in m or rad. A smaller limit would keep the tool
#: at its position.
_LEAST = 1e-6
#: First firmware releases with force mode, with damping (on CB3), and with gain.
_FORCE_MODE = Firmware(3, 0)
#: Noise of the measured speed of the tool in m/s, and the largest part of a limit of the session that it may take up.
#: Chosen: in the simulator, the noise is up to 0.003 m/s.
_NOISE, _NOISE_SHARE = 0.005, 0.2
_DAMPING_CB, _GAIN = Firmware(3, 5), Firmware(5, 0)
#: Names of the directions along and about the axes of a frame.
AXES = ("x", "y", "z", "rx", "ry", "rz")


def axes_of(values: Sequence[object], what: str) -> tuple[bool, ...]:
    """Convert six values to booleans. Each value must be 0, 1, False or True.

    Raises:
        BadValue: If `values` are not six of these values.
    """
    axes = list(values)
    if len(axes) != 6 or any(each not in (0, 1) for each in axes):
        raise BadValue(f"{what} is {axes!r}; expected six values of 0 or 1, for x, y, z, rx, ry, rz")
    return tuple(map(bool, axes))


def frame_of(context: MotionContext, frame: Numbers | str) -> tuple[float, ...]:
    """Return the pose of a frame in the base frame.

    A frame is "base", "tool" (the tool frame in its current pose), or a pose in the base frame.

    Raises:
        BadValue: If `frame` is none of these.
        LinkTimeout, RemoteError: If no state arrives, so that the pose of the tool is unknown.
    """
    if isinstance(frame, str):
        if frame == "base":
            return (0.0,) * 6
        if frame == "tool":
            return tuple(context.state().tool_vector_actual.tolist())
        raise BadValue(f"frame is {frame!r}; expected 'base', 'tool', or a pose in the base frame")
    return tuple(check_pose(frame, "frame").tolist())


def _check_pressing(pressing: Pressing, firmware: Firmware) -> None:
    """Check the ranges of the parameters, and whether the firmware supports these parameters.

    Raises:
        BadValue: If a number is out of range.
        LocalError: If this firmware does not support force mode, or if it does not support the given damping or gain.
    """
    if firmware < _FORCE_MODE:
        raise LocalError(f"firmware {firmware} does not support force mode; {_FORCE_MODE} or later is required")
    if pressing.kind not in (1, 2, 3):
        raise BadValue(f"kind is {pressing.kind!r}; expected 1, 2 or 3")
    for index, (name, limit, is_free) in enumerate(zip(AXES, pressing.limits, pressing.selection, strict=True)):
        speed, deviation = (TOOL_SPEED, POSITION) if index < 3 else (TOOL_TURN, TURN)
        bound = speed if is_free else deviation
        check_number(limit, f"limits[{name}]", _LEAST, bound.most, bound.unit)
    if pressing.damping is not None:
        check_number(pressing.damping, "damping", 0.0, 1.0)
        if firmware < _DAMPING_CB:
            raise LocalError(f"firmware {firmware} does not support damping; {_DAMPING_CB} or later is required")
    if pressing.gain is not None:
        check_number(pressing.gain, "gain", 0.0, 2.0)
        if firmware < _GAIN:
            raise LocalError(f"firmware {firmware} does not support gain; {_GAIN} or later is required")


def _slowed(pressing: Pressing, fastest: float) -> Pressing:
    """Lower the largest speeds along the axes, so that the tool moves at `fastest` m/s or less."""
    speeds = [limit for limit, is_free in zip(pressing.limits[:3], pressing.selection, strict=False) if is_free]
    share = min(fastest / math.hypot(*speeds), 1.0) if speeds else 1.0
    lowered = [
        share * limit if is_free and axis < 3 else limit
        for axis, (limit, is_free) in enumerate(zip(pressing.limits, pressing.selection, strict=True))
    ]
    return dataclasses.replace(pressing, limits=tuple(lowered))


@slider(force_mode=SliderEffect.UNSCALED)
class ForceMode(BlockMotion):
    """Force mode that lasts while a ``with`` block is open; see `robot.motion.force_mode`."""

    def __init__(
        self,
        context: MotionContext,
        pressing: Pressing,
        wrench: Numbers,
        watchdog: float,
        open_link: Callable[[], Link],
    ) -> None:
        firmware = context.who.identity.firmware
        _check_pressing(pressing, firmware)
        if context.limits is not None and context.limits.tool_speed is not None:
            most = context.limits.tool_speed
            pressing = _slowed(pressing, most - min(_NOISE, _NOISE_SHARE * most))
        seconds = check_number(watchdog, "watchdog", 0.05, 10.0)
        body = partial(force_control.force_mode, firmware, pressing=pressing, watchdog=seconds)
        self._message = KeptMessage(body, _wrench(wrench).tolist())
        super().__init__(context, "force_mode", self._message, open_link)

    @property
    def wrench(self) -> FloatArray:
        """Wrench that the tool exerts along and about the axes of the frame, (6,), in N and Nm."""
        assert self._message.values is not None  # every message has a wrench
        return six(self._message.values, "wrench")

    def set_wrench(self, wrench: Numbers) -> None:
        """Exert another wrench, starting with the next state.

        The values for axes that do not yield have no effect.

        Raises:
            BadValue: If `wrench` is not six finite numbers, or exceeds the largest force or torque of an arm.
            LinkError: If force mode has ended; the error states the reason.
            LocalError: If called outside the ``with`` block.
        """
        self._check_open()
        self._message.values = _wrench(wrench).tolist()


def _wrench(wrench: Numbers) -> FloatArray:
    values = six(wrench, "wrench")
    for name, value in zip(AXES, values.tolist(), strict=True):
        check_number(value, f"wrench[{name}]", -_LARGEST, _LARGEST, "Nm" if name.startswith("r") else "N")
    return values


_NOTHING = (0.0,) * 6
#: First firmware releases with freedrive in a program, and with freedrive along selected axes.
_FREEDRIVE, _SOME_AXES = Firmware(3, 0), Firmware(5, 10)


@slider(freedrive=SliderEffect.UNSCALED)
class Freedrive(BlockMotion):
    """Freedrive that lasts while a ``with`` block is open; see `robot.freedrive`.

    Args:
        context: The robot.
        axes: Whether each axis of the frame is free, shape (6,). If None, all axes are free.
        frame: Pose of the frame in the base frame, shape (6,).
        watchdog: Longest time without a message from this computer, in s. After this time, the robot ends freedrive.
        open_link: Function that opens the link to the program.

    Raises:
        BadValue: If a number is out of range, or if no axis is free.
        LocalError: If this firmware does not support freedrive, or does not support freedrive along selected axes.
    """

    def __init__(
        self,
        context: MotionContext,
        axes: tuple[bool, ...] | None,
        frame: tuple[float, ...],
        watchdog: float,
        open_link: Callable[[], Link],
    ) -> None:
        firmware = context.who.identity.firmware
        if firmware < _FREEDRIVE:
            raise LocalError(f"firmware {firmware} does not support freedrive; {_FREEDRIVE} or later is required")
        if axes is not None and not any(axes):
            raise BadValue("no axis is free; expected at least one")
        if axes is not None and firmware < _SOME_AXES:
            raise LocalError(
                f"firmware {firmware} can only free all axes; {_SOME_AXES} or later is required to select axes"
            )
        seconds = check_number(watchdog, "watchdog", 0.05, 10.0)
        body = partial(force_control.freedrive, firmware, axes=axes, frame=frame, watchdog=seconds)
        super().__init__(context, "freedrive", KeptMessage(body, _NOTHING), open_link)


#: First firmware releases with direct torque.
DIRECT_TORQUE = Since("5.23/10.11")


@slider(torque=SliderEffect.UNSCALED)
class Torque(BlockMotion):
    """Direct torque from your loop, while a ``with`` block is open; see `robot.motion.torque`.

    Args:
        context: The robot.
        limits: Largest torques that `send` accepts, shape (6,), in Nm. If None, the limits are the maximum torques of
            the joints.
        friction_compensation: Whether the controller compensates the friction of the joints.
        watchdog: Longest time without new torques, in s. After this time, the arm brakes.
        open_link: Function that opens the link to the program.

    Raises:
        BadValue: If a number is out of range.
        LocalError: If this firmware does not support direct torque.
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
        if firmware not in DIRECT_TORQUE:
            raise LocalError(f"firmware {firmware} has no direct torque; 5.23, 10.11 or later is required")
        most = [_LARGEST] * 6 if model is None else model.max_torque.tolist()
        self._limits = most
        if limits is not None:
            self._limits = six(limits, "limits").tolist()
            for joint, (limit, largest) in enumerate(zip(self._limits, most, strict=True)):
                check_number(limit, f"limits[{joint}] ({JOINTS[joint]})", 0.0, largest)
        self._watchdog = check_number(watchdog, "watchdog", 0.01, 1.0)
        compensates = bool(friction_compensation)
        body = partial(force_control.torque, firmware, friction_compensation=compensates, watchdog=self._watchdog)
        self._message = KeptMessage(body)
        super().__init__(context, "torque", self._message, open_link)

    def send(self, torque: ArrayLike) -> None:
        """Apply these torques, starting in the next cycle.

        If no new torques follow, these torques decrease gradually during the watchdog time.

        Args:
            torque: Torques in addition to gravity compensation, shape (6,), in Nm.

        Raises:
            BadValue: If `torque` is not six finite numbers, or if a torque exceeds the limit of its joint. Nothing is
                sent.
            SafetyStop, NotRunning, ConnectionLost, ProgramStopped, Cancelled: If direct torque has ended.
            LocalError: If called outside the ``with`` block.
        """
        self._check_open()
        values = six(torque, "torque").tolist()
        for joint, (value, most) in enumerate(zip(values, self._limits, strict=True)):
            if abs(value) > most:
                raise BadValue(f"torque[{joint}] ({JOINTS[joint]}) is {value:g} Nm; expected at most {most:g} Nm")
        self._message.is_mute = True
        self._say(message(values), self._watchdog)


@dataclass(frozen=True, eq=False)
class Contact:
    """Position of the arm where a contact began.

    Attributes:
        q: Joint positions, shape (6,), in rad.
        pose: Pose of the TCP in the base frame, shape (6,), in m and rad; None if the model of the arm is unknown.
    """

    q: FloatArray
    pose: FloatArray | None


@slider(until_contact=SliderEffect.SCALED)
class ContactMotion(Motion):
    """Motion that ends when the tool touches an object; see `robot.motion.until_contact`.

    The motion fails with `NoContact` if the tool touches nothing.

    Args:
        life: Life cycle of the motion.
        distance: Longest distance without a contact, in m, used in error messages.
        pose_at: Function that returns the pose of the TCP for given joint positions, or None if it is unknown.
    """

    def __init__(self, life: Lifecycle, distance: float, pose_at: Callable[[FloatArray], FloatArray | None]) -> None:
        super().__init__(life)
        self._distance = distance
        self._pose_at = pose_at
        self._contact: Contact | None = None

    @property
    def contact(self) -> Contact | None:
        """Position where the contact began; None while the motion runs, or if there was no contact."""
        return self._contact

    def _on_text(self, text: str) -> None:
        """Handle a line of text from the program."""
        if text.startswith(force_control.NO_CONTACT):
            self._life.fail(NoContact(f"nothing was touched within {self._distance:g} m"))
            return
        q = force_control.contact_of(text)
        if q is not None:
            joints = six(q, "q")
            self._contact = Contact(joints, self._pose_at(joints))

"""Force control: force mode, freedrive, direct torque, and motions that end at a contact."""

from __future__ import annotations

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

#: N and Nm; no arm exerts more.
_LARGEST = 1000.0
#: m and rad, m/s and rad/s; a smaller limit holds the tool where it is.
_LEAST = 1e-6
#: The first releases with force mode, with damping (CB3), and with gain.
_FORCE_MODE = Firmware(3, 0)
_DAMPING_CB, _GAIN = Firmware(3, 5), Firmware(5, 0)
#: The axes of a frame, along and about them.
AXES = ("x", "y", "z", "rx", "ry", "rz")


def axes_of(values: Sequence[object], what: str) -> tuple[bool, ...]:
    """Six of 0 and 1, or of False and True, as booleans.

    Raises:
        BadValue: not six such values.
    """
    axes = list(values)
    if len(axes) != 6 or any(each not in (0, 1) for each in axes):
        raise BadValue(f"{what} is {axes!r}; expected six of 0 and 1: x, y, z, rx, ry, rz")
    return tuple(map(bool, axes))


def frame_of(context: MotionContext, frame: Numbers | str) -> tuple[float, ...]:
    """The pose of a frame: "base", "tool" as it is now, or a pose in the base frame.

    Raises:
        BadValue: none of these.
        LinkTimeout, RemoteError: no state comes, so the pose of the tool is not known.
    """
    if isinstance(frame, str):
        if frame == "base":
            return (0.0,) * 6
        if frame == "tool":
            return tuple(context.state().tool_vector_actual.tolist())
        raise BadValue(f"frame is {frame!r}; expected 'base', 'tool', or a pose in the base frame")
    return tuple(check_pose(frame, "frame").tolist())


def _check_pressing(pressing: Pressing, firmware: Firmware) -> None:
    """Check the numbers, and whether the firmware has what they need.

    Raises:
        BadValue: a number out of range.
        LocalError: this firmware has no force mode, damping or gain.
    """
    if firmware < _FORCE_MODE:
        raise LocalError(f"force mode is used from firmware {_FORCE_MODE} on, not on {firmware}")
    if pressing.kind not in (1, 2, 3):
        raise BadValue(f"kind is {pressing.kind!r}; expected 1, 2 or 3")
    for index, (name, limit, is_free) in enumerate(zip(AXES, pressing.limits, pressing.selection, strict=True)):
        speed, deviation = (TOOL_SPEED, POSITION) if index < 3 else (TOOL_TURN, TURN)
        bound = speed if is_free else deviation
        check_number(limit, f"limits[{name}]", _LEAST, bound.most, bound.unit)
    if pressing.damping is not None:
        check_number(pressing.damping, "damping", 0.0, 1.0)
        if firmware < _DAMPING_CB:
            raise LocalError(f"firmware {firmware} takes no damping; {_DAMPING_CB} is the first")
    if pressing.gain is not None:
        check_number(pressing.gain, "gain", 0.0, 2.0)
        if firmware < _GAIN:
            raise LocalError(f"firmware {firmware} takes no gain; {_GAIN} is the first")


@slider(force_mode=SliderEffect.UNSCALED)
class ForceMode(BlockMotion):
    """Force mode while a ``with`` block is open; made by `robot.motion.force_mode`."""

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
        seconds = check_number(watchdog, "watchdog", 0.05, 10.0)
        body = partial(force_control.force_mode, firmware, pressing=pressing, watchdog=seconds)
        self._message = KeptMessage(body, _wrench(wrench).tolist())
        super().__init__(context, "force_mode", self._message, open_link)

    @property
    def wrench(self) -> FloatArray:
        """(6,) what the tool is to exert, N and Nm along and about the axes of the frame."""
        assert self._message.values is not None  # there is a wrench from the first message on
        return six(self._message.values, "wrench")

    def set_wrench(self, wrench: Numbers) -> None:
        """Exert another wrench from the next state on. Along axes that are not compliant it has no effect.

        Raises:
            BadValue: not six finite numbers, or more than an arm can exert.
            LinkError: force mode is over; the error says why.
            LocalError: not within the block.
        """
        self._check_open()
        self._message.values = _wrench(wrench).tolist()


def _wrench(wrench: Numbers) -> FloatArray:
    values = six(wrench, "wrench")
    for name, value in zip(AXES, values.tolist(), strict=True):
        check_number(value, f"wrench[{name}]", -_LARGEST, _LARGEST, "Nm" if name.startswith("r") else "N")
    return values


_NOTHING = (0.0,) * 6
#: The first releases that have freedrive in a program, and freedrive along selected axes.
_FREEDRIVE, _SOME_AXES = Firmware(3, 0), Firmware(5, 10)


@slider(freedrive=SliderEffect.UNSCALED)
class Freedrive(BlockMotion):
    """Freedrive while a ``with`` block is open; made by `robot.freedrive`.

    Args:
        context: the robot.
        axes: (6,) of the frame that are free; None for all.
        frame: (6,) pose in the base frame.
        watchdog: s without a message from this computer after which the robot ends freedrive.
        open_link: opens the link to the program.

    Raises:
        BadValue: a number out of range, or no axis is free.
        LocalError: this firmware has no freedrive, or none along selected axes.
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
            raise LocalError(f"freedrive is used from firmware {_FREEDRIVE} on, not on {firmware}")
        if axes is not None and not any(axes):
            raise BadValue("no axis is free; expected one at least")
        if axes is not None and firmware < _SOME_AXES:
            raise LocalError(f"firmware {firmware} frees all axes or none; {_SOME_AXES} is the first that takes axes")
        seconds = check_number(watchdog, "watchdog", 0.05, 10.0)
        body = partial(force_control.freedrive, firmware, axes=axes, frame=frame, watchdog=seconds)
        super().__init__(context, "freedrive", KeptMessage(body, _NOTHING), open_link)


#: The first releases that have direct torque.
DIRECT_TORQUE = Since("5.23/10.11")


@slider(torque=SliderEffect.UNSCALED)
class Torque(BlockMotion):
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
        if firmware not in DIRECT_TORQUE:
            raise LocalError(f"firmware {firmware} has no direct torque: 5.23 and 10.11 are the first")
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


@dataclass(frozen=True, eq=False)
class Contact:
    """Where a contact began.

    Attributes:
        q: (6,) joint positions, rad.
        pose: (6,) of the TCP in the base frame, m and rad; None where it is not known which arm this is.
    """

    q: FloatArray
    pose: FloatArray | None


@slider(until_contact=SliderEffect.SCALED)
class ContactMotion(Motion):
    """A movement until a contact; made by `robot.motion.until_contact`. It fails with `NoContact` if there is none.

    Args:
        life: life cycle of the motion.
        distance: m after which it ends without a contact, for messages.
        pose_at: the pose of the TCP at joint positions.
    """

    def __init__(self, life: Lifecycle, distance: float, pose_at: Callable[[FloatArray], FloatArray | None]) -> None:
        super().__init__(life)
        self._distance = distance
        self._pose_at = pose_at
        self._contact: Contact | None = None

    @property
    def contact(self) -> Contact | None:
        """Where the contact began; None while it runs, and if it ended without a contact."""
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

"""Blocks in which the arm yields: force mode, along some axes, where the tool presses, and freedrive, moved by hand."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

from linkcore.arguments import check_number
from linkcore.errors import BadValue, LocalError

from ..bounds import POSITION, TOOL_SPEED, TOOL_TURN, TURN, check_pose
from ..firmware import Firmware
from ..urscript import yielding
from ..vectors import FloatArray, Numbers, six
from .context import MotionContext
from .linked import Link
from .linked_block import KeptMessage, LinkedBlock

#: N and Nm; no arm exerts more.
_LARGEST = 1000.0
#: m and rad, m/s and rad/s; a smaller limit holds the tool where it is.
_LEAST = 1e-6
#: The first releases with force mode, with damping (CB3), and with gain.
_FORCE_MODE = Firmware(3, 0)
_DAMPING_CB, _GAIN = Firmware(3, 5), Firmware(5, 0)
_NAMES = ("x", "y", "z", "rx", "ry", "rz")


@dataclass(frozen=True)
class Pressing:
    """The parameters of force mode that are set once, when it begins.

    Attributes:
        frame: (6,) pose in the base frame.
        selection: (6,) the compliant axes.
        limits: (6,) of speed along them, m/s and rad/s; of deviation along the others, m and rad.
        kind: 1, 2 or 3: how the controller turns the frame; see `Motions.force_mode`.
        damping, gain: None for those of the controller.
    """

    frame: tuple[float, ...]
    selection: tuple[bool, ...]
    limits: tuple[float, ...]
    kind: int
    damping: float | None
    gain: float | None

    def check(self, firmware: Firmware) -> None:
        """Check the numbers, and whether the firmware has what they need.

        Raises:
            BadValue: a number out of range.
            LocalError: this firmware has no force mode, damping or gain.
        """
        if firmware < _FORCE_MODE:
            raise LocalError(f"force mode is used from firmware {_FORCE_MODE} on, not on {firmware}")
        if self.kind not in (1, 2, 3):
            raise BadValue(f"kind is {self.kind!r}; expected 1, 2 or 3")
        for index, (name, limit, is_free) in enumerate(zip(_NAMES, self.limits, self.selection, strict=True)):
            speed, deviation = (TOOL_SPEED, POSITION) if index < 3 else (TOOL_TURN, TURN)
            bound = speed if is_free else deviation
            check_number(limit, f"limits[{name}]", _LEAST, bound.most, bound.unit)
        if self.damping is not None:
            check_number(self.damping, "damping", 0.0, 1.0)
            if firmware < _DAMPING_CB:
                raise LocalError(f"firmware {firmware} takes no damping; {_DAMPING_CB} is the first")
        if self.gain is not None:
            check_number(self.gain, "gain", 0.0, 2.0)
            if firmware < _GAIN:
                raise LocalError(f"firmware {firmware} takes no gain; {_GAIN} is the first")


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


class ForceMode(LinkedBlock):
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
        pressing.check(firmware)
        self._message = KeptMessage(
            partial(
                yielding.force_mode,
                firmware,
                frame=pressing.frame,
                selection=pressing.selection,
                limits=pressing.limits,
                kind=pressing.kind,
                damping=pressing.damping,
                gain=pressing.gain,
                watchdog=check_number(watchdog, "watchdog", 0.05, 10.0),
            ),
            _wrench(wrench).tolist(),
        )
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
    for name, value in zip(_NAMES, values.tolist(), strict=True):
        check_number(value, f"wrench[{name}]", -_LARGEST, _LARGEST, "Nm" if name.startswith("r") else "N")
    return values


_NOTHING = (0.0,) * 6
#: The first releases that have freedrive in a program, and freedrive along selected axes.
_FREEDRIVE, _AXES = Firmware(3, 0), Firmware(5, 10)


class Freedrive(LinkedBlock):
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
        if axes is not None and firmware < _AXES:
            raise LocalError(f"firmware {firmware} frees all axes or none; {_AXES} is the first that takes axes")
        seconds = check_number(watchdog, "watchdog", 0.05, 10.0)
        body = partial(yielding.freedrive, firmware, axes=axes, frame=frame, watchdog=seconds)
        super().__init__(context, "freedrive", KeptMessage(body, _NOTHING), open_link)

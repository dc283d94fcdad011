"""The parameters of an impedance: their ranges, and the program that has them.

Numbers that are out of range, or that have no effect with this frame or this firmware, are refused.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from linkcore.arguments import check_number
from linkcore.errors import BadValue, LocalError
from linkcore.wire.fields import Since

from ...arm.bounds import TOOL_SPEED, TOOL_TURN
from ...arm.models import Model
from ...arm.parameters import numbers as parameter
from ...arm.parameters import parameters
from ...arm.vectors import JOINTS, FloatArray, six
from ...protocol.firmware import Firmware
from ...script.links import Writer
from ...script.springs import Springs, ToolSprings, admittance, impedance
from .force_control import AXES, DIRECT_TORQUE
from .jog import FULL_SPEED, FrameName

#: The first firmware of arms whose wrist measures force that computes with whole lists.
_MEASURED_FORCE = Since("5.10/10.0")
#: Nm/rad of a joint at most, N/m and Nm/rad of the tool: with its inertia more would swing faster than a cycle lets
#: it be damped.
_STIFFEST, _STIFFEST_TOOL = (10_000.0,) * 6, (5_000.0,) * 3 + (200.0,) * 3
#: The largest damping ratio.
_DAMPEST = (3.0,) * 6
#: rad/s or m/s, rad or m: the least speed and the largest error that an axis can be given.
_SLOWEST, _FURTHEST, _FURTHEST_TOOL = 0.01, (3.0,) * 6, (0.5,) * 3 + (1.5,) * 3
#: The part of its largest torque that springs and dampers of a joint may have; and how many times as much, at most,
#: brakes it. Chosen: so that what brakes is always more than what drives.
_SHARE, _BRAKING = 0.5, 4.0
#: Of the tool, if nothing else is given: N/m and Nm/rad, N and Nm, m and rad. Chosen: as much as the vendor's torques
#: can hold at half of the reach of a UR5e.
_TOOL_STIFFNESS = (500.0,) * 3 + (30.0,) * 3
_TOOL_FORCE = (50.0,) * 3 + (5.0,) * 3
_TOOL_ERROR = (0.1,) * 3 + (0.5,) * 3
#: N and Nm at most.
_STRONGEST = (200.0,) * 3 + (30.0,) * 3
#: Nm/rad to the posture if nothing else is given, and at most; rad/s of a joint under springs of the tool at most.
#: Chosen: some hundredths of what springs of the tool are; and near a singular pose a joint turns far while the tool
#: moves little.
_POSTURE, _TIGHTEST, _TURNING = 0.5, (200.0,) * 6, 1.5
#: rad that stand for a joint that turns without end.
_ENDLESS = 1e6


@dataclass(frozen=True)
class ImpedanceParameters:
    """The numbers of `Motions.impedance`, as they were given.

    Attributes:
        frame: of the springs.
        stiffness, damping, torque, speed, error, force, posture_stiffness: (6,) or one for all; None for the default.
        friction_compensation: whether the controller compensates the friction of the joints.
        watchdog: s without a message from this computer after which the robot ends it.
    """

    frame: FrameName
    stiffness: ArrayLike | None
    damping: ArrayLike
    torque: ArrayLike | None
    speed: ArrayLike | None
    error: ArrayLike | None
    force: ArrayLike | None
    posture_stiffness: ArrayLike | None
    friction_compensation: bool
    watchdog: float

    def program(self, firmware: Firmware, model: Model | None) -> tuple[Writer, FloatArray, bool]:
        """What makes the lines of the program, the stiffness that it begins with, and whether it takes a posture.

        Raises:
            BadValue, LocalError: as `Motions.impedance`.
        """
        has_torque = firmware in DIRECT_TORQUE
        if not has_torque:
            self._check_measured(firmware)
        if model is None:
            raise LocalError("the controller does not say which arm this is, so its torques and speeds are not known")
        seconds = check_number(self.watchdog, "watchdog", 0.05, 10.0, "s")
        ratios = damping_of(self.frame, self.damping)
        tool = None if self.frame == "joints" else self._tool()
        if tool is None:
            self._refuse(("force", "posture_stiffness"), "is of springs of the tool, frame='base' or 'tool'")
            given = _default("impedance_stiffness", model) if self.stiffness is None else self.stiffness
            rates = _within(_or(self.speed, 1.0), "speed", JOINTS, _SLOWEST, model.max_speed.tolist(), "rad/s")
            stretch = _within(_or(self.error, 0.2), "error", JOINTS, 0.0, _FURTHEST, "rad")
        else:
            given = _or(self.stiffness, _TOOL_STIFFNESS)
            rates = np.minimum(_TURNING, model.max_speed)
            stretch = _within(_or(self.error, _TOOL_ERROR), "error", AXES, 0.0, _FURTHEST_TOOL)
        stiffness = stiffness_of(self.frame, given)
        if tool is not None and not has_torque:
            return (
                partial(
                    admittance,
                    firmware,
                    stiffness=stiffness.tolist(),
                    damping=ratios.tolist(),
                    error=stretch.tolist(),
                    tool=tool,
                    watchdog=seconds,
                ),
                stiffness,
                False,
            )
        most = model.max_torque
        low, high = np.clip(model.position_limits, -_ENDLESS, _ENDLESS).T
        torque = _default("impedance_torque", model) if self.torque is None else self.torque
        torques = _within(torque, "torque", JOINTS, 0.0, (_SHARE * most).tolist(), "Nm")
        springs = Springs(
            stiffness=stiffness.tolist(),
            damping=ratios.tolist(),
            speed=rates.tolist(),
            torque=torques.tolist(),
            braking=np.minimum(_BRAKING * torques, most).tolist(),
            error=stretch.tolist(),
            lowest=low.tolist(),
            highest=high.tolist(),
            friction_compensation=bool(self.friction_compensation),
            watchdog=seconds,
            tool=tool,
        )
        return partial(impedance, firmware, springs=springs), stiffness, tool is not None

    def _check_measured(self, firmware: Firmware) -> None:
        """Raise unless springs of the tool can act by the force that its wrist measures."""
        without = f"firmware {firmware} has no direct torque: 5.23 and 10.11 have it"
        if firmware not in _MEASURED_FORCE:
            raise LocalError(
                f"{without}; nor the force sensor of an e-Series wrist, by which the tool is led from 5.10 on"
            )
        if self.frame == "joints":
            raise LocalError(
                f"{without}, by which springs of the joints act; those of the tool, frame='base' or 'tool', act by the "
                "force sensor of its wrist"
            )
        self._refuse(("torque", "posture_stiffness"), f"has no effect: {without}")

    def _refuse(self, names: Sequence[str], why: str) -> None:
        for name in names:
            if getattr(self, name) is not None:
                raise BadValue(f"{name} {why}; expected none")

    def _tool(self) -> ToolSprings:
        fastest = (TOOL_SPEED.most,) * 3 + (TOOL_TURN.most,) * 3
        speed = _or(self.speed, FULL_SPEED[self.frame])
        bending = _or(self.posture_stiffness, _POSTURE)
        return ToolSprings(
            in_tool=self.frame == "tool",
            speed=_within(speed, "speed", AXES, _SLOWEST, fastest).tolist(),
            force=_within(_or(self.force, _TOOL_FORCE), "force", AXES, 0.0, _STRONGEST).tolist(),
            posture=_within(bending, "posture_stiffness", JOINTS, 0.0, _TIGHTEST, "Nm/rad").tolist(),
        )


def stiffness_of(frame: FrameName, values: ArrayLike) -> FloatArray:
    """(6,) Nm/rad of the joints, or N/m and Nm/rad of the tool.

    Raises:
        BadValue: out of range.
    """
    if frame == "joints":
        return _within(values, "stiffness", JOINTS, 0.0, _STIFFEST, "Nm/rad")
    return _within(values, "stiffness", AXES, 0.0, _STIFFEST_TOOL)


def damping_of(frame: FrameName, values: ArrayLike) -> FloatArray:
    """(6,) ratios.

    Raises:
        BadValue: out of range.
    """
    return _within(values, "damping", JOINTS if frame == "joints" else AXES, 0.0, _DAMPEST)


def _or(given: ArrayLike | None, default: ArrayLike) -> ArrayLike:
    return default if given is None else given


def _default(name: str, model: Model) -> FloatArray:
    if (name, model.name) not in parameters():
        what = name.removeprefix("impedance_")
        raise BadValue(f"{what} has no default for a {model.name}; expected a number, or six")
    return np.array(parameter(name, model.name))


def _within(
    values: ArrayLike, name: str, axes: Sequence[str], least: float, most: Sequence[float], unit: str = ""
) -> FloatArray:
    """One number for all axes or six, each within its range."""
    given = six(np.broadcast_to(values, 6) if np.ndim(values) == 0 else values, name)
    for at, (value, limit) in enumerate(zip(given.tolist(), most, strict=True)):
        check_number(value, f"{name}[{at}] ({axes[at]})", least, limit, unit)
    return given

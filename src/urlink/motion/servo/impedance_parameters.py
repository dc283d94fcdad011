"""Parameters of an impedance, the ranges of the parameters, and the program that uses the parameters.

A number is rejected if it is out of range, or if it has no effect with the given frame or firmware.
"""

from __future__ import annotations

import dataclasses
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
from ...session.session_limits import SessionLimits
from .force_control import AXES, DIRECT_TORQUE
from .jog import FULL_SPEED, FrameName

#: First firmware whose URScript computes with whole lists. The program for arms with a force sensor in the wrist needs
#: this.
_MEASURED_FORCE = Since("5.10/10.0")
#: Largest stiffness: for a joint in Nm/rad, for the tool in N/m and Nm/rad. With a larger stiffness, the oscillation of
#: an axis would be too fast to be damped once per cycle.
_STIFFEST, _STIFFEST_TOOL = (10_000.0,) * 6, (5_000.0,) * 3 + (200.0,) * 3
#: Largest damping ratio.
_DAMPEST = (3.0,) * 6
#: Smallest speed limit of an axis, in rad/s or m/s, and largest allowed error, in rad or m (for joints, and for the
#: tool).
_SLOWEST, _FURTHEST, _FURTHEST_TOOL = 0.01, (3.0,) * 6, (0.5,) * 3 + (1.5,) * 3
#: Largest fraction of the maximum torque of a joint that springs and dampers may use. Largest braking torque, as a
#: multiple of the torque limit of springs and dampers. Chosen so that the braking torque is always larger than the
#: driving torque.
_SHARE, _BRAKING = 0.5, 4.0
#: Defaults for springs of the tool: stiffness in N/m and Nm/rad, largest force in N and Nm, largest error in m and rad.
#: Chosen: as much as the vendor's torque limits permit at half of the reach of a UR5e.
_TOOL_STIFFNESS = (500.0,) * 3 + (30.0,) * 3
_TOOL_FORCE = (50.0,) * 3 + (5.0,) * 3
_TOOL_ERROR = (0.1,) * 3 + (0.5,) * 3
#: Largest allowed force in N and torque in Nm of springs of the tool.
_STRONGEST = (200.0,) * 3 + (30.0,) * 3
#: Default and largest posture stiffness, in Nm/rad, and largest speed of a joint with springs of the tool, in rad/s.
#: Chosen: the default is a few hundredths of the stiffness of the springs of the tool. The speed limit is needed near a
#: singular pose, because a joint turns far there while the tool moves little.
_POSTURE, _TIGHTEST, _TURNING = 0.5, (200.0,) * 6, 1.5
#: Position limit in rad that is used for a joint without position limits.
_ENDLESS = 1e6


@dataclass(frozen=True)
class ImpedanceParameters:
    """Arguments of `Motions.impedance`, as the caller passed them.

    Attributes:
        frame: Frame of the springs.
        stiffness, damping, torque, speed, error, force, posture_stiffness: One number for all axes, or shape (6,); None
            for the default.
        friction_compensation: Whether the controller compensates the friction of the joints.
        watchdog: Longest time without a message from this computer, in s. After this time, the robot ends the motion.
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

    def fastest(self) -> FloatArray:
        """Return the largest speeds, (6,): of the joints in rad/s, or of the tool in m/s and rad/s."""
        usual = 1.0 if self.frame == "joints" else FULL_SPEED[self.frame]
        return np.broadcast_to(np.array(_or(self.speed, usual), dtype=np.float64), (6,))

    def slowed(self, limits: SessionLimits | None) -> ImpedanceParameters:
        """Return these parameters with largest speeds that do not exceed the limits of the session."""
        if limits is None:
            return self
        fastest = self.fastest()
        if self.frame == "joints":
            slowed = fastest if limits.joint_speed is None else np.minimum(fastest, limits.joint_speed)
        else:
            most, line = limits.tool_speed, float(np.linalg.norm(fastest[:3]))
            share = 1.0 if most is None or line <= most else most / line
            slowed = fastest * ([share] * 3 + [1.0] * 3)
        return self if (slowed == fastest).all() else dataclasses.replace(self, speed=slowed)

    def program(self, firmware: Firmware, model: Model | None) -> tuple[Writer, FloatArray, bool]:
        """Return the function that writes the program, the initial stiffness, and whether the program takes a posture.

        Raises:
            BadValue, LocalError: If an argument is rejected; see `Motions.impedance`.
        """
        has_torque = firmware in DIRECT_TORQUE
        if not has_torque:
            self._check_measured(firmware)
        if model is None:
            raise LocalError(
                "the controller does not report the model of the arm, so its torque and speed limits are unknown"
            )
        seconds = check_number(self.watchdog, "watchdog", 0.05, 10.0, "s")
        ratios = damping_of(self.frame, self.damping)
        tool = None if self.frame == "joints" else self._tool()
        if tool is None:
            self._refuse(("force", "posture_stiffness"), "applies only to springs of the tool (frame='base' or 'tool')")
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
        """Raise an error unless the program can use the measured force of the wrist for springs of the tool."""
        without = f"firmware {firmware} has no direct torque (5.23, 10.11 or later is required)"
        if firmware not in _MEASURED_FORCE:
            raise LocalError(
                f"{without}; without it, springs of the tool need the force sensor of an e-Series wrist, and firmware "
                "5.10 or later"
            )
        if self.frame == "joints":
            raise LocalError(
                f"{without}, which springs of the joints need; only springs of the tool, frame='base' or 'tool', can "
                "use the force sensor of the wrist"
            )
        self._refuse(("torque", "posture_stiffness"), f"has no effect: {without}")

    def _refuse(self, names: Sequence[str], why: str) -> None:
        for name in names:
            if getattr(self, name) is not None:
                raise BadValue(f"{name} {why}; omit it")

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
    """Check a stiffness, and return it as (6,): for joints in Nm/rad, for the tool in N/m and Nm/rad.

    Raises:
        BadValue: If a number is out of range.
    """
    if frame == "joints":
        return _within(values, "stiffness", JOINTS, 0.0, _STIFFEST, "Nm/rad")
    return _within(values, "stiffness", AXES, 0.0, _STIFFEST_TOOL)


def damping_of(frame: FrameName, values: ArrayLike) -> FloatArray:
    """Check damping ratios, and return them as (6,).

    Raises:
        BadValue: If a number is out of range.
    """
    return _within(values, "damping", JOINTS if frame == "joints" else AXES, 0.0, _DAMPEST)


def _or(given: ArrayLike | None, default: ArrayLike) -> ArrayLike:
    return default if given is None else given


def _default(name: str, model: Model) -> FloatArray:
    if (name, model.name) not in parameters():
        what = name.removeprefix("impedance_")
        raise BadValue(f"{what} has no default for a {model.name}; expected one number or six")
    return np.array(parameter(name, model.name))


def _within(
    values: ArrayLike, name: str, axes: Sequence[str], least: float, most: Sequence[float], unit: str = ""
) -> FloatArray:
    """Check one number for all axes, or six numbers. Each number must be within the range of its axis."""
    given = six(np.broadcast_to(values, 6) if np.ndim(values) == 0 else values, name)
    for at, (value, limit) in enumerate(zip(given.tolist(), most, strict=True)):
        check_number(value, f"{name}[{at}] ({axes[at]})", least, limit, unit)
    return given

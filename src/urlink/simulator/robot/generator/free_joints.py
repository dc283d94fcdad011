"""Freedrive with every axis free, and direct torque: the joints yield to torques.

In **freedrive** each joint moves as an inertia with damping under the torques from outside; gravity is compensated. At
the end of its range a joint stands still. The inertias and the damping are guesses, and so is the speed of the tool
above which the controller stops the arm.

Under **direct torque** the joints move by the masses of the arm, of its motors and of its payload, under the torques
that a program gives for one cycle and those from outside. The controller compensates gravity, as the vendor says; if
the program does not have friction compensated, it has a guessed size. In a cycle without a torque the arm
brakes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from urlink.dynamics import Dynamics
from urlink.kinematics import Arm
from urlink.vectors import FloatArray

from ..sources import Setpoint
from .joint_limits import JointLimits, LimitViolation
from .path_motion import Move
from .speed_motion import JointSpeed

__all__ = ["ROTORS", "FreeJoints", "TorqueMotion"]

_REST = [0.0] * 6
# kg m² and 1/s of each joint in freedrive; s: times the change of a torque, this is a braking torque.
_INERTIA = np.array([5.0, 5.0, 3.0, 1.0, 1.0, 0.5])
_DAMPING = 8.0
_BRAKE = 0.03
# m/s of the tool in freedrive
_FASTEST = 1.5
# kg m² that motors and gears add to each joint; without them a wrist would have almost no inertia. A guess.
ROTORS = (0.3, 0.3, 0.3, 0.1, 0.1, 0.1)
# Nm and Nms of the friction in each joint, and rad/s above which the first has its full size.
_COULOMB, _VISCOUS, _STICTION = 3.0, 5.0, 0.02


class FreeJoints:
    """Freedrive with every axis free.

    Args:
        kinematics, limits: of the arm.
        tcp: (6,) in the frame of the flange.
        begin: present set-point.
    """

    def __init__(self, kinematics: Arm, limits: JointLimits, tcp: Sequence[float], begin: Setpoint) -> None:
        self._kinematics, self._limits, self._tcp = kinematics, limits, list(tcp)
        self._last = begin
        self._lowest, self._highest = kinematics.position_limits.T
        self._felt: FloatArray | None = None

    def advance(self, wrench: Sequence[float], torques: Sequence[float], seconds: float) -> Setpoint:
        """The set-point one cycle later, under a wrench at the TCP in the base frame, and torques at the joints.

        Raises:
            LimitViolation: a joint, or the tool, gets too fast.
        """
        last = self._last
        felt = np.asarray(torques, dtype=np.float64)
        if any(wrench):
            felt = felt + self._kinematics.jacobian(last.q, self._tcp).T @ np.asarray(wrench)
        change = np.zeros(6) if self._felt is None else felt - self._felt
        self._felt = felt
        qd = np.array(last.qd) * math.exp(-_DAMPING * seconds) + (felt * seconds + _BRAKE * change) / _INERTIA
        q = np.array(last.q) + seconds * qd
        is_inside = (self._lowest < q) & (q < self._highest)
        qd = np.where(is_inside & (np.abs(qd) > 1e-9), qd, 0.0)
        q = np.clip(q, self._lowest, self._highest)
        setpoint = Setpoint(q.tolist(), qd.tolist(), ((qd - np.array(last.qd)) / seconds).tolist())
        self._limits.check(last, setpoint, seconds)
        if any(setpoint.qd):
            speed = math.hypot(*self._kinematics.velocity(setpoint.q, setpoint.qd, self._tcp)[:3].tolist())
            if speed > _FASTEST:
                raise LimitViolation(
                    f"freedrive: the tool is moved at {speed:.2f} m/s, at most {_FASTEST:g} is allowed"
                )
        self._last = setpoint
        return setpoint


class TorqueMotion:
    """Direct torque for one cycle.

    Args:
        dynamics: of the arm and its payload; gravity has no effect.
        torque: (6,) Nm of the program, and from outside.
        friction: (6,) fraction of its friction that each joint has, 0 to 1.
        acceleration: (6,) rad/s² with which the arm brakes if no torque follows.

    Attributes:
        move: over after one cycle.
    """

    def __init__(
        self, dynamics: Dynamics, torque: FloatArray, friction: Sequence[float], acceleration: Sequence[float]
    ) -> None:
        self.move = Move()
        self.is_at_rest = False
        self.overrun = 0.0
        self._dynamics, self._torque, self._friction = dynamics, torque, np.array(friction)
        self._brake = JointSpeed(_REST, acceleration, None)

    def advance(self, last: Setpoint, seconds: float, scaling: float, change: float) -> Setpoint:
        """The set-point one cycle later."""
        if self.move.is_over:
            setpoint = self._brake.advance(last, seconds, scaling, change)
            self.is_at_rest = self._brake.is_at_rest
            return setpoint
        self.move.is_over = True
        speed = np.array(last.qd)
        rub = self._friction * (_COULOMB * np.tanh(speed / _STICTION) + _VISCOUS * speed)
        left = self._torque - rub - self._dynamics.coriolis_torque(last.q, last.qd)
        qdd = np.linalg.solve(self._dynamics.mass_matrix(last.q) + np.diag(ROTORS), left)
        qd = speed + seconds * qdd
        return Setpoint((np.array(last.q) + seconds * qd).tolist(), qd.tolist(), qdd.tolist())

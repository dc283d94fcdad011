"""How an arm gives way: in freedrive, under direct torque, and in force mode.

In freedrive and under direct torque the joints yield, by the one model of the arm: the masses of links and payload, and
the rotors.

In **freedrive** it moves under the torques from outside; gravity and friction are compensated, and its speed is damped.
At the end of its range a joint stands still. The damping is a guess, and so is the speed of the tool above which the
controller stops the arm.

Under **direct torque** it moves under the torques that a program gives for one cycle and those from outside. The
controller compensates gravity, as the vendor says; what the program does not have compensated of its friction is that
of the joints (`urlink.arm.motors`). In a cycle without a torque the arm brakes.

In force mode the tool yields along some axes until a force is there, and follows its path along the others.
How a controller does this is not published beyond the purpose of the arguments; this model keeps to that.

- Along a **compliant axis** the tool moves as a mass with damping would, under the force that it is to exert and the
  one that acts on it. The change of the force brakes it too, so that it comes to rest on stiff things. `damping` is the
  part of its speed that a mass loses in 2 ms: 0 keeps it, 1 stops it at once. `gain` scales the force that moves it. It
  never gets faster than its limit; where something other than the wanted force drives it at that limit for a tenth of a
  second, the arm is stopped.
- Along **every other axis** it follows the program, and gives way like a stiff spring. Where it is off by more than its
  limit, the arm is stopped.

The masses, stiffnesses and times are guesses. A contact of up to 100 kN/m is held stably at 125 Hz, a stiffer one at
500 Hz.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from urlink.arm.dynamics import Dynamics
from urlink.arm.motors import Motors
from urlink.arm.parameters import number, numbers
from urlink.arm.poses import rotvec_to_matrix
from urlink.arm.vectors import FloatArray

from ..setpoint_sources import REST, Setpoint
from .joint_limits import ArmWithTool, LimitViolation, moved
from .path_motion import Command
from .streamed_motion import JointSpeed

# s: times the change of a torque or a force, this brakes.
_BRAKE = 0.03
# 1/s of each joint in freedrive
_FREE_DAMPING = number("freedrive_damping")
# m/s of the tool in freedrive
_FASTEST = number("freedrive_fastest")


class FreeJoints:
    """Freedrive with every axis free.

    Args:
        arm: with its tool.
        dynamics: of the arm with its rotors and its payload.
        begin: present set-point.
    """

    def __init__(self, arm: ArmWithTool, dynamics: Dynamics, begin: Setpoint) -> None:
        self._arm, self._dynamics = arm, dynamics
        self._last = begin
        self._lowest, self._highest = arm.kinematics.position_limits.T
        self._felt: FloatArray | None = None

    def advance(self, wrench: Sequence[float], torques: Sequence[float], seconds: float) -> Setpoint:
        """The set-point one cycle later, under a wrench at the TCP in the base frame, and torques at the joints.

        Raises:
            LimitViolation: a joint, or the tool, gets too fast.
        """
        last = self._last
        felt = np.asarray(torques, dtype=np.float64)
        if any(wrench):
            felt = felt + self._arm.kinematics.jacobian(last.q, self._arm.tcp).T @ np.asarray(wrench)
        change = np.zeros(6) if self._felt is None else felt - self._felt
        self._felt = felt
        push = np.linalg.solve(self._dynamics.mass_matrix(last.q), felt * seconds + _BRAKE * change)
        qd = np.array(last.qd) * math.exp(-_FREE_DAMPING * seconds) + push
        q = np.array(last.q) + seconds * qd
        is_inside = (self._lowest < q) & (q < self._highest)
        qd = np.where(is_inside & (np.abs(qd) > 1e-9), qd, 0.0)
        q = np.clip(q, self._lowest, self._highest)
        setpoint = Setpoint(q.tolist(), qd.tolist(), ((qd - np.array(last.qd)) / seconds).tolist())
        self._arm.limits.check(last, setpoint, seconds)
        if any(setpoint.qd):
            speed = math.hypot(*self._arm.velocity(setpoint.q, setpoint.qd)[:3].tolist())
            if speed > _FASTEST:
                raise LimitViolation(
                    f"freedrive: the tool is moved at {speed:.2f} m/s, at most {_FASTEST:g} is allowed"
                )
        self._last = setpoint
        return setpoint


class TorqueMotion(Command):
    """Direct torque for one cycle.

    Args:
        dynamics: of the arm with its rotors and its payload; gravity has no effect.
        motors: of the arm.
        torque: (6,) Nm of the program, and from outside.
        friction: (6,) fraction of its friction that each joint has, 0 to 1.
        acceleration: (6,) rad/s² with which the arm brakes if no torque follows.

    Attributes:
        is_over: after one cycle.
    """

    def __init__(
        self,
        dynamics: Dynamics,
        motors: Motors,
        torque: FloatArray,
        friction: Sequence[float],
        acceleration: Sequence[float],
    ) -> None:
        self._dynamics, self._motors, self._torque, self._friction = dynamics, motors, torque, np.array(friction)
        self._brake = JointSpeed(REST, acceleration, None)

    def advance(self, last: Setpoint, seconds: float, scaling: float, change: float) -> Setpoint:
        """The set-point one cycle later."""
        if self.is_over:
            setpoint = self._brake.advance(last, seconds, scaling, change)
            self.is_at_rest = self._brake.is_at_rest
            return setpoint
        self.is_over = True
        speed = np.array(last.qd)
        rub, slope = (self._friction * each for each in self._motors.friction_torque(last.qd))
        left = self._torque - rub - self._dynamics.coriolis_torque(last.q, last.qd)
        # Friction at the end of the cycle: with that at its beginning a light joint would tremble about rest.
        qdd = np.linalg.solve(self._dynamics.mass_matrix(last.q) + np.diag(seconds * slope), left)
        qd = speed + seconds * qdd
        return Setpoint((np.array(last.q) + seconds * qd).tolist(), qd.tolist(), qdd.tolist())


# kg and kg m² that move along and about a compliant axis.
_MASS = np.array(numbers("force_mode_mass"))
# 1/s that damping 1 is: all of the speed within 2 ms.
_DAMPING = 500.0
# N/m and Nm/rad of the axes that are not compliant, and s in which they give way.
_STIFFNESS = np.array([20e3, 20e3, 20e3, 500.0, 500.0, 500.0])
_GIVING_WAY = 0.05
# N and Nm above which an axis counts as pushed, and s for which it may be pushed at its largest speed.
_DRIVEN = np.array([5.0, 5.0, 5.0, 0.5, 0.5, 0.5])
_DRIVEN_FOR = 0.1
# m/s below which the movement has no direction, and m within which there is none towards the frame.
_SLOW, _NEAR = 1e-4, 1e-6

_AXES = ("x", "y", "z", "rx", "ry", "rz")
_UNITS = ("m", "m", "m", "rad", "rad", "rad")


@dataclass(frozen=True)
class ForceTask:
    """The arguments of `force_mode`.

    Attributes:
        frame: (6,) pose in the base frame; only its axes have an effect.
        selection: (6,) which of them are compliant.
        wrench: (6,) N and Nm that the tool is to exert along and about compliant axes.
        kind: 1 turns the y axis towards the origin of the frame, as seen from the tool; 2 leaves it as it is; 3 turns
            the x axis into the direction in which the tool moves in the x-y plane.
        limits: (6,) largest speed of compliant axes, m/s and rad/s, and largest deviation of the others, m and rad.
        damping: 0 to 1.
        gain: 0 to 2.
    """

    frame: Sequence[float]
    selection: Sequence[bool]
    wrench: Sequence[float]
    kind: int
    limits: Sequence[float]
    damping: float = 0.005
    gain: float = 1.0


def free_tool(frame: Sequence[float], axes: Sequence[bool]) -> ForceTask:
    """Freedrive along some axes of a frame: no force is exerted, speed dies away quickly, and there are no limits."""
    return ForceTask(frame, axes, (0.0,) * 6, 2, (math.inf,) * 6, damping=0.02)


class Compliance:
    """Changes the set-points of a program to those of an arm under force control.

    Args:
        arm: with its tool.
        begin: present set-point; the axes that follow the program keep its speed.
        task: the arguments of force mode.
    """

    def __init__(self, arm: ArmWithTool, begin: Setpoint, task: ForceTask) -> None:
        self.task = task
        self._arm = arm
        self._last = begin
        self._pose = arm.pose(begin.q)
        # In the base frame: the speed of the compliant axes, that of the whole tool, and the deviation of the others.
        self._deviation_speed = np.zeros(6)
        self._speed = arm.velocity(begin.q, begin.qd) if any(begin.qd) else np.zeros(6)
        self._deviation = np.zeros(6)
        self._felt: FloatArray | None = None
        self._driven = 0.0

    @property
    def task(self) -> ForceTask:
        """The arguments of force mode."""
        return self._task

    @task.setter
    def task(self, task: ForceTask) -> None:
        self._task = task
        self._is_free = np.array(task.selection, dtype=np.bool_)
        self._most, self._wanted = np.array(task.limits), np.array(task.wrench)
        self._frame = rotvec_to_matrix(list(task.frame)[3:])

    def advance(self, nominal: Setpoint, wrench: Sequence[float], seconds: float) -> Setpoint:
        """The set-point one cycle later.

        Args:
            nominal: the set-point of the program alone.
            wrench: (6,) what acts on the TCP, N and Nm in the base frame.
            seconds: of a cycle.

        Raises:
            LimitViolation: a limit of the task or of the joints is broken.
        """
        task, limits, is_free = self._task, self._most, self._is_free
        followed = np.zeros(6)
        if any(nominal.qd):
            followed = self._arm.velocity(nominal.q, nominal.qd)
        axes = self._axes(followed)
        felt = axes @ np.asarray(wrench)
        change = np.zeros(6) if self._felt is None else felt - axes @ self._felt
        self._felt = np.array(wrench)

        speed = axes @ self._deviation_speed * math.exp(-_DAMPING * task.damping * seconds)
        speed += (task.gain * (self._wanted + felt) * seconds + _BRAKE * change) / _MASS
        self._check_driven(speed, felt, seconds)
        speed = np.where(is_free, np.minimum(np.maximum(speed, -limits), limits), 0.0)

        deviation = axes @ self._deviation
        giving = np.where(is_free, 0.0, (felt / _STIFFNESS - deviation) / _GIVING_WAY)
        deviation = np.where(is_free, 0.0, deviation + seconds * giving)
        if (np.abs(deviation) > limits).any():
            axis = int(np.argmax(np.abs(deviation) > limits))
            off, most = f"{deviation[axis]:.4f} {_UNITS[axis]}", f"{limits[axis]:g}"
            raise LimitViolation(f"force mode: {_AXES[axis]} is off by {off}, at most {most} is allowed")

        self._deviation_speed, self._deviation = axes.T @ speed, axes.T @ deviation
        return self._move(axes.T @ np.where(is_free, speed, axes @ followed + giving), seconds)

    def _check_driven(self, speed: FloatArray, felt: FloatArray, seconds: float) -> None:
        """Raise if something pushes the tool at the limit of its speed."""
        driven = self._is_free & (np.abs(speed) > self._most) & (speed * felt > 0.0) & (np.abs(felt) > _DRIVEN)
        self._driven = self._driven + seconds if driven.any() else 0.0
        if self._driven > _DRIVEN_FOR:
            axis = int(np.argmax(driven))
            raise LimitViolation(f"force mode: pushed along {_AXES[axis]} at its largest speed of {self._most[axis]:g}")

    def _axes(self, followed: FloatArray) -> FloatArray:
        """(6, 6): from the base frame to the axes of the task, for forces and speeds."""
        columns = self._frame
        if self._task.kind == 1:
            way = np.array(list(self._task.frame)[:3]) - np.array(self._pose[:3])
            columns = _turned(columns, 1, way, _NEAR)
        elif self._task.kind == 3:
            moving = followed[:3]
            columns = _turned(columns, 0, moving - columns[:, 2] * (columns[:, 2] @ moving), _SLOW)
        both = np.zeros((6, 6))
        both[:3, :3] = both[3:, 3:] = columns.T
        return both

    def _move(self, speed: FloatArray, seconds: float) -> Setpoint:
        pose = moved(self._pose, (0.5 * seconds * (self._speed + speed)).tolist())
        self._speed = speed
        setpoint = self._arm.setpoint(pose, self._last, seconds)
        self._arm.limits.check(self._last, setpoint, seconds)
        self._pose, self._last = pose, setpoint
        return setpoint


def _turned(columns: FloatArray, axis: int, way: FloatArray, least: float) -> FloatArray:
    """A frame with one of its first two axes along a direction, and its z axis as close to its old one as possible; the
    frame itself if the direction is too short, or along z."""
    length = float(np.linalg.norm(way))
    if length < least:
        return columns
    chosen = way / length
    z = columns[:, 2] - chosen * (columns[:, 2] @ chosen)
    height = float(np.linalg.norm(z))
    if height < 1e-6:
        return columns
    z = z / height
    other = np.cross(z, chosen) if axis == 0 else np.cross(chosen, z)
    pair = (chosen, other) if axis == 0 else (other, chosen)
    return np.stack((*pair, z), axis=1)

"""Compliant motion of a simulated arm: freedrive, direct torque and force mode.

Freedrive and direct torque use the same model of the arm, which consists of the masses of the links and the payload,
and of the rotors. Freedrive along only some axes is simulated as force mode.

In **freedrive**, the external torques move the arm. Gravity and friction are compensated, and the joint speeds are
damped. A joint stops at the end of its range. If the tool becomes too fast, the controller stops the arm. The damping
and this maximum speed are assumed.

Under **direct torque**, the torques that a program sets for one cycle, plus the external torques, move the arm.
According to the vendor, the controller compensates gravity. The program chooses the fraction of the friction that the
controller compensates. The rest of the joint friction (`urlink.arm.motors`) acts on the joints. In a cycle for which
the program has set no torque, the arm brakes.

In **force mode**, the tool yields along some axes until a force is reached, and follows its path along the other axes.
The algorithm of a real controller is not published, only the purpose of the arguments. The model in this module has the
following properties:

- Along a **compliant axis**, the tool moves like a damped mass that the requested force and the external force
  accelerate. A change of the force also brakes the tool, so that it comes to rest on stiff objects. `damping` is
  approximately the fraction of the speed that the mass loses in 2 ms: with 0, the mass keeps its speed; with 1, it
  loses 63 % of its speed. `gain` scales the force that moves the mass. The tool never exceeds the speed limit of the
  axis. If an external force pushes the tool at this limit for more than 0.1 s, the arm is stopped.
- Along **every other axis**, the tool follows the program and yields like a stiff spring. If the deviation from the
  program exceeds the limit of the axis, the arm is stopped.

The masses, stiffnesses and times are assumed. A contact with a stiffness of up to 100 kN/m is stable at 125 Hz; at 500
Hz, stiffer contacts are stable too.
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

# Time, in s, by which the change of a torque or a force is multiplied. The product is an impulse that brakes the arm.
_BRAKE = 0.03
# Damping of each joint in freedrive, in 1/s.
_FREE_DAMPING = number("freedrive_damping")
# Maximum speed of the tool in freedrive, in m/s.
_FASTEST = number("freedrive_fastest")


class FreeJoints:
    """Freedrive in which all axes are free.

    Args:
        arm: Arm with its tool.
        dynamics: Dynamics of the arm with rotors and payload.
        begin: Current set-point.
    """

    def __init__(self, arm: ArmWithTool, dynamics: Dynamics, begin: Setpoint) -> None:
        self._arm, self._dynamics = arm, dynamics
        self._last = begin
        self._lowest, self._highest = arm.kinematics.position_limits.T
        self._felt: FloatArray | None = None

    def advance(self, wrench: Sequence[float], torques: Sequence[float], seconds: float) -> Setpoint:
        """Return the set-point one cycle later.

        Args:
            wrench: Wrench at the TCP, in N and Nm in the base frame.
            torques: External torques at the joints, in Nm.
            seconds: Duration of the cycle, in s.

        Raises:
            LimitViolation: If a joint or the tool is too fast.
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
                    f"freedrive: the tool is moving at {speed:.2f} m/s; at most {_FASTEST:g} m/s is allowed"
                )
        self._last = setpoint
        return setpoint


class TorqueMotion(Command):
    """Motion under direct torque for one cycle.

    Args:
        dynamics: Dynamics of the arm with rotors and payload. Gravity is not used.
        motors: Motors of the arm.
        torque: Sum of the program's torques and the external torques, shape (6,), in Nm.
        friction: For each joint, the fraction of the friction that is not compensated, shape (6,), 0 to 1.
        acceleration: Deceleration of the joints if no torque is set for the next cycle, shape (6,), in rad/s².

    Attributes:
        is_over: Whether the cycle has passed.
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
        """Return the set-point one cycle later."""
        if self.is_over:
            setpoint = self._brake.advance(last, seconds, scaling, change)
            self.is_at_rest = self._brake.is_at_rest
            return setpoint
        self.is_over = True
        speed = np.array(last.qd)
        rub, slope = (self._friction * each for each in self._motors.friction_torque(last.qd))
        left = self._torque - rub - self._dynamics.coriolis_torque(last.q, last.qd)
        # Use the friction at the end of the cycle. With the friction at the beginning, a light joint would oscillate
        # around zero speed.
        qdd = np.linalg.solve(self._dynamics.mass_matrix(last.q) + np.diag(seconds * slope), left)
        qd = speed + seconds * qdd
        return Setpoint((np.array(last.q) + seconds * qd).tolist(), qd.tolist(), qdd.tolist())


# Simulated masses and moments of inertia for motions along and about a compliant axis, in kg and kg m².
_MASS = np.array(numbers("force_mode_mass"))
# Rate at which the speed decays with a damping of 1, in 1/s. Its time constant is 2 ms.
_DAMPING = 500.0
# Stiffness of the axes that are not compliant, in N/m and Nm/rad, and time constant with which they yield, in s.
_STIFFNESS = np.array([20e3, 20e3, 20e3, 500.0, 500.0, 500.0])
_GIVING_WAY = 0.05
# Force above which an axis counts as pushed, in N and Nm, and maximum time for which it may be pushed at its maximum
# speed, in s.
_DRIVEN = np.array([5.0, 5.0, 5.0, 0.5, 0.5, 0.5])
_DRIVEN_FOR = 0.1
# Speed in m/s below which the direction of a motion is not used, and distance in m below which the direction to the
# origin of the frame is not used.
_SLOW, _NEAR = 1e-4, 1e-6

_AXES = ("x", "y", "z", "rx", "ry", "rz")
_UNITS = ("m", "m", "m", "rad", "rad", "rad")


@dataclass(frozen=True)
class ForceTask:
    """Arguments of `force_mode`.

    Attributes:
        frame: Pose of the task frame in the base frame, shape (6,). The position is used only for kind 1.
        selection: Whether each axis is compliant, shape (6,).
        wrench: Requested wrench that the tool exerts along and about the compliant axes, shape (6,), in N and Nm.
        kind: Transformation of the frame. 1 turns the y axis to the direction from the tool to the origin of the frame.
            2 does not change the frame. 3 turns the x axis to the direction in which the tool moves in the x-y plane.
        limits: Maximum speed of compliant axes, in m/s and rad/s, and maximum deviation of the other axes, in m and
            rad; shape (6,).
        damping: Damping of the compliant axes, 0 to 1.
        gain: Gain of the compliant axes, 0 to 2.
    """

    frame: Sequence[float]
    selection: Sequence[bool]
    wrench: Sequence[float]
    kind: int
    limits: Sequence[float]
    damping: float = 0.005
    gain: float = 1.0


def free_tool(frame: Sequence[float], axes: Sequence[bool]) -> ForceTask:
    """Return the force mode task that simulates freedrive along some axes of a frame.

    In this task, the tool exerts no force, the speed of the tool decreases quickly, and there are no limits.
    """
    return ForceTask(frame, axes, (0.0,) * 6, 2, (math.inf,) * 6, damping=0.02)


class Compliance:
    """Force mode: changes the set-points of a program to set-points of the compliant arm.

    Args:
        arm: Arm with its tool.
        begin: Current set-point. Axes that follow the program keep the speed of this set-point.
        task: Arguments of force mode.
    """

    def __init__(self, arm: ArmWithTool, begin: Setpoint, task: ForceTask) -> None:
        self.task = task
        self._arm = arm
        self._last = begin
        self._pose = arm.pose(begin.q)
        # In the base frame: speed along the compliant axes, speed of the tool along all axes, and deviation along the
        # other axes.
        self._deviation_speed = np.zeros(6)
        self._speed = arm.velocity(begin.q, begin.qd) if any(begin.qd) else np.zeros(6)
        self._deviation = np.zeros(6)
        self._felt: FloatArray | None = None
        self._driven = 0.0

    @property
    def task(self) -> ForceTask:
        """Arguments of force mode."""
        return self._task

    @task.setter
    def task(self, task: ForceTask) -> None:
        self._task = task
        self._is_free = np.array(task.selection, dtype=np.bool_)
        self._most, self._wanted = np.array(task.limits), np.array(task.wrench)
        self._frame = rotvec_to_matrix(list(task.frame)[3:])

    def advance(self, nominal: Setpoint, wrench: Sequence[float], seconds: float) -> Setpoint:
        """Return the set-point one cycle later.

        Args:
            nominal: Set-point of the program, without compliance.
            wrench: Wrench on the TCP, shape (6,), in N and Nm in the base frame.
            seconds: Duration of the cycle, in s.

        Raises:
            LimitViolation: If a limit of the task or of the joints is exceeded.
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
            raise LimitViolation(f"force mode: the deviation along {_AXES[axis]} is {off}; at most {most} is allowed")

        self._deviation_speed, self._deviation = axes.T @ speed, axes.T @ deviation
        return self._move(axes.T @ np.where(is_free, speed, axes @ followed + giving), seconds)

    def _check_driven(self, speed: FloatArray, felt: FloatArray, seconds: float) -> None:
        """Raise if an external force has pushed the tool at a speed limit for too long."""
        driven = self._is_free & (np.abs(speed) > self._most) & (speed * felt > 0.0) & (np.abs(felt) > _DRIVEN)
        self._driven = self._driven + seconds if driven.any() else 0.0
        if self._driven > _DRIVEN_FOR:
            axis = int(np.argmax(driven))
            most = f"{self._most[axis]:g}"
            raise LimitViolation(f"force mode: the tool was pushed along {_AXES[axis]} at the maximum speed of {most}")

    def _axes(self, followed: FloatArray) -> FloatArray:
        """Return the matrix that transforms from the base frame to the axes of the task, shape (6, 6).

        The matrix applies to wrenches and to speeds of the tool.
        """
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
    """Return a frame whose x or y axis (`axis` 0 or 1) has the direction `way`.

    The z axis is as close to the old z axis as possible. If `way` is shorter than `least`, or is parallel to the z
    axis, the frame is not changed.
    """
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

"""Sensors of a simulated arm. Their values are computed from the set-points of the arm.

- **Positions and poses** agree: every pose is computed by forward kinematics from the joint positions of the same
  cycle.
- **Speeds** are the derivatives of the positions. The TCP speed is the product of the Jacobian and the joint speeds.
- **Moments** are computed for the rigid links and the rotors (`urlink.dynamics`).
- **Currents** are these moments divided by the torque constants, plus friction (`urlink.arm.motors`), minus the effect
  of external forces on the tool. At rest, stiction carries a part of the load. Therefore the actual current of a joint
  at rest has an error, a fraction of the friction, which differs from rest to rest.
- **Positions at rest** have an error of some encoder steps, which also differs from rest to rest.
- **The force** at the TCP is computed by `surroundings`.
- **Temperatures** rise slowly. They rise further in joints with a higher load.
- **The tool accelerometer** of an e-Series arm shows the acceleration of the flange plus the upward acceleration that
  supports it against gravity, in the tool frame. On a CB arm, it shows only gravity, with the sign that a real CB2
  packet contains.

For lags, offsets, noise and resolution steps, see `characteristics`. It is assumed that the elbow position in real-time
packets is the same point as the elbow in the safety data of a CB3 capture.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from operator import add

import numpy as np

from urlink.arm.dynamics import GRAVITY, Dynamics
from urlink.arm.kinematics import Arm as Kinematics
from urlink.arm.kinematics.geometry import chain, flange, velocity
from urlink.arm.motors import Motors
from urlink.arm.parameters import number
from urlink.arm.rigid import FLOATS, IDENTITY, Rigid, from_pose, product, to_pose

from .characteristics import AMBIENT, JOINT_VOLTAGE, STEPS, TEMPERATURE_RISE, WARMING, SensorParameters
from .setpoint_sources import Setpoint

_ZERO = [0.0] * 6
# Number of random numbers, which are drawn once and then read in turn. It is a prime number, so that the noise of
# different sensors does not repeat together.
_NOISE_LENGTH = 8191
# Additional temperature rise in K for a holding current of 1 A. The rise is proportional to the square root of this
# current.
_RISE = 1.0
# Time interval in s between the two speeds from which an acceleration is computed.
_MOMENT = 1e-6
# Fraction of the maximum torque with which the controller pushes a joint that deviates by 1 rad from its target.
# Assumed: half of the maximum torque at the deviation that causes a stop.
_PUSH = 0.5 / number("position_deviation_limit")


@dataclass(slots=True, init=False, eq=False, repr=False)
class Sample:
    """Values of all sensors in one cycle.

    Attributes:
        q_target, qd_target, qdd_target, M_target, I_target: Six numbers each, in rad, rad/s, rad/s², Nm, A.
        q_actual, qd_actual, I_actual, I_control, V_actual, T_motor: Six numbers each, in rad, rad/s, A, A, V, °C.
        pose_actual, pose_target: Pose of the TCP in the base frame, in m and rotation vector in rad.
        speed_actual, speed_target: Speed of the TCP, in m/s and rad/s.
        force: Wrench at the TCP, in N and Nm.
        elbow_position, elbow_velocity: Position and velocity of the end of the upper arm, in m and m/s.
        accelerometer: Acceleration in the frame of the tool, in m/s².
        momentum: Momentum of the arm in kg m/s. This is only a rough value.
    """

    I_actual: list[float]
    I_control: list[float]
    I_target: list[float]
    M_target: list[float]
    T_motor: list[float]
    V_actual: list[float]
    accelerometer: list[float]
    elbow_position: list[float]
    elbow_velocity: list[float]
    force: list[float]
    momentum: float
    pose_actual: list[float]
    pose_target: list[float]
    q_actual: list[float]
    q_target: list[float]
    qd_actual: list[float]
    qd_target: list[float]
    qdd_target: list[float]
    speed_actual: list[float]
    speed_target: list[float]


class Sensors:
    """Sensors of one arm.

    Args:
        kinematics: Kinematics of the arm.
        motors: Motors of the joints.
        parameters: Parameters of the sensors.
        q: Joint positions whose gravity load determines the temperature of each joint, shape (6,), in rad.
        seed: Seed of the noise; None for no noise.
    """

    def __init__(
        self, kinematics: Kinematics, motors: Motors, parameters: SensorParameters, q: Sequence[float], seed: int | None
    ) -> None:
        model = kinematics.model
        self._kinematics, self._seed, self._of = kinematics, seed, parameters
        self._motors = motors
        self._dynamics = Dynamics(model)
        self._tcp: list[float] = list(_ZERO)
        self._tool: Rigid[float] = IDENTITY
        # Latest targets, and values that depend only on these targets. They are stored because an arm at rest has the
        # same targets in every cycle.
        self._posture: Sequence[float] = []
        self._pose: list[float] = []
        self._load: tuple[Setpoint, Sequence[float]] | None = None
        self._currents: tuple[list[float], list[float], list[float]] = ([], [], [])
        self._elbow = model.dh_a.item(1), model.dh_d.item(0)
        self._is_e = model.generation == "e"
        self._mass = float(model.link_masses.sum())
        load = self._dynamics.gravity_torque(q).tolist()
        self._rise = [
            rise + _RISE * math.sqrt(abs(m / k))
            for rise, m, k in zip(TEMPERATURE_RISE, load, motors.torque_constants, strict=True)
        ]
        #: Deviation of the joints from their targets, in rad, in addition to lag and noise; see `SimulatedArm.drags`.
        self.deviation: Sequence[float] = _ZERO
        torque = model.max_torque.tolist()
        self._push = [_PUSH * m / k for m, k in zip(torque, motors.torque_constants, strict=True)]
        self._warmed_to = -1
        self._warm: list[float] = []

    def positions(self, setpoint: Setpoint, cycle: int, rest: int, is_powered: bool) -> list[float]:
        """Return the actual joint positions, in rad.

        `cycle` selects the noise. `rest`, the number of the current or last rest, selects the error of joints at rest.
        """
        measured = self._positions(setpoint, cycle, rest, is_powered)
        return list(map(add, measured, self.deviation)) if any(self.deviation) else measured

    def _positions(self, setpoint: Setpoint, cycle: int, rest: int, is_powered: bool) -> list[float]:
        q, qd, _ = setpoint
        is_moving = any(qd)
        if self._seed is None or not (is_powered or is_moving):
            # To first order, this is the position at the time t - lag; the derivative is known exactly.
            return [p - self._of.lag * v for p, v in zip(q, qd, strict=True)] if is_moving else q
        noise = self._noise(cycle, 0, self._of.position_noise)
        if is_moving:
            return [_stepped(p - self._of.lag * v + n, s) for p, v, n, s in zip(q, qd, noise, STEPS, strict=True)]
        offset = self._noise(rest, 6, self._of.position_offset)
        return [_stepped(p + o + n, s) for p, o, n, s in zip(q, offset, noise, STEPS, strict=True)]

    def speeds(self, setpoint: Setpoint, cycle: int) -> list[float]:
        """Return the actual joint speeds, in rad/s."""
        _, qd, qdd = setpoint
        if not any(qd):
            return _ZERO
        noise = self._noise(cycle, 1, self._of.speed_noise)
        return [v - self._of.speed_lag * a + n for v, a, n in zip(qd, qdd, noise, strict=True)]

    def sample(
        self,
        setpoint: Setpoint,
        tcp: Sequence[float],
        dynamics: Dynamics,
        external: Sequence[float],
        wrench: Sequence[float],
        cycle: int,
        rest: int,
        time: float,
        is_powered: bool,
    ) -> Sample:
        """Return the values of all sensors in one cycle.

        Args:
            setpoint: Targets of the cycle.
            tcp: Tool centre point in the flange frame, shape (6,), in m and rad.
            dynamics: Dynamics of the arm with rotors and payload.
            external: Wrench on the TCP, shape (6,), in N and Nm in the base frame.
            wrench: The same wrench, minus the offset of the force sensor, shape (6,).
            cycle: Number of the cycle, which selects the noise.
            rest: Number of the current or last rest of the arm, which selects the errors that differ from rest to rest.
            time: Time since the arm was switched on, in s, for the temperatures.
            is_powered: Whether the motors have power.
        """
        q, qd, qdd = setpoint
        is_moving = any(qd) or any(qdd)
        self._look_at(q, tcp, dynamics)
        s = Sample()
        s.q_target, s.qd_target, s.qdd_target = q, qd, qdd
        s.q_actual = self.positions(setpoint, cycle, rest, is_powered)
        s.qd_actual = self.speeds(setpoint, cycle)
        s.pose_target = self._pose
        s.pose_actual = self._forward(s.q_actual)
        s.speed_target = s.speed_actual = _ZERO
        if any(qd):
            s.speed_target = self._velocity(q, qd, s.pose_target)
            s.speed_actual = self._velocity(s.q_actual, s.qd_actual, s.pose_actual)
        s.momentum = 0.5 * self._mass * math.hypot(*s.speed_actual[:3])
        s.elbow_position, s.elbow_velocity = _elbow(*self._elbow, s.q_actual, s.qd_actual)
        s.accelerometer = self._accelerations(setpoint, s.pose_actual, cycle, is_moving)
        if is_powered:
            self._measure_load(s, setpoint, self._moments(q, tcp, external), cycle, rest, is_moving)
            n, o = self._noise(cycle, 5, 1.0), self._of.force_offset
            noises = [self._of.force_noise] * 3 + [self._of.torque_noise] * 3
            s.force = [f + each * scale + off for f, each, scale, off in zip(wrench, n, noises, o, strict=True)]
        else:
            s.M_target = s.I_target = s.I_control = s.I_actual = s.V_actual = s.force = _ZERO
        s.T_motor = self._temperatures(int(time))
        return s

    def _look_at(self, q: Sequence[float], tcp: Sequence[float], dynamics: Dynamics) -> None:
        """Compute the values that depend on targets, tool and payload, if any of these has changed."""
        if tcp == self._tcp and q == self._posture and dynamics is self._dynamics:
            return
        self._dynamics = dynamics
        if tcp != self._tcp:
            self._tcp, self._tool = list(tcp), from_pose(list(tcp))
        self._posture = q
        self._pose = self._forward(q)
        self._load = None

    def _forward(self, q: Sequence[float]) -> list[float]:
        """Return the pose of the TCP.

        `Arm.forward` would take twice as long, because it checks its arguments and makes an array.
        """
        return list(to_pose(product(self._flange(q), self._tool)))

    def _flange(self, q: Sequence[float]) -> Rigid[float]:
        q1, q2, q3, q4, q5, q6 = q
        angles, geometry = (q1, q2, q3, q4, q5, q6), self._kinematics.geometry
        if geometry.is_nominal:
            return flange(geometry.lengths, FLOATS, angles)
        return chain(geometry, FLOATS, angles)[5]

    def _velocity(self, q: Sequence[float], qd: Sequence[float], pose: Sequence[float]) -> list[float]:
        """Return the velocity of the TCP, given its pose.

        `Arm.velocity` would compute the pose again.
        """
        q1, q2, q3, q4, q5, q6 = q
        v1, v2, v3, v4, v5, v6 = qd
        x, y, z = pose[:3]
        geometry = self._kinematics.geometry
        return list(velocity(geometry, FLOATS, (q1, q2, q3, q4, q5, q6), (v1, v2, v3, v4, v5, v6), (x, y, z)))

    def _moments(self, q: Sequence[float], tcp: Sequence[float], external: Sequence[float]) -> list[float]:
        """Return the joint torques that result from the wrench on the TCP, in Nm."""
        if not any(external):
            return _ZERO
        moments: list[float] = (self._kinematics.jacobian(q, tcp).T @ external).tolist()
        return moments

    def _measure_load(
        self, s: Sample, setpoint: Setpoint, moments: Sequence[float], cycle: int, rest: int, is_moving: bool
    ) -> None:
        """Compute moments, currents and voltages; `moments` are the external torques on the joints."""
        if self._load != (setpoint, moments):
            self._load = setpoint, moments
            needed: list[float] = (
                self._dynamics.torque(*setpoint) if is_moving else self._dynamics.gravity_torque(setpoint.q)
            ).tolist()
            target = self._motors.current(needed, setpoint.qd)
            control = [i - m / k for i, m, k in zip(target, moments, self._motors.torque_constants, strict=True)]
            self._currents = needed, target, control
        s.M_target, s.I_target, s.I_control = self._currents
        if self._seed is None:
            s.I_actual = s.I_control
        elif is_moving:
            s.I_actual = list(map(add, s.I_control, self._noise(cycle, 3, self._of.current_noise)))
        else:
            held = self._noise(rest, 7, self._of.stiction)
            noise = self._noise(cycle, 3, self._of.current_noise_at_rest)
            s.I_actual = [
                i + h * c + n for i, h, c, n in zip(s.I_control, held, self._motors.coulomb, noise, strict=True)
            ]
        if any(self.deviation):
            # The controller pushes a joint towards its target.
            pushed = [-push * d for push, d in zip(self._push, self.deviation, strict=True)]
            s.I_control, s.I_actual = list(map(add, s.I_control, pushed)), list(map(add, s.I_actual, pushed))
        noise = self._noise(cycle, 4, self._of.voltage_noise)
        idle, drop, step = JOINT_VOLTAGE
        s.V_actual = [_stepped(idle - drop * abs(i) + n, step) for i, n in zip(s.I_control, noise, strict=True)]

    def _temperatures(self, second: int) -> list[float]:
        if second != self._warmed_to:
            self._warmed_to = second
            warm = 1.0 - math.exp(-second / WARMING)
            # The resolution is a sixteenth of a degree.
            self._warm = [round(16.0 * (AMBIENT + rise * warm)) / 16.0 for rise in self._rise]
        return self._warm

    def _accelerations(self, setpoint: Setpoint, pose: Sequence[float], cycle: int, is_moving: bool) -> list[float]:
        """Return the value that the accelerometer in the tool measures, in m/s² in the tool frame."""
        noise = self._noise(cycle, 2, self._of.accelerometer_noise)
        across = _upward(pose)
        if not self._is_e:
            return [n - GRAVITY * u[2] for u, n in zip(across, noise, strict=False)]
        x, y, z = 0.0, 0.0, GRAVITY
        if is_moving:
            # The sensor is in the flange. Compute the acceleration from two velocities of the flange, a microsecond
            # apart.
            q, qd, qdd = setpoint
            later = [p + _MOMENT * v for p, v in zip(q, qd, strict=True)]
            faster = [v + _MOMENT * a for v, a in zip(qd, qdd, strict=True)]
            before = self._velocity(q, qd, self._flange(q)[9:])
            after = self._velocity(later, faster, self._flange(later)[9:])
            x, y, up = ((b - a) / _MOMENT for a, b in zip(before[:3], after[:3], strict=True))
            z += up
        bias = self._of.accelerometer_bias
        return [u[0] * x + u[1] * y + u[2] * z + b + n for u, b, n in zip(across, bias, noise, strict=False)]

    def _noise(self, at: int, channel: int, scale: float) -> tuple[float, ...]:
        """Return six random numbers with the standard deviation `scale`; `at` is the number of a cycle or of a rest."""
        begin = (at * 6 + channel * 1171) % _NOISE_LENGTH
        return _noise(self._seed, scale)[begin : begin + 6]


def _stepped(value: float, step: float) -> float:
    """Return the value rounded to a multiple of `step`; a step of 0 means no rounding."""
    return step * round(value / step) if step else value


def _upward(pose: Sequence[float]) -> tuple[tuple[float, float, float], ...]:
    """Return the axes x, y and z of the tool as three unit vectors in the base frame."""
    matrix = from_pose(list(pose))
    return (matrix[0], matrix[3], matrix[6]), (matrix[1], matrix[4], matrix[7]), (matrix[2], matrix[5], matrix[8])


def _elbow(a2: float, d1: float, q: Sequence[float], qd: Sequence[float]) -> tuple[list[float], list[float]]:
    """Return the position and the velocity of the end of the upper arm, in m and m/s.

    The point is in the vertical plane through the axis of the base. The sideways offset of the real upper arm is
    ignored.
    """
    s1, c1, s2, c2 = math.sin(q[0]), math.cos(q[0]), math.sin(q[1]), math.cos(q[1])
    turn, lift = qd[0], qd[1]
    out, speed = a2 * c2, -a2 * s2 * lift
    return (
        [out * c1, out * s1, d1 + a2 * s2],
        [speed * c1 - out * s1 * turn, speed * s1 + out * c1 * turn, a2 * c2 * lift],
    )


@lru_cache(maxsize=64)
def _noise(seed: int | None, scale: float) -> tuple[float, ...]:
    if seed is None:
        return (0.0,) * (_NOISE_LENGTH + 6)
    numbers: list[float] = (scale * np.random.default_rng(seed).standard_normal(_NOISE_LENGTH)).tolist()
    return (*numbers, *numbers[:6])

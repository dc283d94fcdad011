"""The sensors of an arm, computed from its set-points.

Sources of the numbers:

- **positions and poses** agree: every pose is the forward kinematics of the joint positions beside it;
- **speeds** are the derivatives of the positions, TCP speeds the Jacobian times the joint speeds;
- **lag and noise** of the actual joints are of the size seen in the one moving and the one standing capture;
- **moments** hold the arm up (masses and centres of mass as published) and accelerate it (a coarse inertia, a guess);
- **currents** are moments over the torque constants that the captures show, plus a guess of friction, less what acts
  on the tool;
- **the force** at the TCP is that of `force_sensor`, with noise of a guessed size;
- **temperatures** rise slowly from 24 degC, more in joints that carry more; how fast is a guess;
- **tool accelerometer** is gravity in the frame of the tool, of the sign that the real CB2 packet shows.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache, reduce
from operator import add

import numpy as np

from urlink.dynamics import GRAVITY, Dynamics
from urlink.kinematics import Arm as Kinematics
from urlink.kinematics.geometry import chain, flange
from urlink.kinematics.velocity import velocity
from urlink.models import Model
from urlink.rigid import FLOATS, IDENTITY, Rigid, from_pose, product, to_pose

from .sources import Setpoint

__all__ = ["Sample", "Sensors"]

# Seconds by which the actual joints lag behind their targets.
_LAG = 0.002
# Standard deviations: rad, rad/s (of a moving joint), A, N or Nm, V, m/s².
_NOISE_Q, _NOISE_QD, _NOISE_I, _NOISE_F, _NOISE_V, _NOISE_ACC = 1e-5, 5e-4, 0.01, 0.1, 0.05, 0.02
_AMBIENT = 24.0
_WARMING = 900.0
# The friction current, A, and the joint speed above which it has its full size, rad/s. A guess.
_FRICTION, _STICTION = 0.4, 0.02

_ZERO = [0.0] * 6
# Gaussian noise is drawn once and then read in turn; with a prime length the channels do not repeat together.
_NOISE_LENGTH = 8191
# Nm/A by joint, read off one capture each: simulated UR5e and UR3e, real CB2 UR5. The rest are guessed by joint size.
_TORQUE_CONSTANTS = {
    "UR5e": (9.93, 9.93, 9.93, 7.77, 7.77, 7.77),
    "UR3e": (10.86, 10.86, 7.77, 3.6, 3.6, 3.6),
    "UR5": (12.5, 12.5, 12.5, 9.3, 9.3, 9.3),
    "UR3": (12.5, 12.5, 9.3, 4.5, 4.5, 4.5),
}
_TORQUE_CONSTANTS_LARGE = (14.0, 14.0, 12.5, 9.3, 9.3, 9.3)


class Sample:
    """The values of all sensors in one cycle.

    Attributes:
        q_target, qd_target, qdd_target, M_target, I_target: six numbers: rad, rad/s, rad/s², Nm, A.
        q_actual, qd_actual, I_actual, I_control, V_actual, T_motor: six numbers: rad, rad/s, A, A, V, degC.
        pose_actual, pose_target: TCP in the base frame, m and rotation vector in rad.
        speed_actual, speed_target: of the TCP, m/s and rad/s.
        force: at the TCP, N and Nm.
        elbow_position, elbow_velocity: the end of the upper arm, m and m/s.
        accelerometer: m/s², in the frame of the tool.
        momentum: kg m/s, coarse.
    """

    __slots__ = (
        "I_actual",
        "I_control",
        "I_target",
        "M_target",
        "T_motor",
        "V_actual",
        "accelerometer",
        "elbow_position",
        "elbow_velocity",
        "force",
        "momentum",
        "pose_actual",
        "pose_target",
        "q_actual",
        "q_target",
        "qd_actual",
        "qd_target",
        "qdd_target",
        "speed_actual",
        "speed_target",
    )

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
    """The sensors of one arm.

    Args:
        kinematics: of the arm.
        q: (6,) rad, joint positions from which the temperature of each joint is computed.
        seed: of the noise; None for none.
    """

    def __init__(self, kinematics: Kinematics, q: Sequence[float], seed: int | None) -> None:
        model = kinematics.model
        self._model, self._kinematics = model, kinematics
        # The payload, and the dynamics with it.
        self._carried: tuple[float, tuple[float, ...]] = (0.0, (0.0, 0.0, 0.0))
        self._dynamics = Dynamics(kinematics)
        self._seed = seed
        # The frame of the TCP in that of the flange, and the pose of which it is.
        self._tcp: Sequence[float] = _ZERO
        self._tool = IDENTITY
        # What follows from the targets alone, and the targets; an arm that stands has the same ones in every cycle.
        self._posture: Sequence[float] = []
        self._pose: list[float] = []
        self._held: list[float] = []
        self._load: tuple[Setpoint, Sequence[float]] | None = None
        self._currents: tuple[list[float], list[float], list[float]] = ([], [], [])
        self._elbow = model.dh_a.item(1), model.dh_d.item(0)
        self._inertia = _inertia(model)
        #: Nm/A, of each joint
        self.torque_constants = _TORQUE_CONSTANTS.get(model.name, _TORQUE_CONSTANTS_LARGE)
        self._mass = float(model.link_masses.sum())
        load = self._dynamics.gravity_torque(q).tolist()
        self._rise = [4.0 + 3.0 * math.sqrt(abs(m / k)) for m, k in zip(load, self.torque_constants, strict=True)]
        self._warmed_to = -1
        self._warm: list[float] = []

    def positions(self, setpoint: Setpoint, cycle: int, is_powered: bool) -> list[float]:
        """The actual joint positions, rad."""
        q, qd, _ = setpoint
        if any(qd):
            # q(t - lag), to first order: its derivative is known exactly.
            noise = self._noise(cycle, 0, _NOISE_Q)
            return [p - _LAG * v + n for p, v, n in zip(q, qd, noise, strict=True)]
        return [p + n for p, n in zip(q, self._noise(cycle, 0, _NOISE_Q), strict=True)] if is_powered else q

    def sample(
        self,
        setpoint: Setpoint,
        tcp: Sequence[float],
        payload: float,
        payload_cog: Sequence[float],
        external: Sequence[float],
        wrench: Sequence[float],
        cycle: int,
        time: float,
        is_powered: bool,
    ) -> Sample:
        """The values of all sensors in one cycle.

        Args:
            setpoint: the targets.
            tcp: (6,) in the flange frame, m and rad.
            payload: kg.
            payload_cog: (3,) in the flange frame, m.
            external: (6,) what acts on the TCP, N and Nm in the base frame.
            wrench: (6,) the same, with the offset of the force sensor.
            cycle: selects the noise.
            time: s since the arm was switched on, for the temperatures.
            is_powered: whether the motors have power.
        """
        q, qd, qdd = setpoint
        self._look_at(q, tcp, payload, payload_cog)
        s = Sample()
        s.q_target, s.qd_target, s.qdd_target = q, qd, qdd
        s.q_actual = self.positions(setpoint, cycle, is_powered)
        s.qd_actual = _ZERO
        is_moving = any(qd)
        if is_moving:
            noise = self._noise(cycle, 1, _NOISE_QD)
            s.qd_actual = [v - _LAG * a + n for v, a, n in zip(qd, qdd, noise, strict=True)]

        s.pose_target = self._pose
        s.pose_actual = self._forward(s.q_actual)
        s.speed_target = s.speed_actual = _ZERO
        if is_moving:
            s.speed_target = self._velocity(q, qd, s.pose_target)
            s.speed_actual = self._velocity(s.q_actual, s.qd_actual, s.pose_actual)
        s.momentum = 0.5 * self._mass * math.hypot(*s.speed_actual[:3])
        s.elbow_position, s.elbow_velocity = _elbow(*self._elbow, s.q_actual, s.qd_actual)
        s.accelerometer = [
            g + n for g, n in zip(_gravity_in_tool(s.pose_actual), self._noise(cycle, 2, _NOISE_ACC)[:3], strict=True)
        ]
        if is_powered:
            self._measure_load(s, setpoint, self._moments(q, tcp, external), cycle)
            s.force = [f + n for f, n in zip(wrench, self._noise(cycle, 5, _NOISE_F), strict=True)]
        else:
            s.M_target = s.I_target = s.I_control = s.I_actual = s.V_actual = s.force = _ZERO
        s.T_motor = self._temperatures(int(time))
        return s

    def _look_at(self, q: Sequence[float], tcp: Sequence[float], payload: float, payload_cog: Sequence[float]) -> None:
        """Compute what follows from these targets, tool and payload, unless they are those of the cycle before."""
        carried = payload, tuple(payload_cog)
        if tcp == self._tcp and q == self._posture and carried == self._carried:
            return
        if carried != self._carried:
            self._carried = carried
            self._dynamics = Dynamics(self._kinematics, payload=payload, payload_cog=payload_cog)
        if tcp != self._tcp:
            self._tcp, self._tool = list(tcp), from_pose(list(tcp))
        self._posture = q
        self._pose = self._forward(q)
        self._held = self._dynamics.gravity_torque(q).tolist()
        self._load = None

    def _forward(self, q: Sequence[float]) -> list[float]:
        """The pose of the TCP: `Arm.forward`, which checks its arguments and makes an array, takes twice as long."""
        q1, q2, q3, q4, q5, q6 = q
        angles, geometry = (q1, q2, q3, q4, q5, q6), self._kinematics.geometry
        there: Rigid[float] = (
            flange(geometry.lengths, FLOATS, angles) if geometry.is_nominal else chain(geometry, FLOATS, angles)[5]
        )
        return list(to_pose(product(there, self._tool)))

    def _velocity(self, q: Sequence[float], qd: Sequence[float], pose: Sequence[float]) -> list[float]:
        """Velocity of the TCP, whose pose is known already; `Arm.velocity` would compute it again."""
        q1, q2, q3, q4, q5, q6 = q
        v1, v2, v3, v4, v5, v6 = qd
        x, y, z = pose[:3]
        geometry = self._kinematics.geometry
        return list(velocity(geometry, FLOATS, (q1, q2, q3, q4, q5, q6), (v1, v2, v3, v4, v5, v6), (x, y, z)))

    def _moments(self, q: Sequence[float], tcp: Sequence[float], external: Sequence[float]) -> list[float]:
        """The torques of the joints from what acts on the TCP, Nm."""
        if not any(external):
            return _ZERO
        moments: list[float] = (self._kinematics.jacobian(q, tcp).T @ external).tolist()
        return moments

    def _measure_load(self, s: Sample, setpoint: Setpoint, moments: Sequence[float], cycle: int) -> None:
        """Moments, currents and voltages, with these torques from outside on the joints."""
        if self._load != (setpoint, moments):
            self._load = setpoint, moments
            needed = [g + m * a for g, m, a in zip(self._held, self._inertia, setpoint.qdd, strict=True)]
            target = [m / k for m, k in zip(needed, self.torque_constants, strict=True)]
            control = [
                i + _FRICTION * math.tanh(v / _STICTION) - m / k
                for i, v, m, k in zip(target, setpoint.qd, moments, self.torque_constants, strict=True)
            ]
            self._currents = needed, target, control
        s.M_target, s.I_target, s.I_control = self._currents
        s.I_actual = [i + n for i, n in zip(s.I_control, self._noise(cycle, 3, _NOISE_I), strict=True)]
        s.V_actual = [
            round(47.8 - 0.1 * abs(i) + n, 1) for i, n in zip(s.I_control, self._noise(cycle, 4, _NOISE_V), strict=True)
        ]

    def _temperatures(self, second: int) -> list[float]:
        if second != self._warmed_to:
            self._warmed_to = second
            warm = 1.0 - math.exp(-second / _WARMING)
            self._warm = [round(_AMBIENT + rise * warm, 1) for rise in self._rise]
        return self._warm

    def _noise(self, cycle: int, channel: int, scale: float) -> tuple[float, ...]:
        at = (cycle * 6 + channel * 1171) % _NOISE_LENGTH
        return _noise(self._seed, scale)[at : at + 6]


def _gravity_in_tool(pose: Sequence[float]) -> tuple[float, float, float]:
    """Gravity in the frame of the tool, m/s²: +z for a tool that points down.

    The real CB2 packet has this sign: (-0.1, -2.8, 8.4) where the kinematics of its joints give (-1.0, -0.6, 9.8).
    """
    rx, ry, rz = pose[3:]
    angle = math.sqrt(rx * rx + ry * ry + rz * rz)
    g = GRAVITY
    if angle < 1e-12:
        return 0.0, 0.0, -g
    x, y, z = rx / angle, ry / angle, rz / angle
    s, v = math.sin(angle), 1.0 - math.cos(angle)
    # The third row of the rotation matrix is the base's z axis in the frame of the tool.
    return -g * (v * x * z - s * y), -g * (v * y * z + s * x), -g * (1.0 - v * (x * x + y * y))


def _elbow(a2: float, d1: float, q: Sequence[float], qd: Sequence[float]) -> tuple[list[float], list[float]]:
    """The end of the upper arm, on the axis through the shoulder's plane; m and m/s.

    The elbow of the safety data of the one CB3 capture is this point. That the real-time packet's is too is a guess.
    """
    s1, c1, s2, c2 = math.sin(q[0]), math.cos(q[0]), math.sin(q[1]), math.cos(q[1])
    turn, lift = qd[0], qd[1]
    out, speed = a2 * c2, -a2 * s2 * lift
    return (
        [out * c1, out * s1, d1 + a2 * s2],
        [speed * c1 - out * s1 * turn, speed * s1 + out * c1 * turn, a2 * c2 * lift],
    )


def _inertia(model: Model) -> list[float]:
    """kg m² that each joint accelerates, coarsely: all links after it at half its reach in an L-shaped posture."""
    lengths = [abs(a) + abs(d) for a, d in zip(model.dh_a.tolist(), model.dh_d.tolist(), strict=True)]
    masses = model.link_masses.tolist()
    # Not `sum`, which rounds in another way from Python 3.12 on: the same run sends the same bytes everywhere.
    return [reduce(add, masses[i:]) * (0.5 * reduce(add, lengths[i:])) ** 2 / 2.0 for i in range(6)]


@lru_cache(maxsize=64)
def _noise(seed: int | None, scale: float) -> tuple[float, ...]:
    if seed is None:
        return (0.0,) * (_NOISE_LENGTH + 6)
    numbers: list[float] = (scale * np.random.default_rng(seed).standard_normal(_NOISE_LENGTH)).tolist()
    return (*numbers, *numbers[:6])

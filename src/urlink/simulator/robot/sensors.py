"""Sensors of a simulated arm. Their values are computed from the set-points of the arm.

- **Positions and poses** agree: every pose is computed by forward kinematics from the joint positions of the same
  cycle.
- **Speeds** are the derivatives of the positions. The TCP speed is the product of the Jacobian and the joint speeds.
- **Moments** are computed for the rigid links and the rotors (`urlink.dynamics`).
- **Currents** are these moments divided by the torque constants, plus friction (`urlink.arm.motors`), minus the effect
  of external forces on the tool. At rest, stiction carries a part of the load. Therefore the actual current of a joint
  at rest has an error, a fraction of the friction, which differs from rest to rest of this joint. The error of a moving
  joint has a slow and a fast part.
- **Control currents** of a CB arm are the actual currents without their noise. Those of an e-Series are the targets.
- **Positions at rest** have an error of some encoder steps, which also differs from rest to rest. After a stop, each
  joint creeps to this position for some tenths of a second.
- **The force** at the TCP is computed by `surroundings`. The sensor adds an offset, an error that changes while the arm
  moves, a drift, and noise. Offset, error and drift are fixed in the frame of the flange.
- **Temperatures** are those of an arm that has been on. They rise slowly, and further in joints with a higher load.
- **The tool accelerometer** shows the acceleration of the flange plus the upward acceleration that supports it against
  gravity, in the tool frame. On a CB2 arm, it shows only gravity, with the sign that a real CB2 packet contains.

For lags, offsets, noise and resolution steps, see `characteristics`. It is assumed that the elbow position in real-time
packets is the same point as the elbow in the safety data of a CB3 capture.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from operator import add, mul, sub
from typing import Any

from urlink.arm.dynamics import GRAVITY, Dynamics
from urlink.arm.kinematics import Arm as Kinematics
from urlink.arm.kinematics.geometry import chain, flange, velocity
from urlink.arm.motors import Motors
from urlink.arm.parameters import number
from urlink.arm.rigid import FLOATS, IDENTITY, Rigid, from_pose, product, to_pose

from .characteristics import (
    AMBIENT,
    CURRENT_TIME,
    DRIFT_TIME,
    FORCE_SETTLING_TIME,
    JOINT_VOLTAGE,
    SETTLING_TIME,
    STEPS,
    TEMPERATURE_RISE,
    TRACKING_TIME,
    WANDER_TIME,
    WARMED_BEFORE,
    WARMING,
    SensorParameters,
)
from .noise import Noise
from .setpoint_sources import Course, Setpoint

_ZERO = [0.0] * 6
# Channels of the noise.
_POSITION, _SPEED, _ACCELEROMETER, _CURRENT, _VOLTAGE, _FORCE, _OFFSET, _STICTION = range(8)
_TRACKING, _SETTLING, _SLOW_CURRENT, _WANDER, _DRIFT = range(8, 13)
# Numbers of cycles of motion, and of any cycles, after which the slow errors are computed again.
_SLOW_STEP, _DRIFT_STEP = 8, 64
# Number of settling times after which the creeping that follows a stop has ended.
_SETTLED = 6.0
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
    """Values of all sensors in one cycle. Each value is computed when it is first read.

    A sample keeps everything that its values depend on. So a value is the same, to the last bit, whether it is read in
    its cycle or many cycles later, and whether other values are read or not.

    Args:
        sensors: Sensors that compute the values.
        setpoint: Targets of the cycle.
        tcp: Tool centre point in the flange frame, shape (6,), in m and rad.
        dynamics: Dynamics of the arm with rotors and payload.
        external: Wrench on the TCP, shape (6,), in N and Nm in the base frame.
        wrench: Wrench that an ideal force sensor would show, shape (6,).
        zeroed: Error of the force sensor when it was zeroed, in the frame of the flange, shape (6,).
        progress: Cycle and history of the arm, which select the noise. It must not change any more.
        time: Time since the arm was switched on, in s, for the temperatures.
        is_powered: Whether the motors have power.
        deviation: Deviation of the joints from their targets, shape (6,), in rad.

    Attributes:
        q_target, qd_target, qdd_target, M_target, I_target: Six numbers each, in rad, rad/s, rad/s², Nm, A.
        q_actual, qd_actual, I_actual, I_control, V_actual, T_motor: Six numbers each, in rad, rad/s, A, A, V, °C.
        pose_actual, pose_target: Pose of the TCP in the base frame, in m and rotation vector in rad.
        tool_frame: Frame of the TCP in the base frame, from the actual positions.
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
    tool_frame: Rigid[float]
    sensors: Sensors
    setpoint: Setpoint
    tcp: Sequence[float]
    dynamics: Dynamics
    external: Sequence[float]
    wrench: Sequence[float]
    zeroed: Sequence[float]
    progress: Progress
    time: float
    is_powered: bool
    deviation: Sequence[float]

    def __init__(
        self,
        sensors: Sensors,
        setpoint: Setpoint,
        tcp: Sequence[float],
        dynamics: Dynamics,
        external: Sequence[float],
        wrench: Sequence[float],
        zeroed: Sequence[float],
        progress: Progress,
        time: float,
        is_powered: bool,
        deviation: Sequence[float],
    ) -> None:
        self.sensors = sensors
        self.setpoint = setpoint
        self.q_target, self.qd_target, self.qdd_target = setpoint
        self.tcp = tcp
        self.dynamics = dynamics
        self.external = external
        self.wrench = wrench
        self.zeroed = zeroed
        self.progress = progress
        self.time = time
        self.is_powered = is_powered
        self.deviation = deviation

    def __getattr__(self, name: str) -> Any:
        # Python calls this method only for a slot that is empty, so each value is computed once.
        measure = _MEASURES.get(name)
        if measure is None:
            raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
        measure(self.sensors, self)
        return object.__getattribute__(self, name)

    def later(self, cycles: int, time: float, setpoint: Setpoint) -> Sample:
        """Return the sample after some more cycles in which only the time and the targets change.

        In all of these cycles, the same joints move, or none.

        Args:
            cycles: Number of cycles.
            time: Time since the arm was switched on, in s.
            setpoint: Targets of the later cycle.
        """
        progress = self.progress.copy()
        progress.cycle += cycles
        if any(setpoint.qd):
            progress.moved += cycles
        return Sample(
            self.sensors,
            setpoint,
            self.tcp,
            self.dynamics,
            self.external,
            self.wrench,
            self.zeroed,
            progress,
            time,
            self.is_powered,
            self.deviation,
        )

    @property
    def is_moving(self) -> bool:
        """Whether the targets move."""
        return any(self.qd_target) or any(self.qdd_target)


class Samples:
    """Samples of several cycles in a row, in which only the time and the targets change. Each is made when it is read.

    Args:
        first: Sample of the first cycle.
        course: Targets of each cycle.
        times: Time since the arm was switched on in each cycle, in s.
    """

    def __init__(self, first: Sample, course: Course, times: Sequence[float]) -> None:
        self._first, self._course, self._times = first, course, times

    def __len__(self) -> int:
        return len(self._times)

    def __getitem__(self, at: int) -> Sample:
        return self._first.later(at, self._times[at], self._course[at]) if at else self._first


class SampleAt:
    """One of several samples, which is made when it is read.

    Args:
        samples: All samples.
        at: Number of the sample, from 0.
    """

    __slots__ = ("_at", "_samples")

    def __init__(self, samples: Samples, at: int) -> None:
        self._samples, self._at = samples, at

    @property
    def q_actual(self) -> list[float]:
        """Joint positions, shape (6,), in rad."""
        return self._samples[self._at].q_actual


@dataclass(slots=True, eq=False)
class Progress:
    """History of an arm that its sensors depend on.

    Attributes:
        period: Duration of a cycle, in s.
        cycle: Number of the cycle.
        moved: Number of cycles in which the arm has moved.
        rest: Number of the current or last rest.
        joint_rests: Number of the current or last rest of each joint, shape (6,).
        joint_changes: Number of changes of `joint_rests`.
        stopped: Number of the cycle in which the last motion ended; None before the first motion.
    """

    period: float
    cycle: int
    moved: int
    rest: int
    joint_rests: list[int]
    joint_changes: int
    stopped: int | None

    @property
    def still(self) -> float:
        """Time since the last motion, in s; infinite before the first one."""
        return math.inf if self.stopped is None else (self.cycle - self.stopped) * self.period

    def cycles(self, seconds: float) -> int:
        """Return a time as a number of cycles, at least 1."""
        return max(round(seconds / self.period), 1)

    def copy(self) -> Progress:
        """Return a copy that does not change with this object. `joint_rests` is replaced, and never changed."""
        return Progress(
            self.period, self.cycle, self.moved, self.rest, self.joint_rests, self.joint_changes, self.stopped
        )


class Sensors:
    """Sensors of one arm.

    Args:
        kinematics: Kinematics of the arm.
        motors: Motors of the joints.
        parameters: Parameters of the sensors.
        q: Joint positions whose gravity load determines the temperature of each joint, shape (6,), in rad.
        seed: Seed of the noise; None for ideal sensors, without noise, offset and drift.
        is_cb2: Whether the arm has a CB2 controller.
    """

    def __init__(
        self,
        kinematics: Kinematics,
        motors: Motors,
        parameters: SensorParameters,
        q: Sequence[float],
        seed: int | None,
        is_cb2: bool,
    ) -> None:
        model = kinematics.model
        self._kinematics, self._of, self._is_ideal, self._is_cb2 = kinematics, parameters, seed is None, is_cb2
        self._noise = Noise(seed)
        self._position_noise = Noise(seed, parameters.position_noise)
        self._position_offset = Noise(seed, parameters.position_offset)
        self._accelerometer_noise = Noise(seed, parameters.accelerometer_noise)
        self._voltage_noise = Noise(seed, parameters.voltage_noise)
        self._rest_current = [parameters.current_noise_at_rest] * 6
        self._held: tuple[int, list[float]] | None = None
        self._turn: Rigid[float] = IDENTITY
        # Latest slow errors: the steps that they belong to, and their values.
        self._error: tuple[tuple[int, int], list[float]] | None = None
        self._slow: tuple[int, list[float]] | None = None
        self._tracking: tuple[int, range, list[float], list[float]] | None = None
        self._coulomb_error = [s * c for s, c in zip(parameters.stiction, motors.coulomb, strict=True)]
        shares = parameters.current_correlation
        self._slow_current = [n * math.sqrt(s) for n, s in zip(parameters.current_noise, shares, strict=True)]
        self._fast_current = [n * math.sqrt(1.0 - s) for n, s in zip(parameters.current_noise, shares, strict=True)]
        self._force_noise = [*parameters.force_noise, *parameters.torque_noise]
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
        torque = model.max_torque.tolist()
        self._push = [_PUSH * m / k for m, k in zip(torque, motors.torque_constants, strict=True)]
        self._warmed_to = -1
        self._warm: list[float] = []

    def positions(
        self, setpoint: Setpoint, progress: Progress, is_powered: bool, deviation: Sequence[float]
    ) -> list[float]:
        """Return the actual joint positions, in rad. `progress` selects their errors."""
        measured = self._positions(setpoint, progress, is_powered)
        return list(map(add, measured, deviation)) if any(deviation) else measured

    def _positions(self, setpoint: Setpoint, progress: Progress, is_powered: bool) -> list[float]:
        q, qd, _ = setpoint
        is_moving = any(qd)
        if self._is_ideal or not (is_powered or is_moving):
            # To first order, this is the position at the time t - lag; the derivative is known exactly.
            return [p - self._of.lag * v for p, v in zip(q, qd, strict=True)] if is_moving else q
        noise = self._position_noise.white(progress.cycle, _POSITION)
        if is_moving:
            lag = self._of.lag
            error, change, past = self._tracking_error(progress)
            return [
                s * round((p - lag * v + e + past * c + n if v else p + n) / s)
                for p, v, e, c, n, s in zip(q, qd, error, change, noise, STEPS, strict=True)
            ]
        offset = self._position_offset.white(progress.rest, _OFFSET)
        creep = self._creep(progress)
        if creep is None:
            return [s * round((p + o + n) / s) for p, o, n, s in zip(q, offset, noise, STEPS, strict=True)]
        return [s * round((p + o + e + n) / s) for p, o, e, n, s in zip(q, offset, creep, noise, STEPS, strict=True)]

    def _tracking_error(self, progress: Progress) -> tuple[list[float], list[float], float]:
        """Return the tracking error of the joints at the last knot and its change until the next one, in rad.

        The third value is the part of the time between both knots that has passed.
        """
        if self._tracking is None or progress.moved - self._tracking[0] not in self._tracking[1]:
            count = progress.cycles(TRACKING_TIME)
            knot = progress.moved // count
            # The mean variance of a line between two independent numbers is two thirds of theirs.
            scales = [1.5**0.5 * each for each in self._of.tracking_error]
            now, then = (list(map(mul, self._noise.white(at, _TRACKING), scales)) for at in (knot, knot + 1))
            self._tracking = knot * count, range(count), now, list(map(sub, then, now))
        begin, steps, error, change = self._tracking
        return error, change, (progress.moved - begin) / len(steps)

    def speeds(self, setpoint: Setpoint, progress: Progress) -> list[float]:
        """Return the actual joint speeds, in rad/s."""
        _, qd, qdd = setpoint
        if not any(qd):
            creep = None if self._is_ideal else self._creep(progress)
            return _ZERO if creep is None else [-each / SETTLING_TIME for each in creep]
        noise, lag = self._noise.white(progress.cycle, _SPEED), self._of.speed_lag
        return [
            v - lag * a + n * s if v else 0.0 for v, a, n, s in zip(qd, qdd, noise, self._of.speed_noise, strict=True)
        ]

    def _creep(self, progress: Progress) -> list[float] | None:
        """Return the distances of the joints from the position at which they come to rest, in rad; None for zeros."""
        past = progress.still / SETTLING_TIME
        if past > _SETTLED:
            return None
        decayed = self._of.settling * math.exp(-past)
        return [decayed * a for a in self._noise.white(progress.rest, _SETTLING)]

    def force_error(self, progress: Progress) -> list[float]:
        """Return offset, slow error and drift of the force sensor in the frame of the flange, in N and Nm."""
        if self._is_ideal:
            return _ZERO
        key = progress.moved // _SLOW_STEP, progress.cycle // _DRIFT_STEP
        if self._error is not None and self._error[0] == key:
            return self._error[1]
        of = self._of
        wander = self._noise.switching(key[0] * _SLOW_STEP, progress.cycles(WANDER_TIME), _WANDER)
        drift = self._noise.wandering(key[1] * _DRIFT_STEP, progress.cycles(DRIFT_TIME), _DRIFT)
        error = [
            o + w * x + d * y
            for o, w, x, d, y in zip(of.force_offset, of.force_wander, wander, of.force_drift, drift, strict=True)
        ]
        self._error = key, error
        return error

    def measure_positions(self, s: Sample) -> None:
        """Set the actual joint positions of a sample."""
        s.q_actual = self.positions(s.setpoint, s.progress, s.is_powered, s.deviation)

    def measure_speeds(self, s: Sample) -> None:
        """Set the actual joint speeds of a sample."""
        s.qd_actual = self.speeds(s.setpoint, s.progress)

    def measure_pose(self, s: Sample) -> None:
        """Set the actual pose of the TCP, and its frame."""
        self._look_at(s)
        s.tool_frame = product(self._flange(s.q_actual), self._tool)
        s.pose_actual = list(to_pose(s.tool_frame))

    def compute_target_pose(self, s: Sample) -> None:
        """Set the pose of the TCP for the targets."""
        self._look_at(s)
        s.pose_target = self._pose

    def compute_target_speed(self, s: Sample) -> None:
        """Set the speed of the TCP for the targets."""
        s.speed_target = self._velocity(s.q_target, s.qd_target, s.pose_target) if any(s.qd_target) else _ZERO

    def measure_speed(self, s: Sample) -> None:
        """Set the actual speed of the TCP."""
        s.speed_actual = self._velocity(s.q_actual, s.qd_actual, s.pose_actual) if any(s.qd_actual) else _ZERO

    def measure_momentum(self, s: Sample) -> None:
        """Set the momentum of the arm."""
        s.momentum = 0.5 * self._mass * math.hypot(*s.speed_actual[:3])

    def measure_elbow(self, s: Sample) -> None:
        """Set position and velocity of the elbow."""
        s.elbow_position, s.elbow_velocity = _elbow(*self._elbow, s.q_actual, s.qd_actual)

    def measure_temperatures(self, s: Sample) -> None:
        """Set the temperatures of the motors."""
        s.T_motor = self._temperatures(int(s.time))

    def measured(
        self, q: Sequence[float], wrench: Sequence[float], zeroed: Sequence[float], progress: Progress
    ) -> Sequence[float]:
        """Return the wrench that the force sensor measures, apart from its noise, along the axes of the base frame.

        Args:
            q: Target joint positions, shape (6,), in rad.
            wrench: Wrench that an ideal sensor would show, shape (6,).
            zeroed: Error of the sensor when it was zeroed, in the frame of the flange, shape (6,).
            progress: Cycle and history of the arm.
        """
        if self._is_ideal:
            return wrench
        turn = self._turn if q is self._posture else self._flange(q)
        return list(map(add, wrench, _turned(turn, list(map(sub, self.force_error(progress), zeroed)))))

    def measure_force(self, s: Sample) -> None:
        """Set the measured wrench with its noise, which is larger while the arm moves and just after it."""
        if not s.is_powered:
            s.force = _ZERO
            return
        if self._is_ideal:
            s.force = list(s.wrench)
            return
        self._look_at(s)
        progress = s.progress
        noise, scales = self._noise.white(progress.cycle, _FORCE), self._force_noise
        after = 0.0 if s.is_moving else progress.still / FORCE_SETTLING_TIME
        if after < _SETTLED:
            share = math.exp(-after)
            scales = [a + share * b for a, b in zip(scales, self._of.motion_noise, strict=True)]
        error = self.force_error(progress)
        own = [e - z + n * k for e, z, n, k in zip(error, s.zeroed, noise, scales, strict=True)]
        s.force = list(map(add, s.wrench, _turned(self._turn, own)))

    def _look_at(self, s: Sample) -> None:
        """Compute the values that depend on targets, tool and payload, if the last sample had others."""
        q, tcp, dynamics = s.q_target, s.tcp, s.dynamics
        if tcp == self._tcp and q == self._posture and dynamics is self._dynamics:
            return
        self._dynamics = dynamics
        if tcp != self._tcp:
            self._tcp, self._tool = list(tcp), from_pose(list(tcp))
        self._posture = q
        self._turn = self._flange(q)
        self._pose = list(to_pose(product(self._turn, self._tool)))
        self._load = None

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

    def measure_load(self, s: Sample) -> None:
        """Set moments, currents and voltages."""
        if not s.is_powered:
            s.M_target = s.I_target = s.I_control = s.I_actual = s.V_actual = _ZERO
            return
        self._look_at(s)
        setpoint, progress, is_moving = s.setpoint, s.progress, s.is_moving
        # External torques on the joints.
        moments = self._moments(setpoint.q, s.tcp, s.external)
        if self._load != (setpoint, moments):
            self._load = setpoint, moments
            needed: list[float] = (
                self._dynamics.torque(*setpoint) if is_moving else self._dynamics.gravity_torque(setpoint.q)
            ).tolist()
            target = self._motors.current(needed, setpoint.qd)
            control = [i - m / k for i, m, k in zip(target, moments, self._motors.torque_constants, strict=True)]
            self._currents = needed, target, control
        s.M_target, s.I_target, s.I_control = self._currents
        if self._is_ideal:
            s.I_actual = s.I_control
        else:
            self._add_current_errors(s, setpoint.qd, progress, is_moving)
        if any(s.deviation):
            # The controller pushes a joint towards its target.
            pushed = [-push * d for push, d in zip(self._push, s.deviation, strict=True)]
            s.I_control, s.I_actual = list(map(add, s.I_control, pushed)), list(map(add, s.I_actual, pushed))
        noise = self._voltage_noise.white(progress.cycle, _VOLTAGE)
        idle, drop, step = JOINT_VOLTAGE
        s.V_actual = [_stepped(idle - drop * abs(i) + n, step) for i, n in zip(s.I_control, noise, strict=True)]

    def _add_current_errors(self, s: Sample, qd: Sequence[float], progress: Progress, is_moving: bool) -> None:
        """Set the actual currents, and on a CB arm the control currents, from the control currents without errors."""
        if self._held is None or self._held[0] != progress.joint_changes:
            held = self._noise.held(progress.joint_rests, _STICTION)
            self._held = progress.joint_changes, list(map(mul, held, self._coulomb_error))
        error, noises = self._held[1], self._rest_current
        if is_moving:
            step = progress.moved // _SLOW_STEP
            if self._slow is None or self._slow[0] != step:
                slow = self._noise.wandering(step * _SLOW_STEP, progress.cycles(CURRENT_TIME), _SLOW_CURRENT)
                self._slow = step, list(map(mul, slow, self._slow_current))
            error = [s if v else e for v, s, e in zip(qd, self._slow[1], error, strict=True)]
            noises = [f if v else n for v, f, n in zip(qd, self._fast_current, noises, strict=True)]
        measured = list(map(add, s.I_control, error))
        s.I_actual = list(map(add, measured, map(mul, self._noise.white(progress.cycle, _CURRENT), noises)))
        if not self._is_e:
            s.I_control = measured

    def _temperatures(self, second: int) -> list[float]:
        if second != self._warmed_to:
            self._warmed_to = second
            warm = 1.0 - math.exp(-(second + WARMED_BEFORE) / WARMING)
            # The resolution is a sixteenth of a degree.
            self._warm = [round(16.0 * (AMBIENT + rise * warm)) / 16.0 for rise in self._rise]
        return self._warm

    def measure_accelerations(self, s: Sample) -> None:
        """Set the value that the accelerometer in the tool measures, in m/s² in the tool frame."""
        self._look_at(s)
        noise, tool = self._accelerometer_noise.white(s.progress.cycle, _ACCELEROMETER), s.tool_frame
        # The axes x, y and z of the tool.
        across = tool[0:9:3], tool[1:9:3], tool[2:9:3]
        if self._is_cb2:
            s.accelerometer = [n - GRAVITY * u[2] for u, n in zip(across, noise, strict=False)]
            return
        x, y, z = 0.0, 0.0, GRAVITY
        if s.is_moving:
            # The sensor is in the flange. Compute the acceleration from two velocities of the flange, a microsecond
            # apart.
            q, qd, qdd = s.q_target, s.qd_target, s.qdd_target
            later = [p + _MOMENT * v for p, v in zip(q, qd, strict=True)]
            faster = [v + _MOMENT * a for v, a in zip(qd, qdd, strict=True)]
            # The velocity of the flange now follows from that of the TCP.
            vx, vy, vz, wx, wy, wz = s.speed_target
            dx, dy, dz = map(sub, self._turn[9:], s.pose_target[:3])
            after = self._velocity(later, faster, self._flange(later)[9:])
            x = (after[0] - (vx + wy * dz - wz * dy)) / _MOMENT
            y = (after[1] - (vy + wz * dx - wx * dz)) / _MOMENT
            z += (after[2] - (vz + wx * dy - wy * dx)) / _MOMENT
        bias = self._of.accelerometer_bias
        s.accelerometer = [u[0] * x + u[1] * y + u[2] * z + b + n for u, b, n in zip(across, bias, noise, strict=False)]


#: Value of a sample -> function that computes this value, and perhaps others, and sets them.
_MEASURES: dict[str, Callable[[Sensors, Sample], None]] = {
    "q_actual": Sensors.measure_positions,
    "qd_actual": Sensors.measure_speeds,
    "pose_target": Sensors.compute_target_pose,
    "speed_target": Sensors.compute_target_speed,
    "momentum": Sensors.measure_momentum,
    "accelerometer": Sensors.measure_accelerations,
    "force": Sensors.measure_force,
    "T_motor": Sensors.measure_temperatures,
    "speed_actual": Sensors.measure_speed,
    **dict.fromkeys(("tool_frame", "pose_actual"), Sensors.measure_pose),
    **dict.fromkeys(("elbow_position", "elbow_velocity"), Sensors.measure_elbow),
    **dict.fromkeys(("M_target", "I_target", "I_control", "I_actual", "V_actual"), Sensors.measure_load),
}


def _stepped(value: float, step: float) -> float:
    """Return the value rounded to a multiple of `step`; a step of 0 means no rounding."""
    return step * round(value / step) if step else value


def _turned(turn: Rigid[float], wrench: Sequence[float]) -> list[float]:
    """Return a wrench along the axes of the base frame, given it along those of a frame."""
    a, b, c, d, e, f, g, h, i, _, _, _ = turn
    fx, fy, fz, mx, my, mz = wrench
    return [
        a * fx + b * fy + c * fz,
        d * fx + e * fy + f * fz,
        g * fx + h * fy + i * fz,
        a * mx + b * my + c * mz,
        d * mx + e * my + f * mz,
        g * mx + h * my + i * mz,
    ]


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

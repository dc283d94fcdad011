"""Simulated arm, which follows set-points, brakes if there is no set-point, and has sensors.

The arm is advanced in every cycle. Sensor values are computed only when a packet needs them. The values do not depend
on how often, or at which moment of a cycle, they are read; see `sensors`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import accumulate, repeat
from typing import TYPE_CHECKING

from linkcore.errors import BadValue
from urlink.arm.dynamics import GRAVITY, Dynamics
from urlink.arm.kinematics import Arm as Kinematics
from urlink.arm.motors import motors_of
from urlink.arm.parameters import number
from urlink.arm.vectors import JOINTS

from .characteristics import SensorParameters
from .sensors import Progress, Sample, Sensors
from .setpoint_sources import BRAKING, Course, Setpoint
from .surroundings import ForceSensor, Overload, Surroundings

if TYPE_CHECKING:
    from urlink.arm.arm_file import ArmFile

_ZERO = [0.0] * 6
# Joints that move, if all of them do.
_ALL = (True,) * 6
#: Deviation of a joint in rad that causes a protective stop, and the code of this stop in the vendor's list.
_DEVIATION_LIMIT, _DEVIATES = number("position_deviation_limit"), 153
#: Time constant in s with which a joint that is no longer dragged returns to its target; deviation that counts as zero.
_RETURN, _RETURNED = 0.1, 1e-6


class SimulatedArm:
    """Simulated arm with six joints and sensors.

    Args:
        kinematics: Kinematics of the arm, published or calibrated.
        setpoint: Initial targets.
        seed: Seed of the sensor noise; None for no noise.
        surroundings: Surroundings that act on the tool.
        like: Arm file with identified properties: motors, sensors, TCP and payload. None selects the known properties
            of the model.
        is_cb2: Whether the arm has a CB2 controller.

    Attributes:
        kinematics: Kinematics of the arm.
        model: Model of the arm: its published geometry, masses and limits.
        motors: Motors of the joints.
        payload: Mass at the flange, in kg.
        payload_cog: Centre of mass of the payload in the flange frame, shape (3,), in m.
        payload_inertia: Inertia of the payload, shape (6,), in kg m²: xx, yy, zz, xy, xz, yz.
        force_sensor: Sensor that measures the forces on the tool, and detects an overload.
        is_powered: Whether the arm has power. Without power, there is no current and no noise.
        external_force: Wrench at the TCP that an RTDE client has sent, in N and Nm.
        uses_external_force: Whether `external_force` is reported instead of the measured force.
        drags: Joint number -> fraction of its motion that the joint does not follow, as with a defective brake.
    """

    def __init__(
        self,
        kinematics: Kinematics,
        setpoint: Setpoint,
        seed: int | None,
        surroundings: Surroundings,
        like: ArmFile | None,
        is_cb2: bool = False,
    ) -> None:
        self.kinematics = kinematics
        self.model = kinematics.model
        self.motors = motors_of(self.model) if like is None else like.motors
        self.payload = 0.0
        self.payload_cog: Sequence[float] = (0.0, 0.0, 0.0)
        self.payload_inertia: Sequence[float] = (0.0,) * 6
        #: Change of the payload that is in progress: old and new values (mass, centre, inertia), duration and elapsed
        #: time in s.
        self._transition: tuple[Sequence[float], Sequence[float], float, float] | None = None
        #: Gravity setting of the controller, shape (3,), in m/s² in the base frame. The vector points upwards.
        self.gravity: Sequence[float] = (0.0, 0.0, GRAVITY)
        self.is_powered = True
        self.external_force: Sequence[float] = _ZERO
        self.uses_external_force = False
        self._tcp: list[float] = list(_ZERO)
        self._dynamics: Dynamics | None = None
        self._carried: tuple[tuple[float, ...], ...] | None = None
        self._setpoint = setpoint
        parameters = SensorParameters.of(self.model) if like is None else SensorParameters.of(self.model).like(like)
        self._sensors = Sensors(kinematics, self.motors, parameters, setpoint.q, seed, is_cb2)
        #: Deviation of the joints from their targets that `drags` causes, shape (6,), in rad.
        self.deviation: Sequence[float] = _ZERO
        self._surroundings = surroundings
        self.force_sensor = ForceSensor(kinematics, surroundings)
        self.drags: dict[int, float] = {}
        self._is_following = True
        # State of the arm when braking began, total duration of the braking, and elapsed time, both in s.
        self._brake: tuple[Setpoint, float, float] | None = None
        self._progress = Progress(0.002, 0, 0, 0, [0] * 6, 0, None)
        # Joints that moved in the last cycle; empty if none did.
        self._moving: tuple[bool, ...] = ()
        # Error of the force sensor when it was zeroed, in the frame of the flange.
        self._zeroed_error: Sequence[float] = _ZERO
        self._time = 0.0
        self._sample: Sample | None = None
        if like is not None:
            self._take_tool(like)

    # -- moving ------------------------------------------------------------------------------------

    @property
    def setpoint(self) -> Setpoint:
        """Targets of this cycle."""
        return self._setpoint

    @property
    def is_moving(self) -> bool:
        """Whether the joints move, because the set-points move or the arm brakes."""
        return self._brake is not None or any(self._setpoint.qd)

    @property
    def is_standing(self) -> bool:
        """Whether the arm is at rest and follows no set-points."""
        return not self.is_moving and not self._is_following

    def advance(self, seconds: float, setpoint: Setpoint | None) -> None:
        """Advance by one cycle to this set-point. With None, the arm brakes and then stays at rest."""
        progress = self._progress
        progress.cycle += 1
        progress.period = seconds
        self._time += seconds
        if self._transition is not None:
            self._go_over(*self._transition, seconds)
        if setpoint is not None:
            self._setpoint, self._brake = setpoint, None
        else:
            if self._is_following:
                self._begin_to_brake()
            if self._brake is not None:
                self._go_on_braking(*self._brake, seconds)
        self._is_following = setpoint is not None
        if self.drags or any(self.deviation):
            self._deviate(seconds)
        qd = self._setpoint.qd
        if any(qd):
            progress.moved += 1
            moving = tuple(map(bool, qd)) if 0.0 in qd else _ALL
            if moving != self._moving:
                self._count_rests(moving)
        elif self._moving:
            progress.rest += 1
            progress.stopped = progress.cycle
            self._count_rests(())
        self._sample = None
        self.force_sensor.advance(self._setpoint, self._tcp, self.payload, self.payload_cog, seconds)

    @property
    def is_unchanging(self) -> bool:
        """Whether nothing but the time changes while the set-points stay the same."""
        return (
            not (self._moving or self.is_moving or self.drags or any(self._setpoint.qdd) or any(self.deviation))
            and self._transition is None
            and not self.uses_external_force
            and self.force_sensor.is_unchanging
        )

    @property
    def is_gliding(self) -> bool:
        """Whether nothing but the time and the set-points change while the same joints move."""
        return (
            bool(self._moving)
            and self._is_following
            and self._transition is None
            and not (self.drags or any(self.deviation) or self.uses_external_force)
            and self.force_sensor.is_unchanging
        )

    def advance_along(self, course: Course, cycles: int, seconds: float) -> list[float]:
        """Advance by some cycles along a course; see `is_unchanging` and `is_gliding`.

        Return the time since the arm was switched on, in s, at the beginning and after each cycle.
        """
        times = list(accumulate(repeat(seconds, cycles), initial=self._time))
        self._time = times[-1]
        self._setpoint = course[cycles]
        self._progress.cycle += cycles
        if self._moving:
            self._progress.moved += cycles
        self._sample = None
        return times

    def glide(self, seconds: float, setpoint: Setpoint) -> None:
        """Advance by one cycle, as `advance_along` does."""
        self._time += seconds
        self._setpoint = setpoint
        self._progress.cycle += 1
        if self._moving:
            self._progress.moved += 1
        self._sample = None

    def _count_rests(self, moving: tuple[bool, ...]) -> None:
        """Begin a rest of the joints that no longer move; `moving` is empty if no joint moves."""
        # A new list, because samples of earlier cycles refer to the previous one.
        rests = self._progress.joint_rests.copy()
        for joint, was_moving in enumerate(self._moving):
            if was_moving and not (moving and moving[joint]):
                rests[joint] += 1
        self._progress.joint_rests = rests
        self._progress.joint_changes += 1
        self._moving = moving

    def _deviate(self, seconds: float) -> None:
        """Advance `deviation` by one cycle: a dragged joint falls behind, and any other joint returns to its target."""
        left = math.exp(-seconds / _RETURN)
        self.deviation = [
            d - self.drags[i] * v * seconds if i in self.drags else (left * d if abs(d) > _RETURNED else 0.0)
            for i, (d, v) in enumerate(zip(self.deviation, self._setpoint.qd, strict=True))
        ]

    @property
    def overload(self) -> Overload | None:
        """Reason for a protective stop that the sensors have detected in this cycle; None if there is none."""
        if any(self.deviation):
            furthest = max(self.deviation, key=abs)
            if abs(furthest) > _DEVIATION_LIMIT and self.is_moving:
                joint = list(self.deviation).index(furthest)
                text = f"{JOINTS[joint]}: the position deviates from its target by {abs(furthest):.4f} rad"
                return Overload(text, (_DEVIATES, joint))
        return self.force_sensor.overload

    def carry(self, payload: Sequence[float], seconds: float) -> None:
        """Set mass, centre and inertia of the payload, in kg, m and kg m².

        The payload changes to these values in `seconds`. It is assumed that the change is linear, and that states which
        are sent during the change show the intermediate values (`payload_transition_is_linear`).

        Args:
            payload: New mass, centre and inertia, ten numbers.
            seconds: Duration of the change, in s.
        """
        before = (self.payload, *self.payload_cog, *self.payload_inertia)
        self._go_over(before, payload, seconds, 0.0, 0.0)

    def _go_over(
        self, before: Sequence[float], after: Sequence[float], duration: float, past: float, seconds: float
    ) -> None:
        past += seconds
        share = past / duration if past < duration else 1.0
        self._transition = (before, after, duration, past) if share < 1.0 else None
        now = [a + share * (b - a) for a, b in zip(before, after, strict=True)] if share < 1.0 else after
        self.payload, self.payload_cog, self.payload_inertia = now[0], tuple(now[1:4]), tuple(now[4:])

    def _begin_to_brake(self) -> None:
        if any(self._setpoint.qd):
            limits: list[float] = self.model.max_acceleration.tolist()
            hardest = max(abs(v) / limit for v, limit in zip(self._setpoint.qd, limits, strict=True))
            # The maximum deceleration on the smooth brake path is 3/2 of the mean deceleration. Braking lasts at least
            # 0.06 s, so that it is visible at 125 Hz.
            self._brake = (self._setpoint, max(1.5 * hardest / BRAKING, 0.06), 0.0)
        else:
            self._setpoint = Setpoint(self._setpoint.q, _ZERO, _ZERO)

    def _go_on_braking(self, begin: Setpoint, duration: float, past: float, seconds: float) -> None:
        """Advance the braking by one cycle. All joints slow down in proportion.

        Because of this, the arm brakes in the direction of its motion.
        """
        past += seconds
        if past >= duration:
            self._brake = None
            scaling, way, change = 0.0, 0.5 * duration, 0.0
        else:
            self._brake = (begin, duration, past)
            u = past / duration
            scaling = 1.0 - u * u * (3.0 - 2.0 * u)
            way = duration * (u - u**3 * (1.0 - 0.5 * u))
            change = -6.0 * u * (1.0 - u) / duration
        self._setpoint = Setpoint(
            [q + way * v for q, v in zip(begin.q, begin.qd, strict=True)],
            [scaling * v for v in begin.qd] if scaling else _ZERO,
            [change * v for v in begin.qd] if scaling else _ZERO,
        )

    # -- tool ----------------------------------------------------------------------------------------

    @property
    def tcp(self) -> list[float]:
        """Tool centre point in the flange frame: position in m and rotation vector in rad."""
        return list(self._tcp)

    @tcp.setter
    def tcp(self, pose: Sequence[float]) -> None:
        values = [float(value) for value in pose]
        if len(values) != 6 or not all(map(math.isfinite, values)):
            raise BadValue(f"tcp={pose!r}; expected six finite numbers")
        self._tcp = values
        self._sample = None

    def _take_tool(self, like: ArmFile) -> None:
        if like.tcp is not None:
            self.tcp = like.tcp
        mass = like.known("payload")
        if mass is not None:
            self.payload = max(mass, 0.0)
            self.payload_cog = [each.value if each.is_known else 0.0 for each in like.estimates["payload_cog"]]

    def take_tool_of(self, other: SimulatedArm) -> None:
        """Take over TCP and payload of another arm.

        Both are part of the installation, which a reboot does not change.
        """
        self.tcp = other.tcp
        self.payload = other.payload
        self.payload_cog = other.payload_cog
        self.payload_inertia = other.payload_inertia

    # -- what acts on it -----------------------------------------------------------------------------

    @property
    def wrench(self) -> Sequence[float]:
        """Wrench at the TCP that the controller uses, shape (6,), in N and Nm.

        It equals the force of `sample`, but without noise.
        """
        return self.external_force if self.uses_external_force else self._measured

    @property
    def pushing_wrench(self) -> Sequence[float]:
        """Wrench at the TCP to which the arm yields in freedrive, shape (6,), in N and Nm.

        It equals `wrench`, but without the errors of the force sensor. In freedrive, a real arm yields to the torques
        on its joints, so an offset of the sensor does not move it.
        """
        return self.external_force if self.uses_external_force else self.force_sensor.wrench

    @property
    def _measured(self) -> Sequence[float]:
        """Wrench that the force sensor measures, apart from its noise, in N and Nm in the base frame."""
        return self._sensors.measured(self._setpoint.q, self.force_sensor.wrench, self._zeroed_error, self._progress)

    @property
    def pushed_joints(self) -> Sequence[float]:
        """External torques on the joints, in Nm, without the torques that the wrench at the TCP causes."""
        pushed, touched = self._surroundings.joint_torques, self.force_sensor.torques
        return [a + b for a, b in zip(pushed, touched, strict=True)] if any(touched) else pushed

    @property
    def external_torques(self) -> list[float]:
        """All external torques on the joints, in Nm.

        Zeroing the force sensor does not change them.
        """
        torques = list(self.pushed_joints)
        if any(self.force_sensor.external):
            across = self.kinematics.jacobian(self._setpoint.q, self._tcp).T @ self.force_sensor.external
            torques = [a + b for a, b in zip(torques, across.tolist(), strict=True)]
        return torques

    @property
    def raw_wrench(self) -> list[float]:
        """Wrench at the TCP as measured before `zero_force` subtracts its offset, in N and Nm in the base frame."""
        raw = self._sensors.measured(self._setpoint.q, self.force_sensor.external, _ZERO, self._progress)
        return [f - m + e for f, m, e in zip(self.sample.force, self._measured, raw, strict=True)]

    def zero_force(self) -> None:
        """Make the current force at the TCP the new zero."""
        self.force_sensor.zero()
        self._zeroed_error = self._sensors.force_error(self._progress)
        self._sample = None

    # -- what it shows -------------------------------------------------------------------------------

    @property
    def sample(self) -> Sample:
        """Values of all sensors in this cycle. Each value is computed when it is first read."""
        if self._sample is None:
            self._sample = Sample(
                self._sensors,
                self._setpoint,
                self._tcp,
                self.dynamics,
                self.force_sensor.external,
                self.force_sensor.wrench,
                self._zeroed_error,
                self._progress.copy(),
                self._time,
                self.is_powered,
                self.deviation,
            )
            if self.uses_external_force:
                self._sample.force = list(self.external_force)
        return self._sample

    @property
    def q_actual(self) -> list[float]:
        """Joint positions of `sample`, in rad.

        Programs read the positions in every cycle, so the other sensors are not computed here.
        """
        if self._sample is not None:
            return self._sample.q_actual
        return self._sensors.positions(self._setpoint, self._progress, self.is_powered, self.deviation)

    @property
    def qd_actual(self) -> list[float]:
        """Joint speeds of `sample`, in rad/s.

        A program with a damped control loop reads the speeds in every cycle, so the other sensors are not computed
        here.
        """
        if self._sample is not None:
            return self._sample.qd_actual
        return self._sensors.speeds(self._setpoint, self._progress)

    @property
    def dynamics(self) -> Dynamics:
        """Dynamics of the published arm with its rotors and its payload.

        The controller uses the dynamics to compute the moments of the joints. The calibration is not used. For a UR3e
        at rest, the computed moments differ from the reported moments by 27 mNm with the calibration, but by only 1 mNm
        without it.
        """
        carried = (self.payload,), tuple(self.payload_cog), tuple(self.payload_inertia), tuple(self.gravity)
        if self._dynamics is None or carried != self._carried:
            self._carried = carried
            self._dynamics = Dynamics(
                self.model,
                payload=self.payload,
                payload_cog=self.payload_cog,
                payload_inertia=self.payload_inertia,
                gravity=[-each for each in self.gravity],
                rotors=self.motors.rotor_inertias,
            )
        return self._dynamics

    @property
    def current_as_torque(self) -> list[float]:
        """Actual joint currents, converted to torques with the torque constants, in Nm."""
        return [i * k for i, k in zip(self.sample.I_actual, self.motors.torque_constants, strict=True)]

    @property
    def tool_acceleration(self) -> list[float]:
        """Acceleration of the TCP for the targets of this cycle, in the base frame, in m/s² and rad/s²."""
        q, qd, qdd = self._setpoint
        if not any(qd) and not any(qdd):
            return list(_ZERO)
        # Compute the time derivative of the product of Jacobian and joint speeds with a central difference.
        before, after = (
            self.kinematics.jacobian([p + t * v for p, v in zip(q, qd, strict=True)], self._tcp)
            @ [v + t * a for v, a in zip(qd, qdd, strict=True)]
            for t in (-1e-5, 1e-5)
        )
        acceleration: list[float] = ((after - before) / 2e-5).tolist()
        return acceleration

    def dexterity(self, q: Sequence[float]) -> float:
        """Return the square of the determinant of the flange's Jacobian; 0 in a singular posture.

        Three captured force mode packets contain exactly this number.

        Args:
            q: Target joint positions, shape (6,), in rad.
        """
        return float(self.kinematics.manipulability(q)) ** 2

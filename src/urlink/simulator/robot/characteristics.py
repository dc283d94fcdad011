"""Parameters of a simulated robot: its speed scaling, and the behaviour of its sensors.

For the facts about scaling and their sources, see docs/protocols/urscript.md, Speed scaling. Sensors have lags,
offsets, noise and resolution steps. For the evidence of each value, see `urlink.arm.parameters`. The module `noise`
makes the random numbers.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from linkcore.arguments import check_number
from linkcore.errors import BadValue
from urlink.arm.models import Model
from urlink.arm.motors import force_size, joint_numbers
from urlink.arm.parameters import is_assumed, number, numbers, parameters
from urlink.arm.rigid import floats

if TYPE_CHECKING:
    from urlink.arm.arm_file import ArmFile


@dataclasses.dataclass(frozen=True, kw_only=True)
class ScalingParameters:
    """Parameters of the speed scaling, with which a controller slows down the motions of programs.

    Attributes:
        start_rate: Rate at which the scaling rises from 0 at the start of a program, in 1/s.
        move_rate: Rate at which the scaling rises from 0 when a later path move of the program starts from rest, in
            1/s.
        slider_rate: Rate at which the scaling follows the speed slider, in 1/s.
        resume_rate: Rate at which the scaling rises from 0 when a program is resumed, in 1/s.
        servoj_lag_stretches: Whether the lag of ``servoj`` is multiplied by 1 / scaling, like the time of all motions.
            If False, only the time of the set-points is multiplied, and the arm still moves to the last set-point while
            the scaling is 0.

    Raises:
        BadValue: If a rate is not above zero.
    """

    start_rate: float = number("start_rate")
    move_rate: float = number("move_rate")
    slider_rate: float = number("slider_rate")
    resume_rate: float = number("resume_rate")
    servoj_lag_stretches: bool = is_assumed("servoj_lag_stretches")

    def __post_init__(self) -> None:
        for name in ("start_rate", "move_rate", "slider_rate", "resume_rate"):
            check_number(getattr(self, name), name, 1e-3, 1e6, "1/s")


def approached(now: float, target: float, most: float) -> float:
    """Return `now`, changed towards `target` by at most `most`."""
    return target if abs(target - now) <= most else now + most if target > now else now - most


#: Resolution of the joint encoders, in rad.
STEPS = numbers("encoder_step")
#: Ambient temperature in °C, time constant of the warming in s, and final temperature rise of each joint in K.
AMBIENT, WARMING, TEMPERATURE_RISE = number("ambient_temperature"), number("warming_time"), numbers("temperature_rise")
#: Time, in s, for which the arm was on before the simulation begins.
WARMED_BEFORE = number("warmed_before")
#: Times of motion, in s, after which the slow part of the currents' error, the force's error, and the tracking error
#: are independent of their previous values; and the same for the drift of the force, in s of any kind.
CURRENT_TIME, WANDER_TIME, TRACKING_TIME = number("current_time"), number("force_wander_time"), number("tracking_time")
DRIFT_TIME = number("force_drift_time")
#: Times, in s, after which the creeping of a joint and the noise of the force have fallen to 37 % after a stop.
SETTLING_TIME, FORCE_SETTLING_TIME = number("settling_time"), number("force_settling_time")
#: Time that an e-Series controller needs to execute a cycle, without a running program and with one, in ms.
EXECUTION_TIME = number("execution_time"), number("execution_time_of_a_program")
#: Supply voltage of each joint without current in V, voltage drop per current in V/A, and resolution of the measurement
#: in V.
JOINT_VOLTAGE = number("joint_voltage"), number("joint_voltage_drop"), number("voltage_step")


# Parameters with a value for each joint or axis, and their number of values.
_VECTORS = dict.fromkeys(
    (
        "tracking_error",
        "speed_noise",
        "current_noise",
        "current_correlation",
        "stiction",
        "motion_noise",
        "force_offset",
        "force_wander",
        "force_drift",
    ),
    6,
) | dict.fromkeys(("force_noise", "torque_noise", "accelerometer_bias"), 3)
# Parameters that may be negative.
_SIGNED = ("force_offset", "accelerometer_bias")


def _axes(name: str, of: str) -> tuple[float, ...]:
    """Return the values of a parameter for three axes; a single number applies to each axis."""
    values = numbers(name, of)
    return values * 3 if len(values) == 1 else values


@dataclasses.dataclass(frozen=True, kw_only=True)
class SensorParameters:
    """Lags, noise and offsets of the sensors of one arm.

    Attributes:
        lag: Lag of the actual joint positions behind their targets, in s.
        speed_lag: Lag of the actual joint speeds behind their targets, in s.
        position_noise: Noise of the joint positions, which differs from cycle to cycle, in rad.
        position_offset: Position error of a joint at rest, as a standard deviation, in rad. The error stays constant
            during a rest, and differs from rest to rest.
        tracking_error: Position error of a moving joint in addition to the lag, shape (6,), in rad.
        settling: Distance of a joint from its position of rest at the moment of a stop, as a standard deviation, in
            rad.
        speed_noise: Noise of the speed of a moving joint, shape (6,), in rad/s.
        current_noise: Error of the current of a moving joint, shape (6,), in A.
        current_correlation: Fraction of the variance of this error that changes slowly, shape (6,), 0 to 1.
        current_noise_at_rest: Noise of the current of a joint at rest, in A.
        stiction: Error of the actual current of a joint at rest, as a standard deviation and a fraction of the Coulomb
            friction, shape (6,). The error differs from rest to rest.
        voltage_noise: Noise of the joint voltages, in V.
        force_noise: Noise of the force at rest, in the frame of the flange, shape (3,), in N.
        torque_noise: Noise of the torque at rest, in the frame of the flange, shape (3,), in Nm.
        motion_noise: Additional noise of force and torque while the arm moves, in the frame of the flange, shape (6,),
            in N and Nm.
        force_offset: Wrench that a sensor shows that was never zeroed, in the frame of the flange, shape (6,), in N and
            Nm.
        force_wander: Error of the wrench that changes while the arm moves, as a standard deviation in the frame of the
            flange, shape (6,), in N and Nm.
        force_drift: Error of the wrench that changes with time, as a standard deviation in the frame of the flange,
            shape (6,), in N and Nm.
        accelerometer_noise: Noise of the accelerometer, in m/s².
        accelerometer_bias: Offset of the accelerometer in the tool frame, shape (3,), in m/s².

    Raises:
        BadValue: If a vector has the wrong number of values, if a number is not finite, or if a parameter that must not
            be negative is negative.
    """

    lag: float = number("tracking_lag")
    speed_lag: float = number("speed_lag")
    position_noise: float = number("position_noise")
    position_offset: float = number("position_offset")
    tracking_error: Sequence[float] = numbers("tracking_error")
    settling: float = number("settling")
    speed_noise: Sequence[float] = numbers("speed_noise")
    current_noise: Sequence[float] = joint_numbers("current_noise", "UR5e")
    current_correlation: Sequence[float] = joint_numbers("current_correlation", "UR5e")
    current_noise_at_rest: float = number("current_noise_at_rest")
    stiction: Sequence[float] = joint_numbers("stiction", "UR5e")
    voltage_noise: float = number("voltage_noise")
    force_noise: Sequence[float] = _axes("force_noise", "UR5e")
    torque_noise: Sequence[float] = _axes("torque_noise", "UR5e")
    motion_noise: Sequence[float] = numbers("motion_noise")
    force_offset: Sequence[float] = numbers("force_offset", "UR5e")
    force_wander: Sequence[float] = numbers("force_wander", "UR5e")
    force_drift: Sequence[float] = numbers("force_drift")
    accelerometer_noise: float = number("accelerometer_noise")
    accelerometer_bias: Sequence[float] = numbers("accelerometer_bias")

    def __post_init__(self) -> None:
        for name, count in _VECTORS.items():
            object.__setattr__(self, name, tuple(map(float, floats(getattr(self, name), count, name))))
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            sizes = () if field.name in _SIGNED else (value,) if isinstance(value, float) else value
            if any(not (math.isfinite(each) and each >= 0.0) for each in sizes):
                raise BadValue(f"{field.name}={value!r}; expected finite numbers, 0 or more")
        if max(self.current_correlation) > 1.0:
            raise BadValue(f"current_correlation={self.current_correlation!r}; expected 0 to 1")

    def like(self, arm: ArmFile) -> SensorParameters:
        """Return a copy of these parameters, in which the identified values of one arm replace the defaults."""
        named = {field.name: field.name for field in dataclasses.fields(self)} | {"lag": "tracking_lag"}
        known = {field: arm.known(name) for field, name in named.items()}
        changed = {
            field: (max(value, 0.0),) * _VECTORS[field] if field in _VECTORS else max(value, 0.0)
            for field, value in known.items()
            if value is not None
        }
        return dataclasses.replace(self, **changed)  # type: ignore[arg-type]

    @classmethod
    def of(cls, model: Model) -> SensorParameters:
        """Return the default parameters for a model: logged values of this arm, or else those of its joint sizes."""
        name = model.name
        size = force_size(name)
        return cls(
            current_noise=joint_numbers("current_noise", name),
            current_correlation=joint_numbers("current_correlation", name),
            stiction=joint_numbers("stiction", name),
            force_noise=_axes("force_noise", size),
            torque_noise=_axes("torque_noise", size),
            force_offset=numbers("force_offset", name if ("force_offset", name) in parameters() else model.generation),
            force_wander=numbers("force_wander", name if ("force_wander", name) in parameters() else "other"),
        )

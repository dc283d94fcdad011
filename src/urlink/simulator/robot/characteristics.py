"""Parameters of a simulated robot: its speed scaling, and the behaviour of its sensors.

For the facts about scaling and their sources, see docs/protocols/urscript.md, Speed scaling. Sensors have lags,
offsets, noise and resolution steps. The simulated noise is Gaussian, and independent from cycle to cycle. The noise of
real arms has these properties only at rest. For the evidence of each value, see `urlink.arm.parameters`.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from linkcore.arguments import check_number
from linkcore.errors import BadValue
from urlink.arm.models import Model
from urlink.arm.motors import force_size
from urlink.arm.parameters import is_assumed, number, numbers
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
#: Time that an e-Series controller needs to execute a cycle, without a running program and with one, in ms.
EXECUTION_TIME = number("execution_time"), number("execution_time_of_a_program")
#: Supply voltage of each joint without current in V, voltage drop per current in V/A, and resolution of the measurement
#: in V.
JOINT_VOLTAGE = number("joint_voltage"), number("joint_voltage_drop"), number("voltage_step")


@dataclasses.dataclass(frozen=True, kw_only=True)
class SensorParameters:
    """Lags, noise and offsets of the sensors of one arm.

    Attributes:
        lag: Lag of the actual joint positions behind their targets, in s.
        speed_lag: Lag of the actual joint speeds behind their targets, in s.
        position_noise: Noise of the joint positions, which differs from cycle to cycle, in rad.
        position_offset: Position error of a joint at rest, as a standard deviation, in rad. The error stays constant
            during a rest, and differs from rest to rest.
        speed_noise: Noise of the speed of a moving joint, in rad/s.
        current_noise: Noise of the current of a moving joint, in A.
        current_noise_at_rest: Noise of the current of a joint at rest, in A.
        stiction: Error of the actual current of a joint at rest, as a standard deviation and a fraction of the Coulomb
            friction. The error differs from rest to rest.
        voltage_noise: Noise of the joint voltages, in V.
        force_noise: Noise of the force at the TCP, in N.
        torque_noise: Noise of the torque at the TCP, in Nm.
        force_offset: Wrench at the TCP that a sensor shows before it is zeroed, shape (6,), in N and Nm.
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
    speed_noise: float = number("speed_noise")
    current_noise: float = number("current_noise")
    current_noise_at_rest: float = number("current_noise_at_rest")
    stiction: float = number("stiction")
    voltage_noise: float = number("voltage_noise")
    force_noise: float = number("force_noise", "size 3")
    torque_noise: float = number("torque_noise", "size 3")
    force_offset: Sequence[float] = numbers("force_offset")
    accelerometer_noise: float = number("accelerometer_noise")
    accelerometer_bias: Sequence[float] = numbers("accelerometer_bias")

    def __post_init__(self) -> None:
        for name, count in (("force_offset", 6), ("accelerometer_bias", 3)):
            object.__setattr__(self, name, tuple(map(float, floats(getattr(self, name), count, name))))
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if isinstance(value, float) and not (math.isfinite(value) and value >= 0.0):
                raise BadValue(f"{field.name}={value!r}; expected a finite number, 0 or more")

    def like(self, arm: ArmFile) -> SensorParameters:
        """Return a copy of these parameters, in which the identified values of one arm replace the defaults."""
        named = {field.name: field.name for field in dataclasses.fields(self)} | {"lag": "tracking_lag"}
        known = {field: arm.known(name) for field, name in named.items()}
        changed = {field: max(value, 0.0) for field, value in known.items() if value is not None}
        return dataclasses.replace(self, **changed)  # type: ignore[arg-type]

    @classmethod
    def of(cls, model: Model) -> SensorParameters:
        """Return the default parameters for a model. Only the noise of force and torque depends on the model."""
        size = force_size(model.name)
        return cls(force_noise=number("force_noise", size), torque_noise=number("torque_noise", size))

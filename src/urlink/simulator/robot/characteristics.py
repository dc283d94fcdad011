"""The parameters of a simulated robot: how it scales the speed of programs, and how its arm measures.

The facts of scaling and their sources: docs/protocols/urscript.md, Speed scaling. Sensors have lags, offsets, noise and
steps; noise is Gaussian and independent from cycle to cycle, which real noise is only at rest. What backs each value:
`urlink.arm.parameters`.
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
    """How a controller scales the motion of programs.

    Attributes:
        start_rate: 1/s, with which the scaling rises from 0 at the start of a program.
        move_rate: 1/s, with which it rises from 0 when a later path move of the program starts from rest.
        slider_rate: 1/s, with which it follows the speed slider.
        resume_rate: 1/s, with which it rises from 0 when a program is resumed.
        servoj_lag_stretches: whether the lag of ``servoj`` lasts longer by 1 / scaling, as all motion does. If not,
            only the time of the set-points is stretched, and the arm goes on to the last one while the scaling is 0.

    Raises:
        BadValue: a rate is not above zero.
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
    """A number that has come closer to `target`, by at most `most`."""
    return target if abs(target - now) <= most else now + most if target > now else now - most


#: rad, of the encoders of the joints.
STEPS = numbers("encoder_step")
#: degC, s, and by how much each joint is warmer in the end, K.
AMBIENT, WARMING, TEMPERATURE_RISE = number("ambient_temperature"), number("warming_time"), numbers("temperature_rise")
#: ms that a cycle takes without a program and with one, on an e-Series.
EXECUTION_TIME = number("execution_time"), number("execution_time_of_a_program")
#: V, of the supply of each joint without a current; V/A, by which it falls; V, the steps in which it is measured.
JOINT_VOLTAGE = number("joint_voltage"), number("joint_voltage_drop"), number("voltage_step")


@dataclasses.dataclass(frozen=True, kw_only=True)
class SensorParameters:
    """How one arm measures.

    Attributes:
        lag: s by which the actual joints lag behind their targets.
        speed_lag: s, the same of the actual joint speeds.
        position_noise: rad, standard deviation from cycle to cycle.
        position_offset: rad, standard deviation from rest to rest of what a standing joint is off by.
        speed_noise: rad/s, of a moving joint.
        current_noise: A, of a moving joint.
        current_noise_at_rest: A.
        stiction: part of the Coulomb friction by which the actual current of a standing joint is off: a standard
            deviation, from rest to rest.
        voltage_noise: V.
        force_noise: N, at the TCP.
        torque_noise: Nm, at the TCP.
        force_offset: (6,) N and Nm at the TCP, of a sensor that was not zeroed.
        accelerometer_noise: m/s².
        accelerometer_bias: (3,) m/s², in the frame of the tool.

    Raises:
        BadValue: not that many finite numbers, or one that may not be negative is.
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
                raise BadValue(f"{field.name} must be a finite number of zero or more, not {value!r}")

    def like(self, arm: ArmFile) -> SensorParameters:
        """These, with what is known of one arm in their place."""
        named = {field.name: field.name for field in dataclasses.fields(self)} | {"lag": "tracking_lag"}
        known = {field: arm.known(name) for field, name in named.items()}
        changed = {field: max(value, 0.0) for field, value in known.items() if value is not None}
        return dataclasses.replace(self, **changed)  # type: ignore[arg-type]

    @classmethod
    def of(cls, model: Model) -> SensorParameters:
        """Those of a model, as far as they are known."""
        size = force_size(model.name)
        return cls(force_noise=number("force_noise", size), torque_noise=number("torque_noise", size))

"""Identification of an arm from a recording. The results are numbers with their intervals."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from urlink import BadValue
from urlink.arm import models
from urlink.arm.kinematics import DhTable
from urlink.tools import MOTORS, ArmFile, Estimate

from .calibration import fit_calibration
from .force_sensor import force_offset
from .joints import fit_joints
from .samples import Samples
from .tracking import clock_drift, noise, start_rate, tracking_lag

__all__ = ["identify"]


def identify(samples: Samples, model: str | None = None) -> ArmFile:
    """Identify the properties of an arm, as far as the samples are enough to find them.

    Args:
        samples: Samples of the recording.
        model: Name of the arm model; None for the model that the recording contains.

    Raises:
        BadValue: If the model is neither given nor recorded.
        UnknownModel: If no arm has this name.
    """
    name = model or samples.model
    if name is None:
        raise BadValue(f"{samples.path} does not contain the model of the arm; pass the model")
    arm = models.model(name)
    fitted = fit_joints(arm, samples.fitted)
    estimates: dict[str, Sequence[Estimate]] = {"payload": (fitted.payload,), "payload_cog": fitted.payload_cog}
    estimates |= {in_file: getattr(fitted, field) for field, in_file in MOTORS.items()}
    own = ArmFile(arm.name, estimates).motors
    estimates |= {"tracking_lag": (tracking_lag(samples),), "start_rate": (start_rate(samples),)}
    estimates |= {key: (each,) for key, each in noise(samples, np.array(own.coulomb)).items()}
    estimates |= force_offset(samples)
    estimates["clock_drift"] = (clock_drift(samples),)
    needs = "set-points of servoj in addition to the states: a stream whose set-points the program writes to registers"
    estimates["servoj_gain"] = estimates["servoj_delay"] = (Estimate.unknown(needs),)
    table: DhTable | None = None
    tcp: tuple[float, ...] | None = None
    if "target_TCP_pose" in samples and "target_q" not in samples.derived:
        try:
            found = fit_calibration(arm, samples["target_q"], samples["target_TCP_pose"])
        except BadValue as error:
            estimates["calibration"] = (Estimate.unknown(f"motion of every joint: {error}"),)
        else:
            table, tcp = found.table, tuple(found.tcp.tolist())
            estimates["calibration"] = (Estimate(found.rms, 0.0, found.rms),)
    estimates = {name: tuple(map(_with_width, each)) for name, each in estimates.items()}
    return ArmFile(arm.name, estimates, table, tcp, fitted.torque_r2, fitted.current_r2)


def _with_width(each: Estimate) -> Estimate:
    """Return an estimate, or an unknown one if its interval has no width: the columns were copied or are constant."""
    if each.is_known and not each.high > each.low:
        return Estimate.unknown("measured columns; these are constant or copied")
    return each

"""Arm files: the identified properties of one arm, for the simulator (`sim://ur5e?like=arm.json`).

The file is JSON. Each number has a value and the interval that contains it with a probability of 95 %. If the recording
was not enough to find a number, the file names the motion that is needed to find it, and the simulator uses the value
of the model.
"""

from __future__ import annotations

import dataclasses
import json
import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from linkcore.errors import BadValue, LocalError

from . import models
from .kinematics import DhTable
from .motors import Motors, motors_of

_KIND, _VERSION = "urlink arm", 1
#: Name in the file for each field of `Motors`.
MOTORS = {
    "rotor_inertias": "rotor_inertia",
    "torque_constants": "torque_constant",
    "coulomb": "coulomb_current",
    "viscous": "viscous_current",
}


@dataclasses.dataclass(frozen=True)
class Estimate:
    """Estimate of one number: its value and interval, or the motion that is needed to find them.

    Attributes:
        value: Value of the number; nan if unknown.
        low: Lower end of the interval that contains the number with a probability of 95 %. Assumes that the movements
            of the recording are typical of the arm.
        high: Upper end of this interval.
        needs: Motion that is needed to find the number; "" if the number is known.
    """

    value: float
    low: float
    high: float
    needs: str = ""

    @classmethod
    def unknown(cls, needs: str) -> Estimate:
        """Return the estimate of an unknown number; `needs` is the motion that is needed to find the number."""
        return cls(math.nan, math.nan, math.nan, needs)

    @property
    def is_known(self) -> bool:
        """Whether the recording was enough to find the number."""
        return not self.needs


@dataclasses.dataclass(frozen=True)
class ArmFile:
    """Identified properties of one arm.

    Attributes:
        model: Name of the arm model.
        estimates: Estimates, by the names that parameters have in `urlink.arm.parameters`. A parameter has one
            estimate, or one for each joint or axis.
        calibration: Calibrated DH table; None if the recording was not enough to find it.
        tcp: Pose of the TCP that was found together with the calibration, shape (6,); None without a calibration.
        torque_r2: Fraction of the variance of the torques that the model explains, shape (6,).
        current_r2: Fraction of the variance of the currents that the model explains, shape (6,).
    """

    model: str
    estimates: Mapping[str, Sequence[Estimate]]
    calibration: DhTable | None = None
    tcp: tuple[float, ...] | None = None
    torque_r2: tuple[float, ...] = ()
    current_r2: tuple[float, ...] = ()

    @property
    def motors(self) -> Motors:
        """Motors of the arm: the known values of this arm, and the values of its model for all others."""
        known = motors_of(self.model)
        changed = {
            field: tuple(
                each.value if each.is_known and each.value > 0.0 else other
                for each, other in zip(self.estimates[name], getattr(known, field), strict=True)
            )
            for field, name in MOTORS.items()
            if name in self.estimates
        }
        return dataclasses.replace(known, **changed)

    def known(self, name: str) -> float | None:
        """Return the value of a parameter with a single number; None if the value is unknown."""
        found = self.estimates.get(name, ())
        return found[0].value if len(found) == 1 and found[0].is_known else None

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write the properties to a file.

        Raises:
            LocalError: If the file cannot be written.
        """
        table = self.calibration
        text = {
            "kind": _KIND,
            "version": _VERSION,
            "model": self.model,
            "parameters": {name: [_plain(each) for each in found] for name, found in self.estimates.items()},
            "calibration": None if table is None else table._asdict() | {"tcp": self.tcp},
            "torque_r2": [_number(each) for each in self.torque_r2],
            "current_r2": [_number(each) for each in self.current_r2],
        }
        try:
            Path(path).write_text(json.dumps(text, indent=1, allow_nan=False) + "\n", encoding="utf-8")
        except OSError as error:
            raise LocalError(f"{path}: {error.strerror}") from None


def read_arm_file(path: str | os.PathLike[str]) -> ArmFile:
    """Read an arm file that `urlink identify` has written.

    Raises:
        BadValue: If the file does not exist or is not an arm file. The message names the invalid part.
    """
    try:
        found = json.loads(Path(path).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise BadValue(f"cannot read {path} as an arm file: {error}") from None
    if not isinstance(found, dict) or (found.get("kind"), found.get("version")) != (_KIND, _VERSION):
        raise BadValue(f"{path} is not an arm file; `urlink identify RECORDING --out {path}` writes one")
    try:
        name = models.model(found["model"]).name
        estimates = {str(key): tuple(map(_estimate, value)) for key, value in found["parameters"].items()}
        for key in MOTORS.values():
            if len(estimates.get(key, range(6))) != 6:
                raise BadValue(f"{key} has {len(estimates[key])} values; expected 6")
        table, tcp = None, None
        if found["calibration"] is not None:
            columns = {key: _six(found["calibration"][key], key) for key in (*DhTable._fields, "tcp")}
            tcp = columns.pop("tcp")
            table = DhTable(**columns)
        r2 = (tuple(math.nan if x is None else float(x) for x in found[key]) for key in ("torque_r2", "current_r2"))
        return ArmFile(name, estimates, table, tcp, *r2)
    except (KeyError, TypeError, ValueError) as error:
        said = f"no {error}" if isinstance(error, KeyError) else str(error)
        raise BadValue(f"the arm file {path} is invalid: {said}") from None


def _plain(each: Estimate) -> dict[str, Any]:
    if not each.is_known:
        return {"value": None, "needs": each.needs}
    return {"value": each.value, "low": each.low, "high": each.high}


def _estimate(found: Mapping[str, Any]) -> Estimate:
    if found["value"] is None:
        return Estimate.unknown(str(found["needs"]))
    value, low, high = (float(found[key]) for key in ("value", "low", "high"))
    if not all(map(math.isfinite, (value, low, high))):
        raise BadValue(f"{value!r} from {low!r} to {high!r} is not an estimate; expected finite numbers")
    return Estimate(value, low, high)


def _six(values: Any, name: str) -> tuple[float, ...]:
    numbers = tuple(map(float, values))
    if len(numbers) != 6 or not all(map(math.isfinite, numbers)):
        raise BadValue(f"{name} is {values!r}; expected six finite numbers")
    return numbers


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None

"""Arm files: the identified properties of one arm, for the simulator (`sim://ur5e?like=arm.json`).

The file is JSON. Each number has its value and the interval that holds it with 99 %; in place of what the recording
does not show stands the motion that would show it, and the simulator takes what is known of the model.
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
#: Field of `Motors` -> its name in the file.
MOTORS = {
    "rotor_inertias": "rotor_inertia",
    "torque_constants": "torque_constant",
    "coulomb": "coulomb_current",
    "viscous": "viscous_current",
}


#: Standard deviations to either side, within which 99 % of a normal distribution are.
SIDES = 2.576


@dataclasses.dataclass(frozen=True)
class Estimate:
    """One number, or nothing if the recording does not show it.

    Attributes:
        value: nan if it is not known.
        low, high: the interval that holds it with 99 %, if what the model leaves is noise.
        needs: the motion that would show it; "" if it is known.
    """

    value: float
    low: float
    high: float
    needs: str = ""

    @classmethod
    def around(cls, value: float, deviation: float) -> Estimate:
        """By its standard deviation."""
        return cls(value, value - SIDES * deviation, value + SIDES * deviation)

    @classmethod
    def unknown(cls, needs: str) -> Estimate:
        """Of what the recording does not show; `needs`: the motion that would."""
        return cls(math.nan, math.nan, math.nan, needs)

    @property
    def is_known(self) -> bool:
        """Whether the recording shows it."""
        return not self.needs


@dataclasses.dataclass(frozen=True)
class ArmFile:
    """What was identified of one arm.

    Attributes:
        model: name of the arm.
        estimates: name, as in `urlink.arm.parameters`, -> one estimate, or one for each joint or axis.
        calibration: the DH table; None if the recording does not show it.
        tcp: (6,) of the tool, with the calibration.
        torque_r2, current_r2: (6,) the part of the variance that the model explains.
    """

    model: str
    estimates: Mapping[str, Sequence[Estimate]]
    calibration: DhTable | None = None
    tcp: tuple[float, ...] | None = None
    torque_r2: tuple[float, ...] = ()
    current_r2: tuple[float, ...] = ()

    @property
    def motors(self) -> Motors:
        """Those of the model, with what is known of this arm in their place."""
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
        """The value of a parameter that is one number; None if it is not known."""
        found = self.estimates.get(name, ())
        return found[0].value if len(found) == 1 and found[0].is_known else None

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write the file.

        Raises:
            LocalError: it cannot be written.
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
    """Read what `urlink identify` has written.

    Raises:
        BadValue: no such file, or not one of these: the message says what of it.
    """
    try:
        found = json.loads(Path(path).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise BadValue(f"{path} cannot be read as an arm: {error}") from None
    if not isinstance(found, dict) or (found.get("kind"), found.get("version")) != (_KIND, _VERSION):
        raise BadValue(f"{path} is no arm that was identified; `urlink identify RECORDING --out {path}` writes one")
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
        raise BadValue(f"{path} is not a whole arm: {said}") from None


def _plain(each: Estimate) -> dict[str, Any]:
    if not each.is_known:
        return {"value": None, "needs": each.needs}
    return {"value": each.value, "low": each.low, "high": each.high}


def _estimate(found: Mapping[str, Any]) -> Estimate:
    if found["value"] is None:
        return Estimate.unknown(str(found["needs"]))
    value, low, high = (float(found[key]) for key in ("value", "low", "high"))
    if not all(map(math.isfinite, (value, low, high))):
        raise BadValue(f"{value!r} from {low!r} to {high!r} is no estimate")
    return Estimate(value, low, high)


def _six(values: Any, name: str) -> tuple[float, ...]:
    numbers = tuple(map(float, values))
    if len(numbers) != 6 or not all(map(math.isfinite, numbers)):
        raise BadValue(f"{name} must be six finite numbers, not {values!r}")
    return numbers


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None

"""Arm models: geometry, limits and masses that the vendor publishes for every model, from the table `arms.tsv`.

The sources of the numbers are:

- **DH rows**: the vendor's article "DH parameters for calculations of kinematics and dynamics". For UR15 and UR30: the
  `default_kinematics.yaml` of the vendor's ROS description (`ur_description`). The rows of UR5 and UR5e are also in the
  configuration packets of controllers. The factory calibration of a real arm differs from its row by up to a few
  millimetres. The controller sends this calibration in its kinematics packet.
- **Position and speed limits**: the user manuals, through `joint_limits.yaml` of `ur_description`. The narrower limits
  of the elbow in that file are not used, because they were chosen for motion planners and are not a property of the
  arm.
- **Link masses and centres of mass**: the same article. For UR15, UR18, UR30 and wrist 3 of UR20: the
  `physical_parameters.yaml` of `ur_description`. The masses of UR3e and UR5e explain the currents that simulated
  controllers report.
- **Inertias of the links**: the same `physical_parameters.yaml`, in `ur_description` 2.4.5 and later; see the comments
  in the table.
- **Joint torques**: the vendor's article "Max. joint torques" and `joint_limits.yaml`.
- **Payload and reach**: the vendor's data sheets. If the vendor has raised the payload of a model, the newest value is
  used.
- **Acceleration limits** are not published. The values are those that controllers report in their configuration packet:
  a CB2 UR5 for the CB arms, a simulated UR5e for the others. For all other models, they are an approximation.
- **UR7e and UR12e** have the lengths and masses of UR5e and UR10e. According to reports, they also have the same robot
  types, so packets do not show whether an arm is a UR5e or a UR7e, or whether it is a UR10e or a UR12e.
- **UR18 and UR8 Long**: the lengths are those in the package ur-analytic-ik (0.1.0.post3). UR8 Long has no
  `physical_parameters.yaml`. Its shoulder and wrists have the values of UR15, because `ur_description` draws them with
  the meshes of UR15. Its arm links have the values of the vendor's ur10g-1750, because `ur_description` draws that arm
  with the meshes of UR8 Long.

The attribute `guesses` of a model lists the values that are not published for this model. These values are taken from
another model.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Literal

import numpy as np

from linkcore.arguments import check_number
from linkcore.errors import BadValue, LocalError

from .vectors import JOINTS, FloatArray

__all__ = ["MODELS", "Model", "UnknownModel", "indistinguishable", "model", "model_of"]

_SHAPES: Mapping[str, tuple[int, ...]] = {
    "dh_a": (6,),
    "dh_d": (6,),
    "dh_alpha": (6,),
    "dh_theta": (6,),
    "position_limits": (6, 2),
    "max_speed": (6,),
    "max_acceleration": (6,),
    "link_masses": (6,),
    "link_cogs": (6, 3),
    "link_inertias": (6, 3, 3),
    "max_torque": (6,),
}

_HALF_PI = math.pi / 2.0
_ALPHA = np.array([_HALF_PI, 0.0, 0.0, _HALF_PI, -_HALF_PI, 0.0])
# Axis of each link in the DH frame at its end (0 is x, 1 is y, 2 is z), for inertias that are given as those of a
# cylinder. Arm links lie along x, the flange along z, and the other joints along y.
_AXES = (1, 0, 0, 1, 1, 2)


class UnknownModel(LocalError, ValueError):
    """Error: no arm in `MODELS` has this name."""

    __module__ = "urlink"  # users import the class from `urlink`, so tracebacks show this name


@dataclass(frozen=True, eq=False)
class Model:
    """One arm model with its nominal geometry. All arrays are read-only float64, joints from base to wrist 3.

    Two models are equal only if they are the same object. `MODELS` contains each model once.

    Attributes:
        name: Name that the vendor uses, such as `"UR5e"`.
        generation: Generation: `"CB"` (CB2 and CB3) or `"e"` (e-Series and later arms, up to UR30).
        robot_type: Number of the model in the configuration packet. A CB arm and its successors have the same number.
        dh_a: Link lengths, shape (6,), in m. The lengths of the two arm links are negative, as in the vendor's table.
        dh_d: Link offsets, shape (6,), in m.
        dh_alpha: Link twists, shape (6,), in rad.
        dh_theta: Joint offsets, shape (6,), in rad.
        position_limits: Lowest and highest positions, shape (6, 2), in rad; infinite for a joint that turns without
            limit. On the e-Series, a controller reports limits that are 3 degrees wider (its safety tolerance).
        max_speed: Maximum joint speeds, shape (6,), in rad/s. On the e-Series, a controller reports speeds that are
            0.2 rad/s higher (its safety tolerance).
        max_acceleration: Maximum joint accelerations, shape (6,), in rad/s². Not published; see the docstring of the
            module.
        payload: Maximum payload, in kg.
        reach: Reach according to the data sheet, in m.
        link_masses: Mass of the link after each joint, shape (6,), in kg. The base is not included, because it does not
            move.
        link_cogs: Centre of mass of each link in the DH frame at its end, shape (6, 3), in m.
        link_inertias: Inertia of each link about its centre of mass, along the axes of the DH frame at its end, shape
            (6, 3, 3), in kg m².
        max_torque: Maximum joint torques, shape (6,), in Nm.
        guesses: Names of the attributes that are not published for this model. Their values are taken from a similar
            model.

    Raises:
        BadValue: If an array has the wrong shape, or the DH rows are not those of a nominal UR arm. The closed-form
            kinematics require that a1, a4..a6, d2, d3 and all theta are zero, and that all twists are exactly 0 or ±90
            degrees.
    """

    name: str
    generation: Literal["CB", "e"]
    robot_type: int
    dh_a: FloatArray
    dh_d: FloatArray
    dh_alpha: FloatArray
    dh_theta: FloatArray
    position_limits: FloatArray
    max_speed: FloatArray
    max_acceleration: FloatArray
    payload: float
    reach: float
    link_masses: FloatArray
    link_cogs: FloatArray
    link_inertias: FloatArray
    max_torque: FloatArray
    guesses: frozenset[str] = frozenset()

    def __post_init__(self) -> None:
        for field, shape in _SHAPES.items():
            array = np.array(getattr(self, field), dtype=np.float64)
            if array.shape != shape:
                raise BadValue(f"{self.name}: {field} has the shape {array.shape}; expected {shape}")
            array.flags.writeable = False
            object.__setattr__(self, field, array)
        nominal = (
            not self.dh_theta.any()
            and not self.dh_a[[0, 3, 4, 5]].any()
            and not self.dh_d[[1, 2]].any()
            and bool((self.dh_alpha == _ALPHA).all())
        )
        if not nominal:
            raise BadValue(f"{self.name}: the DH rows are not those of a nominal UR arm; see the class Model")

    def check_joints(self, q: FloatArray) -> None:
        """Raise `BadValue` unless joint positions (6, rad) are within the position limits."""
        for joint, (value, (low, high)) in enumerate(zip(q.tolist(), self.position_limits.tolist(), strict=True)):
            check_number(value, f"q[{joint}] ({JOINTS[joint]})", low, high, "rad", f"a {self.name}")


def _arm(name: str, row: Mapping[str, str]) -> Model:
    a2, a3 = _numbers(row["a2 a3"])
    d1, d4, d5, d6 = _numbers(row["d1 d4 d5 d6"])
    shoulder, elbow, wrists = _numbers(row["torque"])  # base and shoulder have equal motors, and also the three wrists
    turn = 2.0 * math.pi
    limits = np.array([[-turn, turn]] * 6)
    if row.get("position_limits") == "endless wrist":
        limits[5] = -math.inf, math.inf
    is_cb = row["generation"] == "CB"
    unpublished = () if name in ("UR5", "UR5e") else ("max_acceleration",)
    return Model(
        name=name,
        generation="CB" if is_cb else "e",
        robot_type=int(row["robot_type"]),
        dh_a=np.array([0.0, a2, a3, 0.0, 0.0, 0.0]),
        dh_d=np.array([d1, 0.0, 0.0, d4, d5, d6]),
        dh_alpha=_ALPHA,
        dh_theta=np.zeros(6),
        position_limits=limits,
        max_speed=np.radians(_numbers(row["speed"])),
        max_acceleration=np.array([15.0] * 3 + [25.0] * 3 if is_cb else [40.0] * 6),
        payload=float(row["payload"]),
        reach=float(row["reach"]),
        link_masses=np.array(_numbers(row["masses"])),
        link_cogs=np.array([_numbers(link) for link in row["cogs"].split(",")]),
        link_inertias=np.array(
            [_tensor(_numbers(link), axis) for link, axis in zip(row["inertias"].split(","), _AXES, strict=True)]
        ),
        max_torque=np.array([shoulder] * 2 + [elbow] + [wrists] * 3),
        guesses=frozenset((*unpublished, *row.get("guesses", "").split())),
    )


def _numbers(text: str) -> list[float]:
    return [float(each) for each in text.split()]


def _tensor(numbers: Sequence[float], axis: int) -> FloatArray:
    """Return a (3, 3) tensor from ixx, ixy, ixz, iyy, iyz, izz, or from the two inertias of a cylinder.

    The two inertias of a cylinder are the inertia about an axis across the cylinder, and the inertia about its own
    axis.
    """
    if len(numbers) == 2:
        return np.diag([numbers[each == axis] for each in range(3)])
    xx, xy, xz, yy, yz, zz = numbers
    return np.array([(xx, xy, xz), (xy, yy, yz), (xz, yz, zz)])


def _read_arms() -> Iterator[Model]:
    """Yield the arms of the table.

    Lines that begin with # are comments. A value "as UR5" means the value of the UR5.
    """
    arms: dict[str, dict[str, str]] = {}
    for line in Path(__file__).with_name("arms.tsv").read_text(encoding="utf-8").splitlines()[1:]:
        if not line.startswith("#"):
            name, quantity, _, value = line.split("\t")
            is_other = value.startswith("as ")
            arms.setdefault(name, {})[quantity] = arms[value[3:]][quantity] if is_other else value
    return (_arm(name, row) for name, row in arms.items())


#: All known arms. The keys are the names that the vendor uses.
MODELS: Mapping[str, Model] = MappingProxyType({arm.name: arm for arm in _read_arms()})

_BY_FOLDED_NAME = {
    spelling: arm for name, arm in MODELS.items() for spelling in (name.casefold(), name.casefold().replace(" ", ""))
}
# First arm with each robot type. UR7e and UR12e are not included, because they report the numbers of UR5e and UR10e.
_BY_ROBOT_TYPE = {(arm.robot_type, arm.generation): arm for arm in reversed(list(MODELS.values()))}


def model(name: str) -> Model:
    """Return the model with this name, in upper or lower case. The space in "UR8 Long" is optional.

    Raises:
        UnknownModel: If no arm has this name. The message lists the known arms.

    >>> model("ur5e").name, model("UR10").generation
    ('UR5e', 'CB')
    """
    try:
        return _BY_FOLDED_NAME[name.casefold()]
    except (AttributeError, KeyError):  # not a string, or an unknown name
        raise UnknownModel(f"no arm is called {name!r}; expected one of {', '.join(MODELS)}") from None


def model_of(robot_type: int, e_series: bool) -> Model | None:
    """Return the model with a robot type (from a configuration packet), for a generation of controllers.

    The result is None if the number belongs to no known arm, or to an arm that was never made in this generation. UR7e
    and UR12e report the numbers of UR5e and UR10e, so for these arms the result is UR5e or UR10e.

    Args:
        robot_type: Number in the configuration packet.
        e_series: Whether the software of the controller is version 5 or later.

    >>> model_of(1, e_series=False).name, model_of(1, e_series=True).name
    ('UR5', 'UR5e')
    >>> model_of(4, e_series=False) is None
    True
    """
    return _BY_ROBOT_TYPE.get((robot_type, "e" if e_series else "CB"))


def indistinguishable(arm: Model) -> tuple[Model, ...]:
    """Return all arms that report the same robot type as `arm`, including `arm`; for example UR5e and UR7e.

    >>> [each.name for each in indistinguishable(model("UR5e"))]
    ['UR5e', 'UR7e']
    """
    key = (arm.robot_type, arm.generation)
    return tuple(each for each in MODELS.values() if (each.robot_type, each.generation) == key)

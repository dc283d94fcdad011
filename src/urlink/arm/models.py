"""The arms: geometry, limits and masses of every model, as the vendor publishes them, in the table `arms.tsv`.

Which figure comes from where:

- **DH rows**: the vendor's article "DH parameters for calculations of kinematics and dynamics"; for UR15 and
  UR30 the `default_kinematics.yaml` of the vendor's ROS description (`ur_description`). The rows of UR5 and
  UR5e also stand in the configuration packets of controllers. A real arm differs from its row by a factory
  calibration of up to a few millimetres, which it sends in its kinematics packet.
- **Position and speed limits**: the user manuals, through `joint_limits.yaml` of `ur_description`, without
  that file's narrower elbow, which is a planner's choice and not a property of the arm.
- **Link masses and centres of mass**: the same article; for UR15, UR18, UR30 and wrist 3 of UR20 the
  `physical_parameters.yaml` of `ur_description`. Those of UR3e and UR5e explain the currents that simulated controllers
  report.
- **Inertias of the links**: the same file of `ur_description`, 2.4.5 and later; see the comments of the table.
- **Joint torques**: the vendor's article "Max. joint torques" and `joint_limits.yaml`.
- **Payload and reach**: the vendor's data sheets. Where a payload was raised during a model's life, it is the
  newest.
- **Acceleration limits** are not published. The figures are what controllers report in their configuration
  packet: a CB2 UR5 for the CB arms, a simulated UR5e for the others. For any model but those two they are an
  approximation.
- **UR7e and UR12e** have the lengths and masses of UR5e and UR10e. They are reported to have the robot types of those,
  so an arm cannot be distinguished from its successor by what it sends.
- **UR18 and UR8 Long**: the lengths are those that the package ur-analytic-ik (0.1.0.post3) computes with. UR8 Long
  has no `physical_parameters.yaml`: shoulder and wrists are those of UR15, whose meshes it is drawn with, and the arm
  links are those of the vendor's ur10g-1750, which is drawn with the meshes of UR8 Long.

What is not published for a model but taken over from another one stands in its `guesses`.
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
# The axis of each link's cylinder in the DH frame at its end: the arm links lie along x, the other joints along y, and
# the flange along z.
_AXES = (1, 0, 0, 1, 1, 2)


class UnknownModel(LocalError, ValueError):
    """A name that no arm in `MODELS` has."""

    __module__ = "urlink"  # where users import it from, and what a traceback shows


@dataclass(frozen=True, eq=False)
class Model:
    """One arm model in its nominal geometry. All arrays are read-only float64, joints from base to wrist 3.

    Two models are equal only if they are the same object: the table below holds each once.

    Attributes:
        name: as the vendor writes it, such as `"UR5e"`.
        generation: `"CB"` (CB2 and CB3) or `"e"` (e-Series and the arms that came after it, up to UR30).
        robot_type: the number in the configuration packet; a CB arm and its successors share it.
        dh_a: (6,) link lengths, m. The arm lengths are negative, as the vendor writes them.
        dh_d: (6,) link offsets, m.
        dh_alpha: (6,) link twists, rad.
        dh_theta: (6,) joint offsets, rad.
        position_limits: (6, 2) lowest and highest position, rad; infinite where the joint turns without end.
            What a controller reports is 3 degrees wider on the e-Series (its safety tolerance).
        max_speed: (6,) rad/s. What a controller reports is 0.2 rad/s higher on the e-Series (its safety
            tolerance).
        max_acceleration: (6,) rad/s². Not published; see the module's text.
        payload: largest payload, kg.
        reach: as on the data sheet, m.
        link_masses: (6,) mass of the link behind each joint, kg; the base does not move and is left out.
        link_cogs: (6, 3) its centre of mass in the DH frame at the end of the link, m.
        link_inertias: (6, 3, 3) its inertia about the centre of mass along the axes of that frame, kg m².
        max_torque: (6,) Nm.
        guesses: names of those of these attributes that are not known of this model, but of one that is like it.

    Raises:
        BadValue: an array has the wrong shape, or the DH rows are not those of a nominal UR arm (a1, a4..a6,
            d2, d3 and all theta zero, twists of exactly 0 or ±90 degrees), on which the closed-form
            kinematics rest.
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
                raise BadValue(f"{self.name}: {field} must have shape {shape}, not {array.shape}")
            array.flags.writeable = False
            object.__setattr__(self, field, array)
        nominal = (
            not self.dh_theta.any()
            and not self.dh_a[[0, 3, 4, 5]].any()
            and not self.dh_d[[1, 2]].any()
            and bool((self.dh_alpha == _ALPHA).all())
        )
        if not nominal:
            raise BadValue(f"{self.name}: the DH rows are not those of a nominal UR arm")

    def check_joints(self, q: FloatArray) -> None:
        """Raise `BadValue` unless joint positions (6, rad) are within the position limits."""
        for joint, (value, (low, high)) in enumerate(zip(q.tolist(), self.position_limits.tolist(), strict=True)):
            check_number(value, f"q[{joint}] ({JOINTS[joint]})", low, high, "rad", f"a {self.name}")


def _arm(name: str, row: Mapping[str, str]) -> Model:
    a2, a3 = _numbers(row["a2 a3"])
    d1, d4, d5, d6 = _numbers(row["d1 d4 d5 d6"])
    shoulder, elbow, wrists = _numbers(row["torque"])  # base and shoulder have motors of one size, as have the wrists
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
    """(3, 3) out of ixx, ixy, ixz, iyy, iyz, izz; or, of a cylinder, of those across its axis and about it."""
    if len(numbers) == 2:
        return np.diag([numbers[each == axis] for each in range(3)])
    xx, xy, xz, yy, yz, zz = numbers
    return np.array([(xx, xy, xz), (xy, yy, yz), (xz, yz, zz)])


def _read_arms() -> Iterator[Model]:
    """The arms of the table. What begins with # is a comment; "as UR5" stands for the value of the UR5."""
    arms: dict[str, dict[str, str]] = {}
    for line in Path(__file__).with_name("arms.tsv").read_text(encoding="utf-8").splitlines()[1:]:
        if not line.startswith("#"):
            name, quantity, _, value = line.split("\t")
            is_other = value.startswith("as ")
            arms.setdefault(name, {})[quantity] = arms[value[3:]][quantity] if is_other else value
    return (_arm(name, row) for name, row in arms.items())


#: Every arm that is known, by the name the vendor gives it.
MODELS: Mapping[str, Model] = MappingProxyType({arm.name: arm for arm in _read_arms()})

_BY_FOLDED_NAME = {
    spelling: arm for name, arm in MODELS.items() for spelling in (name.casefold(), name.casefold().replace(" ", ""))
}
# The arm that a number was first given to: UR7e and UR12e report those of UR5e and UR10e.
_BY_ROBOT_TYPE = {(arm.robot_type, arm.generation): arm for arm in reversed(list(MODELS.values()))}


def model(name: str) -> Model:
    """The arm called `name`, in upper or lower case; the space in "UR8 Long" may be left out.

    Raises:
        UnknownModel: no arm is called that; the message lists those that are.

    >>> model("ur5e").name, model("UR10").generation
    ('UR5e', 'CB')
    """
    try:
        return _BY_FOLDED_NAME[name.casefold()]
    except (AttributeError, KeyError):  # not a text, or not one of these
        raise UnknownModel(f"no arm is called {name!r}; known are {', '.join(MODELS)}") from None


def model_of(robot_type: int, e_series: bool) -> Model | None:
    """The arm of a robot type (from a configuration packet) on a controller with software 5 or later, or not.

    None for a number that stands for no known arm, or for one that was never made in that generation. UR7e and UR12e
    report the numbers of UR5e and UR10e and are taken for these.

    >>> model_of(1, e_series=False).name, model_of(1, e_series=True).name, model_of(4, e_series=False)
    ('UR5', 'UR5e', None)
    """
    return _BY_ROBOT_TYPE.get((robot_type, "e" if e_series else "CB"))


def indistinguishable(arm: Model) -> tuple[Model, ...]:
    """The arms that report the same robot type as `arm`, itself among them: a UR7e is taken for a UR5e.

    >>> [each.name for each in indistinguishable(model("UR5e"))]
    ['UR5e', 'UR7e']
    """
    key = (arm.robot_type, arm.generation)
    return tuple(each for each in MODELS.values() if (each.robot_type, each.generation) == key)

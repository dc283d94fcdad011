"""The arms: geometry, limits and masses of every model, as the vendor publishes them.

Which figure comes from where:

- **DH rows**: the vendor's article "DH parameters for calculations of kinematics and dynamics"; for UR15 and
  UR30 the `default_kinematics.yaml` of the vendor's ROS description (`ur_description`). The rows of UR5 and
  UR5e also stand in the configuration packets of controllers. A real arm differs from its row by a factory
  calibration of up to a few millimetres, which it sends in its kinematics packet.
- **Position and speed limits**: the user manuals, by way of `joint_limits.yaml` of `ur_description`, without
  that file's narrower elbow, which is a planner's choice and not a property of the arm.
- **Link masses and centres of mass**: the same article; for UR15, UR18, UR30 and wrist 3 of UR20 the
  `physical_parameters.yaml` of `ur_description`. Those of UR3e and UR5e explain the currents that simulated controllers
  report. Inertias: see `urlink.inertias`.
- **Joint torques**: the vendor's article "Max. joint torques" and `joint_limits.yaml`.
- **Payload and reach**: the vendor's data sheets. Where a payload was raised during a model's life, it is the
  newest.
- **Acceleration limits** are not published. The figures are what controllers report in their configuration
  packet: a CB2 UR5 for the CB arms, a simulated UR5e for the others. For any model but those two they are an
  approximation.
- **UR7e and UR12e** have the lengths and masses of UR5e and UR10e. They are said to report the robot types of those,
  so an arm cannot be told from its successor by what it sends.
- **UR18 and UR8 Long**: the lengths are those that the package ur-analytic-ik (0.1.0.post3) computes with. UR8 Long
  has no `physical_parameters.yaml`: shoulder and wrists are those of UR15, whose meshes it is drawn with, and the arm
  links are those of the vendor's ur10g-1750, which is drawn with the meshes of UR8 Long.

What is not published for a model but taken over from another one stands in its `guesses`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from linkcore.arguments import check_number
from linkcore.errors import BadValue, LocalError

from .inertias import INERTIAS
from .vectors import JOINTS

__all__ = ["MODELS", "Model", "UnknownModel", "indistinguishable", "model", "model_of"]

FloatArray = NDArray[np.float64]

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


def _arm(
    name: str,
    generation: Literal["CB", "e"],
    robot_type: int,
    *,
    a: tuple[float, float],
    d: tuple[float, float, float, float],
    speed: tuple[float, float, float, float, float, float],
    payload: float,
    reach: float,
    masses: Sequence[float],
    cogs: Sequence[tuple[float, float, float]],
    torque: tuple[float, float, float],
    endless_wrist: bool = False,
    guesses: tuple[str, ...] = (),
) -> Model:
    """A `Model` from the lengths that tell arms apart: a2, a3 and d1, d4, d5, d6 in m.

    `speed` is in deg/s, `torque` in Nm: of base and shoulder, of the elbow, of the wrists.
    """
    turn = 2.0 * math.pi
    limits = np.array([[-turn, turn]] * 6)
    if endless_wrist:
        limits[5] = -math.inf, math.inf
    return Model(
        name=name,
        generation=generation,
        robot_type=robot_type,
        dh_a=np.array([0.0, a[0], a[1], 0.0, 0.0, 0.0]),
        dh_d=np.array([d[0], 0.0, 0.0, d[1], d[2], d[3]]),
        dh_alpha=_ALPHA,
        dh_theta=np.zeros(6),
        position_limits=limits,
        max_speed=np.radians(speed),
        max_acceleration=np.array([15.0] * 3 + [25.0] * 3 if generation == "CB" else [40.0] * 6),
        payload=payload,
        reach=reach,
        link_masses=np.array(masses),
        link_cogs=np.array(cogs),
        link_inertias=INERTIAS[name],
        max_torque=np.array([torque[0]] * 2 + [torque[1]] + [torque[2]] * 3),
        guesses=frozenset(guesses) if name in ("UR5", "UR5e") else frozenset({"max_acceleration", *guesses}),
    )


_UR3_COGS = [
    (0.0, -0.02, 0.0),
    (0.13, 0.0, 0.1157),
    (0.05, 0.0, 0.0238),
    (0.0, 0.0, 0.01),
    (0.0, 0.0, 0.01),
    (0.0, 0.0, -0.02),
]
# Public copies of the vendor's table disagree on the sign of y of link 5 of the UR5. Plus is what the article
# has for the UR5e and `ur_description` for both, and what the currents of a simulated UR5e follow.
_UR5_COGS = [
    (0.0, -0.02561, 0.00193),
    (0.2125, 0.0, 0.11336),
    (0.15, 0.0, 0.0265),
    (0.0, -0.0018, 0.01634),
    (0.0, 0.0018, 0.01634),
    (0.0, 0.0, -0.001159),
]
_UR10_COGS = [
    (0.021, 0.0, 0.027),
    (0.38, 0.0, 0.158),
    (0.24, 0.0, 0.068),
    (0.0, 0.007, 0.018),
    (0.0, 0.007, 0.018),
    (0.0, 0.0, -0.026),
]

_UR15_COGS = [
    (0.000024, -0.033309, 0.025304),
    (0.419009, -0.000083, 0.192787),
    (0.305471, 0.000019, 0.070552),
    (0.000025, -0.019695, 0.016413),
    (0.000025, 0.01996, 0.015886),
    (-0.000018, -0.000112, -0.053397),
]

#: Every arm that is known, by the name the vendor gives it.
MODELS: Mapping[str, Model] = MappingProxyType(
    {
        arm.name: arm
        for arm in (
            _arm(
                "UR3",
                "CB",
                3,
                a=(-0.24365, -0.21325),
                d=(0.1519, 0.11235, 0.08535, 0.0819),
                speed=(180, 180, 180, 360, 360, 360),
                payload=3.0,
                reach=0.5,
                torque=(56, 28, 12),
                masses=(2.0, 3.42, 1.26, 0.8, 0.8, 0.35),
                cogs=_UR3_COGS,
                endless_wrist=True,
            ),
            # The last of three series, as the CB3 manual calls them; the first two differ by up to 1.7 mm.
            _arm(
                "UR5",
                "CB",
                1,
                a=(-0.425, -0.39225),
                d=(0.089159, 0.10915, 0.09465, 0.0823),
                speed=(180, 180, 180, 180, 180, 180),
                payload=5.0,
                reach=0.85,
                torque=(150, 150, 28),
                masses=(3.7, 8.393, 2.33, 1.219, 1.219, 0.1879),
                cogs=_UR5_COGS,
            ),
            _arm(
                "UR10",
                "CB",
                2,
                a=(-0.612, -0.5723),
                d=(0.1273, 0.163941, 0.1157, 0.0922),
                speed=(120, 120, 180, 180, 180, 180),
                payload=10.0,
                reach=1.3,
                torque=(330, 150, 56),
                masses=(7.1, 12.7, 4.27, 2.0, 2.0, 0.365),
                cogs=_UR10_COGS,
            ),
            _arm(
                "UR3e",
                "e",
                3,
                a=(-0.24355, -0.2132),
                d=(0.15185, 0.13105, 0.08535, 0.0921),
                speed=(180, 180, 180, 360, 360, 360),
                payload=3.0,
                reach=0.5,
                torque=(54, 28, 9),
                masses=(1.98, 3.4445, 1.437, 0.871, 0.805, 0.261),
                cogs=_UR3_COGS,
                endless_wrist=True,
            ),
            _arm(
                "UR5e",
                "e",
                1,
                a=(-0.425, -0.3922),
                d=(0.1625, 0.1333, 0.0997, 0.0996),
                speed=(180, 180, 180, 180, 180, 180),
                payload=5.0,
                reach=0.85,
                torque=(150, 150, 28),
                masses=(3.761, 8.058, 2.846, 1.37, 1.3, 0.365),
                cogs=_UR5_COGS,
            ),
            _arm(
                "UR7e",
                "e",
                1,
                a=(-0.425, -0.3922),
                d=(0.1625, 0.1333, 0.0997, 0.0996),
                speed=(180, 180, 180, 180, 180, 180),
                payload=7.5,
                reach=0.85,
                torque=(150, 150, 28),
                guesses=("max_speed", "max_torque"),
                masses=(3.761, 8.058, 2.846, 1.37, 1.3, 0.365),
                cogs=_UR5_COGS,
            ),
            _arm(
                "UR10e",
                "e",
                2,
                a=(-0.6127, -0.57155),
                d=(0.1807, 0.17415, 0.11985, 0.11655),
                speed=(120, 120, 180, 180, 180, 180),
                payload=12.5,
                reach=1.3,
                torque=(330, 150, 54),
                masses=(7.369, 13.051, 3.989, 2.1, 1.98, 0.615),
                cogs=_UR10_COGS,
            ),
            _arm(
                "UR12e",
                "e",
                2,
                a=(-0.6127, -0.57155),
                d=(0.1807, 0.17415, 0.11985, 0.11655),
                speed=(120, 120, 180, 180, 180, 180),
                payload=12.5,
                reach=1.3,
                torque=(330, 150, 54),
                masses=(7.369, 13.051, 3.989, 2.1, 1.98, 0.615),
                cogs=_UR10_COGS,
            ),
            _arm(
                "UR16e",
                "e",
                4,
                a=(-0.4784, -0.36),
                d=(0.1807, 0.17415, 0.11985, 0.11655),
                speed=(120, 120, 180, 180, 180, 180),
                payload=16.0,
                reach=0.9,
                torque=(330, 150, 54),
                masses=(7.369, 10.45, 4.321, 2.18, 2.033, 0.907),
                cogs=[
                    (0.0, -0.016, 0.03),
                    (0.302, 0.0, 0.16),
                    (0.194, 0.0, 0.065),
                    (0.0, -0.009, 0.011),
                    (0.0, 0.018, 0.012),
                    (0.0, 0.0, -0.044),
                ],
            ),
            _arm(
                "UR8 Long",
                "e",
                6,
                a=(-0.8989, -0.7149),
                d=(0.2186, 0.1824, 0.1361, 0.1434),
                speed=(180, 180, 240, 300, 300, 300),
                payload=8.0,
                reach=1.75,
                torque=(433, 204, 70),
                guesses=("max_speed", "max_torque", "link_masses", "link_cogs", "link_inertias"),
                masses=(9.9883, 17.0738, 7.6393, 2.089, 2.0869, 1.0666),
                cogs=[
                    _UR15_COGS[0],
                    (0.565429, -0.000074, 0.19542),
                    (0.416102, 0.000058, 0.065663),
                    *_UR15_COGS[3:],
                ],
            ),
            _arm(
                "UR15",
                "e",
                9,
                a=(-0.6475, -0.5164),
                d=(0.2186, 0.1824, 0.1361, 0.1434),
                speed=(180, 180, 240, 300, 300, 300),
                payload=17.5,
                reach=1.3,
                torque=(433, 204, 70),
                guesses=("max_torque",),
                masses=(9.9883, 14.9255, 6.1015, 2.089, 2.0869, 1.0666),
                cogs=_UR15_COGS,
            ),
            _arm(
                "UR18",
                "e",
                5,
                a=(-0.475, -0.3389),
                d=(0.2186, 0.1824, 0.1361, 0.1434),
                speed=(180, 180, 240, 300, 300, 300),
                payload=18.0,
                reach=0.95,
                torque=(433, 204, 70),
                masses=(9.9883, 14.2009, 5.52, 2.089, 2.0869, 1.0666),
                cogs=[
                    _UR15_COGS[0],
                    (0.308664, -0.000088, 0.190204),
                    (0.199652, 0.000021, 0.073101),
                    *_UR15_COGS[3:],
                ],
            ),
            _arm(
                "UR20",
                "e",
                7,
                a=(-0.862, -0.7287),
                d=(0.2363, 0.201, 0.1593, 0.1543),
                speed=(120, 120, 150, 210, 210, 210),
                payload=25.0,
                reach=1.75,
                torque=(738, 433, 107),
                masses=(16.343, 29.632, 7.879, 3.054, 3.126, 0.926),
                cogs=[
                    (0.0, -0.061, 0.0062),
                    (0.5226, 0.0, 0.2098),
                    (0.3234, 0.0, 0.0604),
                    (0.0, -0.0026, 0.0393),
                    (0.0, 0.0024, 0.0379),
                    (0.0, 0.0, -0.0293),
                ],
            ),
            _arm(
                "UR30",
                "e",
                8,
                a=(-0.637, -0.5037),
                d=(0.2363, 0.201, 0.1593, 0.1543),
                speed=(120, 120, 150, 210, 210, 210),
                payload=35.0,
                reach=1.3,
                torque=(738, 433, 107),
                guesses=("link_inertias",),
                masses=(16.343, 28.542, 7.156, 3.054, 3.126, 0.926),
                cogs=[
                    (-0.0001, -0.06, 0.0069),
                    (0.3894, 0.0, 0.2103),
                    (0.2257, 0.0, 0.0629),
                    (0.0, -0.0048, 0.0353),
                    (0.0, 0.0046, 0.0341),
                    (0.0, 0.0, -0.0293),
                ],
            ),
        )
    }
)

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
    except KeyError:
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

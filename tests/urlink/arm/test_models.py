"""The table of arms compared with itself, with data sheets, and with data that controllers send about their arm."""

from __future__ import annotations

import math
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from linkcore.errors import BadValue, LocalError
from tests.urlink.arm.arms import Table
from urlink.arm.kinematics import Arm
from urlink.arm.models import MODELS, Model, UnknownModel, model, model_of

EVERY = pytest.mark.parametrize("arm", MODELS.values(), ids=MODELS.keys())

# Weight of the whole arm in kg, from its data sheet; None if it is not known here. The link masses do not include the
# fixed base.
WEIGHTS: dict[str, float | None] = {
    "UR3": 11.0,
    "UR5": 18.4,
    "UR10": 28.9,
    "UR3e": 11.2,
    "UR5e": 20.6,
    "UR7e": 20.6,
    "UR10e": 33.5,
    "UR12e": 33.5,
    "UR16e": 33.1,
    "UR8 Long": None,
    "UR15": 40.7,
    "UR18": None,
    "UR20": 64.0,
    "UR30": 63.5,
}


def test_model_table_contains_every_arm_by_name() -> None:
    assert list(MODELS) == list(WEIGHTS)
    assert all(arm.name == name for name, arm in MODELS.items())
    with pytest.raises(TypeError):
        MODELS["UR1"] = MODELS["UR5"]  # type: ignore[index]


@EVERY
def test_arrays_are_read_only_float64(arm: Model) -> None:
    arrays = {name: value for name, value in vars(arm).items() if isinstance(value, np.ndarray)}
    assert {name: value.shape for name, value in arrays.items()} == {
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
    for value in arrays.values():
        assert value.dtype == np.float64
        with pytest.raises(ValueError, match="read-only"):
            value[0] = 0.0


# Lengths in mm, entered a second time, in the order and from the view of the joint origins in `ur_description`:
# shoulder z, forearm x, wrist 1 x, wrist 1 z, wrist 2 -y, wrist 3 y. They detect accidental changes of the table.
ORIGINS = {
    "UR3": (151.9, -243.65, -213.25, 112.35, 85.35, 81.9),
    "UR5": (89.159, -425.0, -392.25, 109.15, 94.65, 82.3),
    "UR10": (127.3, -612.0, -572.3, 163.941, 115.7, 92.2),
    "UR3e": (151.85, -243.55, -213.2, 131.05, 85.35, 92.1),
    "UR5e": (162.5, -425.0, -392.2, 133.3, 99.7, 99.6),
    "UR7e": (162.5, -425.0, -392.2, 133.3, 99.7, 99.6),
    "UR10e": (180.7, -612.7, -571.55, 174.15, 119.85, 116.55),
    "UR12e": (180.7, -612.7, -571.55, 174.15, 119.85, 116.55),
    "UR16e": (180.7, -478.4, -360.0, 174.15, 119.85, 116.55),
    "UR8 Long": (218.6, -898.9, -714.9, 182.4, 136.1, 143.4),
    "UR15": (218.6, -647.5, -516.4, 182.4, 136.1, 143.4),
    "UR18": (218.6, -475.0, -338.9, 182.4, 136.1, 143.4),
    "UR20": (236.3, -862.0, -728.7, 201.0, 159.3, 154.3),
    "UR30": (236.3, -637.0, -503.7, 201.0, 159.3, 154.3),
}


@EVERY
def test_lengths_match_joint_origins(arm: Model) -> None:
    ours = [arm.dh_d[0], arm.dh_a[1], arm.dh_a[2], *arm.dh_d[3:]]
    np.testing.assert_allclose(ours, np.array(ORIGINS[arm.name]) / 1000.0, rtol=0.0, atol=1e-12)


@EVERY
def test_reach_is_between_stretched_arm_and_wrist(arm: Model) -> None:
    stretched = -arm.dh_a.sum()
    # Data sheets round to a centimetre.
    assert stretched < arm.reach < stretched + arm.dh_d[4] + 1e-3


@EVERY
def test_link_masses_add_up_to_most_of_the_arm_weight(arm: Model) -> None:
    weight = WEIGHTS[arm.name]
    if weight is None:
        pytest.skip(f"the weight of a {arm.name} is not known here")
    assert 0.75 * weight < arm.link_masses.sum() < weight


@EVERY
def test_centre_of_mass_is_inside_link(arm: Model) -> None:
    lengths = np.abs(arm.dh_a) + np.abs(arm.dh_d)
    # Shoulder and elbow housings extend to the side by less than 25 cm on the largest arm.
    assert (np.linalg.norm(arm.link_cogs, axis=1) < lengths + 0.25).all()
    # The frame of an arm link is at its end, and the centre of mass is behind it.
    assert (arm.link_cogs[1:3, 0] > 0.0).all()
    assert (arm.link_cogs[1:3, 0] < -arm.dh_a[1:3]).all()


@EVERY
def test_joint_limits_are_full_turns_and_round_speeds(arm: Model) -> None:
    assert (arm.position_limits[:, 0] == -arm.position_limits[:, 1]).all()
    assert (arm.position_limits[:5, 1] == 2.0 * math.pi).all()
    assert math.isinf(arm.position_limits[5, 1]) == arm.name.startswith("UR3") & (arm.name != "UR30")
    degrees = np.degrees(arm.max_speed)
    assert set(np.round(degrees, 9)) <= {120.0, 150.0, 180.0, 210.0, 240.0, 300.0, 360.0}


@EVERY
def test_inertias_are_physically_possible(arm: Model) -> None:
    for tensor in arm.link_inertias:
        np.testing.assert_array_equal(tensor, tensor.T)
        small, middle, large = np.linalg.eigvalsh(tensor)
        # For any distribution of mass, no principal moment is larger than the other two together.
        assert small > 0.0
        assert large <= (small + middle) * (1.0 + 1e-9)


@EVERY
def test_guesses_contain_only_attribute_names(arm: Model) -> None:
    assert arm.guesses <= set(vars(arm))
    # The accelerations that controllers report are known for two arms.
    assert ("max_acceleration" in arm.guesses) == (arm.name not in ("UR5", "UR5e"))


def test_successors_share_lengths_and_masses() -> None:
    for new, old in (("UR7e", "UR5e"), ("UR12e", "UR10e")):
        for field in ("dh_a", "dh_d", "link_masses", "link_cogs", "link_inertias"):
            np.testing.assert_array_equal(getattr(MODELS[new], field), getattr(MODELS[old], field))


@pytest.mark.parametrize("spelling", ["UR8 Long", "ur8 long", "ur8long"])
def test_space_in_name_is_optional(spelling: str) -> None:
    assert model(spelling) is MODELS["UR8 Long"]


@pytest.mark.parametrize("spelling", ["UR5e", "ur5e", "UR5E", "uR5e"])
def test_lookup_ignores_case(spelling: str) -> None:
    assert model(spelling) is MODELS["UR5e"]


@pytest.mark.parametrize("name", ["UR6", "", "UR5 e", "ur", 5, None, b"UR5", ["UR5"]])
def test_unknown_name_error_lists_known_names(name: Any) -> None:
    with pytest.raises(UnknownModel) as failure:
        model(name)
    assert isinstance(failure.value, LocalError)
    assert isinstance(failure.value, ValueError)
    assert repr(name) in str(failure.value)
    assert all(known in str(failure.value) for known in MODELS)


@pytest.mark.parametrize(
    ("robot_type", "cb", "e"),
    [
        (1, "UR5", "UR5e"),
        (2, "UR10", "UR10e"),
        (3, "UR3", "UR3e"),
        (4, None, "UR16e"),
        (5, None, "UR18"),
        (6, None, "UR8 Long"),
        (7, None, "UR20"),
        (8, None, "UR30"),
        (9, None, "UR15"),
        (0, None, None),
        (-1, None, None),
    ],
)
def test_robot_type_and_generation_identify_arm(robot_type: int, cb: str | None, e: str | None) -> None:
    assert model_of(robot_type, e_series=False) is (None if cb is None else MODELS[cb])
    assert model_of(robot_type, e_series=True) is (None if e is None else MODELS[e])


def test_models_are_equal_only_to_themselves() -> None:
    assert len(set(MODELS.values())) == len(MODELS)
    assert MODELS["UR5"] != MODELS["UR5e"]


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("dh_a", np.zeros(5)),
        ("link_cogs", np.zeros((6, 2))),
        ("dh_theta", np.array([0.0, 0.0, 1e-4, 0.0, 0.0, 0.0])),
        ("dh_a", np.array([1e-5, -0.425, -0.3922, 0.0, 0.0, 0.0])),
        ("dh_d", np.array([0.1625, 1e-5, 0.0, 0.1333, 0.0997, 0.0996])),
        ("dh_alpha", np.array([1.5707, 0.0, 0.0, 1.5708, -1.5708, 0.0])),
    ],
)
def test_non_nominal_arm_is_rejected(field: str, value: np.ndarray) -> None:
    with pytest.raises(BadValue, match=r"UR5e.*(shape|nominal)"):
        Model(**{**vars(MODELS["UR5e"]), field: value})


@pytest.mark.captures("ur")
@pytest.mark.parametrize(
    ("capture", "size", "name", "e_series"),
    [
        ("cb2_primary_state_1254.bin", 469, "UR5", False),
        ("ursim_5.8_primary_state_1386.bin", 445, "UR5e", True),
    ],
    ids=["UR5", "UR5e"],
)
class TestController:
    """Data that two controllers sent about their arm, parsed by hand, independently of the schemas.

    `size` is the size of the configuration sub-package, which has number 6 and differs by firmware.
    """

    @pytest.fixture
    def state(self, captures: Path, capture: str) -> bytes:
        return (captures / capture).read_bytes()

    @pytest.fixture
    def configuration(self, state: bytes, size: int) -> bytes:
        at = state.index(struct.pack(">iB", size, 6))
        return state[at + 5 : at + size]

    def test_dh_rows_match_table(self, state: bytes, configuration: bytes, name: str, e_series: bool) -> None:
        arm = MODELS[name]
        # Sub-package 5 is 225 bytes; six checksums come first.
        at = state.index(struct.pack(">iB", 225, 5)) + 5 + 24
        theta, a, d, alpha = np.frombuffer(state, ">f8", 24, offset=at).reshape(4, 6)
        for sent, ours in zip((a, d, alpha, theta), (arm.dh_a, arm.dh_d, arm.dh_alpha, arm.dh_theta), strict=True):
            # Controllers write pi/2 with nine decimals.
            np.testing.assert_allclose(sent, ours, rtol=0.0, atol=1e-9)
        again = np.frombuffer(configuration, ">f8", 24, offset=232).reshape(4, 6)
        np.testing.assert_array_equal(again, [a, d, alpha, theta])

    def test_uncalibrated_controller_describes_published_arm(
        self, state: bytes, size: int, name: str, e_series: bool
    ) -> None:
        at = state.index(struct.pack(">iB", 225, 5)) + 5 + 24
        theta, a, d, alpha = np.frombuffer(state, ">f8", 24, offset=at).reshape(4, 6)
        table = Table(theta.tolist(), a.tolist(), d.tolist(), alpha.tolist())
        assert not Arm.calibrated(name, table).is_calibrated

    def test_robot_type_identifies_arm(self, configuration: bytes, name: str, e_series: bool) -> None:
        (robot_type,) = struct.unpack_from(">i", configuration, 432)
        assert robot_type == MODELS[name].robot_type
        assert model_of(robot_type, e_series) is MODELS[name]

    def test_limits_match_table(self, configuration: bytes, name: str, e_series: bool) -> None:
        arm = MODELS[name]
        positions = np.frombuffer(configuration, ">f8", 12).reshape(6, 2)
        speeds, accelerations = np.frombuffer(configuration, ">f8", 12, offset=96).reshape(6, 2).T
        # An e-Series controller adds the tolerances of its safety compliance package: 3 degrees, 0.2 rad/s.
        widened = np.radians([-3.0, 3.0]) if e_series else np.zeros(2)
        np.testing.assert_allclose(positions, arm.position_limits + widened, atol=1e-6)
        if e_series:
            np.testing.assert_allclose(speeds, arm.max_speed + 0.2, atol=1e-9)
        else:
            np.testing.assert_allclose(speeds, arm.max_speed, rtol=0.02)  # 3.15 and 3.2
        np.testing.assert_array_equal(accelerations, arm.max_acceleration)

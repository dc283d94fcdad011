"""Calibrated arms: geometry compared with the given table, and exact inverse kinematics."""

from __future__ import annotations

import math
from unittest.mock import Mock

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from linkcore.errors import BadValue
from tests.urlink.arm.arms import REPORTED_UR5, Array, Table, calibrated, calibration, joints, models, tcps
from urlink.arm.kinematics import Arm, Unreachable, refinement
from urlink.arm.kinematics.geometry import chain
from urlink.arm.models import MODELS, Model, model
from urlink.arm.poses import compose, invert, to_matrix

EVERY = pytest.mark.parametrize("name", MODELS)
#: Poses of each arm; ten thousand in the session of `nox -f nightly.py -s fuzz`.
POSES = min(40 * settings().max_examples, 10_000)
READY = (0.2, -1.4, 1.8, -1.9, -1.5, 0.3)


def missed(arm: Arm, q: Array, target: Array) -> float:
    """Return the largest difference between the poses of joint positions and target poses, in m or rad."""
    return float(np.abs(compose(invert(arm.forward(q)), target)).max(initial=0.0))


def published(arm: Model) -> Table:
    return Table(arm.dh_theta.tolist(), arm.dh_a.tolist(), arm.dh_d.tolist(), arm.dh_alpha.tolist())


# --- geometry ---


@pytest.mark.property
@given(models, st.integers(0, 99), joints, tcps)
def test_forward_is_the_product_of_the_dh_table(of: Model, seed: int, q: list[float], tcp: Array | None) -> None:
    table = calibration(of, seed)
    # Tables of controllers look like this: axes that are almost parallel meet far away.
    assert max(map(abs, table.dh_d)) > 10.0
    arm = calibrated(of.name, seed)
    assert arm.is_calibrated
    expected = table.frames(q)[6] @ (np.eye(4) if tcp is None else to_matrix(tcp))
    # The product itself has limited precision at hundreds of metres.
    np.testing.assert_allclose(to_matrix(arm.forward(q, tcp)), expected, rtol=0.0, atol=1e-10)
    np.testing.assert_allclose(arm.frames(q)[6], table.frames(q)[6], rtol=0.0, atol=1e-10)


@EVERY
def test_every_frame_is_close_to_published_frame(name: str) -> None:
    ours, nominal = calibrated(name, 1), Arm(name)
    q = np.random.default_rng(5).uniform(-3.0, 3.0, (50, 6))
    between = np.abs(ours.frames(q) - nominal.frames(q))
    assert between[..., :3, 3].max() < 0.02
    assert between[..., :3, :3].max() < 0.02
    assert np.abs(ours.forward(q) - nominal.forward(q)).max() > 1e-4


def test_table_reported_from_a_robot_is_accepted() -> None:
    arm = Arm.calibrated("UR5", REPORTED_UR5)
    assert repr(arm) == "<Arm UR5, calibrated>"
    q = np.random.default_rng(6).uniform(-3.0, 3.0, (200, 6))
    off = np.linalg.norm(arm.forward(q)[:, :3] - Arm("UR5").forward(q)[:, :3], axis=1)
    assert 1e-3 < np.median(off) < 3e-3
    np.testing.assert_allclose(to_matrix(arm.forward(q[0])), REPORTED_UR5.frames(q[0].tolist())[6], atol=1e-9)
    there = arm.forward(q)
    assert missed(arm, arm.inverse(there, q), there) < 1e-12


@EVERY
def test_published_table_is_not_a_calibration(name: str) -> None:
    arm = Arm.calibrated(name, published(MODELS[name]))
    assert not arm.is_calibrated
    q = [0.1, -1.0, 1.2, -0.3, 0.7, 0.1]
    np.testing.assert_array_equal(arm.forward(q), Arm(name).forward(q))


def test_dh_table_of_other_arm_or_of_deviations_is_rejected() -> None:
    with pytest.raises(BadValue, match=r"DH table of a UR10e: .* of link 2 is -0.42"):
        Arm.calibrated("UR10e", calibration(model("UR5e"), 0))
    whole, nominal = calibration(model("UR5e"), 0), published(model("UR5e"))
    less = Table(
        *(
            [a - b for a, b in zip(getattr(whole, name), getattr(nominal, name), strict=True)]
            for name in ("dh_theta", "dh_a", "dh_d", "dh_alpha")
        )
    )
    with pytest.raises(BadValue, match="not deviations from the published"):
        Arm.calibrated("UR5e", less)


@pytest.mark.parametrize("bad", [(0.0,) * 5, (0.0,) * 5 + (math.nan,)])
def test_invalid_table_is_rejected(bad: tuple[float, ...]) -> None:
    good = published(model("UR5e"))
    with pytest.raises(BadValue, match="dh_d"):
        Arm.calibrated("UR5e", Table(good.dh_theta, good.dh_a, bad, good.dh_alpha))


# --- inverse ---


@pytest.mark.property
@EVERY
def test_random_poses_are_reached(name: str) -> None:
    arm = calibrated(name, 2)
    q = np.random.default_rng(10).uniform(-2.0 * math.pi, 2.0 * math.pi, (POSES, 6))
    there = arm.forward(q)
    found = arm.inverse(there, q)
    assert missed(arm, found, there) < 1e-12
    assert np.abs(found - q).max() < 1e-6
    assert missed(arm, arm.inverse(there[:500], READY), there[:500]) < 1e-12


@EVERY
@pytest.mark.parametrize("joint", [3, 5])
def test_random_poses_near_singularities_are_reached(name: str, joint: int) -> None:
    arm = calibrated(name, 3)
    rng = np.random.default_rng(11)
    q = rng.uniform(-math.pi, math.pi, (40, 6))
    q[:, joint - 1] = rng.choice([0.0, math.pi], 40) + rng.choice([0.0, 1e-12, 1e-9, 1e-6, 1e-4, 1e-2], 40)
    there = arm.forward(q)
    found = arm.inverse(there, q)
    assert missed(arm, found, there) < 1e-12
    # The result is the original joint positions, rather than another branch.
    assert np.abs(found - q).max() < 1e-5
    assert missed(arm, arm.inverse(there[:10], READY), there[:10]) < 1e-12


@pytest.mark.property
@given(models, st.integers(0, 9), joints)
def test_any_pose_of_the_arm_is_found_again(of: Model, seed: int, q: list[float]) -> None:
    arm = calibrated(of.name, seed)
    there = arm.forward(q)
    assert missed(arm, arm.inverse(there, q, is_limited=False), there) < 1e-12
    for way in arm.solutions(there):
        assert missed(arm, way, there) < 1e-12


def test_calibrated_branches_are_close_to_published_arm() -> None:
    arm, nominal = calibrated("UR10e", 4), Arm("UR10e")
    q = np.random.default_rng(12).uniform(-2.0, 2.0, (300, 6))
    there = arm.forward(q)
    ours, theirs = arm.branches(there), nominal.branches(there)
    exist = ~np.isnan(ours[..., 0])
    assert missed(arm, ours[exist], np.repeat(there, exist.sum(axis=1), axis=0)) < 1e-12
    both = exist & ~np.isnan(theirs[..., 0])
    assert both.sum() > 0.95 * exist.sum()
    between = np.abs(np.angle(np.exp(1j * (ours[both] - theirs[both])))).max(axis=1)
    assert np.quantile(between, 0.9) < 0.05
    np.testing.assert_allclose(arm.branches(there[0]), ours[0], atol=1e-9)


def test_refinement_reaches_full_precision_in_three_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    arm = calibrated("UR5e", 5)
    rng = np.random.default_rng(14)
    q = rng.uniform(-3.0, 3.0, (200, 6))
    q = q[(np.abs(np.sin(q[:, [2, 4]])) > 0.3).all(axis=1)]
    steps = Mock(wraps=chain)
    monkeypatch.setattr(refinement, "chain", steps)
    there = arm.forward(q)
    for pose, close in zip(there.tolist(), (q + rng.uniform(-0.01, 0.01, q.shape)).tolist(), strict=True):
        assert missed(arm, arm.inverse(pose, close), np.array(pose)) < 1e-12
    assert steps.call_count / len(q) < 3.2


def test_many_poses_give_the_same_as_one_by_one() -> None:
    arm = calibrated("UR3e", 5)
    rng = np.random.default_rng(13)
    q = rng.uniform(-3.0, 3.0, (60, 6))
    near = q + rng.uniform(-0.2, 0.2, (60, 6))
    there = arm.forward(q)
    one_by_one = [arm.inverse(pose, close) for pose, close in zip(there, near, strict=True)]
    np.testing.assert_allclose(arm.inverse(there, near), one_by_one, atol=1e-7)
    np.testing.assert_allclose(arm.inverse_path(there[:1], near[0]), one_by_one[:1], atol=1e-7)


@pytest.mark.parametrize("joint", range(6))
def test_inverse_reaches_pose_when_near_is_half_a_turn_off(joint: int) -> None:
    # The sine of half a turn is as small as the sine of 0.
    arm = calibrated("UR5e", 1)
    there = arm.forward(READY)
    near = np.array(READY)
    near[joint] += math.pi
    for found in (arm.inverse(there, near), arm.inverse([there], near)[0]):
        assert missed(arm, found, there) < 1e-12


def test_pose_out_of_reach_raises_unreachable() -> None:
    arm = calibrated("UR5e", 6)
    for there in ([5.0, 0.0, 0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.5, 0.0, math.pi, 0.0]):
        with pytest.raises(Unreachable):
            arm.inverse(there, READY)
        assert np.isnan(arm.inverse(np.array([there, arm.forward(READY)]), READY)[:, 0]).tolist() == [True, False]
        assert len(arm.solutions(there)) == 0


def test_path_is_followed_to_full_precision() -> None:
    arm = calibrated("UR5e", 7)
    q = np.array(READY) + np.linspace(0.0, 0.5, 50)[:, None]
    np.testing.assert_allclose(arm.inverse_path(arm.forward(q), READY), q, atol=1e-9)


def test_velocity_is_the_jacobian_times_the_speeds() -> None:
    arm = calibrated("UR16e", 8)
    qd = [0.1, -0.2, 0.3, -0.4, 0.5, -0.6]
    tcp = [0.1, 0.0, 0.2, 0.3, 0.0, 0.0]
    expected = arm.jacobian(READY, tcp) @ qd
    np.testing.assert_allclose(arm.velocity(READY, qd, tcp), expected, rtol=0.0, atol=1e-13)
    np.testing.assert_allclose(arm.velocity([READY], qd, tcp), [expected], rtol=0.0, atol=1e-13)


def test_jacobian_is_the_derivative_of_the_pose() -> None:
    arm = calibrated("UR16e", 8)
    step = 1e-6
    for i in range(6):
        shift = step * np.eye(6)[i]
        ahead, behind = arm.forward(np.array(READY) + shift), arm.forward(np.array(READY) - shift)
        np.testing.assert_allclose(arm.jacobian(READY)[:3, i], (ahead - behind)[:3] / (2.0 * step), atol=1e-8)
        turn = compose(ahead, invert(behind))[3:]
        np.testing.assert_allclose(arm.jacobian(READY)[3:, i], turn / (2.0 * step), atol=1e-8)

"""Kinematics of published arms, compared with definitions, with itself, and with poses from controllers."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st
from numpy.typing import ArrayLike

from linkcore.errors import BadValue, LocalError
from tests.urlink.arm.arms import Array, angles, dh_matrix, joints, models, tcps
from urlink.arm.kinematics import Arm, Unreachable
from urlink.arm.kinematics.closed_form import SLACK
from urlink.arm.models import MODELS, Model, UnknownModel
from urlink.arm.poses import compose, invert, to_matrix

EVERY = pytest.mark.parametrize("arm", [Arm(name) for name in MODELS], ids=list(MODELS))
IDENTITY = np.eye(4)

arms = models.map(Arm)


def bent(least: float) -> st.SearchStrategy[float]:
    """Return a strategy for angles with a sine of at least about `least`, in all four half turns."""
    half_turn = st.one_of(st.just(math.pi / 2.0), st.floats(least, math.pi - least))
    return st.builds(lambda turn, angle: turn * math.pi + angle, st.integers(-2, 1), half_turn)


# Constructed instead of filtered: `angles` prefers multiples of a quarter turn, and most would be rejected.
regular_joints = st.tuples(angles, angles, bent(1.01e-3), angles, bent(1.01e-2), angles).map(list)


def separation(first: Array, second: Array) -> float:
    """Return the largest difference between two homogeneous matrices."""
    return float(np.abs(first - second).max())


def turned(q: Array, other: Array) -> float:
    """Return the largest joint movement between two joint positions, without whole turns."""
    return float(np.abs((q - other + math.pi) % (2.0 * math.pi) - math.pi).max())


def missed(arm: Arm, q: Array, target: Array, tcp: ArrayLike | None = None) -> float:
    """Return the largest element of the difference between the poses of joint positions and target poses."""
    return float(np.abs(compose(invert(arm.forward(q, tcp)), target)).max(initial=0.0))


def wrist_off_base(arm: Arm, q: ArrayLike) -> float:
    """Return the distance of the origin of frame 5 from the axis of the base."""
    return float(np.linalg.norm(arm.frames(q)[5][:2, 3]))


# --- forward ---


@pytest.mark.property
@given(arms, joints)
def test_frames_are_the_product_of_the_dh_matrices(arm: Arm, q: list[float]) -> None:
    ours, model = arm.frames(q), arm.model
    assert ours.shape == (7, 4, 4)
    expected = IDENTITY
    assert separation(ours[0], expected) == 0.0
    for i in range(6):
        expected = expected @ dh_matrix(
            model.dh_a[i], model.dh_d[i], model.dh_alpha[i], q[i] + float(model.dh_theta[i])
        )
        assert separation(ours[i + 1], expected) < 1e-13


@pytest.mark.property
@given(arms, joints, tcps)
def test_forward_is_the_last_frame_times_the_tcp(arm: Arm, q: list[float], tcp: Array | None) -> None:
    expected = arm.frames(q)[6] @ (IDENTITY if tcp is None else to_matrix(tcp))
    assert separation(to_matrix(arm.forward(q, tcp)), expected) < 1e-12


@EVERY
def test_stretched_arm_has_expected_flange_position(arm: Arm) -> None:
    d1, _, _, d4, d5, d6 = arm.model.dh_d
    # If the arm is upright, the flange looks along -y, at a distance of d4 and d6 to the side.
    expected = [0.0, -d4 - d6, d1 - arm.model.dh_a.sum() + d5]
    np.testing.assert_allclose(
        arm.forward([0.0, -math.pi / 2.0, 0.0, -math.pi / 2.0, 0.0, 0.0])[:3], expected, atol=1e-15
    )


def test_arrays_tuples_and_lists_give_the_same_result() -> None:
    arm = Arm("UR5e")
    q = [0.1, -1.2, 1.3, -0.4, 0.5, 0.6]
    for alike in (tuple(q), np.array(q), np.array(q, dtype=np.float32), np.array(q)[::1]):
        np.testing.assert_allclose(arm.forward(alike), arm.forward(q), atol=1e-6)
    np.testing.assert_array_equal(arm.forward(np.arange(6)), arm.forward([0, 1, 2, 3, 4, 5]))


# --- inverse ---


def check_solutions(arm: Arm, found: Array, tcp: Array | None, target: Array) -> None:
    """Check that every row reaches the target, no two rows are equal, and there are at most eight."""
    assert found.shape[1] == 6
    assert 1 <= len(found) <= 8
    assert missed(arm, found, target, tcp) < 1e-12
    for i, q in enumerate(found):
        assert all(turned(q, other) >= 1e-7 for other in found[:i])


@pytest.mark.property
@given(arms, joints, tcps)
def test_every_solution_reaches_the_pose(arm: Arm, q: list[float], tcp: Array | None) -> None:
    there = arm.forward(q, tcp)
    found = arm.solutions(there, tcp=tcp)
    check_solutions(arm, found, tcp, there)
    assert (found > -math.pi).all()
    assert (found <= math.pi).all()


@pytest.mark.property
@given(arms, regular_joints)
def test_original_joints_are_among_the_solutions(arm: Arm, q: list[float]) -> None:
    # Away from singularities only: in a singularity, joints are known to the root of the precision, or not at all.
    assume(wrist_off_base(arm, q) ** 2 > float(arm.model.dh_d[3]) ** 2 + 1e-4)
    found = arm.solutions(arm.forward(q))
    assert min(turned(np.array(q), other) for other in found) < 1e-7


@pytest.mark.property
@example(Arm("UR16e"), [0.0, 0.0, 3.25, -1.75, 0.0, 0.0], np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0]))
@given(arms, joints, tcps)
def test_near_puts_the_closest_solution_first(arm: Arm, q: list[float], tcp: Array | None) -> None:
    there = arm.forward(q, tcp)
    found = arm.solutions(there, q, tcp)
    check_solutions(arm, found, tcp, there)
    np.testing.assert_allclose(arm.inverse(there, q, tcp, is_limited=False), found[0], rtol=0.0, atol=1e-6)
    # Apart from precision, and in the right turn of each joint, these are the original joints, even if the wrist is
    # singular. A singular wrist may differ only close to the axis of the base. There, rounding moves joint 1 by more
    # than the error that leaves joint 6 free (`SLACK`).
    off_edge = math.sqrt(max(wrist_off_base(arm, q) ** 2 - float(arm.model.dh_d[3]) ** 2, 0.0))
    rounding = 4e-16 * (1.0 + (0.0 if tcp is None else float(np.linalg.norm(tcp[:3]))))
    if off_edge * SLACK > math.pi * rounding:
        assert np.abs(found[0] - q).max() < 1e-4
    moves = np.abs(found - q).max(axis=1)
    assert (moves <= math.pi + 1e-9).all()
    assert (np.diff(moves) >= -1e-9).all()


@EVERY
def test_ordinary_pose_has_eight_solutions(arm: Arm) -> None:
    q = np.array([0.4, -1.2, 1.5, -0.9, 1.3, 0.2])
    there = arm.forward(q)
    found = arm.solutions(there)
    assert len(found) == 8
    check_solutions(arm, found, None, there)
    assert min(turned(q, other) for other in found) < 1e-9


@EVERY
@pytest.mark.parametrize("q5", [0.0, math.pi, -math.pi, 1e-13])
def test_solution_of_singular_wrist_is_close_to_near(arm: Arm, q5: float) -> None:
    q = np.array([0.4, -1.2, 1.5, -0.9, q5, 0.7])
    there = arm.forward(q)
    free = arm.solutions(there)
    check_solutions(arm, free, None, there)
    if q5 != 1e-13:  # there, joint 6 is almost free, but has a value
        in_line = free[np.abs(np.sin(free[:, 4])) < 1e-6]
        # Elbow up and elbow down, each of them once.
        assert len(in_line) == 2
        assert (in_line[:, 5] == 0.0).all()
    led = arm.solutions(there, near=q)
    check_solutions(arm, led, None, there)
    np.testing.assert_allclose(led[0], q, atol=1e-9)


@EVERY
def test_solution_of_half_a_turn_is_plus_pi(arm: Arm) -> None:
    turn = math.pi
    found = arm.solutions(arm.forward([-turn, -turn, -turn, -turn, -turn / 2.0, 0.0]))
    assert (found == turn).any()
    assert (found > -turn).all()


@EVERY
def test_stretched_arm_is_within_reach(arm: Arm) -> None:
    q = [0.0, -math.pi / 2.0, 0.0, -math.pi / 2.0, 0.0, 0.0]
    found = arm.solutions(arm.forward(q), near=q)
    check_solutions(arm, found, None, arm.forward(q))
    np.testing.assert_allclose(found[0], q, atol=1e-6)


@EVERY
@pytest.mark.parametrize("q3", [0.0, math.pi])
def test_wrist_in_line_with_stretched_or_folded_arm_is_solved(arm: Arm, q3: float) -> None:
    # For the orientation, joint 6 is free or nearly free, but only one value of it brings the wrist into reach.
    for q5 in (0.0, math.pi, 1e-11, 1e-9, 1e-7, 1e-5, 1e-3, math.pi - 1e-8):
        q = [0.2, 0.3, q3, -1.0, q5, 1.0]
        there = arm.forward(q)
        check_solutions(arm, arm.solutions(there), None, there)
        led = arm.solutions(there, near=q)
        check_solutions(arm, led, None, there)
        assert np.abs(led[0] - q).max() < 1e-4, q5


OUT_OF_REACH = [
    ([5.0, 0.0, 0.0, 0.0, 0.0, 0.0], "it reaches at most"),
    ([0.0, 0.0, 0.5, 0.0, math.pi, 0.0], "from the axis of the base"),
]


@EVERY
@pytest.mark.parametrize(("there", "why"), OUT_OF_REACH)
def test_unreachable_pose_raises_alone_and_is_nan_among_many(arm: Arm, there: list[float], why: str) -> None:
    near = [0.1, -1.5, 1.5, -1.5, -1.5, 0.0]
    with pytest.raises(Unreachable, match=why) as failure:
        arm.inverse(there, near)
    assert isinstance(failure.value, LocalError)
    assert arm.model.name in str(failure.value)
    for found in (arm.solutions(there), arm.solutions(there, near)):
        assert found.shape == (0, 6)
        assert found.dtype == np.float64
    assert np.isnan(arm.branches(there)).all()
    rows = arm.inverse(np.array([arm.forward(near), there]), near)
    np.testing.assert_allclose(rows[0], near, atol=1e-9)
    assert np.isnan(rows[1]).all()
    with pytest.raises(Unreachable, match="row 1: "):
        arm.inverse_path(np.array([arm.forward(near), there]), near)


@EVERY
def test_millimetre_beyond_stretched_arm_is_out_of_reach(arm: Arm) -> None:
    q = [0.3, -0.5, 0.0, 0.8, 1.2, 0.0]
    beyond = arm.forward(q)
    shoulder, wrist = arm.frames(q)[[1, 3], :3, 3]
    along = (wrist - shoulder) / np.linalg.norm(wrist - shoulder)
    inside, outside = beyond.copy(), beyond.copy()
    inside[:3] -= 1e-3 * along
    outside[:3] += 1e-3 * along

    def same_shoulder_and_wrist(there: Array) -> int:
        # The other branches put the wrist elsewhere, and have another reach.
        return sum(turned(q[[0, 4]], np.array([0.3, 1.2])) < 1e-6 for q in arm.solutions(there))

    assert same_shoulder_and_wrist(inside) == 2
    assert same_shoulder_and_wrist(beyond) == 1
    assert same_shoulder_and_wrist(outside) == 0


# --- limits ---


def test_inverse_stays_within_limits_despite_longer_turn() -> None:
    arm = Arm("UR5e")
    q = np.array([6.2, -1.5, 1.5, -1.5, -1.5, -6.2])
    beyond = q + 0.2 * np.array([1.0, 0.0, 0.0, 0.0, 0.0, -1.0])
    there = arm.forward(beyond)
    back = beyond - 2.0 * math.pi * np.array([1.0, 0.0, 0.0, 0.0, 0.0, -1.0])
    np.testing.assert_allclose(arm.inverse(there, q), back, atol=1e-9)
    np.testing.assert_allclose(arm.inverse(there, q, is_limited=False), beyond, atol=1e-9)
    np.testing.assert_allclose(arm.inverse([there], q), [back], atol=1e-9)
    np.testing.assert_allclose(arm.inverse([there], q, is_limited=False), [beyond], atol=1e-9)
    assert arm.within_limits([q, beyond, back]).tolist() == [True, False, True]
    assert bool(arm.within_limits(q))


def test_inverse_keeps_the_turns_of_an_endless_joint() -> None:
    arm = Arm("UR3e")
    q = np.array([0.0, -1.5, 1.5, -1.5, -1.5, 50.0])
    np.testing.assert_allclose(arm.inverse(arm.forward(q), q), q, atol=1e-9)
    assert arm.within_limits(q)


# --- all branches ---


@EVERY
def test_branch_keeps_its_index_along_a_path(arm: Arm) -> None:
    begin, end = np.array([0.4, -1.4, 1.8, -1.2, 1.3, 0.2]), np.array([0.6, -1.3, 1.7, -1.1, 1.1, 0.5])
    path = arm.forward(begin + np.linspace(0.0, 1.0, 200)[:, None] * (end - begin))
    ways = arm.branches(path)
    assert ways.shape == (200, 8, 6)
    assert not np.isnan(ways).any()
    steps = np.diff(ways, axis=0)
    assert np.abs(steps - 2.0 * math.pi * np.rint(steps / (2.0 * math.pi))).max() < 0.1
    number = np.arange(8)
    assert ((np.sign(ways[..., 2]) < 0.0) == (number % 2 == 1)).all()
    assert ((np.sign(ways[..., 4]) < 0.0) == (number // 2 % 2 == 1)).all()


@pytest.mark.property
@given(arms, st.integers(0, 2**32))
def test_many_poses_give_the_same_as_one_by_one(arm: Arm, seed: int) -> None:
    rng = np.random.default_rng(seed)
    q = rng.uniform(-2.0 * math.pi, 2.0 * math.pi, (5, 6))
    q[rng.integers(0, 5), rng.integers(0, 6)] = rng.choice([0.0, math.pi, 1e-6, math.pi / 2.0])
    near = q + rng.uniform(-1.0, 1.0, (5, 6))
    tcp = rng.uniform(-0.3, 0.3, 6)
    there = arm.forward(q, tcp)
    np.testing.assert_allclose(there, [arm.forward(row, tcp) for row in q], rtol=0.0, atol=1e-13)
    np.testing.assert_allclose(arm.frames(q), [arm.frames(row) for row in q], rtol=0.0, atol=1e-14)
    np.testing.assert_allclose(arm.jacobian(q, tcp), [arm.jacobian(row, tcp) for row in q], rtol=0.0, atol=1e-13)
    np.testing.assert_allclose(arm.manipulability(q), [arm.manipulability(row) for row in q], rtol=1e-9, atol=1e-15)
    one_by_one = [arm.inverse(pose, close, tcp) for pose, close in zip(there, near, strict=True)]
    assert missed(arm, arm.inverse(there, near, tcp), there, tcp) < 1e-12
    assert missed(arm, np.array(one_by_one), there, tcp) < 1e-12
    ours, singles = arm.branches(there, tcp), np.array([arm.branches(row, tcp) for row in there])
    # At the very edge of the reach, rounding may decide whether a branch exists.
    both = ~np.isnan(ours).any(axis=-1) & ~np.isnan(singles).any(axis=-1)
    assert both.sum() >= 5
    assert missed(arm, ours[both], np.repeat(there, both.sum(axis=1), axis=0), tcp) < 1e-12
    assert (np.isnan(ours) == np.isnan(singles)).mean() > 0.9


def test_arguments_may_have_any_number_of_dimensions() -> None:
    arm = Arm("UR10e")
    q = np.random.default_rng(3).uniform(-1.0, 1.0, (2, 3, 6))
    there = arm.forward(q)
    assert there.shape == (2, 3, 6)
    assert arm.frames(q).shape == (2, 3, 7, 4, 4)
    assert arm.jacobian(q).shape == (2, 3, 6, 6)
    assert arm.manipulability(q).shape == (2, 3)
    assert arm.branches(there).shape == (2, 3, 8, 6)
    assert arm.within_limits(q).shape == (2, 3)
    np.testing.assert_allclose(arm.inverse(there, q), q, atol=1e-8)
    np.testing.assert_allclose(arm.inverse(there, q[0, 0])[0, 0], q[0, 0], atol=1e-8)
    np.testing.assert_allclose(arm.inverse(there[0, 0], q[0, 0]), q[0, 0], atol=1e-8)
    for empty in (arm.forward(q[:0]), arm.inverse(there[:0], q[:0])):
        assert empty.shape == (0, 3, 6)
    assert arm.branches(there[:0]).shape == (0, 3, 8, 6)


@EVERY
def test_path_is_followed_through_singular_wrist(arm: Arm) -> None:
    begin, end = np.array([0.3, -1.3, 1.6, -1.9, 0.4, 0.5]), np.array([0.5, -1.1, 1.4, -1.5, -0.4, 0.9])
    q = begin + np.linspace(0.0, 1.0, 41)[:, None] * (end - begin)
    q[20, 4] = 0.0
    there = arm.forward(q)
    found = arm.inverse_path(there, begin)
    assert missed(arm, found, there) < 1e-12
    # In the singularity, joint 6 keeps its previous position, and the other joints compensate for it.
    assert found[20, 5] == pytest.approx(found[19, 5], abs=1e-9)
    np.testing.assert_allclose(np.delete(found, 20, axis=0), np.delete(q, 20, axis=0), atol=1e-6)
    np.testing.assert_allclose(found, q, atol=0.05)


# --- 10 000 random poses of every arm ---


@EVERY
def test_ten_thousand_random_poses_are_reached(arm: Arm) -> None:
    rng = np.random.default_rng(10)
    q = rng.uniform(-2.0 * math.pi, 2.0 * math.pi, (10_000, 6))
    there = arm.forward(q)
    found = arm.inverse(there, q)
    assert missed(arm, found, there) < 1e-12
    assert np.quantile(np.abs(found - q).max(axis=1), 0.99) < 1e-6
    ways = arm.branches(there[:2000])
    exist = ~np.isnan(ways[..., 0])
    assert missed(arm, ways[exist], np.repeat(there[:2000], exist.sum(axis=1), axis=0)) < 1e-12


@EVERY
@pytest.mark.parametrize("joint", [3, 5])
def test_random_poses_near_singularities_are_reached(arm: Arm, joint: int) -> None:
    rng = np.random.default_rng(11)
    q = rng.uniform(-math.pi, math.pi, (200, 6))
    away = rng.choice([0.0, 1e-14, 1e-12, 1e-9, 1e-6, 1e-4, 1e-2], 200)
    q[:, joint - 1] = rng.choice([0.0, math.pi], 200) + away
    there = arm.forward(q)
    assert missed(arm, arm.inverse(there, q), there) < 1e-12
    assert missed(arm, arm.inverse(there, np.zeros(6)), there) < 1e-12


# --- velocities ---


@pytest.mark.property
@given(arms, joints, tcps)
def test_jacobian_is_the_derivative_of_the_pose(arm: Arm, q: list[float], tcp: Array | None) -> None:
    step = 1e-5
    shifts = step * np.eye(6)
    ahead, behind = (to_matrix(arm.forward(q + sign * shifts, tcp)) for sign in (1.0, -1.0))
    numeric = np.empty((6, 6))
    numeric[:3] = (ahead[:, :3, 3] - behind[:, :3, 3]).T / (2.0 * step)
    spin = ahead[:, :3, :3] @ np.swapaxes(behind[:, :3, :3], 1, 2) / (4.0 * step)
    numeric[3:] = [spin[:, 2, 1] - spin[:, 1, 2], spin[:, 0, 2] - spin[:, 2, 0], spin[:, 1, 0] - spin[:, 0, 1]]
    np.testing.assert_allclose(arm.jacobian(q, tcp), numeric, rtol=0.0, atol=1e-8)


@pytest.mark.property
@given(arms, joints, joints, tcps)
def test_velocity_is_the_jacobian_times_the_speeds(
    arm: Arm, q: list[float], qd: list[float], tcp: Array | None
) -> None:
    expected = arm.jacobian(q, tcp) @ qd
    np.testing.assert_allclose(arm.velocity(q, qd, tcp), expected, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(arm.velocity([q, q], qd, tcp)[1], expected, rtol=0.0, atol=1e-12)


@pytest.mark.property
@given(arms, joints, tcps)
def test_manipulability_is_the_product_of_the_singular_values(arm: Arm, q: list[float], tcp: Array | None) -> None:
    expected = float(np.prod(np.linalg.svd(arm.jacobian(q, tcp), compute_uv=False)))
    assert float(arm.manipulability(q)) == pytest.approx(expected, rel=1e-6, abs=1e-12)
    # The formula in the documentation.
    _, a2, a3, _, _, _ = arm.model.dh_a[[0, 1, 2, 3, 4, 5]]
    x, y = arm.frames(q)[5][:2, 3]
    in_plane = x * math.cos(q[0]) + y * math.sin(q[0])
    closed = abs(a2 * a3 * math.sin(q[2]) * math.sin(q[4]) * in_plane)
    assert float(arm.manipulability(q)) == pytest.approx(closed, rel=1e-9, abs=1e-13)


# --- arguments ---


def test_name_of_arm_ignores_case() -> None:
    assert Arm("ur5E").model is MODELS["UR5e"]
    assert Arm(MODELS["UR3"]).model is MODELS["UR3"]
    assert Arm("ur8long").model is MODELS["UR8 Long"]
    assert not Arm("UR5e").is_calibrated
    assert repr(Arm("UR5e")) == "<Arm UR5e, as published>"
    with pytest.raises(UnknownModel, match="UR6"):
        Arm("UR6")


@pytest.mark.parametrize(
    "bad",
    [[0.0] * 5, [0.0] * 7, [], [0.0] * 5 + [math.nan], [math.inf] + [0.0] * 5, np.zeros((6, 1)), 3.0, ["a"] * 6, None],
    ids=repr,
)
def test_arguments_must_be_six_finite_numbers(bad: ArrayLike) -> None:
    arm = Arm("UR5e")
    good = [0.0, -1.5, 1.5, -1.5, -1.5, 0.0]
    there = arm.forward(good)
    calls: list[Callable[[], object]] = [
        lambda: arm.forward(bad),
        lambda: arm.frames(bad),
        lambda: arm.jacobian(bad),
        lambda: arm.manipulability(bad),
        lambda: arm.within_limits(bad),
        lambda: arm.solutions(bad),
        lambda: arm.branches(bad),
        lambda: arm.inverse(bad, good),
        lambda: arm.inverse(there, bad),
        lambda: arm.inverse_path(bad, good),
        lambda: arm.inverse_path([there], bad),
    ]
    if bad is not None:  # None means the flange, or no preference.
        calls += [
            lambda: arm.forward(good, bad),
            lambda: arm.forward([good], bad),
            lambda: arm.jacobian(good, bad),
            lambda: arm.inverse(there, good, bad),
            lambda: arm.solutions(there, near=bad),
        ]
    for call in calls:
        with pytest.raises(BadValue, match="finite numbers"):
            call()


# --- real bytes, parsed by hand, independently of the schemas ---


def subpackages(capture: Path) -> dict[int, bytes]:
    state = capture.read_bytes()
    found = {}
    at = 5
    while at < len(state):
        size, kind = struct.unpack_from(">iB", state, at)
        found[kind] = state[at + 5 : at + size]
        at += size
    return found


def joint_positions(found: dict[int, bytes]) -> Array:
    """Return the actual positions from the six blocks of 41 bytes."""
    return np.array([struct.unpack_from(">d", found[1], 41 * i)[0] for i in range(6)])


def cartesian(found: dict[int, bytes]) -> tuple[Array, Array | None]:
    """Return the pose and, if the package is long enough, the TCP offset."""
    numbers = np.frombuffer(found[4], ">f8").astype(np.float64)
    return numbers[:6], numbers[6:] if len(numbers) == 12 else None


REAL = pytest.mark.parametrize(
    ("name", "model"),
    [
        ("cb2_primary_state_1254.bin", MODELS["UR5"]),
        ("eseries_secondary_state_716.bin", MODELS["UR3e"]),
        ("ursim_5.8_primary_state_1386.bin", MODELS["UR5e"]),
    ],
    ids=["UR5", "UR3e", "UR5e"],
)


@REAL
@pytest.mark.captures("ur")
def test_forward_matches_pose_reported_by_controller(captures: Path, name: str, model: Model) -> None:
    found = subpackages(captures / name)
    reported, tcp = cartesian(found)
    # The rotation vector is also the same: same sign, same turn.
    np.testing.assert_allclose(Arm(model).forward(joint_positions(found), tcp), reported, rtol=0.0, atol=1e-4)


@REAL
@pytest.mark.captures("ur")
def test_inverse_matches_joints_reported_by_controller(captures: Path, name: str, model: Model) -> None:
    found = subpackages(captures / name)
    reported, tcp = cartesian(found)
    q = joint_positions(found)
    np.testing.assert_allclose(Arm(model).inverse(reported, q, tcp), q, rtol=0.0, atol=1e-4)


@pytest.mark.captures("ur")
def test_oldest_cartesian_package_contains_no_tcp(captures: Path) -> None:
    found = subpackages(captures / "cb2_old_state_465.bin")
    reported, tcp = cartesian(found)
    assert tcp is None
    # The orientation agrees, and the position differs by the length of a tool.
    error = compose(invert(Arm("UR5").forward(joint_positions(found))), reported)
    assert 0.05 < np.linalg.norm(error[:3]) < 0.065
    assert np.linalg.norm(error[3:]) < 1e-4

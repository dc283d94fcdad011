"""Kinematics against their definition, each other, and the poses and currents that controllers report."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from numpy.typing import NDArray

from linkcore.errors import BadValue
from urlink.models import MODELS, Model, model
from urlink.simulator.robot.kinematics import (
    GRAVITY,
    forward,
    frames,
    gravity_torque,
    inverse,
    jacobian,
    matrix_to_pose,
    pose,
    pose_inv,
    pose_to_matrix,
    pose_trans,
)

Array = NDArray[np.float64]

EVERY = pytest.mark.parametrize("arm", MODELS.values(), ids=MODELS.keys())
IDENTITY = np.eye(4)

# Whole quarter turns put the arm into its singularities: stretched, folded, wrists in line.
angles = st.one_of(st.floats(-2.0 * math.pi, 2.0 * math.pi), st.integers(-4, 4).map(lambda n: n * math.pi / 2.0))
joints = st.lists(angles, min_size=6, max_size=6)


def bent(least: float) -> st.SearchStrategy[float]:
    """Angles with a sine of at least about `least`, in all four half turns."""
    half_turn = st.one_of(st.just(math.pi / 2.0), st.floats(least, math.pi - least))
    return st.builds(lambda turn, angle: turn * math.pi + angle, st.integers(-2, 1), half_turn)


# Made so rather than sought: angles likes multiples of a quarter turn, most of which would be thrown away.
regular_joints = st.tuples(angles, angles, bent(1.01e-3), angles, bent(1.01e-2), angles).map(list)
arms = st.sampled_from(list(MODELS.values()))
lengths = st.floats(-2.0, 2.0)
directions = st.tuples(*[st.floats(-1.0, 1.0)] * 3).map(np.array).filter(lambda v: float(np.linalg.norm(v)) > 0.1)
# From nothing to half a turn, with extra weight on both ends, where the rotation vector is delicate.
turns = st.one_of(
    st.floats(0.0, math.pi),
    st.floats(0.0, 1e-6),
    st.floats(0.0, 1e-6).map(lambda less: math.pi - less),
    st.sampled_from([0.0, 1e-300, 1e-15, 1e-8, math.pi / 2.0, math.pi - 1e-8, math.pi - 1e-15, math.pi]),
)


@st.composite
def poses(draw: st.DrawFn) -> Array:
    axis = draw(directions)
    rotation = axis / np.linalg.norm(axis) * draw(turns)
    return np.array([draw(lengths), draw(lengths), draw(lengths), *rotation])


tcps = st.none() | poses()


def separation(first: Array, second: Array) -> float:
    """The largest difference between two homogeneous matrices."""
    return float(np.abs(first - second).max())


def turned(q: Array, other: Array) -> float:
    """The largest joint movement between two joint positions, whole turns left out."""
    return float(np.abs((q - other + math.pi) % (2.0 * math.pi) - math.pi).max())


def dh_matrix(a: float, d: float, alpha: float, theta: float) -> Array:
    """Rz(theta) Tz(d) Tx(a) Rx(alpha), written out as it is defined."""
    ct, st_, ca, sa = math.cos(theta), math.sin(theta), math.cos(alpha), math.sin(alpha)
    about_z = np.array([[ct, -st_, 0, 0], [st_, ct, 0, 0], [0, 0, 1, d], [0, 0, 0, 1]])
    about_x = np.array([[1, 0, 0, a], [0, ca, -sa, 0], [0, sa, ca, 0], [0, 0, 0, 1]])
    product: Array = about_z @ about_x
    return product


def rotation_of(vector: Array) -> Array:
    """The rotation of a rotation vector as a power series in its cross-product matrix: slow, and right."""
    x, y, z = vector
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    total = np.eye(3)
    term = np.eye(3)
    for n in range(1, 40):
        term = term @ cross / n
        total += term
    return total


# --- forward ---


@pytest.mark.property
@given(arms, joints)
def test_frames_are_the_product_of_the_dh_matrices(arm: Model, q: list[float]) -> None:
    ours = frames(arm, q)
    assert ours.shape == (7, 4, 4)
    expected = IDENTITY
    assert separation(ours[0], expected) == 0.0
    for i in range(6):
        expected = expected @ dh_matrix(arm.dh_a[i], arm.dh_d[i], arm.dh_alpha[i], q[i] + float(arm.dh_theta[i]))
        assert separation(ours[i + 1], expected) < 1e-13


@pytest.mark.property
@given(arms, joints)
def test_forward_is_the_last_frame(arm: Model, q: list[float]) -> None:
    assert separation(forward(arm, q), frames(arm, q)[6]) < 1e-13


@pytest.mark.property
@given(arms, joints, tcps)
def test_pose_is_forward_times_tcp(arm: Model, q: list[float], tcp: Array | None) -> None:
    expected = forward(arm, q) @ (IDENTITY if tcp is None else pose_to_matrix(tcp))
    assert separation(pose_to_matrix(pose(arm, q, tcp)), expected) < 1e-12


@EVERY
def test_arm_stretched_upwards(arm: Model) -> None:
    d1, _, _, d4, d5, d6 = arm.dh_d
    # Upright, the flange looks along -y, beside the arm by d4 and d6.
    expected = [0.0, -d4 - d6, d1 - arm.dh_a.sum() + d5]
    np.testing.assert_allclose(
        forward(arm, [0.0, -math.pi / 2.0, 0.0, -math.pi / 2.0, 0.0, 0.0])[:3, 3], expected, atol=1e-15
    )


def test_arrays_tuples_and_lists_are_the_same() -> None:
    arm = model("UR5e")
    q = [0.1, -1.2, 1.3, -0.4, 0.5, 0.6]
    for alike in (tuple(q), np.array(q), np.array(q, dtype=np.float32).astype(np.float64), np.array(q)[::1]):
        assert separation(forward(arm, alike), forward(arm, q)) < 1e-6
    assert separation(forward(arm, np.array([0, 1, 2, 3, 4, 5])), forward(arm, [0, 1, 2, 3, 4, 5])) == 0.0


@pytest.mark.parametrize(
    "bad",
    [
        [0.0] * 5,
        [0.0] * 7,
        [],
        [0.0, 0.0, 0.0, 0.0, 0.0, math.nan],
        [math.inf, 0.0, 0.0, 0.0, 0.0, 0.0],
        np.zeros((6, 1)),
        np.zeros((1, 6)),
        np.float64(3.0),
        ["a", "b", "c", "d", "e", "f"],
        None,
    ],
    ids=repr,
)
def test_what_is_not_six_finite_numbers_is_refused(bad: list[float]) -> None:
    arm = model("UR5e")
    good = [0.0] * 6
    calls: list[Callable[[], Array]] = [
        lambda: forward(arm, bad),
        lambda: frames(arm, bad),
        lambda: pose(arm, bad),
        lambda: jacobian(arm, bad),
        lambda: gravity_torque(arm, bad),
        lambda: inverse(arm, bad),
        lambda: pose_to_matrix(bad),
        lambda: pose_inv(bad),
        lambda: pose_trans(bad, good),
        lambda: pose_trans(good, bad),
    ]
    if bad is not None:  # None stands for the flange, and for no preference.
        calls += [
            lambda: pose(arm, good, bad),
            lambda: jacobian(arm, good, bad),
            lambda: inverse(arm, good, bad),
            lambda: inverse(arm, good, near=bad),
        ]
    for call in calls:
        with pytest.raises(BadValue, match="6 finite numbers"):
            call()


@pytest.mark.parametrize("bad", [np.eye(3), np.zeros((4, 4, 1)), np.full((4, 4), math.nan)])
def test_what_is_not_a_homogeneous_matrix_is_refused(bad: Array) -> None:
    with pytest.raises(BadValue, match="4 by 4"):
        matrix_to_pose(bad)


# --- poses ---


@pytest.mark.property
@given(poses())
def test_pose_to_matrix_and_back(there: Array) -> None:
    matrix = pose_to_matrix(there)
    assert separation(matrix[:3, :3], rotation_of(there[3:])) < 1e-14
    np.testing.assert_array_equal(matrix[:, 3], [*there[:3], 1.0])
    back = matrix_to_pose(matrix)
    np.testing.assert_array_equal(back[:3], there[:3])
    angle = float(np.linalg.norm(there[3:]))
    if angle < math.pi - 1e-12:
        np.testing.assert_allclose(back[3:], there[3:], rtol=0.0, atol=1e-14)
    # Up to half a turn itself, where the opposite axis may come back.
    assert separation(pose_to_matrix(back), matrix) < 1e-14


@pytest.mark.property
@given(directions, st.floats(1e-12, 1e-3))
def test_a_small_rotation_keeps_all_its_digits(axis: Array, angle: float) -> None:
    rotation = axis / np.linalg.norm(axis) * angle
    back = matrix_to_pose(pose_to_matrix([0.0, 0.0, 0.0, *rotation]))[3:]
    assert np.linalg.norm(back - rotation) < 1e-14 * angle


@pytest.mark.property
@given(directions, st.floats(math.pi, 20.0))
def test_more_than_half_a_turn_comes_back_the_short_way(axis: Array, angle: float) -> None:
    matrix = pose_to_matrix([0.0, 0.0, 0.0, *(axis / np.linalg.norm(axis) * angle)])
    back = matrix_to_pose(matrix)
    assert np.linalg.norm(back[3:]) <= math.pi + 1e-15
    assert separation(pose_to_matrix(back), matrix) < 1e-13


@pytest.mark.parametrize("axis", [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (0.6, 0.0, -0.8)])
def test_half_a_turn(axis: tuple[float, float, float]) -> None:
    # An exact matrix, without the rounding of sin(pi): 2 axis axis' - 1.
    matrix = np.eye(4)
    matrix[:3, :3] = 2.0 * np.outer(axis, axis) - np.eye(3)
    rotation = matrix_to_pose(matrix)[3:]
    sign = math.copysign(1.0, axis[int(np.argmax(np.abs(axis)))])
    np.testing.assert_allclose(rotation, sign * math.pi * np.array(axis), atol=1e-15)


@pytest.mark.property
@given(poses(), poses())
def test_pose_trans_is_the_matrix_product(first: Array, second: Array) -> None:
    expected = pose_to_matrix(first) @ pose_to_matrix(second)
    assert separation(pose_to_matrix(pose_trans(first, second)), expected) < 1e-13


@pytest.mark.property
@given(poses())
def test_pose_inv_undoes_on_both_sides(there: Array) -> None:
    for both in (pose_trans(there, pose_inv(there)), pose_trans(pose_inv(there), there)):
        np.testing.assert_allclose(both, 0.0, atol=1e-13)


# --- inverse ---


def check_branches(arm: Model, solutions: Array, tcp: Array | None, target: Array) -> None:
    """Every row reaches the target, no two are the same, there are at most eight."""
    assert solutions.shape[1] == 6
    assert 1 <= len(solutions) <= 8
    offset = IDENTITY if tcp is None else pose_to_matrix(tcp)
    for q in solutions:
        assert separation(forward(arm, q) @ offset, target) < 1e-9
    for i, q in enumerate(solutions):
        assert all(turned(q, other) >= 1e-7 for other in solutions[:i])


@pytest.mark.property
@given(arms, joints, tcps)
def test_every_branch_leads_back_to_the_pose(arm: Model, q: list[float], tcp: Array | None) -> None:
    there = pose(arm, q, tcp)
    solutions = inverse(arm, there, tcp)
    check_branches(arm, solutions, tcp, pose_to_matrix(there))
    assert (solutions > -math.pi).all()
    assert (solutions <= math.pi).all()


@pytest.mark.property
@given(arms, regular_joints)
def test_the_joints_it_came_from_are_among_the_branches(arm: Model, q: list[float]) -> None:
    # Away from singularities; in them the joints are known only to the root of the precision, or not at all.
    lever = frames(arm, q)[5][:2, 3]
    assert abs(math.sin(q[4])) > 1e-2
    assert abs(math.sin(q[2])) > 1e-3
    assume(float(lever @ lever) > float(arm.dh_d[3]) ** 2 + 1e-4)
    solutions = inverse(arm, pose(arm, q))
    assert min(turned(np.array(q), other) for other in solutions) < 1e-7


@pytest.mark.property
@given(arms, joints, tcps)
def test_near_gives_the_continuation_first(arm: Model, q: list[float], tcp: Array | None) -> None:
    there = pose(arm, q, tcp)
    solutions = inverse(arm, there, tcp, near=q)
    check_branches(arm, solutions, tcp, pose_to_matrix(there))
    # In the turn of each joint that is meant; precision aside, the joints it came from, at a singular wrist too. Only
    # under the axis of the base, where joint 1 has but half its digits, a singular wrist may go its own way.
    lever = frames(arm, q)[5][:2, 3]
    if float(lever @ lever) > float(arm.dh_d[3]) ** 2 + 1e-9:
        assert np.abs(solutions[0] - q).max() < 1e-4
    moves = np.abs(solutions - q).max(axis=1)
    assert (moves <= math.pi + 1e-9).all()
    assert (np.diff(moves) >= -1e-9).all()


@EVERY
def test_eight_ways_to_reach_an_ordinary_pose(arm: Model) -> None:
    q = np.array([0.4, -1.2, 1.5, -0.9, 1.3, 0.2])
    solutions = inverse(arm, pose(arm, q))
    assert len(solutions) == 8
    check_branches(arm, solutions, None, forward(arm, q))
    assert min(turned(q, other) for other in solutions) < 1e-9


@EVERY
@pytest.mark.parametrize("q5", [0.0, math.pi, -math.pi, 1e-13])
def test_singular_wrist(arm: Model, q5: float) -> None:
    q = np.array([0.4, -1.2, 1.5, -0.9, q5, 0.7])
    there = pose(arm, q)
    free = inverse(arm, there)
    check_branches(arm, free, None, forward(arm, q))
    in_line = free[np.abs(np.sin(free[:, 4])) < 1e-6]
    # Elbow up and elbow down, not each of them twice.
    assert len(in_line) == 2
    assert (in_line[:, 5] == 0.0).all()
    led = inverse(arm, there, near=q)
    check_branches(arm, led, None, forward(arm, q))
    np.testing.assert_allclose(led[0], q, atol=1e-9)


@EVERY
def test_half_a_turn_of_a_joint_is_given_as_pi(arm: Model) -> None:
    turn = math.pi
    solutions = inverse(arm, pose(arm, [-turn, -turn, -turn, -turn, -turn / 2.0, 0.0]))
    assert (solutions == turn).any()
    assert (solutions > -turn).all()


@EVERY
def test_stretched_arm_is_still_in_reach(arm: Model) -> None:
    q = [0.0, -math.pi / 2.0, 0.0, -math.pi / 2.0, 0.0, 0.0]
    solutions = inverse(arm, pose(arm, q), near=q)
    check_branches(arm, solutions, None, forward(arm, q))
    np.testing.assert_allclose(solutions[0], q, atol=1e-6)


@EVERY
@pytest.mark.parametrize("q3", [0.0, math.pi])
@pytest.mark.parametrize("q5", [0.0, math.pi, 1e-11, 1e-9, 1e-7, 1e-5, 1e-3, math.pi - 1e-8])
def test_wrist_in_line_with_the_arm_stretched_or_folded(arm: Model, q3: float, q5: float) -> None:
    # For the orientation joint 6 is free, or nearly so, but only one value of it brings the wrist into reach.
    q = [0.2, 0.3, q3, -1.0, q5, 1.0]
    there = pose(arm, q)
    check_branches(arm, inverse(arm, there), None, forward(arm, q))
    led = inverse(arm, there, near=q)
    check_branches(arm, led, None, forward(arm, q))
    assert np.abs(led[0] - q).max() < 1e-5


@EVERY
@pytest.mark.parametrize(
    "there",
    [
        [5.0, 0.0, 0.0, 0.0, 0.0, 0.0],  # far
        [0.0, 0.0, 0.5, 0.0, math.pi, 0.0],  # on the axis of the base, which the wrist cannot come to
    ],
)
def test_out_of_reach_is_an_empty_array(arm: Model, there: list[float]) -> None:
    for solutions in (inverse(arm, there), inverse(arm, there, near=[0.0] * 6)):
        assert solutions.shape == (0, 6)
        assert solutions.dtype == np.float64


@EVERY
def test_a_millimetre_beyond_the_stretched_arm_is_out_of_reach(arm: Model) -> None:
    beyond = pose(arm, [0.3, -0.5, 0.0, 0.8, 1.2, 0.0])
    shoulder, wrist = frames(arm, [0.3, -0.5, 0.0, 0.8, 1.2, 0.0])[[1, 3], :3, 3]
    along = (wrist - shoulder) / np.linalg.norm(wrist - shoulder)
    inside, outside = beyond.copy(), beyond.copy()
    inside[:3] -= 1e-3 * along
    outside[:3] += 1e-3 * along

    def same_shoulder_and_wrist(there: Array) -> int:
        # The other branches put the wrist elsewhere and have their own reach.
        return sum(turned(q[[0, 4]], np.array([0.3, 1.2])) < 1e-6 for q in inverse(arm, there))

    assert same_shoulder_and_wrist(inside) == 2
    assert same_shoulder_and_wrist(beyond) == 1
    assert same_shoulder_and_wrist(outside) == 0


# --- velocities and forces ---


@pytest.mark.property
@given(arms, joints, tcps)
def test_jacobian_is_the_derivative_of_the_pose(arm: Model, q: list[float], tcp: Array | None) -> None:
    offset = IDENTITY if tcp is None else pose_to_matrix(tcp)
    step = 1e-5
    numeric = np.empty((6, 6))
    for i in range(6):
        shift = step * np.eye(6)[i]
        ahead, behind = forward(arm, q + shift) @ offset, forward(arm, q - shift) @ offset
        numeric[:3, i] = (ahead[:3, 3] - behind[:3, 3]) / (2.0 * step)
        spin = ahead[:3, :3] @ behind[:3, :3].T / (2.0 * step)
        numeric[3:, i] = [spin[2, 1] - spin[1, 2], spin[0, 2] - spin[2, 0], spin[1, 0] - spin[0, 1]]
        numeric[3:, i] /= 2.0
    np.testing.assert_allclose(jacobian(arm, q, tcp), numeric, rtol=0.0, atol=1e-8)


cogs = st.lists(st.floats(-0.3, 0.3), min_size=3, max_size=3)


@pytest.mark.property
@given(arms, joints, st.floats(0.0, 35.0), cogs)
def test_gravity_torque_is_the_slope_of_the_potential_energy(
    arm: Model, q: list[float], payload: float, payload_cog: list[float]
) -> None:
    def energy(at: Array) -> float:
        chain = frames(arm, at)
        heights = [(chain[i + 1] @ [*arm.link_cogs[i], 1.0])[2] for i in range(6)]
        carried = (chain[6] @ [*payload_cog, 1.0])[2]
        return GRAVITY * float(arm.link_masses @ heights + payload * carried)

    step = 1e-5
    slope = [(energy(q + step * unit) - energy(q - step * unit)) / (2.0 * step) for unit in np.eye(6)]
    torque = gravity_torque(arm, q, payload, payload_cog)
    np.testing.assert_allclose(torque, slope, rtol=0.0, atol=1e-5)
    assert torque[0] == 0.0


@pytest.mark.parametrize("bad", [-1.0, math.nan, math.inf])
def test_a_payload_is_a_mass(bad: float) -> None:
    with pytest.raises(BadValue, match="payload"):
        gravity_torque(model("UR5e"), [0.0] * 6, bad)


def test_a_centre_of_mass_is_three_numbers() -> None:
    with pytest.raises(BadValue, match="3 finite numbers"):
        gravity_torque(model("UR5e"), [0.0] * 6, 1.0, [0.0, 0.0])


# --- real bytes, parsed by hand so that they are apart from the schemas ---


def subpackages(capture: Path) -> dict[int, bytes]:
    state = capture.read_bytes()
    found = {}
    at = 5
    while at < len(state):
        size, kind = struct.unpack_from(">iB", state, at)
        found[kind] = state[at + 5 : at + size]
        at += size
    return found


def joint_data(found: dict[int, bytes]) -> tuple[Array, Array]:
    """Actual positions and currents out of the six blocks of 41 bytes."""
    blocks = [struct.unpack_from(">dddf", found[1], 41 * i) for i in range(6)]
    return np.array([block[0] for block in blocks]), np.array([block[3] for block in blocks])


def cartesian(found: dict[int, bytes]) -> tuple[Array, Array | None]:
    """The pose and, where the package is long enough to hold one, the TCP offset."""
    numbers = np.frombuffer(found[4], ">f8").astype(np.float64)
    return numbers[:6], numbers[6:] if len(numbers) == 12 else None


REAL = pytest.mark.parametrize(
    ("name", "arm"),
    [
        ("cb2_primary_state_1254.bin", MODELS["UR5"]),
        ("eseries_secondary_state_716.bin", MODELS["UR3e"]),
        ("ursim_5.8_primary_state_1386.bin", MODELS["UR5e"]),
    ],
    ids=["UR5", "UR3e", "UR5e"],
)


@pytest.mark.captures("ur")
@REAL
def test_pose_that_a_controller_reports_for_its_joints(captures: Path, name: str, arm: Model) -> None:
    found = subpackages(captures / name)
    q, _ = joint_data(found)
    reported, tcp = cartesian(found)
    ours = pose(arm, q, tcp)
    error = pose_trans(pose_inv(ours), reported)
    assert np.linalg.norm(error[:3]) < 1e-4
    assert np.linalg.norm(error[3:]) < 1e-4
    # The rotation vector itself too: same sign, same turn.
    np.testing.assert_allclose(ours, reported, rtol=0.0, atol=1e-4)


@pytest.mark.captures("ur")
@REAL
def test_joints_that_a_controller_reports_for_its_pose(captures: Path, name: str, arm: Model) -> None:
    found = subpackages(captures / name)
    q, _ = joint_data(found)
    reported, tcp = cartesian(found)
    np.testing.assert_allclose(inverse(arm, reported, tcp, near=q)[0], q, rtol=0.0, atol=1e-4)


@pytest.mark.captures("ur")
def test_the_oldest_package_has_a_tcp_that_it_does_not_tell(captures: Path) -> None:
    found = subpackages(captures / "cb2_old_state_465.bin")
    q, _ = joint_data(found)
    reported, tcp = cartesian(found)
    assert tcp is None
    # The orientation agrees and the position is a tool's length away.
    error = pose_trans(pose_inv(pose(MODELS["UR5"], q)), reported)
    assert 0.05 < np.linalg.norm(error[:3]) < 0.065
    assert np.linalg.norm(error[3:]) < 1e-4


@pytest.mark.captures("ur")
@pytest.mark.parametrize(
    ("name", "arm", "alike"),
    [
        # Joints with the same drive: shoulder and elbow or wrists 1 and 2, of a size each.
        ("eseries_secondary_state_716.bin", MODELS["UR3e"], [(3, 4)]),
        ("ursim_5.8_primary_state_1386.bin", MODELS["UR5e"], [(1, 2), (3, 4)]),
    ],
    ids=["UR3e", "UR5e"],
)
def test_currents_of_a_simulated_controller_are_proportional_to_the_torques(
    captures: Path, name: str, arm: Model, alike: list[tuple[int, int]]
) -> None:
    q, currents = joint_data(subpackages(captures / name))
    torques = gravity_torque(arm, q)
    for one, other in alike:
        assert torques[one] / currents[one] > 0.0
        assert torques[one] / currents[one] == pytest.approx(torques[other] / currents[other], rel=1e-5)


@pytest.mark.captures("ur")
def test_target_torques_of_a_real_arm(captures: Path) -> None:
    # A CB2 UR5 standing still; its payload is not in the packet.
    packet = (captures / "cb2_rt_812.bin").read_bytes()
    q, torques = (np.frombuffer(packet, ">f8", 6, offset=at).astype(np.float64) for at in (12, 204))
    ours = gravity_torque(MODELS["UR5"], q)
    np.testing.assert_allclose(ours, torques, rtol=0.0, atol=1.5)
    np.testing.assert_allclose(ours[1:3], torques[1:3], rtol=0.07)

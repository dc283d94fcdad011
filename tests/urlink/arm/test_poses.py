"""Poses and rotations, compared with definitions and with each other, including delicate angles."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from numpy.typing import ArrayLike

from linkcore.errors import BadValue
from tests.urlink.arm.arms import Array, directions, poses, rotation_of, rotation_vectors
from urlink.arm.poses import (
    compose,
    from_matrix,
    interpolate,
    invert,
    matrix_to_rotvec,
    quaternion_to_rotvec,
    rotvec_to_matrix,
    rotvec_to_quaternion,
    rotvec_to_rpy,
    rpy_to_rotvec,
    to_matrix,
    transform,
)

NOWHERE = [0.0] * 6
quarters = st.integers(-4, 4).map(lambda n: n * math.pi / 2.0)
angles = st.one_of(st.floats(-math.pi, math.pi), quarters, quarters.map(lambda a: a + 1e-9))


def apart(first: Array, second: Array) -> float:
    """Return the largest difference between two matrices."""
    return float(np.abs(first - second).max())


# --- the group ---


@pytest.mark.property
@given(poses())
def test_pose_survives_conversion_to_matrix(there: Array) -> None:
    matrix = to_matrix(there)
    assert apart(matrix[:3, :3], rotation_of(there[3:])) < 1e-14
    np.testing.assert_array_equal(matrix[:, 3], [*there[:3], 1.0])
    np.testing.assert_array_equal(matrix[3], [0.0, 0.0, 0.0, 1.0])
    back = from_matrix(matrix)
    np.testing.assert_array_equal(back[:3], there[:3])
    angle = float(np.linalg.norm(there[3:]))
    if angle < math.pi - 1e-12:
        np.testing.assert_allclose(back[3:], there[3:], rtol=0.0, atol=1e-14)
    # At half a turn, the opposite axis may be returned.
    assert apart(to_matrix(back), matrix) < 1e-14


@pytest.mark.property
@given(poses(), poses())
def test_compose_is_the_product_of_the_matrices(first: Array, second: Array) -> None:
    assert apart(to_matrix(compose(first, second)), to_matrix(first) @ to_matrix(second)) < 1e-13


@pytest.mark.property
@given(poses())
def test_inverse_cancels_pose_on_both_sides(there: Array) -> None:
    for both in (compose(there, invert(there)), compose(invert(there), there)):
        np.testing.assert_allclose(both, 0.0, atol=1e-13)


@pytest.mark.property
@given(poses(), arrays.arrays(np.float64, (3, 3), elements=st.floats(-5.0, 5.0)))
def test_transform_applies_matrix_to_points(there: Array, points: Array) -> None:
    matrix = to_matrix(there)
    expected = points @ matrix[:3, :3].T + matrix[:3, 3]
    np.testing.assert_allclose(transform(there, points), expected, rtol=0.0, atol=1e-13)


@pytest.mark.property
@given(poses(), poses(), st.floats(-0.5, 1.5))
def test_interpolate_is_straight_and_about_one_axis(first: Array, second: Array, fraction: float) -> None:
    there = interpolate(first, second, fraction)
    np.testing.assert_allclose(there[:3], first[:3] + fraction * (second[:3] - first[:3]), atol=1e-13)
    whole = from_matrix(to_matrix(invert([0.0, 0.0, 0.0, *first[3:]])) @ to_matrix([0.0, 0.0, 0.0, *second[3:]]))[3:]
    # A half turn may go in either direction.
    if np.linalg.norm(whole) < math.pi - 1e-6:
        part = rotvec_to_matrix(first[3:]) @ rotvec_to_matrix(fraction * whole)
        assert apart(rotvec_to_matrix(there[3:]), part) < 1e-7
    ends = interpolate(first, second, [0.0, 1.0])
    assert apart(to_matrix(ends[0]), to_matrix(first)) < 1e-13
    assert apart(to_matrix(ends[1]), to_matrix(second)) < 1e-13


# --- rotations ---


@pytest.mark.property
@given(rotation_vectors())
def test_rotations_round_trip(rotvec: Array) -> None:
    matrix = rotation_of(rotvec)
    assert apart(rotvec_to_matrix(rotvec), matrix) < 1e-14
    quaternion = rotvec_to_quaternion(rotvec)
    assert np.linalg.norm(quaternion) == pytest.approx(1.0, abs=1e-15)
    assert quaternion[3] >= 0.0
    for back in (
        matrix_to_rotvec(matrix),
        quaternion_to_rotvec(quaternion),
        quaternion_to_rotvec(-quaternion),
        quaternion_to_rotvec(1e-200 * quaternion),
        rpy_to_rotvec(rotvec_to_rpy(rotvec)),
    ):
        assert np.linalg.norm(back) <= math.pi + 1e-15
        assert apart(rotation_of(back), matrix) < 1e-13


@pytest.mark.property
@given(directions, st.floats(1e-150, 1e-3))
def test_small_rotation_keeps_all_digits(axis: Array, angle: float) -> None:
    rotvec = axis / np.linalg.norm(axis) * angle
    for back in (
        matrix_to_rotvec(rotvec_to_matrix(rotvec)),
        quaternion_to_rotvec(rotvec_to_quaternion(rotvec)),
        from_matrix(to_matrix([0.0, 0.0, 0.0, *rotvec]))[3:],
    ):
        assert np.linalg.norm(back - rotvec) < 1e-14 * angle


@pytest.mark.property
@given(directions, st.floats(math.pi, 20.0))
def test_large_rotation_is_returned_as_shortest_rotation(axis: Array, angle: float) -> None:
    matrix = to_matrix([0.0, 0.0, 0.0, *(axis / np.linalg.norm(axis) * angle)])
    back = from_matrix(matrix)
    assert np.linalg.norm(back[3:]) <= math.pi + 1e-15
    assert apart(to_matrix(back), matrix) < 1e-13


@pytest.mark.parametrize(
    "axis", [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (0.6, 0.0, -0.8), (-0.6, 0.8, 0.0)]
)
def test_rotation_by_half_a_turn_is_exact(axis: tuple[float, float, float]) -> None:
    # An exact matrix, without the rounding of sin(pi): 2 axis axis' - 1.
    matrix = np.eye(4)
    matrix[:3, :3] = 2.0 * np.outer(axis, axis) - np.eye(3)
    sign = math.copysign(1.0, axis[int(np.argmax(np.abs(axis)))])
    expected = sign * math.pi * np.array(axis)
    np.testing.assert_allclose(from_matrix(matrix)[3:], expected, atol=1e-15)
    np.testing.assert_allclose(matrix_to_rotvec([matrix[:3, :3]] * 2)[1], expected, atol=1e-15)


@pytest.mark.property
@given(angles, angles, angles)
def test_rpy_turns_about_fixed_x_then_y_then_z(roll: float, pitch: float, yaw: float) -> None:
    expected = rotation_of(np.array([0, 0, yaw])) @ rotation_of(np.array([0, pitch, 0]))
    expected = expected @ rotation_of(np.array([roll, 0, 0]))
    rotvec = rpy_to_rotvec([roll, pitch, yaw])
    assert apart(rotation_of(rotvec), expected) < 1e-13
    again = rotvec_to_rpy(rotvec)
    assert abs(again[1]) <= math.pi / 2.0
    assert apart(rotation_of(rpy_to_rotvec(again)), expected) < 1e-13


def test_roll_is_zero_if_pitch_is_a_quarter_turn() -> None:
    for pitch in (math.pi / 2.0, -math.pi / 2.0):
        roll, found, yaw = rotvec_to_rpy(rpy_to_rotvec([0.3, pitch, 0.0]))
        assert roll == 0.0
        assert found == pytest.approx(pitch, abs=1e-7)
        assert abs(yaw) == pytest.approx(0.3, abs=1e-7)


def test_quaternions_have_the_order_x_y_z_w() -> None:
    np.testing.assert_allclose(rotvec_to_quaternion([0.0, 0.0, 0.2]), [0.0, 0.0, math.sin(0.1), math.cos(0.1)])
    np.testing.assert_allclose(quaternion_to_rotvec([0.0, 0.0, 0.0, 5.0]), [0.0, 0.0, 0.0])


# --- many at once ---


@pytest.mark.slow
@pytest.mark.property
@given(st.lists(st.tuples(poses(), poses()), min_size=1, max_size=9))
def test_many_poses_give_the_same_as_one_by_one(pairs: list[tuple[Array, Array]]) -> None:
    first, second = (np.array(column) for column in zip(*pairs, strict=True))
    # A half turn is the same about an axis and its opposite, and at 90 degrees of pitch, roll and yaw are equivalent.
    # Therefore, rotations are compared instead of their numbers.
    one_by_one = [
        (to_matrix(compose(first, second)), [to_matrix(compose(a, b)) for a, b in pairs]),
        (to_matrix(invert(first)), [to_matrix(invert(a)) for a in first]),
        (to_matrix(first), [to_matrix(a) for a in first]),
        (to_matrix(from_matrix(to_matrix(first))), [to_matrix(from_matrix(to_matrix(a))) for a in first]),
        (
            rotvec_to_matrix(rpy_to_rotvec(rotvec_to_rpy(first[:, 3:]))),
            [rotvec_to_matrix(rpy_to_rotvec(rotvec_to_rpy(a[3:]))) for a in first],
        ),
    ]
    for rows, singles in one_by_one:
        np.testing.assert_allclose(rows, np.array(singles), rtol=0.0, atol=1e-13)
    # There are two shortest paths between orientations that are half a turn apart.
    for a, b in pairs:
        if np.linalg.norm(compose(invert(a), b)[3:]) < math.pi - 1e-6:
            between = to_matrix(interpolate(np.array([a]), np.array([b]), 0.3))
            np.testing.assert_allclose(between, [to_matrix(interpolate(a, b, 0.3))], rtol=0.0, atol=1e-13)


def test_shapes_broadcast_like_numpy() -> None:
    rng = np.random.default_rng(1)
    many, few = rng.uniform(-1, 1, (4, 5, 6)), rng.uniform(-1, 1, (5, 6))
    assert compose(many, few).shape == (4, 5, 6)
    np.testing.assert_allclose(compose(many, few)[2, 3], compose(many[2, 3], few[3]), atol=1e-15)
    assert compose(few[0], many).shape == (4, 5, 6)
    assert invert(many).shape == (4, 5, 6)
    assert to_matrix(many).shape == (4, 5, 4, 4)
    assert from_matrix(to_matrix(many)).shape == (4, 5, 6)
    assert interpolate(few[0], few[1], np.linspace(0, 1, 7)).shape == (7, 6)
    assert interpolate(many, few, np.full((4, 1), 0.5)).shape == (4, 5, 6)
    assert transform(few, rng.uniform(-1, 1, (5, 3))).shape == (5, 3)
    assert transform(few[:, None], rng.uniform(-1, 1, (8, 3))).shape == (5, 8, 3)
    assert rotvec_to_quaternion(many[..., 3:]).shape == (4, 5, 4)
    assert quaternion_to_rotvec(rotvec_to_quaternion(many[..., 3:])).shape == (4, 5, 3)
    assert compose(np.zeros((0, 6)), np.zeros(6)).shape == (0, 6)


# --- wrong arguments ---

ONE_ARGUMENT: list[Callable[[ArrayLike], Array]] = [
    invert,
    to_matrix,
    lambda bad: compose(bad, NOWHERE),
    lambda bad: compose(NOWHERE, bad),
    lambda bad: interpolate(bad, NOWHERE, 0.5),
    lambda bad: interpolate(NOWHERE, bad, [0.5]),
    lambda bad: transform(bad, [0.0, 0.0, 0.0]),
    lambda bad: transform(NOWHERE, bad),
    rotvec_to_matrix,
    rotvec_to_quaternion,
    rotvec_to_rpy,
    rpy_to_rotvec,
    quaternion_to_rotvec,
]


@pytest.mark.parametrize("call", ONE_ARGUMENT)
@pytest.mark.parametrize(
    "bad",
    [[0.0] * 5, [], [math.nan] * 6, [[math.inf] * 6], "ur", None, [[0.0] * 6, [0.0] * 5], np.zeros((6, 1)), 1.0],
    ids=repr,
)
def test_arguments_must_be_rows_of_finite_numbers(call: Callable[[ArrayLike], Array], bad: ArrayLike) -> None:
    with pytest.raises(BadValue, match="finite numbers"):
        call(bad)


def test_error_names_the_wrong_row() -> None:
    rows = np.zeros((4, 6))
    rows[2, 5] = math.nan
    with pytest.raises(BadValue, match=r"at \[2, 5\] is nan"):
        compose(rows, NOWHERE)


def test_incompatible_shapes_are_rejected() -> None:
    with pytest.raises(BadValue, match="do not broadcast"):
        compose(np.zeros((3, 6)), np.zeros((2, 6)))


def test_non_rotations_are_rejected() -> None:
    mirror = np.diag([1.0, 1.0, -1.0])
    with pytest.raises(BadValue, match="is not a rotation"):
        matrix_to_rotvec(mirror)
    with pytest.raises(BadValue, match=r"at \[1\] is not a rotation"):
        matrix_to_rotvec([np.eye(3), 2.0 * np.eye(3)])
    with pytest.raises(BadValue, match="is not a rotation"):
        from_matrix(np.zeros((4, 4)))
    with pytest.raises(BadValue, match="length 0"):
        quaternion_to_rotvec([[0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 0.0, 0.0]])

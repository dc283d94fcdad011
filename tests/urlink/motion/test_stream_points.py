"""Points given to a stream: their steps, and the reasons to reject them."""

from __future__ import annotations

import contextlib
import itertools
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from linkcore.errors import BadValue
from urlink.arm.models import model
from urlink.arm.vectors import FloatArray
from urlink.motion import PosePoint
from urlink.motion.moves.trajectory import Trajectory, TrajectoryPoint
from urlink.motion.servo.jerk_limited import JointLimit
from urlink.motion.stream.stream_points import PointReader
from urlink.motion.stream.stream_steps import Bounds, JointMoment, Mark, Step

SHORTEST = 0.004
STILL = [0.0] * 6


def reader(inverse: Callable[[FloatArray, FloatArray], FloatArray] = lambda pose, near: pose) -> PointReader:
    limits = (JointLimit(3.0, 10.0, 100.0),) * 6
    return PointReader(Bounds(model("UR5e"), (3.0,) * 6, limits), SHORTEST, inverse)


def mark(time: float = 2.0, qd: float = 0.0) -> Mark:
    """Return a mark at zero, with the last joint moving."""
    return Mark(time, JointMoment(np.zeros(6), np.array([*STILL[:5], qd]), np.zeros(6)))


def at(angle: float) -> list[float]:
    return [*STILL[:5], angle]


def point(angle: float, time: float, *more: float) -> TrajectoryPoint:
    """Return a point of the last joint, with its speed and its acceleration if they are given."""
    return TrajectoryPoint(at(angle), time, *map(at, more))


# -- appended points ---------------------------------------------------------------------------------------


def test_points_are_joined_by_steps_of_the_degree_they_define() -> None:
    """The degree of a step depends on the quantities that the point has."""
    points = [point(0.1, 2.5), point(0.2, 3.0, 0.3), point(0.3, 3.5, 0.1, 0.2), point(0.2, 4.0)]
    aims = reader().after(points, mark(qd=0.01))
    assert [(aim.time, aim.degree) for aim in aims] == [(2.5, 1), (3.0, 3), (3.5, 5), (4.0, 1)]
    begin, time = mark(qd=0.01).moment, 2.0
    for aim, given in zip(aims, points, strict=True):
        assert aim.step is not None
        assert aim.step.length == given.time - time
        assert aim.step.degree == aim.degree
        assert aim.moment.q == pytest.approx(given.q)
        expected = Step.to(begin, aim.moment, aim.step.length, aim.degree)
        assert aim.step.rows == pytest.approx(expected.rows)
        begin, time = aim.moment, given.time
    assert aims[1].moment.qd[5] == pytest.approx(0.3)
    assert aims[2].moment.qdd[5] == pytest.approx(0.2)


def test_reader_accepts_one_point_and_rejects_empty_list() -> None:
    (aim,) = reader().after(point(0.1, 3.0), mark())
    assert aim.time == 3.0
    with pytest.raises(BadValue, match="there are no points"):
        reader().after([], mark())
    with pytest.raises(BadValue, match="there are no points"):
        reader().curve([], 0.0, mark())


def test_first_point_at_rest_has_no_step() -> None:
    for time in (2.0, 2.0 + 0.99 * SHORTEST, 2.0 - 0.99 * SHORTEST):
        first, second = reader().after([point(0.04, time), point(0.1, 2.5)], mark())
        assert (first.time, first.step, first.degree) == (2.0, None, 5)
        assert first.moment.q[5] == 0.04
        assert second.step is not None
        assert second.step.length == pytest.approx(2.5 - time)
    (moves,) = reader().after([point(0.04, 2.0, 0.2, 0.3)], mark())
    assert (moves.moment.qd[5], moves.moment.qdd[5]) == (0.2, 0.3)


def test_first_point_two_cycles_later_has_a_step() -> None:
    (aim,) = reader().after(point(1e-4, SHORTEST), mark(0.0))
    assert aim.step is not None
    assert aim.step.length == SHORTEST


def test_points_of_replacing_curve_need_minimum_interval() -> None:
    points = [point(0.0, 2.5), point(0.0, 2.5 + 0.9 * SHORTEST)]
    with pytest.raises(BadValue, match=r"point 1 .*: its time is .* s after the previous point"):
        reader().curve(points, 0.0, mark())


@pytest.mark.parametrize("time", [math.inf, math.nan, -1.0])
def test_time_of_a_pose_point_is_checked(time: float) -> None:
    with pytest.raises(BadValue, match="time"):
        PosePoint([0.1, 0.2, 0.3, 0.0, 0.0, 0.0], time)


@pytest.mark.parametrize(
    ("away", "is_near"), [(0.05, True), (0.0499, True), (-0.0499, True), (0.0501, False), (-0.0501, False)]
)
def test_first_point_must_be_near_arm(away: float, is_near: bool) -> None:
    why = rf"point 0 \(t = 2 s\): wrist 3 \(joint 5\) is at {away:.4f} rad, 0\.0501 rad from .*; .* 0\.05 rad"
    with contextlib.nullcontext() if is_near else pytest.raises(BadValue, match=why):
        reader().after(point(away, 2.0), mark())
    there = Trajectory.from_arrays([0, 1], [at(away), at(0.1)])
    with contextlib.nullcontext() if is_near else pytest.raises(BadValue, match="from the position of the arm"):
        reader().after(there, mark())


@pytest.mark.parametrize(
    ("number", "time", "is_refused"),
    [
        (0, 2.0 + SHORTEST, False),
        (0, 2.0 + SHORTEST * (1 - 0.9e-6), False),
        (0, 2.0 + SHORTEST * (1 - 1.2e-6), True),
        (0, 2.0, True),
        (0, 1.5, True),
        (0, 1002.0, False),
        (0, 1002.1, True),
        (1, 2.5 + SHORTEST * (1 + 1e-9), False),
        (1, 2.5 + 0.9 * SHORTEST, True),
        (1, 1502.0, True),
    ],
)
def test_interval_between_points_is_limited(number: int, time: float, is_refused: bool) -> None:
    """The minimum is two cycles of the controller, for an arm that moves."""
    points = [point(0.0, 2.5)] * number + [point(0.0, time)]
    why = rf"point {number} \(t = .*: its time is .* s after the previous point .* expected 0\.004 s .* to 1000 s"
    with pytest.raises(BadValue, match=why) if is_refused else contextlib.nullcontext():
        reader().after(points, mark(qd=1e-5))


def test_impossible_point_is_named_in_error() -> None:
    points = [point(0.02, 2.0), point(0.03, 2.5), point(3.0, 2.6)]
    why = r"^point 2 \(t = 2\.6 s\): speed of wrist 3"
    with pytest.raises(BadValue, match=why):
        reader().after(points, mark())
    with pytest.raises(BadValue, match=why):
        reader().curve(points, 0.0, mark())


def test_acceleration_requires_speed() -> None:
    lacking = TrajectoryPoint(at(0.1), 2.5, None, STILL)
    with pytest.raises(BadValue, match="point 1 has accelerations without velocities"):
        reader().after([point(0.1, 2.4), lacking], mark())


@pytest.mark.parametrize(("wrong", "why"), [([3], "point 0 is 3; expected"), (3, "points is 3; expected")])
def test_other_objects_are_rejected(wrong: Any, why: str) -> None:
    with pytest.raises(BadValue, match=why):
        reader().after(wrong, mark())


# -- trajectories ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("begins", "first"), [(0.0, 2.0), (2.7, 2.7)])
def test_trajectory_begins_at_mark_or_later(begins: float, first: float) -> None:
    there = Trajectory.from_arrays([0, 0.5, 1], [at(0), at(0.1), at(0.2)])
    aims = reader().after(there, mark(), begins)
    times = [first + t for t in (0.0, 0.5, 1.0)]
    # If it begins where the points end, its first point is the mark.
    assert [aim.time for aim in aims] == pytest.approx(times[1:] if first == 2.0 else times)
    assert [aim.moment.q[5] for aim in aims][-2:] == pytest.approx([0.1, 0.2])
    curve = reader().curve(there, 5.0, mark())
    assert [aim.time for aim in curve] == [5.0, 5.5, 6.0]


def test_dense_trajectory_is_sampled_every_fourth_cycle() -> None:
    """The curve must stay the same."""
    dense = np.linspace(0.0, 1.0, 1001)
    cubic = Trajectory.from_arrays(dense, [at(0.2 * u * u * (3 - 2 * u)) for u in dense])
    aims = reader().after(cubic, mark())
    assert len(aims) == 125
    assert [aim.degree for aim in aims] == [3] * 125
    for aim in aims[::20]:
        assert aim.moment.q[5] == pytest.approx(float(cubic.at(np.array([aim.time - 2.0]))[0][0, 5]))
    times = [2.0, *(aim.time for aim in aims)]
    assert [b - a for a, b in itertools.pairwise(times)] == pytest.approx([2 * SHORTEST] * 125)
    quintic = Trajectory.from_arrays(
        dense,
        [at(0.2 * u**3 * (10 - 15 * u + 6 * u * u)) for u in dense],
        qd=[at(0.2 * 30 * u * u * (1 - u) ** 2) for u in dense],
        qdd=[at(0.2 * 60 * u * (1 - 3 * u + 2 * u * u)) for u in dense],
    )
    assert {aim.degree for aim in reader().after(quintic, mark())} == {5}
    short = Trajectory.from_arrays([0.0, 0.003, 0.0079], [at(0.0), at(1e-5), at(2e-5)])
    assert [aim.time for aim in reader().after(short, mark())] == pytest.approx([2.0079])
    sparse = Trajectory.from_arrays([0.0, 0.004, 0.1], [at(0.0), at(1e-5), at(2e-5)])
    assert len(reader().after(sparse, mark())) == 2


# -- poses -------------------------------------------------------------------------------------------------


def test_pose_is_reached_close_to_previous_point() -> None:
    asked: list[float] = []

    def inverse(pose: FloatArray, near: FloatArray) -> FloatArray:
        asked.append(float(near[5]))
        return np.array(at(float(pose[0])))

    poses = [PosePoint([x, 0, 0, 0, 0, 0], time) for x, time in ((0.1, 3.0), (0.2, 5.0), (0.4, 6.0))]
    aims = reader(inverse).after([poses[0], point(0.3, 4.0), *poses[1:]], mark())
    assert asked == [0.0, 0.3, 0.2]
    assert [aim.moment.q[5] for aim in aims] == pytest.approx([0.1, 0.3, 0.2, 0.4])
    assert [aim.degree for aim in aims] == [1] * 4


@pytest.mark.parametrize(("leap", "is_refused"), [(1.49, False), (-1.49, False), (1.51, True), (-1.51, True)])
def test_pose_behind_singularity_is_rejected(leap: float, is_refused: bool) -> None:
    read = reader(lambda pose, near: np.array(at(leap)))
    why = rf"point 0 \(t = 9 s\): wrist 3 \(joint 5\) would jump from 0\.0000 to {leap:.4f} rad; .* 1\.5 rad"
    with pytest.raises(BadValue, match=why) if is_refused else contextlib.nullcontext():
        read.after(PosePoint(STILL, 9.0), mark())

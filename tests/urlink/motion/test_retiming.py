"""Trajectories along poses, and the fastest trajectories along a path."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from linkcore.errors import BadValue
from tests.urlink.arm.arms import calibrated
from urlink import Trajectory
from urlink.arm.kinematics import Arm, Unreachable
from urlink.arm.vectors import FloatArray
from urlink.motion.moves import retiming
from urlink.motion.moves.retiming import retime

SPEED = np.array([2.0, 2.0, 3.0, 3.0, 3.0, 3.0])
ACCELERATION = np.array([5.0, 4.0, 8.0, 10.0, 10.0, 10.0])
READY = np.array([0.0, -1.6, 1.6, -1.6, -1.6, 0.0])

#: Joint positions in steps of 1 mrad; some joints do not move.
joints = st.lists(st.integers(-1500, 1500).map(lambda n: n * 1e-3) | st.just(0.0), min_size=6, max_size=6)


def usage(trajectory: Trajectory, speed: FloatArray = SPEED, acceleration: FloatArray = ACCELERATION) -> FloatArray:
    """Return the used fraction of the most used limit at each moment."""
    t = np.linspace(0.0, trajectory.duration, 5_000)
    _, qd, qdd = trajectory.at(t[1:-1])
    used: FloatArray = np.maximum(np.abs(qd) / speed, np.abs(qdd) / acceleration).max(axis=1)
    return used


# -- minimal time --------------------------------------------------------------------------------------


@pytest.mark.parametrize(("way", "seconds"), [(2.0, 2.0 / 0.5 + 0.5 / 2.0), (0.1, 2.0 * math.sqrt(0.1 / 2.0))])
def test_straight_path_accelerates_cruises_and_brakes(way: float, seconds: float) -> None:
    straight = Trajectory.from_arrays([0.0, 5.0], [[0.0] * 6, [0.0, way, 0.0, 0.5 * way, 0.0, 0.0]])
    retimed = straight.retimed(0.5, 2.0)
    assert retimed.duration == pytest.approx(seconds, rel=1e-3)
    assert retimed.has_velocities


@pytest.mark.parametrize(("way", "acceleration"), [(1e-3, 1e6), (1e-5, 1e3), (1.3e-7, 1.0)])
def test_shortest_paths_end_at_target(way: float, acceleration: float) -> None:
    """Some end within one cycle of a controller, or are too short to distinguish their points."""
    q = [[0.5] * 6, [0.5 + way] * 6]
    retimed = Trajectory.from_arrays([0.0, 1.0], q).retimed(1e3, acceleration)
    assert retimed.q[[0, -1]].tolist() == q
    assert np.abs(retimed.qd[[0, -1]]).max() == 0.0
    assert 2.0 * math.sqrt(way / acceleration) <= retimed.duration < 3.0 * math.sqrt(way / acceleration) + 3e-4
    assert usage(retimed, np.full(6, 1e3), np.full(6, acceleration)).max() <= 1.0 + 1e-6


@pytest.mark.parametrize(
    ("speed", "acceleration", "seconds"), [(1.0, 2.0, math.sqrt(0.9)), (0.5, 1e3, 0.9), (1e5, 1e9, 2e-4)]
)
def test_single_step_is_a_cubic_from_rest_to_rest(speed: float, acceleration: float, seconds: float) -> None:
    """Compare with the formulas: the largest speed is 1.5 times the mean, and the acceleration is 6 s / t²."""
    q = np.array([[0.0] * 6, [0.3, -0.3, 0.1, 0.0, 0.0, 0.0]])
    time, places, speeds = retime(q, np.zeros((2, 6)), np.full(6, speed), np.full(6, acceleration), 2e-4)
    assert time == pytest.approx([0.0, seconds])
    assert places.tolist() == q.tolist()
    assert not speeds.any()


@pytest.mark.parametrize("seed", range(3))
def test_retiming_plan_reaches_but_does_not_exceed_limits(seed: int) -> None:
    """Check both ends of each step: on a curve with tangent T and length s, joints accelerate by T's'² + T s''."""
    rng = np.random.default_rng(seed)
    u = np.linspace(0.0, 1.0, 81)[:, None]
    size, phase = rng.uniform(0.2, 1.0, 6), rng.uniform(0.0, 6.0, 6)
    q, qd = size * np.sin(3.0 * u + phase), 3.0 * size * np.cos(3.0 * u + phase)
    time, speeds = retiming._fastest(q, qd, SPEED, np.tile(ACCELERATION, (80, 1)))
    ds = np.linalg.norm(np.diff(q, axis=0), axis=1)[:, None]
    squares = (speeds**2).sum(axis=1)[:, None]
    along = np.diff(squares, axis=0) / (2.0 * ds)
    tangent = qd / np.linalg.norm(qd, axis=1)[:, None]
    # At the rest positions, the path is straight.
    before, after = tangent[:-1].copy(), tangent[1:].copy()
    before[0], after[-1] = np.diff(q, axis=0)[0] / ds[0], np.diff(q, axis=0)[-1] / ds[-1]
    bend = (after - before) / ds
    used = np.concatenate(
        [
            np.abs(bend * squares[:-1] + before * along) / ACCELERATION,
            np.abs(bend * squares[1:] + after * along) / ACCELERATION,
            np.abs(speeds[:-1]) / SPEED,
            np.abs(speeds[1:]) / SPEED,
        ],
        axis=1,
    ).max(axis=1)
    assert used.max() <= 1.0 + 1e-9
    assert np.mean(used > 1.0 - 1e-6) > 0.95
    assert time == pytest.approx(np.cumsum([0.0, *(2.0 * ds / (squares[1:] ** 0.5 + squares[:-1] ** 0.5)).ravel()]))


@pytest.mark.parametrize("seed", range(20))
def test_largest_feasible_x_equals_bisection(seed: int) -> None:
    """Compare with bisection, for lines a x + b y <= c and 0 <= y <= `end`."""
    rng = np.random.default_rng(seed)
    a, b, c = rng.normal(size=(3, 8))
    b[rng.integers(8)] = 0.0
    c, end = np.abs(c) + 0.1, float(rng.uniform(0.1, 2.0))

    def is_left(x: float) -> bool:
        ends = [((c[i] - a[i] * x) / b[i], b[i] > 0.0) for i in range(8) if b[i]]
        highest = min([end, *(y for y, is_upper in ends if is_upper)])
        return bool(highest >= max([0.0, *(y for y, is_upper in ends if not is_upper)]))

    low, high = 0.0, 10.0
    for _ in range(50):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if is_left(middle) else (low, middle)
    assert retiming._largest(a, b, c, end, 10.0) == pytest.approx(low, abs=1e-9)
    assert retiming._largest(a, b, c, end, 0.5 * low) == 0.5 * low
    assert retiming._largest(np.zeros(1), np.ones(1), -np.ones(1), end, 1.0) == 0.0


def test_retiming_omits_points_that_are_passed_too_quickly() -> None:
    """Keep as many points as fit into the time, and both ends."""
    u = np.linspace(0.0, math.pi, 2001)
    q, qd = np.outer(0.5 - 0.5 * np.cos(u), [0.3] * 6), np.outer(np.sin(u), [0.3] * 6)
    time, places, _ = retime(q, qd, np.full(6, 10.0), np.full(6, 120.0), 5e-3)
    assert time[-1] == pytest.approx(0.1, rel=0.05)
    assert np.diff(time).min() >= 5e-3 * (1.0 - 1e-9)
    assert 10 <= len(time) <= 20
    assert places[[0, -1]].tolist() == q[[0, -1]].tolist()


@pytest.mark.parametrize(("end", "rounds"), [(1.0, 1), (0.5, 5)])
def test_retiming_plans_only_bent_paths_a_second_time(end: float, rounds: int, monkeypatch: pytest.MonkeyPatch) -> None:
    planned: list[int] = []
    fastest = retiming._fastest

    def counted(q: FloatArray, *rest: FloatArray) -> tuple[FloatArray, FloatArray]:
        planned.append(len(q))
        return fastest(q, *rest)

    monkeypatch.setattr(retiming, "_fastest", counted)
    path = Trajectory.from_arrays([0, 1, 2], [[0.0] * 6, [0.5] * 6, [end, *[1.0] * 5]])
    retimed = path.retimed(SPEED, ACCELERATION)
    assert planned.count(len(retimed)) == rounds


@pytest.mark.parametrize("middle", [0.05, 0.15, 0.25])
def test_retiming_of_two_steps_takes_the_minimal_time(middle: float) -> None:
    """The shorter step uses the full acceleration, from rest or to rest."""
    q = np.array([[0.0] * 6, [middle] * 6, [0.3] * 6])
    time, places, speeds = retime(
        q, np.array([[0.0] * 6, [1.0] * 6, [0.0] * 6]), np.full(6, 9.0), np.full(6, 2.0), 2e-4
    )
    fastest = math.sqrt(2.0 * 2.0 * min(middle, 0.3 - middle))
    assert time == pytest.approx([0.0, 2.0 * middle / fastest, 2.0 * 0.3 / fastest])
    assert len(places) == 3
    assert speeds[1] == pytest.approx([fastest] * 6)


def test_retiming_keeps_points_that_are_far_enough_apart() -> None:
    assert retiming._spread(np.array([0.0, 1.0, 1.4, 2.5]), 1.0) == [0, 1, 3]
    assert retiming._spread(np.array([0.0, 1.0, 2.0, 2.5]), 1.0) == [0, 1, 3]
    assert retiming._spread(np.array([0.0, 0.4, 0.8]), 1.0) == [0, 2]


def test_retiming_keeps_the_rests_of_a_path() -> None:
    there_and_back = Trajectory.from_arrays([0, 3, 9], [[0.0] * 6, [1.0, 0.5, 0.0, 0.0, 0.0, 0.0], [0.0] * 6])
    retimed = there_and_back.retimed(1.0, 2.0)
    assert retimed.duration == pytest.approx(2.0 * (1.0 + 0.5), rel=1e-3)
    rests = np.flatnonzero(np.abs(retimed.qd).max(axis=1) == 0.0)
    assert retimed.q[rests] == pytest.approx(there_and_back.q, abs=1e-12)


@pytest.mark.property
@settings(max_examples=max(settings().max_examples // 3, 1))
@given(st.lists(joints, min_size=2, max_size=3), st.lists(st.floats(0.1, 5.0), min_size=2, max_size=2))
def test_retiming_respects_limits_and_path(q: list[list[float]], steps: list[float]) -> None:
    assume(np.abs(np.diff(q, axis=0)).max() > 0.05)
    time = np.concatenate([[0.0], np.cumsum(steps[: len(q) - 1])])
    path = Trajectory.from_arrays(time, q)
    retimed = path.retimed(SPEED, ACCELERATION)
    assert usage(retimed).max() <= 1.0 + 1e-6
    assert np.abs(retimed.qd[[0, -1]]).max() == 0.0
    # Each position is on the old path, in the same order; between the points, it may differ by a few mrad.
    old, _, _ = path.at((time[:-1, None] + np.diff(time)[:, None] * np.linspace(0.0, 1.0, 1500)).ravel())
    new, _, _ = retimed.at(np.linspace(0.0, retimed.duration, 60))
    nearest = [int(np.abs(old - place).max(axis=1).argmin()) for place in new]
    assert max(float(np.abs(old[i] - place).max()) for i, place in zip(nearest, new, strict=True)) < 5e-3
    # The result is not slower than the old timing, scaled as a whole, apart from the effect of the steps.
    times = np.linspace(0.0, path.duration, 5_000)[1:-1]
    _, qd, qdd = path.at(times)
    scale = max(float((np.abs(qd) / SPEED).max()), math.sqrt(float((np.abs(qdd) / ACCELERATION).max())))
    assert retimed.duration <= 1.05 * path.duration * scale


def test_retimed_trajectory_is_at_some_limit_most_of_the_time() -> None:
    rng = np.random.default_rng(0)
    q = np.cumsum(rng.uniform(-0.3, 0.3, (8, 6)), axis=0)
    used = usage(Trajectory.from_arrays(np.arange(8.0), q).retimed(SPEED, ACCELERATION))
    assert np.mean(used > 0.9) > 0.8


@pytest.mark.slow
def test_second_retiming_changes_nothing() -> None:
    rng = np.random.default_rng(1)
    q = np.cumsum(rng.uniform(-0.3, 0.3, (3, 6)), axis=0)
    once = Trajectory.from_arrays([0, 1, 2], q).retimed(2.0, 5.0)
    assert once.retimed(2.0, 5.0).duration == pytest.approx(once.duration, rel=0.03)
    # Half the speed and a quarter of the acceleration take twice as long.
    slower = Trajectory.from_arrays([0, 1, 2], q).retimed(1.0, 1.25)
    assert slower.duration == pytest.approx(2.0 * once.duration, rel=0.01)


@pytest.mark.parametrize("bad", [0.0, -1.0, math.nan, [1.0] * 5, "fast"])
def test_invalid_limits_are_rejected(bad: object) -> None:
    path = Trajectory.from_arrays([0.0, 1.0], [[0.0] * 6, [1.0] * 6])
    with pytest.raises(BadValue, match="speed"):
        path.retimed(bad, 1.0)  # type: ignore[arg-type]
    with pytest.raises(BadValue, match="acceleration"):
        path.retimed(1.0, bad)  # type: ignore[arg-type]


def test_trajectory_without_motion_cannot_be_retimed() -> None:
    with pytest.raises(BadValue, match="does not move"):
        Trajectory.from_arrays([0.0, 1.0], [READY, READY]).retimed(1.0, 1.0)


# -- along poses ---------------------------------------------------------------------------------------


def test_tool_follows_given_poses() -> None:
    arm = calibrated("UR5e", 3)
    tcp = [0.0, 0.0, 0.1, 0.0, 0.2, 0.0]
    poses = arm.forward(READY, tcp) + np.linspace(0.0, 1.0, 21)[:, None] * [0.0, 0.1, 0.1, 0.0, 0.0, 0.0]
    trajectory = Trajectory.from_poses(np.linspace(0.0, 2.0, 21), poses, arm, READY, tcp)
    assert trajectory.q[0] == pytest.approx(READY, abs=1e-9)
    np.testing.assert_allclose(arm.forward(trajectory.q, tcp), poses, atol=1e-9)
    between, _, _ = trajectory.at(np.linspace(0.2, 1.8, 99))
    off = arm.forward(between, tcp)[:, :3] - poses[0, :3]
    assert np.abs(off[:, 0]).max() < 1e-3
    assert np.abs(off[:, 1] - off[:, 2]).max() < 1e-3


def test_impossible_poses_are_rejected() -> None:
    arm = Arm("UR5e")
    start = arm.forward(READY)
    far = start * [0.0, 1.0, 1.0, 1.0, 1.0, 1.0]
    far[0] = 3.0
    with pytest.raises(Unreachable, match="row 1"):
        Trajectory.from_poses([0.0, 1.0], [start, far], arm, READY)
    near = np.array([*READY[:4], -0.05, 0.0])
    tilted = arm.forward([*near[:3], near[3] + 0.5, 0.05, 0.0])
    turned = arm.forward([*near[:3], near[3] - 1.4, 0.05, 2.0])
    with pytest.raises(BadValue, match=r"between points 1 and 2 wrist \d \(joint \d\) jumps"):
        Trajectory.from_poses([0.0, 1.0, 2.0], [arm.forward(near), tilted, turned], arm, near)


def test_point_shortly_before_rest_is_passed_slowly() -> None:
    """The first point after the start counts, too: one joint, 1 rad/s² at most, at rest at both ends."""
    ones, most = np.ones((2, 1)), np.ones((2, 1))
    rests = np.array([True, False, True])
    squares = retiming._squares(np.array([1.0, 0.1]), ones, ones, rests, np.array([10.0]), most)
    assert squares == pytest.approx([0.0, 0.2, 0.0])

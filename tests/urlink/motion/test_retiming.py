"""Trajectories along poses, and the fastest ones along a path."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from linkcore.errors import BadValue
from tests.urlink.arms import calibrated
from urlink import Trajectory
from urlink.kinematics import Arm, Unreachable
from urlink.vectors import FloatArray

SPEED = np.array([2.0, 2.0, 3.0, 3.0, 3.0, 3.0])
ACCELERATION = np.array([5.0, 4.0, 8.0, 10.0, 10.0, 10.0])
READY = np.array([0.0, -1.6, 1.6, -1.6, -1.6, 0.0])

#: Joint positions in steps of 1 mrad, of which some stay.
joints = st.lists(st.integers(-1500, 1500).map(lambda n: n * 1e-3) | st.just(0.0), min_size=6, max_size=6)


def usage(trajectory: Trajectory, speed: FloatArray = SPEED, acceleration: FloatArray = ACCELERATION) -> FloatArray:
    """Of the limit that is used most at each moment, the part."""
    t = np.linspace(0.0, trajectory.duration, 5_000)
    _, qd, qdd = trajectory.at(t[1:-1])
    used: FloatArray = np.maximum(np.abs(qd) / speed, np.abs(qdd) / acceleration).max(axis=1)
    return used


# -- in the shortest time ------------------------------------------------------------------------------


@pytest.mark.parametrize(("way", "seconds"), [(2.0, 2.0 / 1.0 + 1.0 / 2.0), (0.1, 2.0 * math.sqrt(0.1 / 2.0))])
def test_one_joint_accelerates_goes_on_and_brakes(way: float, seconds: float) -> None:
    straight = Trajectory.from_arrays([0.0, 5.0], [[0.0] * 6, [0.0, way, 0.0, 0.5 * way, 0.0, 0.0]])
    retimed = straight.retimed(1.0, 2.0)
    assert retimed.duration == pytest.approx(seconds, rel=1e-3)
    assert retimed.has_velocities


def test_where_it_rests_it_rests() -> None:
    there_and_back = Trajectory.from_arrays([0, 3, 9], [[0.0] * 6, [1.0, 0.5, 0.0, 0.0, 0.0, 0.0], [0.0] * 6])
    retimed = there_and_back.retimed(1.0, 2.0)
    assert retimed.duration == pytest.approx(2.0 * (1.0 + 0.5), rel=1e-3)
    rests = np.flatnonzero(np.abs(retimed.qd).max(axis=1) == 0.0)
    assert retimed.q[rests] == pytest.approx(there_and_back.q, abs=1e-12)


@pytest.mark.property
@settings(max_examples=max(settings().max_examples // 3, 1))
@given(st.lists(joints, min_size=2, max_size=3), st.lists(st.floats(0.1, 5.0), min_size=2, max_size=2))
def test_the_limits_hold_and_the_path_is_the_same(q: list[list[float]], steps: list[float]) -> None:
    assume(np.abs(np.diff(q, axis=0)).max() > 0.05)
    time = np.concatenate([[0.0], np.cumsum(steps[: len(q) - 1])])
    path = Trajectory.from_arrays(time, q)
    retimed = path.retimed(SPEED, ACCELERATION)
    assert usage(retimed).max() <= 1.0 + 1e-6
    assert np.abs(retimed.qd[[0, -1]]).max() == 0.0
    # Each place is one of the old path, in the same order, and so is what is between them but for some mrad.
    old, _, _ = path.at((time[:-1, None] + np.diff(time)[:, None] * np.linspace(0.0, 1.0, 1500)).ravel())
    new, _, _ = retimed.at(np.linspace(0.0, retimed.duration, 60))
    nearest = [int(np.abs(old - place).max(axis=1).argmin()) for place in new]
    assert max(float(np.abs(old[i] - place).max()) for i, place in zip(nearest, new, strict=True)) < 5e-3
    # No slower than the old timing, faster or slower as a whole, but for what the steps leave.
    times = np.linspace(0.0, path.duration, 5_000)[1:-1]
    _, qd, qdd = path.at(times)
    scale = max(float((np.abs(qd) / SPEED).max()), math.sqrt(float((np.abs(qdd) / ACCELERATION).max())))
    assert retimed.duration <= 1.05 * path.duration * scale


def test_some_limit_is_used_up_most_of_the_time() -> None:
    rng = np.random.default_rng(0)
    q = np.cumsum(rng.uniform(-0.3, 0.3, (8, 6)), axis=0)
    used = usage(Trajectory.from_arrays(np.arange(8.0), q).retimed(SPEED, ACCELERATION))
    assert np.mean(used > 0.9) > 0.8


def test_twice_retimed_is_once_retimed() -> None:
    rng = np.random.default_rng(1)
    q = np.cumsum(rng.uniform(-0.3, 0.3, (3, 6)), axis=0)
    once = Trajectory.from_arrays([0, 1, 2], q).retimed(2.0, 5.0)
    assert once.retimed(2.0, 5.0).duration == pytest.approx(once.duration, rel=0.03)
    # Half the speed and a quarter of the acceleration take twice as long.
    slower = Trajectory.from_arrays([0, 1, 2], q).retimed(1.0, 1.25)
    assert slower.duration == pytest.approx(2.0 * once.duration, rel=0.01)


@pytest.mark.parametrize("bad", [0.0, -1.0, math.nan, [1.0] * 5, "fast"])
def test_limits_that_are_none(bad: object) -> None:
    path = Trajectory.from_arrays([0.0, 1.0], [[0.0] * 6, [1.0] * 6])
    with pytest.raises(BadValue, match="speed"):
        path.retimed(bad, 1.0)  # type: ignore[arg-type]
    with pytest.raises(BadValue, match="acceleration"):
        path.retimed(1.0, bad)  # type: ignore[arg-type]


def test_what_does_not_move_cannot_be_retimed() -> None:
    with pytest.raises(BadValue, match="stays where it is"):
        Trajectory.from_arrays([0.0, 1.0], [READY, READY]).retimed(1.0, 1.0)


# -- along poses ---------------------------------------------------------------------------------------


def test_the_tool_is_where_it_was_wanted() -> None:
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


def test_poses_that_cannot_be_followed() -> None:
    arm = Arm("UR5e")
    start = arm.forward(READY)
    far = start * [0.0, 1.0, 1.0, 1.0, 1.0, 1.0]
    far[0] = 3.0
    with pytest.raises(Unreachable, match="row 1"):
        Trajectory.from_poses([0.0, 1.0], [start, far], arm, READY)
    near = np.array([*READY[:4], -0.05, 0.0])
    tilted = arm.forward([*near[:3], near[3] + 0.5, 0.05, 0.0])
    turned = arm.forward([*near[:3], near[3] - 1.4, 0.05, 2.0])
    with pytest.raises(BadValue, match=r"between points 1 and 2 wrist \d \(joint \d\) leaps"):
        Trajectory.from_poses([0.0, 1.0, 2.0], [arm.forward(near), tilted, turned], arm, near)

"""movel, movep, servoc and movec: straight lines and circles of the tool."""

from __future__ import annotations

import math
from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from linkcore.errors import BadValue
from tests.urlink.simulator.generator.stepping import (
    CYCLE,
    REST,
    UR5E,
    Array,
    check_continuous,
    cycles,
    finish,
    speeds,
    standing,
    trapezoid,
)
from urlink.arm.kinematics import Arm
from urlink.arm.models import MODELS, Model
from urlink.arm.poses import compose, invert
from urlink.simulator.robot.generator import LimitViolation, MotionGenerator, OutOfReach
from urlink.simulator.robot.setpoint_sources import HOME, Setpoint

TOOL = [0.01, -0.02, 0.1, 0.1, 0.2, 0.3]

parts = st.floats(-1.0, 1.0)
triples = st.tuples(parts, parts, parts).map(np.array)
arms = st.sampled_from(list(MODELS.values()))


def with_tool(arm: Model = UR5E) -> MotionGenerator:
    generator = standing(arm=arm)
    generator.tcp = TOOL
    return generator


def pose(q: object, arm: Model = UR5E) -> Array:
    return Arm(arm).forward(np.array(q), TOOL)


def shifted(by: Array, turn: Array, arm: Model = UR5E) -> list[float]:
    """Return the pose of the tool at home, moved in the base frame and turned in the frame of the tool."""
    home = pose(HOME, arm)
    turned = compose(home, np.concatenate([[0, 0, 0], turn]))
    found: list[float] = np.concatenate([home[:3] + by, turned[3:]]).tolist()
    return found


def tool_path(setpoints: list[Setpoint], arm: Model = UR5E) -> Array:
    return np.array([pose(setpoint.q, arm) for setpoint in setpoints])


def turned_by(first: Array, second: Array) -> Array:
    return compose(invert(first), second)[3:]


@pytest.mark.property
@given(arms, triples, triples, st.floats(0.05, 0.25), st.floats(0.3, 1.5), st.sampled_from([0.004, 0.008]))
def test_movel_moves_the_tool_straight(arm: Model, by: Array, turn: Array, v: float, a: float, cycle: float) -> None:
    by, turn = 0.06 * arm.reach * by, 0.25 * turn
    generator = with_tool(arm)
    before = generator.setpoint
    target = shifted(by, turn, arm)
    setpoints = finish(generator, generator.movel(target, a=a, v=v), cycle)
    path = tool_path(setpoints, arm)
    length = max(math.hypot(*by), 0.25 * math.hypot(*turn))
    assert len(setpoints) == pytest.approx(trapezoid(length, v, a) / cycle, abs=1.001)
    start = pose(HOME, arm)
    along = (path[:, :3] - start[:3]) @ by / max(float(by @ by), 1e-300)
    assert np.abs(path[:, :3] - start[:3] - np.outer(along, by)).max() < 1e-6
    # The tool has covered the same fraction of its rotation as of its distance.
    if by @ by > 1e-4:
        middle = len(path) // 2
        np.testing.assert_allclose(turned_by(start, path[middle]), along[middle] * turn, atol=1e-6)
    np.testing.assert_allclose(turned_by(np.array(target), path[-1]), 0.0, atol=1e-6)
    np.testing.assert_allclose(path[-1, :3], target[:3], atol=1e-9)
    assert generator.setpoint.qd == REST
    steps = np.linalg.norm(np.diff(path[:, :3], axis=0), axis=1) / cycle
    assert (steps <= v * (1 + 1e-6)).all()
    check_continuous(before, setpoints, 3.0 * arm.max_acceleration, cycle)


def test_time_overrides_speed_and_acceleration() -> None:
    generator = with_tool()
    setpoints = finish(generator, generator.movel(shifted(np.array([0.1, 0, 0]), np.zeros(3)), a=1.2, v=0.01, t=2.0))
    assert len(setpoints) == pytest.approx(2.0 / CYCLE, abs=1.001)


def test_movel_to_the_current_pose_ends_immediately() -> None:
    generator = with_tool()
    target = pose(HOME).tolist()
    assert len(finish(generator, generator.movel(target))) == 1
    assert len(finish(generator, generator.movel(target, t=1.0))) == 1


@pytest.mark.parametrize("begin", ["movel", "movep", "servoc"])
def test_pose_out_of_reach_is_approached_as_far_as_possible(begin: str) -> None:
    generator = with_tool()
    start = pose(HOME)
    far = [1000.0 * start[0], 1000.0 * start[1], *start[2:].tolist()]
    generator.servoc(far, 1.2, 0.25, 0.0) if begin == "servoc" else getattr(generator, begin)(far)
    with pytest.raises(LimitViolation):
        cycles(generator, 10_000)
    gone = pose(generator.setpoint.q)[:3] - start[:3]
    assert np.linalg.norm(gone) > 0.1
    np.testing.assert_allclose(np.cross(gone, [start[0], start[1], 0.0]), 0.0, atol=1e-6)


@pytest.mark.parametrize("way", [(0.2, 0.1, 0.1), (-0.1, 0.3, 0.0)])
@pytest.mark.parametrize("t", [0.02, 0.05])
def test_too_short_time_is_extended(way: tuple[float, ...], t: float) -> None:
    generator = with_tool()
    target = shifted(np.array(way), np.array([0.0, 0.0, 1.0]))
    setpoints = finish(generator, generator.movel(target, t=t))
    assert t < len(setpoints) * CYCLE < 2.0
    np.testing.assert_allclose(pose(generator.setpoint.q), target, atol=1e-6)
    assert (np.abs(speeds(setpoints)) <= 1.03 * UR5E.max_speed).all()


def test_line_ends_where_it_enters_an_unreachable_region() -> None:
    """The line leads from one side of the base to the other, through the column that no arm can reach."""
    generator = with_tool()
    target = pose(HOME).tolist()
    generator.movel([-target[0], -target[1], *target[2:]], v=0.2)
    with pytest.raises(LimitViolation):
        cycles(generator, 10_000)
    stood = generator.setpoint
    with pytest.raises(LimitViolation):
        generator.advance(CYCLE)
    assert generator.setpoint == stood
    finish(generator, generator.stopj(2.0))
    assert generator.is_standing


@pytest.mark.parametrize("q", [[0.0, -math.pi / 2, 0.0, -math.pi / 2, 0.0, 0.0], [0.0] * 6])
def test_line_from_a_singularity_moves_or_violates_a_limit(q: list[float]) -> None:
    generator = standing(q)
    down = Arm(UR5E).forward(q) - np.array([0, 0, 0.05, 0, 0, 0])
    before, setpoints = generator.setpoint, []
    move = generator.movel(down.tolist())
    with suppress(LimitViolation):
        while not move.is_over:
            setpoints.append(generator.advance(CYCLE))
    check_continuous(before, setpoints, 10.0 * UR5E.max_acceleration)


def test_movep_and_servoc_equal_movel() -> None:
    target = shifted(np.array([0.05, 0.05, 0.0]), np.zeros(3))
    ends = []
    for name in ("movel", "movep", "servoc"):
        generator = with_tool()
        ends.append(
            (len(finish(generator, getattr(generator, name)(target, a=1.0, v=0.1, r=0.0))), generator.setpoint.q)
        )
    assert ends[0] == ends[1] == ends[2]


@pytest.mark.slow
@pytest.mark.property
@given(st.floats(0.2, 6.0), st.floats(0.1, 0.9), triples, st.floats(0.02, 0.06), st.sampled_from([0, 1]))
def test_movec_moves_the_tool_on_a_circle(angle: float, part: float, turn: Array, radius: float, mode: int) -> None:
    """The arc lies on a circle in a tilted plane; the tool turns to an orientation or keeps it relative to the arc."""
    # A tool that keeps its orientation relative to the arc turns by the same angle at the same rate.
    angle, v = (angle, 0.1) if mode == 0 else (min(angle, 1.0), 0.5 * radius)
    generator = with_tool()
    start = pose(HOME)
    x, y = np.array([0.6, 0.0, 0.8]), np.array([0.0, 1.0, 0.0])
    centre = start[:3] - radius * x

    def point(at: float) -> list[float]:
        return (centre + radius * (math.cos(at) * x + math.sin(at) * y)).tolist()  # type: ignore[no-any-return]

    turn = 0.2 * turn
    to = [*point(angle), *shifted(np.zeros(3), turn)[3:]]
    before = generator.setpoint
    move = generator.movec([*point(part * angle), 0.0, 0.0, 0.0], to, v=v, a=0.5, mode=mode)
    setpoints = finish(generator, move, 0.008)
    path = tool_path(setpoints)
    arms = path[:, :3] - centre
    np.testing.assert_allclose(np.linalg.norm(arms, axis=1), radius, atol=1e-6)
    np.testing.assert_allclose(arms @ np.cross(x, y), 0.0, atol=1e-6)
    np.testing.assert_allclose(path[-1, :3], point(angle), atol=1e-9)
    angles = np.unwrap(np.arctan2(arms @ y, arms @ x))
    assert (np.diff(angles) >= -1e-9).all()
    assert angles[-1] - angles[0] == pytest.approx(angle, abs=0.01)
    if mode == 0:
        np.testing.assert_allclose(turned_by(np.array(to), path[-1]), 0.0, atol=1e-6)
        length = max(radius * angle, 0.25 * math.hypot(*turn))
    else:
        # The tool has turned with the arc: relative to the radius of the circle, its orientation is unchanged.
        about = np.concatenate([[0, 0, 0], -angle * np.cross(x, y)])
        undone = compose(about, np.concatenate([[0, 0, 0], path[-1, 3:]]))
        np.testing.assert_allclose(turned_by(start, undone), 0.0, atol=1e-6)
        length = radius * angle
    assert len(setpoints) == pytest.approx(trapezoid(length, v, 0.5) / 0.008, abs=1.001)
    check_continuous(before, setpoints, 3.0 * UR5E.max_acceleration, 0.008)


@given(by=triples, turn=triples)
def test_optimovel_stays_within_the_joint_limits(by: Array, turn: Array) -> None:
    target = shifted(0.3 * by, 0.5 * turn)
    fast, slow = with_tool(), with_tool()
    try:
        setpoints = finish(fast, fast.optimovel(target, 2.0, 1.0, 0.0))
    except LimitViolation:
        # A line that leads out of reach or through a singularity fails at any speed.
        with pytest.raises(LimitViolation):
            finish(slow, slow.movel(target, 0.5, 0.05))
        return
    # optimovel computes its speed from samples of the line.
    assert (np.abs(speeds(setpoints)).max(axis=0) <= 1.02 * UR5E.max_speed).all()


def test_optimovel_is_as_fast_as_the_joints_allow() -> None:
    pose = [-0.0203, 0.363, 0.559, 0.68, -1.083, -2.076]
    generator = standing([-1.57, -1.6, 1.6, -0.7, 0.7, 0.2])
    tops = np.abs(speeds(finish(generator, generator.optimovel(pose, 2.0, 1.0, 0.0)))).max(axis=0) / UR5E.max_speed
    assert 0.8 < tops.max() <= 1.02


def test_movec_rejects_points_on_a_straight_line() -> None:
    generator = with_tool()
    middle, end = (shifted(np.array([d, 0, 0]), np.zeros(3)) for d in (0.05, 0.1))
    for via, to in ((middle, end), (middle, middle), (pose(HOME).tolist(), end), (middle, pose(HOME).tolist())):
        with pytest.raises(OutOfReach, match="are on a straight line"):
            generator.movec(via, to)
    with pytest.raises(BadValue, match="mode"):
        generator.movec(middle, end, mode=2)

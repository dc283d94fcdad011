"""Behaviour of all commands: blends, the speed slider, resuming after a stop, and replacing each other."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from linkcore.errors import BadValue
from tests.urlink.simulator.generator.stepping import (
    CYCLE,
    REST,
    UR5E,
    check_continuous,
    cycles,
    finish,
    positions,
    speeds,
    standing,
    to_rest,
    trapezoid,
)
from urlink.arm.kinematics import Arm
from urlink.arm.models import MODELS, Model
from urlink.simulator.robot.generator import Command, LimitViolation, MotionGenerator, OutOfReach
from urlink.simulator.robot.setpoint_sources import HOME, Setpoint

HARDEST = 2.5 * UR5E.max_acceleration


def moved(*by: float) -> list[float]:
    return [h + d for h, d in zip(HOME, by, strict=True)]


def tool(q: list[float]) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    return Arm(UR5E).forward(q)[:3]


def shifted(x: float, y: float, z: float) -> list[float]:
    pose: list[float] = np.add(Arm(UR5E).forward(HOME), [x, y, z, 0, 0, 0]).tolist()
    return pose


# -- blends --------------------------------------------------------------------------------------


def test_blend_passes_its_corner_at_speed() -> None:
    generator = standing()
    before = generator.setpoint
    corner, target = moved(0.5, 0, 0, 0, 0, 0), moved(0.5, 0.3, 0, 0, 0, 0)
    setpoints = finish(generator, generator.movej(corner, a=3.0, v=1.0, r=0.1))
    assert math.dist(tool(generator.setpoint.q), tool(corner)) <= 0.1
    assert math.dist(tool(setpoints[-2].q), tool(corner)) > 0.1
    near = len(setpoints)
    setpoints += finish(generator, generator.movej(target, a=3.0, v=1.0))
    assert generator.setpoint == (target, REST, REST)
    check_continuous(before, setpoints, HARDEST)
    # The arm never comes to rest, and passes the corner inside the radius.
    assert np.linalg.norm(speeds(setpoints)[near : near + 100], axis=1).min() > 0.3
    closest = min(math.dist(tool(setpoint.q), tool(corner)) for setpoint in setpoints)
    assert 0.0 < closest < 0.1
    assert len(setpoints) * CYCLE < trapezoid(0.5, 1.0, 3.0) + trapezoid(0.3, 1.0, 3.0)


def test_blend_without_a_next_move_ends_at_its_target() -> None:
    for release in (True, False):
        generator = standing()
        target = moved(0.5, 0, 0.2, 0, 0, 0)
        finish(generator, generator.movej(target, r=0.1))
        assert not generator.is_standing
        if release:
            generator.release()
        to_rest(generator)
        assert generator.setpoint == (target, REST, REST)


def test_radius_is_limited_to_half_the_path() -> None:
    generator = standing()
    finish(generator, generator.movej(moved(0.5, 0, 0, 0, 0, 0), r=10.0))
    assert generator.setpoint.q[0] == pytest.approx(0.25, abs=0.01)


def test_movep_rounds_corners_onto_the_next_line() -> None:
    generator = standing()
    before = generator.setpoint
    setpoints = finish(generator, generator.movep(shifted(0.1, 0, 0), a=1.0, v=0.1, r=0.02))
    first = len(setpoints)
    setpoints += finish(generator, generator.movep(shifted(0.1, 0.1, 0), a=1.0, v=0.1, r=0.02))
    second = len(setpoints)
    setpoints += finish(generator, generator.movep(shifted(0.1, 0.1, 0.1), a=1.0, v=0.1))
    check_continuous(before, setpoints, HARDEST)
    path = np.array([tool(setpoint.q) for setpoint in setpoints]) - tool(list(HOME))
    np.testing.assert_allclose(path[-1], 0.1, atol=1e-9)
    assert np.linalg.norm(path[first - 1] - [0.1, 0, 0]) <= 0.02
    # The path is rounded inside both radii, and straight between them.
    straight = (path[:, 1] > 0.021) & (np.arange(len(path)) < second)
    assert straight.sum() > 100
    np.testing.assert_allclose(path[straight][:, [0, 2]] - [0.1, 0.0], 0.0, atol=1e-6)
    # The speed stays about the same along the whole path.
    pace = np.linalg.norm(np.diff(path, axis=0), axis=1) / CYCLE
    assert pace.max() < 0.103
    assert pace[100:-100].min() > 0.06


def test_joint_moves_lines_and_circles_blend() -> None:
    generator = standing()
    before = generator.setpoint
    setpoints = finish(generator, generator.movej(moved(0.3, 0, 0, 0, 0, 0), r=0.03))
    setpoints += finish(generator, generator.movel(shifted(0.05, 0.05, 0.1), r=0.03))
    setpoints += finish(generator, generator.movec(shifted(0.02, 0.02, 0.05), shifted(0, 0, 0), v=0.1, a=0.5, r=0.02))
    setpoints += finish(generator, generator.movej(list(HOME)))
    check_continuous(before, setpoints, HARDEST)
    assert generator.setpoint == (list(HOME), REST, REST)


# -- the speed slider ----------------------------------------------------------------------------


@pytest.mark.parametrize("begin", ["movej", "movel", "movep", "movec"])
def test_slider_scales_path_moves(begin: str) -> None:
    def run(fraction: float) -> list[Setpoint]:
        generator = standing()
        generator.speed_fraction = fraction
        cycles(generator, 100)
        move = {
            "movej": lambda: generator.movej(moved(0.5, 0.1, 0, 0, 0, 0)),
            "movel": lambda: generator.movel(shifted(0.1, 0, 0)),
            "movep": lambda: generator.movep(shifted(0.1, 0, 0)),
            "movec": lambda: generator.movec(shifted(0.05, 0.05, 0), shifted(0.1, 0, 0)),
        }[begin]()
        return finish(generator, move)

    whole, half = run(1.0), run(0.5)
    assert len(half) == pytest.approx(2 * len(whole), abs=2)
    assert np.abs(speeds(half)).max() == pytest.approx(0.5 * np.abs(speeds(whole)).max(), rel=0.01)
    np.testing.assert_allclose(positions(half)[1::2][: len(whole) - 2], positions(whole)[:-2], atol=1e-6)


@pytest.mark.parametrize("begin", ["movej", "movel", "speedj", "speedl"])
def test_moving_the_slider_changes_speed_smoothly(begin: str) -> None:
    generator = standing()
    before = generator.setpoint
    if begin == "movej":
        generator.movej(moved(1.0, 0.2, 0, 0, 0, 0))
    elif begin == "movel":
        generator.movel(shifted(0.1, 0.1, 0), v=0.05)
    elif begin == "speedj":
        generator.speedj([0.2] * 6, 2.0, None)
    else:
        generator.speedl([0.05, 0, 0, 0, 0, 0], 1.0, None, 1.0)
    setpoints = []
    for fraction in (0.5, 0.0, 1.0, 0.2):
        generator.speed_fraction = fraction
        setpoints += cycles(generator, 200)
        if fraction == 0.0:
            assert np.abs(generator.setpoint.qd).max() == 0.0
            assert not generator.is_standing
    check_continuous(before, setpoints, np.full(6, 12.0))


# -- ends and restarts ---------------------------------------------------------------------------


def test_new_command_ends_the_previous_command() -> None:
    generator = standing()
    move = generator.movej(moved(1, 0, 0, 0, 0, 0))
    cycles(generator, 100)
    generator.stopj(2.0)
    assert move.is_over


def test_release_brakes_a_running_motion() -> None:
    generator = standing()
    before = generator.setpoint
    move = generator.movej(moved(1, 0, 0, 0, 0, 0))
    setpoints = cycles(generator, 200)
    generator.release()
    assert move.is_over
    setpoints += to_rest(generator)
    check_continuous(before, setpoints, HARDEST)
    assert 0.0 < generator.setpoint.q[0] < 1.0
    generator.release()
    assert generator.is_standing


def test_generator_that_starts_in_motion_brakes() -> None:
    generator = MotionGenerator(Arm(UR5E), Setpoint(list(HOME), [0.5] * 6, REST))
    assert not generator.is_standing
    to_rest(generator)
    assert generator.setpoint.q[0] > HOME[0]


@pytest.mark.parametrize("begin", ["movej", "movel"])
def test_stopped_move_resumes_and_reaches_its_end(begin: str) -> None:
    generator = standing()
    target = moved(0.5, 0.1, 0, 0, 0, 0)
    pose = shifted(0.1, 0.05, 0)
    move = generator.movej(target, r=0.01) if begin == "movej" else generator.movel(pose)
    cycles(generator, 200)
    stood = [a + 0.05 for a in generator.setpoint.q]
    generator.start(stood)
    before = generator.setpoint
    assert before == (stood, REST, REST)
    setpoints = finish(generator, move) + to_rest(generator)
    check_continuous(before, setpoints, HARDEST)
    if begin == "movej":
        assert generator.setpoint.q == target
    else:
        np.testing.assert_allclose(tool(generator.setpoint.q), pose[:3], atol=1e-9)


@pytest.mark.parametrize("begin", ["speedj", "speedl", "servoj", "nothing"])
def test_other_commands_resume_from_rest(begin: str) -> None:
    generator = standing()
    if begin == "speedj":
        generator.speedj([0.1] * 6, 1.0, None)
    elif begin == "speedl":
        generator.speedl([0.05, 0, 0, 0, 0, 0], 1.0, None, 1.0)
    elif begin == "servoj":
        generator.servoj(moved(0.01, 0, 0, 0, 0, 0), CYCLE, 0.03, 300.0)
    cycles(generator, 10)
    generator.start(generator.setpoint.q)
    check_continuous(generator.setpoint, cycles(generator, 500), HARDEST)


@pytest.mark.parametrize("begin", ["movej", "servoj", "stopj"])
def test_ended_command_does_not_move_the_arm_back(begin: str) -> None:
    generator = standing()
    if begin == "movej":
        generator.movej(moved(0.1, 0, 0, 0, 0, 0))
    elif begin == "servoj":
        generator.servoj(moved(0.01, 0, 0, 0, 0, 0), CYCLE, 0.03, 300.0)
    else:
        generator.stopj(1.0)
    to_rest(generator)
    elsewhere = moved(-0.5, 0, 0, 0, 0, 0)
    generator.start(elsewhere)
    cycles(generator, 10)
    assert generator.setpoint == (elsewhere, REST, REST)
    assert generator.is_standing


def test_command_over_a_limit_ends_when_the_arm_restarts() -> None:
    generator = standing()
    move = generator.servoj(moved(1, 0, 0, 0, 0, 0), CYCLE, 0.03, 300.0)
    for _ in range(3):
        with pytest.raises(LimitViolation):
            generator.advance(CYCLE)
    was_over = move.is_over
    generator.start(generator.setpoint.q)
    assert (was_over, move.is_over) == (False, True)
    cycles(generator, 3)
    assert generator.is_standing


def test_tcp_must_be_six_numbers() -> None:
    generator = standing()
    with pytest.raises(BadValue, match="a TCP"):
        generator.tcp = [0.0] * 5


# -- arbitrary commands in arbitrary cycles ------------------------------------------------------

numbers = st.floats(-1.0, 1.0)
sixes = st.lists(numbers, min_size=6, max_size=6)
rates = st.floats(0.1, 3.0)
radii = st.sampled_from([0.0, 0.01, 0.1])
waits = st.integers(0, 150)
COMMANDS = (
    "movej", "movel", "movep", "movec", "servoc", "servoj", "speedj", "speedl",
    "stopj", "stopl", "release", "slider", "start", "finish",
)  # fmt: skip


def begin(generator: MotionGenerator, name: str, six: list[float], a: float, v: float, r: float) -> Command | None:
    q = [now + 0.5 * part for now, part in zip(generator.setpoint.q, six, strict=True)]
    pose = (Arm(UR5E).forward(generator.setpoint.q) + np.multiply(six, 0.1)).tolist()
    slight = [0.2 * part for part in six]
    if name == "movej":
        return generator.movej(q, a, v, 0.0, r)
    if name == "movel":
        return generator.movel(pose, a, v, 0.0, r)
    if name == "movep":
        return generator.movep(pose, a, v, r)
    if name == "movec":
        return generator.movec([p + 0.03 for p in pose], pose, a, v, r)
    if name == "servoc":
        return generator.servoc(pose, a, v, r)
    if name == "servoj":
        return generator.servoj(
            [now + 0.05 * part for now, part in zip(generator.setpoint.q, six, strict=True)], CYCLE, 0.1, 300.0
        )
    if name == "speedj":
        return generator.speedj(six, a, None)
    if name == "speedl":
        return generator.speedl(slight, a, None, a)
    if name == "stopj":
        return generator.stopj(a)
    if name == "stopl":
        return generator.stopl(a)
    if name == "slider":
        generator.speed_fraction = abs(six[0])
    elif name == "release":
        generator.release()
    elif name == "start" and not any(generator.setpoint.qd):
        generator.start(generator.setpoint.q)
    return None


@pytest.mark.property
@given(st.lists(st.tuples(st.sampled_from(COMMANDS), sixes, rates, rates, radii, waits), max_size=12))
@example(
    [
        ("slider", [5e-324, *REST[1:]], 1.0, 1.0, 0.0, 50),
        ("speedj", [*REST[1:], 0.75], 1.0, 1.0, 0.0, 49),
        ("movej", REST, 1.0, 1.0, 0.0, 0),
    ]
)
@example([("speedj", [0.0, 0.0, 1.0, 0.0, 0.0, 0.0], 0.15625, 1.0, 0.0, 0), *2 * [("finish", REST, 1.0, 1.0, 0.0, 0)]])
def test_motion_stays_smooth_for_any_commands_in_any_cycle(
    sequence: list[tuple[str, list[float], float, float, float, int]],
) -> None:
    """Only the two refusals may be raised, and the speed must never jump by more than an arm could follow."""
    generator = standing()
    before = generator.setpoint
    setpoints: list[Setpoint] = []
    move: Command | None = None
    for name, six, a, v, r, wait in sequence:
        try:
            if name == "finish" and move is not None:
                while not move.is_over and wait < 1000:
                    wait += 1
                    setpoints.append(generator.advance(CYCLE))
            move = begin(generator, name, six, a, v, r) or move
            for _ in range(wait):
                setpoints.append(generator.advance(CYCLE))
        except LimitViolation:
            move = generator.stopj(3.0)
        except OutOfReach:
            pass
    generator.speed_fraction = 1.0
    generator.stopj(3.0)
    refusal = "none"
    try:
        setpoints += to_rest(generator)
    except LimitViolation as violation:  # the joint was about to leave its range, too close to the limit to brake
        refusal = str(violation)
    assert refusal == "none" or "out of range" in refusal
    check_continuous(before, setpoints, 10.0 * UR5E.max_acceleration)
    assert (np.abs(speeds(setpoints)) <= 1.03 * UR5E.max_speed * (1 + 1e-9)).all()


@pytest.mark.property
@given(st.sampled_from(list(MODELS.values())), sixes, sixes, st.floats(0.01, 0.3), st.sampled_from([0.002, 0.008]))
def test_blends_are_smooth_and_end_at_the_target(
    arm: Model, by: list[float], then: list[float], r: float, cycle: float
) -> None:
    generator = standing(arm=arm)
    before = generator.setpoint
    target = [h + d for h, d in zip(HOME, then, strict=True)]
    setpoints = finish(generator, generator.movej(moved(*by), v=2.0, a=5.0, r=r), cycle)
    setpoints += finish(generator, generator.movej(target, v=2.0, a=5.0), cycle)
    check_continuous(before, setpoints, np.full(6, 10.0 + 1e-6), cycle)
    assert (np.abs(speeds(setpoints)) <= 2.0 * (1 + 1e-9)).all()
    assert generator.setpoint == (target, REST, REST)

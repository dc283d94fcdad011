"""Measurement of the payload: fit, plan, limits, consent, and postures that a person chooses."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import urlink
from linkcore.errors import BadValue, Cancelled, LinkTimeout, LocalError
from tests.matrix import trials
from tests.waiting import until
from urlink.arm.arm_file import Estimate
from urlink.arm.kinematics import Arm
from urlink.arm.payload import POSTURES, Rest, fit_currents, fit_sensor, gravity_in
from urlink.arm.vectors import FloatArray
from urlink.motion import payload_measurement as measuring
from urlink.motion.payload_measurement import WristLimits, plan, way
from urlink.robot import Robot
from urlink.simulator import Controller, Still

from .payloads_drawn import START, SensorErrors, draw, drawn_errors, planted

pytestmark = pytest.mark.simulated_time

TIMEOUT = 300.0
ARM = Arm("UR5e")
TCP = np.array([0.0, 0.01, 0.12, 0.0, 0.0, 0.4])
#: Mass in kg and centre in m of the load in the simulator.
MASS, CENTRE = 1.8, (0.01, -0.02, 0.06)
NO_ERRORS = SensorErrors(np.zeros(6), np.zeros(6), (0.0, 0.0), (0.0, 0.0), 0.0)
#: Options that make a measurement fast.
QUICK: dict[str, Any] = {"postures": 6, "speed": 1.0, "acceleration": 2.0, "rest": 0.2}


def limits(wrists: float | FloatArray = 1.2, low: float = -np.inf, high: float = np.inf) -> WristLimits:
    return WristLimits(START, np.broadcast_to(wrists, 3).astype(float), np.full(3, low), np.full(3, high), TCP)


def is_near(estimate: Estimate, truth: float) -> bool:
    """Whether a number is in an interval of twice the width, so that other noise of the simulator does not matter."""
    return abs(estimate.value - truth) <= estimate.high - estimate.low


@pytest.fixture
def arm() -> Iterator[tuple[Controller, Robot]]:
    with (
        Controller("UR5e", "5.11", motion=Still()) as controller,
        urlink.connect(controller.address, stale_after=20.0, silence=30.0) as robot,
    ):
        yield controller, robot


# -- the fit ---------------------------------------------------------------------------------------


@settings(max_examples=25, deadline=None)
@given(
    st.floats(0.2, 20.0),
    st.tuples(*[st.floats(-0.2, 0.2)] * 3),
    st.tuples(st.floats(0.0, 10.0), *[st.floats(-0.2, 0.2)] * 3),
    st.integers(*POSTURES),
)
def test_fit_is_exact_without_errors(
    mass: float, centre: tuple[float, ...], known: tuple[float, ...], postures: int
) -> None:
    unset = mass - known[0], mass * np.array(centre) - known[0] * np.array(known[1:])
    offset = np.array([30.0, -5.0, 70.0, 0.3, -0.2, 0.1])
    drift = np.array([1.0, -2.0, 0.5, 0.1, 0.0, -0.1])
    errors = SensorErrors(offset, drift, (0.0, 0.0), (0.0, 0.0), 0.0)
    rests = planted(ARM, plan(ARM, limits(), postures), TCP, unset, errors, np.random.default_rng(1))
    found = fit_sensor(ARM, rests, TCP, known)
    assert found.mass.value == pytest.approx(mass, abs=1e-6)
    assert [each.value for each in found.cog] == pytest.approx(centre, abs=1e-5)
    # The offset is that of the end of the measurement.
    assert [each.value for each in found.force_offset] == pytest.approx((offset + drift).tolist(), abs=1e-5)


def test_fit_turns_gravity_of_an_arm_on_a_wall() -> None:
    gravity = (9.82, 0.0, 0.0)
    postures = plan(ARM, limits(), 6, gravity)
    rests = planted(ARM, postures, TCP, (0.0, np.zeros(3)), NO_ERRORS, np.random.default_rng(1))
    loaded = []
    for rest, down in zip(rests, gravity_in(ARM, np.array([each.q for each in rests]), gravity), strict=True):
        turn = urlink.poses.rotvec_to_matrix(ARM.forward(rest.q)[3:])
        torque = turn @ np.cross(2.0 * (np.array([0.0, 0.0, 0.1]) - TCP[:3]), down)
        loaded.append(Rest(rest.time, rest.q, np.concatenate((turn @ (2.0 * down), torque)), np.zeros(6)))
    found = fit_sensor(ARM, loaded, TCP, (0.0, 0.0, 0.0, 0.0), gravity)
    mass, centre = found.setting
    assert mass == pytest.approx(2.0)
    assert centre == pytest.approx((0.0, 0.0, 0.1), abs=1e-9)


def test_fit_hysteresis_does_not_bias_the_mass() -> None:
    errors = SensorErrors(np.zeros(6), np.zeros(6), (0.0, 0.0), (0.0, 0.0), 0.05)
    postures = plan(ARM, limits(), 8)
    rests = planted(ARM, [postures[0], *postures], TCP, (4.0, np.zeros(3)), errors, np.random.default_rng(3))[1:]
    # The first rest has no known previous load, so it is the only one that differs.
    rests[0] = planted(ARM, postures, TCP, (4.0, np.zeros(3)), NO_ERRORS, np.random.default_rng(3))[0]
    assert fit_sensor(ARM, rests, TCP, (0.0, 0.0, 0.0, 0.0)).mass.value == pytest.approx(4.0, abs=1e-6)


@pytest.mark.slow
@pytest.mark.matrix
@pytest.mark.parametrize("postures", POSTURES)
def test_intervals_hold_in_95_percent_of_drawn_tools(postures: int) -> None:
    found = draw(trials(40, 200), 45, postures)
    assert found.together >= 0.95 * found.runs
    assert found.unknown <= 0.05 * found.runs
    # Not by being too wide: the mass of 6 postures is known within 0.4 kg at a wander of 1 N.
    assert found.widths[0] < 0.4


def test_centre_is_unknown_without_a_tool() -> None:
    rng = np.random.default_rng(4)
    rests = planted(ARM, plan(ARM, limits(), 6), TCP, (0.0, np.zeros(3)), drawn_errors(rng), rng)
    found = fit_sensor(ARM, rests, TCP, (0.0, 0.0, 0.0, 0.0))
    assert not any(each.is_known for each in found.cog)
    with pytest.raises(BadValue, match=r"the centre of gravity \(x, y, z\) is unknown, because the measured mass"):
        _ = found.setting
    assert "unknown" in str(found)


def test_negative_mass_is_rejected() -> None:
    rests = planted(ARM, plan(ARM, limits(), 6), TCP, (-2.0, np.zeros(3)), NO_ERRORS, np.random.default_rng(1))
    with pytest.raises(BadValue, match="the measured mass is -2 kg; check the payload that is set"):
        fit_sensor(ARM, rests, TCP, (0.0, 0.0, 0.0, 0.0))


@pytest.mark.parametrize(
    ("wrists", "message"),
    [
        # The tool points down, so wrist 3 turns about the direction of gravity.
        ((0.0, 0.0, 1.0), "do not determine the mass, .* tilt the tool by 30 degrees or more"),
        ((0.1, 0.1, 0.1), "do not determine the mass"),
        ((0.5, 0.0, 0.0), "do not determine the centre of gravity along [xyz] of the flange, .* about only one axis"),
        ((1.2, 0.0, 0.0), "do not determine the (mass|centre of gravity along [xyz] of the flange).*; add postures"),
    ],
)
@pytest.mark.parametrize("fit", ["sensor", "currents"])
def test_fit_names_the_undetermined_quantity(wrists: tuple[float, ...], message: str, fit: str) -> None:
    steps = np.linspace(-1.0, 1.0, 8)[:, np.newaxis] * np.array([0.0, 0.0, 0.0, *wrists])
    rests = planted(ARM, list(START + steps), TCP, (2.0, np.zeros(3)), NO_ERRORS, np.random.default_rng(1))
    fits = {
        "sensor": lambda: fit_sensor(ARM, rests, TCP, (0.0, 0.0, 0.0, 0.0)),
        "currents": lambda: fit_currents(ARM, rests, (0.0, 0.0, 0.0, 0.0)),
    }
    with pytest.raises(BadValue, match=message):
        fits[fit]()


# -- the plan --------------------------------------------------------------------------------------


@settings(max_examples=10, deadline=None)
@given(st.tuples(*[st.floats(0.6, 2.0)] * 3), st.floats(0.12, 0.5), st.integers(*POSTURES))
def test_plan_stays_inside_the_limits(wrists: tuple[float, ...], half: float, postures: int) -> None:
    at = ARM.forward(START, TCP)[:3]
    given = WristLimits(START, np.array(wrists), at - half, at + half, TCP)
    try:
        planned = plan(ARM, given, postures)
    except BadValue:
        return
    assert len(planned) == postures
    for begin, end in pairwise([*planned, START]):
        line = begin + np.linspace(0.0, 1.0, 400)[:, np.newaxis] * (end - begin)
        assert (np.abs(line - START)[:, 3:] <= wrists).all()
        assert (np.abs(line - START)[:, :3] == 0.0).all()
        for tool in (TCP, None):
            points = ARM.forward(line, tool)[:, :3]
            assert ((points >= at - half) & (points <= at + half)).all()


def test_way_ends_at_both_postures() -> None:
    line = way(START, START + 0.1)
    assert (line[0] == START).all()
    assert line[-1] == pytest.approx(START + 0.1)


@pytest.mark.parametrize(
    ("given_limits", "message"),
    [
        (limits(0.1), "the limits are too narrow: the postures do not determine the mass"),
        (limits(1.2, 0.0, 0.001), "box does not contain the current posture"),
    ],
)
def test_plan_rejects_limits_that_are_too_narrow(given_limits: WristLimits, message: str) -> None:
    with pytest.raises(BadValue, match=message):
        plan(ARM, given_limits, 6)


# -- automatic -------------------------------------------------------------------------------------


@pytest.mark.slow
def test_measures_and_sets_the_payload_within_limits(arm: tuple[Controller, Robot]) -> None:
    controller, robot = arm
    # An offset of the sensor that turns with the tool: zero it under a push, and then release it.
    controller.push([5.0, -8.0, 12.0, 0.3, -0.2, 0.1])
    robot.zero_force_sensor()
    cycle = controller.cycle
    until(lambda: controller.cycle > cycle + 100, TIMEOUT)
    controller.push([0.0] * 6)
    controller.world.carry(MASS, CENTRE)
    rng = np.random.default_rng(8)
    seen: list[urlink.RealtimeState] = []
    start = robot.realtime.wait()
    at = start.tool_vector_actual[:3]
    box = np.array([at - np.array([0.14, 0.14, 0.02]), at + np.array([0.14, 0.14, 0.25])])

    def wander(number: int) -> None:
        controller.push([*rng.normal(0.0, 0.5, 3), *rng.normal(0.0, 0.05, 3)])

    with robot.realtime.subscribe(seen.append, policy=urlink.block):
        found = robot.measure_payload(0.7, may_move=True, box=box, on_posture=wander, **QUICK)
    controller.push([0.0] * 6)
    assert found.source == "sensor"
    assert is_near(found.mass, MASS)
    assert all(is_near(each, truth) for each, truth in zip(found.cog, CENTRE, strict=True))
    assert 0.1 < found.wander[0] < 1.5
    q = np.array([each.q_actual for each in seen])
    moved = np.abs(q - start.q_actual).max(axis=0)
    assert (moved[3:] <= 0.7).all()
    assert moved[3:].max() > 0.5
    assert (moved[:3] < 1e-3).all()
    tool = np.array([each.tool_vector_actual[:3] for each in seen])
    assert ((tool >= box[0]) & (tool <= box[1])).all()
    assert np.abs(np.array([each.qd_actual for each in seen])).max() < 1.05
    assert q[-1] == pytest.approx(start.q_actual, abs=1e-3)

    robot.set_payload(found)
    state = robot.realtime.wait()
    assert state.payload_mass == pytest.approx(found.mass.value)
    with pytest.raises(BadValue, match="cog was given together with a measured payload"):
        robot.set_payload(found, (0.0, 0.0, 0.0))


def test_refuses_to_move_without_consent(arm: tuple[Controller, Robot]) -> None:
    controller, robot = arm
    with pytest.raises(BadValue, match=r"missing consent; .* the TCP from \[.*\] to \[.*\] m .* may_move=True"):
        robot.measure_payload(1.2)
    assert controller.program_name is None
    assert not robot.realtime.wait().qd_target.any()


def test_cancels_the_motion_when_a_state_exceeds_a_limit(
    arm: tuple[Controller, Robot], monkeypatch: pytest.MonkeyPatch
) -> None:
    controller, robot = arm
    start = np.array(controller.arm.setpoint.q)
    goal = start + np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0])
    monkeypatch.setattr(measuring, "plan", lambda *arguments: [start, goal])
    with pytest.raises(Cancelled, match=r"stopped: wrist 1 is 0\.[0-9]* rad away from its start; at most 0\.3 rad"):
        robot.measure_payload(0.3, may_move=True, **QUICK)
    until(lambda: not any(controller.arm.setpoint.qd), TIMEOUT)
    assert controller.arm.setpoint.q[3] - start[3] < 0.6


def test_refuses_while_a_program_runs(arm: tuple[Controller, Robot]) -> None:
    _, robot = arm
    program = robot.script.run("def waits():\n  sleep(1000)\nend\n")
    until(lambda: program.phase is urlink.Phase.RUNNING, TIMEOUT)
    with pytest.raises(Cancelled, match="a program is running or paused"):
        robot.measure_payload(1.2, may_move=True)
    assert not program.done
    program.cancel()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"postures": 5}, "postures is 5; expected a whole number from 6 to 10"),
        ({"postures": True}, "postures is True"),
        ({"wrists": -0.1}, "wrists is -0.1; expected one angle or three angles"),
        ({"wrists": (1.0, 2.0)}, "wrists is"),
        ({"wrists": math.nan}, "wrists is nan"),
        ({"box": ((0, 0, 0), (1, 1, -1))}, "expected its lower and its upper corner"),
        ({"speed": 5.0}, "speed is 5"),
        ({"acceleration": 0.0}, "acceleration is 0"),
        ({"rest": 0.0}, "rest is 0"),
        ({"timeout": math.inf}, "timeout is inf"),
        ({"gravity": (0.0, 0.0, 0.0)}, "a norm of 5 to 15"),
        ({"set_payload": (-1.0, 0.0, 0.0, 0.0)}, "the mass of set_payload is -1 kg"),
        ({"set_payload": (1.0, 0.0)}, "must be 4 finite numbers"),
        ({"on_posture": 3}, "on_posture"),
    ],
)
def test_bad_arguments_are_rejected(arm: tuple[Controller, Robot], options: dict[str, object], message: str) -> None:
    with pytest.raises(BadValue, match=message):
        arm[1].measure_payload(**{"wrists": 1.0, "may_move": True, **options})  # type: ignore[arg-type]


def test_measures_with_currents_without_a_sensor() -> None:
    with Controller("UR5", "3.15", motion=Still()) as controller, urlink.connect(controller.address) as robot:
        controller.world.carry(3.0, (0.0, 0.0, 0.05))
        with pytest.raises(BadValue, match="missing set_payload; this firmware does not report its payload"):
            robot.measure_payload(1.5, may_move=True, **QUICK)
        found = robot.measure_payload(1.5, may_move=True, set_payload=(0.0, 0.0, 0.0, 0.0), **QUICK)
        assert found.source == "currents"
        assert is_near(found.mass, 3.0)
        # A wrist sensor finds it within a few grams in the simulator.
        assert found.mass.high - found.mass.low > 0.2
        with pytest.raises(BadValue, match="measured without a force sensor"):
            robot.wrench(found)
        with pytest.raises(LocalError, match="a UR5 has no force sensor"):
            robot.measure_payload_by_hand()


# -- by hand ---------------------------------------------------------------------------------------


@pytest.mark.slow
def test_measures_postures_that_a_person_chooses(arm: tuple[Controller, Robot]) -> None:
    controller, robot = arm
    robot.set_payload(MASS, CENTRE)
    numbers = []
    turns = iter(((0, 0, 0, 1, 0, 0), (0, 0, 0, 0, 1, 0), (0, 0, 0, 1, 0, 0), (0, 0, 0, 0, 1, 1), (0, 0, 0, 1, 0, 1)))

    def turn(number: int) -> None:
        numbers.append(number)
        way = next(turns, None)
        if way is None:
            return
        at = np.array(controller.arm.setpoint.q)
        controller.world.push_joints([5.0 * each for each in way])
        until(lambda: float(np.abs(np.array(controller.arm.setpoint.q) - at).max()) > 0.6, TIMEOUT)
        controller.world.push_joints([0.0] * 6)

    found = robot.measure_payload_by_hand(postures=6, rest=0.2, on_posture=turn)
    assert numbers == [1, 2, 3, 4, 5, 6]
    assert is_near(found.mass, MASS)
    assert found.mass.high - found.mass.low < 0.5


def test_by_hand_ends_when_no_new_posture_comes(arm: tuple[Controller, Robot]) -> None:
    controller, robot = arm
    with pytest.raises(LinkTimeout, match="posture 2 of 6 did not come in time: turn the tool by 20 degrees"):
        robot.measure_payload_by_hand(postures=6, rest=0.2, posture_timeout=3.0)
    until(lambda: not controller.is_running_program, TIMEOUT)


# -- asyncio ---------------------------------------------------------------------------------------


@pytest.mark.slow
def test_async_measurement_and_wrench() -> None:
    async def measure() -> None:
        async with urlink.connect_async("sim://ur5e?firmware=5.11&motion=still") as robot:
            robot.controller.world.carry(MASS, CENTRE)
            found = await robot.measure_payload(0.8, may_move=True, **QUICK)
            assert is_near(found.mass, MASS)
            stream = await robot.wrench(found, "base")
            async for wrench in stream:
                assert abs(wrench.force[2]) < 4.0
                assert (wrench.raw == wrench.state.tcp_force).all()
                break
            assert stream.frame == "base"
            assert (await stream.wait()).frame == "base"

    asyncio.run(measure())


def test_async_cancel_stops_the_arm() -> None:
    async def measure() -> None:
        async with urlink.connect_async("sim://ur5e?firmware=5.11") as robot:
            task = asyncio.create_task(robot.measure_payload(1.2, may_move=True, **QUICK))
            await robot.realtime.wait_until(lambda state: state.qd_target.any(), 60.0)
            task.cancel()
            with pytest.raises(asyncio.CancelledError):
                await task
            await robot.realtime.wait_until(lambda state: not state.qd_target.any(), 10.0)
            at = (await robot.realtime.wait()).q_target
            await asyncio.sleep(5.0)
            assert ((await robot.realtime.wait()).q_target == at).all()

    asyncio.run(measure())

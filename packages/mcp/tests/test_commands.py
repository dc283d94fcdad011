"""Checks and order of requests that need consent, without a client."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections.abc import Coroutine, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

import urlink
from packages.mcp.tests.clients import events, is_moving, rests_before, run, turned, until
from tests.fakes.clock import Clock
from urlink_mcp.actions import MoveJoints, MoveToPoint, OfRobot, SetDigitalOutput, prepare, rehearse
from urlink_mcp.commands import Answer, RobotCommands
from urlink_mcp.questions import Question
from urlink_mcp.request_log import Client, RequestLog

pytestmark = [pytest.mark.real_time, pytest.mark.slow]

CLIENT = Client("tester", "1", "stdio")
YES: Answer = ("accept", {"consent": True})


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def expiry(clock: Clock) -> urlink.Expiry:
    expiry = urlink.Expiry(5.0, clock)
    expiry.tick()
    return expiry


@pytest.fixture
def commands(robot: urlink.Robot, clock: Clock, expiry: urlink.Expiry, log: Path) -> Iterator[RobotCommands]:
    how: dict[str, Any] = {"consent_time": 30.0, "motion_time": 60.0, "now": clock}
    with contextlib.closing(RequestLog(log)) as requests:
        commands = RobotCommands("arm", robot, expiry=expiry, log=requests, **how)
        yield commands
        commands.close()


def prepared(commands: RobotCommands, given: OfRobot, tool: str = "move_joints") -> Coroutine[Any, Any, Question]:
    return commands.prepare(CLIENT, tool, given, {})


def answered(commands: RobotCommands, question: Question, answer: Answer = YES) -> Coroutine[Any, Any, dict[str, Any]]:
    return commands.answered(CLIENT, question.id, question.tool, {}, answer)


def test_consent_is_valid_until_its_time(
    commands: RobotCommands, robot: urlink.Robot, clock: Clock, expiry: urlink.Expiry
) -> None:
    async def main() -> None:
        for late, is_moved in ((0.0, True), (0.1, False)):
            question = await prepared(commands, MoveJoints(q=turned(robot, 0.05), speed=0.5))
            # Small steps, because a large step would be an interruption of the process.
            for _ in range(300):
                clock.now += 0.1
                expiry.tick()
            clock.now = question.until + late
            if is_moved:
                assert await answered(commands, question) == {"phase": "done"}
            else:
                with pytest.raises(urlink.LinkTimeout, match="1 s too late"):
                    await answered(commands, question)

    before = robot.realtime.wait(20.0).q_actual[0]
    run(main())
    assert robot.realtime.wait(20.0).q_actual[0] == pytest.approx(before + 0.05, abs=1e-3)


def test_request_and_consent_after_interruption_are_refused(
    commands: RobotCommands, robot: urlink.Robot, clock: Clock
) -> None:
    async def main() -> None:
        request = MoveJoints(q=turned(robot, 0.05))
        question = await prepared(commands, request)
        clock.now += 3.0
        with pytest.raises(urlink.LinkTimeout, match="this process was interrupted"):
            await answered(commands, question)
        with pytest.raises(urlink.LinkTimeout, match="this process was interrupted"):
            await prepared(commands, request)
        assert await commands.stop(CLIENT) == {"phase": "done", "at_rest": True}

    run(main())


def test_second_motion_is_refused_while_one_runs(commands: RobotCommands, robot: urlink.Robot, log: Path) -> None:
    async def main() -> None:
        questions = [await prepared(commands, MoveJoints(q=turned(robot, 1.0), speed=0.1)) for _ in range(2)]
        moving = asyncio.create_task(answered(commands, questions[0]))
        await until(lambda: is_moving(robot))
        with pytest.raises(urlink.LocalError, match=r"tester 1 \(stdio\) is moving the arm"):
            await answered(commands, questions[1])
        await prepared(commands, SetDigitalOutput(number=1, on=True))
        await commands.stop(CLIENT)
        with pytest.raises(urlink.Cancelled):
            await moving

    run(main())
    assert {("stop", "asked"), ("stop", "done"), ("move_joints", "refused or failed")} <= set(events(log))


def test_cancelled_task_stops_motion(commands: RobotCommands, robot: urlink.Robot) -> None:
    async def main() -> None:
        goal = turned(robot, 1.0)
        question = await prepared(commands, MoveJoints(q=goal, speed=0.1))
        moving = asyncio.create_task(answered(commands, question))
        await until(lambda: is_moving(robot))
        moving.cancel()
        with pytest.raises(asyncio.CancelledError):
            await moving
        await rests_before(robot, goal)

    run(main())


def test_task_cancelled_before_start_moves_nothing(commands: RobotCommands, robot: urlink.Robot) -> None:
    release = threading.Event()

    async def main() -> None:
        question = await prepared(commands, MoveJoints(q=turned(robot, 1.0), speed=0.1))
        # The motion waits behind this call for its thread.
        blocked = asyncio.create_task(commands._in_lane("commands", lambda: release.wait(60.0)))
        await asyncio.sleep(0)
        moving = asyncio.create_task(answered(commands, question))
        await asyncio.sleep(0.05)
        moving.cancel()
        with pytest.raises(asyncio.CancelledError):
            await moving
        release.set()
        await blocked
        assert await commands._in_lane("commands", lambda: 1) == 1

    before = robot.realtime.wait(20.0).q_target
    run(main())
    np.testing.assert_array_equal(robot.realtime.wait(20.0).q_target, before)


def test_closed_commands_refuse_requests_but_keep_their_errors(commands: RobotCommands, robot: urlink.Robot) -> None:
    async def main() -> None:
        question = await prepared(commands, MoveJoints(q=turned(robot, 0.1)))
        commands.close()
        with pytest.raises(urlink.Cancelled, match="the server is ending"):
            await answered(commands, question)
        with pytest.raises(urlink.Cancelled, match="the server is ending"):
            await prepared(commands, MoveJoints(q=turned(robot, 0.1)))
        with pytest.raises(urlink.Cancelled, match="the server is ending"):
            await commands.stop(CLIENT)

    run(main())


def test_request_is_refused_if_it_cannot_be_logged(robot: urlink.Robot, log: Path) -> None:
    class Full(RequestLog):
        def check(self) -> None:
            raise urlink.LocalError("the request cannot be logged")

    commands = RobotCommands("arm", robot, expiry=urlink.Expiry(0.0), log=Full(), consent_time=30.0, motion_time=60.0)
    with pytest.raises(urlink.LocalError, match="cannot be logged"):
        run(prepared(commands, MoveJoints(q=turned(robot, 0.1))))
    commands.close()


def test_point_that_changes_after_question_does_not_redirect_motion(
    commands: RobotCommands, robot: urlink.Robot
) -> None:
    robot.motion.move_joints(turned(robot, 0.2), 1.0, wait=60.0)
    robot.points.teach("there", replace=True)
    robot.motion.move_joints(robot.points["home"].q, 1.0, wait=60.0)
    taught = robot.points["there"]

    async def main() -> None:
        question = await prepared(commands, MoveToPoint(point="there", speed=0.5), "move_to_point")
        robot.points.add("there", robot.points["home"], replace=True)
        await answered(commands, question)

    try:
        run(main())
        np.testing.assert_allclose(robot.realtime.wait(20.0).q_actual, taught.q, atol=1e-3)
    finally:
        robot.points.remove("there")


def test_request_is_refused_during_safety_stop() -> None:
    limits = urlink.SessionLimits()
    how: dict[str, Any] = {"consent_time": 30.0, "motion_time": 60.0}
    with urlink.connect("sim://ur5e?firmware=5.11", limits=limits) as robot:
        robot.realtime.wait(20.0)
        robot.controller.faults.protective_stop()
        run(until(lambda: robot.safety.refusal is not None))
        commands = RobotCommands("arm", robot, expiry=urlink.Expiry(0.0), log=RequestLog(), **how)
        for given in (MoveJoints(q=[0.0] * 6), SetDigitalOutput(number=1, on=True)):
            with pytest.raises(urlink.SafetyStop):
                run(prepared(commands, given))
        commands.close()


# -- rehearsal ---------------------------------------------------------------------------------------


def test_rehearse_sends_nothing(robot: urlink.Robot) -> None:
    before = robot.realtime.wait(20.0)
    rehearse(lambda: robot.motion.move_joints(turned(robot, 0.3), 0.5))
    rehearse(lambda: robot.io.set_digital_out(5, True))
    with pytest.raises(urlink.LimitExceeded):
        rehearse(lambda: robot.motion.move_joints(turned(robot, 2.0), 1.5, 3.0))
    with pytest.raises(urlink.LocalError, match="did not notice that it was abandoned"):
        rehearse(lambda: None)
    after = [robot.realtime.wait(20.0) for _ in range(50)][-1]
    np.testing.assert_array_equal(after.q_target, before.q_target)
    assert (robot.motion.current, after.digital_output_bits) == (None, before.digital_output_bits)


def test_rehearse_checks_limits_before_first_state() -> None:
    # The first call on a new connection waits for a state, which must not end the rehearsal.
    limits = urlink.SessionLimits(joint_speed=0.5)
    with urlink.connect("sim://ur5e?firmware=5.11", limits=limits) as robot, pytest.raises(urlink.LimitExceeded):
        rehearse(lambda: robot.motion.move_joints([2.0, -1.5, 2.0, -2.07, -1.57, 0.0], 1.0))


@pytest.mark.property
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(
    q=st.lists(st.floats(-8.0, 8.0) | st.floats(), min_size=4, max_size=7),
    speed=st.floats(0.0, 5.0) | st.floats(),
)
def test_prepare_accepts_no_motion_beyond_limits(shared_robot: urlink.Robot, q: list[float], speed: float) -> None:
    state = shared_robot.realtime.wait(20.0)
    try:
        given = MoveJoints(q=q, speed=speed)
        action = prepare(shared_robot, state, given)
    except (ValidationError, urlink.LocalError):
        return
    assert len(q) == 6
    assert speed <= 3.15
    assert action.sentence.startswith("The joints will turn by up to")
    end = shared_robot.kinematics.forward(q)
    assert np.all(np.abs(end[:2]) <= 1.0)
    assert shared_robot.motion.current is None

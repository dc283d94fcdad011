"""Motions of one command, and the handle that all motions share."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

import pytest

from linkcore.errors import BadValue, Closed, LinkTimeout
from tests.urlink.motion.rehearsal import HOME, PATIENCE, Rehearsal, turned
from tests.waiting import until
from urlink.errors import MotionCancelled, NotEnabled, NotRunning, ProgramStopped, SafetyStop, ScriptFailed
from urlink.interfaces.enums import RobotMode, SafetyMode
from urlink.motion import Motion, MotionPhase

MOVES: list[tuple[Callable[[Rehearsal], Motion], str, str]] = [
    (lambda r: r.motion.move_joints([0] * 6), "move_joints", "movej([0.0, 0.0, 0.0, 0.0, 0.0, 0.0], a=1.4, v=1.05)"),
    (
        lambda r: r.motion.move_joints([0] * 6, 2, 3, time=4),
        "move_joints",
        "movej([0.0, 0.0, 0.0, 0.0, 0.0, 0.0], a=3.0, v=2.0, t=4.0)",
    ),
    (
        lambda r: r.motion.move_linear([0.1, 0.2, 0.3, 0, 0, 1]),
        "move_linear",
        "movel(p[0.1, 0.2, 0.3, 0.0, 0.0, 1.0], a=1.2, v=0.25)",
    ),
    (
        lambda r: r.motion.speed_joints([0.1] * 6),
        "speed_joints",
        "speedj([0.1, 0.1, 0.1, 0.1, 0.1, 0.1], 1.4, 0.5)\n  stopj(1.4)",
    ),
    (
        lambda r: r.motion.speed_linear([0.1, 0, 0, 0, 0, 0], duration=2),
        "speed_linear",
        "speedl([0.1, 0.0, 0.0, 0.0, 0.0, 0.0], 1.2, 2.0)\n  stopl(1.2)",
    ),
    (lambda r: r.motion.stop(), "stop", "stopj(2.0)"),
]


@pytest.mark.parametrize(("move", "name", "text"), MOVES)
def test_sends_one_program_and_ends_with_it(
    robot: Rehearsal, move: Callable[[Rehearsal], Motion], name: str, text: str
) -> None:
    motion = move(robot)
    assert motion.name == name
    assert f"\n  {text}\n" in robot.sent[0]
    assert not motion.done
    assert [robot.motion.current] == [motion]
    told: list[Motion] = []
    motion.add_done_callback(told.append)
    robot.begin()
    robot.finish()
    motion.wait(PATIENCE)
    assert (motion.phase, motion.error, motion.progress) == (MotionPhase.DONE, None, 1.0)
    assert told == [motion]
    motion.add_done_callback(told.append)
    assert told == [motion, motion]
    motion.cancel()
    assert motion.phase is MotionPhase.DONE
    assert [robot.motion.current] == [None]
    assert len(robot.sent) == 1
    assert repr(motion) == f"<Motion {name} done>"


@pytest.mark.parametrize(("move", "name", "text"), MOVES)
def test_nothing_is_sent_while_a_stop_holds(
    robot: Rehearsal, move: Callable[[Rehearsal], Motion], name: str, text: str
) -> None:
    robot.state(safety=SafetyMode.PROTECTIVE_STOP)
    until(lambda: robot.safety.cause)
    with pytest.raises(SafetyStop, match="protective stop"):
        move(robot)
    assert robot.sent == []
    assert robot.motion.current is None


def test_an_arm_that_nobody_enabled_can_be_stopped(robot: Rehearsal) -> None:
    """It may be moving: by a program that went on while the robot could not be heard."""
    running = robot.motion.move_joints([0] * 6)
    robot.begin()
    robot.safety.policy = "always"
    with pytest.raises(NotEnabled):
        robot.motion.move_joints([1] * 6)
    before = len(robot.sent)
    running.cancel()
    assert "stopj(2.0)" in robot.sent[before]
    robot.motion.stop()
    assert "stopj(2.0)" in robot.sent[before + 1]


def test_nothing_is_sent_to_a_robot_that_does_not_run(robot: Rehearsal) -> None:
    robot.state(RobotMode.IDLE)
    until(lambda: not robot.safety.is_enabled)
    with pytest.raises(NotRunning):
        robot.motion.stop()
    assert robot.sent == []


NAN = float("nan")


@pytest.mark.parametrize(
    "call",
    [
        lambda m: m.move_joints([0] * 5),
        lambda m: m.move_joints([0, 0, 0, 0, 0, NAN]),
        lambda m: m.move_joints([0, 0, 7, 0, 0, 0]),
        lambda m: m.move_joints("nought"),
        lambda m: m.move_joints([0] * 6, speed=0),
        lambda m: m.move_joints([0] * 6, speed=9),
        lambda m: m.move_joints([0] * 6, acceleration=-1),
        lambda m: m.move_joints([0] * 6, time=0),
        lambda m: m.move_linear([0] * 7),
        lambda m: m.move_linear([0, 0, 0, 0, 0, float("inf")]),
        lambda m: m.move_linear([0] * 6, speed=NAN),
        lambda m: m.speed_joints([4, 0, 0, 0, 0, 0]),
        lambda m: m.speed_joints([0] * 6, duration=0),
        lambda m: m.speed_linear([None] * 6),
        lambda m: m.stop(0),
        lambda m: m.servo(rate=0),
        lambda m: m.servo(watchdog="soon"),
    ],
)
def test_nonsense_is_refused_before_anything_is_sent(robot: Rehearsal, call: Callable[[object], object]) -> None:
    with pytest.raises(BadValue):
        call(robot.motion)
    assert robot.sent == []


def test_progress_is_the_way_behind(robot: Rehearsal) -> None:
    motion = robot.motion.move_joints(turned(0.4))
    assert motion.progress == 0.0
    robot.q = turned(0.1)
    robot.show()
    assert motion.progress == pytest.approx(0.25)
    robot.q = turned(0.5)
    robot.show()
    assert motion.progress == pytest.approx(0.75)
    with pytest.raises(LinkTimeout, match=r"move_joints is not over within 0\.01 s"):
        motion.wait(0.01)


@pytest.mark.parametrize("timeout", [None, -1, "soon", float("nan")])
def test_waiting_for_no_number_of_seconds(robot: Rehearsal, timeout: object) -> None:
    with pytest.raises(BadValue, match="timeout"):
        robot.motion.stop().wait(timeout)  # type: ignore[arg-type]


def test_superseded(robot: Rehearsal) -> None:
    first = robot.motion.move_joints(HOME)
    robot.begin()
    name = robot.program
    second = robot.motion.move_joints(turned(1))
    with pytest.raises(MotionCancelled, match="move_joints was superseded by move_joints"):
        first.wait(PATIENCE)
    first.cancel()  # without effect: not its arm any more
    assert len(robot.sent) == 2
    robot.key("PROGRAM_XXX_STOPPED", name)
    robot.begin()
    robot.finish()
    second.wait(PATIENCE)


def test_what_is_refused_supersedes_nothing(robot: Rehearsal) -> None:
    first = robot.motion.move_joints(HOME)
    robot.begin()
    with pytest.raises(BadValue):
        robot.motion.move_joints([9] * 6)
    robot.slow.refusal = ConnectionError("not sent")
    with pytest.raises(ConnectionError):
        robot.motion.move_joints(HOME)
    assert not first.done
    robot.finish(_name(robot.sent[0]))
    first.wait(PATIENCE)


def test_what_ended_it_while_another_was_refused_is_not_lost(robot: Rehearsal) -> None:
    first = robot.motion.move_joints(HOME)
    robot.begin()
    first.make_way()
    robot.vanish()
    until(lambda: first._held)
    assert not first.done
    first.go_on()
    with pytest.raises(ProgramStopped):
        first.wait(0)


def _name(text: str) -> str:
    return text.removeprefix("def ").partition("(")[0]


def test_cancelled(robot: Rehearsal) -> None:
    with robot.motion.move_joints(HOME) as motion:
        robot.begin()
    assert motion.phase is MotionPhase.CANCELLED
    with pytest.raises(MotionCancelled, match="was cancelled"):
        motion.wait(0)
    assert "stopj" in robot.sent[-1]


def test_a_stop_ends_it_at_once(robot: Rehearsal) -> None:
    motion = robot.motion.move_joints(HOME)
    robot.begin()
    robot.state(safety=SafetyMode.SAFEGUARD_STOP)
    with pytest.raises(SafetyStop):
        motion.wait(PATIENCE)
    motion.cancel()
    assert len(robot.sent) == 1


def test_stopped_at_the_pendant(robot: Rehearsal) -> None:
    motion = robot.motion.move_joints(HOME)
    robot.begin()
    robot.vanish()
    with pytest.raises(ProgramStopped):
        motion.wait(PATIENCE)
    assert motion.phase is MotionPhase.FAILED


def test_failed_on_the_controller(robot: Rehearsal) -> None:
    motion = robot.motion.move_linear([9, 0, 0, 0, 0, 0])
    robot.begin()
    robot.exception(3, 1, "no inverse kinematics")
    robot.vanish()
    with pytest.raises(ScriptFailed, match="no inverse kinematics"):
        motion.wait(PATIENCE)


def test_awaited(robot: Rehearsal) -> None:
    async def move() -> None:
        motion = robot.motion.move_joints(HOME)
        robot.begin()
        with pytest.raises(asyncio.TimeoutError):
            await asyncio.wait_for(_wrapped(motion), 0.01)
        assert not motion.done  # giving up waiting does not stop the arm
        robot.finish()
        await motion
        cancelled = robot.motion.move_joints(HOME)
        cancelled.cancel()
        with pytest.raises(MotionCancelled):
            await cancelled

    asyncio.run(move())


async def _wrapped(motion: Motion) -> None:
    await motion


def test_speeds_one_after_the_other(robot: Rehearsal) -> None:
    motions = []
    for i in range(50):
        motions.append(robot.motion.speed_joints([i / 100, 0, 0, 0, 0, 0], duration=0.1))
        robot.begin()
        robot.tick()
    assert [motion.done for motion in motions] == [True] * 49 + [False]
    assert all(isinstance(motion.error, MotionCancelled) for motion in motions[:-1])
    assert not any("stopj" in text.split("speedj")[0] for text in robot.sent)
    robot.finish()
    motions[-1].wait(PATIENCE)


def test_time_is_the_progress_of_a_speed(robot: Rehearsal) -> None:
    motion = robot.motion.speed_joints([0] * 6, duration=0.01)
    until(lambda: motion.progress == 1.0)
    assert not motion.done


def test_closed(robot: Rehearsal) -> None:
    motion = robot.motion.move_joints(HOME)
    robot.motion.close()
    robot.motion.close()
    assert motion.phase is MotionPhase.CANCELLED
    with pytest.raises(Closed):
        robot.motion.stop()

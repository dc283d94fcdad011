"""Motions of a single command, and the handle that all motions share."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Callable

import numpy as np
import pytest

from linkcore.errors import BadValue, Cancelled, Closed, ConnectionLost, LinkTimeout
from linkcore.handle import Motion, Phase
from tests.fakes.rehearsal import HOME, TIMEOUT, Rehearsal, turned
from tests.waiting import until
from urlink import Joint
from urlink.arm.kinematics import Arm
from urlink.errors import CompileError, NotEnabled, NotRunning, ProgramStopped, SafetyStop, ScriptFailed
from urlink.protocol.enums import RobotMode, SafetyMode
from urlink.script.wrapping import StartPlace, expiry_marker, start_marker

pytestmark = pytest.mark.simulated_time

MOVES: list[tuple[Callable[[Rehearsal], Motion], str, str]] = [
    (lambda r: r.motion.move_joints([0] * 6), "move_joints", "movej([0.0, 0.0, 0.0, 0.0, 0.0, 0.0], a=1.4, v=1.05)"),
    (
        lambda r: r.motion.move_joints([0] * 6, time=4),
        "move_joints",
        "movej([0.0, 0.0, 0.0, 0.0, 0.0, 0.0], a=1.4, v=1.05, t=4.0)",
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
        lambda r: r.motion.speed_linear([0.1, 0, 0, 0, 0, 0], duration=0.2),
        "speed_linear",
        "speedl([0.1, 0.0, 0.0, 0.0, 0.0, 0.0], 1.2, 0.2)\n  stopl(1.2)",
    ),
    (lambda r: r.motion.stop(), "stop", "stopj(2.0)"),
]


def phase_of(motion: Motion) -> Phase:
    """Return the phase, so that a type checker does not assume that it stays the same."""
    return motion.phase


@pytest.mark.parametrize(("move", "name", "text"), MOVES)
def test_motion_sends_one_program_and_ends_with_program(
    robot: Rehearsal, move: Callable[[Rehearsal], Motion], name: str, text: str
) -> None:
    motion = move(robot)
    assert motion.name == name
    assert f"\n  {text}\n" in robot.sent[0]
    assert not motion.done
    assert phase_of(motion) is Phase.SENT
    assert [robot.motion.current] == [motion]
    notified: list[Motion] = []
    motion.add_done_callback(notified.append)
    robot.begin()
    until(lambda: phase_of(motion) is Phase.RUNNING)
    robot.finish()
    motion.wait(TIMEOUT)
    assert (phase_of(motion), motion.error, motion.progress) == (Phase.DONE, None, 1.0)
    until(lambda: notified == [motion])
    motion.add_done_callback(notified.append)
    until(lambda: notified == [motion, motion])
    sent = len(robot.sent)
    motion.cancel()
    assert phase_of(motion) is Phase.DONE
    assert [robot.motion.current] == [None]
    assert len(robot.sent) == sent
    assert repr(motion) == f"<Motion {name} done>"


@pytest.mark.parametrize(("move", "name", "text"), MOVES)
def test_program_gets_start_permission(
    robot: Rehearsal, move: Callable[[Rehearsal], Motion], name: str, text: str
) -> None:
    """Programs that only bring the arm to rest start without permission."""
    move(robot)
    robot.begin()
    if name == "stop":
        assert len(robot.sent) == 1
        assert "urlink_cycles" not in robot.sent[0]
    else:
        waiting = r"while urlink_cycles < 2500 and not \(read_output_integer_register\(47\) == (\d+)\)"
        asked = re.search(waiting, robot.sent[0])
        assert asked is not None
        assert robot.sent[1:] == [f"sec urlink_permission():\n  write_output_integer_register(47, {asked[1]})\nend\n"]


def test_late_program_gets_no_permission_after_timeout(rehearsal: Callable[..., Rehearsal]) -> None:
    robot = rehearsal(start_timeout=0.2)
    late = robot.motion.move_joints(HOME)
    robot.until(lambda: late.done)
    with pytest.raises(LinkTimeout, match=r"not begin within 0\.2 s.*moves nothing if it begins later.*local control"):
        late.wait(0)
    robot.key("PROGRAM_XXX_STARTED", robot.program)
    robot.text(start_marker(robot.program))
    robot.text("heard")
    after = robot.script.run("sleep(1)")
    robot.begin()
    assert [text.split("(")[0] for text in robot.sent] == [
        f"def {robot.program.rpartition('_')[0]}_1",
        f"def {after.name}",
        "sec urlink_permission",
    ]


def test_cancelled_program_gets_no_permission(robot: Rehearsal) -> None:
    motion = robot.motion.move_joints(HOME)
    name = robot.program
    motion.cancel()
    robot.key("PROGRAM_XXX_STARTED", name)
    robot.text(start_marker(name))
    after = robot.motion.stop()
    robot.begin()
    robot.finish()
    after.wait(TIMEOUT)
    assert not any("urlink_permission" in text for text in robot.sent)


def test_program_without_permission_raises_timeout(robot: Rehearsal) -> None:
    motion = robot.motion.move_joints(HOME)
    robot.key("PROGRAM_XXX_STARTED", robot.program)
    robot.text(expiry_marker(robot.program))
    robot.key("PROGRAM_XXX_STOPPED", robot.program)
    with pytest.raises(LinkTimeout, match=r"got no start permission within 5 s, and has ended without moving the arm"):
        motion.wait(TIMEOUT)


def test_safety_stop_withholds_start_permission(robot: Rehearsal) -> None:
    motion = robot.motion.move_joints(HOME)
    robot.state(safety=SafetyMode.PROTECTIVE_STOP)
    robot.key("PROGRAM_XXX_STARTED", robot.program)
    robot.text(start_marker(robot.program))
    with pytest.raises(SafetyStop):
        motion.wait(TIMEOUT)
    robot.text("heard")
    assert len(robot.sent) == 1


def test_program_starts_at_once_without_permission_place(rehearsal: Callable[..., Rehearsal]) -> None:
    robot = rehearsal(start_place=StartPlace(None, ()), start_timeout=0.2)
    motion = robot.motion.move_joints(HOME)
    assert "urlink_cycles" not in robot.sent[0]
    robot.until(lambda: motion.done)
    with pytest.raises(LinkTimeout, match="if it begins later, the arm might still move"):
        motion.wait(0)


@pytest.mark.parametrize(("move", "name", "text"), MOVES)
def test_safety_stop_prevents_every_motion(
    robot: Rehearsal, move: Callable[[Rehearsal], Motion], name: str, text: str
) -> None:
    robot.state(safety=SafetyMode.PROTECTIVE_STOP)
    until(lambda: robot.safety.cause)
    with pytest.raises(SafetyStop, match="protective stop"):
        move(robot)
    assert robot.sent == []
    assert robot.motion.current is None


def test_disabled_arm_can_be_stopped(robot: Rehearsal) -> None:
    """The arm might be moving, because a program continued while the robot was disconnected."""
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


def test_motion_is_refused_if_robot_is_not_running(robot: Rehearsal) -> None:
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
        lambda m: m.servo(rate=501),
        lambda m: m.servo(speed=0.05),
        lambda m: m.servo(acceleration=[1.0] * 6),
        lambda m: m.servo(jerk=30.0),
        lambda m: m.servo(target_filter="jerk_limited", delay=0.01),
        lambda m: m.move_joints([0] * 6, 0.5, time=2.0),
        lambda m: m.move_joints([0] * 6, acceleration=1.4, time=2.0),
        lambda m: m.move_joints([0] * 6, time=2.0, wait=1e10),
        lambda m: m.move_linear([0.3, 0.2, 0.3, 0, 0, 0], speed=0.25, time=2.0),
        lambda m: m.move_linear([0.3, 0.2, 0.3, 0, 0, 0], acceleration=1.0, time=2.0),
        lambda m: m.servo(watchdog="soon"),
    ],
)
def test_invalid_arguments_are_rejected_before_sending(robot: Rehearsal, call: Callable[[object], object]) -> None:
    with pytest.raises(BadValue):
        call(robot.motion)
    assert robot.sent == []


def test_progress_is_fraction_of_distance(robot: Rehearsal) -> None:
    motion = robot.motion.move_joints(turned(0.4))
    assert motion.progress == 0.0
    robot.q = turned(0.1)
    robot.show()
    assert motion.progress == pytest.approx(0.25)
    robot.q = turned(0.5)
    robot.show()
    assert motion.progress == pytest.approx(0.75)
    with pytest.raises(
        LinkTimeout, match=r"move_joints has not ended within 0\.01 s, and continues; its phase is sent"
    ):
        motion.wait(0.01)
    # The progress of a stop is unknown.
    assert robot.motion.stop().progress == 0.0


@pytest.mark.parametrize("timeout", [None, -1, "soon", float("nan")])
def test_wait_rejects_invalid_timeout(robot: Rehearsal, timeout: object) -> None:
    with pytest.raises(BadValue, match="timeout"):
        robot.motion.stop().wait(timeout)  # type: ignore[arg-type]


def test_cancelling_preempted_motion_sends_no_stop(robot: Rehearsal) -> None:
    first = robot.motion.move_joints(HOME)
    robot.begin()
    name, sent = robot.program, len(robot.sent)
    second = robot.motion.move_linear([0.1, 0.2, 0.3, 0, 0, 0])
    assert robot.motion.current is second
    first.cancel()  # ends the handle without a stop: the arm belongs to the other motion
    assert len(robot.sent) == sent + 1
    robot.key("PROGRAM_XXX_STOPPED", name)
    robot.begin()
    robot.finish()
    second.wait(TIMEOUT)


@pytest.mark.parametrize("is_told", [True, False])
def test_motion_is_preempted_by_next_motion(robot: Rehearsal, is_told: bool) -> None:
    first = robot.motion.move_joints(HOME)
    robot.begin()
    name = robot.program
    second = robot.motion.move_linear([0.1, 0.2, 0.3, 0, 0, 0])
    if is_told:
        robot.key("PROGRAM_XXX_STOPPED", name)
    else:
        robot.begin()
    with pytest.raises(Cancelled, match="move_joints was preempted by move_linear"):
        first.wait(TIMEOUT)
    assert not second.done
    second.cancel()


def test_failed_start_does_not_preempt(robot: Rehearsal) -> None:
    first = robot.motion.move_joints(HOME)
    robot.begin()
    name = robot.program
    with pytest.raises(BadValue):
        robot.motion.move_joints([9] * 6)
    robot.slow.refusal = ConnectionLost("not sent")
    with pytest.raises(ConnectionLost):
        robot.motion.move_joints(HOME)
    second = robot.motion.move_joints(HOME)
    robot.exception(3, 1, "compile_error")
    with pytest.raises(CompileError):
        second.wait(TIMEOUT)
    assert not first.done
    assert robot.motion.current is first
    robot.finish(name)
    first.wait(TIMEOUT)


def test_leaving_block_cancels_motion(robot: Rehearsal) -> None:
    with robot.motion.move_joints(HOME) as motion:
        robot.begin()
    assert motion.phase is Phase.CANCELLED
    with pytest.raises(Cancelled, match="was cancelled"):
        motion.wait(0)
    assert "stopj" in robot.sent[-1]


def test_safety_stop_ends_motion_at_once(robot: Rehearsal) -> None:
    motion = robot.motion.move_joints(HOME)
    robot.begin()
    robot.state(safety=SafetyMode.SAFEGUARD_STOP)
    with pytest.raises(SafetyStop):
        motion.wait(TIMEOUT)
    sent = len(robot.sent)
    motion.cancel()
    assert len(robot.sent) == sent


@pytest.mark.parametrize(
    ("move", "left"),
    [
        (lambda r: r.motion.move_joints(HOME), "the arm might still move until the motion ends"),
        (
            lambda r: r.motion.speed_joints([0.1] * 6, duration=0.3),
            "the arm brakes on its own 0.3 s after the motion started",
        ),
    ],
)
def test_error_of_lost_robot_describes_remaining_motion(
    robot: Rehearsal, move: Callable[[Rehearsal], Motion], left: str
) -> None:
    motion = move(robot)
    robot.begin()
    until(lambda: motion.phase is Phase.RUNNING)
    robot.fast.put(ConnectionLost("pulled"))
    with pytest.raises(NotRunning, match=f"realtime interface is lost.*pulled; {left}"):
        motion.wait(TIMEOUT)


def test_robot_lost_before_start_raises_not_running(robot: Rehearsal) -> None:
    motion = robot.motion.move_joints(HOME)
    robot.fast.put(ConnectionLost("pulled"))
    with pytest.raises(NotRunning, match="pulled; it moves nothing if it begins later"):
        motion.wait(TIMEOUT)
    # The position of the arm is no longer known.
    until(lambda: robot.realtime.latest is None)
    assert motion.progress == 0.0


def test_progress_without_distance_is_complete(robot: Rehearsal) -> None:
    assert robot.motion.move_joints(robot.q).progress == 1.0


def test_progress_ignores_rotation_of_tool(robot: Rehearsal) -> None:
    """One rotation has several rotation vectors."""
    goal = robot.pose.copy()
    goal[0] += 0.1
    goal[3:] *= 1.0 - 2.0 * np.pi / np.linalg.norm(goal[3:])
    motion = robot.motion.move_linear(goal)
    assert motion.progress == 0.0
    goal[0] -= 0.075
    robot.q = Arm("UR5e").inverse(goal, robot.q).tolist()
    robot.show()
    assert motion.progress == pytest.approx(0.25, abs=1e-6)


def test_stop_at_pendant_raises_program_stopped(robot: Rehearsal) -> None:
    motion = robot.motion.move_joints(HOME)
    robot.begin()
    robot.vanish()
    robot.until(lambda: motion.done)
    with pytest.raises(ProgramStopped, match="was stopped early by another client or a person"):
        motion.wait(TIMEOUT)
    assert motion.phase is Phase.FAILED


def test_controller_exception_raises_script_failed(robot: Rehearsal) -> None:
    motion = robot.motion.move_linear([0.4, 0.2, 0.3, 0, 0, 0])
    robot.begin()
    robot.exception(3, 1, "no inverse kinematics")
    robot.vanish()
    with pytest.raises(ScriptFailed, match="no inverse kinematics"):
        motion.wait(TIMEOUT)


def test_motion_can_be_awaited(robot: Rehearsal) -> None:
    async def move() -> None:
        motion = robot.motion.move_joints(HOME)
        robot.begin()
        with pytest.raises(asyncio.TimeoutError):
            await asyncio.wait_for(asyncio.shield(_wrapped(motion)), 0.01)
        assert not motion.done  # a shielded motion continues
        robot.finish()
        await motion
        cancelled = robot.motion.move_joints(HOME)
        cancelled.cancel()
        with pytest.raises(Cancelled):
            await cancelled

    asyncio.run(move())


async def _wrapped(motion: Motion) -> None:
    await motion


def test_consecutive_speeds_preempt_without_stop(robot: Rehearsal) -> None:
    motions = []
    for i in range(50):
        motions.append(robot.motion.speed_joints([i / 100, 0, 0, 0, 0, 0], duration=0.1))
        robot.begin()
        until(lambda: motions[-1].phase is Phase.RUNNING)
        robot.tick()
    assert [motion.done for motion in motions] == [True] * 49 + [False]
    assert all(isinstance(motion.error, Cancelled) for motion in motions[:-1])
    assert not any("stopj" in text.split("speedj")[0] for text in robot.sent)
    # Only the first program waits for permission. The others continue a motion, which would stutter if they waited.
    assert ["urlink_cycles" in text for text in robot.sent if text.startswith("def ")] == [True] + [False] * 49
    robot.finish()
    motions[-1].wait(TIMEOUT)


def test_progress_of_speed_is_elapsed_time(robot: Rehearsal) -> None:
    motion = robot.motion.speed_joints([0] * 6, duration=0.01)
    assert motion.progress == 0.0
    robot.time += 0.004
    assert motion.progress == pytest.approx(0.4)
    robot.time += 1.0
    assert motion.progress == 1.0
    assert not motion.done


def test_close_cancels_motion(robot: Rehearsal) -> None:
    motion = robot.motion.move_joints(HOME)
    robot.programs.close(0.0)
    robot.programs.close(0.0)
    assert motion.phase is Phase.CANCELLED
    assert "stopj" in robot.sent[-1]
    with pytest.raises(Closed):
        robot.motion.stop()


def test_motions_with_goal_end_when_arm_is_moved_in_pause(robot: Rehearsal, monkeypatch: pytest.MonkeyPatch) -> None:
    """Otherwise, the controller would move the arm back onto the path to the goal."""
    watched: list[str] = []
    monkeypatch.setattr("urlink.motion.motions.end_where_moved", lambda life, realtime: watched.append(life.name))
    motion, pose = robot.motion, robot.pose
    motion.move_joints(HOME)
    motion.move_linear(pose)
    motion.move_circular(pose + 0.1 * np.eye(6)[0], pose + 0.1 * np.eye(6)[1])
    motion.path([Joint(HOME)])
    motion.until_contact([0, 0, 1])
    assert watched == ["move_joints", "move_linear", "move_circular", "path", "until_contact"]
    motion.speed_joints([0.1] * 6, duration=0.1)
    motion.stop()
    assert len(watched) == 5

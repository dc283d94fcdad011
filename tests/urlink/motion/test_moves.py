"""Motions of one command, and the handle that all motions share."""

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
    """It changes while a test goes on, which a type checker does not expect of an attribute."""
    return motion.phase


@pytest.mark.parametrize(("move", "name", "text"), MOVES)
def test_sends_one_program_and_ends_with_it(
    robot: Rehearsal, move: Callable[[Rehearsal], Motion], name: str, text: str
) -> None:
    motion = move(robot)
    assert motion.name == name
    assert f"\n  {text}\n" in robot.sent[0]
    assert not motion.done
    assert phase_of(motion) is Phase.SENT
    assert [robot.motion.current] == [motion]
    told: list[Motion] = []
    motion.add_done_callback(told.append)
    robot.begin()
    until(lambda: phase_of(motion) is Phase.RUNNING)
    robot.finish()
    motion.wait(TIMEOUT)
    assert (phase_of(motion), motion.error, motion.progress) == (Phase.DONE, None, 1.0)
    until(lambda: told == [motion])
    motion.add_done_callback(told.append)
    until(lambda: told == [motion, motion])
    sent = len(robot.sent)
    motion.cancel()
    assert phase_of(motion) is Phase.DONE
    assert [robot.motion.current] == [None]
    assert len(robot.sent) == sent
    assert repr(motion) == f"<Motion {name} done>"


@pytest.mark.parametrize(("move", "name", "text"), MOVES)
def test_is_let_go_on_once_it_has_begun(
    robot: Rehearsal, move: Callable[[Rehearsal], Motion], name: str, text: str
) -> None:
    """But for what only brings the arm to rest, which begins whenever it comes."""
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


def test_what_begins_after_its_handle_has_failed_is_not_let_go_on(rehearsal: Callable[..., Rehearsal]) -> None:
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


def test_one_that_was_cancelled_before_it_began_is_not_let_go_on(robot: Rehearsal) -> None:
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


def test_one_that_was_not_let_go_on_in_time_has_ended(robot: Rehearsal) -> None:
    motion = robot.motion.move_joints(HOME)
    robot.key("PROGRAM_XXX_STARTED", robot.program)
    robot.text(expiry_marker(robot.program))
    robot.key("PROGRAM_XXX_STOPPED", robot.program)
    with pytest.raises(LinkTimeout, match=r"got no start permission within 5 s, and has ended without moving the arm"):
        motion.wait(TIMEOUT)


def test_a_stop_between_its_beginning_and_the_permission(robot: Rehearsal) -> None:
    motion = robot.motion.move_joints(HOME)
    robot.state(safety=SafetyMode.PROTECTIVE_STOP)
    robot.key("PROGRAM_XXX_STARTED", robot.program)
    robot.text(start_marker(robot.program))
    with pytest.raises(SafetyStop):
        motion.wait(TIMEOUT)
    robot.text("heard")
    assert len(robot.sent) == 1


def test_without_a_place_for_its_permission_it_begins_at_once(rehearsal: Callable[..., Rehearsal]) -> None:
    robot = rehearsal(start_place=StartPlace(None, ()), start_timeout=0.2)
    motion = robot.motion.move_joints(HOME)
    assert "urlink_cycles" not in robot.sent[0]
    robot.until(lambda: motion.done)
    with pytest.raises(LinkTimeout, match="if it begins later, the arm may still move"):
        motion.wait(0)


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
    with pytest.raises(
        LinkTimeout, match=r"move_joints has not ended within 0\.01 s, and continues; its phase is sent"
    ):
        motion.wait(0.01)
    # Of a stop nobody knows how far it has got.
    assert robot.motion.stop().progress == 0.0


@pytest.mark.parametrize("timeout", [None, -1, "soon", float("nan")])
def test_waiting_for_no_number_of_seconds(robot: Rehearsal, timeout: object) -> None:
    with pytest.raises(BadValue, match="timeout"):
        robot.motion.stop().wait(timeout)  # type: ignore[arg-type]


def test_preempted(robot: Rehearsal) -> None:
    first = robot.motion.move_joints(HOME)
    robot.begin()
    name, sent = robot.program, len(robot.sent)
    second = robot.motion.move_linear([0.1, 0.2, 0.3, 0, 0, 0])
    assert robot.motion.current is second
    first.cancel()  # ends it, and stops nothing: the arm is the other's
    assert len(robot.sent) == sent + 1
    robot.key("PROGRAM_XXX_STOPPED", name)
    robot.begin()
    robot.finish()
    second.wait(TIMEOUT)


@pytest.mark.parametrize("is_told", [True, False])
def test_preempted_when_the_controller_says_so(robot: Rehearsal, is_told: bool) -> None:
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


def test_what_does_not_begin_preempts_nothing(robot: Rehearsal) -> None:
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


def test_cancelled(robot: Rehearsal) -> None:
    with robot.motion.move_joints(HOME) as motion:
        robot.begin()
    assert motion.phase is Phase.CANCELLED
    with pytest.raises(Cancelled, match="was cancelled"):
        motion.wait(0)
    assert "stopj" in robot.sent[-1]


def test_a_stop_ends_it_at_once(robot: Rehearsal) -> None:
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
        (lambda r: r.motion.move_joints(HOME), "the arm may still move until the motion ends"),
        (
            lambda r: r.motion.speed_joints([0.1] * 6, duration=0.3),
            "the arm brakes on its own 0.3 s after the motion started",
        ),
    ],
)
def test_a_robot_that_is_lost_says_what_may_still_move(
    robot: Rehearsal, move: Callable[[Rehearsal], Motion], left: str
) -> None:
    motion = move(robot)
    robot.begin()
    until(lambda: motion.phase is Phase.RUNNING)
    robot.fast.put(ConnectionLost("pulled"))
    with pytest.raises(NotRunning, match=f"realtime interface is lost.*pulled; {left}"):
        motion.wait(TIMEOUT)


def test_a_robot_that_is_lost_before_it_began(robot: Rehearsal) -> None:
    motion = robot.motion.move_joints(HOME)
    robot.fast.put(ConnectionLost("pulled"))
    with pytest.raises(NotRunning, match="pulled; it moves nothing if it begins later"):
        motion.wait(TIMEOUT)
    # Where the arm is, nobody can tell any more.
    until(lambda: robot.realtime.latest is None)
    assert motion.progress == 0.0


def test_one_that_has_nowhere_to_go_is_all_behind(robot: Rehearsal) -> None:
    assert robot.motion.move_joints(robot.q).progress == 1.0


def test_how_the_tool_is_turned_does_not_count_as_way(robot: Rehearsal) -> None:
    """One rotation has more than one vector."""
    goal = robot.pose.copy()
    goal[0] += 0.1
    goal[3:] *= 1.0 - 2.0 * np.pi / np.linalg.norm(goal[3:])
    motion = robot.motion.move_linear(goal)
    assert motion.progress == 0.0
    goal[0] -= 0.075
    robot.q = Arm("UR5e").inverse(goal, robot.q).tolist()
    robot.show()
    assert motion.progress == pytest.approx(0.25, abs=1e-6)


def test_stopped_at_the_pendant(robot: Rehearsal) -> None:
    motion = robot.motion.move_joints(HOME)
    robot.begin()
    robot.vanish()
    robot.until(lambda: motion.done)
    with pytest.raises(ProgramStopped, match="was stopped early by another client or a person"):
        motion.wait(TIMEOUT)
    assert motion.phase is Phase.FAILED


def test_failed_on_the_controller(robot: Rehearsal) -> None:
    motion = robot.motion.move_linear([0.4, 0.2, 0.3, 0, 0, 0])
    robot.begin()
    robot.exception(3, 1, "no inverse kinematics")
    robot.vanish()
    with pytest.raises(ScriptFailed, match="no inverse kinematics"):
        motion.wait(TIMEOUT)


def test_awaited(robot: Rehearsal) -> None:
    async def move() -> None:
        motion = robot.motion.move_joints(HOME)
        robot.begin()
        with pytest.raises(asyncio.TimeoutError):
            await asyncio.wait_for(asyncio.shield(_wrapped(motion)), 0.01)
        assert not motion.done  # what is shielded goes on
        robot.finish()
        await motion
        cancelled = robot.motion.move_joints(HOME)
        cancelled.cancel()
        with pytest.raises(Cancelled):
            await cancelled

    asyncio.run(move())


async def _wrapped(motion: Motion) -> None:
    await motion


def test_speeds_one_after_the_other(robot: Rehearsal) -> None:
    motions = []
    for i in range(50):
        motions.append(robot.motion.speed_joints([i / 100, 0, 0, 0, 0, 0], duration=0.1))
        robot.begin()
        until(lambda: motions[-1].phase is Phase.RUNNING)
        robot.tick()
    assert [motion.done for motion in motions] == [True] * 49 + [False]
    assert all(isinstance(motion.error, Cancelled) for motion in motions[:-1])
    assert not any("stopj" in text.split("speedj")[0] for text in robot.sent)
    # The first asks before it moves the arm. The others go on with what moves, and to ask would make it stutter.
    assert ["urlink_cycles" in text for text in robot.sent if text.startswith("def ")] == [True] + [False] * 49
    robot.finish()
    motions[-1].wait(TIMEOUT)


def test_time_is_the_progress_of_a_speed(robot: Rehearsal) -> None:
    motion = robot.motion.speed_joints([0] * 6, duration=0.01)
    assert motion.progress == 0.0
    robot.time += 0.004
    assert motion.progress == pytest.approx(0.4)
    robot.time += 1.0
    assert motion.progress == 1.0
    assert not motion.done


def test_closed(robot: Rehearsal) -> None:
    motion = robot.motion.move_joints(HOME)
    robot.programs.close(0.0)
    robot.programs.close(0.0)
    assert motion.phase is Phase.CANCELLED
    assert "stopj" in robot.sent[-1]
    with pytest.raises(Closed):
        robot.motion.stop()


def test_which_motions_end_where_the_arm_is_moved_in_a_pause(robot: Rehearsal, monkeypatch: pytest.MonkeyPatch) -> None:
    """Those with a goal: the controller would lead the arm back onto the path to it."""
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

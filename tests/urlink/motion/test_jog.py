"""Jogging: messages to the program on the robot, and the motion that the program makes."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from typing import Any, cast, get_args

import numpy as np
import pytest

from linkcore.errors import BadValue, Cancelled, LinkError, LocalError
from linkcore.handle import Motion, Phase
from tests.fakes.rehearsal import FOLLOW, HOME, STOP, TIMEOUT, WAIT, Rehearsal
from tests.urlink.motion.bench import Bench
from tests.urlink.motion.test_servo import Beside
from tests.waiting import until
from urlink.arm.kinematics import Arm
from urlink.arm.models import model
from urlink.arm.poses import rotvec_to_matrix
from urlink.errors import ProgramStopped, SafetyStop
from urlink.motion import Jog
from urlink.motion.servo.jog import FULL_SPEED, FrameName, _Holding
from urlink.motion.servo.linked_program import LinkedProgram
from urlink.protocol.enums import SafetyMode
from urlink.protocol.firmware import Firmware
from urlink.protocol.realtime.packets import RealtimeState
from urlink.script.links import LINK_ENDED, STARVED, ReverseSocket
from urlink.script.messages import STOP_MESSAGE, WAIT_MESSAGE, read_message, setpoint
from urlink.script.streaming import jogging

_FIRMWARES = [Firmware.parse(each) for each in ("1.8", "3.1", "3.15", "5.11", "5.25")]
_REST = [0.0] * 6


@contextmanager
def opened(robot: Rehearsal, frame: Any = "joints", **options: Any) -> Iterator[Jog]:
    """Open a jog and wait for its connection; cancel it at the end."""
    jog = robot.motion.jog(frame, **options)
    with Beside(robot):
        jog.__enter__()
    yield jog
    jog.cancel()


def answers(robot: Rehearsal) -> Iterator[list[float]]:
    """Yield the speeds that the program receives, state by state, from the first speed."""
    while True:
        robot.tick()
        message = robot.message()
        assert message is not None
        assert message[1] in (FOLLOW, WAIT)
        if message[1] == FOLLOW:
            yield message[0]


class TestMessages:
    @pytest.mark.simulated_time
    def test_speed_expires_after_timeout(self, robot: Rehearsal) -> None:
        with opened(robot, timeout=0.1) as jog:
            moved = robot.time
            jog.move([0.1, 0, 0, 0, 0, -0.2])
            answered = answers(robot)
            lasted = 0
            while (speeds := next(answered)) != _REST:
                assert speeds == pytest.approx([0.1, 0, 0, 0, 0, -0.2])
                lasted += 1
            # 50 states, and possibly one more before the program follows.
            assert 0 < lasted <= 51
            assert robot.time - moved > 0.1 - robot.cycle
            jog.move([0, 0.3, 0, 0, 0, 0])
            assert next(each for each in answered if each != _REST) == pytest.approx([0, 0.3, 0, 0, 0, 0])
            stopped = robot.time
            jog.stop()
            assert next(each for each in answered if each[1] != pytest.approx(0.3)) == _REST
            assert robot.time - stopped < 0.05  # before the speed would have lapsed
        assert jog.phase is Phase.CANCELLED
        while (message := robot.message()) is not None and message[1] != STOP:
            pass
        assert message is not None
        with pytest.raises(Cancelled):
            jog.move(_REST)

    @pytest.mark.parametrize("frame", ["base", "tool"])
    @pytest.mark.simulated_time
    def test_speed_is_converted_to_base_frame(self, robot: Rehearsal, frame: str) -> None:
        robot.q = [0.3, -1.2, 1.4, -1.0, 0.5, 0.7]
        robot.show()
        along, about = [0.1, 0.02, -0.05], [0.3, 0.0, -0.2]
        turned = np.eye(3) if frame == "base" else rotvec_to_matrix(robot.pose[3:])
        with opened(robot, frame) as jog:
            jog.move(along + about)
            assert next(answers(robot)) == pytest.approx([*(turned @ along), *(turned @ about)], abs=1e-6)
            with pytest.raises(BadValue, match=r"the speed in speeds has the length 50 m/s; .* \(in mm/s\?\)"):
                jog.move([0, 0, 50, 0, 0, 0])

    @pytest.mark.parametrize(
        ("frame", "arm", "most", "call"),
        [
            ("joints", "UR10e", model("UR10e").max_speed.tolist(), "speedj("),
            ("joints", "UR9000", [math.tau] * 6, "speedj("),
            ("base", "UR10e", [5.0] * 3 + [10.0] * 3, "speedl("),
            ("tool", "UR10e", [5.0] * 3 + [10.0] * 3, "speedl("),
        ],
    )
    @pytest.mark.simulated_time
    def test_speed_is_limited(
        self, rehearsal: Callable[..., Rehearsal], frame: str, arm: str, most: list[float], call: str
    ) -> None:
        robot = rehearsal(model=arm)
        with opened(robot, frame, timeout=0.25) as jog:
            assert (jog.frame, jog.timeout) == (frame, 0.25)
            assert call in robot.uploaded
            # Until the first speed, messages only show that this computer is connected.
            robot.tick()
            assert robot.message() == (_REST, WAIT)
            if frame == "joints":
                jog.move(most)
                jog.move([-each for each in most])
            for axis in range(6):
                for way in (1.0, -1.0):
                    speeds = list(_REST)
                    speeds[axis] = way * np.nextafter(most[axis], 20.0)
                    named = rf"speeds\[{axis}\]" if frame == "joints" else "turn" if axis > 2 else "speed"
                    with pytest.raises(BadValue, match=named):
                        jog.move(speeds)

    @pytest.mark.parametrize("frame", get_args(FrameName))
    @pytest.mark.simulated_time
    def test_speed_expires_in_every_frame(self, robot: Rehearsal, dialogues: list[Any], frame: FrameName) -> None:
        with opened(robot, frame, timeout=0.25) as jog:
            jog.move([0.1] * 6)
            then, state = robot.context.clock(), robot.context.state()
            for now, is_held in ((then, True), (then + 0.25, True), (np.nextafter(then + 0.25, 999), False)):
                speeds = np.array(read_message(dialogues[0].step(b"", state, now))[0])
                # A rotation between frames keeps the length of both halves.
                lengths = np.linalg.norm(speeds.reshape(2, 3), axis=1)
                assert lengths == pytest.approx([0.1 * math.sqrt(3) if is_held else 0.0] * 2)

    @pytest.mark.simulated_time
    def test_invalid_calls_are_rejected(self, robot: Rehearsal) -> None:
        with pytest.raises(BadValue, match="frame='world'"):
            robot.motion.jog("world")  # type: ignore[arg-type]
        with pytest.raises(LocalError, match=r"within its block: with robot\.motion\.jog\(\) as jog"):
            robot.motion.jog().move(_REST)
        assert robot.sent == []
        with opened(robot) as jog:
            with pytest.raises(BadValue, match=r"speeds\[5\] \(wrist 3\)"):
                jog.move([0, 0, 0, 0, 0, 4.0])
            with pytest.raises(BadValue, match="shape"):
                jog.move([1, 2])

    @pytest.mark.simulated_time
    def test_safety_stop_ends_jog(self, robot: Rehearsal) -> None:
        with opened(robot) as jog:
            jog.move([0.1] * 6)
            robot.state(safety=SafetyMode.PROTECTIVE_STOP)
            with pytest.raises(SafetyStop):
                jog.wait(10)
            with pytest.raises(SafetyStop):
                jog.move([0.1] * 6)


@pytest.mark.simulated_time
def test_ctrl_c_while_a_block_ends_stops_the_arm(robot: Rehearsal, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(program: LinkedProgram) -> None:
        raise KeyboardInterrupt

    with opened(robot) as jog:
        monkeypatch.setattr(LinkedProgram, "finish", interrupted)
        with pytest.raises(KeyboardInterrupt):
            jog.__exit__(None, None, None)
        assert isinstance(jog.error, Cancelled)


class TestHeldSpeeds:
    """Speeds that are held for longer than a program may run without messages."""

    @pytest.mark.real_time
    def test_speed_is_held_for_given_duration(self, robot: Rehearsal) -> None:
        motion = robot.motion.speed_joints([0.3, 0, 0, 0, 0, 0], duration=0.6)
        assert motion.progress == 0.0
        assert "speedj(" in robot.uploaded
        robot.connect()
        began, answered = robot.time, answers(robot)
        assert next(answered) == pytest.approx([0.3, 0, 0, 0, 0, 0])
        robot.time = began + 0.3
        assert next(answered) == pytest.approx([0.3, 0, 0, 0, 0, 0])
        assert 0.4 < motion.progress < 0.6
        while (message := robot.obey()) is not None and message[1] != STOP:
            assert robot.time - began < 0.8
        assert message is not None
        robot.finish()
        motion.wait(TIMEOUT)

    @pytest.mark.real_time
    def test_next_call_changes_speed_without_another_program(self, robot: Rehearsal) -> None:
        motion = robot.motion.speed_joints([0.3, 0, 0, 0, 0, 0], duration=3600.0)
        robot.connect()
        answered = answers(robot)
        next(answered)
        sent = len(robot.sent)
        assert robot.motion.speed_joints([0, 0.2, 0, 0, 0, 0], duration=0.5) is motion
        assert next(each for each in answered if each[0] == 0.0) == pytest.approx([0, 0.2, 0, 0, 0, 0])
        assert len(robot.sent) == sent
        robot.time += 0.5
        while (message := robot.obey()) is not None and message[1] != STOP:
            pass
        assert message is not None  # the last message: any later call needs another program
        assert robot.motion.speed_joints([0, 0.2, 0, 0, 0, 0], duration=5.0) is not motion

    @pytest.mark.parametrize(
        "other",
        [
            lambda m: m.speed_joints([0.1] * 6, 2.0, duration=5.0),
            lambda m: m.speed_linear([0.1, 0, 0, 0, 0, 0], 1.4, duration=5.0),
            lambda m: m.speed_joints([0.1] * 6, duration=0.3),
        ],
        ids=["acceleration", "tool", "short"],
    )
    @pytest.mark.real_time
    def test_speed_call_that_cannot_change_the_motion_preempts_it(
        self, robot: Rehearsal, other: Callable[[Any], Motion]
    ) -> None:
        motion = robot.motion.speed_joints([0.3, 0, 0, 0, 0, 0], duration=5.0)
        robot.connect()
        next(answers(robot))
        assert other(robot.motion) is not motion
        robot.begin()
        until(lambda: motion.done)
        with pytest.raises(Cancelled, match="preempted"):
            motion.wait(TIMEOUT)

    @pytest.mark.real_time
    def test_safety_stop_refuses_next_call(self, robot: Rehearsal) -> None:
        motion = robot.motion.speed_joints([0.3, 0, 0, 0, 0, 0], duration=5.0)
        robot.connect()
        next(answers(robot))
        robot.state(safety=SafetyMode.PROTECTIVE_STOP)
        until(lambda: motion.done)
        with pytest.raises(SafetyStop):
            robot.motion.speed_joints([0.3, 0, 0, 0, 0, 0], duration=5.0)

    @pytest.mark.simulated_time
    def test_next_call_is_refused_until_enabled_again(self, robot: Rehearsal) -> None:
        motion = robot.motion.speed_joints([0.3, 0, 0, 0, 0, 0], duration=5.0)
        robot.safety.policy = "always"
        with pytest.raises(LinkError, match="enable"):
            robot.motion.speed_joints([0.0, 0.3, 0, 0, 0, 0], duration=5.0)
        motion.cancel()

    @pytest.mark.simulated_time
    def test_early_program_end_fails_motion(self, robot: Rehearsal) -> None:
        motion = robot.motion.speed_joints([0.3, 0, 0, 0, 0, 0], duration=5.0)
        robot.connect()
        robot.finish()
        with pytest.raises(ProgramStopped, match="ended unexpectedly"):
            motion.wait(TIMEOUT)


def test_held_speed_ends_after_duration() -> None:
    holding = _Holding(nullcontext(), lambda link: [], np.array([0.3] * 6), 0.5, None)
    state = cast(RealtimeState, None)
    for now, is_over in ((10.0, False), (10.25, False), (10.499, False), (10.5, True)):
        assert read_message(holding.step(b"", state, now))[0] == [0.3] * 6
        assert holding.is_over is is_over
    assert holding.change(np.array([0.1] * 6), 2.0) is False
    assert read_message(holding.step(b"", state, 10.5))[0] == [0.3] * 6


def test_changed_speed_restarts_duration() -> None:
    holding = _Holding(nullcontext(), lambda link: [], np.array([0.3] * 6), 0.5, None)
    state = cast(RealtimeState, None)
    assert holding.part(9.0) == 0.0
    assert holding.change(np.array([0.3] * 6), 0.5) is True
    holding.step(b"", state, 10.0)
    assert holding.part(10.25) == 0.5
    assert holding.change(np.array([0.1] * 6), 2.0) is True
    assert holding.part(10.25) == 0.0
    assert read_message(holding.step(b"", state, 11.0))[0] == [0.1] * 6
    assert holding.part(12.0) == 0.5


def test_full_speed_equals_vendor_defaults() -> None:
    """Vendor defaults exist for `movej` (rad/s of the leading joint) and `movel` (m/s), not for turning the tool."""
    assert FULL_SPEED["joints"] == (1.05,) * 6
    frames: list[FrameName] = ["base", "tool"]
    for frame in frames:
        assert FULL_SPEED[frame] == (0.25, 0.25, 0.25, 0.8, 0.8, 0.8)


def bench(firmware: Firmware, is_tool: bool = False) -> Bench:
    program = jogging(firmware, ReverseSocket("10.0.0.1", 50001, 7), is_tool=is_tool, acceleration=2.0, watchdog=0.1)
    made = Bench(program, firmware)
    made.run(3, lambda: made.deliver(WAIT_MESSAGE))
    assert made.path[-1] == list(HOME)
    return made


def send_speeds(bench: Bench, speeds: list[float], seconds: float) -> None:
    bench.run(round(seconds / bench.period), lambda: bench.deliver(setpoint(speeds, _REST)))


@pytest.mark.parametrize("firmware", _FIRMWARES, ids=str)
class TestProgram:
    def test_speed_changes_at_limited_acceleration(self, firmware: Firmware) -> None:
        jogged = bench(firmware)
        for speed in (0.4, -0.4, 0.0):
            send_speeds(jogged, [0, 0, 0, 0, 0, speed], 0.6)
            assert jogged.motion.setpoint.qd[5] == pytest.approx(speed, abs=1e-9)
        speeds = np.diff(np.array(jogged.path)[:, 5]) / jogged.period
        assert np.abs(np.diff(speeds)).max() / jogged.period <= 2.0 + 1e-6
        jogged.deliver(STOP_MESSAGE)
        jogged.run(firmware.rate // 5)
        assert jogged.has_finished
        assert jogged.said == []

    def test_program_brakes_without_messages(self, firmware: Firmware) -> None:
        starved, cut = bench(firmware), bench(firmware)
        for jogged, text in ((starved, STARVED), (cut, LINK_ENDED)):
            send_speeds(jogged, [0, 0, 0, 0, 0, 0.4], 0.4)
            if jogged is cut:
                jogged.sockets.is_open = False
            jogged.run(round(0.5 / jogged.period))
            assert jogged.said == [text]
            assert jogged.motion.is_standing
        # 0.4 rad/s for 0.1 s, with a tolerance for braking.
        way = starved.path[-1][5] - cut.path[-1][5]
        assert way == pytest.approx(0.04, abs=0.4 * 4 * starved.period)


@pytest.mark.parametrize("firmware", [_FIRMWARES[2], _FIRMWARES[4]], ids=str)
def test_tool_moves_in_a_straight_line(firmware: Firmware) -> None:
    jogged = bench(firmware, is_tool=True)
    kinematics = Arm(jogged.model)
    before = kinematics.forward(HOME)
    send_speeds(jogged, [0, 0, -0.1, 0, 0, 0], 0.5)
    after = kinematics.forward(jogged.path[-1])
    # The tool reaches its speed in 0.05 s.
    assert after[:3] - before[:3] == pytest.approx([0, 0, -0.0475], abs=0.1 * 3 * jogged.period)
    # Compare matrices, because a turn by pi about an axis and about its opposite is the same.
    assert rotvec_to_matrix(after[3:]) == pytest.approx(rotvec_to_matrix(before[3:]), abs=1e-6)


@pytest.mark.simulated_time
def test_repeated_moves_use_one_program(rehearsal: Callable[..., Rehearsal]) -> None:
    robot = rehearsal("3.15", "UR5", link="rtde")
    with opened(robot, link="rtde") as jog:
        for _ in range(20):
            jog.move([0.1] * 6)
        assert next(answers(robot)) == pytest.approx([0.1] * 6)
        assert len(robot.sent) == 1

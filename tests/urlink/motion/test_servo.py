"""Servo loops; the test plays the robot."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from linkcore.errors import BadValue, Cancelled, Closed, ConnectFailed, ConnectionLost, LocalError
from linkcore.handle import Phase
from tests.fakes.rehearsal import FOLLOW, HOME, STOP, Rehearsal, turned
from tests.urlink.motion.bench import PLAYING
from tests.waiting import until
from urlink.arm.models import model
from urlink.errors import ProgramStopped, SafetyStop
from urlink.motion import Servo, ServoStatistics
from urlink.motion.moves.speed_limit import largest_speeds
from urlink.motion.moves.trajectory import Trajectory
from urlink.motion.servo.resampling import ResampledSetpoints
from urlink.motion.servo.servo import _Leading
from urlink.motion.servo.setpoints import Servoing
from urlink.protocol.enums import SafetyMode
from urlink.protocol.firmware import Firmware
from urlink.protocol.realtime.packets import RealtimeState
from urlink.script.messages import WAIT_MESSAGE

pytestmark = pytest.mark.simulated_time


class Beside:
    """The robot's side at the start and the end of a block, while the thread of the test waits in the block."""

    def __init__(self, robot: Rehearsal) -> None:
        self._robot = robot
        self._sent = len(robot.sent)
        self._thread = threading.Thread(target=self._run)
        self.over = threading.Event()

    def _run(self) -> None:
        until(lambda: len(self._robot.sent) > self._sent)
        self._robot.connect()
        while not self.over.wait(0.002):
            self._robot.tick()

    def __enter__(self) -> Beside:
        self._thread.start()
        return self

    def __exit__(self, *exc: object) -> None:
        self.over.set()
        self._thread.join()


@contextmanager
def opened(robot: Rehearsal, **options: Any) -> Iterator[Servo]:
    """Open a servo and wait for its connection; at the end, its program ends when it receives a stop."""
    servo = robot.motion.servo(**options)
    with Beside(robot):
        servo.__enter__()
    yield servo
    if not servo.done:
        ended = threading.Thread(target=servo.__exit__)
        ended.start()
        while (message := robot.message()) is not None and message[1] != STOP:
            pass
        robot.finish()
        ended.join()


def next_set_point(robot: Rehearsal) -> list[float]:
    while True:
        message = robot.message()
        assert message is not None
        if message[1] == FOLLOW:
            return message[0]


@pytest.mark.parametrize(("firmware", "arm"), [("1.8", "UR5"), ("3.4", "UR5"), ("5.11", "UR5e")])
def test_servo_sends_given_set_points(rehearsal: Callable[..., Rehearsal], firmware: str, arm: str) -> None:
    robot = rehearsal(firmware, arm)
    with opened(robot) as servo:
        assert servo.rate == robot.firmware.rate
        for i in range(10):
            servo.send(turned(0.001 * i))
            assert next_set_point(robot) == pytest.approx(turned(0.001 * i), abs=1e-6)
    assert servo.phase is Phase.DONE
    assert robot.message() is None
    assert len(robot.sent) == 1
    with pytest.raises(Closed, match="was left"):
        servo.send(HOME)
    with pytest.raises(LocalError, match="used before"):
        servo.__enter__()


def test_servo_rejects_calls_outside_block(led: Rehearsal) -> None:
    servo = led.motion.servo()
    calls: list[Callable[[], object]] = [
        lambda: servo.send(HOME),
        lambda: servo.schedule(HOME, at=0.0),
        servo.measure_delay,
    ]
    for tell in calls:
        with pytest.raises(LocalError, match="within its block"):
            tell()
    assert led.sent == []


def test_statistics_count_late_set_points(led: Rehearsal) -> None:
    """The loop should send every 2 ms, and sends every tenth set-point 2 ms late."""
    with opened(led, watchdog=5.0) as servo:
        assert servo.stats == ServoStatistics(0, 0.0, 0.0, 0.0, 0.0, 0)
        for n in range(101):
            servo.send(HOME)
            led.time += 0.004 if n % 10 == 9 else 0.002
        stats = servo.stats
    assert (stats.count, stats.late) == (101, 10)
    assert stats.mean == pytest.approx(0.0022)
    assert stats.p50 == pytest.approx(0.0, abs=1e-9)
    assert stats.max == pytest.approx(0.002)
    assert stats.p99 == pytest.approx(0.002)


def test_interval_is_late_beyond_one_and_a_half_periods(robot: Rehearsal) -> None:
    """Quantiles are for the newest intervals, but counts are for all intervals."""
    with opened(robot, rate=2.0, watchdog=5.0) as servo:
        for interval in (0.5, 0.75, 0.25, 0.8125, 0.5):
            servo.send(HOME)
            robot.time += interval
        servo.send(HOME)
        stats = servo.stats
    assert (stats.count, stats.late, stats.max) == (6, 1, 0.3125)
    assert stats.mean == pytest.approx(2.8125 / 5)
    assert stats.p50 == 0.25
    assert 0.25 < stats.p99 < 0.3125


def test_median_of_deviations_from_interval(robot: Rehearsal) -> None:
    with opened(robot, rate=2.0, watchdog=5.0) as servo:
        for interval in (0.5, 0.625, 0.75, 0.875):
            servo.send(HOME)
            robot.time += interval
        servo.send(HOME)
        assert servo.stats.p50 == pytest.approx(0.1875)


def test_statistics_of_long_loop_use_newest_intervals(robot: Rehearsal, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("urlink.motion.servo.servo._REMEMBERED", 2)
    with opened(robot, rate=2.0, watchdog=5.0) as servo:
        for interval in (2.0, 0.5, 0.75):
            servo.send(HOME)
            robot.time += interval
        servo.send(HOME)
        assert (servo.stats.count, servo.stats.late, servo.stats.max) == (4, 1, 0.25)


def test_set_point_carries_speed(led: Rehearsal, dialogues: list[Any]) -> None:
    with opened(led) as servo:
        for q, seconds, speed in ((0.03, 0.0, 0.0), (0.032, 0.004, 0.5), (0.033, 0.0, 0.5), (0.031, 0.002, 0.0)):
            led.time += seconds
            servo.send(turned(q))
            assert next_set_point(led) == pytest.approx(turned(q))
            assert led.speeds == pytest.approx([0.0] * 5 + [speed], abs=1e-6)
        # From now on, only the loop sends messages.
        assert dialogues[0].step(b"", led.context.state(), led.time) == b""


def test_burst_after_delay_causes_no_speed_peak(led: Rehearsal) -> None:
    """The loop moves at 0.15 rad/s. Its first set-point after 60 ms is from before the delay."""
    speeds = []
    with opened(led) as servo:
        for n in range(60):
            led.time += 0.06 if n == 29 else -0.0004 if n == 30 else 0.0
            led.show()  # 2 ms later
            servo.send(turned(0.15 * (0.002 * n + (0.06 if n >= 30 else 0.0))))
            next_set_point(led)
            speeds.append(led.speeds[5])
    assert speeds[:29] == pytest.approx([0.0, *[0.15] * 28], abs=1e-6)
    assert min(speeds[29:]) > 0.0
    assert max(speeds[29:]) < 0.151


def test_speed_uses_only_recent_set_points(robot: Rehearsal, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("urlink.motion.servo.servo.LONGEST_PERIOD", 0.25)
    servo = robot.motion.servo()

    def speeds(*sent: tuple[float, float]) -> list[float]:
        found, before = [], None
        for at, q in sent:
            found.append(servo._speeds(before, turned(q), at)[5])
            before = turned(q)
        return found

    # Set-points of the last 0.25 s count, and an earlier one if they cover less time.
    assert speeds((0.0, 0.0), (0.125, 0.1), (0.25, 0.2), (0.375, 0.4)) == pytest.approx([0.0, 0.8, 0.8, 0.3 / 0.25])
    assert speeds((0.0, 0.0), (0.125, 0.0), (0.5, 0.3)) == pytest.approx([0.0, 0.0, 0.3 / 0.375])


def leading(resampled: ResampledSetpoints | None = None) -> _Leading:
    return _Leading(Servoing(Firmware.parse("5.11"), largest_speeds(model("UR5e")), 0.1, 0.03, 300.0), resampled)


def seen(time: float, scaling: float = 1.0, q: float = 0.0) -> RealtimeState:
    state = SimpleNamespace(**{**PLAYING, "time": time, "speed_scaling": scaling, "q_target": np.array(turned(q))})
    return cast(RealtimeState, state)


def test_program_waits_until_loop_sends() -> None:
    servo = leading()
    assert servo.step(b"", seen(50.0, q=0.3), 1000.0) == WAIT_MESSAGE
    assert servo.here == turned(0.3)
    servo.is_mute = True
    assert servo.step(b"", seen(50.002, q=0.4), 1000.002) == b""
    assert servo.here == turned(0.3)


def test_program_time_follows_scaling() -> None:
    servo = leading()
    assert servo.program_time(999.0) == 999.0
    servo.step(b"", seen(50.0), 1000.0)
    servo.step(b"", seen(50.25, 0.5), 1000.25)  # three quarters on average
    assert servo.program_time(1000.25) == pytest.approx(1000.25 - 0.0625)
    assert servo.program_time(1000.5) == pytest.approx(1000.5 - 0.0625 - 0.125)
    assert servo.program_time(1000.0) == pytest.approx(1000.0 - 0.0625)  # time does not run backwards
    servo.step(b"", seen(50.75, 0.5), 1000.75)
    assert servo.program_time(1000.75) == pytest.approx(1000.75 - 0.0625 - 0.25)
    # A state from the past counts as one cycle; for the program, half of it passes.
    servo.step(b"", seen(40.0, 0.5), 1000.75)
    assert servo.program_time(1000.75) == pytest.approx(1000.75 - 0.0625 - 0.25 - 0.001, abs=1e-9)


def test_program_time_starts_slowly_after_pause() -> None:
    servo = leading()
    servo.step(b"", seen(50.0), 1000.0)
    servo.resume(seen(60.0, q=0.2))
    assert not servo.begins_anew  # it had not begun
    servo.is_mute = True
    servo.resume(seen(60.0, q=0.3))
    assert (servo.here, servo.begins_anew) == (turned(0.3), True)
    servo.step(b"", seen(60.0), 1010.0)
    assert servo.program_time(1010.0) == pytest.approx(1000.0)
    assert servo.program_time(1011.0) == pytest.approx(1000.0)  # with the first state, no time passes
    servo.step(b"", seen(60.08), 1010.08)
    assert servo.program_time(1010.08) == pytest.approx(1000.0 + 0.5 * 0.5 * 0.08)


def test_source_of_set_points_is_notified_of_pause() -> None:
    resumed: list[RealtimeState] = []
    resampled = SimpleNamespace(resume=resumed.append)
    servo, state = leading(cast(ResampledSetpoints, resampled)), seen(60.0)
    servo.is_mute = True
    servo.resume(state)
    assert resumed == [state]
    assert not servo.begins_anew


def test_loop_restarts_after_pause(robot: Rehearsal, dialogues: list[Any]) -> None:
    with opened(robot) as servo:
        for n in range(5):
            servo.send(turned(0.001 * n))
            assert next_set_point(robot) == pytest.approx(turned(0.001 * n))
            robot.time += 0.002
        dialogues[0].resume(seen(robot.time, q=0.3))
        with pytest.raises(BadValue, match=r"from the position of the arm; at most 0\.0500 rad"):
            servo.send(turned(0.005))
        for q, speed in ((0.3, 0.0), (0.301, 0.5)):
            servo.send(turned(q))
            assert next_set_point(robot) == pytest.approx(turned(q))
            assert robot.speeds[5] == pytest.approx(speed, abs=1e-6)
            robot.time += 0.002


def test_scaling_is_from_newest_state(robot: Rehearsal) -> None:
    servo = robot.motion.servo()
    for scaling in (0.4, 1.0):
        robot.scaling = scaling
        robot.tick()
        until(lambda scaling=scaling: servo.scaling == scaling)  # type: ignore[misc]


def test_first_set_point_is_near_and_all_are_in_range(led: Rehearsal) -> None:
    led.q = turned(2 * np.pi - 0.05)
    led.show()
    with opened(led) as servo:
        with pytest.raises(BadValue, match=r"from the position of the arm; at most 0\.0500 rad"):
            servo.send(turned(2 * np.pi - 0.1001))
        with pytest.raises(
            BadValue, match=r"q\[5\] \(wrist 3\) is 6\.28319 rad; expected a number from -6\.28319 to 6\.28319 rad"
        ):
            servo.send(turned(np.nextafter(2 * np.pi, 7)))
        servo.send(turned(2 * np.pi))
    led.q = turned(0.0)
    led.show()
    with opened(led) as servo:
        with pytest.raises(BadValue, match="from the position of the arm"):
            servo.send(turned(np.nextafter(-0.05, -1)))
        servo.send(turned(-0.05))


def test_unknown_arm_has_no_joint_range(rehearsal: Callable[..., Rehearsal]) -> None:
    robot = rehearsal(model="UR9000")
    with opened(robot, target_filter="jerk_limited") as servo:
        for target in ([100.0] * 6, [-100.0] * 6):
            servo.send(target)
        with pytest.raises(BadValue, match="not finite"):
            servo.send([float("inf")] * 6)


def test_coasting_time_of_servo_depends_on_its_rate(robot: Rehearsal) -> None:
    """The program coasts for a tenth of a second, or for three periods of a slower loop."""
    for options, cycles in (
        ({}, 50),
        ({"rate": 4.0}, 375),
        ({"rate": 4.0, "target_filter": "jerk_limited"}, 50),
    ):
        with opened(robot, watchdog=5.0, **options):
            assert f"if missed < {cycles}:" in robot.uploaded
            assert "elif missed < 2500:" in robot.uploaded
    robot.show()
    motion = robot.motion.follow(Trajectory.from_arrays([0.0, 1.0], [HOME, turned(0.1)]), watchdog=5.0)
    assert "if missed < 50:" in robot.uploaded
    motion.cancel()


def test_too_fast_set_point_is_rejected_and_loop_continues(led: Rehearsal) -> None:
    with opened(led) as servo:
        for n in range(10):
            servo.send(turned(0.001 * n))
            led.time += 0.002
        with pytest.raises(BadValue, match=r"q\[5\].*0\.0100 rad from the last set-point; at most 0\.0094 rad"):
            servo.send(turned(0.019))
        servo.send(turned(0.015))
        assert servo.stats.count == 11


def test_small_steps_without_time_between_are_too_fast(led: Rehearsal) -> None:
    with opened(led) as servo:
        for n in range(3):  # at 3.14 rad/s, for the 2 ms of a cycle and the millisecond that a set-point may be early
            servo.send(turned(0.004 * n))
        with pytest.raises(BadValue, match=r"0\.0040 rad from the last set-point; at most"):
            servo.send(turned(0.012))
        led.time += 0.002
        servo.send(turned(0.012))


@pytest.mark.parametrize(
    ("q", "message"),
    [
        ([0] * 5, "shape"),
        (turned(float("nan")), "not finite"),
        (turned(0.1), r"0\.1000 rad from the position of the arm; at most 0\.0500"),
    ],
)
def test_invalid_first_set_point_is_rejected(led: Rehearsal, q: list[float], message: str) -> None:
    with opened(led) as servo:
        with pytest.raises(BadValue, match=message):
            servo.send(q)
        assert servo.stats.count == 0
        servo.send(HOME)
        assert next_set_point(led) == pytest.approx(HOME, abs=1e-6)


def test_jump_is_rejected(led: Rehearsal) -> None:
    with opened(led) as servo:
        servo.send(HOME)
        with pytest.raises(BadValue, match=r"q\[5\] \(wrist 3\) is 1\.0000 rad, 1\.0000 rad from the last set-point"):
            servo.send(turned(1.0))
        assert not servo.done


def test_target_filter_generates_set_points(led: Rehearsal) -> None:
    """A single distant target is sent, at no rate at all, and the set-points to it follow automatically."""
    with opened(led, rate=5.0, target_filter="jerk_limited", speed=2.0, acceleration=10.0, jerk=200.0) as servo:
        with pytest.raises(
            BadValue, match=r"q\[5\] \(wrist 3\) is 7 rad; expected a number from -6\.28319 to 6\.28319 rad"
        ):
            servo.send(turned(7.0))
        servo.send(turned(0.5))
        way: list[float] = []
        while not way or abs(led.q[5] - 0.5) > 1e-6:
            message = led.obey()
            assert message is not None
            if message[1] == FOLLOW:
                way.append(message[0][5])
        # 0.5 rad at 10 rad/s² and 200 rad/s³ take 0.5 s.
        assert len(way) * led.cycle == pytest.approx(0.5, abs=0.02)
        assert np.diff(way).max() <= 2.0 * led.cycle + 1e-6
        assert servo.stats.count == 1
    assert servo.phase is Phase.DONE


def test_unknown_filter_is_rejected(led: Rehearsal) -> None:
    with pytest.raises(BadValue, match="target_filter='smooth'; expected 'jerk_limited'"):
        led.motion.servo(target_filter="smooth")  # type: ignore[arg-type]
    with pytest.raises(BadValue, match="expected positive limits"):
        led.motion.servo(target_filter="jerk_limited", jerk=-1.0)
    assert led.sent == []


def test_send_raises_safety_stop(led: Rehearsal) -> None:
    with opened(led) as servo:
        servo.send(HOME)
        led.state(safety=SafetyMode.PROTECTIVE_STOP)
        until(lambda: servo.done)
        with pytest.raises(SafetyStop, match="protective stop"):
            servo.send(HOME)


def test_connection_lost_by_watchdog_names_watchdog(robot: Rehearsal) -> None:
    with opened(robot) as servo:
        servo.send(HOME)
        robot.text("urlink: nothing to go to")
        until(lambda: servo.done)
        with pytest.raises(ConnectionLost, match=r"\(watchdog=0\.1 s\); .*pass a larger watchdog="):
            servo.send(HOME)


def test_servo_names_the_delay_before_a_too_large_step(led: Rehearsal) -> None:
    with opened(led) as servo:
        for n in range(3):
            servo.send(turned(0.001 * n))
            led.time += 0.002
        led.time += 0.06
        with pytest.raises(BadValue, match=r"sent 0\.062 s ago \(watchdog=0\.1 s\): after such a delay"):
            servo.send(turned(0.5))


def test_cut_link_raises_connection_lost(robot: Rehearsal) -> None:
    with opened(robot) as servo:
        servo.send(HOME)
        assert robot.link is not None
        robot.link.close()
        robot.text("urlink: the link ended")
        until(lambda: servo.done)
        with pytest.raises(ConnectionLost, match="brakes on its own"):
            servo.send(HOME)


def test_send_raises_after_the_link_was_cut(robot: Rehearsal, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("urlink.motion.servo.block_motion._REASON", 0.05)
    with opened(robot) as servo:
        assert robot.link is not None
        robot.link.close()

        def send_on() -> None:
            for _ in range(1000):
                servo.send(HOME)

        with pytest.raises(ConnectionLost):
            send_on()
        servo.cancel()


def test_stop_at_pendant_raises_program_stopped(led: Rehearsal) -> None:
    with opened(led) as servo:
        led.vanish()
        led.until(lambda: servo.done)
        with pytest.raises(ProgramStopped):
            servo.send(HOME)


def test_preempted_servo_raises_cancelled(led: Rehearsal) -> None:
    with opened(led) as servo:
        servo.send(HOME)
        motion = led.motion.move_joints(HOME)
        led.begin()
        until(lambda: servo.done)
        with pytest.raises(Cancelled, match="preempted by move_joints"):
            servo.send(HOME)
        motion.cancel()


def test_missing_connection_raises_connect_failed(robot: Rehearsal, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("urlink.motion.servo.linked_program.CONNECT_TIMEOUT", 0.05)
    over = threading.Event()

    def run() -> None:
        while not over.wait(0.002):
            robot.tick()

    thread = threading.Thread(target=run)
    thread.start()
    try:
        with pytest.raises(ConnectFailed, match="reverse_host"), robot.motion.servo():
            raise AssertionError("the servo must not connect")
    finally:
        over.set()
        thread.join()
    assert robot.motion.current is None


def test_lost_registers_raise_connection_lost(
    rehearsal: Callable[..., Rehearsal], monkeypatch: pytest.MonkeyPatch
) -> None:
    robot = rehearsal(link="rtde")
    with opened(robot) as servo:
        servo.send(HOME)
        robot.inputs.is_cut = True
        waited: list[float] = []
        with monkeypatch.context() as patch:
            # Wait until the end of the time during which a reason might arrive.
            patch.setattr(servo, "wait", waited.append)
            with pytest.raises(ConnectionLost, match=r"^cut$"):
                servo.send(HOME)
        assert waited == [1.5]
        # The arm brakes on its own, and no reason is reported.
        robot.time += 1.1
        robot.until(lambda: servo.done)
        with pytest.raises(ConnectionLost, match="it brakes on its own: cut"):
            servo.send(HOME)


def test_reported_reason_replaces_connection_loss(rehearsal: Callable[..., Rehearsal]) -> None:
    robot = rehearsal(link="rtde")

    def stop() -> None:
        robot.state(safety=SafetyMode.PROTECTIVE_STOP)
        raise ConnectionLost("cut")

    with opened(robot) as servo:
        robot.inputs.before_write = stop
        with pytest.raises(SafetyStop, match="protective stop"):
            servo.send(HOME)


def test_firmware_without_registers_is_rejected(rehearsal: Callable[..., Rehearsal]) -> None:
    for firmware, arm in (("1.8", "UR5"), ("3.8", "UR5"), ("5.2", "UR5e")):
        robot = rehearsal(firmware, arm)
        with pytest.raises(LocalError, match=r"does not have the registers for link='rtde'; 3\.9, 5\.3 or later"):
            robot.motion.servo(link="rtde")
        assert robot.sent == []


def test_done_callback_of_failed_start_can_move_the_arm_and_wait(led: Rehearsal) -> None:
    led.state(safety=SafetyMode.PROTECTIVE_STOP)
    until(lambda: led.safety.cause is not None)
    seen: list[BaseException] = []

    def command(servo: Servo) -> None:
        for act in (led.motion.stop, servo.wait, led.motion.servo().__enter__):
            try:
                act()
            except SafetyStop as error:
                seen.append(error)

    servo = led.motion.servo()
    servo.add_done_callback(command)
    with pytest.raises(SafetyStop), servo:
        pass
    until(lambda: len(seen) == 3)
    assert led.sent == []

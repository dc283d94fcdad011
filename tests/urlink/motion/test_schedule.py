"""Waypoints on the robot's clock, and the delay of an arm, on simulated arms whose clock the test controls."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from linkcore import clock
from linkcore.errors import BadValue, LinkError, LocalError
from tests.fakes.rehearsal import HOME, Rehearsal, turned
from tests.urlink.motion.bench import PLAYING, Led
from tests.urlink.motion.test_servo import opened
from urlink import Circular, Joint, Linear
from urlink.arm.kinematics import Arm, Unreachable
from urlink.arm.models import model
from urlink.arm.poses import compose, invert
from urlink.motion.moves.trajectory import Trajectory
from urlink.motion.servo.follower import Follower
from urlink.motion.servo.following import Tolerances
from urlink.motion.servo.resampling import Schedule
from urlink.motion.servo.servo_delay import measure
from urlink.protocol.firmware import Firmware
from urlink.protocol.realtime.packets import RealtimeState
from urlink.script.messages import read_message, setpoint

pytestmark = pytest.mark.simulated_time

_FIRMWARES = [Firmware.parse(each) for each in ("1.8", "3.15", "5.11")]


class Scheduled(Led):
    """A servo with scheduled waypoints, on an arm that lags by `delay`."""

    def __init__(self, firmware: Firmware, delay: float) -> None:
        self.source = Schedule(
            model("UR5e" if firmware.is_e_series else "UR5"), 1 / firmware.rate, delay, nullcontext()
        )
        super().__init__(firmware, self.source)

    def add(self, q: list[float], seconds: float) -> float | None:
        """Add a waypoint, in s after the start; return the time when it is reached, in the same way."""
        reached = self.source.add(q, self.BEGIN + seconds, self.time, self.bench.motion.setpoint.q)
        return None if reached is None else reached - self.BEGIN

    def until(self, seconds: float) -> None:
        self.run(round((self.BEGIN + seconds - self.time) * self.bench.firmware.rate))

    @property
    def q5(self) -> float:
        return self.bench.motion.setpoint.q[5]


def delay_of(firmware: Firmware) -> float:
    """Return the delay, as `Servo.measure_delay` measures it."""
    led = Scheduled(firmware, 0.0)

    def states() -> Iterator[RealtimeState]:
        while True:
            yield led.state()
            led.bench.run()

    def send(q: list[float]) -> None:
        led.bench.deliver(setpoint(q, [0.0] * 6))

    return measure(states(), send, 5, -0.05, 0.5)


@pytest.mark.slow
@pytest.mark.parametrize("firmware", _FIRMWARES[1:], ids=str)
def test_schedule_reaches_waypoints_in_time_with_measured_delay(firmware: Firmware) -> None:
    delay = delay_of(firmware)
    cycle = 1.0 / firmware.rate
    # The arm lags by 0.9 of the look-ahead time plus two over the gain, after the time in which a set-point arrives.
    assert delay == pytest.approx(0.9 * 0.03 + 2 / 300 + 1.5 * cycle, abs=0.8 * cycle)
    wave = [0.15 * (1.0 - np.cos(2.0 * t)) for t in np.arange(0.0, 2.01, 0.16)]
    errors = []
    for known in (0.0, delay):
        led = Scheduled(firmware, known)
        led.run(5)
        off = []
        for i in range(1, 13):
            # Six per second, planned three ahead as a policy does; known waypoints are replaced by equal ones.
            for ahead in range(i, min(i + 3, 13)):
                assert led.add(turned(wave[ahead]), 0.16 * ahead) == pytest.approx(0.16 * ahead)
            led.until(0.16 * i)
            off.append(led.q5 - wave[i])
        errors.append(np.abs(off[1:-1]).max())
    before, after = errors
    assert before == pytest.approx(0.3 * delay, rel=0.2)
    assert after < max(0.1 * before, 3e-4)


@pytest.mark.slow
@pytest.mark.parametrize("firmware", [_FIRMWARES[0], _FIRMWARES[2]], ids=str)
def test_schedule_delays_and_drops_waypoints(firmware: Firmware) -> None:
    led = Scheduled(firmware, 2.0 / firmware.rate)
    assert led.add(turned(0.1), 0.0) is None  # the time is now
    led.run(3)
    assert led.sent == []
    later = led.add(turned(0.5), 0.1)  # this needs 5 rad/s, which no joint reaches
    assert later is not None
    assert 0.25 < later < 1.0
    assert led.add(turned(0.4), 1.5) == pytest.approx(1.5)
    assert led.add(turned(0.2), later) == pytest.approx(later)  # replaces that waypoint and all later ones
    led.until(1.0)
    assert led.q5 == pytest.approx(0.2, abs=1e-5)
    assert led.add(turned(0.3), 0.9) is None
    with pytest.raises(BadValue, match="position of wrist 3"):
        led.add(turned(7.0), 9.0)
    # The loop is delayed in the middle, and after the last waypoint. The arm does not jump, and arrives.
    led.add(turned(-0.3), 1.8)
    for missed in (1, 6, round(0.08 * firmware.rate)):
        led.run(max(round(0.1 * firmware.rate), missed + 2), missed=missed)
    led.run(firmware.rate, missed=round(0.08 * firmware.rate))
    steps = np.diff(np.array(led.bench.path)[:, 5]) / led.bench.period
    assert np.abs(steps).max() < np.pi
    assert led.q5 == pytest.approx(-0.3, abs=1e-4)
    assert led.bench.said == []


@pytest.mark.slow
def test_trajectory_is_followed_without_lag() -> None:
    """Compare the errors that tolerances and feedback see, before and after the delay is known."""
    firmware = _FIRMWARES[1]
    path = Trajectory.from_arrays([0, 1, 2], [turned(0), turned(0.5), turned(0)])
    seen = []
    for delay in (None, delay_of(firmware)):
        led = Scheduled(firmware, 0.0)
        tolerances = Tolerances(path=None, goal=0.001, goal_time=1.0, start=0.05)
        servoing = led.resampled._stream._servoing
        follower = Follower(path, tolerances, servoing, delay)
        errors = []
        led.bench.run(2)
        while not follower.is_over:
            state = led.state()
            led.bench.deliver(follower.step(b"", state, led.time))
            if (times := follower.times(state.time)) is not None:
                errors.append(state.q_actual[5] - follower.desired(times[1])[0][5])
            led.bench.run()
            assert led.time < led.BEGIN + 5
        seen.append(np.abs(errors).max())
    assert seen[0] > 0.009  # the lag beyond two cycles is 14 ms, at 0.75 rad/s
    assert seen[1] < 0.1 * seen[0]


def schedule(delay: float = 0.0) -> Schedule:
    return Schedule(model("UR5"), 1 / 128, delay, nullcontext())


def is_possible(times: list[float], way: list[float]) -> bool:
    try:
        Trajectory.from_arrays(times, [turned(each) for each in way]).check(model("UR5"))
    except BadValue:
        return False
    return True


@pytest.mark.parametrize("way", [0.1, 0.5, 6.0])
def test_early_waypoint_is_postponed_as_little_as_needed(way: float) -> None:
    """The time since the previous waypoint is less than half as long again as it has to be."""
    made = schedule()
    reached = made.add(turned(way), 50.02, 50.0, HOME)
    assert reached is not None
    assert is_possible([0.0, reached - 50.0], [0.0, way])
    assert not is_possible([0.0, (reached - 50.0) / 1.5], [0.0, way])
    made = schedule()
    made.add(turned(0.1), 52.0, 50.0, HOME)
    reached = made.add(turned(0.1 + way), 52.02, 50.0, HOME)
    assert reached is not None
    assert is_possible([0.0, 2.0, reached - 50.0], [0.0, 0.1, 0.1 + way])
    assert not is_possible([0.0, 2.0, 2.0 + (reached - 52.0) / 1.5], [0.0, 0.1, 0.1 + way])


def test_waypoint_far_too_early_is_rejected() -> None:
    """The limit is 1.45 to the power of 16. Within that time, a base that turns at 2.1 rad/s gets 4.16 rad far."""

    def added(angle: float) -> float | None:
        made = Schedule(model("UR10"), 1 / 128, 0.0, nullcontext())
        return made.add([angle, *HOME[1:]], 50.0 + 1 / 128, 50.0, HOME)

    assert added(4.1) == pytest.approx(50.0 + 1.45**16 / 128)
    with pytest.raises(BadValue, match="velocity of base"):
        added(4.2)


def test_waypoint_is_rejected_after_its_set_point_was_sent() -> None:
    """The set-point that answers a state is for `delay` later; the next set-point follows at least a cycle later."""
    for delay in (0.0, 0.125):
        made = schedule(delay)
        assert [made.has_targets, made.last] == [False, None]
        assert made.add(list(HOME), math.nextafter(50.0 + delay + 1 / 128, 0.0), 50.0, HOME) is None
        assert not made.has_targets
        # An arm at rest has nothing to brake from.
        assert made.add(list(HOME), 50.0 + delay + 1 / 128, 50.0, HOME) == 50.0 + delay + 1 / 128
        assert made.last == list(HOME)
        made.begin(51.0, HOME)
        assert made.add(turned(0.1), 51.5 + delay, 60.0, turned(9.0)) == 51.5 + delay
        made.accept(51.25, 1.0)
        assert made.add(turned(0.1), 51.25 + delay, 51.0, HOME) is None
        for time, q in ((51.1, 0.0), (51.3, 0.05), (51.5, 0.1), (60.0, 0.1)):
            assert made.at(time, 1.0)[0] == pytest.approx(turned(q))
        assert made.skip(51.25 + 1 / 128, 0.2)[0] == made.at(51.25, 1.0)[0]
        # A waypoint that is reached right now is where the next curve begins, rather than a point of it.
        made.accept(51.5, 1.0)
        assert made.add(turned(0.2), 52.0 + delay, 60.0, HOME) == 52.0 + delay
        assert made.at(51.5, 1.0)[0] == pytest.approx(turned(0.1))


@pytest.mark.parametrize("delay", [0.0, 0.125])
def test_restart_continues_from_reached_position(delay: float) -> None:
    made = schedule(delay)
    for at, q in ((50.5, 0.1), (51.0, 0.2), (51.5, 0.0)):
        assert made.add(turned(q), at + delay, 50.0, HOME) == at + delay
    made.begin(50.0, HOME)
    made.restart(50.75, turned(0.3), [0.0] * 5 + [0.25])
    # This is the position of the previous set-point.
    for time, q in ((50.75 - 1 / 128, 0.3), (51.0, 0.2), (51.5, 0.0)):
        assert made.at(time, 1.0)[0] == pytest.approx(turned(q), abs=1e-9)
    assert made.at(50.75 - 1 / 128, 1.0)[1] == pytest.approx([0.0] * 5 + [0.25])
    # After the last waypoint, and within a cycle of it, the rest of the distance takes a tenth of a second.
    for time in (51.5, 53.0):
        made.restart(time, turned(0.01), [0.0] * 6)
        begin = time - 1 / 128
        for seconds, q in ((0.0, 0.01), (0.05, 0.005), (0.1, 0.0)):
            assert made.at(begin + seconds, 1.0)[0] == pytest.approx(turned(q), abs=1e-9)


@pytest.mark.parametrize("speed", [-2.0, 0.0, 2.0])
@pytest.mark.parametrize("away", [-0.3, 0.3])
def test_restart_postpones_waypoints_if_needed(away: float, speed: float) -> None:
    """Not only the last waypoint counts: the first might be a few milliseconds ahead, and the arm far from the path."""
    made = Schedule(model("UR5e"), 0.002, 0.0, nullcontext())
    places = [0.1, 0.15, 0.2, 0.2]
    for number, q in enumerate(places):
        at = 50.3 + 0.1 * number
        assert made.add(turned(q), at, 50.0, HOME) == at
    made.begin(50.0, HOME)
    made.restart(50.297, turned(0.1 + away), [0.0] * 5 + [speed])
    curve = made._curve
    assert curve is not None
    curve.check(model("UR5e"))
    assert curve.q[:, 5].tolist() == pytest.approx([0.1 + away, *places])
    assert curve.qd[0, 5] == pytest.approx(speed)
    assert np.diff(curve.time)[1:].tolist() == pytest.approx([0.1] * 3)


@pytest.mark.parametrize(("apart", "is_one"), [(0.0015, False), (0.0005, True)])
def test_waypoints_within_a_millisecond_are_merged(apart: float, is_one: bool) -> None:
    made = schedule()
    for at in (51.0, 51.0 + apart):
        assert made.add(turned(0.1), at, 50.0, HOME) == at
    # At the last waypoint the speed goes to zero, so the position is not quite reached before.
    assert (abs(made.at(51.0, 1.0)[0][5] - 0.1) > 1e-8) == is_one


class Lagging:
    """An arm at the position commanded `lag` s ago, `gain` times as far; its sensor is off by `offset` rad."""

    def __init__(self, lag: float, gain: float = 1.0, offset: float = 0.01, joint: int = 5) -> None:
        self.lag, self.gain, self.offset, self.joint = lag, gain, offset, joint
        #: time in s since the first state, and positions relative to the start, in rad
        self.sent: list[tuple[float, list[float]]] = []

    def measure(self, amplitude: float = 0.05, duration: float = 1.0) -> float:
        return measure(self._states(amplitude, duration), self._send, self.joint, amplitude, duration)

    def _states(self, amplitude: float, duration: float) -> Iterator[RealtimeState]:
        for i in range(100_000):
            self.time = 0.002 * i
            t = min(max(self.time - self.lag, 0.0), duration)
            q = np.array(HOME)
            q[self.joint] += self.offset + self.gain * amplitude * np.sin(np.pi * t / duration) ** 2
            yield cast(RealtimeState, SimpleNamespace(time=50.0 + self.time, q_target=np.array(HOME), q_actual=q))

    def _send(self, q: list[float]) -> None:
        self.sent.append((self.time, list(np.subtract(q, HOME))))


@pytest.mark.parametrize(("lag", "amplitude"), [(0.003, 0.05), (0.12, -0.3), (0.45, 0.05)])
def test_measured_delay_is_lag_of_arm(lag: float, amplitude: float) -> None:
    assert Lagging(lag).measure(amplitude) == pytest.approx(lag, abs=1e-7)
    assert Lagging(lag, joint=2).measure(amplitude, 3.0) == pytest.approx(lag, abs=1e-7)


def test_measurement_moves_one_joint_forth_and_back() -> None:
    """The joint moves from rest to rest; the measurement also waits for the states after that."""
    arm = Lagging(0.02, joint=2)
    arm.measure(0.1, 0.8)
    times, way = np.array([time for time, _ in arm.sent]), np.array([q for _, q in arm.sent])
    assert way == pytest.approx(np.outer(0.1 * np.sin(np.pi * np.minimum(times, 0.8) / 0.8) ** 2, np.eye(6)[2]))
    assert times[-1] == pytest.approx(0.8 + 0.5, abs=0.003)


@pytest.mark.parametrize(
    "arm",
    [Lagging(0.0, 0.0), Lagging(0.6), Lagging(-0.01), Lagging(0.02, 0.7), Lagging(0.02, -1.0), Lagging(0.02, 1.3)],
    ids=["no motion", "too late", "too early", "not far enough", "other direction", "too far"],
)
def test_arm_not_following_is_reported(arm: Lagging) -> None:
    with pytest.raises(LinkError, match="does not follow"):
        arm.measure()


def test_arm_following_most_of_the_way_is_measured() -> None:
    assert Lagging(0.02, 0.85).measure() == pytest.approx(0.02, abs=1e-3)


class TestServo:
    def test_schedule_accepts_joints_and_poses(self, robot: Rehearsal) -> None:
        up = Arm("UR5e").forward(HOME)
        up[2] += 0.02
        with opened(robot) as servo:
            assert servo.schedule(Joint(turned(0.05)), at=robot.time + 0.2) == pytest.approx(robot.time + 0.2)
            assert servo.schedule(Linear(up), at=robot.time + 0.4) == pytest.approx(robot.time + 0.4)
            assert servo.schedule(turned(0.0), at=robot.time) is None
            end, q = robot.time + 0.45, [0.0] * 6
            while robot.time < end or robot.q != pytest.approx(q):
                message = robot.obey()
                assert message is not None
                q = message[0]
            assert compose(invert(robot.pose), up) == pytest.approx([0.0] * 6, abs=1e-4)
            assert servo.stats.count == 2
            for refused, error, text in (
                (Linear(up, speed=0.1), BadValue, "without blend and speed"),
                (Linear([3, 0, 0, 0, 0, 0]), Unreachable, "cannot bring its tool"),
                ([0] * 5, BadValue, "shape"),
            ):
                with pytest.raises(error, match=text):
                    servo.schedule(refused, at=robot.time + 1)
            with pytest.raises(LocalError, match=r"use either send\(\) or schedule\(\), not both"):
                servo.send(HOME)
            with pytest.raises(LocalError, match="cannot be used with a target filter or scheduled waypoints"):
                servo.measure_delay()

    @pytest.mark.parametrize("delay", [None, 0.0, 0.1])
    def test_set_points_are_sent_earlier_by_delay(
        self, robot: Rehearsal, dialogues: list[Any], delay: float | None
    ) -> None:
        with opened(robot, delay=delay) as servo:
            # A thread answers the states up to here.
            robot.tick()
            clock.sleep(0.1)  # simulated time passes only when the state was answered
            at = robot.time + 0.2
            assert servo.schedule(turned(0.02), at=at) == at
            assert servo.stats.count == 1
            still, now, q = np.zeros(6), robot.time, list(HOME)
            while q != pytest.approx(turned(0.02), abs=1e-6):
                now += robot.cycle
                state = SimpleNamespace(time=now, q_target=np.array(HOME), qd_target=still, **PLAYING)
                q = read_message(dialogues[0].step(b"", cast(RealtimeState, state), now))[0]
            # The last few thousandths of a second are less than a millionth of a radian.
            assert at - now == pytest.approx(2 * robot.cycle if delay is None else delay, abs=0.003)

    def test_pose_needing_a_large_joint_turn_is_rejected(self, robot: Rehearsal) -> None:
        """The pose might be behind a singularity or far away, so the path would not be straight."""
        with opened(robot) as servo:
            for turn, is_far in ((1.45, False), (-0.2, True), (2.9, False)):
                pose = Arm("UR5e").forward([turn, *HOME[1:]])
                if is_far:
                    with pytest.raises(
                        BadValue, match=r"q\[0\] \(base\) would have to move from 1\.4500 to -0\.2000 rad"
                    ):
                        servo.schedule(Linear(pose), at=robot.time + 10)
                else:
                    assert servo.schedule(Linear(pose), at=robot.time + 10 + turn) is not None
            for refused in (Circular(pose, pose), Joint(HOME, blend=0.1)):
                with pytest.raises(BadValue, match="expected a Joint or Linear without blend and speed"):
                    servo.schedule(refused, at=robot.time + 20)  # type: ignore[arg-type]

    def test_schedule_works_after_an_interruption(
        self, robot: Rehearsal, dialogues: list[Any], monkeypatch: pytest.MonkeyPatch
    ) -> None:
        def interrupt(*args: object) -> None:
            raise KeyboardInterrupt

        with opened(robot) as servo:
            with monkeypatch.context() as patched:
                patched.setattr("urlink.motion.servo.servo.ResampledSetpoints", interrupt)
                with pytest.raises(KeyboardInterrupt):
                    servo.schedule(HOME, at=robot.time + 1)
            assert servo.schedule(HOME, at=robot.time + 1) is not None
            assert dialogues[0].resampled is not None

    def test_send_and_schedule_cannot_be_combined(self, rehearsal: Callable[..., Rehearsal]) -> None:
        for options, message in (({}, "use either send"), ({"target_filter": "jerk_limited"}, "use send")):
            robot = rehearsal()
            with opened(robot, **options) as servo:
                servo.send(HOME)
                with pytest.raises(LocalError, match=message):
                    servo.schedule(HOME, at=robot.time + 1)
        with pytest.raises(LocalError, match="follows its own clock"):
            robot.motion.follow(Trajectory.from_arrays([0, 1], [HOME, turned(0.1)]), low_bandwidth=True, delay=0.02)

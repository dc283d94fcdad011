"""The follower alone, on clocks that the test sets, and together with its program on a simulated arm."""

from __future__ import annotations

import math
import struct
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from linkcore.errors import BadValue, LinkError, LinkTimeout
from tests.fakes.rehearsal import FOLLOW, WAIT, turned
from tests.urlink.motion.bench import PLAYING, Bench
from urlink.arm.models import Model, model
from urlink.command.program_time import ControllerTimer, ProgramTimer
from urlink.errors import ToleranceExceeded
from urlink.motion.moves.speed_limit import EARLY, largest_speeds
from urlink.motion.moves.trajectory import Trajectory
from urlink.motion.servo.follower import Follower
from urlink.motion.servo.following import AHEAD, Tolerances, stands
from urlink.motion.servo.setpoints import Servoing
from urlink.protocol.firmware import Firmware
from urlink.protocol.realtime.packets import RealtimeState
from urlink.script.links import ReverseSocket, missable
from urlink.script.messages import MESSAGE_SIZE, setpoint

TOKEN = 7
LOOSE = Tolerances(path=None, goal=0.05, goal_time=5.0, start=0.05)
#: Half a radian forth and back in two seconds.
WAVE = Trajectory.from_arrays([0, 1, 2], [turned(0), turned(0.5), turned(0)])
FIRMWARES = [Firmware.parse(each) for each in ("1.8", "3.4", "5.11")]
NEWEST = FIRMWARES[-1]


def arm(firmware: Firmware) -> Model:
    return model("UR5e" if firmware.is_e_series else "UR5")


def servoing(firmware: Firmware, watchdog: float = 0.1) -> Servoing:
    return Servoing(firmware, largest_speeds(arm(firmware)), watchdog, 0.03, 300.0)


def follower(
    firmware: Firmware = NEWEST, trajectory: Trajectory = WAVE, tolerances: Tolerances = LOOSE, watchdog: float = 0.1
) -> Follower:
    return Follower(trajectory, tolerances, servoing(firmware, watchdog))


def state(time: float, q: list[float], qd: float = 0.0) -> RealtimeState:
    """Return a state with the fields that the follower reads."""
    position, speeds = np.array(q), np.array([0.0] * 5 + [qd])
    return cast(
        RealtimeState,
        SimpleNamespace(time=time, q_target=position, q_actual=position, qd_target=speeds, qd_actual=speeds, **PLAYING),
    )


def message(data: bytes) -> tuple[list[float], int]:
    """Return the positions and the action of a message."""
    numbers = struct.unpack(">13i", data)
    return [each / 1e6 for each in numbers[:6]], numbers[12]


def speeds(data: bytes) -> list[float]:
    return [each / 1e6 for each in struct.unpack(">13i", data)[6:12]]


class Feeding:
    """A follower that receives one state after another; the arm is at the commanded position."""

    def __init__(self, follower: Follower, firmware: Firmware = NEWEST) -> None:
        self.follower = follower
        self.firmware = firmware
        self.cycle = 1.0 / firmware.rate
        self.time, self.now = 50.0, 1000.0
        self.q = list(turned(0.0))
        self.sent: list[list[float]] = []
        #: speed of the last joint after each set-point, rad/s
        self.speeds: list[float] = []

    def state(self, cycles: float = 1, *, own: float | None = None, stated: float | None = None) -> bytes:
        """Advance by `cycles` cycles and pass a state.

        Args:
            cycles: Cycles of the controller.
            own: Time in s that passes on this computer's clock, if it differs.
            stated: Time in the state, if it differs.
        """
        self.time += cycles * self.cycle
        self.now += cycles * self.cycle if own is None else own
        data = self.follower.step(b"", state(self.time if stated is None else stated, self.q), self.now)
        if data and message(data)[1] == FOLLOW:
            self.q = message(data)[0]
            self.sent.append(self.q)
            self.speeds.append(speeds(data)[5])
        return data


class LateTimer(ProgramTimer):
    """Timer of a trajectory that started 0.02 s before its first state was answered."""

    def beginning(self) -> float:
        return 0.02


def test_late_start_is_corrected_like_missed_cycles() -> None:
    """If two arms must move together, this computer might be delayed between the first set-points of both."""
    late = Feeding(Follower(WAVE, LOOSE, servoing(NEWEST), timer=LateTimer(0.002)))
    missed = Feeding(follower())
    for feeding, cycles in ((late, 1), (missed, 10)):
        feeding.state(0)
        feeding.state(cycles)
        for _ in range(20):
            feeding.state()
    assert late.q == pytest.approx(missed.q, abs=5e-4)
    # Nine cycles of coasting, at 98 % of the speed and less, are worth 8.1 cycles. One cycle comes before them, and
    # 1.0 and 1.1 cycles come after them.
    begins = Feeding(Follower(WAVE, LOOSE, servoing(NEWEST), timer=LateTimer(0.002)))
    begins.state(0)
    assert begins.follower._s == pytest.approx((1.0 + 8.1 + 1.0 + 1.1) * 0.002)


# -- the controller's clock ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("stated", "own", "passed"),
    [
        (0.002, 0.002, 0.002),
        (0.004, 0.004, 0.004),
        (0.002, 0.5, 0.002),  # the state was late
        (0.05, 0.0001, 0.05),  # delayed states arrive together
        (0.0, 0.002, 0.0),
        (0.101, 0.002, 0.101),
        (0.103, 0.002, 0.002),  # more than a tenth of a second early
        (1.0, 0.002, 0.002),  # this computer's clock does not confirm that second
        (1.0, 0.03, 0.03),
        (1.0, 1.0, 1.0),
        (-5.0, 0.002, 0.002),
        (-5.0, 0.0001, 0.002),
        (float("nan"), 0.002, 0.002),
        (float("inf"), 0.002, 0.002),
    ],
)
def test_controller_clock_is_ignored_if_it_is_implausible(stated: float, own: float, passed: float) -> None:
    clock = ControllerTimer(0.002)
    assert clock.passed(100.0, 7.0) == 0.0
    assert clock.passed(100.0 + stated, 7.0 + own) == pytest.approx(passed, abs=1e-12)
    # The clock continues from the reported time, even a wrong one.
    following = 100.0 + stated + 0.002
    assert clock.passed(following, 7.002 + own) == pytest.approx(0.002, abs=1e-9)


def test_single_wrong_time_does_not_shift_the_clock() -> None:
    clock = ControllerTimer(0.002)
    passed = [clock.passed(time, 7.0 + 0.002 * n) for n, time in enumerate((100.0, 100.002, 101.004, 100.006, 100.008))]
    assert sum(passed) == pytest.approx(0.008)


def test_time_of_delayed_states_is_used_if_they_come_together() -> None:
    """States are half a second late, then catch up half a second within a tenth; no state is early."""
    clock = ControllerTimer(0.002)
    clock.passed(100.0, 7.0)
    assert clock.passed(100.002, 7.502) == pytest.approx(0.002)
    assert clock.passed(100.6, 7.61) == pytest.approx(0.598)
    # A second within a tenth of a second would be early.
    assert clock.passed(101.6, 7.71) == pytest.approx(0.1)


def test_timer_accepts_decreasing_delays_of_first_states() -> None:
    """A state is believed if it is hardly quicker than the quickest state before it."""
    clock = ControllerTimer(0.002)
    passed = [clock.passed(100.0 + 0.092 * n, 7.0 + 0.002 * n) for n in range(4)]
    assert passed == pytest.approx([0.0, 0.092, 0.092, 0.092])


# -- the set-points --------------------------------------------------------------------------------------


@pytest.mark.parametrize("firmware", FIRMWARES, ids=str)
def test_follower_answers_each_state_with_the_next_set_point(firmware: Firmware) -> None:
    feeding = Feeding(follower(firmware), firmware)
    cycles = round(2.5 * firmware.rate)
    for _ in range(cycles):
        feeding.state()
    times = (np.arange(len(feeding.sent)) + 2) * feeding.cycle
    assert np.allclose(feeding.sent, WAVE.at(times)[0], rtol=0, atol=1e-6)
    assert feeding.follower.is_over
    assert feeding.sent[-1] == pytest.approx(WAVE.q[-1])


def ramp(speed: float) -> Trajectory:
    """Return a trajectory: wrist 3 has this speed from 0.1 s to 0.5 s, and rests since 0.51 s."""
    places = [turned(speed * way) for way in (0.0, 0.05, 0.45, 0.455, 0.455)]
    return Trajectory.from_arrays(
        [0.0, 0.1, 0.5, 0.51, 2.0], places, [[0.0] * 5 + [share * speed] for share in (0, 1, 1, 0, 0)]
    )


@pytest.mark.parametrize(("missed", "pace"), [(0, 1.0), (15, 1.046), (30, 1.1)])
def test_program_catches_up_at_most_10_percent_faster(missed: int, pace: float) -> None:
    """Compare the pace with a lag to make up in 0.1 s: 2.3 cycles after 15 missed cycles, and 9.2 cycles after 30."""
    feeding = Feeding(follower(trajectory=ramp(0.5)))
    for _ in range(120):
        feeding.state()
    feeding.state(missed + 1)
    assert feeding.speeds[-2:] == pytest.approx([0.5, 0.5 * pace], abs=1e-6)


@pytest.mark.parametrize(("speed", "seconds"), [(0.5, 0.1), (2.0, 0.208)])
def test_overshoot_is_corrected_at_constant_speed(speed: float, seconds: float) -> None:
    """Correction takes a tenth of a second, at 0.25 rad/s at most. The arm kept moving when the trajectory ended."""
    feeding = Feeding(follower(trajectory=ramp(speed)))
    for _ in range(246):
        feeding.state()
    here = feeding.sent[-1][5] + speed * 18.5 * feeding.cycle  # after 25 cycles
    gap = here - 0.455 * speed
    assert gap == pytest.approx(0.026 * speed, abs=1e-6)
    feeding.state(26)
    # The follower is behind the trajectory, so it runs a tenth faster.
    for cycles in range(1, 30):
        assert feeding.speeds[-1] == pytest.approx(-gap / seconds, abs=2e-6)
        assert feeding.sent[-1][5] == pytest.approx(here - gap * 1.1 * cycles * feeding.cycle / seconds, abs=2e-6)
        feeding.state()
    for _ in range(round(seconds / feeding.cycle)):
        feeding.state()
    assert (feeding.sent[-1][5], feeding.speeds[-1]) == pytest.approx((0.455 * speed, 0.0), abs=1e-6)


def test_early_state_advances_set_point_by_less_than_a_cycle() -> None:
    """At the largest joint speed, a set-point may be early by no more than a millisecond."""
    feeding = Feeding(follower(trajectory=ramp(3.1)))
    for _ in range(120):
        feeding.state()
    for own in (0.0002, 0.0, 0.002):
        feeding.state(own=own)
    ways = np.diff(np.array(feeding.sent)[-5:, 5])
    assert ways == pytest.approx(3.1 * feeding.cycle * np.array([1.0, 0.5, 0.0, 1.1]), abs=2e-6)


@pytest.mark.parametrize("stated", [1.0, -5.0, float("nan"), float("inf")])
def test_implausible_time_moves_arm_by_at_most_one_cycle(stated: float) -> None:
    feeding = Feeding(follower())
    program = Program(servoing(NEWEST), feeding.q)
    path = []
    for n in range(313):
        wrong = feeding.time + stated if n > 250 and n % 20 == 0 else None
        path.append(program.cycle(feeding.state(stated=wrong))[5])
    fastest = np.abs(WAVE.at(np.linspace(0, 2, 1000))[1]).max() * feeding.cycle
    assert np.abs(np.diff(path)).max() <= 1.1 * fastest + 1e-6
    assert path[-1] == pytest.approx(WAVE.at(314 * feeding.cycle)[0][5], abs=1e-4)


def test_permanent_clock_change_is_followed() -> None:
    feeding = Feeding(follower())
    for _ in range(250):
        feeding.state()
    feeding.time -= 5.0
    while not feeding.follower.is_over:
        feeding.state()
        assert len(feeding.sent) < 1100
    assert feeding.sent[-1] == pytest.approx(WAVE.q[-1])


@pytest.mark.parametrize("missed", [1, 3, 10, 30, 49])
def test_missed_cycles_are_caught_up_10_percent_faster(missed: int) -> None:
    feeding = Feeding(follower())
    for _ in range(250):
        feeding.state()
    before = len(feeding.sent)
    feeding.state(missed + 1)
    for _ in range(600):
        feeding.state()
    sent = np.array(feeding.sent)[:, 5]
    # Without a set-point for n cycles, the program on the robot advances by n - n (n + 1) / 100 cycles.
    coasted = missed - missed * (missed + 1) / 100
    last_step = feeding.speeds[before - 1] * feeding.cycle
    here = sent[before - 1] + coasted * last_step
    fastest = np.abs(WAVE.at(np.linspace(0, 2, 1000))[1]).max() * feeding.cycle
    assert abs(sent[before] - here) <= 1.1 * fastest + 1e-6
    assert np.abs(np.diff(sent[before:])).max() <= 1.1 * fastest + 0.25 * feeding.cycle
    # In half a second, the follower catches up at least 50 ms.
    assert sent[-1] == pytest.approx(WAVE.at((250 + missed + 601 + 1) * feeding.cycle)[0][5], abs=1e-4)


def test_wrong_state_time_moves_the_arm_by_few_cycles_only() -> None:
    """The time of the state is wrong, but by less than the gap that is allowed between states that arrive together."""
    feeding = Feeding(follower())
    for _ in range(250):
        feeding.state()
    before = feeding.sent[-1][5]
    assert feeding.state(stated=feeding.time + 0.09)
    fastest = np.abs(WAVE.at(np.linspace(0, 2, 1000))[1]).max() * feeding.cycle
    assert abs(feeding.sent[-1][5] - before) <= math.pi * (feeding.cycle + EARLY)
    assert abs(feeding.sent[-1][5] - before) <= 6 * fastest


def test_set_point_jump_ends_trajectory_with_tolerance_exceeded() -> None:
    """The arm is not where the trajectory is, and too little time passes for the arm to get there."""
    led = follower(tolerances=Tolerances(path=None, goal=0.05, goal_time=5.0, start=1.0))
    led.step(b"", state(50.0, turned(0.0)), 1000.0)
    for n in range(1, 20):
        led.step(b"", state(50.0 + 0.002 * n, turned(0.0)), 1000.0 + 0.002 * n)
    led._stream.q = turned(0.5)  # as no follower does
    with pytest.raises(ToleranceExceeded, match="would have to jump"):
        led.step(b"", state(50.04, turned(0.0)), 1000.04)


def test_two_states_of_one_cycle_are_answered_once() -> None:
    feeding = Feeding(follower())
    for _ in range(10):
        assert feeding.state()
    assert feeding.state(0) == b""
    assert feeding.state()


def test_follower_waits_for_arm_at_rest() -> None:
    led = follower()
    moving = state(1.0, turned(0), 0.5)
    assert message(led.step(b"", moving, 10.0))[1] == WAIT
    assert message(led.step(b"", moving, 11.5))[1] == WAIT
    with pytest.raises(LinkTimeout, match=r"did not come to rest within 1\.5 s, so the trajectory did not begin"):
        led.step(b"", moving, 11.51)
    assert (led.times(1.0), led.progress, led.is_over) == (None, 0.0, False)


def test_arm_is_at_rest_below_two_hundredths_rad_per_second() -> None:
    for joint in range(6):
        for direction in (1.0, -1.0):
            speeds = np.zeros(6)
            speeds[joint] = direction * 0.02
            assert not stands(speeds)
            assert stands(0.999 * speeds)


def test_start_far_from_arm_is_rejected() -> None:
    with pytest.raises(BadValue, match="too far from the position of the arm"):
        follower().step(b"", state(1.0, turned(0.06)), 10.0)


def test_initial_offset_is_faded_out() -> None:
    feeding = Feeding(follower())
    feeding.q = turned(0.04)
    for _ in range(600):
        feeding.state()
    sent = np.array(feeding.sent)[:, 5]
    assert sent[0] == pytest.approx(0.04, abs=1e-4)
    wanted = WAVE.at((np.arange(600) + 2) * feeding.cycle)[0][:, 5]
    assert np.abs(sent - wanted)[250:].max() < 1e-6
    assert np.abs(np.diff(sent - wanted)).max() <= 0.26 * feeding.cycle
    assert np.abs(sent - wanted)[50] > 0.02  # not at once


@pytest.mark.parametrize(("off", "seconds"), [(0.04, 0.24), (-0.001, 0.2)])
def test_fade_out_is_smooth_and_limited(off: float, seconds: float) -> None:
    """Fading takes at least a fifth of a second, at 0.25 rad/s at most, from rest to rest."""
    led = follower()
    led.step(b"", state(50.0, turned(off)), 1000.0)
    for part, left, speed in ((0.0, 1.0, 0.0), (0.25, 27 / 32, 1.125), (0.5, 0.5, 1.5), (1.0, 0.0, 0.0), (9.0, 0, 0)):
        q, qd = led.desired(part * seconds)
        there, along, _ = WAVE.sample(part * seconds)
        assert q[5] - there[5] == pytest.approx(left * off, abs=1e-9)
        assert qd[5] - along[5] == pytest.approx(-speed * off / seconds, abs=1e-9)


def test_leaving_path_or_goal_raises_tolerance_exceeded() -> None:
    led = follower(tolerances=Tolerances(path=0.05, goal=0.01, goal_time=0.1, start=0.05))
    led.step(b"", state(1.0, turned(0)), 10.0)
    led.step(b"", state(1.002, turned(0.04)), 10.002)
    with pytest.raises(ToleranceExceeded, match=r"wrist 3 \(joint 5\) is 0\.06.* into its path"):
        led.step(b"", state(1.004, turned(0.06)), 10.004)
    with pytest.raises(ToleranceExceeded, match="nan"):
        led.step(b"", state(1.006, turned(float("nan"))), 10.006)
    feeding = Feeding(follower(tolerances=Tolerances(path=None, goal=0.01, goal_time=0.1, start=0.05)))

    def hold() -> None:
        for _ in range(1200):
            feeding.q = turned(0.02)
            feeding.state()

    with pytest.raises(ToleranceExceeded, match=r"0\.1 s after the end of its path; the tolerance is 0\.01"):
        hold()
    assert feeding.time - 50.0 == pytest.approx(2.1, abs=0.01)


@pytest.mark.parametrize(
    ("t", "off", "speed", "what"),
    [
        (0.0, 0.05, 0.5, "continues"),
        (0.0, math.nextafter(0.05, 1.0), 0.5, "0.000 s into its path; the tolerance is 0.05"),
        (2.0, 0.0, 0.0, "ends"),
        (2.0, -0.01, 0.0, "ends"),
        (2.0, 0.01, 0.5, "continues"),
        (2.0, math.nextafter(0.01, 1.0), 0.0, "continues"),
        (2.5, 0.0, 0.5, "continues"),
        (2.5, 1.0, 0.0, "continues"),
        (2.51, 0.01, 0.5, "ends"),
        (2.51, -math.nextafter(0.01, 1.0), 0.0, "0.5 s after the end of its path; the tolerance is 0.01"),
    ],
)
def test_tolerances_apply_to_path_and_goal(t: float, off: float, speed: float, what: str) -> None:
    """At the end, the arm is at rest at the goal, or it is there but still moving when its time is up."""
    led = follower(tolerances=Tolerances(path=0.05, goal=0.01, goal_time=0.5, start=0.05))
    led.step(b"", state(50.0, turned(0.0)), 1000.0)
    seen = state(50.0 + t, turned(off), speed)
    if what in ("continues", "ends"):
        led._compare(seen, t)
        assert (led.is_over, led.progress, led.times(50.0 + t)) == (what == "ends", t / 2.0, (0.0, t))
    else:
        with pytest.raises(ToleranceExceeded, match=what):
            led._compare(seen, t)


def test_times_returns_passed_time_and_time_on_trajectory() -> None:
    feeding = Feeding(follower())
    feeding.state()
    assert feeding.follower.times(50.002) == pytest.approx((0.0, 0.0))
    for _ in range(99):
        feeding.state()
    assert feeding.follower.progress == pytest.approx(0.198 / 2.0)
    for after in (0.0, 0.0631, 0.198, 0.2):  # between states, and after the newest one
        assert feeding.follower.times(50.002 + after) == pytest.approx((after, after))
    assert feeding.follower.times(50.0) is None


# -- with the program on the robot -----------------------------------------------------------------------


class Program:
    """Model of the streaming program without the interpreter.

    `test_follower_model_moves_like_the_program_on_the_robot` compares it with the real program.
    """

    def __init__(self, servoing: Servoing, q: list[float]) -> None:
        self.q = list(q)
        self.is_over = False
        self._aim = list(q)
        self._step = [0.0] * 6
        self._cycle = 1.0 / servoing.firmware.rate
        self._missed = 0
        self._missable = missable(servoing.watchdog, servoing.firmware.rate)
        self._coastable = servoing.coastable
        self._ways = [speed / servoing.firmware.rate for speed in servoing.speeds]
        self._has_begun = False

    def cycle(self, messages: bytes) -> list[float]:
        """Run one cycle with these messages; return the argument of ``servoj``."""
        last_message = messages[-MESSAGE_SIZE:]
        if (
            self.is_over
            or (not last_message and not self._has_begun)
            or (last_message and message(last_message)[1] == WAIT)
        ):
            return self.q
        if last_message:
            goal = message(last_message)[0]
            self._step = [self._cycle * each for each in speeds(last_message)]
            self._aim = goal
            self.q = self._bounded() if self._has_begun else goal
            self._has_begun, self._missed = True, 0
        elif self._missed < self._missable:
            self._missed += 1
            share = max(1.0 - self._missed / self._coastable, 0.0)
            self._aim = [aim + step * share for aim, step in zip(self._aim, self._step, strict=True)]
            self.q = self._bounded()
        else:
            self.is_over = True
        return self.q

    def _bounded(self) -> list[float]:
        """Return the aim, limited to the distance that each joint can move in a cycle."""
        return [min(max(a, q - way), q + way) for a, q, way in zip(self._aim, self.q, self._ways, strict=True)]


@pytest.mark.parametrize("firmware", FIRMWARES[1:], ids=str)
def test_follower_model_moves_like_the_program_on_the_robot(firmware: Firmware) -> None:
    """The program for CB2 also brakes, which is not modelled here."""
    bench = Bench(servoing(firmware).body(ReverseSocket("10.0.0.1", 50001, TOKEN)), firmware)
    modelled = Program(servoing(firmware), list(bench.motion.setpoint.q))
    targets: list[list[float]] = []
    feeding = Feeding(follower(firmware), firmware)
    bench.watch_servoj(targets.append)
    bench.run(2)
    expected = []
    for missed in (0, 0, 0, 1, 0, 4, 0, 0, 2, 11, 0, 0, 200):
        for _ in range(missed):
            expected.append(modelled.cycle(b""))
            bench.run()
        messages = feeding.state(missed + 1)
        bench.deliver(messages)
        expected.append(modelled.cycle(messages))
        bench.run()
    assert np.allclose(targets, expected[: len(targets)], rtol=0, atol=1e-9)
    assert len(targets) > 24 + missable(0.1, firmware.rate)
    assert modelled.is_over


@pytest.mark.parametrize("firmware", FIRMWARES[1:], ids=str)
@pytest.mark.parametrize("watchdog", [0.05, 5.0])
def test_coasting_distance_of_program_equals_the_prediction(firmware: Firmware, watchdog: float) -> None:
    """Compare the distance of each number of cycles without a set-point, and the speed in the last cycle."""
    how = servoing(firmware, watchdog)
    bench = Bench(how.body(ReverseSocket("10.0.0.1", 50001, TOKEN)), firmware)
    targets: list[list[float]] = []
    bench.watch_servoj(targets.append)
    bench.run(2)
    bench.deliver(setpoint(turned(0.0), [0.0] * 5 + [0.5]))
    most = missable(min(watchdog, 0.1), firmware.rate)
    bench.run(most + 5)
    way = [q[5] for q in targets]
    step = 0.5 / firmware.rate
    for missed in range(min(most + 5, len(way) - 1)):
        assert way[missed] == pytest.approx(how.coasting(missed) * step, abs=1e-9)
        assert way[missed + 1] - way[missed] == pytest.approx(how.share(missed + 1) * step, abs=1e-9)
    assert how.coastable == most
    assert how.late == pytest.approx(most / firmware.rate)
    assert len(way) > most


def test_slow_loop_may_be_late_by_three_periods() -> None:
    speeds = largest_speeds(arm(NEWEST))
    for period, watchdog, seconds in ((0.02, 1.0, 0.1), (0.1, 1.0, 0.3), (0.5, 1.0, 1.0)):
        assert Servoing(NEWEST, speeds, watchdog, 0.03, 300.0, period).late == pytest.approx(seconds, abs=0.004)


@pytest.mark.parametrize("late", [0.012, 0.06, 0.4], ids=lambda each: f"{1000 * each:.0f} ms")
@pytest.mark.parametrize("firmware", FIRMWARES, ids=str)
def test_arm_stays_on_trajectory_when_few_set_points_arrive(firmware: Firmware, late: float) -> None:
    """A busy computer with a long watchdog sends few set-points; the arm still stays on its path.

    Most of the time, the program coasts, at the right speed and only briefly. The fewer set-points arrive, the slower
    the arm moves.

    If the program took its speed from the last two set-points, and coasted as long as the watchdog allows, it would
    overshoot the end by 0.2 rad.
    """
    path = Trajectory.from_arrays([0.0, 0.5, 1.0], [turned(0.2), turned(0.0), turned(0.2)])
    led = follower(firmware, path, Tolerances(path=None, goal=0.01, goal_time=3.0, start=0.05), watchdog=5.0)
    feeding = Feeding(led, firmware)
    feeding.q = turned(0.2)
    program = Program(servoing(firmware, watchdog=5.0), feeding.q)
    every = max(round(late * firmware.rate), 1)
    places, errors = [program.cycle(feeding.state())[5]], []
    while not led.is_over:
        for _ in range(every - 1):
            places.append(program.cycle(b"")[5])
        feeding.q = program.q
        places.append(program.cycle(feeding.state(every))[5])
        feeding.q = program.q
        errors.append(places[-1] - led.desired(led.progress * path.duration)[0][5])
    fastest = np.abs(path.at(np.linspace(0, 1, 1000))[1]).max()
    assert np.abs(errors).max() < fastest * (min(late, 0.05) + 3 * feeding.cycle)
    assert -0.02 < min(places) < 0.02
    assert max(places) < 0.22


@pytest.mark.parametrize("firmware", [FIRMWARES[1], pytest.param(NEWEST, marks=pytest.mark.slow)], ids=str)
def test_lag_experiment_of_the_original_driver_is_reproduced(firmware: Firmware) -> None:
    """Run the program on a simulated arm: wrist 3 to 0 over 1 s, to 1 rad over 3 s and back over 4 s.

    The simulated arm lags by 0.9 of the look-ahead time plus two over the gain. Apart from this lag, it is where it
    should be. Two runs of the original driver differed by 0.03 rad. These runs are identical to the last bit.
    """
    begin = turned(0.3)
    path = Trajectory.from_arrays([0, 1, 4, 8], [begin, turned(0.0), turned(1.0), turned(0.0)])
    led = follower(firmware, path, Tolerances(path=0.05, goal=0.01, goal_time=1.0, start=0.05))
    bench = Bench(led.body(ReverseSocket("10.0.0.1", 50001, TOKEN)), firmware, begin)
    bench.run(2)
    errors = []
    lag = 0.9 * 0.03 + 2 / 300
    while not led.is_over:
        setpoint, now = bench.motion.setpoint, bench.cycle * bench.period
        messages = led.step(b"", state(50.0 + now, list(setpoint.q), setpoint.qd[5]), 1000.0 + now)
        bench.deliver(messages)
        times = led.times(50.0 + now)
        assert times is not None
        t = times[1]
        errors.append(setpoint.q[5] - path.sample(t - lag)[0][5])
        bench.run()
        assert bench.cycle < 10 * firmware.rate
    assert bench.path[-1] == pytest.approx(turned(0.0), abs=0.01)
    assert np.abs(errors[round(0.1 * firmware.rate) :]).max() < 0.005
    bench.deliver(led.farewell)
    bench.run(firmware.rate)
    assert bench.has_finished


@pytest.mark.parametrize(("held", "answered"), [(19, (18,)), (19, (0, 5, 10, 18)), (40, tuple(range(40)))])
def test_repeated_delays_keep_acceleration_bounded(held: int, answered: tuple[int, ...]) -> None:
    """Many cycles pass without a message, and then several arrive in one cycle. CB2 does not smooth the result."""
    firmware = FIRMWARES[0]
    path = Trajectory.from_arrays([0, 1, 2, 3], [turned(0), turned(0.8), turned(0.3), turned(0.5)])
    how = servoing(firmware, watchdog=2.0)
    led = Follower(path, Tolerances(path=None, goal=0.01, goal_time=1.0, start=0.05), how)
    bench = Bench(how.body(ReverseSocket("10.0.0.1", 50001, TOKEN)), firmware)
    bench.run(2)

    def seen() -> tuple[RealtimeState, float]:
        time, at = bench.cycle * bench.period, bench.motion.setpoint
        return state(50.0 + time, list(at.q), at.qd[5]), 1000.0 + time

    while not led.is_over:
        states = []
        for _ in range(held):
            states.append(seen()[0])
            bench.run()
        for each in answered:
            bench.deliver(led.step(b"", states[each], seen()[1]))
        for _ in range(3):
            bench.run()
            bench.deliver(led.step(b"", *seen()))
        assert bench.cycle < 12 * firmware.rate
    way = np.array(bench.path)
    # Without the bound, the acceleration is 250 to 370 rad/s², and the simulated arm makes a protective stop.
    assert np.abs(np.diff(way, 2, axis=0)).max() / bench.period**2 < 50.1
    assert -0.05 < way[:, 5].min() < way[:, 5].max() < 1.0
    assert bench.said == []


#: Events before a state: cycles missed here, error of its time, its delay in s, and the time in s for which the
#: controller itself is delayed, as only a simulated controller is.
_events = st.tuples(
    st.one_of(st.just(0), st.just(0), st.integers(0, 8), st.integers(0, 70)),
    st.one_of(st.just(0.0), st.sampled_from([1.0, -5.0, 0.05, -0.1, 0.002, -0.002, math.nan, math.inf, 1e9])),
    st.one_of(st.just(0.0), st.floats(0.0, 0.004), st.floats(0.0, 0.05)),
    st.one_of(st.just(0.0), st.just(0.0), st.floats(0.0, 0.1)),
)


@pytest.mark.property
@given(
    st.lists(_events, min_size=5, max_size=60),
    st.sampled_from(FIRMWARES),
    st.sampled_from([0.3, 1.0, 2.0, 3.1]),
    st.floats(0.05, 0.95),
)
def test_arm_speed_stays_limited_for_any_reported_states(
    happened: list[tuple[int, float, float, float]], firmware: Firmware, speed: float, where: float
) -> None:
    """Each set-point is within the reach of the joints in the time, and the arm still arrives."""
    cycle = 1.0 / firmware.rate
    # So short that its middle, at `speed`, is reached soon.
    trajectory = Trajectory.from_arrays([0, 0.4], [turned(0.0), turned(0.4 * speed / 1.5)])
    led = follower(firmware, trajectory)
    program = Program(servoing(firmware), turned(0.0))
    path = [program.q[5]]
    cycles, held, now, last = 0, 0.0, 1000.0, 0.0
    budget = most = cycle + EARLY + servoing(firmware).watchdog
    settled = [(0, 0.0, 0.0, 0.0)]
    for stall, off, late, hold in [
        *(settled * round(where * trajectory.duration / cycle)),
        *happened,
        *(settled * (2 * firmware.rate)),
    ]:
        held += hold
        for _ in range(stall):
            cycles += 1
            path.append(program.cycle(b"")[5])
        cycles += 1
        before, now = now, max(now, 1000.0 + cycles * cycle + held + late)
        budget = min(budget + now - before, most)
        try:
            messages = led.step(b"", state(50.0 + cycles * cycle + off, program.q), now)
        except LinkError:
            return  # a clear end: the program brakes
        if messages and message(messages)[1] == FOLLOW:
            aim = message(messages)[0][5]
            budget -= abs(aim - last) / math.pi
            assert budget >= -1e-5
            last = aim
        path.append(program.cycle(messages)[5])
        assert abs(path[-1] - path[-2]) <= math.pi * cycle + 1e-9
        if program.is_over:
            return  # no message came for too long, so the program braked on its own
        if led.is_over:
            break
    assert path[-1] == pytest.approx(trajectory.q[-1][5], abs=0.06)


# -- a pause ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("aside", [0.0, 0.02, -0.02])
@pytest.mark.parametrize("braked", [0.0, 0.06, -0.05])
def test_resume_continues_from_nearest_point_of_path(braked: float, aside: float) -> None:
    """The arm does not jump, and its distance from the path is faded out."""
    trajectory = Trajectory.from_arrays([0, 2], [turned(0), turned(1.0)])
    feeding = Feeding(follower(trajectory=trajectory))
    feeding.state(0)
    for _ in range(500):
        feeding.state()
    follows, before = feeding.follower, feeding.follower.progress * 2.0
    stands = before + braked
    feeding.q = trajectory.sample(stands)[0]
    feeding.q[0] += aside
    follows.resume(state(feeding.time, feeding.q))
    sent = [list(feeding.q)]
    for _ in range(3):
        feeding.state()
        sent.append(list(feeding.q))
    assert follows.progress * 2.0 == pytest.approx(stands, abs=5e-3)
    # The time starts slowly, where the program has braked to rest.
    assert np.abs(np.diff(sent, axis=0)).max() < 4e-3
    for _ in range(400):
        feeding.state()
    # 0.806 s of controller time have passed; the first sixth of it was slow.
    t = follows.progress * 2.0
    assert t - stands == pytest.approx(0.72, abs=0.01)
    assert feeding.q == pytest.approx(trajectory.sample(t + 2 * feeding.cycle)[0], abs=2e-3)
    while not follows.is_over:
        feeding.state()
    assert feeding.q == pytest.approx(turned(1.0), abs=1e-3)


def test_resume_before_start_begins_at_position_of_arm() -> None:
    """The motion starts where the arm is at rest at that time."""
    feeding = Feeding(follower())
    feeding.follower.resume(state(feeding.time, turned(0.02)))
    feeding.q = turned(0.02)
    feeding.state()
    feeding.state()
    assert feeding.q == pytest.approx(turned(0.02), abs=1e-3)


def test_offset_at_end_of_path_is_faded_out_afterwards() -> None:
    """The motion ends when the offset is zero."""
    trajectory = Trajectory.from_arrays([0, 1], [turned(0), turned(0.3)])
    feeding = Feeding(follower(trajectory=trajectory))
    feeding.state(0)
    for _ in range(490):
        feeding.state()
    feeding.q = trajectory.sample(0.98)[0]
    feeding.q[0] += 0.04
    feeding.follower.resume(state(feeding.time, feeding.q))
    assert feeding.follower._end > 1.1
    for _ in range(400):
        feeding.state()
    assert feeding.q == pytest.approx(turned(0.3), abs=1e-3)


def test_resume_searches_a_limited_part_of_the_trajectory() -> None:
    """The search runs from a little before the last point to one second after it, in steps of 4 ms."""
    trajectory = Trajectory.from_arrays([0, 4], [turned(0), turned(2.0)])
    led = follower(trajectory=trajectory)
    for place, found in ((2.004, 2.004), (2.9, 2.9), (3.5, 2.996), (1.9, 1.9), (1.5, 1.8)):
        assert led._nearest(trajectory.sample(place)[0], 2.0) == pytest.approx(found, abs=1e-9)


def test_progress_accounts_for_measured_lag() -> None:
    """The measured lag counts, without the cycles in it that a set-point takes to arrive."""
    led = Follower(WAVE, LOOSE, servoing(NEWEST), 0.1)
    feeding, plain = Feeding(led), Feeding(Follower(WAVE, LOOSE, servoing(NEWEST)))
    for _ in range(100):
        feeding.state()
        plain.state()
        sent = plain.follower.progress * 2.0 + AHEAD * plain.cycle
        assert led.progress * 2.0 == pytest.approx(sent - 0.1)
    passed, t = led.times(50.2) or (0.0, 0.0)
    assert passed == pytest.approx(t)
    assert t == pytest.approx(sent - 0.1)

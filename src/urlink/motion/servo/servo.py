"""Servo loops: set-points or targets from the user's loop."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from linkcore.arguments import check_number
from linkcore.errors import BadValue, LocalError
from linkcore.threads import Newest

from ...arm.vectors import JOINTS, Numbers
from ...command.program_time import ProgramTimer, reported_scaling
from ...protocol.realtime.packets import RealtimeState
from ...script.messages import WAIT_MESSAGE, setpoint
from ...script.text import integer
from ..context import MotionContext
from ..limited import FIRST_STEP, LimitedArm, check_targets
from ..moves.path import Joint, Linear, Waypoint, check_joint_positions, shown_tcp
from ..moves.speed_limit import LONGEST_PERIOD, SpeedLimit
from ..moves.trajectory import LEAP
from ..slider import SliderEffect, slider_by_use
from .block_motion import BlockMotion
from .following import AHEAD
from .jerk_limited import JointLimit
from .linked_program import Link
from .resampling import FilteredTargets, ResampledSetpoints, Schedule
from .servo_delay import measure
from .setpoints import LinkDialogue, Servoing

#: Number of newest intervals that the statistics use: 100 s at 500 Hz.
_REMEMBERED = 50_000
#: Interval between two set-points, in s, above which an error message mentions the delay.
_LATE = 0.05
#: Largest distance of any joint between the first set-point and the target position of the arm, in rad.
_NEAR = 0.05


@dataclass(frozen=True)
class ServoStatistics:
    """Statistics of the intervals between set-points, or between targets, that were sent.

    Attributes:
        count: Number of set-points or targets that were sent.
        mean: Mean interval between two set-points or targets, in s.
        p50, p99, max: Median, 99th percentile and maximum of the deviations of intervals from the period, in s.
        late: Number of intervals longer than one and a half periods.
    """

    count: int
    mean: float
    p50: float
    p99: float
    max: float
    late: int


class _Leading(LinkDialogue):
    """Dialogue of a servo. It answers each state with the next set-point of a target filter or schedule.

    Before the first set-point, it answers with `WAIT_MESSAGE`. If the user's loop sends the set-points, states after
    the first set-point are not answered.

    Args:
        servoing: Parameters for following set-points.
        resampled: Object that calculates the set-points. If None, the user's loop sends the set-points.
    """

    def __init__(self, servoing: Servoing, resampled: ResampledSetpoints | None) -> None:
        super().__init__(servoing.body)
        self.watchdog = servoing.watchdog
        #: any thread may set this attribute, but only once
        self.resampled = resampled
        self._timer = ProgramTimer(1.0 / servoing.firmware.rate)
        #: lag of the program's time behind the controller's clock, in s, and the monotonic time of this measurement, in
        #: s
        self._behind = self._at = 0.0
        #: target positions of the arm before the first message, in rad
        self.here: list[float] | None = None
        #: whether the next set-point is checked like the first one, because the program has been paused
        self.begins_anew = False

    def step(self, received: bytes, state: RealtimeState, now: float) -> bytes:
        passed, scaled = self._timer.passed(state, now)
        self._behind, self._at = self._behind + passed - scaled, now
        if self.resampled is not None:
            return self.resampled.answer(state, now)
        if self.is_mute:
            return b""
        self.here = state.q_target.tolist()
        return WAIT_MESSAGE

    def program_time(self, now: float) -> float:
        """Return monotonic time in s, minus the time that the program has lost through pauses and speed scaling."""
        return now - self._behind - (1.0 - self._timer.rate) * max(now - self._at, 0.0)

    def resume(self, state: RealtimeState) -> None:
        self._timer.restart()
        if self.resampled is not None:
            self.resampled.resume(state)
        else:
            self.here, self.begins_anew = state.q_target.tolist(), self.is_mute


@slider_by_use(
    {
        "servo, a loop by the controller's clock": SliderEffect.KEPT_UNTIL_0,
        "servo, a loop by servo.scaling": SliderEffect.SCALED,
        "servo, target filter": SliderEffect.SCALED,
        "servo, schedule": SliderEffect.KEPT_UNTIL_0,
    }
)
class Servo(BlockMotion):
    """Servo: your loop sends set-points or targets, and the arm follows; see `robot.motion.servo`.

    Use it as a ``with`` block. Send a set-point in each cycle of the controller, or in each cycle of your loop. With a
    target filter, send a target whenever you have a new one. Leaving the block stops the arm.

    Attributes:
        rate: Intended number of set-points or targets per second.
    """

    def __init__(
        self,
        context: MotionContext,
        rate: float,
        servoing: Servoing,
        open_link: Callable[[], Link],
        limits: Sequence[JointLimit] | None = None,
        delay: float | None = None,
    ) -> None:
        model = context.who.identity.arm
        cycle = 1.0 / servoing.firmware.rate
        self._servoing = servoing
        self._schedule: Schedule | None = None
        self._delay = AHEAD * cycle if delay is None else delay
        self._targets = None if limits is None else FilteredTargets(limits, cycle)
        self._dialogue = _Leading(
            servoing, None if self._targets is None else ResampledSetpoints(servoing, self._targets)
        )
        super().__init__(context, "servo", self._dialogue, open_link)
        self.rate = rate
        self._last: list[float] | None = None
        #: times in s and positions in rad of the newest set-points, and of one set-point older than `LONGEST_PERIOD`
        self._recent: list[tuple[float, list[float]]] = []
        self._began: float  # time at which the first set-point was sent
        self._sent_at: float
        #: time of the program at which the last set-point was sent, in s
        self._passed = -math.inf
        self._count = self._late = 0
        # Between set-points, in s. The thread in the block adds them.
        self._intervals: Newest[float] = Newest(_REMEMBERED)
        self._model = model
        self._limit = SpeedLimit(servoing.speeds, 1.0 / rate)
        self._cycle = cycle
        #: the arm with the limits of the session and with the TCP at the first target; None without limits
        self._limited: LimitedArm | None = None

    def _limited_arm(self) -> LimitedArm | None:
        """Return the arm with the limits of the session; None if the session has no limits."""
        if self._limited is None:
            self._limited = self._context.limited()
            if self._limited is not None:
                self._limited.check_inside()
        return self._limited

    def send(self, q: Numbers) -> None:
        """Send one set-point; with a target filter, a target.

        The first set-point must be within 0.05 rad of the target position of the arm. After that, a set-point is
        rejected if a joint cannot move to it in the time that has passed for the program (`scaling`).
        `urlink.motion.moves.speed_limit` describes this check, and how irregular a loop may be. While the program is
        paused, nothing is sent. The next set-point after a pause is checked like the first one. With a target filter,
        any target within the joint limits is accepted.

        Args:
            q: Joint positions, shape (6,), in rad.

        Raises:
            BadValue: If `q` is not six finite numbers, is too fast, or exceeds a limit of the arm. Nothing is sent.
            LimitExceeded: If the arm could exceed a limit of the session on the way to `q`, or while it brakes after
                `q`. Nothing is sent.
            SafetyStop, NotRunning, ConnectionLost, ProgramStopped, Cancelled: If the servo has ended.
            LocalError: If called outside the ``with`` block, or if waypoints were scheduled in the block.
        """
        self._check_open()
        if self._schedule is not None:
            raise LocalError("schedule() was already used in this block; use either send() or schedule(), not both")
        now = self._context.clock()
        values: list[float] = check_joint_positions(q, "q", self._model).tolist()
        limited = self._limited_arm()
        if self._targets is not None:
            if limited is not None:
                check_targets(limited, self._targets.predicted(values, limited.q.tolist()))
            self._targets.newest = values
        else:
            if self._program.is_paused:
                return
            before = None if self._dialogue.begins_anew else self._last
            passed = self._dialogue.program_time(now)
            self._check_step(before, values, passed)
            seconds = max(passed - self._passed, self._cycle) if before is not None else FIRST_STEP
            if limited is not None:
                limited.check_setpoint(before or self._dialogue.here or values, values, min(seconds, LONGEST_PERIOD))
            speeds = self._speeds(before, values, now)
            if limited is not None and not limited.can_coast(values, speeds, self._servoing.coasted):
                speeds = [0.0] * 6
            self._say(setpoint(values, speeds), self._servoing.watchdog)
            self._passed = passed
            self._limit.take(before or values, values, passed)
            self._dialogue.begins_anew = False
        self._count_one(values, now)

    def schedule(self, target: Numbers | Joint | Linear, at: float) -> float | None:
        """Schedule a waypoint for a time on the robot's clock.

        Times are on the same clock as `RealtimeState.time`. The joints move along a smooth curve from the current
        set-point through all future waypoints, to rest at the last waypoint. A waypoint replaces all waypoints with the
        same time or a later time. A pose is converted to the joint positions that are closest to the previous waypoint.
        The smaller the distance between two poses, the straighter the tool moves between them.

        Args:
            target: Joint positions, shape (6,), in rad, or a `Joint`, or a `Linear` with a pose in the base frame.
            at: Time in s on the robot's clock.

        Returns:
            Time at which the arm will arrive: `at`, or later if the limits of speed and acceleration of the arm require
            more time. None if the time `at` has passed. Then the waypoint is ignored.

        Raises:
            BadValue: If an argument is not finite, if a joint position is out of range, or if a pose requires a jump of
                a joint.
            Unreachable: If a pose is out of reach.
            SafetyStop, NotRunning, ConnectionLost, ProgramStopped, Cancelled: If the servo has ended.
            LocalError: If called outside the ``with`` block, in a servo with a target filter, or after `send`.
        """
        self._check_open()
        if self._targets is not None:
            raise LocalError("schedule() is not available with a target filter; use send() for targets")
        if self._schedule is None and self._last is not None:
            raise LocalError("send() was already used in this block; use either send() or schedule(), not both")
        time = check_number(at, "at")
        state = self._context.state()
        if self._schedule is None:
            schedule = Schedule(self._model, self._cycle, self._delay, self._context.section.lock, self._limited_arm())
            self._dialogue.resampled = ResampledSetpoints(self._servoing, schedule)
            # Set this attribute last. Otherwise an interruption could leave a schedule that is not connected to the
            # dialogue.
            self._schedule = schedule
        schedule = self._schedule
        here = state.q_target.tolist()
        q = self._joints_of(target, state, schedule.last or here)
        values = check_joint_positions(q, "q", self._model).tolist()
        reached = schedule.add(values, time, state.time, here)
        if reached is not None:
            self._count_one(values, self._context.clock())
        return reached

    def _joints_of(self, target: Numbers | Joint | Linear, state: RealtimeState, near: list[float]) -> Numbers:
        if not isinstance(target, Waypoint):
            return target
        if target.has_motion_of_its_own or not isinstance(target, (Joint, Linear)):
            raise BadValue(f"{target!r} cannot be scheduled; expected a Joint or Linear without blend and speed")
        if isinstance(target, Joint):
            return target.q
        arm = self._context.who.identity.kinematics
        q = arm.inverse(target.pose, near, shown_tcp(arm, state))
        for joint, (value, before) in enumerate(zip(q.tolist(), near, strict=True)):
            if abs(value - before) > LEAP:
                raise BadValue(
                    f"q[{joint}] ({JOINTS[joint]}) would have to move from {before:.4f} to {value:.4f} rad: the pose "
                    "is beyond a singularity, or too far from the last one"
                )
        return q

    def measure_delay(self, joint: int = 5, amplitude: float = 0.05, duration: float = 1.0) -> float:
        """Measure the delay of the arm behind its set-points. THE ARM MOVES.

        One joint moves to another position and back. Use a separate ``with`` block for this measurement. Pass the
        result to ``follow(delay=)`` and ``servo(delay=)``. The delay depends on `lookahead_time` and `gain`.

        Args:
            joint: Number of the joint, 0 to 5.
            amplitude: Amplitude of the motion in rad, with its sign.
            duration: Duration of the motion in both directions together, in s. The measurement takes half a second
                longer.

        Returns:
            Time in s from a state until the arm reaches the set-point that answered this state.

        Raises:
            BadValue: If the motion exceeds the range or the largest speed of the joint.
            LinkError: If the arm does not follow its set-points, or if the servo has ended. Then the error states the
                reason.
            LocalError: If called outside the ``with`` block, in a servo with a target filter, or after `schedule`.
        """
        self._check_open()
        if self._targets is not None or self._schedule is not None:
            raise LocalError(
                "measure_delay() cannot be used with a target filter or scheduled waypoints; call it in a separate "
                "servo block without them"
            )
        return measure(
            self._context.realtime,
            self.send,
            int(integer(joint, 0, 5, "joint")),
            check_number(amplitude, "amplitude", -0.5, 0.5),
            check_number(duration, "duration", 0.1, 60.0),
        )

    def _count_one(self, values: list[float], now: float) -> None:
        if self._last is None:
            self._dialogue.is_mute = self._dialogue.resampled is None
            self._began = now
            self._count = 1
        else:
            interval = now - self._sent_at
            # Counted first, so that there are never more intervals than set-points in `stats`.
            self._count += 1
            self._intervals.add(interval)
            if interval * self.rate > 1.5:
                self._late += 1
        self._last, self._sent_at = values, now

    @property
    def scaling(self) -> float:
        """Speed scaling of programs on the robot, as a fraction from 0 to 1, in the newest state.

        Your loop must multiply the time that passes by this factor. Otherwise the arm falls behind.

        Raises:
            LinkTimeout, RemoteError: If no state arrives.
        """
        return reported_scaling(self._context.state())

    @property
    def stats(self) -> ServoStatistics:
        """Statistics of the intervals between set-points, or between targets, that were sent.

        The deviations are those of the last 50000 intervals.
        """
        intervals = np.array(self._intervals.copy())
        if not intervals.size:
            return ServoStatistics(self._count, 0.0, 0.0, 0.0, 0.0, self._late)
        deviations = np.abs(intervals - 1.0 / self.rate)
        p50, p99 = np.percentile(deviations, (50, 99)).tolist()
        mean = (self._sent_at - self._began) / (self._count - 1)
        return ServoStatistics(self._count, mean, p50, p99, float(deviations.max()), self._late)

    def _speeds(self, before: list[float] | None, values: list[float], now: float) -> list[float]:
        """Return the speeds with which the program continues from the newest set-point, (6,) in rad/s.

        The program continues at these speeds if the next set-point is late. For each joint, the speed is the smaller of
        the speed since the previous set-point and the mean speed over the last `LONGEST_PERIOD`. It is 0 if these two
        have different directions. The reason: if this computer was delayed, a current set-point may directly follow an
        old one, and their difference is not a real speed.
        """
        recent = self._recent
        if before is None:
            recent.clear()
        recent.append((now, values))
        while len(recent) > 2 and now - recent[1][0] >= LONGEST_PERIOD:
            del recent[0]
        longer, last = self._since(*recent[0]), self._since(*recent[-2:][0])
        return [min(a, b, key=abs) if a * b > 0.0 else 0.0 for a, b in zip(longer, last, strict=True)]

    def _since(self, at: float, q: list[float]) -> list[float]:
        """Return the speeds from an earlier set-point to the newest one, (6,) in rad/s."""
        now, values = self._recent[-1]
        # Even if two set-points are sent at the same time, the program executes them in two cycles.
        seconds = max(now - at, self._cycle)
        return [(there - here) / seconds for here, there in zip(q, values, strict=True)]

    def _lateness(self) -> str:
        """Return the end of an error message about a set-point that is too far away; empty unless the loop was late."""
        late = self._context.clock() - self._sent_at
        if late <= max(1.5 / self.rate, _LATE):
            return ""
        return (
            f"; the last one was sent {late:.3f} s ago (watchdog={self._servoing.watchdog:g} s): after such a delay, "
            "continue from it in small steps, or use target_filter='jerk_limited'"
        )

    def _check_step(self, last: list[float] | None, values: list[float], now: float) -> None:
        """Reject a set-point that is too far from the last set-point, or from the arm if there is none.

        After a pause, the distance from the arm is checked again.
        """
        if last is not None:
            excess = self._limit.excess(last, values, now)
            if excess is not None:
                raise BadValue(f"{excess}{self._lateness()}")
            return
        here = self._dialogue.here
        assert here is not None  # the block opens after the first message has been sent
        for joint, (value, before) in enumerate(zip(values, here, strict=True)):
            if abs(value - before) > _NEAR:
                raise BadValue(
                    f"q[{joint}] ({JOINTS[joint]}) is {value:.4f} rad, {abs(value - before):.4f} rad from the "
                    f"position of the arm; at most {_NEAR:.4f} rad"
                )

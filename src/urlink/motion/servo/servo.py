"""Servo loops: set-points or targets from the user's own loop."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from linkcore.arguments import check_number
from linkcore.errors import BadValue, LocalError

from ...arm.vectors import JOINTS, Numbers
from ...command.program_time import ProgramTimer, reported_scaling
from ...protocol.realtime.packets import RealtimeState
from ...script.text import integer
from ..context import MotionContext
from ..links.messages import WAIT_MESSAGE, setpoint
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

#: Intervals that the statistics keep: a minute and a half at 500 Hz.
_REMEMBERED = 50_000
#: Seconds between two set-points from which on an error mentions the delay.
_LATE = 0.05
#: rad between the first set-point and the target position of the arm, at most.
_NEAR = 0.05


@dataclass(frozen=True)
class ServoStatistics:
    """How regularly set-points, or targets, were sent.

    Attributes:
        count: how many were sent.
        mean: s between two of them.
        p50, p99, max: s: the median, the 99th percentile and the largest of the deviations of that from the period.
        late: number of intervals longer than one and a half periods.
    """

    count: int
    mean: float
    p50: float
    p99: float
    max: float
    late: int


class _Leading(LinkDialogue):
    """Answers each state with the next set-point of a target filter or schedule.

    Before the first one, and if the loop sends its own set-points, it answers with `WAIT_MESSAGE`.

    Args:
        servoing: how set-points are followed.
        resampled: makes the set-points; None if the loop sends its own.
    """

    def __init__(self, servoing: Servoing, resampled: ResampledSetpoints | None) -> None:
        super().__init__(servoing.body)
        self.watchdog = servoing.watchdog
        #: set once, by any thread
        self.resampled = resampled
        self._timer = ProgramTimer(1.0 / servoing.firmware.rate)
        #: s by which the program is behind the controller's clock, and when that was measured, monotonic s
        self._behind = self._at = 0.0
        #: rad; target positions of the arm before the first message
        self.here: list[float] | None = None
        self.has_begun = False
        #: after a pause: the next set-point is as the first
        self.begins_anew = False

    def step(self, received: bytes, state: RealtimeState, now: float) -> bytes:
        passed, scaled = self._timer.passed(state, now)
        self._behind, self._at = self._behind + passed - scaled, now
        if self.resampled is not None:
            return self.resampled.answer(state, now)
        if self.has_begun:
            return b""
        self.here = state.q_target.tolist()
        return WAIT_MESSAGE

    def program_time(self, now: float) -> float:
        """Monotonic s of which those are left out in which the program stood still, or its part of them."""
        return now - self._behind - (1.0 - self._timer.rate) * max(now - self._at, 0.0)

    def resume(self, state: RealtimeState) -> None:
        self._timer.restart()
        if self.resampled is not None:
            self.resampled.resume(state)
        else:
            self.here, self.begins_anew = state.q_target.tolist(), self.has_begun


@slider_by_use(
    {
        "servo, a loop by the controller's clock": SliderEffect.KEPT_UNTIL_0,
        "servo, a loop by servo.scaling": SliderEffect.SCALED,
        "servo, target filter": SliderEffect.SCALED,
        "servo, schedule": SliderEffect.KEPT_UNTIL_0,
    }
)
class Servo(BlockMotion):
    """Sends the set-points of a loop; made by `robot.motion.servo`, and open within a ``with`` block.

    Send a set-point in each of the controller's cycles, or in each of your own; with a target filter, a target whenever
    there is one. Leaving the block stops the arm.

    Attributes:
        rate: intended number of set-points or targets per second.
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
        #: s and rad of the newest set-points, and of one that is older than `LONGEST_PERIOD`
        self._recent: list[tuple[float, list[float]]] = []
        self._began: float  # when the first was sent
        self._sent_at: float
        self._count = self._late = 0
        self._intervals: deque[float] = deque(maxlen=_REMEMBERED)
        self._model = model
        self._limit = SpeedLimit(servoing.speeds, 1.0 / rate)
        self._cycle = cycle

    def send(self, q: Numbers) -> None:
        """Send one set-point; with a target filter, a target.

        Args:
            q: (6,) joint positions, rad. With a target filter, anywhere within the joint limits. Without one, the first
                must be within 0.05 rad of the target position of the arm, and after that no joint may be led faster
                than it can move in the time of the program (`scaling`): `urlink.motion.moves.speed_limit` describes
                what is refused, and how irregular a loop may be. While the program is paused nothing is sent, and the
                next set-point after it is as the first.

        Raises:
            BadValue: not six finite numbers, too fast, or beyond a limit of the arm; nothing was sent.
            SafetyStop, NotRunning, ConnectionLost, ProgramStopped, Cancelled: the servo is over.
            LocalError: not within the block; or waypoints were scheduled in it.
        """
        self._check_open()
        if self._schedule is not None:
            raise LocalError("waypoints were scheduled, so set-points are made of them; schedule the next one too")
        now = self._context.clock()
        values: list[float] = check_joint_positions(q, "q", self._model).tolist()
        if self._targets is not None:
            self._targets.newest = values
        else:
            if self._program.is_paused:
                return
            before = None if self._dialogue.begins_anew else self._last
            passed = self._dialogue.program_time(now)
            self._check_step(before, values, passed)
            self._say(setpoint(values, self._speeds(before, values, now)), self._servoing.watchdog)
            self._limit.take(before or values, values, passed)
            self._dialogue.begins_anew = False
        self._count_one(values, now)

    def schedule(self, target: Numbers | Joint | Linear, at: float) -> float | None:
        """Be at a waypoint at a time on the robot's clock, which is that of `RealtimeState.time`.

        Between waypoints the joints move in a smooth curve, from the present set-point through all waypoints that are
        ahead, to rest at the last one. A waypoint replaces those of the same time or later. A pose becomes the joint
        positions closest to those of the waypoint before; the closer the poses are, the straighter the tool moves
        between them.

        Args:
            target: (6,) joint positions, rad, or a `Joint`; or a `Linear` with a pose in the base frame.
            at: s.

        Returns:
            when the arm will be there: `at`, or later if the limits of speed and acceleration of the arm need more
            time; None if that time is past, and nothing was changed.

        Raises:
            BadValue: not finite numbers, out of the range of a joint, or a jump of a joint.
            Unreachable: a pose is out of reach.
            SafetyStop, NotRunning, ConnectionLost, ProgramStopped, Cancelled: the servo is over.
            LocalError: not within the block; with a target filter; or after `send`.
        """
        self._check_open()
        if self._targets is not None:
            raise LocalError("a servo with a target filter takes targets by send; schedule needs one without")
        if self._schedule is None and self._last is not None:
            raise LocalError("set-points were sent in this block; it is either send or schedule")
        time = check_number(at, "at")
        state = self._context.state()
        if self._schedule is None:
            schedule = Schedule(self._model, self._cycle, self._delay, self._context.section.lock)
            self._dialogue.resampled = ResampledSetpoints(self._servoing, schedule)
            # Last: one that an interruption left without its set-points would lead nothing.
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
            raise BadValue(f"{target!r} is scheduled by its time; expected a Joint or Linear without blend and speed")
        if isinstance(target, Joint):
            return target.q
        arm = self._context.who.identity.kinematics
        q = arm.inverse(target.pose, near, shown_tcp(arm, state))
        for joint, (value, before) in enumerate(zip(q.tolist(), near, strict=True)):
            if abs(value - before) > LEAP:
                raise BadValue(
                    f"q[{joint}] ({JOINTS[joint]}) would have to go from {before:.4f} to {value:.4f} rad: the pose is "
                    "beyond a singularity, or too far from the last one"
                )
        return q

    def measure_delay(self, joint: int = 5, amplitude: float = 0.05, duration: float = 1.0) -> float:
        """Measure by how much the arm lags behind its set-points. THE ARM MOVES: one joint, there and back.

        Use it in a block of its own; what it returns is for ``follow(delay=)`` and ``servo(delay=)``. It depends on
        `lookahead_time` and `gain`.

        Args:
            joint: number of the joint, 0 to 5.
            amplitude: rad of the movement, with its sign.
            duration: s for the movement there and back; measuring takes half a second more.

        Returns:
            s from a state to the one in which the arm is at the set-point that answered it.

        Raises:
            BadValue: the movement is beyond the range or the speed of the joint.
            LinkError: the arm does not follow, or what ended the servo.
            LocalError: not within the block, with a target filter, or while waypoints are scheduled.
        """
        self._check_open()
        if self._targets is not None or self._schedule is not None:
            raise LocalError("the delay is measured in a block of its own, without target filter and waypoints")
        return measure(
            self._context.realtime,
            self.send,
            int(integer(joint, 0, 5, "joint")),
            check_number(amplitude, "amplitude", -0.5, 0.5),
            check_number(duration, "duration", 0.1, 60.0),
        )

    def _count_one(self, values: list[float], now: float) -> None:
        if self._last is None:
            self._dialogue.has_begun = True
            self._began = now
        else:
            interval = now - self._sent_at
            self._intervals.append(interval)
            if interval * self.rate > 1.5:
                self._late += 1
        self._count += 1
        self._last, self._sent_at = values, now

    @property
    def scaling(self) -> float:
        """The fraction of its speed with which the robot executes programs, 0 to 1, by the newest state.

        A loop of your own lets its own time pass so much slower; otherwise the arm falls behind it.

        Raises:
            LinkTimeout, RemoteError: no state comes.
        """
        return reported_scaling(self._context.state())

    @property
    def stats(self) -> ServoStatistics:
        """How regularly set-points, or targets, were sent; deviations are of the last 50000 intervals."""
        intervals = np.array(self._intervals)
        if not intervals.size:
            return ServoStatistics(self._count, 0.0, 0.0, 0.0, 0.0, self._late)
        deviations = np.abs(intervals - 1.0 / self.rate)
        p50, p99 = np.percentile(deviations, (50, 99)).tolist()
        mean = (self._sent_at - self._began) / (self._count - 1)
        return ServoStatistics(self._count, mean, p50, p99, float(deviations.max()), self._late)

    def _speeds(self, before: list[float] | None, values: list[float], now: float) -> list[float]:
        """(6,) rad/s since the set-point `before`, if any: the program goes on at these if the next one is late.

        No faster than over the last `LONGEST_PERIOD`, and in no other direction: after this computer was held up, an
        old set-point may be followed at once by a current one, and their difference is not a speed.
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
        """(6,) rad/s from a set-point that was sent to the newest one."""
        now, values = self._recent[-1]
        # Two set-points that are sent at once still are for two cycles.
        seconds = max(now - at, self._cycle)
        return [(there - here) / seconds for here, there in zip(q, values, strict=True)]

    def _lateness(self) -> str:
        """The end of the message about a set-point that is too far away, if the loop was late."""
        late = self._context.clock() - self._sent_at
        if late <= max(1.5 / self.rate, _LATE):
            return ""
        return (
            f"; the last one was sent {late:.3f} s ago (watchdog={self._servoing.watchdog:g} s): after such a delay, "
            "continue from it in small steps, or use target_filter='jerk_limited'"
        )

    def _check_step(self, last: list[float] | None, values: list[float], now: float) -> None:
        """Refuse what is too far from the last set-point; the first one, also after a pause, from where the arm is."""
        if last is not None:
            excess = self._limit.excess(last, values, now)
            if excess is not None:
                raise BadValue(f"{excess}{self._lateness()}")
            return
        here = self._dialogue.here
        assert here is not None  # the block opens after the first message was sent
        for joint, (value, before) in enumerate(zip(values, here, strict=True)):
            if abs(value - before) > _NEAR:
                raise BadValue(
                    f"q[{joint}] ({JOINTS[joint]}) is {value:.4f} rad, {abs(value - before):.4f} rad from where the "
                    f"arm is; at most {_NEAR:.4f} rad"
                )

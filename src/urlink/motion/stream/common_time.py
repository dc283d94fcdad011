"""Common time for several arms: it begins at the same moment for all arms, and passes as slowly as for the slowest arm.

For trajectories, this computer calculates the set-points. The common time is then a function of this computer's clock.
Each state of an arm contains the time of the arm's controller, which `RobotClock` converts to this clock. Therefore
delays of the states do not matter. If the states of one arm do not arrive, or if its program is paused, the common time
stops for all arms.

For streams, programs on the robots buffer the points. Instead of a common time, the pace of each program is controlled
(`urlink.script.buffering`), so that no stream goes ahead of another stream.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable

from ...command.program_time import RAMP, ProgramTimer
from ...protocol.realtime.packets import RealtimeState
from ..servo.following import AHEAD

#: Time in s between the moment when the last arm is ready and the beginning. Within this time, states and set-points of
#: all arms can arrive (chosen). If the states of an arm take longer, this arm begins late and catches up.
_LEAD = 0.05
#: Time in s without a state, after which the common time stops. Chosen: by default, a program brakes after this time.
_SILENT = 0.1
#: If an arm is ahead of the common time or behind it: time constant of the correction in s, and largest change of the
#: arm's pace as a fraction. Chosen: new estimates of the clocks then cause no jerk, and a follower uses the same
#: fraction to catch up (`urlink.motion.servo.follower`).
_SETTLING, _MOST = 0.2, 0.1


class CommonTime:
    """Common time of all trajectories of a group. The methods may be called from any thread.

    Attributes:
        began: Monotonic time of this computer at which the trajectories begin, in s; None while an arm is not ready.
        rate: Seconds of the common time per second of this computer.
    """

    def __init__(self) -> None:
        self.began: float | None = None
        self.rate = 1.0
        self._lock = threading.Lock()
        #: in the order of joining; a dictionary, so that a member can leave in one step, even in a signal handler
        self._members: dict[MemberTimer, None] = {}
        #: newest known moment: monotonic time of this computer, and common time, in s
        self._local, self._time = -math.inf, 0.0

    def member(self, to_local: Callable[[float], float], cycle: float) -> MemberTimer:
        """Add an arm, and return the timer of this arm.

        Args:
            to_local: Function that converts the time of the arm's controller to monotonic time of this computer, in s.
            cycle: Cycle of the arm's controller, in s.
        """
        member = MemberTimer(self, to_local, cycle)
        self._members[member] = None
        return member

    def leave(self, member: MemberTimer) -> None:
        """Remove an arm whose motion has ended, so that this arm does not delay the others."""
        self._members.pop(member, None)

    def at(self, local: float) -> float:
        """Return the common time, in s, at a monotonic time of this computer.

        This time must be close to the newest state.
        """
        return self._time + self.rate * (local - self._local)

    def look(self, local: float, now: float) -> None:
        """Advance to `local`, the time of a state that arrived at `now`; both are monotonic times in s."""
        with self._lock:
            running = list(self._members)
            wanted = min((member.own_rate(now) for member in running), default=0.0)
            if self.began is None:
                if not all(member.is_ready for member in running):
                    return
                self.began = self._local = max(local, now) + _LEAD
                self.rate = wanted
            seconds = local - self._local
            if seconds > 0.0:
                change = min(max(wanted - self.rate, -RAMP * seconds), RAMP * seconds)
                time = self._time + (self.rate + 0.5 * change) * seconds
                self._local, self._time, self.rate = local, time, self.rate + change


class MemberTimer(ProgramTimer):
    """Timer of one arm's trajectory in a group. `CommonTime.member` returns such timers.

    Attributes:
        is_ready: Whether the arm can begin.
        is_paused: Function that returns whether the program of the arm is paused.
    """

    def __init__(self, common: CommonTime, to_local: Callable[[float], float], cycle: float) -> None:
        super().__init__(cycle)
        self.is_ready = False
        self.is_paused: Callable[[], bool] = bool
        self._common = common
        self._to_local = to_local
        self._own = ProgramTimer(cycle)
        #: for the newest state: time since the previous state, and monotonic times of this computer at which it was
        #: sent and at which it arrived, in s
        self._seconds, self._local, self._seen = 0.0, -math.inf, -math.inf

    def leave(self) -> None:
        """Remove this arm from the group after the end of its motion."""
        self._common.leave(self)
        self.is_paused = bool

    def own_rate(self, now: float) -> float:
        """Return the seconds of the arm's program per second of the controller, as far as known at the time `now`."""
        return 0.0 if self.is_paused() or now - self._seen > _SILENT else self._own.rate

    def passed(self, state: RealtimeState, now: float) -> tuple[float, float]:
        """Advance the common time; return the times that have passed, see `ProgramTimer.passed`."""
        seconds, scaled = self._own.passed(state, now)
        local = self._to_local(state.time) if math.isfinite(state.time) else now
        self._seconds, self._local, self._seen = seconds, local, now
        self._common.look(local, now)
        self.rate = self._common.rate
        return seconds, scaled

    def beginning(self) -> float | None:
        """Return the common time; None before the common time has begun."""
        self.is_ready = True
        began = self._common.began
        return None if began is None or self._local < began else self._common.at(self._local)

    def after(self, t: float, scaled: float) -> float:
        """Return the new time on the trajectory, with a correction towards the common time."""
        step = self.rate * self._seconds
        off = self._common.at(self._local) - (t + step)
        most = _MOST * step
        return t + step + min(max(off * self._seconds / _SETTLING, -most), most)

    def restart(self) -> None:
        """Continue after a pause."""
        self._own.restart()


class CommonPace:
    """Common pace of the streams of a group. The methods may be called from any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        #: in the order of joining; a dictionary, so that a member can leave in one step, even in a signal handler
        self._members: dict[MemberPace, None] = {}
        #: common rate in seconds of the streams per second of this computer, monotonic time of this computer for which
        #: the rate is valid, in s, and target of the rate
        self._rate, self._local, self._wanted = 0.0, -math.inf, 0.0
        #: whether all arms are stopped until each of them can move along its points
        self._holds = True

    def member(self, to_local: Callable[[float], float], cycle: float) -> MemberPace:
        """Add an arm, and return the pace of this arm; for the arguments, see `CommonTime.member`."""
        member = MemberPace(self, to_local, cycle)
        self._members[member] = None
        return member

    def leave(self, member: MemberPace) -> None:
        """Remove an arm whose stream has ended, so that this arm does not delay the others."""
        self._members.pop(member, None)

    def at(self, local: float) -> float:
        """Return the common rate at the monotonic time `local` of this computer, close to the newest state.

        The rate is in seconds of the streams per second of this computer.
        """
        most = RAMP * max(local - self._local, 0.0)
        return self._rate + min(max(self._wanted - self._rate, -most), most)

    def look(self, local: float, now: float) -> None:
        """Advance to `local`, the time of a state that arrived at `now`; both are monotonic times in s."""
        with self._lock:
            busy = [each for each in list(self._members) if not each.is_idle]
            are_led = bool(busy) and all(each.is_led for each in busy)
            if not busy or (self._rate == 0.0 and not are_led):
                self._rate, self._local, self._wanted, self._holds = 0.0, local, 0.0, True
            elif self._holds:
                # The beginning is in the future, so that all arms receive the new pace in time.
                self._local, self._holds = max(local, now) + _LEAD, False
            elif local > self._local:
                self._rate, self._local = self.at(local), local
                self._wanted = min(each.own_rate(now) for each in busy)

    def lead(self, place: float, local: float) -> float:
        """Return the time in s by which a stream is ahead of the slowest stream that has points.

        Args:
            place: Time on the stream's clock, in s, at the moment `local`.
            local: Monotonic time of this computer, in s.
        """
        busy = [each.place_at(local, self._rate) for each in list(self._members) if not each.is_idle]
        return place - min(busy, default=place)


class MemberPace:
    """Pace of one arm's stream in a group. `CommonPace.member` returns such paces.

    Attributes:
        is_paused: Function that returns whether the program of the arm is paused.
        is_idle: Whether the stream has no points left. Then this arm does not delay the other arms.
        is_led: Whether the arm is moving along its points, so that its pace can be controlled.
    """

    def __init__(self, common: CommonPace, to_local: Callable[[float], float], cycle: float) -> None:
        self.is_paused: Callable[[], bool] = bool
        self.is_idle, self.is_led = True, False
        self._common = common
        self._to_local = to_local
        self._cycle = cycle
        #: values from the newest state: seconds of the program per second of the controller; time on the clock of the
        #: stream, in s; monotonic times of this computer at which the state was sent and at which it arrived, in s
        self._rate, self._place, self._local, self._seen = 0.0, 0.0, -math.inf, -math.inf

    def leave(self) -> None:
        """Remove this arm from the group after the end of its stream."""
        self._common.leave(self)
        self.is_paused = bool

    def own_rate(self, now: float) -> float:
        """Return the largest possible rate of the stream, as far as known at the time `now`.

        The rate is in seconds of the stream per second of the controller.
        """
        is_halted = not self.is_led or self.is_paused() or now - self._seen > _SILENT
        return 0.0 if is_halted else self._rate

    def place_at(self, local: float, rate: float) -> float:
        """Return the time on the stream's clock at the monotonic time `local`, in s.

        It is assumed that the stream advances at `rate`.
        """
        since = min(max(local - self._local, -_SILENT), _SILENT)
        return self._place + (rate * since if self.is_led else 0.0)

    def look(self, time: float, now: float, place: float, rate: float, *, is_led: bool, is_idle: bool) -> float:
        """Record a state, and return the pace for the program: seconds of the stream per second of the program.

        Args:
            time: Time of the state, in s on the controller's clock.
            now: Arrival of the state, in monotonic s of this computer.
            place: Time on the clock of the stream at the time of the state, in s.
            rate: Seconds of the program per second of the controller.
            is_led, is_idle: See the attributes.
        """
        local, ahead = self._to_local(time) if math.isfinite(time) else now, AHEAD * self._cycle
        # The arm is ahead of its newest report and state by the time `ahead`. If this time were ignored for two arms
        # with different cycles, one arm would be ahead of the other by the difference.
        self._place = place + self._common.at(local) * ahead if is_led else place
        self._rate, self._local, self._seen, self.is_led, self.is_idle = rate, local, now, is_led, is_idle
        self._common.look(local, now)
        if not is_led:
            return 0.0
        wanted = self._common.at(local + ahead)
        lead = self._common.lead(self._place, local) / _SETTLING
        # An arm that is slower than the others moves as fast as it can.
        return (1.0 if rate <= wanted else wanted / rate) * (1.0 - min(max(lead, 0.0), 1.0))

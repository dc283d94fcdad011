"""A common time for several arms: it begins for all at once, and passes as slowly as for the slowest arm.

For trajectories, whose set-points are computed here, the common time is a function of this computer's clock. The states
of each arm contain a time of its own controller, which `RobotClock` converts. Therefore it does not matter how long the
states took to arrive. If the states of one program do not arrive, or if it is paused, the common time stops for all.

For streams, whose points are buffered by programs on the robots, it is the pace of each program
(`urlink.script.buffering`): no stream goes ahead of another one.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable

from ...command.program_time import RAMP, ProgramTimer
from ...protocol.realtime.packets import RealtimeState
from ..servo.following import AHEAD

#: Time in s from when the last arm is ready until the beginning. States and set-points of all arms arrive in this time.
#: Chosen; an arm whose states take longer begins late, and catches up.
_LEAD = 0.05
#: Time in s without a state. After it, the common time stops. Chosen: by default, a program brakes after this time.
_SILENT = 0.1
#: Time in s for moving an arm that is ahead or behind to the common time, and the largest fraction of its speed for
#: that. Chosen: new estimates of the clocks then make no jerk, and a follower catches up by this fraction
#: (`urlink.motion.servo.follower`).
_SETTLING, _MOST = 0.2, 0.1


class CommonTime:
    """The time of all trajectories of a group. Its methods may be called from any thread.

    Attributes:
        began: Monotonic time of this computer, in s, when the trajectories begin; None while an arm is not ready.
        rate: Seconds of the common time per second of this computer.
    """

    def __init__(self) -> None:
        self.began: float | None = None
        self.rate = 1.0
        self._lock = threading.RLock()  # re-entrant for signal handlers
        #: in the order of joining; a dictionary, so that a member can leave in one step, even in a signal handler
        self._members: dict[MemberTimer, None] = {}
        #: time reached so far: monotonic time of this computer, and common time, in s
        self._local, self._time = -math.inf, 0.0

    def member(self, to_local: Callable[[float], float], cycle: float) -> MemberTimer:
        """Return the timer of one more arm.

        Args:
            to_local: Function that converts the time of the arm's controller to monotonic time of this computer, in s.
            cycle: Cycle of its controller, in s.
        """
        member = MemberTimer(self, to_local, cycle)
        self._members[member] = None
        return member

    def leave(self, member: MemberTimer) -> None:
        """Remove an arm whose motion has ended, so that it does not delay the others."""
        self._members.pop(member, None)

    def at(self, local: float) -> float:
        """Return the common time in s at a monotonic time of this computer, near the newest state."""
        return self._time + self.rate * (local - self._local)

    def look(self, local: float, now: float) -> None:
        """Advance to `local`, the time of a state that has arrived `now`; both are monotonic s of this computer."""
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
    """Timer of the trajectory of one arm of a group. `CommonTime.member` makes it.

    Attributes:
        is_ready: Whether the arm can begin.
        is_paused: Function that returns whether its program is paused.
    """

    def __init__(self, common: CommonTime, to_local: Callable[[float], float], cycle: float) -> None:
        super().__init__(cycle)
        self.is_ready = False
        self.is_paused: Callable[[], bool] = bool
        self._common = common
        self._to_local = to_local
        self._own = ProgramTimer(cycle)
        #: for the newest state: s since the previous one, and monotonic s of this computer at its time and its arrival
        self._seconds, self._local, self._seen = 0.0, -math.inf, -math.inf

    def leave(self) -> None:
        """Handle the end of the motion of this arm."""
        self._common.leave(self)
        self.is_paused = bool

    def own_rate(self, now: float) -> float:
        """Return the seconds of the arm's program per second of its controller, as far as known `now`."""
        return 0.0 if self.is_paused() or now - self._seen > _SILENT else self._own.rate

    def passed(self, state: RealtimeState, now: float) -> tuple[float, float]:
        """Return the times that have passed, as for a single program; see `ProgramTimer.passed`."""
        seconds, scaled = self._own.passed(state, now)
        local = self._to_local(state.time) if math.isfinite(state.time) else now
        self._seconds, self._local, self._seen = seconds, local, now
        self._common.look(local, now)
        self.rate = self._common.rate
        return seconds, scaled

    def beginning(self) -> float | None:
        """Return the common time, when it has begun; None before."""
        self.is_ready = True
        began = self._common.began
        return None if began is None or self._local < began else self._common.at(self._local)

    def after(self, t: float, scaled: float) -> float:
        """Return the time on the trajectory, changed towards the common time."""
        step = self.rate * self._seconds
        off = self._common.at(self._local) - (t + step)
        most = _MOST * step
        return t + step + min(max(off * self._seconds / _SETTLING, -most), most)

    def restart(self) -> None:
        """Continue after a pause."""
        self._own.restart()


class CommonPace:
    """Common pace of the streams of a group. Its methods may be called from any thread."""

    def __init__(self) -> None:
        self._lock = threading.RLock()  # re-entrant for signal handlers
        #: in the order of joining; a dictionary, so that a member can leave in one step, even in a signal handler
        self._members: dict[MemberPace, None] = {}
        #: seconds of the streams per second of this computer, its monotonic time in s, and the target of this rate
        self._rate, self._local, self._wanted = 0.0, -math.inf, 0.0
        #: whether all arms are stopped until each one passes points
        self._holds = True

    def member(self, to_local: Callable[[float], float], cycle: float) -> MemberPace:
        """Return the pace of one more arm; for the arguments, see `CommonTime.member`."""
        member = MemberPace(self, to_local, cycle)
        self._members[member] = None
        return member

    def leave(self, member: MemberPace) -> None:
        """Remove an arm whose stream has ended, so that it does not delay the others."""
        self._members.pop(member, None)

    def at(self, local: float) -> float:
        """Return seconds of the streams per second of this computer, at its time `local`, near the newest state."""
        most = RAMP * max(local - self._local, 0.0)
        return self._rate + min(max(self._wanted - self._rate, -most), most)

    def look(self, local: float, now: float) -> None:
        """Advance to `local`, the time of a state that has arrived `now`; both are monotonic s of this computer."""
        with self._lock:
            busy = [each for each in list(self._members) if not each.is_idle]
            are_led = bool(busy) and all(each.is_led for each in busy)
            if not busy or (self._rate == 0.0 and not are_led):
                self._rate, self._local, self._wanted, self._holds = 0.0, local, 0.0, True
            elif self._holds:
                # The beginning is later than now, so that all arms receive it in time.
                self._local, self._holds = max(local, now) + _LEAD, False
            elif local > self._local:
                self._rate, self._local = self.at(local), local
                self._wanted = min(each.own_rate(now) for each in busy)

    def lead(self, place: float, local: float) -> float:
        """Return by how much a stream is ahead of the slowest stream with points, in s.

        Args:
            place: Time on the stream's clock, in s, at the moment `local`.
            local: Monotonic time of this computer, in s.
        """
        busy = [each.place_at(local, self._rate) for each in list(self._members) if not each.is_idle]
        return place - min(busy, default=place)


class MemberPace:
    """Pace of the stream of one arm of a group. `CommonPace.member` makes it.

    Attributes:
        is_paused: Function that returns whether its program is paused.
        is_idle: Whether it has no points left, so that it does not delay the others.
        is_led: Whether it passes points.
    """

    def __init__(self, common: CommonPace, to_local: Callable[[float], float], cycle: float) -> None:
        self.is_paused: Callable[[], bool] = bool
        self.is_idle, self.is_led = True, False
        self._common = common
        self._to_local = to_local
        self._cycle = cycle
        #: by the newest state: seconds of its program per second of its controller; time on its clock, in s; monotonic
        #: time of this computer at its time and at its arrival, in s
        self._rate, self._place, self._local, self._seen = 0.0, 0.0, -math.inf, -math.inf

    def leave(self) -> None:
        """Handle the end of the stream of this arm."""
        self._common.leave(self)
        self.is_paused = bool

    def own_rate(self, now: float) -> float:
        """Return the largest number of seconds of the stream per second of its controller, as far as known `now`."""
        is_halted = not self.is_led or self.is_paused() or now - self._seen > _SILENT
        return 0.0 if is_halted else self._rate

    def place_at(self, local: float, rate: float) -> float:
        """Return the time on its clock, in s, at a monotonic time of this computer, if it passes with `rate`."""
        since = min(max(local - self._local, -_SILENT), _SILENT)
        return self._place + (rate * since if self.is_led else 0.0)

    def look(self, time: float, now: float, place: float, rate: float, *, is_led: bool, is_idle: bool) -> float:
        """Return the pace for its program: seconds of the stream per second of the program.

        Args:
            time: Time of a state, in s on the controller's clock.
            now: Arrival of the state, in monotonic s of this computer.
            place: Time on the clock of the stream at that time, in s.
            rate: Seconds of the program per second of the controller.
            is_led, is_idle: See the attributes.
        """
        local, ahead = self._to_local(time) if math.isfinite(time) else now, AHEAD * self._cycle
        # A report and a state are older by this time. If the cycles of two arms differ, the arms would be apart by the
        # difference.
        self._place = place + self._common.at(local) * ahead if is_led else place
        self._rate, self._local, self._seen, self.is_led, self.is_idle = rate, local, now, is_led, is_idle
        self._common.look(local, now)
        if not is_led:
            return 0.0
        wanted = self._common.at(local + ahead)
        lead = self._common.lead(self._place, local) / _SETTLING
        # An arm that is slower than the others passes as fast as it can.
        return (1.0 if rate <= wanted else wanted / rate) * (1.0 - min(max(lead, 0.0), 1.0))

"""A common time for several arms: it begins for all at once, and passes as slowly as for the slowest arm.

Of trajectories, whose set-points are made here, it is a function of this computer's clock. Each arm's states have a
time of its own controller, which `RobotClock` converts, so it does not matter how long they took to arrive. A
program whose states do not come, or that is paused, halts it for all.

Of streams, whose points are in programs on the robots, it is the pace of each program (`urlink.script.buffering`): no
stream goes ahead of another one.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable

from ...command.program_time import RAMP, ProgramTimer
from ...protocol.realtime.packets import RealtimeState
from ..servo.following import AHEAD

#: s from when the last arm is ready to the beginning: states and set-points of all arms get through in that. Chosen; an
#: arm whose states take longer begins late, and catches up.
_LEAD = 0.05
#: s without a state after which the time stands still. Chosen: those after which a program brakes, by default.
_SILENT = 0.1
#: s in which an arm that is ahead or behind is led to the common time, and the fraction of its speed for that at most.
#: Chosen: what the clocks show anew makes no jerk, and a follower catches up by so much
#: (`urlink.motion.servo.follower`).
_SETTLING, _MOST = 0.2, 0.1


class CommonTime:
    """The time of all trajectories of a group. Any thread may call.

    Attributes:
        began: monotonic s of this computer at which they begin; None while an arm is not ready.
        rate: seconds of it per second of this computer.
    """

    def __init__(self) -> None:
        self.began: float | None = None
        self.rate = 1.0
        self._lock = threading.Lock()
        #: in the order of joining; a dictionary, since a member leaves in one step, also in a signal handler
        self._members: dict[MemberTimer, None] = {}
        #: where it has got to: monotonic s of this computer, and s of its own
        self._local, self._time = -math.inf, 0.0

    def member(self, to_local: Callable[[float], float], cycle: float) -> MemberTimer:
        """The timer of one more arm.

        Args:
            to_local: converts s of the arm's controller to monotonic s of this computer.
            cycle: s of its controller.
        """
        member = MemberTimer(self, to_local, cycle)
        self._members[member] = None
        return member

    def leave(self, member: MemberTimer) -> None:
        """The motion of that arm is over, so it holds up nobody."""
        self._members.pop(member, None)

    def at(self, local: float) -> float:
        """s of it at monotonic s of this computer, near the newest state."""
        return self._time + self.rate * (local - self._local)

    def look(self, local: float, now: float) -> None:
        """Go on until `local`, the time of a state that has come `now`, both monotonic s of this computer."""
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
    """The time of the trajectory of one arm of a group; made by `CommonTime.member`.

    Attributes:
        is_ready: the arm can begin.
        is_paused: returns whether its program is paused.
    """

    def __init__(self, common: CommonTime, to_local: Callable[[float], float], cycle: float) -> None:
        super().__init__(cycle)
        self.is_ready = False
        self.is_paused: Callable[[], bool] = bool
        self._common = common
        self._to_local = to_local
        self._own = ProgramTimer(cycle)
        #: of the newest state: s since the one before, monotonic s of this computer at its time and at its arrival
        self._seconds, self._local, self._seen = 0.0, -math.inf, -math.inf

    def leave(self) -> None:
        """The motion of this arm is over."""
        self._common.leave(self)
        self.is_paused = bool

    def own_rate(self, now: float) -> float:
        """Seconds of the program on this arm per second of its controller, as far as is known `now`."""
        return 0.0 if self.is_paused() or now - self._seen > _SILENT else self._own.rate

    def passed(self, state: RealtimeState, now: float) -> tuple[float, float]:
        """As for a program by itself."""
        seconds, scaled = self._own.passed(state, now)
        local = self._to_local(state.time) if math.isfinite(state.time) else now
        self._seconds, self._local, self._seen = seconds, local, now
        self._common.look(local, now)
        self.rate = self._common.rate
        return seconds, scaled

    def beginning(self) -> float | None:
        """The common time, once it has begun."""
        self.is_ready = True
        began = self._common.began
        return None if began is None or self._local < began else self._common.at(self._local)

    def after(self, t: float, scaled: float) -> float:
        """Towards the common time."""
        step = self.rate * self._seconds
        off = self._common.at(self._local) - (t + step)
        most = _MOST * step
        return t + step + min(max(off * self._seconds / _SETTLING, -most), most)

    def restart(self) -> None:
        """Go on after a pause."""
        self._own.restart()


class CommonPace:
    """How fast the streams of a group pass. Any thread may call."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        #: in the order of joining; a dictionary, since a member leaves in one step, also in a signal handler
        self._members: dict[MemberPace, None] = {}
        #: seconds of the streams per second of this computer, at monotonic s of it, and to what that goes
        self._rate, self._local, self._wanted = 0.0, -math.inf, 0.0
        #: all stand, until each goes through points
        self._holds = True

    def member(self, to_local: Callable[[float], float], cycle: float) -> MemberPace:
        """The pace of one more arm; its arguments are those of `CommonTime.member`."""
        member = MemberPace(self, to_local, cycle)
        self._members[member] = None
        return member

    def leave(self, member: MemberPace) -> None:
        """The stream of that arm is over, so it holds up nobody."""
        self._members.pop(member, None)

    def at(self, local: float) -> float:
        """Seconds of the streams per second of this computer at monotonic s of it, near the newest state."""
        most = RAMP * max(local - self._local, 0.0)
        return self._rate + min(max(self._wanted - self._rate, -most), most)

    def look(self, local: float, now: float) -> None:
        """Go on until `local`, the time of a state that has come `now`, both monotonic s of this computer."""
        with self._lock:
            busy = [each for each in list(self._members) if not each.is_idle]
            are_led = bool(busy) and all(each.is_led for each in busy)
            if not busy or (self._rate == 0.0 and not are_led):
                self._rate, self._local, self._wanted, self._holds = 0.0, local, 0.0, True
            elif self._holds:
                # Later, so that all receive it in time.
                self._local, self._holds = max(local, now) + _LEAD, False
            elif local > self._local:
                self._rate, self._local = self.at(local), local
                self._wanted = min(each.own_rate(now) for each in busy)

    def lead(self, place: float, local: float) -> float:
        """s by which a stream is ahead of the one that is furthest behind, of those that have points.

        Args:
            place: s on its clock, at `local`, monotonic s of this computer.
        """
        busy = [each.place_at(local, self._rate) for each in list(self._members) if not each.is_idle]
        return place - min(busy, default=place)


class MemberPace:
    """The pace of the stream of one arm of a group; made by `CommonPace.member`.

    Attributes:
        is_paused: returns whether its program is paused.
        is_idle: it has no points left, so it holds up nobody.
        is_led: it goes through points.
    """

    def __init__(self, common: CommonPace, to_local: Callable[[float], float], cycle: float) -> None:
        self.is_paused: Callable[[], bool] = bool
        self.is_idle, self.is_led = True, False
        self._common = common
        self._to_local = to_local
        self._cycle = cycle
        #: by the newest state: seconds of its program per second of its controller; s on its clock; monotonic s of this
        #: computer at its time and at its arrival
        self._rate, self._place, self._local, self._seen = 0.0, 0.0, -math.inf, -math.inf

    def leave(self) -> None:
        """The stream of this arm is over."""
        self._common.leave(self)
        self.is_paused = bool

    def own_rate(self, now: float) -> float:
        """Seconds of the stream that pass per second of its controller at most, as far as is known `now`."""
        is_halted = not self.is_led or self.is_paused() or now - self._seen > _SILENT
        return 0.0 if is_halted else self._rate

    def place_at(self, local: float, rate: float) -> float:
        """s on its clock at monotonic s of this computer, if it passes with `rate`."""
        since = min(max(local - self._local, -_SILENT), _SILENT)
        return self._place + (rate * since if self.is_led else 0.0)

    def look(self, time: float, now: float, place: float, rate: float, *, is_led: bool, is_idle: bool) -> float:
        """What its program is to be sent: seconds of the stream per second of the program.

        Args:
            time: of a state, s of the controller.
            now: its arrival, monotonic s of this computer.
            place: s on the clock of the stream at that time.
            rate: seconds of the program per second of the controller.
            is_led, is_idle: see the attributes.
        """
        local, ahead = self._to_local(time) if math.isfinite(time) else now, AHEAD * self._cycle
        # What a report says, and a state shows, is so much older: of two cycles that differ, arms would be apart.
        self._place = place + self._common.at(local) * ahead if is_led else place
        self._rate, self._local, self._seen, self.is_led, self.is_idle = rate, local, now, is_led, is_idle
        self._common.look(local, now)
        if not is_led:
            return 0.0
        wanted = self._common.at(local + ahead)
        lead = self._common.lead(self._place, local) / _SETTLING
        # An arm that is slower than the others passes as fast as it can.
        return (1.0 if rate <= wanted else wanted / rate) * (1.0 - min(max(lead, 0.0), 1.0))

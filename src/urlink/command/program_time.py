"""How much time passes on the controller and for a program, from the times in states; and the pauses of a program.

The speed slider and the controller's own limits slow down all motion of a program, streamed set-points too; where a
program is paused, or the slider is at 0, its time stands still (docs/protocols/urscript.md, Speed scaling). A state
reports the fraction of this moment. The ramp with which each program starts is not reported. After a pause, the arm has
to be where the program has left it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from linkcore.handle import Lifecycle
from linkcore.streaming.packet_queue import latest
from linkcore.streaming.peer_clock import EARLIER
from linkcore.streaming.stream import Stream

from ..arm.vectors import JOINTS
from ..errors import ToleranceExceeded
from ..protocol.enums import ProgramState
from ..protocol.realtime.packets import RealtimeState

#: Whose time a trajectory has: that of the program on the robot, or that of the controller's clock.
ScalingName = Literal["follow", "ignore"]

#: 1/s with which the scaling changes, and rises from 0 where a paused program goes on, which is not reported.
RAMP = 6.25
_PAUSED = (ProgramState.PAUSING, ProgramState.PAUSED)


def is_paused(state: RealtimeState) -> bool:
    """Whether the program is paused, as far as that is reported: from 3.2 on."""
    return state.program_state in _PAUSED


def reported_scaling(state: RealtimeState) -> float:
    """The fraction of its speed with which a program is executed, 0 to 1; 1 on CB2, which does not report it."""
    if is_paused(state):  # before 3.10 it is not in the scaling
        return 0.0
    scaling = state.speed_scaling
    # A comparison that NaN fails too.
    return 1.0 if scaling is None or not 0.0 <= scaling <= 1.0 else scaling


class ControllerTimer:
    """Measures how much time passes on the controller, by the times in its states, as far as these are plausible.

    A state cannot come before its time. How long states take to arrive is not known, but the quickest of them gives a
    bound: a state that would be quicker by more than `EARLIER` has a wrong time. So states that were delayed, or are
    read late, may come together, and the time of each counts. This also holds for a simulated controller that was
    delayed and catches up faster than time passes.

    For a state with no time, or one in the past or too far in the future, this computer's clock counts, with one cycle
    at least. The states after it are compared with it.

    Args:
        cycle: seconds of the controller's cycle.
    """

    def __init__(self, cycle: float) -> None:
        self._cycle = cycle
        self._last: tuple[float, float] | None = None
        #: s from the time of a state to its arrival, each on its own clock: of the quickest; from the first state on
        self._quickest: float

    def passed(self, time: float, now: float) -> float:
        """Seconds since the last state; 0 for the first.

        Args:
            time: of the state, on the controller's clock.
            now: its arrival, monotonic s.
        """
        last, self._last = self._last, (time, now)
        way = now - time
        if last is None:
            self._quickest = way
            return 0.0
        elapsed = time - last[0]
        if elapsed >= 0.0 and way >= self._quickest - EARLIER:
            self._quickest = min(self._quickest, way)
            return elapsed
        self._quickest = way
        return max(now - last[1], self._cycle)


class ProgramTimer:
    """Measures how much time passes on the controller and for its program, from the states.

    Args:
        cycle: seconds of the controller's cycle.
        scaling: "ignore" for a program whose time passes as fast as the controller's.

    Attributes:
        rate: seconds of the program per second of the controller, by the newest state.
    """

    def __init__(self, cycle: float, scaling: ScalingName = "follow") -> None:
        self.rate = 1.0
        self._timer = ControllerTimer(cycle)
        self._is_ignored = scaling == "ignore"
        self._is_new = False
        self._most = 1.0

    def passed(self, state: RealtimeState, now: float) -> tuple[float, float]:
        """Seconds since the last state, on the controller's clock and on the program's; 0 for the first.

        Args:
            state: the newest.
            now: its arrival, monotonic s.
        """
        seconds = self._timer.passed(state.time, now)
        if self._is_new:
            self._is_new, self.rate = False, 0.0
            return seconds, 0.0
        self._most = min(self._most + RAMP * seconds, 1.0)
        before = self.rate
        self.rate = min(1.0 if self._is_ignored else reported_scaling(state), self._most)
        return seconds, 0.5 * (before + self.rate) * seconds

    def beginning(self) -> float | None:
        """s on a trajectory with which it begins at the newest state; None if it has to wait."""
        return 0.0

    def after(self, t: float, scaled: float) -> float:
        """s on a trajectory at the newest state.

        Args:
            t: at the state before.
            scaled: s that have passed for the program since then.
        """
        return t + scaled

    def restart(self) -> None:
        """Go on after a pause: with the next state, and slowly at first."""
        self._is_new, self._most = True, 0.0


#: rad in any joint, by default; more means that somebody has moved the arm.
MOVED = 0.05
#: rad/s; an arm whose targets are slower has come to rest.
_RESTING = 1e-4


class Pause:
    """Watches where the arm comes to rest in a pause, and where it is when the program goes on.

    Args:
        what: the motion, for messages.
        tolerance: rad in any joint, between the two.
        at_once: look where the arm is during the pause too.

    Attributes:
        holds: whether the program is paused.
        is_over: whether it has gone on; cleared by who handles that.
        count: pauses that are over.
    """

    def __init__(self, what: str, tolerance: float, *, at_once: bool = False) -> None:
        self.holds = False
        self.is_over = False
        self.count = 0
        self._what = what
        self._tolerance = tolerance
        self._at_once = at_once
        self._rest: Sequence[float] | None = None

    def look(self, state: RealtimeState) -> bool:
        """Whether the program is paused.

        Raises:
            ToleranceExceeded: it has gone on, and the arm is not where it had come to rest; with `at_once`, during
                the pause.
        """
        if is_paused(state):
            if not self.holds:
                self.holds, self._rest = True, None
            if self._rest is None and max(map(abs, state.qd_target.tolist())) < _RESTING:
                self._rest = state.q_target.tolist()
            elif self._at_once:
                self._check(state.q_target.tolist())
        elif self.holds:
            self.holds, self.is_over = False, True
            self.count += 1
            self._check(state.q_target.tolist())
        return self.holds

    def _check(self, here: Sequence[float]) -> None:
        if self._rest is None:
            return  # it had not come to rest
        moved = [abs(a - b) for a, b in zip(here, self._rest, strict=True)]
        joint = max(range(6), key=moved.__getitem__)
        if moved[joint] > self._tolerance:
            raise ToleranceExceeded(
                f"{JOINTS[joint]} (joint {joint}) was moved by {moved[joint]:.4f} rad while the program of "
                f"{self._what} was paused; at most {self._tolerance:g} rad, so the arm does not go on"
            )


def end_where_moved(life: Lifecycle, realtime: Stream[RealtimeState]) -> None:
    """End a motion that the controller executes by itself if the arm is moved while its program is paused.

    The controller would lead the arm back onto its path, so the program is stopped before it can go on. Before 3.2 no
    pause is reported, and nothing is watched.
    """
    pause = Pause(life.name, MOVED, at_once=True)

    def look(state: RealtimeState) -> None:
        try:
            pause.look(state)
        except ToleranceExceeded as error:
            life.fail(error, brake=True)

    subscription = realtime.subscribe(look, policy=latest)
    life.on_end(lambda: subscription.close(0))

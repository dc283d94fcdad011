"""Time that passes on the controller and for a program, computed from states; also the pauses of a program.

The speed slider and the controller's own limits slow down all motion of a program, including streamed set-points. If
a program is paused, or the slider is at 0, the program's time does not advance (docs/protocols/urscript.md, Speed
scaling). A state reports only the current fraction. The ramp at the start of each program is not reported. After a
pause, the arm must be where it was when the program was paused.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Literal

from linkcore.errors import LocalError
from linkcore.handle import Lifecycle
from linkcore.streaming.peer_clock import EARLIER
from linkcore.streaming.stream import Stream
from linkcore.threads import CallbackThread

from ..arm.vectors import JOINTS
from ..errors import ToleranceExceeded
from ..protocol.enums import ProgramState
from ..protocol.realtime.packets import RealtimeState

#: Time base of a trajectory: the time of the program on the robot ("follow"), or the controller's clock ("ignore").
ScalingName = Literal["follow", "ignore"]

#: Rate of change of the scaling, in 1/s. The same ramp starts at 0 when a paused program resumes; it is not reported.
RAMP = 6.25
_PAUSED = (ProgramState.PAUSING, ProgramState.PAUSED)


def is_paused(state: RealtimeState) -> bool:
    """Whether the program is paused. This is reported since firmware 3.2."""
    return state.program_state in _PAUSED


def reported_scaling(state: RealtimeState) -> float:
    """Return the speed fraction of program execution, 0 to 1; always 1 on CB2, which does not report it."""
    if is_paused(state):  # before 3.10, the scaling does not include pauses
        return 0.0
    scaling = state.speed_scaling
    # Written so that NaN also fails the comparison.
    return 1.0 if scaling is None or not 0.0 <= scaling <= 1.0 else scaling


class ControllerTimer:
    """Measures how much time passes on the controller, from the times in its states, if they are plausible.

    A state cannot arrive before its own time. The latency of states is unknown, but the fastest state gives a bound: a
    state that is faster by more than `EARLIER` has a wrong time. Therefore states that were delayed, or are read late,
    can arrive together, and the time in each state is used. This also holds for a simulated controller that was
    delayed and catches up faster than real time.

    If a state has no time, or a time in the past or too far in the future, the clock of this computer is used instead,
    with at least one cycle. Later states are compared with that state.

    Args:
        cycle: Cycle of the controller, in seconds.
    """

    def __init__(self, cycle: float) -> None:
        self._cycle = cycle
        self._last: tuple[float, float] | None = None
        #: Shortest time from the time in a state to its arrival, each on its own clock, in s; set by the first state.
        self._quickest: float

    def passed(self, time: float, now: float) -> float:
        """Return the seconds since the last state; 0 for the first state.

        Args:
            time: Time in the state, on the controller's clock.
            now: Arrival of the state, in s of the monotonic clock.
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
    """Measures how much time passes on the controller and for its program, from states.

    Args:
        cycle: Cycle of the controller, in seconds.
        scaling: Time base. With "ignore", the program's time passes as fast as the controller's.

    Attributes:
        rate: Seconds of the program per second of the controller, from the newest state.
    """

    def __init__(self, cycle: float, scaling: ScalingName = "follow") -> None:
        self.rate = 1.0
        self._timer = ControllerTimer(cycle)
        self._is_ignored = scaling == "ignore"
        self._is_new = False
        self._most = 1.0

    def passed(self, state: RealtimeState, now: float) -> tuple[float, float]:
        """Return the seconds since the last state, on the controller's and on the program's clock; 0 for the first.

        Args:
            state: The newest state.
            now: Arrival of the state, in s of the monotonic clock.
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
        """Return the time on the trajectory, in s, if it begins at the newest state; None if it must not begin yet."""
        return 0.0

    def after(self, t: float, scaled: float) -> float:
        """Return the time on the trajectory, in s, at the newest state.

        Args:
            t: Time on the trajectory at the previous state.
            scaled: Time that has passed for the program since then, in s.
        """
        return t + scaled

    def restart(self) -> None:
        """Continue after a pause with the next state, slowly at first."""
        self._is_new, self._most = True, 0.0


#: Default tolerance in rad, in any joint. A larger difference means that the arm was moved during the pause.
MOVED = 0.05
#: Joint speed, in rad/s, below which the targets count as at rest.
_RESTING = 1e-4


class Pause:
    """Compares the position at which the arm comes to rest in a pause with its position when the program resumes.

    Args:
        what: Name of the motion, used in messages.
        tolerance: Largest allowed difference between the two, in rad, in any joint.
        at_once: Whether to check the position during the pause too.

    Attributes:
        holds: Whether the program is paused.
        is_over: Whether the program has resumed; the code that handles the resumption clears it.
        count: Number of pauses that have ended.
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
        """Process a state; return whether the program is paused.

        Raises:
            ToleranceExceeded: If the program has resumed, and the arm is not where it had come to rest. With
                `at_once`, also if the arm is moved during the pause.
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
            return  # the arm had not come to rest
        moved = [abs(a - b) for a, b in zip(here, self._rest, strict=True)]
        joint = max(range(6), key=moved.__getitem__)
        if moved[joint] > self._tolerance:
            raise ToleranceExceeded(
                f"{JOINTS[joint]} (joint {joint}) was moved by {moved[joint]:.4f} rad while the program of "
                f"{self._what} was paused; at most {self._tolerance:g} rad are allowed, so the motion has ended"
            )


def end_where_moved(life: Lifecycle, realtime: Stream[RealtimeState]) -> None:
    """End a motion that the controller executes on its own, if the arm is moved while its program is paused.

    Otherwise the controller would drive the arm back to its path. The program is stopped before it can resume. Firmware
    before 3.2 does not report pauses, so nothing is monitored there.

    The states are compared in the thread that reads them. The stop is sent in another thread, because it waits if the
    controller accepts no text, and no state could be received meanwhile.
    """
    pause = Pause(life.name, MOVED, at_once=True)
    is_ending = False

    def look(state: RealtimeState) -> None:
        nonlocal is_ending
        try:
            pause.look(state)
        except ToleranceExceeded as error:
            if not is_ending:
                is_ending = True
                _soon(f"{life.name} stop", partial(life.fail, error, brake=True))

    # The position is compared only during a pause. At other times, only the modes of a state matter.
    subscription = realtime._connection.subscribe_inline(RealtimeState, look, only_changes=lambda: not pause.holds)
    life.on_end(lambda: subscription.close(0))


def _soon(name: str, call: Callable[[], object]) -> None:
    """Make a call in a new thread; if the system has no thread left, in this one."""
    thread = CallbackThread(name)
    try:
        thread.start()
    except LocalError:
        call()
    else:
        thread.call(call)
        thread.close(0.0)

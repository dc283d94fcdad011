"""Advance a simulated controller in time, in cycles of 8 ms (CB) or 2 ms (e-Series).

    due faults -> programs -> their set-point -> arm -> modes -> messages about them

A cycle needs no thread, clock or socket. The owner of the controller decides when a cycle ends: a test calls `step`, or
the server's thread follows the clock. The same programs and faults in the same cycles give the same result to the last
bit.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator

from linkcore import clock
from linkcore.arguments import check_seconds
from linkcore.errors import LinkTimeout
from linkcore.threads import started

from . import messages
from .faults import FaultSchedule
from .programs.runner import ProgramRunner
from .state import ControllerState


class ControlLoop:
    """Advances the state of one controller.

    Args:
        state: State of the controller.
        runner: Runner of its programs.
        schedule: Schedule of its faults.
    """

    def __init__(self, state: ControllerState, runner: ProgramRunner, schedule: FaultSchedule) -> None:
        self._state = state
        self._runner = runner
        self._schedule = schedule

    def next_event(self, cycle: int) -> int | None:
        """Return the first cycle after this one that must run on time; None if there is none.

        While a program runs, the controller is down or there is a scene, every cycle must run on time. Otherwise only
        the next cycle with a scheduled fault must.
        """
        if self._runner.is_running or not self._state.is_up or self._state.surroundings.scene is not None:
            return cycle + 1
        fault = self._schedule.next_cycle(self._state.rate)
        return None if fault is None else max(cycle + 1, fault)

    def advance(self) -> None:
        """Execute one cycle."""
        state = self._state
        state.cycle += 1
        self._schedule.advance(state.cycle, state.rate)
        if not state.is_up:
            state.cycles_down -= 1
            if state.cycles_down == 0:
                state.come_up()
            return
        state.uptime += 1
        setpoint = self._runner.advance(state.period)
        state.arm.advance(state.period, setpoint)
        if state.arm.force_sensor.overload is not None:
            state.stop_protectively(state.arm.force_sensor.overload)
        state.update_modes(state.period)
        state.arm.is_powered = state.modes.is_powered
        cause = state.take_safety_change()
        if cause is not None:
            for message in messages.safety_messages(state, cause):
                state.outbox.put(message)


#: Robot time, in s, that `passing` advances at once. After these packets, the bytes from clients are read.
_SLICE = 0.01


class SteppedClock:
    """Clock, in seconds, that advances only when `advance` is called.

    Args:
        rate: Cycles per second of the controller.
    """

    def __init__(self, rate: int) -> None:
        self._rate = rate
        self._cycles = 0

    def __call__(self) -> float:
        # Return the middle of a cycle, so that rounding never counts one cycle too few.
        return (self._cycles + 0.5) / self._rate if self._cycles else 0.0

    def advance(self, cycles: int) -> None:
        """Advance by this number of cycles."""
        self._cycles += cycles


@contextlib.contextmanager
def passing(step: Callable[[int], object], rate: int, speed: float) -> Iterator[None]:
    """Let time pass, in a thread, until the block is left.

    Args:
        step: Function that advances by a number of cycles.
        rate: Cycles per second.
        speed: Factor of real time; time passes more slowly if the machine is too slow.
    """
    speed = check_seconds(speed, "speed", positive=True, finite=True)
    over = threading.Event()
    cycles = round(_SLICE * rate)

    def run() -> None:
        due = clock.now()
        while not clock.wait(over.wait, due - clock.now()):
            # The serving thread might get no processor time for seconds. Robot time then pauses, and continues later.
            with contextlib.suppress(LinkTimeout):
                step(cycles)
            due = max(due + cycles / rate / speed, clock.now() - 1.0)

    thread = started(threading.Thread(target=run, name="urlink sim time", daemon=True))
    try:
        yield
    finally:
        over.set()
        clock.join(thread)

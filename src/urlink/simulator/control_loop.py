"""One cycle of the controller, 8 ms (CB) or 2 ms (e-Series) long: the order of its steps.

    faults that are due -> programs -> their set-point -> arm -> modes -> messages about them

There is no thread, clock or socket here: the owner of the controller decides when a cycle is over, a test with `step`,
or the server's thread. The same programs and faults in the same cycles give the same result to the last bit.
"""

from __future__ import annotations

from collections.abc import Callable

from . import messages
from .faults import FaultSchedule
from .programs.runner import ProgramRunner
from .robot.sources import SetpointSource
from .state import ControllerState

__all__ = ["ControlLoop"]


class ControlLoop:
    """Advances the state of one controller.

    Args:
        state: of the controller.
        runner: of its programs.
        schedule: of its faults.
        make_source: makes what the arm follows when the controller has come up.
    """

    def __init__(
        self,
        state: ControllerState,
        runner: ProgramRunner,
        schedule: FaultSchedule,
        make_source: Callable[[], SetpointSource],
    ) -> None:
        self._state = state
        self._runner = runner
        self._schedule = schedule
        self._make_source = make_source

    def next_event(self, cycle: int) -> int | None:
        """The first cycle after this one that must be executed at its time; None if there is none.

        While a program runs or the controller is down, that is every cycle; otherwise the next one with a scheduled
        fault.
        """
        if self._runner.is_running or not self._state.is_up:
            return cycle + 1
        fault = self._schedule.next_cycle(self._state.firmware.rate)
        return None if fault is None else max(cycle + 1, fault)

    def advance(self) -> None:
        """Execute one cycle."""
        state = self._state
        state.cycle += 1
        self._schedule.advance(state.cycle, state.firmware.rate)
        if not state.is_up:
            state.cycles_down -= 1
            if state.cycles_down == 0:
                state.come_up(self._make_source())
            return
        state.uptime += 1
        setpoint = self._runner.advance(state.period)
        state.arm.advance(state.period, setpoint)
        if state.arm.is_overloaded:
            state.stop_protectively(f"a force of more than {state.surroundings.force_limit:g} N at the TCP")
        state.update_modes(state.period)
        state.arm.is_powered = state.modes.is_powered
        cause = state.take_safety_change()
        if cause is not None:
            for message in messages.safety_messages(state, cause):
                state.outbox.put(message)

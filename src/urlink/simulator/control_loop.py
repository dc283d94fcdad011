"""Control loop of a simulated controller, in cycles of 8 ms (CB) or 2 ms (e-Series).

    due faults -> programs -> their set-point -> arm -> modes -> messages about them

The line above shows the order of the work in one cycle. A cycle needs no thread, clock or socket. A cycle is executed
when a test calls `step`, or when the clock of the server's thread reaches the next cycle. If the same programs and
faults arrive in the same cycles, the result is the same to the last bit.
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
from .robot.sensors import SampleAt, Samples
from .robot.setpoint_sources import Course, Setpoint
from .robot.surroundings import Plane, Spring
from .state import ControllerState


class ControlLoop:
    """Control loop that advances the state of one controller.

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

        Every cycle must run on time while a program runs, while the controller is down, or if there is a scene.
        Otherwise only the next cycle with a scheduled fault must run on time.
        """
        if self._runner.is_running or not self._state.is_up or self._state.surroundings.scene is not None:
            return cycle + 1
        fault = self._schedule.next_cycle(self._state.rate)
        return None if fault is None else max(cycle + 1, fault)

    @property
    def calls_users(self) -> bool:
        """Whether a cycle calls code of the user, which might wait: a scene, a contact, or a source of set-points."""
        world = self._state.surroundings
        return (
            world.scene is not None
            or bool(world.contacts and any(type(contact) not in (Plane, Spring) for contact in world.contacts))
            or not self._runner.follows_own_source
        )

    @property
    def is_self_contained(self) -> bool:
        """Whether the next cycles depend only on the state of the controller, so that they can be executed early."""
        return self._state.is_up and self._state.surroundings.is_empty and self._runner.is_self_contained

    def advance_many(self, cycles: int) -> Samples | None:
        """Execute several cycles at once, at most `cycles`, if only the time and the set-points change in them.

        Call it directly after a cycle. Return the sensors of that cycle and of the executed ones; None if the next
        cycles must be executed one by one.
        """
        state, arm, period = self._state, self._state.arm, self._state.period
        if not (state.is_up and state.modes.is_unchanging):
            return None
        first, program, then = arm.sample, None, None
        if not (arm.is_unchanging and self._runner.is_unchanging):
            program = self._runner.moving_program if arm.is_gliding else None
            then = None if program is None else program.course(cycles, period)
            if then is None or not then.size:
                return None
            cycles = then.shape[1]
        course = Course(arm.setpoint, then)
        samples = Samples(first, course, arm.advance_along(course, cycles, period))
        if program is not None:
            program.advance_along(cycles, period, course[cycles], [SampleAt(samples, at) for at in range(cycles)])
        state.cycle += cycles
        state.uptime += cycles
        return samples

    def next_fault(self) -> int | None:
        """Return the cycle of the next scheduled fault; None if there is none."""
        return self._schedule.next_cycle(self._state.rate)

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
        if self._glides():
            return
        setpoint = self._runner.advance(state.period)
        state.arm.advance(state.period, setpoint)
        overload = state.arm.overload
        if overload is not None:
            state.stop_protectively(overload.reason, code=overload.code)
        state.update_modes(state.period)
        state.arm.is_powered = state.modes.is_powered
        cause = state.take_safety_change()
        if cause is not None:
            for message in messages.safety_messages(state, cause):
                state.outbox.put(message)

    def _glides(self) -> bool:
        """Execute a cycle in which only the time and the set-point change.

        Return False, and do nothing, if more might change; see `advance_many`.
        """
        state, arm = self._state, self._state.arm
        if not state.modes.is_unchanging or state.has_safety_change:
            return False
        setpoint: Setpoint | None = None
        if arm.is_gliding:
            program = self._runner.moving_program
            setpoint = None if program is None else program.glide(state.period)
        elif arm.is_unchanging and self._runner.is_unchanging:
            setpoint = arm.setpoint
        if setpoint is None:
            return False
        arm.glide(state.period, setpoint)
        return True


#: Robot time, in s, by which `passing` advances at once. Bytes from clients are read after each advance.
_SLICE = 0.01


class SteppedClock:
    """Clock that advances only when `advance` is called; it returns seconds.

    Args:
        rate: Cycles per second of the controller.
    """

    def __init__(self, rate: int) -> None:
        self._rate = rate
        self._cycles = 0

    def __call__(self) -> float:
        # Return the time in the middle of a cycle. At the boundary, rounding might count one cycle too few.
        return (self._cycles + 0.5) / self._rate if self._cycles else 0.0

    def advance(self, cycles: int) -> None:
        """Advance by this number of cycles."""
        self._cycles += cycles


@contextlib.contextmanager
def passing(step: Callable[[int], object], rate: int, speed: float) -> Iterator[None]:
    """Advance the robot's time in a thread until the block ends.

    Args:
        step: Function that advances by a number of cycles.
        rate: Cycles per second.
        speed: Speed of the robot's time relative to real time, so 2.0 is twice real time. The robot's time passes more
            slowly if this computer is too slow.
    """
    speed = check_seconds(speed, "speed", positive=True, finite=True)
    over = threading.Event()
    cycles = round(_SLICE * rate)

    def run() -> None:
        due = clock.now()
        while not clock.wait(over.wait, due - clock.now()):
            # The server's thread might get no processor time for seconds. The robot's time then pauses, and continues
            # later.
            with contextlib.suppress(LinkTimeout):
                step(cycles)
            due = max(due + cycles / rate / speed, clock.now() - 1.0)

    thread = started(threading.Thread(target=run, name="urlink sim time", daemon=True))
    try:
        yield
    finally:
        over.set()
        clock.join(thread)

"""Runner of the programs of a controller, which are the main program and secondary programs.

The main program commands the arm. In each cycle, the threads of this program run first. Then the program's motion
generator converts their commands to one set-point. The arm follows this set-point, and has no access to programs.

If the last statement of a program is `protective_stop()`, the program ends, and its end is reported after the stop. The
UR Client Library waits for the report of the end before it unlocks the stop.

Assumptions:

- A protective stop pauses any other main program, and `play` continues it later. The main program ends in an emergency
  stop, and when the arm is switched off.
- Secondary programs keep running during stops, and while the arm is switched off.
- If a program was paused because an RTDE input was late, the full time of the input's watchdog begins again when the
  program resumes.
- The speed scaling does not restart at 0 if a program replaces another program, or starts while the arm still moves.
  This is inferred from drivers that send a new program with a speed many times a second: the arm keeps its speed.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Sequence

from ...arm.vectors import FloatArray
from ...protocol.enums import ControlMode
from .. import messages
from ..robot.generator import ArmDrive, LimitViolation
from ..robot.sensors import SampleAt
from ..robot.setpoint_sources import Demonstration, Setpoint, SetpointSource, Still
from ..state import ControllerState
from ..urscript import Execution, Script
from .program_world import ProgramWorld, Route

#: Maximum number of secondary programs that run at the same time; further programs are queued. Nearly all secondary
#: programs end within a cycle.
MOST_SECONDARY = 32
#: Maximum number of characters in all queued secondary programs.
MOST_WAITING = 1 << 20


class RunningProgram:
    """Main program, which commands the arm and is a source of set-points.

    Attributes:
        name: Name of the program.
        is_program: Whether the program still runs or is paused. When the program has ended, the arm brakes and then
            holds its position.
        execution: Execution of the script. It contains the error that ended the program, and the statements that
            clients sent in interpreter mode.
    """

    def __init__(
        self, state: ControllerState, script: Script, route: Route, on_end: Callable[[RunningProgram], object]
    ) -> None:
        self.name = script.name
        self.is_program = True
        self._state = state
        self._on_end = on_end
        # Continue from the speed of the previous source of set-points.
        self._drive = ArmDrive(state.arm, state.scaling, state.scaling_parameters)
        self.execution = Execution(script, ProgramWorld(state, route, self._drive))

    def start(self, q: Sequence[float]) -> None:
        """Continue from rest at six joint positions, in rad, after the arm has braked."""
        self._drive.start(q)

    def advance(self, seconds: float) -> Setpoint:
        """Run the threads of the program for one cycle of `seconds`, and return the set-point of this cycle."""
        drive, generator, state = self._drive, self._drive.generator, self._state
        generator.speed_fraction = state.slider
        if self.is_program:
            if generator.arm.tcp != (tcp := state.arm.tcp):
                generator.tcp = tcp
            self.execution.advance()
            # If the last statement was protective_stop(), the stop must be reported before the end of the program.
            if self.execution.is_over and state.modes.may_move:
                self.end()
        try:
            setpoint = drive.advance(seconds)
            state.control_mode = drive.control_mode
            # If a program starts while the arm moves, it continues with the scaling of the previous program.
            state.scaling = generator.scaling if self.is_program or not generator.is_standing else 0.0
            return setpoint
        except LimitViolation as violation:
            state.stop_protectively(str(violation), code=violation.code)
            return drive.setpoint

    def course(self, cycles: int, seconds: float) -> FloatArray | None:
        """Return the set-points of at most this number of cycles, in which the program only waits for its motion.

        Return:
            Positions, speeds and accelerations, shape (3, n, 6); None if the set-points are only known cycle by cycle.
        """
        return self._drive.course(cycles, seconds) if self._only_awaits_motion else None

    @property
    def _only_awaits_motion(self) -> bool:
        """Whether the program does nothing until its motion has ended, and no setting has changed."""
        generator, state = self._drive.generator, self._state
        return (
            self.is_program
            and self.execution.only_awaits_motion
            and generator.speed_fraction == state.slider
            and generator.arm.tcp == state.arm.tcp
        )

    def glide(self, seconds: float) -> Setpoint | None:
        """Advance by one cycle of `course`, and return its set-point; None if it is only known by `advance`."""
        setpoint = self._drive.glide(seconds) if self._only_awaits_motion else None
        if setpoint is not None:
            self.execution.remember((self._state.arm.sample,))
        return setpoint

    def advance_along(self, cycles: int, seconds: float, last: Setpoint, sensors: Iterable[SampleAt]) -> None:
        """Advance by this number of cycles of `course`.

        Args:
            cycles, seconds: Number of cycles, and duration of a cycle in s.
            last: Set-point of the last cycle.
            sensors: Sensors before each cycle.
        """
        self.execution.remember(sensors)
        self._drive.advance_along(cycles, seconds, last)

    @property
    def is_unchanging(self) -> bool:
        """Whether the program has ended, and every later set-point equals the current one."""
        return not self.is_program and self._drive.is_unchanging and self._drive.setpoint == self._state.arm.setpoint

    def end(self) -> None:
        """Stop the program, if it still runs."""
        if self.is_program:
            self.is_program = False
            self.execution.stop()
            self._drive.end_mode()
            self._on_end(self)


class ProgramRunner:
    """Runner of the programs of one controller, which returns the set-points for the arm.

    Args:
        state: State of the controller.
        route: Function that returns the targets of the programs' connections.

    Attributes:
        main: Main program that was started last, even if it has ended; None before the first main program.
    """

    def __init__(self, state: ControllerState, route: Route) -> None:
        self.main: RunningProgram | None = None
        self._state = state
        self._route = route
        # Whether the arm must come to rest before the source of set-points starts again, from this position.
        self._begins_anew = False
        self._secondary: list[Execution] = []
        self._waiting: deque[tuple[Script, int]] = deque()

    @property
    def program(self) -> RunningProgram | None:
        """The program that commands the arm or is paused; None if there is none."""
        main = self.main  # read once, because other threads call this too
        return main if main is not None and main.is_program else None

    @property
    def is_running(self) -> bool:
        """Whether any program runs, is paused or is queued, so that no cycle may be skipped."""
        return bool(self._secondary or self._waiting or self.program)

    @property
    def is_self_contained(self) -> bool:
        """Whether no program or source of set-points can read or send anything outside of the controller."""
        if self._secondary or self._waiting:
            return False
        program = self.program
        return self.follows_own_source and (program is None or not program.execution.script.is_connected)

    @property
    def follows_own_source(self) -> bool:
        """Whether the set-points come from a class of the simulator, and not from an object of the user."""
        return type(self._state.source) in (RunningProgram, Still, Demonstration)

    @property
    def is_steady(self) -> bool:
        """Whether nothing changes in the next cycles, unless the source of set-points changes it."""
        state = self._state
        if self._secondary or self._waiting or self._begins_anew or state.is_paused or state.by_hand is not None:
            return False
        return state.modes.may_move and state.slider == state.speed_fraction and state.watchdogs.is_empty

    @property
    def is_unchanging(self) -> bool:
        """Whether nothing changes in the next cycles, because no program runs and the arm is at rest."""
        source = self._state.source
        is_at_rest = source.is_unchanging if isinstance(source, RunningProgram) else type(source) is Still
        return is_at_rest and self.is_steady

    @property
    def moving_program(self) -> RunningProgram | None:
        """Running program that commands the arm, while nothing else changes; None if there is none."""
        return self.main if self.main is self._state.source and self.is_steady else None

    # -- beginning and ending ------------------------------------------------------------------------

    def start(self, script: Script) -> None:
        """Stop the running program, and start this script as the main program."""
        state = self._state
        self.stop()
        state.is_paused = False
        self.main = state.source = RunningProgram(state, script, self._route, self._ended)
        # The new program continues from the current speed of the arm, even if the arm is braking.
        self._begins_anew = False
        if state.zeroes_force:
            state.arm.zero_force()
        state.outbox.put(messages.program_started(state, script.name))
        state.update_modes(0.0)

    def start_secondary(self, script: Script, length: int) -> bool:
        """Queue a secondary program; return False if the queue is full.

        Args:
            script: Compiled program.
            length: Number of characters in the text of the program.
        """
        if sum(waiting for _, waiting in self._waiting) + length > MOST_WAITING:
            return False
        self._waiting.append((script, length))
        return True

    def stop(self) -> bool:
        """End the running program; return False if there is none."""
        program = self.program
        if program is not None:
            program.end()
        return program is not None

    def stop_all(self) -> bool:
        """End any running program, including a demonstration; return False if there is none."""
        state = self._state
        if not self.stop():
            if not state.source.is_program:
                return False
            state.is_paused = False
            self.follow(Still())
        state.update_modes(0.0)
        return True

    def follow(self, source: SetpointSource) -> None:
        """End the running program, let the arm brake if necessary, and then follow another source of set-points."""
        self.stop()
        self._state.source = source
        self._begins_anew = True

    def close(self) -> None:
        """End all programs, because the controller goes down."""
        self.stop()
        for execution in self._secondary:
            execution.stop()
        self._secondary.clear()
        self._waiting.clear()

    def _ended(self, program: RunningProgram) -> None:
        state = self._state
        state.is_paused = False
        self._report(program.execution)
        state.watchdogs.clear()
        state.outbox.put(messages.program_stopped(state, program.name))

    def _report(self, execution: Execution) -> None:
        """Send a message about the error that has ended a program, if there was an error."""
        if execution.error is not None:
            self._state.outbox.put(messages.runtime_exception(self._state, execution.error, is_running=True))

    # -- one cycle -----------------------------------------------------------------------------------

    def advance(self, seconds: float) -> Setpoint | None:
        """Run every program for one cycle.

        Returns:
            Set-point for the arm; None if the arm must brake and stay at rest.
        """
        state, modes = self._state, self._state.modes
        state.control_mode = ControlMode.POSITION
        state.move_slider(seconds)
        self._watch()
        if state.resumes and modes.may_move:
            state.is_paused = state.resumes = False
        if modes.holds_program:
            program = self.program
            if program is not None and program.execution.is_over:
                program.end()
            elif program is not None:
                state.is_paused = True
        elif not modes.may_move:
            # Clear the pause even if no program runs, because a demonstration might have been paused.
            self.stop()
            state.is_paused = False
        if self._secondary or self._waiting:
            self._advance_secondary()
        is_idle = state.by_hand is not None and not state.source.is_program
        if not modes.may_move or state.is_paused or is_idle:
            self._begins_anew = True
            state.scaling = 0.0
            return self._by_hand(seconds) if modes.may_move else None
        state.by_hand = None
        if self._begins_anew:
            if state.arm.is_moving:
                return None
            state.source.start(state.arm.setpoint.q)
            self._begins_anew = False
        if state.source is not self.main:
            state.scaling = state.slider if state.source.is_program else 0.0
        return state.source.advance(seconds)

    def _by_hand(self, seconds: float) -> Setpoint | None:
        """Return the set-point from the drive of the pendant; None if the pendant does not move the arm."""
        state, hand = self._state, self._state.by_hand
        if hand is None:
            return None
        try:
            return hand.advance(seconds)
        except LimitViolation as violation:
            state.by_hand = None
            state.stop_protectively(str(violation), code=violation.code)
            return None

    def _watch(self) -> None:
        """Pause or stop the program if an RTDE input with a watchdog is late.

        While the program is paused, the watchdogs are restarted, so that no input becomes late.
        """
        state = self._state
        if state.is_paused:
            state.watchdogs.restart(state.cycle)
            return
        action = state.watchdogs.expired(state.cycle)
        if action == "stop":
            self.stop()
        elif action == "pause":
            state.is_paused = True

    def _advance_secondary(self) -> None:
        while self._waiting and len(self._secondary) < MOST_SECONDARY:
            self._secondary.append(Execution(self._waiting.popleft()[0], ProgramWorld(self._state, self._route)))
        for execution in self._secondary:
            execution.advance()
            self._report(execution)
        self._secondary = [execution for execution in self._secondary if not execution.is_over]

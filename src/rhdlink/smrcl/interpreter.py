"""Interpreter that executes the lines of one plan at a time, with one step per cycle.

A line is read in one cycle. From the next cycle on, its default end and its stop conditions are tested until one of
them is true. The next line is read in the following cycle. A line that takes no time (such as an assignment, `if` or
`goto`) is followed by the next line in the same cycle. This is the state machine `sm_interp` of MRC.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from .arithmetic import format_number, leading_number
from .expressions import Compiler, LineFault, Value
from .lexer import TokenType, tokenize
from .parser import Parser
from .plan import ERROR, FREE_LINE, Failure, MissionPlan, Outcome, PlanLine, Run, Stage
from .recipients import Outbox
from .statements import compile_line
from .syntax import Evaluate
from .vehicle import Vehicle

if TYPE_CHECKING:
    from .commands import ScriptCommand


@dataclass(frozen=True)
class MissionLimits:
    """Limits that stop a runaway mission. Real missions stay far below them.

    Attributes:
        lines: Maximum number of lines executed in one cycle.
        calls: Maximum number of nested calls, as in MRC.
    """

    lines: int = 20_000
    calls: int = 1000


def never() -> bool:
    """Return False: default end of a command that continues until a stop condition is true."""
    return False


class ScriptInterpreter:
    """Interpreter that executes plans on a vehicle.

    Args:
        vehicle: Robot that moves, and has the variables.
        output: Receiver of the executed lines, the values of `eval`, and the messages.
        commands: Commands of the language, by name.
        functions: Additional functions for expressions, by name.
        limits: Limits of the mission.

    Attributes:
        vehicle, output, commands, limits: The arguments.
        profile: Profile of the mission, like MRC or sound.
        symbols: Variables of the mission.
        compiler: Compiler of expressions.
        perform: Function that executes a command; see `MissionEffects.perform`. Its arguments are the command's row,
            its parameters (checked for number and kind), its plan and its stop conditions.
        executed: Number of lines executed so far.
        default_end: Default end of the last command.
        time: Value of ``$time``, in s.
        holds: Function that is called before each line. The run is held while it returns true.
        skips: Whether lines are skipped, because they belong to another `case`.
        case: Number of the wanted `case`.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        output: Outbox,
        commands: Mapping[str, ScriptCommand],
        functions: Mapping[str, Callable[..., float]],
        limits: MissionLimits,
    ) -> None:
        self.vehicle = vehicle
        self.output = output
        self.profile = vehicle.profile
        self.limits = limits
        self.symbols = vehicle.symbols
        self.commands = commands
        self._parser = Parser(commands, functions)
        self.compiler = Compiler(vehicle.symbols, vehicle.profile, functions)
        self.perform: Callable[[ScriptCommand, Sequence[float | str], Run, Sequence[Value]], Outcome]
        self.executed = 0
        self.default_end: Callable[[], bool] = never
        self.time = 0.0
        self.holds: Callable[[PlanLine], bool] | None = None
        self._condition = vehicle.symbols.system["condition"].place
        self.symbols.pool[self._condition] = -1.0
        # The conditions of the current line, and their last values. In MRC, watches use the same memory.
        self._tests: tuple[Value, ...] = ()
        self._found = [0.0] * 128
        self.case = 0
        self.skips = False

    # -- cycles -------------------------------------------------------------------------------------

    def step(self, run: Run) -> bool:
        """Perform one cycle of a run. Return whether the run has ended."""
        run.enter(self.vehicle.odometry.distance, self.vehicle.cycles)
        if run.stage is Stage.FETCH or run.stage is Stage.HOLD:
            self._fetch(run)
        elif run.stage is Stage.WAIT:
            self._wait(run)
        elif run.stage is Stage.ROUTINE:
            run.continue_routine()
        return run.stage is Stage.DONE

    def update_variables(self, run: Run) -> None:
        """Update the system variables, with the distance and time of a run."""
        vehicle = self.vehicle
        driven = vehicle.odometry.distance - run.start_distance
        vehicle.variables.update(vehicle, driven, run.cycles, self.time)

    def _wait(self, run: Run) -> None:
        self.update_variables(run)
        if self.default_end():
            run.result = 0.0
            run.stage = Stage.FETCH
        if self._tests:
            try:
                self._test(self._tests)
            except LineFault as fault:
                self._fail(run, fault)
                return
            if number := self._first_true():
                run.result = float(number)
                run.stage = Stage.FETCH
            else:
                run.result = 0.0

    def _fetch(self, run: Run) -> None:
        left = self.limits.lines
        plan = run.plan
        while plan.next < len(plan.lines):
            line = plan.lines[plan.next]
            if self.holds is not None and not self.skips and self.holds(line):
                run.stage = Stage.HOLD
                self.update_variables(run)
                return
            run.stage = Stage.FETCH
            run.line, run.column = line, 1
            plan.next += 1
            self.executed += 1
            self.update_variables(run)
            self.begin_command()
            self.output.line(self.executed, line)
            left -= 1
            if left < 0:
                reason = f"endless loop without a wait: {self.limits.lines} lines in one cycle"
                self._fail(run, LineFault(reason, is_limit=True))
                return
            if self.skips:
                self._skip(line.text)
                run.result = FREE_LINE
                continue
            try:
                outcome = self._execute(line, run)
            except LineFault as fault:
                self._fail(run, fault)
                return
            if outcome is Outcome.WAIT:
                if run.stage is Stage.FETCH:
                    run.stage = Stage.WAIT
                return
            run.result = FREE_LINE
        run.stage = Stage.DONE

    def _fail(self, run: Run, fault: LineFault) -> None:
        line = run.line
        assert line is not None
        number = line.number if self.profile.file_lines else self.executed
        if self.profile.says_why:
            self.output.message(f"line {number}: {fault}\n")
        else:
            self.output.message(f" syntax error in line : {number} \n")
        run.failure = self.failure(run, str(fault), fault.column, is_limit=fault.is_limit)
        run.result = ERROR
        run.stage = Stage.DONE

    @staticmethod
    def failure(run: Run | None, reason: str, column: int = 0, *, is_limit: bool = False) -> Failure:
        """Create the failure of the running line.

        Its column is `column`, or the start of the current statement.
        """
        if run is None or run.line is None:
            return Failure(reason, 0, 0, "", is_limit)
        line = run.line
        return Failure(reason, line.number, (column or run.column) + line.indent, line.text, is_limit)

    # -- conditions ---------------------------------------------------------------------------------

    @property
    def conditions(self) -> tuple[bool, ...]:
        """Last values of the stop conditions of the current line."""
        return tuple(value != 0.0 for value in self._found[: len(self._tests)])

    def begin_command(self) -> None:
        """Set ``$condition`` from the last values of the conditions, and drop the conditions."""
        self.symbols.pool[self._condition] = float(self._first_true())
        self._tests = ()

    def _first_true(self) -> int:
        for number, value in enumerate(self._found[: len(self._tests)], start=1):
            if value != 0.0:
                return number
        return 0

    def set_conditions(self, conditions: tuple[Value, ...]) -> None:
        """Test the stop conditions of a line now, and in each cycle that the line takes.

        Raises:
            LineFault: If a condition cannot be computed.
        """
        self._test(conditions)
        self._tests = conditions

    def _test(self, tests: Sequence[Value]) -> None:
        for number, test in enumerate(tests):
            self._found[number] = test()

    def watch(self, tests: Sequence[Value]) -> float:
        """Compute the first condition of a watch.

        Raises:
            LineFault: If the condition cannot be computed.
        """
        if self.profile.watches_apart:
            return tests[0]()
        with self.aside():
            self._test(tests)
            return self._found[0]

    @contextlib.contextmanager
    def aside(self) -> Iterator[None]:
        """Run a command inside the current one: a watch, or a client's `eval`.

        The current command continues afterwards.
        """
        pool = self.symbols.pool
        kept = self._tests, self.default_end, pool[self._condition]
        found = list(self._found) if self.profile.watches_apart else self._found
        self.begin_command()
        try:
            yield
        finally:
            self._tests, self.default_end, pool[self._condition] = kept
            self._found = found

    # -- lines --------------------------------------------------------------------------------------

    def _skip(self, text: str) -> None:
        """Skip a line in a `switch` that is before or after the selected case. The line is not parsed."""
        text = text.lstrip(" \t\r")
        if text.startswith("case "):
            value = leading_number(text[5:])
            if value is not None and abs(value - self.case) < 0.1:
                self.skips = False
        elif text.startswith("endswitch"):
            self.skips = False

    def _execute(self, line: PlanLine, run: Run) -> Outcome:
        if line.steps is None:
            line.steps = compile_line(self._parser.parse(line.text), self)
        try:
            for column, step in line.steps:
                run.column = column
                outcome: Outcome | None = step(run)
                if outcome is not None:
                    return outcome
        except LineFault as fault:
            if self.profile.ascii_only or not fault.column:
                raise
            if self._reads_on(line.text, fault.column):
                return Outcome.NEXT
            raise
        except (ArithmeticError, ValueError) as error:
            raise LineFault(f"the line cannot be computed: {error}") from error
        return Outcome.NEXT

    def _reads_on(self, text: str, column: int) -> bool:
        """Read the rest of a wrong line as MRC does. MRC reports unknown names in it.

        Returns:
            Whether the rest contains a character beyond ASCII, which makes MRC forget the error.
        """
        for token in tokenize(text):
            if token.column < column:
                continue
            if token.type is TokenType.FOREIGN:
                return True
            if token.type is TokenType.SYSTEM and token.text not in self.symbols.system:
                self.output.message(f'System variable "${token.text}" not found\n')
        return False

    def evaluate(self, text: str) -> list[float] | None:
        """Compute the values of ``eval ...`` while a command runs.

        Return None if the text is another command, or is invalid.
        """
        line = self._parser.parse(text)
        statement = line.statements[0] if line.statements else None
        with self.aside():
            try:
                if line.problem is not None:
                    raise LineFault(line.problem.message, line.problem.column)
                if not isinstance(statement, Evaluate):
                    return None
                values = [self.compiler.compile(each)() for each in statement.values]
                self.print_values(values)
                return values
            except LineFault as fault:
                if not self.profile.says_why and fault.column:
                    self._reads_on(text, fault.column)
                return None

    def print_values(self, values: Sequence[float]) -> None:
        """Print the values of `eval`."""
        self.output.values("".join(f"{format_number(value)}  " for value in values) + "\n")

    def perform_aside(self, text: str) -> None:
        """Execute a line while a command runs, unless the line is wrong. It never takes time."""
        line = PlanLine(text, 0)
        run = Run(MissionPlan([line]))
        run.line = line
        with self.aside(), contextlib.suppress(LineFault):
            self._execute(line, run)

    # -- flow ---------------------------------------------------------------------------------------

    def go_to(self, label: str, run: Run) -> None:
        """Continue with the line that has a label.

        Raises:
            LineFault: If there is no such label.
        """
        place = run.plan.labels.get(label)
        if place is None:
            raise LineFault(f'there is no label "{label}"')
        run.plan.next = place

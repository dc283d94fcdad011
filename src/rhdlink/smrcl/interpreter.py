"""Executes lines, one plan at a time, stepped once per cycle.

A line is read in one cycle, and from the next one on its default end and its stop conditions are tested, until one of
them is true; then the next line is read in the cycle after that. Lines that take no time (assignments, `if`, `goto` and
the like) are followed by the next one in the same cycle. This is the state machine `sm_interp` of MRC.
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
    """Bounds that no mission of the field comes near, and that keep one from running away.

    Attributes:
        lines: that may be executed in one cycle.
        calls: within each other; as many as MRC has room for.
    """

    lines: int = 20_000
    calls: int = 1000


def never() -> bool:
    """The default end of what goes on until a stop condition is true."""
    return False


class ScriptInterpreter:
    """Executes plans on a vehicle.

    Args:
        vehicle: what moves, and has the variables.
        output: gets the executed lines, the values of `eval`, and the messages.
        commands: of the language, by name.
        functions: further functions for expressions, by name.
        limits: bounds.

    Attributes:
        vehicle, output, commands, limits: as given.
        profile: as MRC does it, or sound.
        symbols: the variables of the mission.
        compiler: of expressions.
        perform: executes a command, see `MissionEffects.perform`: its row, its parameters (of the number and the kinds
            that it takes), the plan that it belongs to, and its stop conditions.
        executed: lines so far.
        default_end: of the last command.
        time: ``$time``, s.
        holds: asked before each line; the run stands while it is true.
        skips: lines are those of a `case` that is not wanted.
        case: the one that is.
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
        # The conditions of the present line, and as they were computed last. Watches use the same place in MRC.
        self._tests: tuple[Value, ...] = ()
        self._found = [0.0] * 128
        self.case = 0
        self.skips = False

    # -- cycles -------------------------------------------------------------------------------------

    def step(self, run: Run) -> bool:
        """One cycle of a run; whether it is over."""
        run.enter(self.vehicle.odometry.distance, self.vehicle.cycles)
        if run.stage is Stage.FETCH or run.stage is Stage.HOLD:
            self._fetch(run)
        elif run.stage is Stage.WAIT:
            self._wait(run)
        elif run.stage is Stage.ROUTINE:
            run.continue_routine()
        return run.stage is Stage.DONE

    def update_variables(self, run: Run) -> None:
        """Bring the system variables up to date, with distance and time of a run."""
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
                reason = f"a loop that takes no time: {self.limits.lines} lines in one cycle"
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
        """The failure of what a run executes, at a column of the line, or where the present statement begins."""
        if run is None or run.line is None:
            return Failure(reason, 0, 0, "", is_limit)
        line = run.line
        return Failure(reason, line.number, (column or run.column) + line.indent, line.text, is_limit)

    # -- conditions ---------------------------------------------------------------------------------

    @property
    def conditions(self) -> tuple[bool, ...]:
        """The stop conditions of the present line, as they were computed last."""
        return tuple(value != 0.0 for value in self._found[: len(self._tests)])

    def begin_command(self) -> None:
        """Set ``$condition`` from the conditions that were computed last, and forget them."""
        self.symbols.pool[self._condition] = float(self._first_true())
        self._tests = ()

    def _first_true(self) -> int:
        for number, value in enumerate(self._found[: len(self._tests)], start=1):
            if value != 0.0:
                return number
        return 0

    def set_conditions(self, conditions: tuple[Value, ...]) -> None:
        """Test the stop conditions of a line, now and in each cycle that it takes.

        Raises:
            LineFault: one cannot be computed.
        """
        self._test(conditions)
        self._tests = conditions

    def _test(self, tests: Sequence[Value]) -> None:
        for number, test in enumerate(tests):
            self._found[number] = test()

    def watch(self, tests: Sequence[Value]) -> float:
        """The value of the first condition of a watch.

        Raises:
            LineFault: it cannot be computed.
        """
        if self.profile.watches_apart:
            return tests[0]()
        with self.aside():
            self._test(tests)
            return self._found[0]

    @contextlib.contextmanager
    def aside(self) -> Iterator[None]:
        """A command within the present one, after which that goes on as before: a watch, or a client's `eval`."""
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
        """A line in a `switch` whose case has not come, or is over. It is not read any further."""
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
            raise LineFault(f"it cannot be computed: {error}") from error
        return Outcome.NEXT

    def _reads_on(self, text: str, column: int) -> bool:
        """Read the rest of a wrong line as MRC does: it complains of the names there.

        Returns:
            Whether there is a character beyond ASCII in it, which has MRC forget the error.
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
        """The values of ``eval ...``, beside the present command; None if it is something else, or wrong."""
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
        """Execute a line beside the present command, unless it is wrong. It takes no time, whatever it says."""
        line = PlanLine(text, 0)
        run = Run(MissionPlan([line]))
        run.line = line
        with self.aside(), contextlib.suppress(LineFault):
            self._execute(line, run)

    # -- flow ---------------------------------------------------------------------------------------

    def go_to(self, label: str, run: Run) -> None:
        """Have the line with a label executed next.

        Raises:
            LineFault: there is no such label.
        """
        place = run.plan.labels.get(label)
        if place is None:
            raise LineFault(f'there is no label "{label}"')
        run.plan.next = place

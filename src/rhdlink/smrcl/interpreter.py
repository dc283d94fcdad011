"""Executes lines, one plan at a time, stepped once per cycle.

A line is read in one cycle, and from the next one on its default end and its stop conditions are tested, until one of
them is true; then the next line is read in the cycle after that. Lines that take no time (assignments, `if`, `goto` and
the like) are followed by the next one in the same cycle. This is the state machine `sm_interp` of MRC.
"""

from __future__ import annotations

import enum
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from .arithmetic import format_number, leading_number, truncate
from .expressions import Compiler, LineFault, Value
from .lexer import TokenType, tokenize
from .parser import FUNCTIONS, Parser
from .plan import MissionPlan, PlanLine
from .syntax import (
    ArrayElement,
    Assign,
    Case,
    CommandStatement,
    EndSwitch,
    Evaluate,
    If,
    NumberLiteral,
    Operand,
    SpeedSetting,
    Statement,
    Switch,
    TextLiteral,
    WaitFor,
)
from .vehicle import Vehicle

if TYPE_CHECKING:
    from .commands import ScriptCommand

__all__ = ["Effects", "Failure", "MissionLimits", "Outcome", "Output", "Run", "ScriptInterpreter", "never"]


class Outcome(enum.Enum):
    """How a line goes on."""

    #: The line takes time: it is over when its end or a condition is true.
    WAIT = 0
    #: The next line follows in the same cycle.
    NEXT = 1


class Output(Protocol):
    """Takes what a mission says."""

    def line(self, number: int, line: PlanLine) -> None:
        """A line is about to be executed; `number` counts all lines executed so far."""

    def values(self, text: str) -> None:
        """The values of `eval`."""

    def message(self, text: str) -> None:
        """The text of a command or of an error."""


class Effects(Protocol):
    """The effects of commands; see `rhdlink.smrcl.effects`."""

    def perform(
        self, command: ScriptCommand, parameters: Sequence[float | str], run: Run, conditions: Sequence[Value]
    ) -> Outcome:
        """Execute a command.

        Args:
            command: its row.
            parameters: of the number and the kinds that it takes.
            run: the plan that it belongs to.
            conditions: its stop conditions.

        Raises:
            Fault: it cannot be executed.
        """


@dataclass(frozen=True)
class MissionLimits:
    """Bounds that no mission of the field comes near, and that keep one from running away.

    Attributes:
        lines: that may be executed in one cycle.
        calls: within each other; as many as MRC has room for.
    """

    lines: int = 20_000
    calls: int = 1000


@dataclass(frozen=True)
class Failure:
    """Why a plan has failed.

    Attributes:
        reason: in words.
        line: of the file, from 1; 0 where no line is at fault.
        column: from 1; 0 where no line is at fault.
        text: of the line.
        is_limit: a bound was reached.
    """

    reason: str
    line: int
    column: int
    text: str
    is_limit: bool = False


class _Stage(enum.Enum):
    """The step of a run in its next cycle."""

    FETCH = "reads lines"
    WAIT = "tests the end of a line"
    ROUTINE = "goes through a routine of a command"
    HOLD = "stands at a breakpoint"
    DONE = "is over"


#: What a run leaves as its result; otherwise 0 for a default end, or the number of the condition that was true.
FREE_LINE, ERROR = -2.0, -1.0


class Run:
    """One execution of a plan.

    Args:
        plan: what is executed.
        result: what is left there until a line has a result.

    Attributes:
        plan: what is executed; `goto` moves in it.
        line: the line that is executed.
        column: in it, from 1: of the statement that is executed.
        result: of the last line: 0 for its default end, the number of a condition, `FREE_LINE` or `ERROR`.
        failure: why it ended early; None if it did not.
    """

    def __init__(self, plan: MissionPlan, result: float = 0.0) -> None:
        self.plan = plan
        self.line: PlanLine | None = None
        self.column = 0
        self.result = result
        self.failure: Failure | None = None
        self.stage = _Stage.FETCH
        self._entered: _Stage | None = None
        self.cycles = 0
        self.start_distance = 0.0
        self.calls: list[int] = []
        self._routine: Callable[[int], bool] | None = None

    @property
    def is_done(self) -> bool:
        """Whether it is over."""
        return self.stage is _Stage.DONE

    @property
    def is_held(self) -> bool:
        """Whether it stands at a breakpoint."""
        return self.stage is _Stage.HOLD

    def start_routine(self, routine: Callable[[int], bool]) -> None:
        """Go through a routine from the next cycle on; it is given the number of the cycle and says when it is over."""
        self._routine = routine
        self.stage = _Stage.ROUTINE

    def continue_routine(self) -> None:
        """One cycle of the routine."""
        if self._routine is None or self._routine(self.cycles):
            self.stage = _Stage.FETCH

    def enter(self, distance: float, cycles: int) -> None:
        """Begin a cycle, `cycles` periods after the one before; distance and time count from the first of a stage."""
        if self.stage is not self._entered:
            self._entered = self.stage
            self.cycles = 0
            self.start_distance = distance
        else:
            self.cycles += cycles


def never() -> bool:
    """The default end of what goes on until a stop condition is true."""
    return False


_Step = Callable[[Run], Outcome | None]


class ScriptInterpreter:
    """Executes plans on a vehicle.

    Args:
        vehicle: what moves, and has the variables.
        output: gets the executed lines and the messages.
        commands: of the language, by name.
        functions: further functions for expressions, by name.
        limits: bounds.

    Attributes:
        effects: of commands; set by the code that makes both.
        executed: lines so far.
        default_end: of the last command.
        time: ``$time``, s.
        holds: asked before each line; the run stands while it is true.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        output: Output,
        commands: Mapping[str, ScriptCommand],
        functions: Mapping[str, Callable[..., float]],
        limits: MissionLimits,
    ) -> None:
        self._vehicle = vehicle
        self._output = output
        self._profile = vehicle.profile
        self._limits = limits
        self._symbols = vehicle.symbols
        self._commands = commands
        self._parser = Parser(frozenset(commands), {**FUNCTIONS, **dict.fromkeys(functions)})
        self.compiler = Compiler(vehicle.symbols, vehicle.profile, functions)
        self.effects: Effects | None = None
        self.executed = 0
        self.default_end: Callable[[], bool] = never
        self.time = 0.0
        self.holds: Callable[[PlanLine], bool] | None = None
        self._condition = vehicle.symbols.system["condition"].place
        self._symbols.pool[self._condition] = -1.0
        # The conditions of the present line as they were computed last, and how many there are. Watches use the same
        # place in MRC.
        self._found = [0.0] * 128
        self._count = 0
        self._tests: tuple[Value, ...] = ()
        self._case = 0
        self._skips = False

    # -- cycles -------------------------------------------------------------------------------------

    def step(self, run: Run) -> bool:
        """One cycle of a run; whether it is over."""
        run.enter(self._vehicle.odometry.distance, self._vehicle.cycles)
        if run.stage is _Stage.FETCH or run.stage is _Stage.HOLD:
            self._fetch(run)
        elif run.stage is _Stage.WAIT:
            self._wait(run)
        elif run.stage is _Stage.ROUTINE:
            run.continue_routine()
        return run.is_done

    def update_variables(self, run: Run) -> None:
        """Bring the system variables up to date, with distance and time of a run."""
        vehicle = self._vehicle
        driven = vehicle.odometry.distance - run.start_distance
        vehicle.update_variables(driven, run.cycles * vehicle.control.parameters.period, self.time)

    def _wait(self, run: Run) -> None:
        self.update_variables(run)
        if self.default_end():
            run.result = 0.0
            run.stage = _Stage.FETCH
        if self._count:
            try:
                self._test(self._tests)
            except LineFault as fault:
                self._fail(run, fault)
                return
            if number := self._first_true():
                run.result = float(number)
                run.stage = _Stage.FETCH
            else:
                run.result = 0.0

    def _fetch(self, run: Run) -> None:
        left = self._limits.lines
        plan = run.plan
        while plan.next < len(plan.lines):
            line = plan.lines[plan.next]
            if self.holds is not None and not self._skips and self.holds(line):
                run.stage = _Stage.HOLD
                self.update_variables(run)
                return
            run.stage = _Stage.FETCH
            run.line, run.column = line, 1
            plan.next += 1
            self.executed += 1
            self.update_variables(run)
            self.begin_command()
            self._output.line(self.executed, line)
            left -= 1
            if left < 0:
                reason = f"a loop that takes no time: {self._limits.lines} lines in one cycle"
                self._fail(run, LineFault(reason, is_limit=True))
                return
            if self._skips:
                self._skip(line.text)
                run.result = FREE_LINE
                continue
            try:
                outcome = self._execute(line, run)
            except LineFault as fault:
                self._fail(run, fault)
                return
            if outcome is Outcome.WAIT:
                if run.stage is _Stage.FETCH:
                    run.stage = _Stage.WAIT
                return
            run.result = FREE_LINE
        run.stage = _Stage.DONE

    def _fail(self, run: Run, fault: LineFault) -> None:
        line = run.line
        assert line is not None
        number = line.number if self._profile.file_lines else self.executed
        if self._profile.says_why:
            self._output.message(f"line {number}: {fault}\n")
        else:
            self._output.message(f" syntax error in line : {number} \n")
        run.failure = self.failure(run, str(fault), fault.column, is_limit=fault.is_limit)
        run.result = ERROR
        run.stage = _Stage.DONE

    @staticmethod
    def failure(run: Run | None, reason: str, column: int = 0, *, is_limit: bool = False) -> Failure:
        """The failure of what a run executes, at a column of the line, or where the present statement begins."""
        line = None if run is None else run.line
        if run is None or line is None:
            return Failure(reason, 0, 0, "", is_limit)
        return Failure(reason, line.number, (column or run.column) + line.indent, line.text, is_limit)

    # -- conditions ---------------------------------------------------------------------------------

    @property
    def conditions(self) -> tuple[bool, ...]:
        """The stop conditions of the present line, as they were computed last."""
        return tuple(value != 0.0 for value in self._found[: self._count])

    def begin_command(self) -> None:
        """Set ``$condition`` from the conditions that were computed last, and forget them."""
        self._symbols.pool[self._condition] = float(self._first_true())
        self._count = 0

    def _first_true(self) -> int:
        found = self._found
        for number in range(self._count):
            if found[number] != 0.0:
                return number + 1
        return 0

    def _test(self, tests: Sequence[Value]) -> None:
        for number, test in enumerate(tests):
            self._found[number] = test()
        self._count = len(tests)

    def watch(self, tests: Sequence[Value]) -> float:
        """The value of the first condition of a watch.

        Raises:
            Fault: it cannot be computed.
        """
        if self._profile.watches_apart:
            return tests[0]()
        with self.aside():
            self._test(tests)
            return self._found[0]

    def aside(self) -> _Aside:
        """A command within the present one, after which that goes on as before: a watch, or a client's `eval`."""
        return _Aside(self)

    # -- lines --------------------------------------------------------------------------------------

    def _skip(self, text: str) -> None:
        """A line in a `switch` whose case has not come, or is over. It is not read any further."""
        text = text.lstrip(" \t\r")
        if text.startswith("case "):
            value = leading_number(text[5:])
            if value is not None and abs(value - self._case) < 0.1:
                self._skips = False
        elif text.startswith("endswitch"):
            self._skips = False

    def leave_switch(self) -> None:
        """Skip no more lines."""
        self._skips = False

    def _execute(self, line: PlanLine, run: Run) -> Outcome:
        if line.steps is None:
            self.prepare(line)
        assert line.tree is not None
        assert line.steps is not None
        try:
            for statement, step in zip(line.tree.statements, line.steps, strict=True):
                run.column = _column(statement)
                outcome: Outcome | None = step(run)
                if outcome is not None:
                    return outcome
            if (problem := line.tree.problem) is not None:
                raise LineFault(problem.message, problem.column)
        except LineFault as fault:
            if self._profile.ascii_only or not fault.column:
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
            if token.type is TokenType.SYSTEM and token.text not in self._symbols.system:
                self._output.message(f'System variable "${token.text}" not found\n')
        return False

    def prepare(self, line: PlanLine) -> None:
        """Read a line, and compile what it says. What is wrong with it shows when it is executed."""
        tree = line.tree = self._parser.parse(line.text)
        line.steps = tuple(self._step(statement) for statement in tree.statements)

    def _step(self, statement: Statement) -> _Step:
        if isinstance(statement, CommandStatement):
            return self._command(statement)
        if isinstance(statement, Assign):
            return self._assign(statement)
        if isinstance(statement, Evaluate):
            return self._evaluate(statement)
        if isinstance(statement, If):
            return self._if(statement)
        if isinstance(statement, WaitFor):
            return self._wait_for(statement)
        if isinstance(statement, Switch):
            return self._switch(statement)
        return self._case_or_end(statement)

    def evaluate(self, text: str) -> list[float] | None:
        """The values of ``eval ...``, beside the present command; None if it is something else, or wrong."""
        line = PlanLine(text, 0)
        values: list[float] = []
        with self.aside():
            self.prepare(line)
            assert line.tree is not None
            statement = line.tree.statements[0] if line.tree.statements else None
            try:
                if line.tree.problem is not None:
                    raise LineFault(line.tree.problem.message, line.tree.problem.column)
                if not isinstance(statement, Evaluate):
                    return None
                values = [self.compiler.compile(each)() for each in statement.values]
            except LineFault as fault:
                if not self._profile.says_why and fault.column:
                    self._reads_on(text, fault.column)
                return None
        self._print(values)
        return values

    def perform_aside(self, text: str) -> bool:
        """Execute a line beside the present command; False if it is wrong. It takes no time, whatever it says."""
        line = PlanLine(text, 0)
        with self.aside():
            run = Run(MissionPlan([line]))
            run.line = line
            try:
                self._execute(line, run)
            except LineFault:
                return False
        return True

    # -- statements ---------------------------------------------------------------------------------

    def _operand(self, operand: Operand) -> Callable[[], float | str]:
        if isinstance(operand, (NumberLiteral, TextLiteral)):
            value = operand.value
            return lambda: value
        pool, compiler = self._symbols.pool, self.compiler
        return lambda: pool[compiler.find(operand).place]

    def _command(self, statement: CommandStatement) -> _Step:
        command = self._commands[statement.name]
        parameters = [self._operand(each) for each in statement.parameters]
        speeds = [self._speed(each) for each in statement.speeds]
        conditions = tuple(map(self.compiler.compile, statement.conditions))

        def step(run: Run) -> Outcome | None:
            values = [parameter() for parameter in parameters]
            for speed in speeds:
                speed()
            if statement.is_broken:
                return None
            self._test(conditions)
            self._tests = conditions
            if not command.takes(len(values)):
                if not self._profile.says_why:
                    most = 9 if command.repeats else command.most
                    self._output.message(f"Expecting between {command.least}  and {most} parameters\n")
                raise LineFault(f"{command.name} takes {command.count}, not {len(values)}")
            for number, (operand, value) in enumerate(zip(statement.parameters, values, strict=True)):
                mistake = command.mistake(number, operand)
                if not mistake and self._profile.numbers_are_checked:
                    mistake = command.excess(number, value)
                if mistake:
                    raise LineFault(mistake)
            if command.needs_condition and not conditions:
                raise LineFault(f"{command.name} needs a condition, as in {command.needs_condition}")
            assert self.effects is not None
            return self.effects.perform(command, values, run, conditions)

        return step

    def _speed(self, setting: SpeedSetting) -> Callable[[], None]:
        value = self._operand(setting.value)
        control = self._vehicle.control

        def set_speed() -> None:
            found = value()
            assert isinstance(found, float)
            if self._profile.numbers_are_checked and not (abs(found) < 1e6 and (setting.letter == "v" or found > 0.0)):
                kind = "speed" if setting.letter == "v" else "acceleration; it has to be above 0"
                raise LineFault(f"@{setting.letter} {format_number(found)} is no {kind}")
            if setting.letter == "v":
                control.speed = found
            else:
                control.acceleration = found

        return set_speed

    def _wait_for(self, statement: WaitFor) -> _Step:
        conditions = tuple(map(self.compiler.compile, statement.conditions))

        def step(run: Run) -> Outcome:
            if not conditions and self._profile.ascii_only:
                raise LineFault("a character that is not ASCII can stand in texts and comments only", statement.column)
            self._test(conditions)
            self._tests = conditions
            return Outcome.WAIT

        return step

    def _evaluate(self, statement: Evaluate) -> _Step:
        values = tuple(map(self.compiler.compile, statement.values))

        def step(run: Run) -> Outcome:
            self._print([value() for value in values])
            return Outcome.NEXT

        return step

    def _print(self, values: Sequence[float]) -> None:
        self._output.values("".join(f"{format_number(value)}  " for value in values) + "\n")

    def _if(self, statement: If) -> _Step:
        condition, label = self.compiler.compile(statement.condition), statement.label

        def step(run: Run) -> Outcome:
            if condition() != 0.0:
                self.go_to(label, run)
            return Outcome.NEXT

        return step

    def go_to(self, label: str, run: Run) -> None:
        """Have the line with a label executed next.

        Raises:
            Fault: there is no such label.
        """
        place = run.plan.find_label(label)
        if place is None:
            raise LineFault(f'there is no label "{label}"')
        run.plan.next = place

    def call(self, label: str, run: Run) -> None:
        """Go to a label, and remember the line to return to.

        Raises:
            Fault: there is no such label, or there are too many calls within calls.
        """
        back = run.plan.next
        self.go_to(label, run)
        if len(run.calls) >= self._limits.calls:
            raise LineFault(f"more than {self._limits.calls} calls within each other", is_limit=True)
        run.calls.append(back)

    def go_back(self, run: Run) -> None:
        """Go on behind the last call.

        Raises:
            Fault: there was none.
        """
        if not run.calls:
            raise LineFault("return without a call")
        run.plan.next = run.calls.pop()

    def _assign(self, statement: Assign) -> _Step:
        target = statement.target
        value = self.compiler.compile(statement.value)
        pool = self._symbols.pool
        if isinstance(target, ArrayElement):
            index = self.compiler.compile(target.index)
            array = target.array

            def assign_element(run: Run) -> None:
                symbol = self.compiler.find(array)
                place, new = truncate(index()), value()
                if 0 <= place < symbol.size:
                    pool[symbol.place + place] = new
                elif self._profile.indices_are_checked:
                    raise self.compiler.beyond(array, symbol, place)

            return assign_element
        if target.is_system:

            def assign_system(run: Run) -> None:
                symbol = self.compiler.find(target)
                pool[symbol.place] = value()

            return assign_system
        user, name, following = self._symbols.user, target.name, statement.following

        def assign(run: Run) -> Outcome | None:
            symbol = user.get(name)
            new = value()
            if symbol is not None:
                pool[symbol.place] = new
                return None
            reads_on = self._profile.new_variables_read_on
            # MRC has only one place for a new name, and the name behind the value is there by now.
            overwritten = not reads_on and following is not None and following not in user
            made = self._symbols.make(following if overwritten and following is not None else name)
            if made is None:
                raise LineFault("there is no room for further variables", is_limit=True)
            pool[made.place] = new
            return None if reads_on else Outcome.NEXT

        return assign

    def _switch(self, statement: Switch) -> _Step:
        value = self.compiler.compile(statement.value)

        def step(run: Run) -> Outcome:
            case = truncate(value())
            # Below 1 the lines up to the first case are executed, and no case matches.
            self._case = case if case >= 1 else 0
            self._skips = case >= 1
            return Outcome.NEXT

        return step

    def _case_or_end(self, statement: Case | EndSwitch) -> _Step:
        skips = isinstance(statement, Case)

        def step(run: Run) -> Outcome:
            self._skips = skips
            return Outcome.NEXT

        return step


def _column(statement: Statement) -> int:
    """Where a statement begins, or where the part of it is that can be wrong; 1 for what is wrong in its parts only."""
    if isinstance(statement, (CommandStatement, WaitFor, If)):
        return statement.column
    if isinstance(statement, Assign):
        target = statement.target
        return (target.array if isinstance(target, ArrayElement) else target).column
    return 1


class _Aside:
    """Keeps the present command of an interpreter while another one is executed."""

    def __init__(self, interpreter: ScriptInterpreter) -> None:
        self._interpreter = interpreter

    def __enter__(self) -> None:
        interpreter = self._interpreter
        pool = interpreter._symbols.pool
        self._kept = (
            interpreter._count,
            interpreter._tests,
            interpreter.default_end,
            pool[interpreter._condition],
        )
        self._found = list(interpreter._found) if interpreter._profile.watches_apart else None
        interpreter.begin_command()

    def __exit__(self, *exc: object) -> None:
        interpreter = self._interpreter
        interpreter._count, interpreter._tests, interpreter.default_end, condition = self._kept
        interpreter._symbols.pool[interpreter._condition] = condition
        if self._found is not None:
            interpreter._found = self._found

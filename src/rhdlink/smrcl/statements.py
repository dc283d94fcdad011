"""Compiled statements of a line, which the interpreter executes."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from .arithmetic import format_number, truncate
from .expressions import LineFault
from .plan import Outcome, Run
from .syntax import (
    ArrayElement,
    Assign,
    CommandStatement,
    EndSwitch,
    Evaluate,
    If,
    Operand,
    Problem,
    ScriptLine,
    SpeedSetting,
    Statement,
    Switch,
    TextLiteral,
    WaitFor,
)

if TYPE_CHECKING:
    from .interpreter import ScriptInterpreter

#: Compiled statement of a line. It returns None if the next statement of the line follows.
Step = Callable[[Run], Outcome | None]


def compile_line(line: ScriptLine, interpreter: ScriptInterpreter) -> list[tuple[int, Step]]:
    """Compile a line to its steps, each with its column.

    A step raises `LineFault` if it cannot be executed.
    """
    steps = [(_column(statement), _compile(statement, interpreter)) for statement in line.statements]
    if line.problem is not None:
        steps.append((line.problem.column, _fail(line.problem)))
    return steps


def _fail(problem: Problem) -> Step:
    def step(run: Run) -> Outcome:
        raise LineFault(problem.message, problem.column)

    return step


def _compile(statement: Statement, interpreter: ScriptInterpreter) -> Step:
    if isinstance(statement, CommandStatement):
        return _command(statement, interpreter)
    if isinstance(statement, Assign):
        return _assign(statement, interpreter)
    if isinstance(statement, Evaluate):
        return _evaluate(statement, interpreter)
    if isinstance(statement, If):
        return _if(statement, interpreter)
    if isinstance(statement, WaitFor):
        return _wait_for(statement, interpreter)
    if isinstance(statement, Switch):
        return _switch(statement, interpreter)
    # `case`, or `endswitch`: the lines before an executed `case` belonged to another case.
    return _skip(interpreter, not isinstance(statement, EndSwitch))


def _column(statement: Statement) -> int:
    """Column of the statement or of the part that can fail; 1 if only its parts can fail."""
    if isinstance(statement, (CommandStatement, WaitFor, If)):
        return statement.column
    if isinstance(statement, Assign):
        target = statement.target
        return (target.array if isinstance(target, ArrayElement) else target).column
    return 1


def _operand(operand: Operand, interpreter: ScriptInterpreter) -> Callable[[], float | str]:
    if isinstance(operand, TextLiteral):
        text = operand.value
        return lambda: text
    return interpreter.compiler.compile(operand)


def _command(statement: CommandStatement, interpreter: ScriptInterpreter) -> Step:
    command, profile = interpreter.commands[statement.name], interpreter.profile
    parameters = [_operand(each, interpreter) for each in statement.parameters]
    speeds = [_speed(each, interpreter) for each in statement.speeds]
    conditions = tuple(map(interpreter.compiler.compile, statement.conditions))

    def step(run: Run) -> Outcome | None:
        values = [parameter() for parameter in parameters]
        for speed in speeds:
            speed()
        if statement.is_broken:
            return None
        interpreter.set_conditions(conditions)
        if not (command.takes(len(values)) or profile.says_why):
            most = 9 if command.repeats else command.most
            interpreter.output.message(f"Expecting between {command.least}  and {most} parameters\n")
        for mistake in command.mistakes(statement, values, checks_numbers=profile.numbers_are_checked):
            raise LineFault(mistake)
        return interpreter.perform(command, values, run, conditions)

    return step


def _speed(setting: SpeedSetting, interpreter: ScriptInterpreter) -> Callable[[], None]:
    value = interpreter.compiler.compile(setting.value)
    control, is_checked = interpreter.vehicle.control, interpreter.profile.numbers_are_checked

    def set_speed() -> None:
        found = value()
        if is_checked and not (abs(found) < 1e6 and (setting.letter == "v" or found > 0.0)):
            kind = "a speed" if setting.letter == "v" else "an acceleration; it has to be above 0"
            raise LineFault(f"@{setting.letter} {format_number(found)} is not {kind}")
        if setting.letter == "v":
            control.speed = found
        else:
            control.acceleration = found

    return set_speed


def _wait_for(statement: WaitFor, interpreter: ScriptInterpreter) -> Step:
    conditions = tuple(map(interpreter.compiler.compile, statement.conditions))

    def step(run: Run) -> Outcome:
        if not conditions and interpreter.profile.ascii_only:
            raise LineFault("a character that is not ASCII is allowed only in texts and comments", statement.column)
        interpreter.set_conditions(conditions)
        return Outcome.WAIT

    return step


def _evaluate(statement: Evaluate, interpreter: ScriptInterpreter) -> Step:
    values = tuple(map(interpreter.compiler.compile, statement.values))

    def step(run: Run) -> Outcome:
        interpreter.print_values([value() for value in values])
        return Outcome.NEXT

    return step


def _if(statement: If, interpreter: ScriptInterpreter) -> Step:
    condition, label = interpreter.compiler.compile(statement.condition), statement.label

    def step(run: Run) -> Outcome:
        if condition() != 0.0:
            interpreter.go_to(label, run)
        return Outcome.NEXT

    return step


def _assign(statement: Assign, interpreter: ScriptInterpreter) -> Step:
    target, compiler, symbols = statement.target, interpreter.compiler, interpreter.symbols
    value, pool, profile = compiler.compile(statement.value), symbols.pool, interpreter.profile
    if isinstance(target, ArrayElement):
        index = compiler.compile(target.index)
        array = target.array

        def assign_element(run: Run) -> None:
            symbol = compiler.find(array)
            place, new = truncate(index()), value()
            if 0 <= place < symbol.size:
                pool[symbol.place + place] = new
            elif profile.indices_are_checked:
                raise compiler.beyond(array, symbol, place)

        return assign_element
    if target.is_system:

        def assign_system(run: Run) -> None:
            symbol = compiler.find(target)
            pool[symbol.place] = value()

        return assign_system
    user, name, following = symbols.user, target.name, statement.following

    def assign(run: Run) -> Outcome | None:
        symbol = user.get(name)
        new = value()
        if symbol is not None:
            pool[symbol.place] = new
            return None
        reads_on = profile.new_variables_read_on
        # MRC stores only one new name, and at this point the stored name is the name after the value.
        overwritten = not reads_on and following is not None and following not in user
        made = symbols.make(following if overwritten and following is not None else name)
        if made is None:
            raise LineFault("there is no room for more variables", is_limit=True)
        pool[made.place] = new
        return None if reads_on else Outcome.NEXT

    return assign


def _switch(statement: Switch, interpreter: ScriptInterpreter) -> Step:
    value = interpreter.compiler.compile(statement.value)

    def step(run: Run) -> Outcome:
        case = truncate(value())
        # Below 1, the lines up to the first case are executed, and no case matches.
        interpreter.case = case if case >= 1 else 0
        interpreter.skips = case >= 1
        return Outcome.NEXT

    return step


def _skip(interpreter: ScriptInterpreter, skips: bool) -> Step:
    def step(run: Run) -> Outcome:
        interpreter.skips = skips
        return Outcome.NEXT

    return step

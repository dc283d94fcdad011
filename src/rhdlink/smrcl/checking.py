"""Checks that find the errors in a script before it runs. Every line is parsed and checked.

Whether a system variable exists depends on the robot, so this is checked only if a robot is given.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from dataclasses import is_dataclass

from ..errors import Mistake
from .commands import COMMANDS, ParameterKind
from .parser import Parser
from .plan import MissionPlan
from .symbols import split_index
from .syntax import (
    ArrayElement,
    Assign,
    CommandStatement,
    If,
    NumberLiteral,
    ScriptLine,
    TextLiteral,
    VariableName,
    WaitFor,
)


def check(
    plan: MissionPlan,
    *,
    functions: Collection[str] = (),
    variables: Collection[str] = (),
    checks_numbers: bool = True,
    system: Collection[str] | None = None,
) -> list[Mistake]:
    """Return every mistake in a script, in the order of its lines.

    Args:
        plan: Lines of the script.
        functions: Additional functions of the mission.
        variables: Variables that exist before the script begins.
        checks_numbers: Whether a number that is too large for a motion is a mistake.
        system: System variables of the robot; None if they are not known.
    """
    parser = Parser(COMMANDS, functions)
    trees = [parser.parse(line.text) for line in plan.lines]
    made = {*variables, *_made(trees)}
    found: list[Mistake] = []
    for line, tree in zip(plan.lines, trees, strict=True):
        for column, message in _mistakes(tree, plan, made, checks_numbers, system):
            # The column is counted in the file, where the line can be indented.
            found.append(Mistake(line.number, column + line.indent, message))
    return found


def _mistakes(
    tree: ScriptLine, plan: MissionPlan, made: Collection[str], checks_numbers: bool, system: Collection[str] | None
) -> Iterator[tuple[int, str]]:
    """Yield the mistakes in a line, each with its column."""
    for statement in tree.statements:
        for variable in _variables(statement):
            if variable.is_system:
                if system is not None and variable.name not in system:
                    yield (variable.column, f"the robot has no system variable ${variable.name}")
            elif variable.name not in made:
                yield (variable.column, f"nothing in the script makes the variable {variable.name}")
        if isinstance(statement, If) and statement.label not in plan.labels:
            yield (statement.column, f'there is no label "{statement.label}"')
        if isinstance(statement, WaitFor) and not statement.conditions:
            yield (statement.column, "a character that is not ASCII is allowed only in texts and comments")
        if isinstance(statement, CommandStatement):
            for text in _command_mistakes(statement, plan, checks_numbers):
                yield (statement.column, text)
    if tree.problem is not None:
        yield (tree.problem.column, tree.problem.message)


def _command_mistakes(statement: CommandStatement, plan: MissionPlan, checks_numbers: bool) -> Iterator[str]:
    if statement.is_broken:
        return
    command = COMMANDS[statement.name]
    known = [operand.value if isinstance(operand, NumberLiteral) else None for operand in statement.parameters]
    yield from command.mistakes(statement, known, checks_numbers=checks_numbers)
    if not command.takes(len(known)):
        return
    for label in _texts(statement, ParameterKind.LABEL):
        if label not in plan.labels:
            yield f'there is no label "{label}"'
    for setting in statement.speeds:
        if setting.letter == "a" and isinstance(setting.value, NumberLiteral) and not setting.value.value > 0.0:
            yield "an acceleration has to be above 0"


def _texts(statement: CommandStatement, kind: ParameterKind) -> Iterator[str]:
    """Yield the parameters of a kind that are texts."""
    for number, operand in enumerate(statement.parameters):
        if isinstance(operand, TextLiteral) and COMMANDS[statement.name].kind(number) is kind:
            yield operand.value


def _made(trees: Iterable[ScriptLine]) -> Iterator[str]:
    """Yield the variables that a script makes, by an assignment or by a command."""
    for tree in trees:
        for statement in tree.statements:
            if isinstance(statement, Assign) and isinstance(statement.target, VariableName):
                yield statement.target.name
            elif isinstance(statement, CommandStatement):
                yield from (split_index(name)[0] for name in _texts(statement, ParameterKind.NEW_NAME))


def _variables(part: object) -> Iterator[VariableName]:
    """Yield the variables that a statement or a part of it reads."""
    if isinstance(part, VariableName):
        yield part
    elif isinstance(part, Assign):
        yield from _variables(part.value)
        if isinstance(part.target, ArrayElement) or part.target.is_system:
            yield from _variables(part.target)
    elif isinstance(part, tuple):
        for each in part:
            yield from _variables(each)
    elif is_dataclass(part):
        # Do not use `fields`: a check would take a third longer.
        for each in vars(part).values():
            yield from _variables(each)

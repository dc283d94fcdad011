"""Convert trees of SMR-CL to text that is parsed to the same tree."""

from __future__ import annotations

import math

from rhdlink.smrcl.syntax import (
    PRECEDENCE,
    UNARY_PRECEDENCE,
    ArrayElement,
    Assign,
    Call,
    Case,
    CommandStatement,
    Evaluate,
    Expression,
    If,
    Negate,
    NumberLiteral,
    Operand,
    ScriptLine,
    Statement,
    Switch,
    TextLiteral,
    VariableName,
    WaitFor,
)

__all__ = ["write_expression", "write_line"]


def write_expression(expression: Expression, loosest: int = 0) -> str:
    """Return an expression as text, in brackets if its precedence is below `loosest`."""
    if isinstance(expression, NumberLiteral):
        return _number(expression.value)
    if isinstance(expression, VariableName):
        return f"${expression.name}" if expression.is_system else expression.name
    if isinstance(expression, ArrayElement):
        return f"{write_expression(expression.array)}[{write_expression(expression.index)}]"
    if isinstance(expression, Call):
        return f"{expression.name}({', '.join(map(write_expression, expression.arguments))})"
    if isinstance(expression, Negate):
        # The operand may be anything that binds at least as tightly as a minus, including another minus.
        text, level = f"-{write_expression(expression.operand, UNARY_PRECEDENCE)}", UNARY_PRECEDENCE
    else:
        level = PRECEDENCE[expression.operator]
        is_power = expression.operator == "^"
        left = write_expression(expression.left, level + is_power)
        right = write_expression(expression.right, level + (not is_power))
        text = f"{left} {expression.operator} {right}"
    return f"({text})" if level < loosest else text


def write_line(line: ScriptLine) -> str:
    """Return a line as text that is parsed to the same line.

    Raises:
        ValueError: If the line has a problem, or contains a text that cannot be written.
    """
    if line.problem is not None:
        raise ValueError(f"a line with a problem has no text: {line.problem.message}")
    return " ".join(map(_write, line.statements))


def _write(statement: Statement) -> str:
    if isinstance(statement, CommandStatement):
        words = [statement.name, *map(_operand, statement.parameters)]
        words += [f"@{each.letter} {_operand(each.value)}" for each in statement.speeds]
        if statement.conditions:
            words.append(_conditions(statement.conditions))
        return " ".join(words)
    if isinstance(statement, WaitFor):
        return _conditions(statement.conditions)
    if isinstance(statement, Evaluate):
        return f"eval {' ; '.join(map(write_expression, statement.values))}"
    if isinstance(statement, If):
        return f"if ({write_expression(statement.condition)}) {_quoted(statement.label)}"
    if isinstance(statement, Assign):
        return f"{write_expression(statement.target)} = {write_expression(statement.value)}"
    if isinstance(statement, Switch):
        return f"switch ({write_expression(statement.value)})"
    if isinstance(statement, Case):
        return f"case {_number(statement.value.value)}"
    return "endswitch"


def _conditions(conditions: tuple[Expression, ...]) -> str:
    return f": {' | '.join(f'({write_expression(each)})' for each in conditions)}"


def _operand(operand: Operand) -> str:
    return _quoted(operand.value) if isinstance(operand, TextLiteral) else write_expression(operand)


def _quoted(text: str) -> str:
    if '"' in text or "\\" in text or "\0" in text:
        raise ValueError(f"no string can hold {text!r}")
    return f'"{text}"'


def _number(value: float) -> str:
    if value != value:
        raise ValueError("no number is written nan")
    if math.isinf(value):
        return "1e999" if value > 0 else "-1e999"
    return repr(value)

"""Parsing lines to trees, writing trees as lines, and the messages for invalid lines."""

from __future__ import annotations

import math

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from rhdlink.smrcl.commands import COMMANDS, RESERVED
from rhdlink.smrcl.lexer import TokenType, tokenize
from rhdlink.smrcl.parser import FUNCTIONS, Parser
from rhdlink.smrcl.plan import LONGEST_LINE
from rhdlink.smrcl.syntax import (
    PRECEDENCE,
    ArrayElement,
    Assign,
    Binary,
    Call,
    Case,
    CommandStatement,
    EndSwitch,
    Evaluate,
    Expression,
    If,
    Negate,
    NumberLiteral,
    ScriptLine,
    SpeedSetting,
    Switch,
    TextLiteral,
    VariableName,
    WaitFor,
)
from tests.rhdlink.smrcl.written import write_expression, write_line

PARSER = Parser(COMMANDS)

names = st.from_regex(r"[A-Za-z][A-Za-z0-9]{0,6}", fullmatch=True).filter(lambda name: name not in RESERVED)
numbers = st.builds(NumberLiteral, st.floats(min_value=0.0, allow_nan=False))
variables = st.builds(VariableName, names, st.booleans())
texts = st.text(st.characters(codec="latin-1", exclude_characters='"\\\0\n\r'), max_size=8)


def _compound(inner: st.SearchStrategy[Expression]) -> st.SearchStrategy[Expression]:
    calls = st.sampled_from(sorted(FUNCTIONS)).flatmap(
        lambda name: st.builds(Call, st.just(name), st.tuples(*[inner] * FUNCTIONS[name]))
    )
    return st.one_of(
        st.builds(ArrayElement, variables, inner),
        calls,
        st.builds(Negate, inner),
        st.builds(Binary, st.sampled_from(sorted(PRECEDENCE)), inner, inner),
    )


expressions: st.SearchStrategy[Expression] = st.recursive(st.one_of(numbers, variables), _compound, max_leaves=8)
signed = st.builds(NumberLiteral, st.floats(allow_nan=False))
operands = st.one_of(signed, st.builds(TextLiteral, texts), variables)
speeds = st.one_of(
    st.builds(SpeedSetting, st.just("v"), st.one_of(signed, variables)),
    st.builds(SpeedSetting, st.just("a"), st.one_of(numbers, variables)),
)
conditions = st.lists(expressions, max_size=3).map(tuple)
ends = st.one_of(
    st.builds(
        CommandStatement,
        st.sampled_from(sorted(COMMANDS)),
        st.lists(operands, max_size=4).map(tuple),
        st.lists(speeds, max_size=2).map(tuple),
        conditions,
    ),
    st.builds(WaitFor, st.lists(expressions, min_size=1, max_size=3).map(tuple)),
    st.builds(Evaluate, st.lists(expressions, min_size=1, max_size=3).map(tuple)),
    st.builds(If, expressions, texts),
    st.builds(Switch, expressions),
    st.builds(Case, numbers),
    st.builds(EndSwitch),
)
# A statement that begins with a minus would continue the previous assignment, so only one assignment comes first.
assignments = st.builds(Assign, st.one_of(variables, st.builds(ArrayElement, variables, expressions)), expressions)
lines = st.one_of(
    st.just(ScriptLine(())),
    st.builds(lambda one: ScriptLine((one,)), st.one_of(assignments, ends)),
    st.builds(
        lambda first, last: ScriptLine((first, last)),
        assignments,
        ends.filter(lambda end: not isinstance(end, WaitFor)),
    ),
)


@pytest.mark.property
@given(lines)
def test_written_line_is_parsed_to_the_same_line(line: ScriptLine) -> None:
    text = write_line(line)
    assume(len(text) <= LONGEST_LINE)
    assert PARSER.parse(text) == line


@pytest.mark.property
@given(st.text(st.characters(codec="latin-1"), max_size=300))
def test_any_text_is_a_line_or_has_a_problem_within_it(text: str) -> None:
    tree = PARSER.parse(text)
    if tree.problem is not None:
        assert 1 <= tree.problem.column <= len(text) + 1
    tokens = tokenize(text)
    assert tokens[-1].type is TokenType.END
    assert [token.column for token in tokens] == sorted({token.column for token in tokens})


@pytest.mark.property
@given(expressions)
def test_expression_is_written_with_the_necessary_brackets(expression: Expression) -> None:
    """The text is parsed to the same tree, and additional brackets around it do not change the tree."""
    text = write_expression(expression)
    assume(len(f"eval (({text}))") <= LONGEST_LINE)
    assert PARSER.parse(f"eval {text}") == ScriptLine((Evaluate((expression,)),))
    assert PARSER.parse(f"eval (({text}))") == PARSER.parse(f"eval {text}")


def bracketed(text: str) -> str:
    """Return an expression with brackets around every operation."""
    (statement,) = PARSER.parse(f"eval {text}").statements
    assert isinstance(statement, Evaluate)

    def write(expression: Expression) -> str:
        if isinstance(expression, Binary):
            return f"({write(expression.left)}{expression.operator}{write(expression.right)})"
        if isinstance(expression, Negate):
            return f"(-{write(expression.operand)})"
        return write_expression(expression)

    return write(statement.values[0])


@pytest.mark.parametrize(
    ("text", "meant"),
    [
        ("a - b - c", "((a-b)-c)"),
        ("a / b / c * d", "(((a/b)/c)*d)"),
        ("a ^ b ^ c", "(a^(b^c))"),
        ("-a ^ b", "(-(a^b))"),
        ("-a * b", "((-a)*b)"),
        ("a ^ -b ^ c", "(a^(-(b^c)))"),
        ("a ^ -b * c", "((a^(-b))*c)"),
        ("a | b & c", "(a|(b&c))"),
        ("a == b != c", "(a==(b!=c))"),
        ("a > b < c", "(a>(b<c))"),
        ("a >= b <= c", "(a>=(b<=c))"),
        ("a < b >= c", "(a<(b>=c))"),
        ("a != b > c + d", "(a!=(b>(c+d)))"),
        ("a - -b", "(a-(-b))"),
        ("--a", "(-(-a))"),
    ],
)
def test_operator_precedence_equals_that_of_mrc(text: str, meant: str) -> None:
    assert bracketed(text) == bracketed(meant)


@pytest.mark.parametrize(
    ("text", "column", "message"),
    [
        ("fwd 1+1", 6, "expected the end of the line after the parameters, found '+'"),
        ("fwd (0.02)", 5, "expected the end of the line after the parameters, found '('"),
        ("fwd -a", 6, "expected a number after '-'; a parameter is a number, a variable or a text, found the name a"),
        ("fwd 1 @v -a", 11, "expected a number after '@v -', found the name a"),
        ("fwd 1 @a -0.3", 10, "expected a number or a variable after '@a', found '-'"),
        ("wait 1 : 1", 10, "expected '(' around a condition, found '1'"),
        ("wait 1 : (1", 12, "expected ')' around a condition, found the end of the line"),
        ("eval", 5, "expected a number, a variable or '(', found the end of the line"),
        ("eval 1 +", 9, "expected a number, a variable or '(', found the end of the line"),
        ("eval sin", 9, "expected '(' after the function sin, found the end of the line"),
        ("eval atan2(1)", 13, "expected ',' and another value: atan2 takes 2, found ')'"),
        ("eval sin(1,2)", 11, "expected ')' after the value of sin, found ','"),
        ("a b = 1", 3, "expected '=' after a, which is not a command, found the name b"),
        ("fwdd 1", 6, "expected '=' after fwdd, which is not a command, found '1'"),
        ("sin = 3", 1, "expected a command or an assignment, found the function sin"),
        ("fwd = 3", 5, "expected the end of the line after the parameters, found '='"),
        ("5 = a", 1, "expected a command or an assignment, found '5'"),
        ("a_b = 1", 2, "expected '=' after a, which is not a command, found '_'"),
        ("goto x y", 9, ""),
        ('if (a = 3) "x"', 7, "expected ')' after if, found '='"),
        ("if (1) x", 8, 'expected a label, as in if (a > 1) "label", found the name x'),
        ("case x", 6, "expected a number after case, found the name x"),
        ("switch 1", 8, "expected '(' after switch, found '1'"),
        ("a[1 = 3", 5, "expected ']' after the index, found '='"),
        ("fwd 1 é", 7, "expected the end of the line after the parameters, found a character that is not ASCII"),
        (f"eval {'(' * 70}1", 66, "brackets and signs are nested too deeply; the maximum is 60"),
        (f"{'a' * 80} = 1", 1, "a name can have at most 79 characters; this one has 80"),
    ],
)
def test_syntax_problem_has_a_column_and_a_message(text: str, column: int, message: str) -> None:
    problem = PARSER.parse(text).problem
    if not message:
        assert problem is None
        return
    assert problem is not None
    assert (problem.column, problem.message) == (column, message)


def test_statements_before_a_problem_are_kept() -> None:
    line = PARSER.parse("a = 4 fwd 1 @v 0.2 )")
    assert line.statements == (
        Assign(VariableName("a"), NumberLiteral(4.0)),
        CommandStatement("fwd", (NumberLiteral(1.0),), (SpeedSetting("v", NumberLiteral(0.2)),), is_broken=True),
    )
    assert line.problem is not None


def test_rest_of_a_line_is_ignored_like_in_mrc() -> None:
    for text in ('if (1) "x" )(', "switch (2) )(", "case 2 )(", "endswitch )("):
        assert PARSER.parse(text).problem is None


@pytest.mark.parametrize(
    ("text", "tokens"),
    [
        ("fwd0.5", ["fwd0", ".5"]),
        ("wait.02:(1)%x", ["wait", ".02", ":", "(", "1", ")"]),
        ("fwd 0.02@v0.1@a.5", ["fwd", "0.02", "@v", "0.1", "@a", ".5"]),
        ('log "a b" \\c\\', ["log", '"a b"', '"c"']),
        ('print "abc', ["print"]),
        ("$odox2y", ["$odox2y"]),
        ("$1 $_", ["$", "1", "$", "_"]),
        ("a>=b==c", ["a", ">=", "b", "==", "c"]),
        ("a =< b", ["a", "=", "<", "b"]),
        ("x % y", ["x"]),
    ],
)
def test_line_is_split_into_tokens(text: str, tokens: list[str]) -> None:
    assert [str(token) for token in tokenize(text)[:-1]] == tokens


def test_infinite_number_survives_a_round_trip() -> None:
    line = ScriptLine((Evaluate((NumberLiteral(math.inf),)),))
    assert PARSER.parse(write_line(line)) == line


@pytest.mark.parametrize("line", [PARSER.parse("fwd ("), ScriptLine((CommandStatement("print", (TextLiteral('"'),)),))])
def test_line_without_a_valid_text_cannot_be_written(line: ScriptLine) -> None:
    with pytest.raises(ValueError, match=r"no text|no string"):
        write_line(line)

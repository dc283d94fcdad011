"""The language compared with Python's own arithmetic, and tested with arbitrary texts."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from tests.fakes.world import NotedWorld, run
from urlink.protocol.firmware import Firmware
from urlink.simulator.urscript import ProgramError, Script, compile_script
from urlink.simulator.urscript.builtins import BUILTINS

FIRMWARE = Firmware(5, 11)
INTEGERS = st.integers(-1000, 1000)
FLOATS = st.floats(-1e6, 1e6).map(lambda x: round(x, 6))
NUMBERS = st.one_of(INTEGERS, FLOATS)
LISTS = st.lists(NUMBERS, min_size=1, max_size=6)

# A text and its value in Python, or None if Python raises an error.
Sum = tuple[str, float | int | None]


def modulo(a: float | int, b: float | int) -> float | int:
    return math.fmod(a, b) if isinstance(a, float) or isinstance(b, float) else int(math.fmod(a, b))


OPERATORS: dict[str, Callable[[float | int, float | int], float | int]] = {
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": operator.truediv,
    "%": modulo,
}


def usable(value: float | int) -> bool:
    return -(2**31) <= value < 2**31 if isinstance(value, int) else math.isfinite(value)


def joined(left: Sum, sign: str, right: Sum) -> Sum:
    text = f"({left[0]}) {sign} ({right[0]})"
    if left[1] is None or right[1] is None:
        return text, None
    try:
        value = OPERATORS[sign](left[1], right[1])
    except (ArithmeticError, ValueError):
        return text, None
    return text, value if usable(value) else None


def negative(of: Sum) -> Sum:
    return f"-({of[0]})", None if of[1] is None or not usable(-of[1]) else -of[1]


LEAVES: st.SearchStrategy[Sum] = NUMBERS.map(lambda x: (repr(x), x))
SUMS: st.SearchStrategy[Sum] = st.recursive(
    LEAVES,
    lambda inner: st.one_of(
        st.builds(joined, inner, st.sampled_from(sorted(OPERATORS)), inner),
        st.builds(negative, inner),
    ),
    max_leaves=12,
)


def evaluate(text: str) -> list[str]:
    """Return the magnitude of a value with all digits, and the end of the program."""
    world = NotedWorld()
    world.payload = math.nan
    run(f"def f():\n  set_payload(norm({text}))\nend\n", world)
    return [repr(world.payload), world.notes[-1]]


@pytest.mark.property
@given(SUMS)
def test_arithmetic_equals_that_of_python(case: Sum) -> None:
    text, value = case
    found = evaluate(text)
    if value is None:
        assert "error" in found[-1]
    elif usable(abs(value)):
        assert [float(found[0]), *found[1:]] == [abs(value), "0 over"]


@pytest.mark.property
@given(NUMBERS, NUMBERS, NUMBERS, st.sampled_from("+-*"), st.sampled_from("+-*"))
def test_operator_precedence_equals_that_of_python(a: float, b: float, c: float, first: str, second: str) -> None:
    text = f"{a!r} {first} {b!r} {second} {c!r}"
    assert float(evaluate(text)[0]) == abs(eval(text))


TRUTHS: st.SearchStrategy[str] = st.recursive(
    st.sampled_from(["True", "False"]),
    lambda inner: st.one_of(
        st.builds("{} {} {}".format, inner, st.sampled_from(["and", "or"]), inner),
        st.builds("not {}".format, inner),
        st.builds("({})".format, inner),
    ),
    max_leaves=10,
)


@pytest.mark.property
@given(TRUTHS)
def test_logic_equals_that_of_python(text: str) -> None:
    assert run(f"textmsg({text})\n").notes == [f"0 textmsg {eval(text)}", "0 over"]


@pytest.mark.property
@given(LISTS, LISTS, NUMBERS, st.sampled_from("+-*"))
def test_list_arithmetic_is_element_by_element(a: list[float], b: list[float], x: float, sign: str) -> None:
    size = min(len(a), len(b))
    a, b = a[:size], b[:size]
    function = OPERATORS[sign]
    for text, expected in (
        (f"{a} {sign} {b}", [function(p, q) for p, q in zip(a, b, strict=True)]),
        (f"{a} {sign} {x!r}", [function(p, x) for p in a]),
        (f"{x!r} {sign} {a}", [function(x, p) for p in a]),
    ):
        shown = "[" + ",".join(f"{value:g}" if isinstance(value, float) else str(value) for value in expected) + "]"
        assert run(f"textmsg({text})\n").notes[0] == f"0 textmsg {shown}"


WORDS = """
def sec thread end if elif else while return break continue pass halt global local run kill join and or xor not True
False x y f ( ) ( ) [ ] : , = == < + - * / % 1 2.5 'text' "text" # p[ movej textmsg sync enter_critical 1e999 0x10
"""
WORD = st.sampled_from([*WORDS.split(), "\n", "\n", "\n"])


def compiled(text: str) -> Script | ProgramError:
    try:
        return compile_script(text, FIRMWARE)
    except ProgramError as error:
        return error


def is_script_or_error(text: str) -> None:
    found = compiled(text)
    if isinstance(found, ProgramError):
        assert 1 <= found.line <= text.count("\n") + 1
        assert found.column >= 1
        assert found.text
    else:
        last = run(text, cycles=3).notes[-1]
        assert last.split(maxsplit=1)[1].startswith(("over", "error", "stopped"))


@pytest.mark.property
@given(st.text())
@example("def f():\n  x = '\ud800'\n  textmsg(x)\nend")
@example("é = 1")
@example("0x")
@example("1" * 5000)
def test_any_text_is_a_program_or_an_error(text: str) -> None:
    is_script_or_error(text)


@pytest.mark.property
@given(st.lists(WORD, max_size=40).map(" ".join))
def test_any_words_are_a_program_or_an_error(text: str) -> None:
    is_script_or_error(text)


LINES = st.sampled_from(
    [
        "x = 1",
        "x = [1, x]",
        "x[0] = x",
        "x = f(x)",
        "global y = x",
        "x = p[1,2,3,4,5,6]",
        "x = x * 2 + y",
        "x = str_cat(x, y)",
        "x = run t()",
        "kill x",
        "join x",
        "sync()",
        "y = get_actual_tcp_pose()",
        "movej(x)",
        "x = socket_read_line()",
        "enter_critical",
        "exit_critical",
        "x = not x",
        "x = x == y",
        "x = to_num(to_str(x))",
        "set_digital_out(x, y)",
    ]
)


@pytest.mark.property
@given(st.lists(LINES, max_size=8), st.lists(LINES, max_size=6), st.lists(LINES, max_size=6))
def test_any_program_of_valid_lines_ends_or_keeps_running(
    main: list[str], function: list[str], thread: list[str]
) -> None:
    lines = ["y = 2", "def f(x=1):", *function, "return x", "end", "thread t():", "x = 0", *thread, "end", *main]
    is_script_or_error("\n".join(lines))


VALUES = st.sampled_from(
    [
        "0",
        "1",
        "-1",
        "6",
        "2147483647",
        "0.5",
        "1.5",
        "-1e300",
        "nan",
        "True",
        "''",
        "'socket_0'",
        "'1.5'",
        "[]",
        "[1, 2, 3]",
        "['a']",
        "[[1, 2], [3]]",
        "[True, False]",
        "[0, 0, 0, 0, 0, 0]",
        "[0, 0, 0, 0, 0, 'x']",
        "[nan, 0, 0, 0, 0, 0]",
        "p[0.4, 0.1, 0.3, 0, 3, 0]",
        "p[1e300, 0, 0, 1e300, 0, 0]",
        "p[nan, 0, 0, 0, nan, 0]",
        "handle",
        "nothing",
    ]
)
NAMES = st.sampled_from(sorted(BUILTINS))
BEGINNING = """
def nothing_at_all():
  sync()
end
thread waiting():
  sync()
end
handle = run waiting()
nothing = nothing_at_all()
connected = socket_open("host", 1)
nan = socket_read_ascii_float(1)
nan = nan[1]
"""


@pytest.mark.property
@given(NAMES, st.lists(VALUES, max_size=6), st.sampled_from(["1.8", "3.4", "5.11"]))
def test_any_built_in_call_returns_or_is_an_error(name: str, values: list[str], firmware: str) -> None:
    world = NotedWorld(firmware)
    world.sockets.peers[1] = [b"(x)", b"rest\n"]
    try:
        run(f"{BEGINNING}\ntextmsg({name}({', '.join(values)}))", world, cycles=20)
    except ProgramError as error:
        assert error.text == f"compile_error_name_not_found:{name}:"  # noqa: PT017
    else:
        assert world.notes[-1].split()[1] in ("over", "error", "stopped")

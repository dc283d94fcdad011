"""Malicious programs: each must end with an error, without using much time or memory."""

from __future__ import annotations

import contextlib
import gc
import itertools
import re
import sys
import time
import tracemalloc
from collections.abc import Callable, Iterable, Iterator

import pytest

from tests.fakes.world import NotedWorld, run
from urlink.protocol.firmware import Firmware
from urlink.simulator.urscript import Execution, ProgramError, compile_script
from urlink.simulator.urscript.errors import (
    MAX_CALL_DEPTH,
    MAX_ELEMENTS,
    MAX_INSTRUCTIONS,
    MAX_MEMORY,
    MAX_NESTING,
    MAX_PARAMETERS,
    MAX_STRING,
    MAX_TEXT,
    MAX_THREADS,
    MAX_TOKENS,
)

FIRMWARE = Firmware(5, 11)
ENDLESS = "The program used too much time without instructing the robot what to do."


def names() -> Iterator[str]:
    return ("v" + "".join(letters) for letters in itertools.product("abcdefgh", repeat=5))


def repeated(unit: Callable[[int], str]) -> Callable[[int], str]:
    """Return a function that makes a program of about a given length; `unit` makes a statement from its number."""

    def text(size: int) -> str:
        parts: list[str] = []
        length = 0
        while length < size:
            parts.append(unit(len(parts)))
            length += len(parts[-1])
        return "def f():\n" + "".join(parts) + "end\n"

    return text


def listed(before: str, items: Callable[[], Iterable[str]], after: str) -> Callable[[int], str]:
    """Return a function that makes a program of about a given length, in characters, with one long list."""

    def text(size: int) -> str:
        taken: list[str] = []
        for item in items():
            taken.append(item)
            if (len(item) + 1) * len(taken) > size:
                break
        return before + ",".join(taken) + after

    return text


DEFAULTS = ",".join(f"{name}=1" for name in itertools.islice(names(), 60))
#: Programs for which compiling was or could be quadratic, as functions of their length in characters.
GROWING: dict[str, Callable[[int], str]] = {
    "statements": repeated(lambda n: f"  x{n % 2000} = (1 + 2) * 3 - 4\n"),
    "moves": repeated(lambda n: "  movej([0.1, -1.57, 1.57, -1.57, -1.57, 0.0], a=1.4, v=1.05)\n"),
    "parameters": listed("def f():\ndef g(", names, "):\nend\nend\n"),
    "parameters in turn": repeated(lambda n: f"def g{n}({','.join(itertools.islice(names(), 60))}):\nend\n"),
    "arguments": listed("def f():\ndef g(a):\nend\ng(", lambda: itertools.repeat("1"), ")\nend\n"),
    "named arguments": listed("def f():\nmovej(", lambda: (f"{name}=1" for name in names()), ")\nend\n"),
    "calls with many parameters": repeated(
        lambda n: (
            f"def g({','.join(f'{name}=1' for name in itertools.islice(names(), 60))}):\nend\n" if not n else "g()\n"
        )
    ),
    "definitions": repeated(lambda n: f"def g{n}():\n return g{max(n - 1, 0)}()\nend\n"),
    "nested definitions": repeated(lambda n: "".join(f"def a{n}_{at}():\n" for at in range(40)) + "end\n" * 40),
    "globals": repeated(lambda n: f"global g{n}=1\n"),
    "locals": repeated(lambda n: f"local g{n}=1\n"),
    "a list": listed("x=[", lambda: itertools.repeat("1"), "]\n"),
    "a string": lambda size: f'x="{"a" * size}"\n',
    "a name": lambda size: f"{'a' * size}=1\n",
    "a number": lambda size: f"x={'9' * size}\n",
    "an unfinished string": lambda size: f'x="{"a" * size}\n',
    "quotes": lambda size: "x=" + "'\"" * (size // 2),
    "blanks": lambda size: " " * size + "x=1\n",
    "blank lines": lambda size: "\n" * size + "$\n",
    "comments": lambda size: "#\n" * (size // 2) + "$\n",
    "a comment": lambda size: "#" * size + "\n$\n",
    "sums": repeated(lambda n: " x=1" + "+1" * 60 + "\n"),
    "brackets": repeated(lambda n: " x=" + "(" * 50 + "1" + ")" * 50 + "\n"),
    "lists in lists": repeated(lambda n: " x=" + "[" * 50 + "1" + "]" * 50 + "\n"),
    "branches": repeated(lambda n: "if True:\n" * 40 + "end\n" * 40),
    "else ifs": lambda size: "if x == 0:\nx = 1\n" + "elif x == 1:\nx = 1\n" * (size // 20) + "end\n",
    "waiting calls": repeated(lambda n: " x=" + "+".join(["socket_read_line()"] * 20) + "\n"),
    "nested calls of a user function": repeated(
        lambda n: "def g(a):\nend\n" if not n else " x=" + "g(" * 30 + ")" * 30 + "\n"
    ),
    "threads": repeated(lambda n: "thread t():\nend\n" if not n else "run t()\n"),
    "breaks": lambda size: "while True:\n" + "break\n" * (size // 6) + "end\n",
    "an error at the end": lambda size: "x = 1 + 2\n" * (size // 10) + "nothing()\n",
}


def work_of(text: str) -> int:
    """Return the cost of compiling a text: the number of function calls, including built-in functions of Python."""
    calls = 0

    def count(frame: object, event: str, argument: object) -> None:
        nonlocal calls
        calls += event in ("call", "c_call")

    sys.setprofile(count)
    try:
        with contextlib.suppress(ProgramError):
            compile_script(text, FIRMWARE)
    finally:
        sys.setprofile(None)
    return calls


@pytest.mark.slow
@pytest.mark.parametrize("name", GROWING)
def test_compile_time_is_linear(name: str) -> None:
    once, twice = (work_of(GROWING[name](size)) for size in (8_000, 16_000))
    assert twice < 2.2 * once + 100


@pytest.mark.slow
@pytest.mark.parametrize("name", ["parameters", "named arguments", "definitions", "statements"])
def test_longest_programs_compile_quickly(name: str) -> None:
    """The count of calls omits work such as a search in a list: such a program once took 130 s, and now about 0.5 s."""
    begun = time.process_time()
    with contextlib.suppress(ProgramError):
        compile_script(GROWING[name](250_000), FIRMWARE)
    assert time.process_time() - begun < 15.0


@pytest.mark.parametrize("is_on", [True, False])
def test_compiling_keeps_the_garbage_collector_setting(is_on: bool) -> None:
    before = gc.isenabled()
    (gc.enable if is_on else gc.disable)()
    try:
        compile_script("x = 1\n", FIRMWARE)
        assert gc.isenabled() is is_on
        with pytest.raises(ProgramError):
            compile_script("x = nothing()\n", FIRMWARE)
        assert gc.isenabled() is is_on
    finally:
        (gc.enable if before else gc.disable)()


def test_too_many_tokens_do_not_compile() -> None:
    with pytest.raises(ProgramError, match=f"program_too_long:{MAX_TOKENS + 1}:"):
        compile_script("x=1" + "+1" * (MAX_TOKENS // 2), FIRMWARE)


def test_too_many_parameters_do_not_compile() -> None:
    def text(count: int) -> str:
        return f"def f():\n def g({','.join(itertools.islice(names(), count))}):\n end\nend\n"

    compile_script(text(MAX_PARAMETERS), FIRMWARE)
    with pytest.raises(ProgramError, match=r"2:\d+: too_many_parameters:g:"):
        compile_script(text(MAX_PARAMETERS + 1), FIRMWARE)


def error_of(text: str, cycles: int = 300) -> str:
    return run(text, cycles=cycles).notes[-1]


DEEP = 30_000
NESTED = {
    "brackets": "x = " + "(" * DEEP + "1" + ")" * DEEP,
    "lists": "x = " + "[" * DEEP + "]" * DEEP,
    "poses": "x = " + "p[" * 30_000,
    "calls": "x = " + "sin(" * 30_000 + "1" + ")" * 30_000,
    "indices": "x = [1]\ny = x" + "[0]" * 30_000,
    "minus": "x = " + "-" * DEEP + "1",
    "not": "x = " + "not " * 30_000 + "True",
    "sum": "x = 1" + " + 1" * 30_000,
    "or": "x = True" + " or True" * 20_000,
    "loops": "while True:\n" * 10_000 + "pass\n" + "end\n" * 10_000,
    "branches": "if True:\n" * 20_000,
    "functions": "".join(f"def f{i}():\n" for i in range(10_000)),
    "open brackets": "x = " + "(" * DEEP,
}


@pytest.mark.parametrize("name", NESTED)
def test_deep_nesting_does_not_compile(name: str) -> None:
    with pytest.raises(ProgramError, match="nesting_too_deep"):
        compile_script(NESTED[name], FIRMWARE)


@pytest.mark.parametrize(
    "text",
    [
        "x = " + "(" * (MAX_NESTING - 2) + "1" + ")" * (MAX_NESTING - 2),
        "x = 1" + " + 1" * (MAX_NESTING - 1),
        "if True:\n" * (MAX_NESTING // 2) + "x = " + "[0][" * 28 + "0" + "]" * 28 + "\n" + "end\n" * (MAX_NESTING // 2),
        "".join(f"def f{i}():\n" for i in range(MAX_NESTING - 2)) + "x = sin(1)\n" + "end\n" * (MAX_NESTING - 2),
    ],
)
def test_nesting_up_to_the_limit_compiles_and_runs(text: str) -> None:
    assert error_of(text + "\n") == "0 over"


def test_too_long_text_does_not_compile() -> None:
    with pytest.raises(ProgramError, match="program_too_long"):
        compile_script("#" * (MAX_TEXT + 1), FIRMWARE)


def test_long_elif_chain_and_long_list_are_not_nested() -> None:
    chain = "x = 999\nif x == 0:\n  pass\n" + "".join(f"elif x == {i}:\n  textmsg({i})\n" for i in range(1, 1000))
    assert run(chain + "end\n").notes == ["0 textmsg 999", "0 over"]
    assert error_of("x = [" + "1+1," * 2000 + "1]\n") == "0 over"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("while True:\n  pass\nend", ENDLESS),
        ("while True:\n  x = 1 + 1\nend", ENDLESS),
        ("while True:\n  x = get_inverse_kin(p[0.4,0.1,0.3,0,3.1,0])\nend", ENDLESS),
        ("while True:\n  x = pose_trans(p[1,0,0,0,0,1],p[1,0,0,0,0,1])\nend", ENDLESS),
        ("while True:\n  textmsg(x9)\nend\nx9 = 1", "no value"),
        ("while True:\n  textmsg('" + "x" * 9000 + "')\nend", ENDLESS),
        ("while True:\n  x = make_list(9000, 1) == make_list(9000, 1)\nend", ENDLESS),
        ("while True:\n  x = socket_send_string('x')\nend", ENDLESS),
        ("while True:\n  enter_critical\nend", ENDLESS),
        ("while True:\n  popup('x')\nend", ENDLESS),
        ("thread t():\n  while True:\n    pass\n  end\nend\nrun t()\nsleep(9)", ENDLESS),
        (
            "def f():\n  while True:\n    return f()\n  end\nend\nf()",
            f"calls are nested too deeply; the limit is {MAX_CALL_DEPTH}",
        ),
        ("def f(x=f()):\n  return x\nend\nf()", "calls are nested too deeply"),
        ("def f():\n  return g()\nend\ndef g():\n  return f()\nend\nf()", "calls are nested too deeply"),
        ("thread t():\n  sync()\nend\nwhile True:\n  run t()\nend", f"Too many threads: {MAX_THREADS}"),
        ("thread t():\n  run t()\n  run t()\n  sync()\nend\nrun t()\nsleep(9)", "Too many threads"),
        ("thread t():\n  run t()\nend\nrun t()\nsleep(9)", "Too many threads"),
        ("x = [1]\nwhile True:\n  x = [x, x]\nend", "the lists in a list cannot contain lists"),
        ("x = [1]\nx[0] = x\nx[0] = x", "the lists in a list cannot contain lists"),
        ("x = make_list(9000, 1)\ny = [x, x]", f"List too long: {2 * 9000 + 2}"),
        ("x = make_list(10001, 1)", f"expected 0 to {MAX_ELEMENTS}"),
        ("x = [0, 0, 0]\nx[0] = make_list(9000, 1)\nx[1] = make_list(9000, 1)", "List too long"),
        ("x = 'x'\nwhile True:\n  x = str_cat(x, x)\nend", f"String too long: {2**14}"),
        ("x = 'x'\nwhile True:\n  x = str_cat(x, x)\n  sync()\nend", f"String too long: {2**14}"),
        ("x = [make_list(9000, 1)]\ny = to_str(x)", "String too long"),
        ("x = pow(pow(10,10),pow(10,10))", "not a finite number"),
        ("x = 10.0\nwhile True:\n  x = x * x\nend", "overflow"),
        ("x = 10\nwhile True:\n  x = x * x\nend", "Integer overflow"),
        ("x = exp(1e9)", "overflow"),
        ("x = floor(1e300)", "Integer overflow"),
        ("x = to_num('" + "9" * 390 + "')", "Integer overflow|not a number"),
        ("x = 1e308 * 10 - 1e308 * 10", "not a number"),
        ("x = sin(1e308 * 1) / 0", "Division by zero"),
        ("x = 1 % 0", "Division by zero"),
        ("x = integer_to_binary_list(1e300)", "from|integer"),
        ("sleep(-1)", "must not be negative"),
        ("movej([1e308, 0, 0, 0, 0, 0] * 10)", "not a number"),
        ("x = get_forward_kin([0, 0, 0])", "has 3 numbers; expected 6"),
        ("x = get_actual_joint_positions_history(-1)", "expected 0 to"),
        ("h = 3.5\njoin h", "thread handle"),
        ("kill [1]", "thread handle"),
    ],
)
def test_malicious_program_ends_with_a_compile_or_runtime_error(text: str, message: str) -> None:
    last = error_of(text)
    assert last.split()[1] == "error", last
    assert re.search(message, last), last


@pytest.mark.parametrize("text", ["sleep(1e300)", "while True:\n  sleep(0)\nend", "while True:\n  sync()\nend"])
def test_waiting_program_is_stopped_without_an_error(text: str) -> None:
    assert error_of(text, cycles=50) == "50 stopped"


def test_threads_that_join_each_other_can_be_stopped() -> None:
    text = "a = 0\nb = 0\nthread s():\n  join b\nend\nthread t():\n  join a\nend\na = run s()\nb = run t()\njoin a"
    assert error_of(text, cycles=20) == "20 stopped"


def test_ended_threads_no_longer_count() -> None:
    """Threads that have ended no longer count from the next cycle."""
    text = "thread t():\n  x = 1\nend\ni = 0\nwhile i < 1000:\n  h = run t()\n  join h\n  i = i + 1\nend"
    assert error_of(text, cycles=1100) == "1000 over"


@pytest.mark.slow
def test_memory_of_variables_is_bounded() -> None:
    count = MAX_MEMORY // MAX_ELEMENTS + 200
    lines = [f"x{i} = make_list({MAX_ELEMENTS - 1}, 1.5)\nsync()" for i in range(count)]
    assert "Out of memory" in error_of("\n".join(lines), cycles=2 * count)


@pytest.mark.slow
def test_memory_of_call_frames_is_bounded() -> None:
    text = f"def f(n):\n  local x = make_list({MAX_ELEMENTS - 1}, 1.5)\n  sync()\n  f(n)\n  textmsg(x)\nend\nf(1)"
    assert "error" in error_of(text, cycles=1000)
    lines = [f"local x{i} = make_list({MAX_ELEMENTS - 1}, {i})" for i in range(5)]
    more = "\n".join(["thread t():", *lines, "sleep(99)", "end"])
    assert "Out of memory" in error_of(f"{more}\nwhile True:\n  run t()\n  sync()\nend", cycles=1000)


@pytest.mark.slow
def test_peak_memory_of_a_program_stays_small() -> None:
    text = "\n".join(f"x{i} = make_list({MAX_ELEMENTS - 1}, random())\nsync()" for i in range(400))
    script = compile_script(text, FIRMWARE)
    world = NotedWorld()
    tracemalloc.start()
    try:
        execution = Execution(script, world)
        for _ in range(500):
            execution.advance()
            world.cycle += 1
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert execution.error is not None
    assert peak < 100 * 2**20


def test_long_expression_counts_as_many_instructions() -> None:
    wide = " + ".join("(" + " + ".join(["1.0"] * 40) + ")" for _ in range(20))
    world = run(f"n = 0\nwhile n < {MAX_INSTRUCTIONS // 10}:\n  n = n + 1\n  x = {wide}\nend")
    assert ENDLESS in world.notes[-1]


def test_strings_read_from_sockets_are_bounded() -> None:
    world = NotedWorld()
    world.sockets.peers[1] = [b"x" * (5 * MAX_STRING)]
    text = "socket_open('h', 1)\n" + "textmsg(str_len(socket_read_string()))\n" * 2
    assert [note.split()[2] for note in run(text, world).notes if "textmsg" in note] == [str(MAX_STRING)] * 2


def test_failed_program_does_nothing_more() -> None:
    world = NotedWorld()
    execution = Execution(compile_script("x = 1 / 0", FIRMWARE), world)
    execution.advance()
    assert execution.is_over
    assert str(execution.error) == "1:7: Division by zero"
    notes = list(world.notes)
    execution.advance()
    execution.stop()
    assert world.notes == notes

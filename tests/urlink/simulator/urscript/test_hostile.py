"""Programs that mean harm: each ends with an error, and neither time nor memory goes with it."""

from __future__ import annotations

import re
import tracemalloc

import pytest

from tests.urlink.simulator.urscript.standin import StandIn, run
from urlink.firmware import Firmware
from urlink.simulator.urscript import Execution, ScriptError, compile_script
from urlink.simulator.urscript.limits import (
    MAX_CALL_DEPTH,
    MAX_ELEMENTS,
    MAX_INSTRUCTIONS,
    MAX_MEMORY,
    MAX_NESTING,
    MAX_STRING,
    MAX_TEXT,
    MAX_THREADS,
)

FIRMWARE = Firmware(5, 11)
ENDLESS = "The program used too much time without instructing the robot what to do."


def error_of(text: str, cycles: int = 300) -> str:
    return run(text, cycles=cycles).notes[-1]


DEEP = 100_000
NESTED = {
    "brackets": "x = " + "(" * DEEP + "1" + ")" * DEEP,
    "lists": "x = " + "[" * DEEP + "]" * DEEP,
    "poses": "x = " + "p[" * 50_000,
    "calls": "x = " + "sin(" * 50_000 + "1" + ")" * 50_000,
    "indices": "x = [1]\ny = x" + "[0]" * 50_000,
    "minus": "x = " + "-" * DEEP + "1",
    "not": "x = " + "not " * 50_000 + "True",
    "sum": "x = 1" + " + 1" * 50_000,
    "or": "x = True" + " or True" * 20_000,
    "loops": "while True:\n" * 10_000 + "pass\n" + "end\n" * 10_000,
    "branches": "if True:\n" * 20_000,
    "functions": "".join(f"def f{i}():\n" for i in range(10_000)),
    "open brackets": "(" * DEEP,
}


@pytest.mark.parametrize("name", NESTED)
def test_deep_nesting_does_not_compile(name: str) -> None:
    with pytest.raises(ScriptError, match="nesting_too_deep"):
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


def test_a_text_that_is_too_long_does_not_compile() -> None:
    with pytest.raises(ScriptError, match="program_too_long"):
        compile_script("#" * (MAX_TEXT + 1), FIRMWARE)


def test_a_long_elif_chain_and_a_long_list_are_no_nesting() -> None:
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
            f"Too many calls in one another: {MAX_CALL_DEPTH}",
        ),
        ("def f(x=f()):\n  return x\nend\nf()", "Too many calls in one another"),
        ("def f():\n  return g()\nend\ndef g():\n  return f()\nend\nf()", "Too many calls in one another"),
        ("thread t():\n  sync()\nend\nwhile True:\n  run t()\nend", f"Too many threads: {MAX_THREADS}"),
        ("thread t():\n  run t()\n  run t()\n  sync()\nend\nrun t()\nsleep(9)", "Too many threads"),
        ("thread t():\n  run t()\nend\nrun t()\nsleep(9)", "Too many threads"),
        ("x = [1]\nwhile True:\n  x = [x, x]\nend", "the lists in a list cannot hold lists"),
        ("x = [1]\nx[0] = x\nx[0] = x", "the lists in a list cannot hold lists"),
        ("x = make_list(9000, 1)\ny = [x, x]", f"List too long: {2 * 9000 + 2}"),
        ("x = make_list(10001, 1)", f"from 0 to {MAX_ELEMENTS}"),
        ("x = [0, 0, 0]\nx[0] = make_list(9000, 1)\nx[1] = make_list(9000, 1)", "List too long"),
        ("x = 'x'\nwhile True:\n  x = str_cat(x, x)\nend", f"String too long: {2**14}"),
        ("x = 'x'\nwhile True:\n  x = str_cat(x, x)\n  sync()\nend", f"String too long: {2**14}"),
        ("x = [make_list(9000, 1)]\ny = to_str(x)", "String too long"),
        ("x = pow(pow(10,10),pow(10,10))", "no finite number"),
        ("x = 10.0\nwhile True:\n  x = x * x\nend", "overflow"),
        ("x = 10\nwhile True:\n  x = x * x\nend", "Integer overflow"),
        ("x = exp(1e9)", "overflow"),
        ("x = floor(1e300)", "Integer overflow"),
        ("x = to_num('" + "9" * 390 + "')", "Integer overflow|not a number"),
        ("x = 1e308 * 10 - 1e308 * 10", "not a number"),
        ("x = sin(1e308 * 1) / 0", "Division by zero"),
        ("x = 1 % 0", "Division by zero"),
        ("x = integer_to_binary_list(1e300)", "from|integer"),
        ("sleep(-1)", "not negative"),
        ("movej([1e308, 0, 0, 0, 0, 0] * 10)", "not a number"),
        ("x = get_forward_kin([0, 0, 0])", "6 numbers"),
        ("x = get_actual_joint_positions_history(-1)", "from 0"),
        ("h = 3.5\njoin h", "thread handle"),
        ("kill [1]", "thread handle"),
    ],
)
def test_it_ends_with_an_error(text: str, message: str) -> None:
    last = error_of(text)
    assert last.split()[1] == "error", last
    assert re.search(message, last), last


@pytest.mark.parametrize("text", ["sleep(1e300)", "while True:\n  sleep(0)\nend", "while True:\n  sync()\nend"])
def test_waiting_is_no_harm(text: str) -> None:
    assert error_of(text, cycles=50) == "50 stopped"


def test_joining_each_other_waits_for_ever_and_can_be_stopped() -> None:
    text = "a = 0\nb = 0\nthread s():\n  join b\nend\nthread t():\n  join a\nend\na = run s()\nb = run t()\njoin a"
    assert error_of(text, cycles=20) == "20 stopped"


def test_a_million_runs_one_after_the_other() -> None:
    """Those that are over count no longer in the next cycle."""
    text = "thread t():\n  x = 1\nend\ni = 0\nwhile i < 1000:\n  h = run t()\n  join h\n  i = i + 1\nend"
    assert error_of(text, cycles=1100) == "1000 over"


def test_what_all_variables_hold_is_bounded() -> None:
    count = MAX_MEMORY // MAX_ELEMENTS + 200
    lines = [f"x{i} = make_list({MAX_ELEMENTS - 1}, 1.5)\nsync()" for i in range(count)]
    assert "Out of memory" in error_of("\n".join(lines), cycles=2 * count)


def test_what_frames_hold_is_bounded() -> None:
    text = f"def f(n):\n  local x = make_list({MAX_ELEMENTS - 1}, 1.5)\n  sync()\n  f(n)\n  textmsg(x)\nend\nf(1)"
    assert "error" in error_of(text, cycles=1000)
    lines = [f"local x{i} = make_list({MAX_ELEMENTS - 1}, {i})" for i in range(5)]
    more = "\n".join(["thread t():", *lines, "sleep(99)", "end"])
    assert "Out of memory" in error_of(f"{more}\nwhile True:\n  run t()\n  sync()\nend", cycles=1000)


def test_memory_stays_small() -> None:
    text = "\n".join(f"x{i} = make_list({MAX_ELEMENTS - 1}, random())\nsync()" for i in range(400))
    script = compile_script(text, FIRMWARE)
    world = StandIn()
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


def test_a_long_expression_counts_as_more_than_one_instruction() -> None:
    wide = " + ".join("(" + " + ".join(["1.0"] * 40) + ")" for _ in range(20))
    world = run(f"n = 0\nwhile n < {MAX_INSTRUCTIONS // 10}:\n  n = n + 1\n  x = {wide}\nend")
    assert ENDLESS in world.notes[-1]


def test_strings_that_are_read_are_bounded() -> None:
    world = StandIn()
    world.sockets.peers[1] = [b"x" * (5 * MAX_STRING)]
    text = "socket_open('h', 1)\n" + "textmsg(str_len(socket_read_string()))\n" * 2
    assert [note.split()[2] for note in run(text, world).notes if "textmsg" in note] == [str(MAX_STRING)] * 2


def test_the_end_of_all_is_the_end() -> None:
    world = StandIn()
    execution = Execution(compile_script("x = 1 / 0", FIRMWARE), world)
    execution.advance()
    assert execution.is_over
    assert str(execution.error) == "1:7: Division by zero"
    notes = list(world.notes)
    execution.advance()
    execution.stop()
    assert world.notes == notes

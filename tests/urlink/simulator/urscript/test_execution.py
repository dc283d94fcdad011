"""Compilation and execution of programs, as the controller sees them."""

from __future__ import annotations

import pytest

from tests.fakes.world import NotedWorld, run
from urlink.protocol.firmware import NEWEST, Firmware
from urlink.simulator.urscript import Execution, ProgramError, compile_script
from urlink.simulator.urscript.builtins import find

FIRMWARE = Firmware(5, 11)


def start(text: str, world: NotedWorld) -> Execution:
    return Execution(compile_script(text, world.firmware), world)


def test_script_has_its_name_and_kind() -> None:
    program = compile_script("def name():\n  sync()\nend\n", FIRMWARE)
    assert (program.name, program.kind) == ("name", "def")
    secondary = compile_script("sec name():\n  set_digital_out(1, True)\nend", FIRMWARE)
    assert (secondary.name, secondary.kind) == ("name", "sec")
    lines = compile_script("set_digital_out(1, True)", FIRMWARE)
    assert (lines.name, lines.kind) == ("unnamed", "def")
    assert compile_script("", FIRMWARE).name == "unnamed"
    assert compile_script("def f():\r\n  sync()\r\nend\r\n", FIRMWARE).name == "f"


@pytest.mark.parametrize(
    ("text", "line", "column", "message"),
    [
        # The messages come from controllers; the program of the first message is assumed.
        ("def silly()\nend", 2, 1, "syntax_error_on_line:2:end:"),
        ("def f():\n  calldoesntexist()\nend", 2, 3, "compile_error_name_not_found:calldoesntexist:"),
        ("def f():\n    textmsg(1\n    movej([0], a=1)\nend", 3, 5, "syntax_error_on_line:3:    movej([0], a=1):"),
        # The other messages follow this pattern.
        ("x = ", 1, 5, "syntax_error_on_line:1:x =:"),
        ("x = 1 +\n\n\nend", 4, 1, "syntax_error_on_line:4:end:"),
        ("x = 'open", 1, 5, "syntax_error_on_line:1:x = 'open:"),
        ("x = [1, 2", 1, 10, "syntax_error_on_line:1:x = [1, 2:"),
        ("x = p[1, 2]", 1, 5, "syntax_error_on_line:1:x = p[1, 2]:"),
        ("x = 1 2", 1, 7, "syntax_error_on_line:1:x = 1 2:"),
        ("1 = x", 1, 1, "syntax_error_on_line:1:1 = x:"),
        ("f(a=1, 2)", 1, 8, "syntax_error_on_line:1:f(a=1, 2):"),
        ("def f(a, a):\n  pass\nend", 1, 10, "syntax_error_on_line:1:def f(a, a)::"),
        ("def f():\n  pass\n", 3, 1, "syntax_error_on_line:3::"),
        ("end", 1, 1, "syntax_error_on_line:1:end:"),
        ("x = 1e999", 1, 5, "syntax_error_on_line:1:x = 1e999:"),
        ("x = 3 $ 4", 1, 10, "syntax_error_on_line:1:x = 3 $ 4:"),
        ("(x)", 1, 1, "syntax_error_on_line:1:(x):"),
        ("x = 1 ü", 1, 7, "syntax_error_on_line:1:x = 1 ü:"),
        ("a[] = 1", 1, 2, "syntax_error_on_line:1:a[] = 1:"),
        ("f() = 1", 1, 5, "syntax_error_on_line:1:f() = 1:"),
        ("$ 1\nx = 1", 2, 1, "syntax_error_on_line:2:x = 1:"),
        ("digital_out.size = 1", 1, 1, "compile_error_name_not_found:digital_out:"),
        ("break", 1, 1, "not_in_a_loop_on_line:1:"),
        ("def f():\n  pass\nend\nx = run f()", 4, 9, "compile_error_not_a_thread:f:"),
        ("thread f():\n  pass\nend\nf()", 4, 1, "compile_error_not_a_function:f:"),
        ("def f():\n  pass\nend\ndef f():\n  pass\nend\nf()", 1, 5, "compile_error_name_already_used:f:"),
        ("def f(a):\n  sync()\nend", 1, 7, "program_with_parameters:f:"),
        ("sec f():\n  h = run t()\nend", 2, 11, "compile_error_name_not_found:t:"),
        (
            "sec f():\n  thread t():\n    pass\n  end\n  run t()\nend",
            5,
            7,
            "compile_error_not_allowed_in_secondary_program:run:",
        ),
        ("movej([0,0,0,0,0,0], acc=1)", 1, 26, "compile_error_name_not_found:acc:"),
    ],
)
def test_compile_error_has_line_column_and_message(text: str, line: int, column: int, message: str) -> None:
    with pytest.raises(ProgramError) as caught:
        compile_script(text, FIRMWARE)
    assert (caught.value.line, caught.value.column, caught.value.text) == (line, column, message)


def test_stop_ends_the_motion_and_closes_sockets() -> None:
    world = NotedWorld()
    world.sockets.peers[1] = [b""]
    execution = start("socket_open('h', 1)\nmovej([0,0,0,0,0,0])\ntextmsg('never')", world)
    for _ in range(2):
        execution.advance()
        world.cycle += 1
        world.sockets.step()
    has_ended = [execution.is_over]
    execution.stop()
    has_ended.append(execution.is_over)
    assert has_ended == [False, True]
    assert execution.error is None
    assert world.notes[-2:] == ["2 release", "2 close socket_0"]


def test_secondary_program_closes_only_its_sockets() -> None:
    world = NotedWorld()
    world.sockets.peers[1] = [b""]
    world.sockets.open("socket_0", "h", 1)
    run("sec f():\n  set_standard_digital_out(1, True)\nend", world)
    assert world.notes == ["0 open socket_0 h:1", "0 close socket_0", "0 digital outputs 0x2", "0 over"]


def test_socket_open_times_out() -> None:
    world = NotedWorld("3.4")
    assert run("textmsg(socket_open('h', 0))", world, cycles=1000).notes == [
        "0 open socket_0 h:0",
        "250 close socket_0",
        "250 textmsg False",
        "250 over",
    ]


def test_peer_that_sends_endlessly_does_not_end_the_program() -> None:
    """Reading from the peer takes time, so the loop is not an endless loop that takes no time."""
    world = NotedWorld()
    world.sockets.peers[1] = [b"x" * 100_000]
    text = """
thread reader():
  while True:
    got = socket_read_byte_list(1)
    n = n + 1
  end
end
n = 0
socket_open("h", 1)
h = run reader()
sleep(0.2)
textmsg(n)
"""
    notes = run(text, world).notes
    assert notes[-1] == "101 over"
    assert int(notes[-3].removeprefix("101 textmsg ")) == 2000


def test_blocking_popup_waits_until_it_is_closed() -> None:
    world = NotedWorld()
    execution = start("popup('x', blocking=True)\ntextmsg('on')", world)
    for _ in range(5):
        execution.advance()
    assert len(world.notes) == 1
    world.has_popup = False
    execution.advance()
    assert world.notes[1:] == ["0 textmsg on"]
    assert execution.is_over


def test_random_numbers_are_the_same_in_every_run() -> None:
    text = "textmsg([random(), random()])"
    assert run(text).notes == run(text).notes


#: Functions that the programs of three drivers call.
DRIVERS = """
direct_torque enable_external_ft_sensor end_force_mode end_freedrive_mode end_teach_mode force_mode
force_mode_set_damping force_mode_set_gain_scaling freedrive_mode ft_rtde_input_enable get_actual_joint_positions
get_actual_joint_positions_history get_actual_tcp_pose get_actual_tcp_speed get_actual_tool_flange_pose
get_forward_kin get_inverse_kin get_joint_positions get_joint_torques get_list_length get_steptime
get_target_joint_positions get_target_joint_speeds is_steady is_within_safety_limits movec movej movel movep norm
optimovej optimovel popup pose_sub pose_trans pow read_input_float_register read_input_integer_register
rtde_set_watchdog servoc servoj set_gravity set_payload set_target_payload set_tcp set_tool_voltage sleep socket_close
socket_open socket_read_ascii_float socket_read_binary_integer socket_send_byte socket_send_int socket_send_string
speedj speedl stopj stopl str_cat sync teach_mode textmsg to_str tool_contact write_output_float_register
write_output_integer_register zero_ftsensor
"""


@pytest.mark.parametrize("name", DRIVERS.split())
def test_every_function_of_common_drivers_is_known(name: str) -> None:
    assert find(name, NEWEST) is not None


@pytest.mark.parametrize(
    ("name", "firmware", "known"),
    [
        ("set_digital_out", "1.8", True),
        ("set_standard_digital_out", "1.8", False),
        ("set_configurable_digital_out", "1.8", False),
        ("set_tool_digital_out", "1.8", False),
        ("set_standard_digital_out", "3.4", True),
        ("set_target_payload", "5.9", False),
        ("set_target_payload", "5.10", True),
        ("get_inverse_kin_has_solution", "5.8", False),
        ("servoj", "1.8", True),
        ("tool_contact", "3.15", False),
        ("freedrive_mode", "3.15", True),
        ("get_freedrive_status", "5.9", False),
        ("optimovej", "5.21", False),
        ("direct_torque", "5.11", False),
        ("direct_torque", "5.23", True),
    ],
)
def test_known_functions_depend_on_the_firmware(name: str, firmware: str, known: bool) -> None:
    assert (find(name, Firmware.parse(firmware)) is not None) is known


#: A function that only computes a value, which is inlined into expressions, and the same function with an assignment,
#: which is called by an instruction.
LEAF = """\
def within(aim, here, way):
  if aim > here + way:
    return here + way
  elif aim < here - way:
    return here - way
  end
  return aim * gain
end
"""
CALLED = LEAF.replace("  if aim", "  kept = aim\n  if aim", 1)
NOTHING = 'def nothing(a):\n  if a == 1:\n    return "one"\n  end\nend\n'


@pytest.mark.parametrize("text", [LEAF, CALLED], ids=["leaf", "called"])
@pytest.mark.parametrize(
    ("statements", "said"),
    [
        ("textmsg([within(5, 1, 2), within(-5, 1, 2), within(1.5, 1, 2)])", "[3,-1,3]"),
        ("textmsg(within(within(9, 1, 2), within(0, 1, 2), within(1, 1, 2)) + 1)", "3"),
        ("textmsg(within(way=1, here=2, aim=9))", "3"),
        ("gain = 3\ntextmsg(within(1, 1, 2))", "3"),
        ("thread t():\n  textmsg(within(1, 0, 1) == 2)\nend\njoin run t()", "True"),
    ],
)
def test_inlined_function_equals_a_called_function(text: str, statements: str, said: str) -> None:
    assert run(f"gain = 2\n{text}{statements}\n").notes[0].endswith(f" textmsg {said}")


@pytest.mark.parametrize("text", [LEAF, CALLED], ids=["leaf", "called"])
@pytest.mark.parametrize(
    ("statement", "place"),
    [
        ("x = within(True, 1, 2)", "aim > here"),
        ('x = within(1, "a", 2)', "here + way"),
        ("x = within(1, 2)", "within(1, 2)"),
        ("x = within(1, 2, 3) + within(1, [1], 2)", "aim > here"),
    ],
)
def test_error_in_an_inlined_function_has_its_line(text: str, statement: str, place: str) -> None:
    program = f"gain = 2\n{text}{statement}\n"
    execution = start(program, NotedWorld())
    execution.advance()
    assert execution.error is not None
    line = program.splitlines()[execution.error.line - 1]
    assert place in line


def test_function_without_return_value_cannot_be_used_in_a_list() -> None:
    assert run(f"{NOTHING}textmsg(nothing(1))\n").notes[0].endswith("textmsg one")
    execution = start(f"{NOTHING}x = [nothing(2)]\n", NotedWorld())
    execution.advance()
    assert execution.error is not None
    assert "a list cannot contain none" in str(execution.error)


@pytest.mark.parametrize(
    ("statement", "error"),
    [
        ("textmsg(numbers[-1])", "Index out of range: -1 of 2"),
        ("numbers[-1] = 0", "Index out of range: -1 of 2"),
        ("at = -1\ntextmsg(numbers[at])", "Index out of range: -1 of 2"),
        ('textmsg(box["size"])', "a value of type struct has no elements"),
        ('box["size"] = 1', "a value of type struct has no elements"),
        ('key = "size"\nbox[key] = 1', "a value of type struct has no elements"),
        ('boxes = [box]\nboxes[0]["size"] = 1', "a value of type struct has no elements"),
    ],
)
@pytest.mark.parametrize(
    "where", ["{}", "def f():\n  local numbers = [1, 2]\n  local box = struct(size=1)\n  {}\nend\nf()"]
)
def test_invalid_index_is_an_error(where: str, statement: str, error: str) -> None:
    text = where.format(statement.replace("\n", "\n  ") if "def" in where else statement)
    text = f"numbers = [1, 2]\nbox = struct(size=1)\n{text}\n"
    execution = start(text, NotedWorld())
    execution.advance()
    assert error in str(execution.error)

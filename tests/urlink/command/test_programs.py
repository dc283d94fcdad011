"""Progress of a program as the controller reports it; the test plays the controller."""

from __future__ import annotations

import re
import threading
from collections.abc import Iterator
from contextlib import nullcontext, suppress
from pathlib import Path
from typing import Any

import pytest

import urlink
from linkcore.errors import BadValue, Cancelled, Closed, ConnectionLost, LinkTimeout
from linkcore.handle import Handle, Phase
from linkcore.streaming.connection import Connection
from linkcore.streaming.connection_life import ConnectionState
from tests.fakes.controller import ScriptedController
from tests.waiting import until
from urlink.command import programs as module
from urlink.command.scripts import Program
from urlink.errors import CompileError, NotRunning, ProgramStopped, SafetyStop, ScriptFailed
from urlink.protocol.enums import RobotMode, SafetyMode
from urlink.script.wrapping import StartPlace

pytestmark = pytest.mark.simulated_time


@pytest.fixture
def robot() -> Iterator[ScriptedController]:
    before = set(threading.enumerate())
    with ScriptedController() as robot:
        robot.clear()
        yield robot
    until(lambda: set(threading.enumerate()) <= before)


def run(robot: ScriptedController, source: str = "movej(q)") -> Program:
    robot.clear()  # states older than a second permit nothing
    return robot.script.run(source)


def uploaded(robot: ScriptedController) -> list[str]:
    """Sent texts, except start permissions."""
    return [text for text in robot.sent if "urlink_permission" not in text]


def ends(robot: ScriptedController, program: Handle) -> None:
    """Send states until the program has ended."""

    def is_over() -> bool:
        robot.state(fast=False)
        return program.done

    until(is_over)


def test_text_is_received_once_when_two_threads_subscribe(
    robot: ScriptedController, monkeypatch: pytest.MonkeyPatch
) -> None:
    subscribe = Connection.subscribe_inline

    def beside(*arguments: Any, **options: Any) -> Any:
        monkeypatch.setattr(Connection, "subscribe_inline", subscribe)
        robot.script.run("sec other():\n  set_flag(1, True)\nend")  # as another thread would
        return subscribe(*arguments, **options)

    texts: list[str] = []
    robot.clear()
    monkeypatch.setattr(Connection, "subscribe_inline", beside)
    program = robot.script.run("movej(q)", on_text=texts.append)
    robot.begins(program)
    robot.text("sent once")
    until(lambda: texts)
    assert list(program.texts) == ["sent once"]
    assert texts == ["sent once"]
    program.cancel()


def test_stop_received_with_start_marker_prevents_permission(monkeypatch: pytest.MonkeyPatch) -> None:
    """All packets arrive in one piece, as after a cable was unplugged. The stop is processed before the permission."""
    with ScriptedController() as robot:
        robot.state()
        program = robot.script.run("movej(q)")
        piece: list[bytes] = []
        with monkeypatch.context() as held:
            held.setattr(robot.slow, "put", piece.append)
            robot.state(safety=SafetyMode.PROTECTIVE_STOP, fast=False)
            robot.state(fast=False)
            robot.begins(program)
        robot.slow.put(b"".join(piece))
        with pytest.raises(SafetyStop):
            program.wait(5)
        assert robot.sent == uploaded(robot)


def test_program_is_sent_runs_and_finishes(robot: ScriptedController) -> None:
    program = run(robot, "def job():\n  textmsg(1)\nend")
    assert program.phase is Phase.SENT
    assert program.name.startswith("job_")
    (token,) = re.findall(r"and not \(read_output_integer_register\(47\) == (\d+)\):", robot.sent[0])
    assert robot.sent == [
        f"def {program.name}():\n"
        "  write_output_integer_register(47, 0)\n"
        f'  textmsg("{program.name} started")\n'
        "  urlink_cycles = 0\n"
        f"  while urlink_cycles < 2500 and not (read_output_integer_register(47) == {token}):\n"
        "    urlink_cycles = urlink_cycles + 1\n"
        "    if not (read_output_integer_register(47) == 0):\n"
        "      write_output_integer_register(47, 0)\n"
        f'      textmsg("{program.name} started")\n'
        "    end\n"
        "    sync()\n"
        "  end\n"
        f"  if not (read_output_integer_register(47) == {token}):\n"
        f'    textmsg("{program.name} was not permitted to go on")\n'
        "    halt\n"
        "  end\n"
        "  def job():\n"
        "    textmsg(1)\n"
        "  end\n"
        "  job()\n"
        f'  textmsg("{program.name} finished")\n'
        "end\n"
    ]
    robot.begins(program)
    until(lambda: program.phase is Phase.RUNNING)
    robot.text("half way")
    robot.comes_to_its_end(program)
    program.wait(5)
    assert (program.phase, program.error, program.texts) == (Phase.DONE, None, ("half way",))
    program.cancel()  # without effect
    assert len(uploaded(robot)) == 1


def test_finish_marker_alone_does_not_end_a_program(robot: ScriptedController) -> None:
    """The next program must not race the previous one."""
    program = run(robot)
    robot.begins(program)
    robot.text(f"{program.name} finished")
    robot.text("heard")
    until(lambda: program.texts == ("heard",))
    assert not program.done
    robot.is_stopped(program)
    program.wait(5)


def test_stop_by_another_client_raises_program_stopped(robot: ScriptedController) -> None:
    program = run(robot)
    robot.begins(program)
    robot.is_stopped(program)
    ends(robot, program)
    with pytest.raises(ProgramStopped, match="was stopped early by another client or a person"):
        program.wait(5)
    assert program.phase is Phase.FAILED


def test_cancel_sends_stop(robot: ScriptedController) -> None:
    program = run(robot)
    robot.begins(program)
    robot.clear()
    program.cancel()
    assert "stopj(2.0)" in robot.sent[-1]
    assert robot.sent[-1].startswith("def urlink_stop_")
    with pytest.raises(Cancelled, match=f"{program.name} was cancelled"):
        program.wait(5)
    assert program.phase is Phase.CANCELLED


@pytest.mark.parametrize("is_told", [True, False])
def test_next_program_preempts_previous(robot: ScriptedController, is_told: bool) -> None:
    one = run(robot)
    robot.begins(one)
    two = run(robot)
    if is_told:
        robot.is_stopped(one)
    robot.begins(two)
    with pytest.raises(Cancelled, match=f"{one.name} was preempted by {two.name}"):
        one.wait(5)
    until(lambda: two.phase is Phase.RUNNING)


def test_cancelled_program_still_preempts_when_it_begins(robot: ScriptedController) -> None:
    one = run(robot)
    robot.begins(one)
    two = run(robot)
    robot.clear()
    two.cancel()
    robot.key("PROGRAM_XXX_STARTED", two.name)
    with pytest.raises(Cancelled, match=f"preempted by {two.name}"):
        one.wait(5)


def test_program_of_another_client_replaces_program(robot: ScriptedController) -> None:
    program = run(robot)
    robot.begins(program)
    robot.key("PROGRAM_XXX_STARTED", "their_program")
    with pytest.raises(ProgramStopped, match="their_program"):
        program.wait(5)


def test_end_of_other_program_does_not_end_this_program(robot: ScriptedController) -> None:
    program = run(robot)
    robot.key("PROGRAM_XXX_STARTED", "their_program")
    robot.key("PROGRAM_XXX_STOPPED", "their_program")
    robot.begins(program)
    robot.key("PROGRAM_XXX_STOPPED", "their_program")
    robot.comes_to_its_end(program)
    program.wait(5)


@pytest.mark.parametrize(
    ("line", "column", "text", "place", "words"),
    [
        (19, 5, "compile_error_name_not_found:txtmsg:", (3, 3), "compile_error_name_not_found:txtmsg:"),
        (18, 1, "syntax_error_on_line:18:end:", (2, 1), "syntax_error_on_line:2:end:"),
        (1, 1, "compile_error", (1, 1), "compile_error"),
        (99, 1, "compile_error", (4, 1), "compile_error"),
    ],
)
def test_compile_error_has_line_and_column_of_source(
    robot: ScriptedController, line: int, column: int, text: str, place: tuple[int, int], words: str
) -> None:
    program = run(robot, "def job():\n  a = 1\n  txtmsg(1)\nend")
    robot.exception(line, column, text)
    with pytest.raises(CompileError) as caught:
        program.wait(5)
    assert (caught.value.line, caught.value.column, caught.value.text) == (*place, words)
    assert program.phase is Phase.FAILED


def test_runtime_error_raises_script_failed(robot: ScriptedController) -> None:
    program = run(robot, "a = 1\nb = a / 0")
    robot.begins(program)
    robot.exception(18, 7, "division by zero")
    until(lambda: program.phase is Phase.RUNNING)
    assert not program.done
    robot.is_stopped(program)
    with pytest.raises(ScriptFailed, match="line 2, column 5: division by zero"):
        program.wait(5)


def test_compile_error_does_not_fail_running_program(robot: ScriptedController) -> None:
    program = run(robot)
    robot.begins(program)
    robot.exception(2, 1, "syntax_error_on_line:2:end:")
    robot.comes_to_its_end(program)
    program.wait(5)


def test_program_ends_by_markers_and_flag_without_key_messages(robot: ScriptedController) -> None:
    """Only the program's own markers and the flag in the state report its progress, as possibly on CB2."""
    program = run(robot)
    robot.state(runs=False)
    robot.text(f"{program.name} started")
    robot.state(runs=False)  # this state might be older than the beginning
    until(lambda: program.phase is Phase.RUNNING)
    robot.state(runs=True)
    robot.text(f"{program.name} finished")
    robot.state(runs=True)
    robot.state(runs=False)
    program.wait(5)
    stopped = run(robot)
    robot.text(f"{stopped.name} started")
    robot.state(runs=True)
    robot.state(runs=False)
    ends(robot, stopped)
    with pytest.raises(ProgramStopped):
        stopped.wait(5)


def test_program_that_ended_between_two_states_is_detected(
    robot: ScriptedController, monkeypatch: pytest.MonkeyPatch
) -> None:
    program = run(robot)
    robot.text(f"{program.name} started")
    until(lambda: program.phase is Phase.RUNNING)
    robot.state(runs=False)
    robot.text("heard")
    until(lambda: program.texts == ("heard",))
    assert not program.done
    monkeypatch.setattr(module, "_FLAG_LAG", 0.0)
    ends(robot, program)
    with pytest.raises(ProgramStopped):
        program.wait(5)


def test_program_that_never_begins_raises_timeout() -> None:
    with ScriptedController(start_timeout=0.05) as robot:
        program = run(robot)

        def is_notified() -> bool:
            robot.state(RobotMode.IDLE)
            return program.done

        until(is_notified)
        with pytest.raises(
            LinkTimeout, match=r"did not begin within 0\.05 s.* robot mode is IDLE, no program is running"
        ):
            program.wait(5)


@pytest.mark.parametrize(
    ("firmware", "flags", "grant", "is_refused"),
    [
        ("3.4", (7,), r"set_flag\(7, True\)", True),
        ("3.4", (), None, False),
        ("5.11", (7,), r"write_output_integer_register\(40, \d+\)", False),
    ],
)
def test_permission_uses_register_or_flag(
    firmware: str, flags: tuple[int, ...], grant: str | None, is_refused: bool
) -> None:
    with ScriptedController(firmware, start_place=StartPlace(40, flags)) as robot:
        program = run(robot)
        robot.begins(program)
        robot.text("heard")
        until(lambda: program.texts == ("heard",))
        permission = "" if grant is None else rf"sec urlink_permission\(\):\n  {grant}\nend\n"
        assert re.fullmatch(permission, "".join(robot.sent[1:]))
        with (
            pytest.raises(BadValue, match=r"flag 7 is reserved for start permissions") if is_refused else nullcontext()
        ):
            robot.io.set_flag(7, True)


def test_program_fails_when_permission_cannot_be_sent(robot: ScriptedController) -> None:
    program = run(robot)
    robot.slow.make_room(0)
    robot.begins(program)
    with pytest.raises(LinkTimeout, match="did not accept a text"):
        program.wait(5)


def test_lost_connection_fails_program(robot: ScriptedController) -> None:
    program = run(robot)
    robot.begins(program)
    robot.slow.put(ConnectionLost("pulled"))
    with pytest.raises(ConnectionLost, match="might still run: pulled"):
        program.wait(5)
    robot.clear()
    again = run(robot)
    robot.begins(again)
    robot.comes_to_its_end(again)
    again.wait(5)


@pytest.mark.parametrize("is_told_first", [True, False])
def test_emergency_stop_fails_program(robot: ScriptedController, is_told_first: bool) -> None:
    program = run(robot)
    robot.begins(program)
    if is_told_first:
        robot.state(safety=SafetyMode.ROBOT_EMERGENCY_STOP)
        robot.is_stopped(program)
    else:
        robot.is_stopped(program)
        robot.state(safety=SafetyMode.ROBOT_EMERGENCY_STOP)
    with pytest.raises(SafetyStop) as caught:
        program.wait(5)
    assert caught.value.cause == "robot emergency stop"
    program.cancel()


def test_program_sent_before_stop_does_not_begin_after_stop(robot: ScriptedController) -> None:
    program = run(robot)
    robot.state(safety=SafetyMode.PROTECTIVE_STOP)
    until(lambda: robot.safety.cause is not None)
    robot.clear()
    robot.begins(program)
    with pytest.raises(SafetyStop, match="protective stop"):
        program.wait(5)
    assert len(robot.sent) == 1  # the program asks, but gets no permission


def test_cancel_during_protective_stop_sends_nothing(robot: ScriptedController) -> None:
    program = run(robot)
    robot.begins(program)
    until(lambda: len(robot.sent) == 2)  # the program has got its permission
    robot.state(safety=SafetyMode.PROTECTIVE_STOP, runs=True)
    until(lambda: robot.safety.cause is not None)
    program.cancel()
    assert len(uploaded(robot)) == 1
    assert program.phase is Phase.CANCELLED


def test_interlock_refuses_script_and_line(robot: ScriptedController) -> None:
    robot.state(RobotMode.POWER_OFF)
    until(lambda: robot.safety.robot_mode is RobotMode.POWER_OFF)
    with pytest.raises(NotRunning, match="POWER_OFF"):
        robot.script.run("movej(q)")
    with pytest.raises(NotRunning, match="POWER_OFF"):
        robot.script.send_line("movej(q)")
    assert robot.sent == []


@pytest.mark.parametrize("is_refused", [True, False])
def test_refused_run_leaves_nothing_when_connection_is_lost(
    robot: ScriptedController, is_refused: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A program that was never sent is not lost: the error is the refusal, even if the connection fails just then."""
    monkeypatch.setattr("urlink.command.safety_monitor._NEXT_REPORT", 0.0)
    robot.clear()
    if is_refused:
        robot.state(safety=SafetyMode.PROTECTIVE_STOP)
        until(lambda: robot.safety.cause)
    programs: list[Handle] = []
    for _ in range(20):
        robot.slow.put(ConnectionLost("pulled"))
        for _ in range(20):
            with suppress(SafetyStop, NotRunning, ConnectionLost):
                programs.append(robot.script.run("movej(q)"))
        robot.state(safety=SafetyMode.PROTECTIVE_STOP if is_refused else SafetyMode.NORMAL)
        until(lambda: robot.primary.connection is ConnectionState.CONNECTED)
    assert bool(programs) is not is_refused
    until(lambda: all(program.done for program in programs))


def test_secondary_program_does_not_end_main_program(robot: ScriptedController) -> None:
    program = run(robot)
    robot.begins(program)
    robot.clear()
    beside = robot.script.run("sec blink():\n  set_standard_digital_out(0, True)\nend")
    assert robot.sent[-1] == (
        f"sec {beside.name}():\n"
        f'  textmsg("{beside.name} started")\n'
        "  set_standard_digital_out(0, True)\n"
        f'  textmsg("{beside.name} finished")\n'
        "end\n"
    )
    robot.text(f"{beside.name} started")
    robot.text(f"{beside.name} finished")
    beside.wait(5)
    wrong = robot.script.run("sec blink():\n  set_standard(0, True)\nend")
    robot.exception(3, 3, "compile_error_name_not_found:set_standard:")
    with pytest.raises(CompileError, match="line 2, column 3"):
        wrong.wait(5)
    assert program.phase is Phase.RUNNING
    robot.comes_to_its_end(program)
    program.wait(5)


def test_on_text_gets_each_line(robot: ScriptedController) -> None:
    heard: list[str] = []
    robot.clear()
    program = robot.script.run("textmsg(1)", on_text=heard.append)
    robot.begins(program)
    robot.text("1")
    robot.text("2\x1b[2J")
    robot.comes_to_its_end(program)
    program.wait(5)
    until(lambda: heard == ["1", "2\x1b[2J"])
    with pytest.raises(BadValue, match="on_text=3"):
        robot.script.run("textmsg(1)", on_text=3)  # type: ignore[arg-type]


def test_texts_keep_last_thousand_lines(robot: ScriptedController) -> None:
    program = run(robot)
    robot.begins(program)
    for number in range(1003):
        robot.text(str(number))
    until(lambda: program.texts[-1:] == ("1002",))
    assert program.texts == tuple(map(str, range(3, 1003)))


def test_texts_before_the_beginning_are_ignored(robot: ScriptedController) -> None:
    heard: list[str] = []
    robot.clear()
    program = robot.script.run("textmsg(1)", on_text=heard.append)
    robot.text("0")
    robot.begins(program)
    robot.text("1")
    robot.comes_to_its_end(program)
    program.wait(5)
    until(lambda: heard)
    assert heard == ["1"]


def test_texts_of_a_secondary_program_stay_empty(robot: ScriptedController) -> None:
    heard: list[str] = []
    robot.clear()
    program = robot.script.run("sec blink():\n  textmsg(1)\nend", on_text=heard.append)
    robot.begins(program)
    robot.text("1")
    robot.comes_to_its_end(program)
    program.wait(5)
    assert program.texts == ()


def test_text_callback_can_wait_for_program(robot: ScriptedController) -> None:
    robot.clear()
    ended = threading.Event()

    def wait(text: str) -> None:
        program.wait(10)
        ended.set()

    program = robot.script.run("textmsg(1)", on_text=wait)
    robot.begins(program)
    robot.text("1")
    robot.comes_to_its_end(program)
    assert ended.wait(10)


def test_logged_controller_error_has_no_escape_sequences(
    robot: ScriptedController, caplog: pytest.LogCaptureFixture
) -> None:
    robot.clear()
    robot.script.send_line("movej(q)")
    program = run(robot)
    robot.begins(program)
    robot.exception(1, 1, "compile_error\x1b[2J")
    until(lambda: "the controller reports" in caplog.text)
    assert "\x1b" not in caplog.text


def test_run_reads_script_from_file(robot: ScriptedController, tmp_path: Path) -> None:
    robot.clear()
    path = tmp_path / "job.script"
    path.write_text("def job():\n  textmsg(1)\nend\n")
    assert robot.script.run(path).name.startswith("job_")
    with pytest.raises(BadValue, match=r"cannot read .*none\.script"):
        robot.script.run(tmp_path / "none.script")
    path.write_bytes(b"\xff")
    with pytest.raises(BadValue, match=r"job\.script is not a text file"):
        robot.script.run(path)
    with pytest.raises(BadValue, match="is of type int; expected a string"):
        robot.script.run(3)  # type: ignore[arg-type]


def test_wait_raises_timeout(robot: ScriptedController) -> None:
    program = run(robot)
    with pytest.raises(LinkTimeout, match=r"has not ended within 0\.01 s, and continues; its phase is sent"):
        program.wait(0.01)
    assert not program.done
    robot.clear()
    with pytest.raises(urlink.LinkTimeout):
        robot.script.run("movej(q)", wait=0.01)
    with pytest.raises(BadValue, match="wait"):
        robot.script.run("movej(q)", wait=-1.0)


def test_send_line_sends_one_valid_line(robot: ScriptedController) -> None:
    robot.clear()
    robot.script.send_line("set speed 0.5")
    assert robot.sent == ["set speed 0.5\n"]
    for line in ("", "a\nb", "a\0b", 5):
        with pytest.raises(BadValue):
            robot.script.send_line(line)  # type: ignore[arg-type]
    assert len(robot.sent) == 1


def test_close_ends_each_handle(robot: ScriptedController) -> None:
    program = run(robot)
    robot.programs.close(0.0)
    with pytest.raises(Cancelled, match=r"was cancelled, since the robot was closed"):
        program.wait(5)
    with pytest.raises(Closed):
        robot.script.run("movej(q)")

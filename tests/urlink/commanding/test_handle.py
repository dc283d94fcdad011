"""What becomes of a program, by what the controller says; the controller is the test."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import pytest

import urlink
from linkcore.errors import BadValue, ConnectionLost, LinkTimeout
from tests.urlink.stand_in import StandIn
from tests.waiting import until
from urlink.commanding import programs as module
from urlink.commanding.handle import Phase, Program
from urlink.errors import CompileError, NotRunning, ProgramStopped, SafetyStop, ScriptFailed
from urlink.interfaces.enums import RobotMode, SafetyMode


@pytest.fixture
def robot() -> Iterator[StandIn]:
    before = set(threading.enumerate())
    with StandIn() as robot:
        robot.clear()
        yield robot
    until(lambda: set(threading.enumerate()) <= before)


def run(robot: StandIn, source: str = "movej(q)") -> Program:
    robot.clear()  # what is older than a second counts for nothing
    return robot.script.run(source)


def test_sent_running_finished(robot: StandIn) -> None:
    program = run(robot, "def job():\n  textmsg(1)\nend")
    assert program.phase is Phase.SENT
    assert program.name.startswith("job_")
    assert robot.sent == [
        f"def {program.name}():\n"
        f'  textmsg("{program.name} started")\n'
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
    program.stop()  # without effect
    assert len(robot.sent) == 1


def test_its_last_word_is_not_its_end(robot: StandIn) -> None:
    """A program that follows at once must not race the old one."""
    program = run(robot)
    robot.begins(program)
    robot.text(f"{program.name} finished")
    robot.text("heard")
    until(lambda: program.texts == ("heard",))
    assert not program.done
    robot.is_stopped(program)
    program.wait(5)


def test_stopped_from_elsewhere(robot: StandIn) -> None:
    program = run(robot)
    robot.begins(program)
    robot.is_stopped(program)
    with pytest.raises(ProgramStopped, match="before its end"):
        program.wait(5)
    assert program.phase is Phase.FAILED


def test_stopped_on_purpose(robot: StandIn) -> None:
    program = run(robot)
    robot.begins(program)
    robot.clear()
    program.stop()
    assert "stopj(2.0)" in robot.sent[-1]
    assert robot.sent[-1].startswith("def urlink_stop_")
    robot.is_stopped(program)
    with pytest.raises(ProgramStopped, match="as asked"):
        program.wait(5)


@pytest.mark.parametrize("is_told", [True, False])
def test_replaced_by_the_next(robot: StandIn, is_told: bool) -> None:
    one = run(robot)
    robot.begins(one)
    two = run(robot)
    if is_told:
        robot.is_stopped(one)
    robot.begins(two)
    with pytest.raises(ProgramStopped, match=r"replaced by|by the next one"):
        one.wait(5)
    until(lambda: two.phase is Phase.RUNNING)


def test_replaced_by_somebody_else(robot: StandIn) -> None:
    program = run(robot)
    robot.begins(program)
    robot.key("PROGRAM_XXX_STARTED", "their_program")
    with pytest.raises(ProgramStopped, match="their_program"):
        program.wait(5)


def test_somebody_elses_end_is_not_ours(robot: StandIn) -> None:
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
        (5, 5, "compile_error_name_not_found:txtmsg:", (3, 3), "compile_error_name_not_found:txtmsg:"),
        (4, 1, "syntax_error_on_line:4:end:", (2, 1), "syntax_error_on_line:2:end:"),
        (1, 1, "compile_error", (1, 1), "compile_error"),
        (99, 1, "compile_error", (4, 1), "compile_error"),
    ],
)
def test_does_not_compile(
    robot: StandIn, line: int, column: int, text: str, place: tuple[int, int], words: str
) -> None:
    program = run(robot, "def job():\n  a = 1\n  txtmsg(1)\nend")
    robot.exception(line, column, text)
    with pytest.raises(CompileError) as caught:
        program.wait(5)
    assert (caught.value.line, caught.value.column, caught.value.text) == (*place, words)
    assert program.phase is Phase.FAILED


def test_fails_while_it_runs(robot: StandIn) -> None:
    program = run(robot, "a = 1\nb = a / 0")
    robot.begins(program)
    robot.exception(4, 7, "division by zero")
    until(lambda: program.phase is Phase.RUNNING)
    assert not program.done
    robot.is_stopped(program)
    with pytest.raises(ScriptFailed, match="line 2, column 5: division by zero"):
        program.wait(5)


def test_a_compile_error_does_not_fail_the_program_that_runs(robot: StandIn) -> None:
    program = run(robot)
    robot.begins(program)
    robot.exception(2, 1, "syntax_error_on_line:2:end:")
    robot.comes_to_its_end(program)
    program.wait(5)


def test_without_key_messages(robot: StandIn) -> None:
    """As it may be on CB2: the program's own words and the flag in the state have to do."""
    program = run(robot)
    robot.state(runs=False)
    robot.text(f"{program.name} started")
    robot.state(runs=False)  # older than the beginning, for all we know
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
    with pytest.raises(ProgramStopped):
        stopped.wait(5)


def test_without_key_messages_and_over_between_two_states(robot: StandIn, monkeypatch: pytest.MonkeyPatch) -> None:
    program = run(robot)
    robot.text(f"{program.name} started")
    until(lambda: program.phase is Phase.RUNNING)
    robot.state(runs=False)
    robot.text("heard")
    until(lambda: program.texts == ("heard",))
    assert not program.done
    monkeypatch.setattr(module, "_FLAG_LAG", 0.0)
    robot.state(runs=False)
    with pytest.raises(ProgramStopped):
        program.wait(5)


def test_never_begins(robot: StandIn, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "START_TIMEOUT", 0.05)
    program = run(robot)

    def told() -> bool:
        robot.state(RobotMode.IDLE)
        return program.done

    until(told)
    with pytest.raises(LinkTimeout, match=r"has not begun within .* robot mode is IDLE, no program runs"):
        program.wait(5)


def test_connection_lost(robot: StandIn) -> None:
    program = run(robot)
    robot.begins(program)
    robot.slow.put(ConnectionLost("pulled"))
    with pytest.raises(ConnectionLost, match="may still run: pulled"):
        program.wait(5)
    again = run(robot)
    robot.begins(again)
    robot.comes_to_its_end(again)
    again.wait(5)


@pytest.mark.parametrize("is_told_first", [True, False])
def test_ended_by_a_stop(robot: StandIn, is_told_first: bool) -> None:
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
    program.stop()


def test_stopping_under_a_stop_sends_nothing(robot: StandIn) -> None:
    program = run(robot)
    robot.begins(program)
    robot.state(safety=SafetyMode.PROTECTIVE_STOP)
    until(lambda: robot.safety.cause is not None)
    program.stop()
    assert len(robot.sent) == 1


def test_refused_by_the_gate(robot: StandIn) -> None:
    robot.state(RobotMode.POWER_OFF)
    until(lambda: robot.safety.robot_mode is RobotMode.POWER_OFF)
    with pytest.raises(NotRunning, match="POWER_OFF"):
        robot.script.run("movej(q)")
    with pytest.raises(NotRunning, match="POWER_OFF"):
        robot.script.send_line("movej(q)")
    assert robot.sent == []


def test_secondary_runs_beside(robot: StandIn) -> None:
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


def test_start_tells_each_text(robot: StandIn) -> None:
    heard: list[str] = []
    robot.clear()
    program = robot.script.start(["movej(q)", "", "textmsg(1)"], prefix="urlink_move", on_text=heard.append)
    assert program.name.startswith("urlink_move_")
    assert robot.sent[-1].splitlines()[2:5] == ["  movej(q)", "", "  textmsg(1)"]
    robot.begins(program)
    robot.text("1")
    robot.comes_to_its_end(program)
    program.wait(5)
    assert heard == ["1"]


def test_done_callbacks(robot: StandIn) -> None:
    called: list[Program] = []
    program = run(robot)

    def fail(program: Program) -> None:
        raise RuntimeError("on purpose")

    program.add_done_callback(fail)
    program.add_done_callback(called.append)
    robot.begins(program)
    robot.comes_to_its_end(program)
    program.wait(5)
    until(lambda: called == [program])
    program.add_done_callback(called.append)
    assert called == [program, program]


def test_waiting_has_an_end(robot: StandIn) -> None:
    program = run(robot)
    with pytest.raises(LinkTimeout, match=r"not over within 0\.01 s"):
        program.wait(0.01)
    assert not program.done
    robot.clear()
    with pytest.raises(urlink.LinkTimeout):
        robot.script.run("movej(q)", wait=0.01)
    with pytest.raises(BadValue, match="wait"):
        robot.script.run("movej(q)", wait=-1.0)


def test_send_line(robot: StandIn) -> None:
    robot.clear()
    robot.script.send_line("set speed 0.5")
    assert robot.sent == ["set speed 0.5\n"]
    for line in ("", "a\nb", "a\0b", 5):
        with pytest.raises(BadValue):
            robot.script.send_line(line)  # type: ignore[arg-type]
    assert len(robot.sent) == 1


def test_closing_ends_what_is_followed(robot: StandIn) -> None:
    program = run(robot)
    robot.script.close()
    with pytest.raises(ConnectionLost, match="closed here"):
        program.wait(5)

"""Interpreter mode: `robot.interpreter()` on the simulated controller, its protocol, and its port for any client."""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections.abc import Iterator
from types import SimpleNamespace
from typing import cast

import pytest
from hypothesis import given
from hypothesis import strategies as st

import urlink
from linkcore.errors import BadValue, Cancelled, Closed, ConnectFailed, LinkTimeout, LocalError, PacketError, WrongPeer
from linkcore.handle import Lifecycle, Phase
from linkcore.net.dialogue import Dialogue
from tests.fakes.line import Desk
from tests.waiting import threads_named, until
from urlink.command.interpreter import CLEAR_AFTER, _undo_statements
from urlink.protocol.interpreter import LONGEST_REPLY, WORDS, InterpreterProtocol, parse_reply, statement_line
from urlink.simulator import Controller, Still
from urlink.simulator.urscript.statements import MOST

pytestmark = pytest.mark.simulated_time

TIMEOUT = 20.0
HOME = [0.0, -1.57, 1.57, -1.57, -1.57, 0.0]
AWAY = [1.5, *HOME[1:]]


def movej(q: list[float], speed: float = 3.0) -> str:
    return f"movej({q}, a=20, v={speed})"


@pytest.fixture
def controller() -> Iterator[Controller]:
    with Controller("UR5e", "10.12", motion=Still()) as controller:
        yield controller


@pytest.fixture
def robot(controller: Controller) -> Iterator[urlink.Robot]:
    before = set(threading.enumerate())
    with urlink.connect(controller.address, stale_after=20.0, silence=30.0) as robot:
        yield robot
    until(lambda: set(threading.enumerate()) <= before)
    controller.faults.clear()


def turned(robot: urlink.Robot) -> float:
    return float(robot.realtime.wait(5).q_actual[0])


def test_statements_run_in_order_and_share_variables(robot: urlink.Robot) -> None:
    texts: list[str] = []
    with robot.interpreter(on_text=texts.append) as interpreter:
        assert interpreter.phase is Phase.RUNNING
        first = interpreter.execute("a = 3")
        interpreter.execute("def twice(x):\n  return 2 * x  # of course\nend")
        interpreter.execute(movej(AWAY), wait=True)
        assert turned(robot) == pytest.approx(AWAY[0], abs=1e-3)
        # The wait above sent an additional statement, sync().
        assert interpreter.execute('textmsg("a is ", twice(a))') == first + 4
        with pytest.raises(urlink.StatementDiscarded, match="does not compile: 'nobody") as discarded:
            interpreter.execute("nobody(1)")
        assert discarded.value.statement == "nobody(1)"
        interpreter.wait_executed(TIMEOUT)
        state = interpreter.state
        assert (state.unexecuted, state.last_cleared) == (0, 0)
        assert state.last_executed == state.last_interpreted > first
        interpreter.clear()
        interpreter.execute(movej(HOME))
    # The block ended normally, so every statement was executed and the program ran to its end.
    assert interpreter.done
    assert interpreter.error is None
    assert turned(robot) == pytest.approx(HOME[0], abs=1e-3)
    until(lambda: texts == ["a is 6"])
    interpreter.end()
    with pytest.raises(LocalError):
        interpreter.execute("a = 4")


def leave_half_way(robot: urlink.Robot) -> urlink.Interpreter:
    """Abort and skip, then leave the block by an exception while the arm moves."""
    with contextlib.suppress(KeyboardInterrupt), robot.interpreter() as interpreter:
        interpreter.execute(movej(HOME), wait=True)
        interpreter.execute(movej(AWAY, 0.2))
        last = interpreter.execute(movej(HOME, 0.2))
        with pytest.raises(LinkTimeout, match=r"did not end within 0\.1 s.*they continue"):
            interpreter.wait_executed(0.1)
        interpreter.skip()
        interpreter.abort()
        interpreter.wait_executed(TIMEOUT)
        assert interpreter.state.last_executed > last
        assert turned(robot) < 1.0
        interpreter.execute(movej(AWAY, 0.2))
        raise KeyboardInterrupt
    return interpreter


def test_interpreter_aborts_skips_and_is_cancelled(controller: Controller, robot: urlink.Robot) -> None:
    assert leave_half_way(robot).phase is Phase.CANCELLED
    until(lambda: not controller.is_running_program)
    assert controller.arm.q_actual[0] < 1.0
    preempted = robot.interpreter()
    robot.motion.stop().wait(TIMEOUT)
    for use in (lambda: preempted.execute("sync()"), lambda: preempted.wait(TIMEOUT), preempted.end):
        with pytest.raises(Cancelled, match="preempted"):
            use()


def execute_in_a_stop(controller: Controller, robot: urlink.Robot) -> None:
    with robot.interpreter() as stopped:
        stopped.execute(movej(AWAY, 0.1))
        controller.faults.protective_stop()
        until(lambda: stopped.done)
        stopped.execute("sync()")


def execute_what_fails(robot: urlink.Robot) -> None:
    with robot.interpreter() as failing:
        failing.execute("x = 1")
        failing.execute("x = x[0]")
        failing.wait_executed(TIMEOUT)


def execute_on_and_on(robot: urlink.Robot) -> None:
    with robot.interpreter() as failing:
        failing.execute("x = 1")
        failing.execute("x = x[0]")
        for _ in range(1000):
            failing.execute("sync()")


def test_statement_after_runtime_error_raises_script_failed(robot: urlink.Robot) -> None:
    """The controller might discard the statement before the error message arrives."""
    with pytest.raises(urlink.ScriptFailed, match="a value of type int has no elements"):
        execute_on_and_on(robot)


def test_interpreter_ends_after_safety_stop_or_script_error(controller: Controller, robot: urlink.Robot) -> None:
    with pytest.raises(urlink.SafetyStop):
        execute_in_a_stop(controller, robot)
    # The program was paused by the stop: when a person resumes it, it ends.
    controller.faults.clear()
    controller.call(controller.pendant.play)
    until(lambda: not controller.is_running_program)
    until(lambda: robot.safety.refusal is None)
    with pytest.raises(urlink.ScriptFailed, match="a value of type int has no elements"):
        execute_what_fails(robot)
    controller.faults.protective_stop()
    with pytest.raises(urlink.SafetyStop):
        robot.interpreter()


@pytest.mark.slow
def test_abandoned_statement_is_undone(
    controller: Controller, robot: urlink.Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("urlink.command.interpreter._REPLY", 0.5)
    with robot.interpreter() as interpreter:
        interpreter.execute(movej(HOME), wait=True)
        controller.faults.stall(1.0, "interpreter")
        with pytest.raises(LinkTimeout, match="it might still be executed"):
            interpreter.execute(movej(AWAY, 0.2))
        until(lambda: not threads_named("undo"), TIMEOUT)
        until(lambda: max(map(abs, controller.arm.setpoint.qd)) == 0.0)
        assert turned(robot) < 1.0
        # Later statements are executed.
        interpreter.execute("a = 42")
        interpreter.execute('textmsg("a is ", a)', wait=True)
        until(lambda: interpreter.texts == ("a is 42",))


@pytest.mark.parametrize("is_over", [False, True])
@pytest.mark.parametrize("until_done", range(5))
def test_undo_of_statement_sends_commands_until_no_longer_wanted(is_over: bool, until_done: int) -> None:
    """The first command checks that the controller answers; the undo stops when it is no longer wanted.

    If the program of the mode was abandoned too, the mode is ended.
    """
    asked: list[str] = []
    life = Lifecycle("interpreter mode", Desk().callbacks)
    if is_over:
        life.fail(LinkTimeout("no answer"))
    dialogue = cast(Dialogue, SimpleNamespace(ask=lambda line, timeout: asked.append(line)))
    _undo_statements(life, dialogue, lambda: len(asked) < until_done)
    lines = ["statelastexecuted", "skipbuffer", "abort", *["end_interpreter()"] * is_over]
    assert asked == lines[:until_done]


def test_ctrl_c_in_wait_executed_cancels_mode(robot: urlink.Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(word: str) -> int:
        raise KeyboardInterrupt

    interpreter = robot.interpreter()
    monkeypatch.setattr(interpreter, "_ask", interrupted)
    with pytest.raises(KeyboardInterrupt):
        interpreter.wait_executed(TIMEOUT)
    assert interpreter.phase is Phase.CANCELLED


def test_interpreter_starts_within_half_a_second(robot: urlink.Robot) -> None:
    begin = time.monotonic()
    with robot.interpreter():
        assert time.monotonic() - begin < 0.5


def test_interpreter_raises_closed_after_robot_is_closed(controller: Controller) -> None:
    with urlink.connect(controller.address) as robot, robot.interpreter():
        pass
    with pytest.raises(Closed, match=r"the robot at 127\.0\.0\.1 was closed"):
        robot.interpreter()


def test_execute_clears_statements_automatically(controller: Controller, robot: urlink.Robot) -> None:
    with robot.interpreter() as interpreter:
        interpreter.execute("n = 0")
        for _ in range(CLEAR_AFTER + 20):
            interpreter.execute("n = n + 1")
        interpreter.wait_executed(TIMEOUT)
        assert interpreter.state.last_cleared > CLEAR_AFTER
        interpreter.execute("write_output_integer_register(0, n)", wait=True)
    assert controller.registers.outputs.integers[0] == CLEAR_AFTER + 20


def test_interpreter_raises_when_mode_is_unavailable() -> None:
    none = r"5\.9 has no interpreter mode; 5\.10 or later is required"
    with urlink.connect("sim://ur5e?firmware=5.9") as old, pytest.raises(LocalError, match=none):
        old.interpreter()
    with Controller("UR5e", "5.25", motion=Still()) as controller:
        with socket.create_server(("127.0.0.1", 0)) as gone:
            dead = gone.getsockname()[1]
        served = f"interpreter={controller.ports['interpreter']}"
        with urlink.connect(controller.address.replace(served, f"interpreter={dead}")) as robot:
            with pytest.raises(ConnectFailed, match="the service might be switched off"):
                robot.interpreter()
            assert not controller.is_running_program
            with pytest.raises(BadValue):
                robot.interpreter(start_timeout=0)
        controller.remote_control = False
        with urlink.connect(controller.address) as robot, pytest.raises(LinkTimeout):
            robot.interpreter(start_timeout=0.3)


# -- the port, used by any client ------------------------------------------------------------------------


@pytest.mark.slow
def test_interpreter_port_replies_to_each_line() -> None:
    with Controller("UR5e", "5.11", motion=Still()) as controller:
        where = (controller.host, controller.ports["interpreter"])
        with socket.create_connection(where, TIMEOUT) as link, link.makefile("rw", newline="\n") as lines:

            def execute(line: str) -> str:
                lines.write(line + "\n")
                lines.flush()
                return lines.readline().rstrip("\n")

            assert execute("a = 1") == "discard: 0: a = 1"
            assert execute("statelastexecuted") == "state: 0: statelastexecuted"
            controller.take(
                "def main():\n  b = 5\n  interpreter_mode()\n  interpreter_mode(clearOnEnd=False)\n"
                '  textmsg("over")\nend\n'
            )
            until(lambda: controller.program_name == "main")
            until(lambda: execute("sync()").startswith("ack"))
            assert execute('b = b + 1   textmsg("b  is", b)').endswith(': b = b + 1   textmsg("b  is", b)')
            assert execute("interpreter_mode()").startswith("ack")  # an error once it is executed
            until(lambda: controller.program_name is None)

            controller.take('def main():\n  interpreter_mode()\n  interpreter_mode()\n  textmsg("over")\nend\n')
            until(lambda: execute("sync()").startswith("ack"))
            assert execute("sleep(0.05)").startswith("ack")
            for word in WORDS:
                assert execute(word).startswith("state: ")
            replies = [execute("x = 1").partition(":")[0] for _ in range(MOST + 5)]
            assert replies[-1] == "discard"
            assert replies.count("ack") <= MOST
            until(lambda: execute("stateunexecuted").startswith("state: 0"))
            # Executed statements are kept, so even `clear_interpreter()`, which would make room, is discarded.
            assert execute("clear_interpreter()").startswith("discard")


def test_program_continues_after_end_interpreter() -> None:
    with Controller("UR5e", "5.11", motion=Still()) as controller, urlink.connect(controller.address) as robot:
        program = robot.script.run('def main():\n  x = 1\n  interpreter_mode()\n  textmsg("x is ", x)\nend')
        where = (controller.host, controller.ports["interpreter"])
        with socket.create_connection(where, TIMEOUT) as link, link.makefile("rw", newline="\n") as lines:
            for line in ("x = x + 41", "end_interpreter()"):
                reply = ""
                end = time.monotonic() + TIMEOUT
                while not reply.startswith("ack") and time.monotonic() < end:
                    lines.write(line + "\n")
                    lines.flush()
                    reply = lines.readline()
        program.wait(TIMEOUT)
        assert program.texts == ("x is 42",)
        thread = "thread t():\n  interpreter_mode()\nend\nh = run t()\nsleep(1)"
        with pytest.raises(urlink.ScriptFailed, match="in the main thread"):
            robot.script.run(thread, wait=TIMEOUT)


# -- the protocol ----------------------------------------------------------------------------------------

texts = st.text(st.characters(codec="utf-8", exclude_categories=("Cc", "Zl", "Zp", "Cs")), min_size=1, max_size=60)


@pytest.mark.property
@given(st.sampled_from(["ack", "discard", "state"]), st.integers(0, 10**6), texts, st.integers(0, 80))
def test_reply_does_not_depend_on_chunking(word: str, number: int, text: str, at: int) -> None:
    protocol = InterpreterProtocol()
    assert protocol.ask("sync()") == b"sync()\n"
    with pytest.raises(LocalError, match="out of step"):
        protocol.ask("sync()")
    data = f"{word}: {number}: {text}\n".encode()
    found = protocol.feed(data[:at])
    found = protocol.feed(data[at:]) if found is None else found
    assert found is not None
    reply = parse_reply(found)
    # Unicode spaces before the text stay, but spaces at the ends of the line are removed.
    assert (reply.word, reply.number, reply.text.strip()) == (word, number, text.strip())
    assert protocol.is_in_step


@pytest.mark.property
@given(st.text(max_size=80))
def test_statement_line_returns_one_line_or_raises_bad_value(text: str) -> None:
    try:
        line = statement_line(text)
    except BadValue:
        return
    assert line.strip()
    assert "\n" not in line
    assert len(line.splitlines()) == 1


def test_invalid_replies_and_statements_are_rejected() -> None:
    for line in ("", "ack", "ack: x: y", "maybe: 1: sync()"):
        with pytest.raises(PacketError, match="is not a known reply"):
            parse_reply(line)
    with pytest.raises(WrongPeer, match="is too long for a reply"):
        InterpreterProtocol().feed(b"x" * (LONGEST_REPLY + 1))
    unasked = InterpreterProtocol()
    for _ in range(LONGEST_REPLY // 10):
        assert unasked.feed(b"ack: 1: x\n") is None
    with pytest.raises(WrongPeer, match="without a request, which start with b'ack: 1: x'"):
        unasked.feed(b"ack: 1: x\n")
    for statement, error in (
        ("# nothing", "is not a statement"),
        (" abort ", "'abort' is a command word, not a statement"),
        (5, "is int; expected a string"),
        ("x = '\0'", "must not contain control characters"),
        ("x = " + "1" * 9000, "at most 8000"),
    ):
        with pytest.raises(BadValue, match=error):
            statement_line(statement)  # type: ignore[arg-type]
    assert statement_line('x = "# no comment"  # a comment') == 'x = "# no comment"'

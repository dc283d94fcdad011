"""Programs on the simulated controller, end to end: sending, running, ending and reporting."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pytest

import urlink
from linkcore.errors import Cancelled
from linkcore.handle import Phase
from tests.waiting import until
from urlink.errors import CompileError, NotConfirmed, NotRunning, ProgramStopped, SafetyStop, ScriptFailed

pytestmark = pytest.mark.simulated_time

FIRMWARES = ("sim://ur5?firmware=1.8", "sim://ur5?firmware=3.4", "sim://ur5e?firmware=5.11")

LONG = "while True:\n  sync()\nend"


@pytest.fixture
def robot() -> Iterator[urlink.Robot]:
    with urlink.connect("sim://ur5e?firmware=5.11") as robot:
        yield robot


@pytest.mark.parametrize("address", FIRMWARES)
def test_program_runs_to_its_end(address: str) -> None:
    with urlink.connect(address) as robot:
        program = robot.script.run('def job():\n  textmsg("one")\n  sleep(0.05)\n  textmsg("two")\nend', wait=20.0)
        assert program.phase is Phase.DONE
        assert program.texts == ("one", "two")


def test_return_finishes_program_but_halt_stops_it(robot: urlink.Robot) -> None:
    robot.script.run("def job():\n  return 1\n  halt\nend", wait=20.0)
    program = robot.script.run("def job():\n  halt\nend")
    with pytest.raises(ProgramStopped, match="was stopped early"):
        program.wait(20)


def test_script_moves_the_arm(robot: urlink.Robot) -> None:
    q = robot.realtime.wait(5).q_actual.copy()
    robot.script.run(
        f"def job():\n  q = {q.round(6).tolist()}\n  movej(q)\n  q[5] = q[5] + 0.1\n  movej(q)\nend", wait=30.0
    )
    until(lambda: np.abs(robot.realtime.wait(5).q_actual - q - [0, 0, 0, 0, 0, 0.1]).max() < 0.01)


def test_compile_error_has_line_number(robot: urlink.Robot) -> None:
    program = robot.script.run('def job():\n  a = 1\n  txtmsg("one")\nend')
    with pytest.raises(CompileError, match="compile_error_name_not_found:txtmsg") as caught:
        program.wait(20)
    assert caught.value.line == 3
    program = robot.script.run("a = 1\nb = = 2")
    with pytest.raises(CompileError, match="syntax_error_on_line:2") as caught:
        program.wait(20)
    assert caught.value.line == 2


def test_runtime_error_has_line_number(robot: urlink.Robot) -> None:
    program = robot.script.run("a = [1, 2]\nsync()\nb = a[5]")
    with pytest.raises(ScriptFailed) as caught:
        program.wait(20)
    assert caught.value.line == 3
    assert program.phase is Phase.FAILED


def test_next_program_preempts_running_program(robot: urlink.Robot) -> None:
    one = robot.script.run(LONG)
    until(lambda: one.phase is Phase.RUNNING)
    two = robot.script.run("sleep(0.02)", wait=20.0)
    assert two.phase is Phase.DONE
    with pytest.raises(Cancelled, match=f"preempted by {two.name}"):
        one.wait(20)


def test_secondary_program_runs_during_main_program(robot: urlink.Robot) -> None:
    long = robot.script.run(LONG)
    until(lambda: long.phase is Phase.RUNNING)
    robot.script.run("sec lamp():\n  set_standard_digital_out(2, True)\nend", wait=20.0)
    until(lambda: robot.io.digital_out(2))
    robot.io.set_digital_out(2, False)
    robot.io.set_tool_voltage(24)
    assert not robot.io.digital_out(2)
    assert robot.io.tool_voltage == 24
    assert long.phase is Phase.RUNNING
    long.cancel()
    robot.motion.stop().wait(20)
    with pytest.raises(Cancelled, match="was cancelled"):
        long.wait(0)


def test_payload_tcp_and_popup_are_set_on_the_controller(robot: urlink.Robot) -> None:
    messages: list[urlink.packets.PopupMessage] = []
    robot.primary.subscribe(messages.append, urlink.packets.PopupMessage)
    robot.set_payload(1.5, (0, 0, 0.1))
    robot.set_tcp((0, 0, 0.2, 0, 0, 0))
    robot.popup("mind the gap")
    until(lambda: messages)
    assert messages[0].text == "mind the gap"
    assert robot.controller.arm.payload == 1.5
    assert robot.controller.arm.tcp[2] == pytest.approx(0.2)


@pytest.mark.parametrize("address", [*FIRMWARES, "sim://ur5?firmware=3.15", "sim://ur5e?firmware=5.25"])
def test_every_setting_is_confirmed(address: str) -> None:
    with urlink.connect(address) as robot:
        robot.io.set_digital_out(3, True)
        robot.io.set_tool_digital_out(1, True)
        robot.io.set_analog_out(0, 0.5)
        robot.io.set_tool_voltage(12)
        robot.set_payload(1.0)
        robot.set_tcp([0.1, 0.0, 0.2, 0.0, 3.0, 3.0])
        robot.set_speed_slider(0.25)
        robot.popup("done")
        if not robot.firmware.is_cb2:
            robot.io.set_configurable_digital_out(7, True)


@pytest.mark.slow
def test_not_confirmed_error_names_local_control(robot: urlink.Robot) -> None:
    robot.io.set_digital_out(0, True)
    robot.controller.remote_control = False
    acts: list[Callable[[], object]] = [
        lambda: robot.io.set_digital_out(0, False, confirm=0.3),
        lambda: robot.set_payload(2.0, confirm=0.3),
        lambda: robot.set_tcp([0, 0, 0.3, 0, 0, 0], confirm=0.3),
        lambda: robot.set_speed_slider(0.3, confirm=0.3),
    ]
    for act in acts:
        with pytest.raises(NotConfirmed, match="the robot is in local control"):
            act()
    robot.popup("ignored without an error")


@pytest.mark.slow
def test_emergency_stop_ends_program(robot: urlink.Robot) -> None:
    controller = robot.controller
    program = robot.script.run(LONG)
    until(lambda: program.phase is Phase.RUNNING)
    controller.faults.emergency_stop()
    with pytest.raises((SafetyStop, NotRunning)) as caught:
        program.wait(20)
    assert "emergency" in str(caught.value)
    with pytest.raises(SafetyStop):
        robot.script.run("movej(q)")
    controller.faults.clear()
    until(lambda: robot.safety.cause is None)
    controller.faults.power_on()
    robot.safety.wait_enabled(20)
    robot.script.run("sleep(0.02)", wait=20.0)


def test_commands_work_after_lost_connection(robot: urlink.Robot) -> None:
    controller = robot.controller
    program = robot.script.run('textmsg("continues")\n' + LONG)
    until(lambda: program.texts == ("continues",))  # the program has got its permission
    controller.faults.cut("primary")
    with pytest.raises(urlink.ConnectionLost, match="might still run"):
        program.wait(20)
    robot.safety.wait_enabled(20)
    robot.script.run("sleep(0.02)", wait=20.0)

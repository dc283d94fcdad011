"""Programs on a controller, cycle by cycle, without threads or sockets and with the controller's own clock only."""

from __future__ import annotations

import itertools
import math
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import urlink
from tests.matrix import trials
from urlink.protocol.enums import ProgramState, SafetyMode
from urlink.simulator import Controller
from urlink.simulator.interfaces.dashboard import UNLOCK_AFTER
from urlink.simulator.programs.runner import MOST_SECONDARY
from urlink.simulator.robot.modes import Power
from urlink.simulator.robot.setpoint_sources import HOME, Demonstration, Still

TURN = "def turn():\n  movej([0.5, -1.2, 1.2, -1.2, -1.2, 0.3], a=1, v=0.5)\nend\n"
SPIN = "def spin():\n  speedj([0.5, 0, 0, 0, 0, 0], 1, 60)\nend\n"
WAIT = "def wait():\n  sleep(60)\nend\n"
CB3 = "3.14"


class Watched:
    """A stepped controller and the messages that it has sent."""

    def __init__(self, firmware: str = "5.11", **more: Any) -> None:
        more.setdefault("motion", Still())
        self.controller = Controller(None, firmware, **more)
        self.said: list[Any] = []
        self.speeds: list[float] = []

    def take(self, *texts: str) -> Watched:
        for text in texts:
            self.controller.take(text)
        return self

    def step(self, seconds: float) -> Watched:
        for _ in range(round(seconds * self.controller.firmware.rate)):
            self.cycle()
        return self

    def listen(self) -> None:
        data = b"".join(self.controller.take_messages())
        self.said += urlink.decode(data, "primary", self.controller.firmware)

    def cycle(self) -> None:
        controller = self.controller
        self.listen()
        controller.step()
        self.listen()
        self.speeds.append(controller.arm.setpoint.qd[0])

    def dashboard(self, line: str) -> str | None:
        return self.controller.dashboard.reply(line)

    @property
    def story(self) -> list[str]:
        """The messages so far, in a short form."""
        return [text for text in map(self._short, self.said) if text]

    def _short(self, message: Any) -> str:
        name = type(message).__name__
        if name == "KeyMessage":
            return f"{message.title.rpartition('_')[2].lower()} {message.text}"
        if name == "RuntimeExceptionMessage":
            return f"{message.line}:{message.column} {message.text}"
        if name == "TextMessage":
            return f"'{message.text}'"
        if name == "RobotCommMessage":
            return f"C{message.code} {message.text}"
        return name if name == "PopupMessage" else ""

    @property
    def steadiest(self) -> float:
        """Largest change of the speed of the base joint so far, in rad/s²."""
        rate = self.controller.firmware.rate
        return max((abs(b - a) * rate for a, b in itertools.pairwise(self.speeds)), default=0.0)

    def moves(self) -> bool:
        return any(self.controller.arm.setpoint.qd)

    def power(self) -> Power:
        return self.controller.modes.power


@pytest.fixture
def watched() -> Watched:
    return Watched()


# -- start and end -------------------------------------------------------------------------------------


def test_program_starts_moves_and_stops(watched: Watched) -> None:
    watched.take(TURN).step(0.5)
    assert watched.moves()
    assert watched.controller.modes.program_state is ProgramState.PLAYING
    assert watched.dashboard("programState") == "PLAYING <unnamed>"
    watched.step(5)
    assert watched.story == ["started turn", "stopped turn"]
    assert watched.controller.arm.setpoint.q == pytest.approx([0.5, -1.2, 1.2, -1.2, -1.2, 0.3], abs=1e-9)
    assert watched.controller.program_name is None
    assert watched.dashboard("programState") == "STOPPED <unnamed>"


@pytest.mark.parametrize("firmware", ["1.6", "1.8", "3.0", "3.4", "3.14", "5.0", "5.4", "5.11", "5.12"])
def test_messages_can_be_decoded_on_every_firmware(firmware: str) -> None:
    watched = Watched(firmware)
    watched.take(
        'def f():\n  textmsg("hello ", 3)\n  popup("look", "here", True, False)\n  x = 1/0\nend\n',
        "def g():\n  nn()\nend\n",
    ).step(0.1)
    assert watched.story[:2] == ["started f", "2:3 compile_error_name_not_found:nn:"]
    assert watched.story[2:4] == ["'hello 3'", "PopupMessage"]
    assert watched.story[4].startswith("4:")
    assert watched.story[5:] == ["stopped f"]
    popup = next(message for message in watched.said if isinstance(message, urlink.packets.PopupMessage))
    assert (popup.title, popup.text, popup.is_warning, popup.is_error) == ("here", "look", True, False)


def test_compile_errors_match_a_real_controller(watched: Watched) -> None:
    # Captures of a real 5.4 contain these two values.
    watched.take('def f():\n  txtmsg("x")\nend\n').step(0.01)
    assert watched.story == ["2:3 compile_error_name_not_found:txtmsg:"]
    assert watched.said[0].timestamp == 0xFFFFFFFFFFFFFFFF
    assert watched.controller.program_name is None


def test_program_that_fails_to_compile_stops_no_other(watched: Watched) -> None:
    watched.take(SPIN).step(0.5)
    watched.take("def f():\n  nonsense()\nend\n").step(0.5)
    assert watched.controller.program_name == "spin"
    assert watched.controller.arm.setpoint.qd[0] == pytest.approx(0.5)


def test_runtime_error_stops_the_program_and_brakes(watched: Watched) -> None:
    program = (
        "def f():\n  thread t():\n    sleep(1)\n    x = 1/0\n  end\n  run t()\n  speedj([0.5,0,0,0,0,0], 1, 60)\nend\n"
    )
    watched.take(program).step(0.9)
    assert watched.moves()
    watched.step(2)
    assert watched.story[0] == "started f"
    assert watched.story[1].startswith("4:")
    assert watched.story[2:] == ["stopped f"]
    assert watched.said[1].timestamp == pytest.approx(1e6, abs=2e4)
    assert not watched.moves()
    assert watched.steadiest < 20


def test_joint_target_out_of_range_is_a_runtime_error(watched: Watched) -> None:
    watched.take("def f():\n  movej([-123, 0, 0, 0, 0, 0])\nend\n").step(0.1)
    assert watched.story[1:] == ["2:3 base: the target of -123.0000 rad is out of range", "stopped f"]
    assert watched.controller.modes.safety_mode is SafetyMode.NORMAL


def test_pose_out_of_reach_causes_a_protective_stop(watched: Watched) -> None:
    watched.take("def f():\n  movel(p[-10.2, 0.26, 0.56, 0.68, -1.08, -2.08], a=1.5, v=1.5)\nend\n").step(3)
    assert watched.story[1].startswith("C191 Protective stop: elbow")
    assert watched.controller.modes.safety_mode is SafetyMode.PROTECTIVE_STOP
    watched.step(5)
    assert watched.dashboard("unlock protective stop") == "Protective stop releasing"
    assert watched.dashboard("stop") == "Stopped"
    watched.step(1)
    assert watched.story[-1] == "stopped f"
    assert watched.dashboard("safetymode") == "Safetymode: NORMAL"


def test_direction_node_moves_until_its_condition(watched: Watched) -> None:
    """PolyScope writes the node as a move to a pose 1000 m away, in a thread that it kills on the condition."""
    text = """def direction():
  start = get_target_tcp_pose()
  thread go():
    movel(pose_add(start, p[0, 1000, 0, 0, 0, 0]), a=1.2, v=0.1)
  end
  handle = run go()
  while get_standard_digital_in(2) == False:
    sync()
  end
  kill handle
  stopl(3)
  textmsg("there")
end
"""
    begin = watched.controller.arm.sample.pose_target[1]
    watched.take(text).step(1.5)
    assert watched.moves()
    watched.controller.signals.digital_inputs = 1 << 2
    watched.step(0.5)
    assert watched.story == ["started direction", "'there'", "stopped direction"]
    assert 0.1 < watched.controller.arm.sample.pose_target[1] - begin < 0.2


@pytest.mark.slow
def test_messages_of_many_steps_are_kept_until_taken() -> None:
    controller = Controller("UR5e", "5.11", motion=Still())
    controller.take("def f():\n  i = 0\n  while i < 12000:\n    textmsg(i)\n    sync()\n    i = i + 1\n  end\nend\n")

    def texts() -> list[str]:
        messages = urlink.decode(b"".join(controller.take_messages()), "primary", "5.11")
        return [message.text for message in messages if isinstance(message, urlink.packets.TextMessage)]

    controller.step(3)
    controller.step(2)
    assert texts() == ["0", "1", "2", "3", "4"]
    assert texts() == []
    controller.step(11_000)
    assert len(texts()) == 10_000
    assert controller.counters.lost_messages == 1000
    controller.step()
    assert texts() == ["11005"]


def test_program_that_ends_while_moving_brakes(watched: Watched) -> None:
    watched.take("def f():\n  speedj([0.8,0,0,0,0,0], 2, 0.6)\nend\n").step(0.7)
    assert watched.story == ["started f", "stopped f"]
    assert watched.moves()
    watched.step(1)
    assert not watched.moves()
    assert watched.steadiest < 12


def test_new_program_continues_at_the_current_speed(watched: Watched) -> None:
    watched.take(SPIN).step(1)
    watched.take(TURN).step(0.01)
    assert watched.story == ["started spin", "stopped spin", "started turn"]
    assert watched.controller.arm.setpoint.qd[0] > 0.4
    watched.step(6)
    assert watched.story[3:] == ["stopped turn"]
    assert watched.controller.arm.setpoint.q[0] == pytest.approx(0.5, abs=1e-9)
    assert watched.steadiest < 12


def test_new_program_takes_over_from_the_demonstration() -> None:
    watched = Watched(motion=Demonstration())
    watched.step(3)
    assert watched.moves()
    watched.take(TURN).step(6)
    assert watched.story == ["started turn", "stopped turn"]
    assert watched.steadiest < 12
    assert watched.controller.modes.program_state is ProgramState.STOPPED


def test_new_program_takes_over_from_a_braking_arm(watched: Watched) -> None:
    watched.take(SPIN).step(1)
    watched.controller.pendant.pause()
    watched.step(0.05)
    assert 0 < watched.controller.arm.setpoint.qd[0] < 0.5
    watched.take(TURN).step(6)
    assert watched.story == ["started spin", "stopped spin", "started turn", "stopped turn"]
    assert watched.steadiest < 25
    assert watched.controller.arm.setpoint.q[0] == pytest.approx(0.5, abs=1e-9)


def test_single_line_runs_as_a_program(watched: Watched) -> None:
    watched.take("movej([0.1, -1.57, 1.57, -1.57, -1.57, 0])").step(3)
    assert watched.controller.arm.setpoint.q[0] == pytest.approx(0.1, abs=1e-9)
    assert watched.story == ["started unnamed", "stopped unnamed"]


def test_comment_does_not_stop_the_program(watched: Watched) -> None:
    watched.take(WAIT, "# hello\n\n  # again\n").step(0.1)
    assert watched.controller.program_name == "wait"


def test_several_programs_in_one_text_run_in_order(watched: Watched) -> None:
    watched.take("def a():\n  sleep(1)\nend\r\nsec s():\r\n  set_digital_out(1, True)\r\nend\r\n" + WAIT).step(0.1)
    assert watched.story == ["started a", "stopped a", "started wait"]
    assert watched.controller.signals.digital_outputs == 2


def test_set_tcp_applies_to_the_next_move(watched: Watched) -> None:
    watched.take(
        "def f():\n  set_tcp(p[0, 0, 0.2, 0, 0, 0])\n"
        "  movel(pose_trans(get_target_tcp_pose(), p[0, 0, 0.1, 0, 0, 0]), a=1, v=0.2)\nend\n"
    )
    watched.cycle()
    before = watched.controller.arm.sample.pose_target
    watched.step(3)
    after = watched.controller.arm.sample.pose_target
    assert math.dist(before[:3], after[:3]) == pytest.approx(0.1, abs=1e-5)
    assert watched.story == ["started f", "stopped f"]


# -- secondary programs --------------------------------------------------------------------------------


def test_secondary_program_runs_during_a_motion(watched: Watched) -> None:
    watched.take(SPIN).step(1)
    watched.take("sec s():\n  set_digital_out(3, True)\nend\n").step(0.1)
    assert watched.controller.signals.digital_outputs == 8
    assert watched.controller.arm.setpoint.qd[0] == pytest.approx(0.5)
    assert watched.story == ["started spin"]


def test_secondary_program_runs_while_the_program_is_paused(watched: Watched) -> None:
    watched.take(WAIT).step(0.1)
    watched.controller.pendant.pause()
    watched.take("sec s():\n  set_digital_out(3, True)\nend\n").step(0.01)
    assert watched.controller.signals.digital_outputs == 8
    assert watched.controller.modes.program_state is ProgramState.PAUSED


def test_is_steady_returns_false_while_a_program_runs(watched: Watched) -> None:
    ask = "sec s():\n  textmsg(is_steady())\nend\n"
    watched.take(ask).step(0.01)
    watched.take(SPIN).step(1)
    watched.take(ask).step(0.01)
    watched.controller.pendant.stop()
    watched.step(2).take(ask).step(0.01)
    assert watched.story == ["'True'", "started spin", "'False'", "stopped spin", "'True'"]


def test_secondary_program_error_is_reported(watched: Watched) -> None:
    watched.take("sec s():\n  x = 1/0\nend\n").step(0.01)
    assert [line[:2] for line in watched.story] == ["2:"]


def test_secondary_program_must_not_move(watched: Watched) -> None:
    watched.take("sec s():\n  movej([0,0,0,0,0,0])\nend\n").step(0.01)
    assert [line[:2] for line in watched.story] == ["2:"]
    assert not watched.moves()


def test_many_secondary_programs_run_one_after_another(watched: Watched) -> None:
    count = 3 * MOST_SECONDARY
    for n in range(count):
        watched.take(f"sec s{n}():\n  textmsg({n})\nend\n")
    watched.step(0.1)
    assert watched.story == [f"'{n}'" for n in range(count)]
    assert watched.controller.counters.refused_programs == 0
    assert not watched.controller.is_running_program


def test_number_of_blocked_secondary_programs_is_bounded(watched: Watched) -> None:
    blocked = 'sec s():\n  popup("x", blocking=True)\n  # ' + "x" * 100_000 + "\nend\n"
    for _ in range(60):
        watched.take(blocked).step(0.002)
    assert watched.controller.counters.refused_programs > 0
    assert watched.dashboard("close popup") == "closing popup"
    watched.step(0.2)
    # Secondary programs that ran later have opened the popup again.
    watched.dashboard("close popup")
    watched.step(0.2)
    assert not watched.controller.is_running_program


# -- stops ---------------------------------------------------------------------------------------------


def test_protective_stop_pauses_and_play_resumes(watched: Watched) -> None:
    watched.take(TURN).step(0.5)
    watched.controller.faults.protective_stop()
    watched.step(2)
    assert not watched.moves()
    assert watched.controller.program_name == "turn"
    assert watched.dashboard("programState") == "PAUSED <unnamed>"
    assert watched.dashboard("play") == "Failed to execute: play"
    watched.controller.faults.clear()
    # The program does not resume automatically.
    watched.step(3)
    assert not watched.moves()
    assert watched.controller.program_name == "turn"
    assert watched.dashboard("play") == "Starting program"
    watched.step(6)
    assert watched.controller.arm.setpoint.q[0] == pytest.approx(0.5, abs=1e-9)
    assert watched.story == ["started turn", "C153 Protective stop: position deviates from path", "stopped turn"]


def test_new_program_starts_after_a_protective_stop(watched: Watched) -> None:
    watched.take(SPIN).step(1)
    watched.controller.faults.protective_stop()
    watched.step(1)
    watched.take(TURN).step(0.1)
    assert watched.controller.counters.refused_programs == 1
    watched.controller.faults.clear()
    watched.take(TURN).step(6)
    assert watched.story[-3:] == ["stopped spin", "started turn", "stopped turn"]


def test_protective_stop_cannot_be_unlocked_immediately(watched: Watched) -> None:
    watched.controller.faults.protective_stop()
    for _ in range(2):
        assert str(watched.dashboard("unlock protective stop")).startswith("Cannot unlock")
        watched.step(UNLOCK_AFTER / 2)
    watched.step(0.01)
    assert watched.dashboard("unlock protective stop") == "Protective stop releasing"
    watched.step(0.01)
    assert watched.controller.modes.may_move
    assert watched.controller.stopped_since is None


@pytest.mark.parametrize("end", ["emergency_stop", "power_off"])
def test_emergency_stop_and_power_off_end_the_program(watched: Watched, end: str) -> None:
    watched.take(SPIN).step(1)
    getattr(watched.controller.faults, end)()
    watched.step(2)
    assert [line for line in watched.story if line[:1] != "C"] == ["started spin", "stopped spin"]
    assert not watched.moves()
    assert watched.power() is Power.OFF
    assert watched.steadiest < 25
    watched.controller.faults.clear()
    watched.controller.faults.power_on()
    watched.step(3)
    assert not watched.moves()
    assert watched.controller.program_name is None
    watched.take(TURN).step(6)
    assert watched.story[-2:] == ["started turn", "stopped turn"]


def test_another_source_of_set_points_ends_the_program(watched: Watched) -> None:
    watched.take(SPIN).step(1)
    watched.controller.follow(Still())
    watched.step(2)
    assert watched.story == ["started spin", "stopped spin"]
    assert not watched.moves()
    assert watched.steadiest < 25
    assert not watched.controller.is_running_program


@pytest.mark.parametrize("end", ["emergency_stop", "power_off"])
@pytest.mark.parametrize("hold", ["pause", "protective_stop"])
def test_emergency_stop_and_power_off_end_a_paused_program(watched: Watched, hold: str, end: str) -> None:
    watched.take(SPIN).step(1)
    if hold == "pause":
        assert watched.controller.pendant.pause()
    else:
        watched.controller.faults.protective_stop()
    watched.step(1)
    getattr(watched.controller.faults, end)()
    watched.step(1)
    assert [line for line in watched.story if line[:1] != "C"] == ["started spin", "stopped spin"]
    assert watched.controller.modes.program_state is ProgramState.STOPPED


def test_paused_demonstration_restarts_after_emergency_stop() -> None:
    watched = Watched(motion=Demonstration())
    watched.step(2)
    assert watched.dashboard("pause") == "Pausing program"
    watched.step(1)
    assert not watched.moves()
    watched.controller.faults.emergency_stop()
    watched.step(1)
    watched.controller.faults.clear()
    watched.controller.faults.power_on()
    watched.step(4)
    assert watched.moves()
    assert watched.controller.modes.program_state is ProgramState.PLAYING


def test_reboot_ends_programs_and_resets_settings() -> None:
    watched = Watched(files={"a.urp": WAIT})
    controller = watched.controller
    controller.pendant.load("a.urp")
    watched.take(
        'def f():\n  set_flag(3, True)\n  set_tcp(p[0,0,0.1,0,0,0])\n  popup("x")\n'
        "  speedj([0.5,0,0,0,0,0],1,60)\nend\n",
        "set speed 0.5",
        'sec s():\n  popup("y", blocking=True)\nend\n',
    ).step(1)
    assert controller.pendant.popup is not None
    controller.faults.reboot(downtime=0.5)
    watched.step(0.4)
    watched.take(WAIT)
    watched.step(1)
    # The connections that could report the end of the program no longer exist.
    assert watched.story == ["started f", "PopupMessage", "PopupMessage"]
    assert controller.program_name is None
    assert not controller.is_running_program
    after: list[Any] = [
        controller.pendant.popup,
        controller.pendant.loaded,
        controller.speed_fraction,
        any(controller.flags),
    ]
    assert after == [None, None, 1.0, False]
    # The TCP belongs to the installation, so it survives the reboot.
    assert controller.arm.tcp[2] == 0.1
    watched.take(TURN).step(6)
    assert watched.story[-2:] == ["started turn", "stopped turn"]


def test_same_program_takes_over_without_braking(watched: Watched) -> None:
    """Drivers that send one speedj after the other rely on this."""
    spin = "def spin():\n  while True:\n    speedj([0.5, 0, 0, 0, 0, 0], 1, 0.1)\n  end\nend\n"
    watched.take(spin).step(1.0)
    watched.speeds.clear()
    watched.take(spin).step(0.5)
    assert watched.story == ["started spin", "stopped spin", "started spin"]
    assert min(watched.speeds) == max(watched.speeds) == 0.5


@pytest.mark.simulated_time
def test_closing_a_controller_ends_its_program() -> None:
    with Controller("UR5e", "5.11", motion=Still()) as controller:
        controller.take(SPIN)
        is_running = [controller.is_running_program]
    is_running.append(controller.is_running_program)
    assert is_running == [True, False]
    # Messages sent during the close must not reach a client that connects later.
    assert controller.take_messages() == []


# -- limits --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("line", "code"),
    [
        ("servoj([0.8, -1.57, 1.57, -1.57, -1.57, 0], t=0.002, lookahead_time=0.03, gain=2000)", "C204"),
        ("servoj([7, -1.57, 1.57, -1.57, -1.57, 0])", "C150"),
        ("speedj([9, 0, 0, 0, 0, 0], 40, 5)", "C191"),
    ],
)
def test_exceeded_limit_causes_a_protective_stop_with_reason(watched: Watched, line: str, code: str) -> None:
    watched.take(f"def f():\n  {line}\n  sleep(1)\nend\n").step(3)
    assert watched.controller.modes.safety_mode is SafetyMode.PROTECTIVE_STOP
    report = next(line for line in watched.story if line.startswith("C"))
    assert report.startswith(f"{code} Protective stop: ")
    assert "deviates" not in report
    assert watched.controller.program_name == "f"
    assert not watched.moves()
    watched.controller.faults.clear()
    watched.step(0.1)
    # The reason applied to the first stop only.
    watched.controller.faults.protective_stop()
    watched.step(0.1)
    assert watched.story[-1] == "C153 Protective stop: position deviates from path"


@pytest.mark.parametrize("kind", ["def", "sec"])
def test_program_can_request_a_protective_stop(watched: Watched, kind: str) -> None:
    watched.take(f"{kind} f():\n  protective_stop()\nend\n").step(0.1)
    assert watched.controller.modes.safety_mode is SafetyMode.PROTECTIVE_STOP
    (report,) = [message for message in watched.said if type(message).__name__ == "RobotCommMessage"]
    assert (report.code, report.argument, report.report_level.name) == (209, 0, "WARNING")
    assert report.text == "Protective stop: protective_stop() was called by the program"
    watched.controller.faults.clear()
    watched.step(0.1)
    # The cause applied to the first stop only.
    watched.controller.faults.protective_stop()
    watched.step(0.1)
    assert watched.story[-1] == "C153 Protective stop: position deviates from path"


@pytest.mark.parametrize("ending", ["", "  textmsg(7)\n"])
def test_protective_stop_as_last_statement_ends_the_program(watched: Watched, ending: str) -> None:
    # The UR Client Library expects this: it waits for the end, and unlocks the stop only then.
    watched.take(f"def f():\n  protective_stop()\n{ending}end\n").step(0.1)
    codes = [line.partition(" ")[0] for line in watched.story if line != "'7'"]
    assert codes == ["started", "C209", "stopped"]
    assert watched.controller.program_name is None
    assert watched.controller.modes.program_state is ProgramState.STOPPED
    watched.controller.faults.clear()
    watched.take("def g():\n  sleep(0.01)\nend\n").step(0.1)
    assert watched.story[-2:] == ["started g", "stopped g"]


def test_protective_stop_pauses_a_program_with_more_statements(watched: Watched) -> None:
    watched.take("def f():\n  protective_stop()\n  sleep(0.01)\nend\n").step(0.1)
    assert watched.controller.program_name == "f"
    assert watched.controller.modes.program_state is ProgramState.PAUSED
    watched.controller.faults.clear()
    watched.controller.pendant.play()
    watched.step(0.1)
    assert watched.story[-1] == "stopped f"


def test_reason_of_an_overridden_stop_is_forgotten(watched: Watched) -> None:
    watched.controller.faults.emergency_stop()
    watched.controller._state.stop_protectively("a joint jumped")
    watched.step(0.1)
    watched.controller.faults.clear()
    watched.controller.faults.power_on()
    watched.step(1)
    watched.controller.faults.protective_stop()
    watched.step(0.1)
    assert not any("jumped" in line for line in watched.story)


@pytest.mark.parametrize("firmware", ["5.25", "10.12"])
def test_vendor_instruction_example_runs_to_its_end(firmware: str) -> None:
    # These are the motions of the example instruction_executor of the UR Client Library.
    near, far = "p[-0.203, 0.263, 0.559, 0.68, -1.083, -2.076]", "p[-0.203, 0.463, 0.559, 0.68, -1.083, -2.076]"
    folded = "[-1.57, -1.6, 1.6, -0.7, 0.7, 0.2]"
    lines = [
        "movej([-1.57, -1.57, 0, 0, 0, 0], t=5, r=0.1)",
        f"movej({folded}, a=1.4, v=2.0, r=0.1)",
        f"movel({near}, t=2, r=0.1)",
        f"movep({far}, a=0.4, v=0.4, r=0.1)",
        "optimovej([-1.57, -1.57, 1.6, -0.5, 0.4, 0.3], a=0.4, v=0.7, r=0.1)",
        f"optimovel({near}, a=0.4, v=0.7)",
        "movej([-1.57, -1.57, 0, 0, 0, 0], a=2.0, v=2.0)",
        f"movej({folded}, t=2)",
        f"movel({near}, a=1.5, v=1.5)",
        f"movel({far}, t=2)",
        "movep(p[-0.203, 0.463, 0.759, 0.68, -1.083, -2.076], a=1.5, v=1.5)",
        f"movej({folded})",
        "optimovel(p[-0.0203, 0.363, 0.559, 0.68, -1.083, -2.076], a=1.0, v=1.0)",
    ]
    watched = Watched(firmware, motion=Still((-1.6, -1.72, -2.2, -0.8, 1.6, 0.03)), noise=False)
    watched.take("def f():\n" + "".join(f"  {line}\n" for line in lines) + "end\n").step(30)
    assert watched.story == ["started f", "stopped f"]
    assert watched.controller.modes.safety_mode is SafetyMode.NORMAL


def test_loop_that_takes_no_time_is_stopped(watched: Watched) -> None:
    watched.take("def f():\n  while True:\n    x = 1\n  end\nend\n").step(0.01)
    assert "too much time" in watched.story[1]
    assert watched.story[2] == "stopped f"


def test_flood_of_text_is_bounded_but_the_end_is_reported(watched: Watched) -> None:
    program = 'def f():\n  i = 0\n  while i < 1500:\n    textmsg("%s")\n    i = i + 1\n  end\nend\n' % ("x" * 500)
    watched.take(program)
    watched.controller.step()
    messages = watched.controller.take_messages()
    assert 16_000 < sum(map(len, messages)) < 18_000
    decoded = urlink.decode(b"".join(messages), "primary", "5.11")
    titles = [message.title for message in decoded if isinstance(message, urlink.packets.KeyMessage)]
    assert titles == ["PROGRAM_XXX_STARTED", "PROGRAM_XXX_STOPPED"]
    assert watched.controller.counters.lost_messages > 0


@pytest.mark.parametrize("text", ["ü" * 300, "\u20ac" * 200, "x" * 9000, "\\x00"])
@pytest.mark.parametrize("firmware", ["1.8", "5.11"])
def test_any_text_can_be_sent_as_message_and_popup(text: str, firmware: str) -> None:
    watched = Watched(firmware)
    watched.take(f'def f():\n  textmsg("{text}")\n  popup("{text}", "{text}")\nend\n').step(0.1)
    assert watched.story[0] == "started f"
    assert watched.story[2:] == ["PopupMessage", "stopped f"]


# -- lines and the dashboard ---------------------------------------------------------------------------


@pytest.mark.parametrize(("line", "speed"), [("0.42", 0.42), (".5", 0.5), ("1", 1.0), ("0", 0.0), ("7", 1.0)])
def test_set_speed_line_moves_the_slider(watched: Watched, line: str, speed: float) -> None:
    watched.take(f"set speed {line}\n")
    assert watched.controller.speed_fraction == speed


def test_slower_slider_makes_motions_slower() -> None:
    def seconds(*texts: str) -> float:
        watched = Watched()
        watched.take(*texts, TURN)
        while watched.controller.program_name:
            watched.cycle()
        return watched.controller.time

    assert seconds("set speed 0.5") == pytest.approx(2 * seconds(), rel=0.1)


@pytest.mark.parametrize(("firmware", "alone"), [("5.11", 0.0), ("3.3", 0.5)])
def test_slider_appears_in_speed_scaling(firmware: str, alone: float) -> None:
    watched = Watched(firmware)
    watched.take("set speed 0.5").step(0.1)

    def scaling() -> float:
        packet = watched.controller.realtime_packet()
        speed_scaling = urlink.decode(packet, "realtime", watched.controller.firmware)[0].speed_scaling
        assert speed_scaling is not None
        return speed_scaling

    assert scaling() == alone
    watched.take(WAIT).step(0.1)
    assert scaling() == 0.5


def test_power_lines_switch_the_arm_off_and_on(watched: Watched) -> None:
    watched.take("power off").step(0.1)
    assert watched.power() is Power.OFF
    watched.take("power on").step(2)
    assert watched.power() is Power.IDLE
    watched.take("set robotmode run").step(2)
    assert watched.power() is Power.RUNNING
    watched.controller.faults.protective_stop()
    watched.take("set unlock protective stop", "set robotmode freedrive").step(0.1)
    assert watched.controller.modes.may_move
    assert watched.story == []


def test_stop_program_line_stops_the_program(watched: Watched) -> None:
    watched.take(WAIT).step(0.1)
    watched.take("stop program", "stop  program").step(0.1)
    assert watched.story == ["started wait", "stopped wait"]


def test_local_control_refuses_programs_and_commands() -> None:
    watched = Watched(files={"a.urp": WAIT})
    watched.controller.remote_control = False
    watched.take(TURN, "set speed 0.5", "sec s():\n  set_digital_out(0, True)\nend\n", "def f(:\nend\n").step(0.1)
    assert watched.story == []
    assert watched.controller.counters.refused_programs == 4
    assert watched.controller.speed_fraction == 1.0
    assert watched.controller.signals.digital_outputs == 0
    for command in ("load a.urp", "play", "power off", "stop"):
        assert "remote control" in str(watched.dashboard(command)).lower()
    assert watched.controller.pendant.loaded is None


def test_cb3_has_no_local_control() -> None:
    watched = Watched(CB3)
    watched.controller.remote_control = False
    watched.take(WAIT).step(0.1)
    assert watched.story == ["started wait"]


def test_blocking_popup_blocks_its_program(watched: Watched) -> None:
    watched.take('def f():\n  popup("go on?", blocking=True)\n  textmsg("on")\nend\n').step(5)
    assert watched.story == ["started f", "PopupMessage"]
    assert watched.controller.pendant.popup == "go on?"
    watched.dashboard("close popup")
    watched.step(0.1)
    assert watched.story[2:] == ["'on'", "stopped f"]


def test_dashboard_commands_load_play_pause_and_stop_a_program() -> None:
    watched = Watched(files={"/programs/turn.urp": TURN, "bad.urp": "def f(:\nend\n"})
    assert watched.dashboard("play") == "Failed to execute: play"
    assert watched.dashboard("load nothing.urp") == "File not found: nothing.urp"
    assert watched.dashboard("load bad.urp") == "Loading program: bad.urp"
    assert watched.dashboard("play") == "Failed to execute: play"
    assert watched.dashboard("load /programs/turn.urp") == "Loading program: /programs/turn.urp"
    assert watched.dashboard("pause") == "Failed to execute: pause"
    assert watched.dashboard("play") == "Starting program"
    # No cycle has to pass before the state changes.
    assert watched.dashboard("programState") == "PLAYING turn.urp"
    assert watched.dashboard("play") == "Failed to execute: play"
    assert watched.dashboard("pause") == "Pausing program"
    assert watched.dashboard("programState") == "PAUSED turn.urp"
    watched.step(1)
    assert watched.dashboard("play") == "Starting program"
    assert watched.dashboard("running") == "Program running: true"
    watched.step(0.5)
    assert watched.moves()
    assert watched.dashboard("pause") == "Pausing program"
    watched.step(1)
    assert not watched.moves()
    assert watched.dashboard("stop") == "Stopped"
    assert watched.dashboard("programState") == "STOPPED turn.urp"
    assert watched.dashboard("stop") == "Stopped"
    assert watched.dashboard("play") == "Starting program"
    watched.step(6)
    assert watched.story == ["started turn", "stopped turn", "started turn", "stopped turn"]
    assert watched.controller.arm.setpoint.q[0] == pytest.approx(0.5, abs=1e-9)


def test_dashboard_load_ends_the_running_program() -> None:
    watched = Watched(files={"a.urp": WAIT})
    watched.take(SPIN).step(1)
    assert watched.dashboard("load a.urp") == "Loading program: a.urp"
    watched.step(1)
    assert watched.story == ["started spin", "stopped spin"]
    assert not watched.moves()


def test_dashboard_stop_ends_the_demonstration() -> None:
    watched = Watched(motion=Demonstration())
    watched.step(2)
    assert watched.dashboard("running") == "Program running: true"
    assert watched.dashboard("stop") == "Stopped"
    assert watched.dashboard("running") == "Program running: false"
    watched.step(1)
    assert not watched.moves()
    assert watched.story == []
    watched.step(3)
    assert not watched.moves()


def test_stop_program_line_ends_the_demonstration() -> None:
    # The UR Client Library sends this line over the primary interface before its own program.
    watched = Watched(motion=Demonstration())
    watched.step(2)
    assert watched.dashboard("programState") == "PLAYING <unnamed>"
    watched.take("stop program\n").step(1)
    assert watched.dashboard("programState") == "STOPPED <unnamed>"
    assert not watched.moves()
    assert watched.take(TURN).step(6).story == ["started turn", "stopped turn"]


# -- reproducibility -----------------------------------------------------------------------------------


@pytest.mark.parametrize("firmware", ["1.8", pytest.param("5.11", marks=pytest.mark.slow)])
def test_same_program_gives_the_same_bytes(firmware: str) -> None:
    program = (
        "def f():\n  thread blink():\n    while True:\n      set_digital_out(0, not get_digital_out(0))\n"
        "      sleep(0.1)\n    end\n  end\n  h = run blink()\n"
        "  movej([0.5, -1.2, 1.2, -1.2, -1.2, 0.3], a=1, v=0.5, r=0.05)\n"
        "  movej([0, -1.57, 1.57, -1.57, -1.57, random()], a=1, v=0.5)\n  kill h\n"
        "  movel(pose_trans(get_actual_tcp_pose(), p[0, 0, -0.05, 0, 0, 0]), a=1, v=0.2)\nend\n"
    )

    def record() -> bytes:
        controller = Controller(None, firmware, seed=7)
        controller.step(100)
        controller.take(program)
        packets = []
        for cycle in range(10 * controller.firmware.rate):
            if cycle % 97 == 0:
                controller.state_package()
            controller.step()
            packets.append(controller.realtime_packet())
        assert controller.arm.setpoint.q[0] != HOME[0]
        return b"".join(packets)

    assert record() == record()


_TEXTS = st.sampled_from(
    [
        TURN,
        SPIN,
        WAIT,
        "stopj(2)",
        "sec s():\n  set_digital_out(0, True)\nend\n",
        'sec p():\n  popup("x", blocking=True)\nend\n',
        "def bad():\n  nonsense()\nend\n",
        "def fails():\n  sleep(0.05)\n  x = 1/0\nend\n",
        "def jumps():\n  servoj([3, 0, 0, 0, 0, 0], t=0.002, lookahead_time=0.03, gain=2000)\nend\n",
        "def far():\n  movel(p[5, 0, 0, 0, 0, 0])\nend\n",
        "def brakes():\n  speedl([0.2, 0, 0, 0, 0, 0], 1, 0.1)\n  stopl(1)\nend\n",
        'def asks():\n  popup("x", blocking=True)\nend\n',
        'def dials():\n  socket_open("192.0.2.1", 9)\n  sleep(1)\nend\n',
        "def protects():\n  sleep(0.02)\n  protective_stop()\n  sleep(0.1)\nend\n",
        "set speed 0",
        "set speed 1",
        "power off",
        "power on",
        "set robotmode run",
        "set unlock protective stop",
        "end",
        "",
    ]
)
_LINES = st.sampled_from(
    ["play", "pause", "stop", "load a.urp", "power off", "power on", "brake release", "unlock protective stop",
     "close popup", "popup x", "restart safety", "shutdown", "programState", "running"]
)  # fmt: skip
_FAULTS = st.sampled_from(["protective_stop", "emergency_stop", "clear", "power_off", "power_on"])
_EVENTS = st.one_of(
    st.tuples(st.just("text"), _TEXTS),
    st.tuples(st.just("line"), _LINES),
    st.tuples(st.just("fault"), _FAULTS),
    st.tuples(st.just("wait"), st.sampled_from([1, 3, 40, 300])),
)


@pytest.mark.slow
@pytest.mark.property
@settings(max_examples=trials(15, 500))
@given(st.lists(_EVENTS, max_size=25), st.sampled_from(["1.8", "3.14", "5.11"]), st.booleans())
def test_every_started_program_is_reported_as_stopped(
    events: list[tuple[str, Any]], firmware: str, has_demonstration: bool
) -> None:
    motion = Demonstration() if has_demonstration else Still()
    watched = Watched(firmware, motion=motion, files={"a.urp": TURN})
    controller = watched.controller
    model = controller.model
    fastest = float(max(model.max_acceleration)) * 1.5
    for kind, what in events:
        if kind == "text":
            watched.take(what)
        elif kind == "line":
            watched.dashboard(what)
        elif kind == "fault":
            getattr(controller.faults, what)()
        else:
            for _ in range(what):
                watched.cycle()
        watched.listen()
        running = [line for line in watched.story if line.startswith(("started ", "stopped "))]
        for before, after in zip(running[::2], running[1::2], strict=False):
            assert before.startswith("started ")
            assert after == before.replace("started", "stopped")
        assert (len(running) % 2 == 1) == (controller.program_name is not None)
        if controller.program_name is not None:
            assert running[-1] == f"started {controller.program_name}"
    # Near a singularity the joints become faster and faster, until their speed limit stops the arm.
    is_near_singularity = any("a speed of" in line for line in watched.story)
    assert is_near_singularity or watched.steadiest < fastest
    controller._runner.close()
    assert controller.program_name is None

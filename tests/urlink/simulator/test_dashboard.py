"""The controller's side of the dashboard: what each command does on each firmware, and in which words it is refused."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.urlink.interfaces.dashboard_desk import FIRMWARES, StandIn
from urlink.interfaces.dashboard.commands import COMMANDS, NOT_IN_REMOTE_CONTROL
from urlink.interfaces.enums import SafetyMode
from urlink.simulator.dashboard import Responder
from urlink.simulator.modes import Power, Stop

ARGUMENTS = {
    "load": "pick.urp",
    "load installation": "default.installation",
    "popup": "hello",
    "addToLog": "hello",
    "setUserRole": "operator",
    "set operational mode": "manual",
    "generate flight report": "system",
    "generate support file": "programs/reports",
}


def line_of(name: str) -> str:
    return f"{name} {ARGUMENTS[name]}" if name in ARGUMENTS else name


def test_the_arguments_are_those_of_the_table() -> None:
    assert ARGUMENTS.keys() == {name for name, command in COMMANDS.items() if command.argument}


@pytest.mark.parametrize("firmware", FIRMWARES)
@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_on_every_firmware(name: str, firmware: str) -> None:
    host = StandIn.of(firmware)
    responder = Responder(host)
    if name in ("play", "pause", "stop"):
        host.load("pick.urp")
        host._set(name != "play")
    reply = responder.reply(line_of(name))
    command = COMMANDS[name]
    if not command.is_on(host.firmware):
        assert reply == f"could not understand: '{line_of(name)}'"
        assert command.is_refusal(reply)
    elif name == "quit":
        assert reply is None
    else:
        assert reply is not None
        assert command.match(reply)
        assert not command.is_refusal(reply)


def test_cb2_has_its_own_few() -> None:
    on = {
        firmware: {name for name, command in COMMANDS.items() if command.is_on(StandIn.of(firmware).firmware)}
        for firmware in ("1.6", "1.8")
    }
    assert on["1.6"] == {
        "load", "play", "stop", "pause", "quit", "shutdown",
        "running", "robotmode", "get loaded program", "popup", "close popup",
    }  # fmt: skip
    assert on["1.8"] - on["1.6"] == {"addToLog", "isProgramSaved", "programState", "PolyscopeVersion"}


def test_polyscope_x_has_none() -> None:
    assert not [name for name, command in COMMANDS.items() if command.is_on((10, 11))]


# -- remote control ------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", COMMANDS)
def test_an_e_series_in_local_mode_answers_questions_and_nothing_else(name: str) -> None:
    host = StandIn.of("5.11")
    host.remote_control = False
    reply = Responder(host).reply(line_of(name))
    if not COMMANDS[name].is_on(host.firmware) or name == "quit":
        return
    assert (reply == NOT_IN_REMOTE_CONTROL) == COMMANDS[name].needs_remote_control
    assert host.modes.power is Power.RUNNING
    assert host.loaded is None


@pytest.mark.parametrize("name", ["play", "load", "power on", "brake release", "unlock protective stop"])
def test_what_moves_the_arm_needs_remote_control(name: str) -> None:
    assert COMMANDS[name].needs_remote_control


def test_a_cb3_knows_no_local_mode() -> None:
    host = StandIn.of("3.14")
    host.remote_control = False
    assert Responder(host).reply("power off") == "Powering off"


# -- power and safety -----------------------------------------------------------------------------------


def test_from_power_off_to_running() -> None:
    host = StandIn.of("5.4")
    responder = Responder(host)
    assert responder.reply("power off") == "Powering off"
    host.wait(0.1)
    assert responder.reply("robotmode") == "Robotmode: POWER_OFF"
    assert responder.reply("power on") == "Powering on"
    assert responder.reply("robotmode") == "Robotmode: POWER_ON"
    host.wait(5)
    assert responder.reply("robotmode") == "Robotmode: IDLE"
    assert responder.reply("brake release") == "Brake releasing"
    host.wait(5)
    assert responder.reply("robotmode") == "Robotmode: RUNNING"


def test_power_on_twice_changes_nothing() -> None:
    host = StandIn.of("5.4")
    responder = Responder(host)
    responder.reply("power on")
    host.wait(5)
    assert responder.reply("robotmode") == "Robotmode: RUNNING"


def test_brake_release_powers_on() -> None:
    host = StandIn.of("3.0")
    host.modes.power_off()
    host.wait(0.1)
    Responder(host).reply("brake release")
    host.wait(5)
    assert host.modes.power is Power.RUNNING


def test_cb2_says_its_mode_as_a_number() -> None:
    host = StandIn.of("1.8")
    responder = Responder(host)
    assert responder.reply("robotmode") == "Robotmode: 0"
    host.protective_stop()
    assert responder.reply("robotmode") == "Robotmode: 4"


def test_a_protective_stop_is_unlocked_after_five_seconds() -> None:
    host = StandIn.of("5.11")
    responder = Responder(host)
    host.protective_stop()
    host.popup = "Protective stop"
    assert responder.reply("safetymode") == "Safetymode: PROTECTIVE_STOP"
    host.time += 4.99
    refused = responder.reply("unlock protective stop")
    assert refused is not None
    assert refused.startswith("Cannot unlock protective stop until 5s after occurrence. ")
    assert COMMANDS["unlock protective stop"].is_refusal(refused)
    assert responder.reply("safetystatus") == "Safetystatus: PROTECTIVE_STOP"
    host.time += 0.02
    assert responder.reply("unlock protective stop") == "Protective stop releasing"
    assert host.modes.stop is Stop.NONE
    assert host.popup is None


def test_an_emergency_stop_is_not_unlocked() -> None:
    host = StandIn.of("5.11")
    responder = Responder(host)
    host.modes.emergency_stop()
    host.wait(10)
    responder.reply("unlock protective stop")
    responder.reply("restart safety")
    responder.reply("power on")
    host.wait(5)
    assert host.modes.safety_mode is SafetyMode.ROBOT_EMERGENCY_STOP
    assert host.modes.power is Power.OFF


def test_restart_safety_leaves_the_arm_off() -> None:
    host = StandIn.of("5.11")
    host.protective_stop()
    Responder(host).reply("restart safety")
    host.wait(0.1)
    assert (host.modes.stop, host.modes.power) == (Stop.NONE, Power.OFF)


# -- programs --------------------------------------------------------------------------------------------


def test_load_play_pause_stop() -> None:
    host = StandIn.of("5.4")
    responder = Responder(host)
    assert responder.reply("get loaded program") == "No program loaded"
    assert responder.reply("programState") == "STOPPED <unnamed>"  # as a real 5.4 says
    assert responder.reply("running") == "Program running: false"  # likewise
    assert responder.reply("play") == "Failed to execute: play"
    assert responder.reply("pause") == "Failed to execute: pause"
    assert responder.reply("stop") == "Failed to execute: stop"
    assert responder.reply("load nothing.urp") == "File not found: nothing.urp"
    assert responder.reply("load /programs/place it.urp") == "Loading program: /programs/place it.urp"
    assert responder.reply("get loaded program") == "Loaded program: /programs/place it.urp"
    assert responder.reply("play") == "Starting program"
    assert responder.reply("running") == "Program running: true"
    assert responder.reply("programState") == "PLAYING place it.urp"
    host.protective_stop()
    assert responder.reply("programState") == "PAUSED place it.urp"
    host.modes.clear()
    assert responder.reply("stop") == "Stopped"
    assert responder.reply("isProgramSaved") == "true place it.urp"


def test_power_off_stops_a_program_from_being_played() -> None:
    host = StandIn.of("5.4")
    host.load("pick.urp")
    host.modes.power_off()
    host.wait(0.1)
    assert Responder(host).reply("play") == "Failed to execute: play"


# -- the rest ----------------------------------------------------------------------------------------------


def test_popup_and_log() -> None:
    host = StandIn.of("5.4")
    responder = Responder(host)
    popups = []
    for line in ("popup two  blanks, and Ümlaut", "close popup"):
        responder.reply(line)
        popups.append(host.popup)
    assert popups == ["two  blanks, and Ümlaut", None]
    responder.reply("addToLog something")
    assert responder.reply("addToLog") == "No log message to add"
    assert host.log == ["something"]
    for number in range(1200):
        responder.reply(f"addToLog {number}")
    assert (len(host.log), host.log[-1]) == (1000, "1199")


def test_user_role() -> None:
    responder = Responder(StandIn.of("3.4"))
    assert responder.reply("getUserRole") == "NONE"
    assert responder.reply("setUserRole operator") == "Setting user role: operator"
    assert responder.reply("getUserRole") == "OPERATOR"
    assert responder.reply("setUserRole king") == "Failed setting user role: king"
    assert responder.reply("setUserRole") == "Setting user role: none"
    assert responder.user_role == "none"


def test_operational_mode() -> None:
    responder = Responder(StandIn.of("5.6"))
    assert responder.reply("get operational mode") == "NONE"
    assert responder.reply("set operational mode automatic") == "Operational mode AUTOMATIC is set"
    assert responder.reply("get operational mode") == "AUTOMATIC"
    responder.reply("set operational mode none")
    assert responder.reply("get operational mode") == "AUTOMATIC"
    responder.reply("clear operational mode")
    assert responder.operational_mode == "none"


def test_who_it_is() -> None:
    responder = Responder(StandIn.of("5.11"))
    assert responder.reply("get robot model") == "UR5"
    assert responder.reply("get serial number") == "20215500001"
    assert responder.reply("version") == "5.11.0.0"
    assert str(responder.reply("PolyscopeVersion")).startswith("URSoftware 5.11.0.0 (")


def test_upper_and_lower_case_are_alike() -> None:
    responder = Responder(StandIn.of("5.11"))
    assert responder.reply("ROBOTMODE") == responder.reply(" robotmode\r") == "Robotmode: RUNNING"


def test_load_installation_is_not_load() -> None:
    host = StandIn.of("5.11")
    responder = Responder(host)
    assert responder.reply("load installation a.installation") == "Loading installation: a.installation"
    assert (host.loaded, responder.installation) == (None, "a.installation")
    # Firmware without it takes it for the name of a program, or does not know it; nobody knows which.
    assert Responder(StandIn.of("3.0")).reply("load installation a") == "could not understand: 'load installation a'"


@pytest.mark.parametrize("line", ["", "dance", "powerup", "play it", "stopp", "popupx", "loadpick.urp"])
def test_what_is_no_command(line: str) -> None:
    assert Responder(StandIn.of("5.11")).reply(line) == f"could not understand: '{line}'"


@pytest.mark.property
@given(st.text() | st.builds("{} {}".format, st.sampled_from(sorted(COMMANDS)), st.text()), st.sampled_from(FIRMWARES))
def test_any_line_is_answered_with_one_line_or_ends_the_connection(line: str, firmware: str) -> None:
    host = StandIn.of(firmware)
    host.files = (line.partition(" ")[2],)
    reply = Responder(host).reply(line)
    if reply is None:
        assert line.strip().lower() == "quit"
    else:
        assert len(reply.splitlines()) == 1

"""Controller side of the dashboard: the effect of each command on each firmware, and its refusals."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.fakes.dashboard import FIRMWARES, play, protective_stop, stepped, wait
from urlink.protocol.dashboard.commands import COMMANDS, NOT_IN_REMOTE_CONTROL
from urlink.protocol.enums import SafetyMode
from urlink.simulator import Demonstration
from urlink.simulator.robot.modes import Power, StopState

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


def test_every_command_with_an_argument_has_a_sample() -> None:
    assert ARGUMENTS.keys() == {name for name, command in COMMANDS.items() if command.argument}


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_replies_as_its_firmware(name: str) -> None:
    for firmware in FIRMWARES:
        host = stepped(firmware)
        dashboard = host.dashboard
        if name in ("pause", "stop"):
            play(host)
        elif name == "play":
            host.pendant.load("pick.urp")
        reply = dashboard.reply(line_of(name))
        command = COMMANDS[name]
        if not command.is_on(host.firmware):
            assert reply == f"could not understand: '{line_of(name)}'", firmware
            assert command.is_refusal(reply), firmware
        elif name == "quit":
            assert reply is None, firmware
        else:
            assert reply is not None, firmware
            assert command.match(reply), (firmware, reply)
            assert not command.is_refusal(reply), (firmware, reply)


def test_cb2_supports_only_a_few_commands() -> None:
    on = {
        firmware: {name for name, command in COMMANDS.items() if command.is_on(stepped(firmware).firmware)}
        for firmware in ("1.6", "1.8")
    }
    assert on["1.6"] == {
        "load", "play", "stop", "pause", "quit", "shutdown",
        "running", "robotmode", "get loaded program", "popup", "close popup",
    }  # fmt: skip
    assert on["1.8"] - on["1.6"] == {"addToLog", "isProgramSaved", "programState", "PolyscopeVersion"}


def test_polyscope_x_supports_no_commands() -> None:
    assert not [name for name, command in COMMANDS.items() if command.is_on((10, 11))]


# -- remote control ------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", COMMANDS)
def test_e_series_in_local_mode_answers_only_queries(name: str) -> None:
    host = stepped("5.11")
    host.remote_control = False
    reply = host.dashboard.reply(line_of(name))
    if not COMMANDS[name].is_on(host.firmware) or name == "quit":
        return
    assert (reply == NOT_IN_REMOTE_CONTROL) == COMMANDS[name].needs_remote_control
    assert host.modes.power is Power.RUNNING
    assert host.pendant.loaded is None


@pytest.mark.parametrize("name", ["play", "load", "power on", "brake release", "unlock protective stop"])
def test_moving_and_power_commands_need_remote_control(name: str) -> None:
    assert COMMANDS[name].needs_remote_control


def test_cb3_ignores_local_mode() -> None:
    host = stepped("3.14")
    host.remote_control = False
    assert host.dashboard.reply("power off") == "Powering off"


# -- power and safety -----------------------------------------------------------------------------------


def test_power_on_and_brake_release_reach_running() -> None:
    host = stepped("5.4")
    dashboard = host.dashboard
    assert dashboard.reply("power off") == "Powering off"
    wait(host, 0.1)
    assert dashboard.reply("robotmode") == "Robotmode: POWER_OFF"
    assert dashboard.reply("power on") == "Powering on"
    assert dashboard.reply("robotmode") == "Robotmode: POWER_ON"
    wait(host, 5)
    assert dashboard.reply("robotmode") == "Robotmode: IDLE"
    assert dashboard.reply("brake release") == "Brake releasing"
    wait(host, 5)
    assert dashboard.reply("robotmode") == "Robotmode: RUNNING"


def test_power_on_while_running_has_no_effect() -> None:
    host = stepped("5.4")
    dashboard = host.dashboard
    dashboard.reply("power on")
    wait(host, 5)
    assert dashboard.reply("robotmode") == "Robotmode: RUNNING"


@pytest.mark.parametrize(
    ("lines", "reached"),
    [
        (["power off", "power on", "brake release"], Power.RUNNING),
        (["power off", "power on"], Power.IDLE),
        (["power off", "brake release"], Power.RUNNING),
        (["power off", "brake release", "power on"], Power.RUNNING),
        (["power off", "power on", "power off"], Power.OFF),
        (["power off", "power off", "power on", "power on"], Power.IDLE),
        (["restart safety", "power on", "brake release"], Power.RUNNING),
        (["brake release", "power on"], Power.RUNNING),
    ],
)
def test_power_commands_are_executed_in_order(lines: list[str], reached: Power) -> None:
    """The vendor's client sends the next command while the arm still brakes for `power off`."""
    host = stepped("5.11")
    host.follow(Demonstration())
    wait(host, 2)
    assert any(host.arm.setpoint.qd)
    seen = [host.modes.power]
    for line in lines:
        host.dashboard.reply(line)
    for _ in range(2 * host.firmware.rate):
        host.step()
        if host.modes.power is not seen[-1]:
            seen.append(host.modes.power)
    begun = [] if "off" not in lines[0] and "safety" not in lines[0] else [Power.OFF, Power.BOOTING, Power.IDLE]
    assert (
        seen
        == {
            Power.RUNNING: [Power.RUNNING, *begun, Power.RUNNING] if begun else [Power.RUNNING],
            Power.IDLE: [Power.RUNNING, *begun],
            Power.OFF: [Power.RUNNING, Power.OFF],
        }[reached]
    )


def test_emergency_stop_cancels_a_pending_power_on() -> None:
    host = stepped("5.11")
    host.dashboard.reply("power off")
    host.dashboard.reply("brake release")
    host.modes.emergency_stop()
    wait(host, 0.1)
    host.modes.clear()
    wait(host, 5)
    assert host.modes.power is Power.OFF


def test_brake_release_also_powers_on() -> None:
    host = stepped("3.0")
    host.modes.power_off()
    wait(host, 0.1)
    host.dashboard.reply("brake release")
    wait(host, 5)
    assert host.modes.power is Power.RUNNING


def test_cb2_reports_its_mode_as_a_number() -> None:
    host = stepped("1.8")
    dashboard = host.dashboard
    assert dashboard.reply("robotmode") == "Robotmode: 0"
    protective_stop(host)
    assert dashboard.reply("robotmode") == "Robotmode: 4"


def test_protective_stop_unlocks_only_after_five_seconds() -> None:
    host = stepped("5.11")
    dashboard = host.dashboard
    protective_stop(host)
    host.pendant.popup = "Protective stop"
    assert dashboard.reply("safetymode") == "Safetymode: PROTECTIVE_STOP"
    wait(host, 4.98)
    refused = dashboard.reply("unlock protective stop")
    assert refused is not None
    assert refused.startswith("Cannot unlock protective stop until 5s after occurrence. ")
    assert COMMANDS["unlock protective stop"].is_refusal(refused)
    assert dashboard.reply("safetystatus") == "Safetystatus: PROTECTIVE_STOP"
    wait(host, 0.02)
    assert dashboard.reply("unlock protective stop") == "Protective stop releasing"
    assert host.modes.stop is StopState.NONE
    assert host.pendant.popup is None


def test_emergency_stop_cannot_be_unlocked() -> None:
    host = stepped("5.11")
    dashboard = host.dashboard
    host.modes.emergency_stop()
    wait(host, 10)
    dashboard.reply("unlock protective stop")
    dashboard.reply("restart safety")
    dashboard.reply("power on")
    wait(host, 5)
    assert host.modes.safety_mode is SafetyMode.ROBOT_EMERGENCY_STOP
    assert host.modes.power is Power.OFF


def test_restart_safety_leaves_the_arm_off() -> None:
    host = stepped("5.11")
    protective_stop(host)
    host.dashboard.reply("restart safety")
    wait(host, 0.1)
    assert (host.modes.stop, host.modes.power) == (StopState.NONE, Power.OFF)


# -- programs --------------------------------------------------------------------------------------------


def test_dashboard_loads_plays_pauses_and_stops_a_program() -> None:
    host = stepped("5.4")
    dashboard = host.dashboard
    assert dashboard.reply("get loaded program") == "No program loaded"
    assert dashboard.reply("programState") == "STOPPED <unnamed>"  # reply of a real 5.4
    assert dashboard.reply("running") == "Program running: false"  # reply of a real 5.4
    assert dashboard.reply("play") == "Failed to execute: play"
    assert dashboard.reply("pause") == "Failed to execute: pause"
    assert dashboard.reply("stop") == "Stopped"  # reply of a real 5.4; other clients depend on it
    assert dashboard.reply("load nothing.urp") == "File not found: nothing.urp"
    assert dashboard.reply("load /programs/place it.urp") == "Loading program: /programs/place it.urp"
    assert dashboard.reply("get loaded program") == "Loaded program: /programs/place it.urp"
    assert dashboard.reply("play") == "Starting program"
    assert dashboard.reply("running") == "Program running: true"
    assert dashboard.reply("programState") == "PLAYING place it.urp"
    protective_stop(host)
    assert dashboard.reply("programState") == "PAUSED place it.urp"
    host.modes.clear()
    assert dashboard.reply("stop") == "Stopped"
    assert dashboard.reply("isProgramSaved") == "true place it.urp"


def test_play_fails_when_powered_off() -> None:
    host = stepped("5.4")
    host.pendant.load("pick.urp")
    host.modes.power_off()
    wait(host, 0.1)
    assert host.dashboard.reply("play") == "Failed to execute: play"


# -- the rest ----------------------------------------------------------------------------------------------


def test_popup_and_log_are_stored() -> None:
    host = stepped("5.4")
    dashboard = host.dashboard
    popups = []
    for line in ("popup two  blanks, and Ümlaut", "close popup"):
        dashboard.reply(line)
        popups.append(host.pendant.popup)
    assert popups == ["two  blanks, and Ümlaut", None]
    dashboard.reply("addToLog something")
    assert dashboard.reply("addToLog") == "No log message to add"
    assert host.pendant.log == ["something"]
    for number in range(1200):
        dashboard.reply(f"addToLog {number}")
    assert (len(host.pendant.log), host.pendant.log[-1]) == (1000, "1199")


def test_user_role_is_set_and_reported() -> None:
    dashboard = stepped("3.4").dashboard
    assert dashboard.reply("getUserRole") == "NONE"
    assert dashboard.reply("setUserRole operator") == "Setting user role: operator"
    assert dashboard.reply("getUserRole") == "OPERATOR"
    assert dashboard.reply("setUserRole king") == "Failed setting user role: king"
    assert dashboard.reply("setUserRole") == "Setting user role: none"
    assert dashboard.user_role == "none"


def test_operational_mode_is_set_and_cleared() -> None:
    dashboard = stepped("5.6").dashboard
    assert dashboard.reply("get operational mode") == "NONE"
    assert dashboard.reply("set operational mode automatic") == "Operational mode AUTOMATIC is set"
    assert dashboard.reply("get operational mode") == "AUTOMATIC"
    dashboard.reply("set operational mode none")
    assert dashboard.reply("get operational mode") == "AUTOMATIC"
    dashboard.reply("clear operational mode")
    assert dashboard.operational_mode == "none"


def test_model_serial_number_and_version_are_reported() -> None:
    dashboard = stepped("5.11").dashboard
    assert dashboard.reply("get robot model") == "UR5"
    assert dashboard.reply("get serial number") == "20215500001"
    assert dashboard.reply("version") == "5.11.0.0"
    assert str(dashboard.reply("PolyscopeVersion")).startswith("URSoftware 5.11.0.0 (")


def test_flight_reports_are_numbered() -> None:
    dashboard = stepped("5.11").dashboard
    assert dashboard.reply("generate flight report system") == "Flight Report generated with id: 1"
    # The vendor's client sends the command without an argument.
    assert dashboard.reply("generate flight report") == "Flight Report generated with id: 2"
    assert dashboard.reply("generate flight report me") == "could not understand: 'generate flight report me'"


def test_commands_ignore_case_and_surrounding_blanks() -> None:
    dashboard = stepped("5.11").dashboard
    assert dashboard.reply("ROBOTMODE") == dashboard.reply(" robotmode\r") == "Robotmode: RUNNING"


def test_load_installation_does_not_load_a_program() -> None:
    host = stepped("5.11")
    dashboard = host.dashboard
    assert dashboard.reply("load installation a.installation") == "Loading installation: a.installation"
    assert (host.pendant.loaded, dashboard.installation) == (None, "a.installation")
    # Older firmware might take this text as a program name instead, or might not know it (not verified).
    assert stepped("3.0").dashboard.reply("load installation a") == "could not understand: 'load installation a'"


@pytest.mark.parametrize("line", ["", "dance", "powerup", "play it", "stopp", "popupx", "loadpick.urp"])
def test_unknown_command_is_not_understood(line: str) -> None:
    assert stepped("5.11").dashboard.reply(line) == f"could not understand: '{line}'"


@pytest.mark.property
@given(st.text() | st.builds("{} {}".format, st.sampled_from(sorted(COMMANDS)), st.text()), st.sampled_from(FIRMWARES))
def test_any_line_gets_one_reply_line_or_ends_the_connection(line: str, firmware: str) -> None:
    host = stepped(firmware)
    host.pendant.files[line.partition(" ")[2].strip()] = "sync()"
    reply = host.dashboard.reply(line)
    if reply is None:
        assert line.strip().lower() == "quit"
    else:
        assert len(reply.splitlines()) == 1

"""Dashboard protocol without a network: greeting, commands, replies, and parsed replies."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from functools import partial

import pytest
from hypothesis import given
from hypothesis import strategies as st

from linkcore.errors import BadValue, LinkError, LocalError, PacketError, WrongPeer
from urlink.protocol.dashboard.commands import COMMANDS, GREETING
from urlink.protocol.dashboard.protocol import (
    LONGEST_COMMAND,
    LONGEST_REPLY,
    DashboardProtocol,
    ProgramStatus,
    SavedProgram,
    command_line,
    encode_line,
    parse_is_program_saved,
    parse_loaded_program,
    parse_operational_mode,
    parse_program_state,
    parse_robot_mode,
    parse_safety_mode,
    parse_text,
    parse_truth,
    parse_user_role,
)
from urlink.protocol.enums import ProgramState, RobotMode, RobotModeCB2, SafetyMode
from urlink.protocol.headers import DASHBOARD_GREETING

HELLO = GREETING.encode() + b"\n"


def greeted() -> DashboardProtocol:
    protocol = DashboardProtocol()
    assert protocol.feed(HELLO) is None
    assert protocol.is_in_step
    return protocol


# -- lines ---------------------------------------------------------------------------------------------


def test_greeting_equals_that_of_a_real_controller() -> None:
    assert GREETING == "Connected: Universal Robots Dashboard Server"
    assert GREETING.encode().startswith(DASHBOARD_GREETING)


def test_dashboard_protocol_returns_the_reply_to_each_command() -> None:
    protocol = greeted()
    assert protocol.ask("robotmode") == b"robotmode\n"
    assert protocol.feed(b"Robotmode: IDLE\r\n") == "Robotmode: IDLE"
    assert protocol.is_in_step
    assert protocol.ask("running") == b"running\n"
    assert protocol.feed(b"Program running: ") is None
    assert protocol.feed(b"true\n") == "Program running: true"


def test_bytewise_input_gives_same_reply() -> None:
    protocol = DashboardProtocol()
    for byte in HELLO[:-1]:
        protocol.feed(bytes([byte]))
        assert not protocol.is_greeted
    protocol.feed(b"\n")
    protocol.ask("running")
    replies = [protocol.feed(bytes([byte])) for byte in b"Program running: true\n"]
    assert replies == [None] * 21 + ["Program running: true"]


@pytest.mark.parametrize("begin", [b"HTTP/1.1 400", b"\x00\x00\x05\x61\x14", b"connected", b"Connected\n", b"\n"])
def test_wrong_greeting_raises_wrong_peer(begin: bytes) -> None:
    with pytest.raises(WrongPeer, match="expected the greeting of a dashboard server"):
        DashboardProtocol().feed(begin)


@pytest.mark.parametrize("size", [LONGEST_REPLY, LONGEST_REPLY + 1])
def test_too_long_line_raises_wrong_peer(size: int) -> None:
    """The limit applies to the greeting, to a reply, and to unrequested data."""
    hello = HELLO[:-1].ljust(size, b"!")
    asked = greeted()
    asked.ask("popup x")
    cases: list[tuple[DashboardProtocol, bytes]] = [(DashboardProtocol(), hello), (asked, b"!" * size)]
    cases.append((greeted(), b"!" * size))
    for protocol, data in cases:
        if size > LONGEST_REPLY:
            with pytest.raises(WrongPeer, match="too long for a reply"):
                protocol.feed(data)
        else:
            assert protocol.feed(data) is None


def test_invalid_utf8_is_shown_as_escape() -> None:
    protocol = greeted()
    protocol.ask("get serial number")
    assert protocol.feed(b"20\xff21\n") == "20\\xff21"


def test_command_before_greeting_or_reply_is_out_of_step() -> None:
    protocol = DashboardProtocol()
    with pytest.raises(LocalError, match="out of step"):
        protocol.ask("running")
    protocol.feed(HELLO)
    protocol.ask("running")
    with pytest.raises(LocalError, match="out of step"):
        protocol.ask("running")


@pytest.mark.parametrize("unasked", [b"Safetymode: NORMAL\n", b"S"])
def test_unrequested_data_puts_protocol_out_of_step(unasked: bytes) -> None:
    protocol = greeted()
    protocol.ask("running")
    assert protocol.feed(b"Program running: true\n" + unasked) == "Program running: true"
    assert not protocol.is_in_step
    protocol = greeted()
    assert protocol.feed(unasked) is None
    assert not protocol.is_in_step
    assert not (lambda p: p.feed(HELLO + unasked) or p.is_in_step)(DashboardProtocol())


@pytest.mark.parametrize(
    "text", ["", "  ", "a\nb", "a\n", "a\rb", "a\x00", "a\x85b", "a\u2028b", "a\u2029b", "\ud800", "x" * 1025]
)
def test_text_that_is_not_one_line_is_rejected(text: str) -> None:
    with pytest.raises(BadValue):
        encode_line(text)
    with pytest.raises(BadValue):
        command_line(COMMANDS["popup"], text)
    protocol = greeted()
    with pytest.raises(BadValue):
        protocol.ask(text)
    assert protocol.is_in_step


def test_longest_line_is_accepted() -> None:
    assert encode_line("x" * LONGEST_COMMAND) == b"x" * LONGEST_COMMAND + b"\n"
    with pytest.raises(BadValue, match="1025 bytes"):
        encode_line("x" * 1023 + "ü")


def test_arguments_of_commands_are_checked() -> None:
    assert command_line(COMMANDS["play"]) == "play"
    assert command_line(COMMANDS["setUserRole"], "operator") == "setUserRole operator"
    with pytest.raises(BadValue, match="has no argument"):
        command_line(COMMANDS["play"], "x")
    with pytest.raises(BadValue, match="'load' needs a path; got None"):
        command_line(COMMANDS["load"])
    with pytest.raises(BadValue, match=r"is 'king'; expected one of 'programmer', 'operator'"):
        command_line(COMMANDS["setUserRole"], "king")


# -- replies -------------------------------------------------------------------------------------------

REPLIES: list[tuple[Callable[[], object], object]] = [
    (lambda: parse_truth("running", "Program running: true"), True),
    (lambda: parse_truth("running", "Robot running: False"), False),
    (lambda: parse_truth("is in remote control", "TRUE"), True),
    (lambda: parse_robot_mode("Robotmode: POWER_OFF"), RobotMode.POWER_OFF),
    (lambda: parse_robot_mode("robotmode: updating_firmware"), RobotMode.UPDATING_FIRMWARE),
    (lambda: parse_robot_mode("Robotmode: 7", is_cb2=True), RobotModeCB2.NO_POWER),
    (lambda: parse_robot_mode("-1", is_cb2=True), RobotModeCB2(-1)),
    (lambda: parse_robot_mode("Robotmode: READY", is_cb2=True), RobotModeCB2.READY),
    (lambda: parse_safety_mode("safetymode", "safety mode: PROTECTIVE_STOP"), SafetyMode.PROTECTIVE_STOP),
    (
        lambda: parse_safety_mode("safetystatus", "Safetystatus: AUTOMATIC_MODE_SAFEGUARD_STOP"),
        SafetyMode.AUTOMATIC_MODE_SAFEGUARD_STOP,
    ),
    (lambda: parse_program_state("PAUSED a b.urp"), ProgramStatus(ProgramState.PAUSED, "a b.urp")),
    (lambda: parse_program_state("STOPPED"), ProgramStatus(ProgramState.STOPPED, None)),
    (lambda: parse_is_program_saved("false <unnamed>"), SavedProgram(False, "<unnamed>")),
    (lambda: parse_is_program_saved("True"), SavedProgram(True, None)),
    (lambda: parse_loaded_program("Loaded program: /programs/a b.urp"), "/programs/a b.urp"),
    (lambda: parse_loaded_program("Program loaded: /programs/a.urp"), "/programs/a.urp"),
    (lambda: parse_loaded_program("No program loaded"), None),
    (lambda: parse_operational_mode("AUTOMATIC"), "automatic"),
    (lambda: parse_user_role("LOCKED"), "locked"),
    (lambda: parse_text("PolyscopeVersion", "3.0.15547"), "3.0.15547"),
    (lambda: parse_text("version", "5.4.0.76837"), "5.4.0.76837"),
    (lambda: parse_text("get serial number", "20195501234"), "20195501234"),
    (lambda: parse_text("get robot model", "UR16"), "UR16"),
    (lambda: parse_text("get robot model", "UR8 Long"), "UR8 Long"),
    (lambda: parse_text("generate flight report", "Flight Report generated with id: 42"), "42"),
    (lambda: parse_text("generate support file", "Completed successfully: a b.zip"), "a b.zip"),
]


@pytest.mark.parametrize(("parse", "value"), REPLIES)
def test_replies_are_parsed(parse: Callable[[], object], value: object) -> None:
    assert parse() == value


TEXTS = [
    "PolyscopeVersion",
    "version",
    "get serial number",
    "get robot model",
    "generate flight report",
    "generate support file",
]
PARSERS: list[Callable[[str], object]] = [
    lambda reply: parse_truth("running", reply),
    lambda reply: parse_truth("is in remote control", reply),
    parse_robot_mode,
    lambda reply: parse_robot_mode(reply, is_cb2=True),
    lambda reply: parse_safety_mode("safetymode", reply),
    lambda reply: parse_safety_mode("safetystatus", reply),
    parse_program_state,
    parse_is_program_saved,
    parse_loaded_program,
    parse_operational_mode,
    parse_user_role,
    *(partial(parse_text, name) for name in TEXTS),
]


@pytest.mark.parametrize("parse", PARSERS)
@pytest.mark.parametrize("reply", ["", "could not understand: 'x'", "Robotmode: DANCING_BEAR", "Safetymode: FINE"])
def test_unexpected_reply_raises_packet_error(parse: Callable[[str], object], reply: str) -> None:
    with pytest.raises(PacketError, match="is not a known reply"):
        parse(reply)


@pytest.mark.parametrize("name", COMMANDS)
def test_refusals_do_not_match_success_replies(name: str) -> None:
    """Otherwise a reply would be ambiguous."""
    command = COMMANDS[name]
    for refusal in (*command.refusals, "could not understand: 'x'", "Failed to execute: x"):
        assert command.match(refusal) is None
    for refusal in command.refusals:
        assert command.is_refusal(refusal.upper() + " x")


@pytest.mark.property
@given(st.lists(st.binary(max_size=30)), st.booleans())
def test_result_of_dashboard_bytes_does_not_depend_on_chunking(pieces: list[bytes], is_greeted: bool) -> None:
    """Any bytes give a line or a documented error."""

    def outcome(chunks: list[bytes]) -> tuple[str | None, type[LinkError] | None]:
        protocol, reply = DashboardProtocol(), None
        try:
            if is_greeted:
                protocol.feed(HELLO)
                protocol.ask("running")
            for chunk in chunks:
                reply = protocol.feed(chunk) or reply
        except LinkError as error:
            return reply, type(error)
        return reply, None

    data = b"".join(pieces)
    whole = outcome([data])
    assert whole[1] in (None, WrongPeer)
    assert outcome(pieces) == whole == outcome([data[at : at + 1] for at in range(len(data))])


@pytest.mark.property
@given(st.text(max_size=60), st.sampled_from([name for name in COMMANDS if COMMANDS[name].argument]))
def test_any_text_gives_one_line_or_bad_value(text: str, name: str) -> None:
    try:
        line = encode_line(command_line(COMMANDS[name], text))
    except BadValue:
        return
    assert line.endswith(b"\n")
    assert len(line.decode().splitlines()) == 1
    assert line.decode().startswith(f"{name} {text}")


@pytest.mark.property
@given(
    st.text(max_size=60)
    | st.builds("{}{}".format, st.sampled_from(["Robotmode: ", "Safetymode: ", "STOPPED ", "true"]), st.text()),
    st.sampled_from(PARSERS),
)
def test_any_reply_gives_value_or_packet_error(reply: str, parse: Callable[[str], object]) -> None:
    with contextlib.suppress(PacketError):
        parse(reply)

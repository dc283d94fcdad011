"""Dashboard client of a user, with a TCP server that answers like a controller or misbehaves."""

from __future__ import annotations

import contextlib
import pickle
import select
import socket
import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from linkcore.errors import (
    BadValue,
    Closed,
    ConnectFailed,
    ConnectionLost,
    LinkError,
    LinkTimeout,
    LocalError,
    PacketError,
    RemoteError,
    WrongPeer,
)
from linkcore.net.dialogue import Dialogue
from tests.fakes.dashboard import FIRMWARES, TIMEOUT, ScriptedDashboard, play, protective_stop, stepped, wait
from tests.listed import assert_listed
from tests.waiting import threads_named
from tests.witnesses import sockets_made
from urlink.protocol.dashboard.client import Dashboard
from urlink.protocol.dashboard.commands import COMMANDS, GREETING, NOT_IN_REMOTE_CONTROL, DashboardRefused
from urlink.protocol.dashboard.protocol import ProgramStatus, SavedProgram
from urlink.protocol.enums import ProgramState, RobotMode, RobotModeCB2, SafetyMode
from urlink.protocol.firmware import Firmware
from urlink.simulator import Controller
from urlink.simulator.robot.modes import Power

pytestmark = pytest.mark.simulated_time

#: Timeout in seconds: short enough for a test to wait for it, and much longer than a reply takes.
SHORT = 0.3

Opened = Callable[..., tuple[ScriptedDashboard, Dashboard]]


@pytest.fixture
def opened() -> Iterator[Opened]:
    """Return a function that creates a scripted server and a dashboard for it; both are closed after the test."""
    made: list[Any] = []

    def opened(
        answer: Callable[[str], bytes | None], firmware: str = "5.11", timeout: float = TIMEOUT, **options: Any
    ) -> tuple[ScriptedDashboard, Dashboard]:
        desk = ScriptedDashboard(answer, **options)
        made.append(desk)
        dashboard = Dashboard("127.0.0.1", desk.port, lambda: Firmware.parse(firmware), timeout=timeout)
        made.append(dashboard)
        return desk, dashboard

    yield opened
    for each in reversed(made):
        each.close()


def answering(host: Controller) -> Callable[[str], bytes]:
    """Return a function that gives the replies of a simulated controller."""

    def answer(line: str) -> bytes:
        reply = host.dashboard.reply(line)
        return b"Disconnected\n" if reply is None else reply.encode() + b"\n"

    return answer


def saying(reply: bytes | None) -> Callable[[str], bytes | None]:
    return lambda line: reply


def nowhere(firmware: str) -> Dashboard:
    """Return a dashboard that fails with a different error if it tries to connect."""
    return Dashboard("no-such-host.invalid", 29999, lambda: Firmware.parse(firmware))


def has_come(connection: socket.socket) -> bool:
    """Wait until data can be received, or the connection has ended."""
    return bool(select.select([connection], [], [], TIMEOUT)[0])


# -- every command ---------------------------------------------------------------------------------------

#: For each command: the call, and its result on a controller that has just started.
CALLS: dict[str, tuple[Callable[[Dashboard], object], object]] = {
    "load": (lambda d: d.load("pick.urp"), None),
    "play": (lambda d: d.play(), None),
    "stop": (lambda d: d.stop(), None),
    "pause": (lambda d: d.pause(), None),
    "quit": (lambda d: d.quit(), None),
    "shutdown": (lambda d: d.shutdown(), None),
    "running": (lambda d: d.running(), True),
    "robotmode": (lambda d: d.robot_mode().name, "RUNNING"),
    "get loaded program": (lambda d: d.loaded_program(), "pick.urp"),
    "popup": (lambda d: d.popup("hello"), None),
    "close popup": (lambda d: d.close_popup(), None),
    "addToLog": (lambda d: d.add_to_log("hello"), None),
    "isProgramSaved": (lambda d: d.is_program_saved(), SavedProgram(True, "pick.urp")),
    "programState": (lambda d: d.program_state(), ProgramStatus(ProgramState.PLAYING, "pick.urp")),
    "PolyscopeVersion": (lambda d: Firmware.parse(d.polyscope_version().split()[0]).major in (1, 3, 5), True),
    "version": (lambda d: Firmware.parse(d.version()).major, 5),
    "setUserRole": (lambda d: d.set_user_role("operator"), None),
    "getUserRole": (lambda d: d.user_role(), "none"),
    "set operational mode": (lambda d: d.set_operational_mode("manual"), None),
    "get operational mode": (lambda d: d.operational_mode(), "none"),
    "clear operational mode": (lambda d: d.clear_operational_mode(), None),
    "power on": (lambda d: d.power_on(), None),
    "power off": (lambda d: d.power_off(), None),
    "brake release": (lambda d: d.brake_release(), None),
    "safetymode": (lambda d: d.safety_mode(), SafetyMode.NORMAL),
    "safetystatus": (lambda d: d.safety_status(), SafetyMode.NORMAL),
    "unlock protective stop": (lambda d: d.unlock_protective_stop(), None),
    "close safety popup": (lambda d: d.close_safety_popup(), None),
    "load installation": (lambda d: d.load_installation("default.installation"), None),
    "restart safety": (lambda d: d.restart_safety(), None),
    "is in remote control": (lambda d: d.is_in_remote_control(), True),
    "get serial number": (lambda d: d.serial_number(), "20215500001"),
    "get robot model": (lambda d: d.robot_model(), "UR5"),
    "generate flight report": (lambda d: d.generate_flight_report(), "1"),
    "generate support file": (lambda d: d.generate_support_file("programs"), "programs/ur_20215500001_1.zip"),
    "saveLog": (lambda d: d.save_log(), None),
}


def test_every_command_has_a_method() -> None:
    assert_listed(COMMANDS, CALLS, "CALLS in tests/urlink/protocol/test_dashboard.py")


@pytest.mark.parametrize("firmware", FIRMWARES)
def test_each_command_works_or_is_refused_on_each_firmware(firmware: str, opened: Opened) -> None:
    """A command of the firmware is executed; any other command is refused before anything is sent."""
    host = stepped(firmware)
    desk, dashboard = opened(lambda line: answering(host)(line), firmware)
    for name, (call, value) in CALLS.items():
        host = stepped(firmware)
        host.pendant.load("pick.urp")
        if name != "play":
            play(host)
        sent = len(desk.lines)
        if COMMANDS[name].is_on(host.firmware):
            assert call(dashboard) == value, name
            assert desk.lines[sent].split()[0] == name.split()[0]
        else:
            with pytest.raises(LocalError, match=f"firmware {firmware} has no dashboard command '{name}'; "):
                call(dashboard)
            assert len(desk.lines) == sent


@pytest.mark.parametrize(
    ("firmware", "call", "which"),
    [
        ("1.8", lambda d: d.power_on(), "3.0 or later is required"),
        ("3.4", lambda d: d.serial_number(), "3.12 or later is required"),
        ("5.4", lambda d: d.is_in_remote_control(), "5.6 or later is required"),
        ("3.14", lambda d: d.version(), "no CB2 or CB3 controller has it"),
        ("5.11", lambda d: d.user_role(), "no e-Series controller has it"),
    ],
)
def test_missing_command_error_names_first_firmware(
    firmware: str, call: Callable[[Dashboard], object], which: str
) -> None:
    words = rf"^firmware {firmware} has no dashboard command .*; {which}$"
    with nowhere(firmware) as dashboard, pytest.raises(LocalError, match=words):
        call(dashboard)


def test_polyscope_x_has_no_dashboard() -> None:
    with nowhere("10.7") as dashboard:
        for call in (dashboard.play, dashboard.robot_mode, dashboard.start, lambda: dashboard.send("play")):
            with pytest.raises(LocalError, match=r"10\.7 is PolyScope X, which has no dashboard server"):
                call()


def test_firmware_is_queried_before_each_command(opened: Opened) -> None:
    """A controller can have a different firmware after a reboot."""
    versions = ["5.4", "5.11"]
    desk, _ = opened(answering(stepped("5.11")))
    with Dashboard("127.0.0.1", desk.port, lambda: Firmware.parse(versions[0])) as dashboard:
        with pytest.raises(LocalError):
            dashboard.is_in_remote_control()
        versions.pop(0)
        assert dashboard.is_in_remote_control()


def test_robot_mode_uses_cb2_modes(opened: Opened) -> None:
    host = stepped("1.8")
    _, dashboard = opened(answering(host), "1.8")
    protective_stop(host)
    assert dashboard.robot_mode() is RobotModeCB2.SECURITY_STOPPED


def test_loaded_program_is_none_without_program(opened: Opened) -> None:
    _, dashboard = opened(answering(stepped("5.11")))
    assert dashboard.loaded_program() is None
    assert dashboard.program_state() == (ProgramState.STOPPED, "<unnamed>")


# -- refusals ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("call", "command", "reply"),
    [
        (lambda d: d.load("no.urp"), "load no.urp", "File not found: no.urp"),
        (lambda d: d.play(), "play", "Failed to execute: play"),
        (lambda d: d.pause(), "pause", "Failed to execute: pause"),
    ],
)
def test_refusal_quotes_reply_of_controller(
    call: Callable[[Dashboard], object], command: str, reply: str, opened: Opened
) -> None:
    desk, dashboard = opened(answering(stepped("5.11")))
    with pytest.raises(DashboardRefused) as caught:
        call(dashboard)
    assert (caught.value.command, caught.value.reply) == (command, reply)
    assert str(caught.value) == f"{command!r}: the controller answered {reply!r}"
    assert isinstance(caught.value, RemoteError)
    assert str(pickle.loads(pickle.dumps(caught.value))) == str(caught.value)
    assert dashboard.robot_mode() == RobotMode.RUNNING
    assert desk.connections == 1


def test_protective_stop_cannot_be_unlocked_immediately(opened: Opened) -> None:
    host = stepped("5.11")
    _, dashboard = opened(answering(host))
    protective_stop(host)
    with pytest.raises(DashboardRefused, match="until 5s after occurrence"):
        dashboard.unlock_protective_stop()
    wait(host, 5)
    dashboard.unlock_protective_stop()
    assert dashboard.safety_mode() is SafetyMode.NORMAL


def test_dashboard_reconnects_after_refusal_in_local_mode(opened: Opened) -> None:
    """The controller's refusal asks the client to reconnect."""
    host = stepped("5.11")
    desk, dashboard = opened(answering(host))
    host.remote_control = False
    assert not dashboard.is_in_remote_control()
    with pytest.raises(DashboardRefused, match="switch robot to Remote Control mode") as caught:
        dashboard.power_off()
    assert caught.value.reply == NOT_IN_REMOTE_CONTROL
    assert dashboard.robot_mode() == RobotMode.RUNNING
    assert desk.connections == 2
    assert dashboard.send("power off") == NOT_IN_REMOTE_CONTROL
    host.remote_control = True
    assert dashboard.send("power off") == "Powering off"
    assert desk.connections == 3


@pytest.mark.parametrize("reply", [b"\n", b"Safetymode: NORMAL\n", b"\xff\xfe\n", b"Kraftwerk\n"])
def test_unknown_reply_is_a_refusal_and_ends_connection(reply: bytes, opened: Opened) -> None:
    replies = [reply, b"Starting program\n"]
    desk, dashboard = opened(lambda line: replies.pop(0))
    with pytest.raises(DashboardRefused):
        dashboard.play()
    dashboard.play()
    assert desk.connections == 2


def test_replies_are_matched_by_prefix_in_any_case(opened: Opened) -> None:
    _, dashboard = opened(saying(b"STARTING PROGRAM pick.urp, now.\r\n"))
    dashboard.play()


def test_unknown_robot_mode_raises_packet_error(opened: Opened) -> None:
    _, dashboard = opened(saying(b"Robotmode: DANCING\n"))
    with pytest.raises(PacketError, match=r"reply to 'robotmode'.*DANCING"):
        dashboard.robot_mode()


# -- arguments ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "call",
    [
        lambda d: d.load("a.urp\nplay"),
        lambda d: d.load(""),
        lambda d: d.load(None),
        lambda d: d.load_installation("a\r"),
        lambda d: d.popup("x" * 2000),
        lambda d: d.popup("\x00"),
        lambda d: d.add_to_log("\ud800"),
        lambda d: d.set_user_role("king"),
        lambda d: d.set_operational_mode("none"),
        lambda d: d.generate_flight_report("everything"),
        lambda d: d.generate_support_file(" "),
        lambda d: d.send("popup a\npower on"),
        lambda d: d.send(""),
        lambda d: d.send("running", timeout=0),
        lambda d: d.start(timeout=float("nan")),
    ],
)
def test_bad_arguments_are_rejected_before_sending(call: Callable[[Any], object]) -> None:
    for firmware in ("3.14", "5.11"):
        with nowhere(firmware) as dashboard, pytest.raises(LocalError):
            call(dashboard)


@pytest.mark.parametrize("timeout", [0.0, -1.0, float("nan"), float("inf")])
def test_timeout_must_be_positive(timeout: float) -> None:
    with pytest.raises(BadValue, match="positive number of seconds"):
        Dashboard("127.0.0.1", 29999, lambda: Firmware(5, 11), timeout=timeout)


def test_send_returns_any_reply(opened: Opened) -> None:
    desk, dashboard = opened(answering(stepped("5.11")))
    assert dashboard.send("robotmode") == "Robotmode: RUNNING"
    assert dashboard.send("dance", timeout=5) == "could not understand: 'dance'"
    assert desk.connections == 1


@pytest.mark.property
@given(st.text(max_size=50))
def test_popup_text_cannot_inject_a_second_command(text: str) -> None:
    desk = ScriptedDashboard(saying(b"showing popup\n"))
    try:
        with Dashboard("127.0.0.1", desk.port, lambda: Firmware(5, 11), timeout=TIMEOUT) as dashboard:
            try:
                dashboard.popup(text)
            except BadValue:
                assert desk.lines == []
            else:
                assert desk.lines == [f"popup {text}"]
    finally:
        desk.close()


# -- starting the arm ----------------------------------------------------------------------------------------


def test_start_powers_on_and_releases_the_brakes(opened: Opened) -> None:
    host = stepped("5.4")
    host.modes.power_off()
    wait(host, 0.1)
    answer = answering(host)

    def later(line: str) -> bytes:
        wait(host, 0.3)
        return answer(line)

    desk, dashboard = opened(later, "5.4")
    dashboard.start()
    assert dashboard.robot_mode() is RobotMode.RUNNING
    assert [line for line in desk.lines if line != "robotmode"] == ["power on", "brake release"]


def test_start_sends_nothing_to_running_arm(opened: Opened) -> None:
    desk, dashboard = opened(answering(stepped("3.0")), "3.0")
    dashboard.start()
    assert desk.lines == ["robotmode"]


def test_start_timeout_names_modes(opened: Opened) -> None:
    host = stepped("5.11")
    host.modes.emergency_stop()
    wait(host, 0.1)
    desk, dashboard = opened(answering(host))
    with pytest.raises(
        LinkTimeout,
        match=r"is not running after 0\.3 s: robot mode POWER_OFF, safety mode ROBOT_EMERGENCY_STOP",
    ):
        dashboard.start(timeout=SHORT)
    assert desk.lines.count("power on") == 1


def test_start_does_not_power_on_twice_after_switch_off(opened: Opened) -> None:
    modes = iter(["POWER_OFF", "IDLE", "POWER_OFF"])

    def answer(line: str) -> bytes:
        yes = {
            "power on": b"Powering on\n",
            "brake release": b"Brake releasing\n",
            "safetymode": b"Safetymode: NORMAL\n",
        }
        return yes.get(line) or f"Robotmode: {next(modes, 'POWER_OFF')}\n".encode()

    desk, dashboard = opened(answer)
    with pytest.raises(LinkTimeout, match="POWER_OFF"):
        dashboard.start(timeout=0.7)
    assert (desk.lines.count("power on"), desk.lines.count("brake release")) == (1, 1)


def test_start_in_local_mode_is_refused(opened: Opened) -> None:
    host = stepped("5.11")
    host.modes.power_off()
    wait(host, 0.1)
    host.remote_control = False
    _, dashboard = opened(answering(host))
    with pytest.raises(DashboardRefused, match="Remote Control"):
        dashboard.start()
    assert host.modes.power is Power.OFF


def test_start_raises_on_cb2() -> None:
    with nowhere("1.8") as dashboard, pytest.raises(LocalError, match=r"CB2 .* start the arm at the pendant"):
        dashboard.start()


# -- failing connections -------------------------------------------------------------------------------------


def test_dashboard_connects_at_first_use(opened: Opened) -> None:
    desk, dashboard = opened(answering(stepped("5.11")))
    assert desk.connections == 0
    dashboard.running()
    dashboard.running()
    assert desk.connections == 1


def test_refused_connection_raises_connect_failed() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    with Dashboard("127.0.0.1", port, lambda: Firmware(5, 11)) as dashboard, pytest.raises(ConnectFailed):
        dashboard.running()


@pytest.mark.parametrize(
    "greeting", [b"HTTP/1.1 400 Bad Request\r\n", b"\x00\x00\x04\xc4\x40", b"Connected: " + b"x" * 9]
)
def test_wrong_greeting_raises_wrong_peer(greeting: bytes, opened: Opened) -> None:
    desk, dashboard = opened(saying(b""), greeting=greeting)
    with pytest.raises(WrongPeer, match="expected the greeting of a dashboard server"):
        dashboard.play()
    assert desk.lines == []


def test_incomplete_greeting_times_out(opened: Opened) -> None:
    desk, dashboard = opened(saying(b""), timeout=SHORT, greeting=b"Connected: Univ")
    with pytest.raises(LinkTimeout, match=r"127\.0\.0\.1:\d+: no greeting was received"):
        dashboard.generate_support_file("programs")
    assert desk.lines == []


@pytest.mark.parametrize("chunk", [1, 7])
def test_replies_do_not_depend_on_chunking(chunk: int, opened: Opened) -> None:
    _, dashboard = opened(answering(stepped("5.11")), chunk=chunk)
    assert dashboard.robot_mode() is RobotMode.RUNNING
    assert dashboard.robot_model() == "UR5"


def test_command_after_lost_connection_reconnects(opened: Opened) -> None:
    desk, dashboard = opened(answering(stepped("5.11")))
    with sockets_made() as made:
        dashboard.running()
    desk.hang_up()
    assert has_come(made[0])
    dashboard.popup("still here")
    assert desk.connections == 2
    assert desk.lines == ["running", "popup still here"]


@pytest.mark.parametrize("last_words", [None, b"showing pop"])
def test_command_is_not_repeated_after_connection_loss(last_words: bytes | None, opened: Opened) -> None:
    desks: list[ScriptedDashboard] = []

    def answer(line: str) -> bytes | None:
        if line != "popup hello":
            return b"Program running: true\n"
        if last_words is not None:
            desks[0].send(last_words)
        return None

    desk, dashboard = opened(answer)
    desks.append(desk)
    with pytest.raises(ConnectionLost, match="it might still be executed"):
        dashboard.popup("hello")
    assert dashboard.running()
    assert desk.lines == ["popup hello", "running"]
    assert desk.connections == 2


@pytest.mark.parametrize("name", ["play", " PLAY "])
def test_abandoned_play_is_undone_before_next_command(name: str, opened: Opened) -> None:
    def answer(line: str) -> bytes | None:
        if line.strip().casefold() == "play":
            return None
        return {"robotmode": b"Robotmode: RUNNING\n", "stop": b"Stopped\n"}.get(line, b"Powering on\n")

    desk, dashboard = opened(answer)
    with pytest.raises(ConnectionLost, match="it might still be executed"):
        dashboard.send(name)
    dashboard.power_on()
    assert [line.strip().casefold() for line in desk.lines] == ["play", "robotmode", "stop", "power on"]


def test_answered_commands_and_queries_are_not_undone(opened: Opened) -> None:
    desk, dashboard = opened(lambda line: b"Starting program\n" if line == "play" else None)
    dashboard.play()
    with pytest.raises(ConnectionLost) as lost:
        dashboard.running()
    assert "still be executed" not in str(lost.value)
    with pytest.raises(ConnectionLost, match="it might still be executed"):
        dashboard.brake_release()
    assert threads_named("undo") == []
    assert desk.lines == ["play", "running", "brake release"]


def test_command_is_not_sent_while_play_cannot_be_undone(opened: Opened) -> None:
    desk, dashboard = opened(saying(b""), timeout=SHORT)
    with pytest.raises(LinkTimeout, match="no reply to 'play'"):
        dashboard.send("play")
    with pytest.raises(LinkTimeout, match="'power on' was not sent, because the abandoned command 'play'"):
        dashboard.power_on()
    assert set(desk.lines) == {"play", "robotmode"}


def test_late_reply_is_not_used_for_next_command(opened: Opened) -> None:
    may_answer = threading.Event()

    def answer(line: str) -> bytes:
        if line == "running":
            assert may_answer.wait(TIMEOUT)
            return b"Program running: true\n"
        return b"true pick.urp\n"

    desk, dashboard = opened(answer, timeout=SHORT)
    with pytest.raises(LinkTimeout, match=r"no reply to 'running' within 0\.3 s"):
        dashboard.running()
    may_answer.set()
    assert dashboard.send("isProgramSaved", timeout=TIMEOUT) == "true pick.urp"
    assert desk.connections == 2


def test_unrequested_line_is_not_used_as_next_reply(opened: Opened) -> None:
    """The line can arrive together with the last reply, or after it."""
    extra = [b"true\n", b""]

    def answer(line: str) -> bytes:
        return b"true\n" + extra.pop(0) if line == "is in remote control" else b"Program running: false\n"

    desk, dashboard = opened(answer)
    assert dashboard.is_in_remote_control()
    with sockets_made() as made:
        assert not dashboard.running()
    assert desk.connections == 2
    desk.send(b"Program running: true\n")
    assert has_come(made[0])
    assert dashboard.is_in_remote_control()
    assert desk.connections == 3


def test_too_long_reply_raises_wrong_peer(opened: Opened) -> None:
    desk, dashboard = opened(saying(b"x" * 10000))
    with pytest.raises(WrongPeer, match="too long for a reply"):
        dashboard.play()
    assert desk.lines == ["play"]


def test_slow_incomplete_reply_times_out(opened: Opened) -> None:
    end = threading.Event()
    desks: list[ScriptedDashboard] = []

    def answer(line: str) -> bytes | None:
        while not end.wait(0.01):
            desks[0].send(b".")
        return None

    desk, dashboard = opened(answer, timeout=SHORT)
    desks.append(desk)
    try:
        with pytest.raises(LinkTimeout, match="no reply to 'robotmode'"):
            dashboard.robot_mode()
    finally:
        end.set()


def test_slow_commands_have_longer_timeouts(opened: Opened, monkeypatch: pytest.MonkeyPatch) -> None:
    _, dashboard = opened(answering(stepped("5.11")), timeout=SHORT)
    waited: list[float] = []
    ask = Dialogue.ask

    def noting(dialogue: Dialogue, line: str, timeout: float, *how: Any, **options: Any) -> str:
        waited.append(timeout)
        return ask(dialogue, line, timeout, *how, **options)

    monkeypatch.setattr(Dialogue, "ask", noting)
    dashboard.generate_flight_report("controller")
    dashboard.generate_support_file("programs")
    dashboard.running()
    assert waited == [180, 600, SHORT]


# -- closing -----------------------------------------------------------------------------------------------


def test_quit_disconnects_and_next_command_reconnects(opened: Opened) -> None:
    desk, dashboard = opened(answering(stepped("5.11")))
    dashboard.quit()
    dashboard.running()
    assert desk.lines == ["quit", "running"]
    assert desk.connections == 2


def test_command_after_close_raises_closed(opened: Opened) -> None:
    desk, dashboard = opened(answering(stepped("5.11")))
    with dashboard:
        dashboard.running()
    dashboard.close()
    with pytest.raises(Closed):
        dashboard.running()
    assert desk.lines == ["running"]
    with Dashboard("127.0.0.1", 1, lambda: Firmware(5, 11)):
        pass


def test_close_wakes_waiting_thread(opened: Opened) -> None:
    asked, errors = threading.Event(), []

    def answer(line: str) -> bytes:
        asked.set()
        return ScriptedDashboard.SILENCE

    _, dashboard = opened(answer)

    def play() -> None:
        try:
            dashboard.play()
        except LinkError as error:
            errors.append(error)

    thread = threading.Thread(target=play)
    thread.start()
    assert asked.wait(TIMEOUT)
    dashboard.close()
    thread.join(TIMEOUT)
    assert [type(error) for error in errors] == [Closed]


# -- threads -----------------------------------------------------------------------------------------------


def test_dashboard_commands_of_threads_are_serialised(opened: Opened) -> None:
    desk, dashboard = opened(lambda line: f"{line}\n".encode())
    wrong: list[str] = []

    def ask(who: str) -> None:
        for number in range(30):
            line = f"{who} {number}"
            if dashboard.send(line) != line:
                wrong.append(line)

    threads = [threading.Thread(target=ask, args=(who,)) for who in "abcd"]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(TIMEOUT)
    assert not wrong
    assert (desk.connections, len(desk.lines)) == (1, 120)


def test_waiting_for_another_threads_reply_times_out(opened: Opened) -> None:
    asked, may_answer = threading.Event(), threading.Event()

    def answer(line: str) -> bytes:
        asked.set()
        assert may_answer.wait(TIMEOUT)
        return b"Log saved to disk\n"

    desk, dashboard = opened(answer, timeout=SHORT)
    thread = threading.Thread(target=dashboard.save_log)
    thread.start()
    assert asked.wait(TIMEOUT)
    with pytest.raises(LinkTimeout, match="'running' was not sent"):
        dashboard.running()
    may_answer.set()
    thread.join(TIMEOUT)
    assert desk.lines == ["saveLog"]


# -- arbitrary bytes ---------------------------------------------------------------------------------------

_QUESTIONS = [call for name, (call, _) in CALLS.items() if COMMANDS[name].is_on((5, 11))]


@pytest.mark.property
@given(st.binary(max_size=60) | st.sampled_from([b"true", b"STOPPED", b"Robotmode: "]).map(lambda b: b + b"\xff \n"))
def test_any_reply_gives_value_or_remote_error(data: bytes) -> None:
    # The line end is appended, so that no example waits for a timeout.
    desk = ScriptedDashboard(saying(data + b"\n"))
    try:
        with Dashboard("127.0.0.1", desk.port, lambda: Firmware(5, 11), timeout=TIMEOUT) as dashboard:
            for call in _QUESTIONS[:: 1 + len(data) % 7]:
                with contextlib.suppress(RemoteError):
                    call(dashboard)
    finally:
        desk.close()


def test_stop_does_not_wait_for_another_reply() -> None:
    """Another thread waits for a report, which can take minutes."""
    asked = threading.Event()

    def talk(connection: socket.socket) -> None:
        with connection, contextlib.suppress(OSError):
            connection.sendall(GREETING.encode() + b"\n")
            while line := connection.recv(1000):
                if line.startswith(b"generate"):
                    asked.set()
                else:
                    connection.sendall(b"Stopped\n")

    def serve() -> None:
        with contextlib.suppress(OSError):
            while True:
                threading.Thread(target=talk, args=(listener.accept()[0],), daemon=True).start()

    def report() -> None:
        with contextlib.suppress(Closed):
            dashboard.generate_flight_report()

    with socket.create_server(("127.0.0.1", 0)) as listener:
        threading.Thread(target=serve, daemon=True).start()
        dashboard = Dashboard("127.0.0.1", listener.getsockname()[1], lambda: Firmware.parse("5.11"), timeout=TIMEOUT)
        waiting = threading.Thread(target=report)
        waiting.start()
        assert asked.wait(TIMEOUT)
        dashboard.stop()
        assert waiting.is_alive()
        dashboard.close()
        waiting.join(TIMEOUT)
        assert not waiting.is_alive()
        listener.shutdown(socket.SHUT_RDWR)

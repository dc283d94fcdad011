"""`robot.dashboard` on PolyScope X: the Robot API of the simulated controller, and scripted replies."""

from __future__ import annotations

import contextlib
import json
import socket
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

import urlink
from linkcore.errors import BadValue, Closed, ConnectFailed, LocalError, PacketError
from linkcore.net.http_client import HttpClient
from linkcore.wire.http import HttpParser, HttpRequest, HttpResponse
from tests.waiting import until
from urlink.protocol.dashboard.client import Dashboard
from urlink.protocol.dashboard.commands import DashboardRefused
from urlink.protocol.dashboard.protocol import ProgramStatus
from urlink.protocol.dashboard.robot_api import BASE, REQUESTS, RobotApi
from urlink.protocol.dashboard.stored_programs import StoredProgram, encode_form, parse_form, parse_programs
from urlink.protocol.enums import ProgramState, RobotMode, SafetyMode
from urlink.protocol.firmware import Firmware
from urlink.protocol.ports import PORTS
from urlink.simulator import Controller, Still
from urlink.simulator.robot.modes import Power

pytestmark = pytest.mark.simulated_time

FILES = {"pick": "while True:\n  sync()\nend\n"}
X14, X12, X11, X7 = Firmware(10, 14), Firmware(10, 12), Firmware(10, 11), Firmware(10, 7)


@pytest.fixture
def controller() -> Iterator[Controller]:
    with Controller("UR5e", "10.12", motion=Still(), files=FILES) as controller:
        yield controller


@pytest.fixture
def robot(controller: Controller) -> Iterator[urlink.Robot]:
    with urlink.connect(controller.address) as robot:
        yield robot
    controller.remote_control = True
    controller.faults.clear()


def test_robot_api_operates_arm_and_program(controller: Controller, robot: urlink.Robot) -> None:
    assert (robot.firmware, robot.model) == (X12, "UR5e")
    desk = robot.dashboard
    assert (desk.robot_mode(), desk.safety_mode()) == (RobotMode.RUNNING, SafetyMode.NORMAL)
    assert (desk.is_in_remote_control(), desk.operational_mode()) == (True, "automatic")
    desk.power_off()
    until(lambda: desk.robot_mode() is RobotMode.POWER_OFF)
    desk.start()
    assert desk.robot_mode() is RobotMode.RUNNING

    assert desk.loaded_program() is None
    assert desk.program_state() == ProgramStatus(ProgramState.STOPPED, None)
    desk.load("pick")
    assert desk.loaded_program() == "pick"
    desk.play()
    assert desk.program_state() == ProgramStatus(ProgramState.PLAYING, "pick")
    desk.pause()
    assert desk.program_state().state is ProgramState.PAUSED
    desk.play()  # resumes the program
    assert desk.program_state().state is ProgramState.PLAYING
    desk.stop()
    assert desk.program_state().state is ProgramState.STOPPED

    controller.faults.emergency_stop()
    assert desk.safety_mode() is SafetyMode.ROBOT_EMERGENCY_STOP
    controller.faults.clear()
    controller.robot_api.operational_mode = "MANUAL"
    assert desk.operational_mode() == "manual"
    controller.robot_api.operational_mode = "AUTOMATIC"
    desk.restart_safety()
    desk.start()


@pytest.mark.slow
def test_refusal_names_request_and_reply(controller: Controller, robot: urlink.Robot) -> None:
    with pytest.raises(DashboardRefused) as refused:
        robot.dashboard.load("nothing")
    assert refused.value.command == "PUT /program/v1/loaded nothing"
    assert refused.value.reply.startswith("404 Not Found")
    with pytest.raises(DashboardRefused, match=r"409 Conflict.*Failed to execute: pause"):
        robot.dashboard.pause()
    controller.remote_control = False
    assert not robot.dashboard.is_in_remote_control()
    with pytest.raises(DashboardRefused, match=r"PUT /program/v1/state play.*403 Forbidden"):
        robot.dashboard.play()
    with pytest.raises(urlink.NotConfirmed, match="in local control"):
        robot.set_payload(1.0)


def test_protective_stop_is_unlocked_immediately(controller: Controller, robot: urlink.Robot) -> None:
    controller.faults.protective_stop()
    assert robot.dashboard.safety_mode() is SafetyMode.PROTECTIVE_STOP
    robot.dashboard.unlock_protective_stop()
    assert robot.dashboard.safety_mode() is SafetyMode.NORMAL


@pytest.mark.slow
def test_power_commands_are_executed_in_order(robot: urlink.Robot) -> None:
    desk, modes = robot.dashboard, []
    desk.power_off()
    desk.power_on()
    desk.brake_release()
    until(lambda: modes.append(desk.robot_mode()) or modes[-2:] == [RobotMode.IDLE, RobotMode.RUNNING])  # type: ignore[func-returns-value]
    assert RobotMode.POWER_ON in modes


def urpx(name: Any) -> bytes:
    """Return a program file, as far as the format of such files is known."""
    return json.dumps({"program": {"programInformation": {"name": name}, "children": []}}).encode()


def test_programs_are_listed_uploaded_and_downloaded(
    controller: Controller, robot: urlink.Robot, tmp_path: Path
) -> None:
    time.sleep(0.1)  # programs that are stored at the start of the controller have the time 0
    desk, file = robot.dashboard, tmp_path / "any.urpx"
    file.write_bytes(urpx("pl ace"))
    assert desk.upload_program(file) == "pl ace"
    assert [each.name for each in desk.programs()] == ["pick", "pl ace"]
    pick, place = desk.programs()
    assert (pick.description, pick.created, pick.last_modified, pick.last_saved) == ("", 0, None, 0)
    assert place.created == place.last_saved != 0
    assert place.state == "STOPPED"
    assert desk.download_program("pl ace") == file.read_bytes()
    desk.load("pl ace")
    assert desk.loaded_program() == "pl ace"
    with pytest.raises(DashboardRefused, match=r"POST /programs/v1/.*400 Bad Request.*pl ace is there"):
        desk.upload_program(file)
    file.write_bytes(urpx("pl ace") + b"\n")
    assert desk.upload_program(file, replace=True) == "pl ace"
    assert desk.download_program("pl ace") == urpx("pl ace") + b"\n"
    place = desk.programs()[1]
    assert place.last_modified == place.last_saved
    assert place.created is not None
    assert place.last_modified is not None
    assert place.last_modified >= place.created
    file.write_bytes(urpx("new"))
    with pytest.raises(DashboardRefused, match="404 Not Found"):
        desk.upload_program(file, replace=True)
    for nameless in (b"", b"def place():\nend\n", b"[1]", urpx(None), urpx(""), urpx(3), b'{"program": "place"}'):
        file.write_bytes(nameless)
        with pytest.raises(DashboardRefused, match="400 Bad Request"):
            desk.upload_program(file)
    with pytest.raises(DashboardRefused, match=r"GET /programs/v1/no%2Fwhere.*404"):
        desk.download_program("no/where")
    with pytest.raises(BadValue, match="cannot read"):
        desk.upload_program(tmp_path / "nothing.urpx")
    with pytest.raises(BadValue, match="needs the name of a program"):
        desk.download_program("")
    controller.remote_control = False
    file.write_bytes(urpx("new"))
    assert desk.upload_program(file) == "new"
    for name in ("pl ace", "new"):
        del controller.pendant.files[name]
    for firmware, error in (
        (X11, "cannot list or store programs; 10.12 or later is required"),
        (Firmware(5, 11), "has a dashboard server, which"),
    ):
        with pytest.raises(LocalError, match=error):
            Dashboard("no-such-host.invalid", 1, lambda firmware=firmware: firmware).programs()  # type: ignore[misc]


FILE_NAMES = st.text(
    st.characters(codec="utf-8", exclude_categories=("Cc", "Cs"), exclude_characters='"\\/'), min_size=1
)


@pytest.mark.property
@given(FILE_NAMES, st.binary(max_size=300), st.binary(max_size=300))
def test_form_round_trip_keeps_name_and_content(name: str, content: bytes, garbage: bytes) -> None:
    content += b"\r\n--urlink"
    kind, body = encode_form(name[:50], content)
    assert parse_form(kind, body) == (name[:50], content)
    with contextlib.suppress(PacketError):
        parse_form(kind, garbage)


def test_program_list_allows_null_and_is_checked() -> None:
    entry = {"name": "a", "description": None, "createdDate": 5, "programState": "SAVED"}
    assert parse_programs(json.dumps({"programs": [entry]})) == (StoredProgram("a", created=5, state="SAVED"),)
    for said in (
        "",
        "[]",
        "{}",
        '{"programs": [1]}',
        '{"programs": [{"name": null}]}',
        '{"programs": [{"name": "a", "createdDate": "x"}]}',
    ):
        with pytest.raises(PacketError):
            parse_programs(said)


#: Commands that the Robot API does not have, and the text that the error must contain.
LACKING: list[tuple[Callable[[Dashboard], object], str]] = [
    (lambda desk: desk.popup("x"), "has 'popup' in 10.14 or later; use robot.popup"),
    (lambda desk: desk.close_popup(), "has 'close popup' in 10.14 or later"),
    (lambda desk: desk.add_to_log("x"), "has 'addToLog' in 10.14 or later"),
    (lambda desk: desk.robot_model(), "has 'get robot model' in 10.14 or later; use robot.model"),
    (lambda desk: desk.serial_number(), "has 'get serial number' in 10.14 or later"),
    (lambda desk: desk.save_log(), "has no 'saveLog'"),
    (lambda desk: desk.running(), r"'running'; use program_state\(\)"),
    (lambda desk: desk.version(), "'version'; use robot.firmware"),
    (lambda desk: desk.set_operational_mode("manual"), "'set operational mode'"),
    (lambda desk: desk.shutdown(), "'shutdown'"),
    (lambda desk: desk.quit(), "'quit'"),
    (lambda desk: desk.send("running"), "has no dashboard server for send"),
]


@pytest.mark.parametrize(("call", "error"), LACKING)
def test_missing_command_names_alternative(call: Callable[[Dashboard], object], error: str) -> None:
    nowhere = Dashboard("no-such-host.invalid", None, lambda: X12)
    with pytest.raises(LocalError, match=error):
        call(nowhere)


def test_missing_request_error_names_first_firmware(controller: Controller) -> None:
    now = X7
    desk = Dashboard("no-such-host.invalid", None, lambda: now, api_port=None)
    with pytest.raises(LocalError, match="has no Robot API"):
        desk.power_on()
    desk = Dashboard("no-such-host.invalid", None, lambda: now)
    with pytest.raises(
        LocalError, match=r"firmware 10.7 is PolyScope X.*the Robot API has 'power on' in 10.11 or later"
    ):
        desk.power_on()
    now = X11
    with pytest.raises(LocalError, match=r"firmware 10.11 .*the Robot API has 'robotmode' in 10.12 or later"):
        desk.robot_mode()
    with pytest.raises(LocalError, match="has no dashboard server"):
        Dashboard("no-such-host.invalid", None, lambda: Firmware(5, 11)).power_on()
    with pytest.raises(BadValue, match="'load' needs the name of a program"):
        desk.load(" ")
    desk.close()
    with pytest.raises(Closed):
        desk.power_on()


def test_firmware_10_11_has_robot_api_and_10_7_has_none() -> None:
    with Controller("UR5e", "10.11", motion=Still(), files=FILES) as controller:
        with urlink.connect(controller.address) as robot:
            robot.dashboard.load("pick")
            robot.dashboard.play()
            assert robot.dashboard.program_state() == ProgramStatus(ProgramState.PLAYING, None)
            with pytest.raises(LocalError):
                robot.dashboard.loaded_program()
        assert "dashboard" not in controller.ports
        robot_api = controller.ports["robot_api"]
        controller.faults.reboot("10.7", 0.1)
        until(lambda: controller.is_up and controller.firmware == X7)
        assert "robot_api" not in controller.ports
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection((controller.host, robot_api), 5)


def test_firmware_10_14_has_popups_log_and_identity() -> None:
    with (
        Controller("UR5e", "10.14", serial="20265500001") as controller,
        urlink.connect(controller.address) as robot,
    ):
        desk = robot.dashboard
        desk.popup("hello")
        popups = [controller.pendant.popup]
        desk.close_popup()
        popups.append(controller.pendant.popup)
        assert popups == ["hello", None]
        desk.close_safety_popup()
        desk.add_to_log("something")
        assert controller.pendant.log == ["something"]
        assert (desk.polyscope_version(), desk.robot_model(), desk.serial_number()) == (
            "10.14.0",
            "UR5e",
            "20265500001",
        )
        assert desk.generate_flight_report() == ""
        with pytest.raises(BadValue, match="'popup' needs a text"):
            desk.popup("")
        with pytest.raises(LocalError, match=r"'set operational mode'; the request of 10\.14 is not known"):
            desk.set_operational_mode("manual")
        # The vendor's client sends these requests: a popup with a title, and all of the system information.
        body = json.dumps({"title": "Attention", "message": "here"}).encode()
        assert asked(controller, "POST", f"{BASE}/popup/v1", body)[0] == 200
        assert controller.pendant.popup == "here"
        information = asked(controller, "GET", f"{BASE}/system/v1/information")[1]
        assert information == {"robotType": "UR5e", "serialNumber": "20265500001"}
        assert asked(controller, "GET", f"{BASE}/openapi.json")[1]["info"]["version"] == "5.0.107"
        controller.remote_control = False
        with pytest.raises(DashboardRefused, match=r"PUT /system/v1/shutdown.*403"):
            desk.shutdown()
        controller.remote_control = True
        desk.shutdown()
        until(lambda: controller.modes.power is Power.OFF)


def test_refused_connection_names_service_setting() -> None:
    with Controller("UR5e", "5.25", ports={"primary": 0}) as controller:
        with socket.create_server(("127.0.0.1", 0)) as gone:
            dead = gone.getsockname()[1]
        address = f"ur://127.0.0.1?primary={controller.ports['primary']}&realtime={dead}&rtde={dead}&dashboard={dead}"
        where = r"on firmware 5\.25 the service might be switched off \(Settings > Security > Services"
        with urlink.connect(address) as robot:
            for use in (
                robot.realtime.wait,
                lambda: robot.rtde.outputs("timestamp").wait(),
                robot.dashboard.robot_mode,
            ):
                with pytest.raises(ConnectFailed, match=where):
                    use()
        with pytest.raises(ConnectFailed, match=r"on firmware 5\.17 or later, and on PolyScope X, the service might"):
            urlink.connect(f"ur://127.0.0.1?primary={dead}&secondary={dead}")


def test_standard_ports_depend_on_firmware() -> None:
    for firmware, missing in (("10.12", "dashboard"), ("5.11", "robot_api")):
        with Controller("UR5e", firmware, ports="standard") as controller:
            assert controller.ports.keys() == PORTS.keys() - {missing, "onrobot"}


# -- scripted replies ------------------------------------------------------------------------------------


class Answering(HttpClient):
    """Client that returns the same response to each request, without a network."""

    def __init__(self, body: bytes, status: int = 200) -> None:
        super().__init__("robot", 80)
        self._answer = HttpResponse(status, "", {}, body)

    def ask(self, request: HttpRequest, timeout: float, given_up: Callable[[], object] | None = None) -> HttpResponse:
        return self._answer


@pytest.mark.parametrize(
    ("name", "body", "words"),
    [
        ("robotmode", {"mode": "UPDATING"}, "Robotmode: UPDATING_FIRMWARE"),
        ("get loaded program", {"name": None}, "No program loaded"),
        ("get loaded program", {}, "No program loaded"),
        ("is in remote control", {"mode": "LOCAL"}, "false"),
        ("power on", {"anything": 1}, ""),
    ],
)
def test_responses_are_converted_to_dashboard_replies(name: str, body: dict[str, Any], words: str) -> None:
    assert RobotApi(Answering(json.dumps(body).encode()), 1.0).do(name, None, X12) == words


@pytest.mark.property
@given(
    st.sampled_from(sorted(REQUESTS)), st.binary() | st.builds(lambda x: json.dumps({"mode": x}).encode(), st.text())
)
def test_any_response_is_converted_or_rejected(name: str, body: bytes) -> None:
    for status in (200, 500):
        try:
            words = RobotApi(Answering(body, status), 1.0).do(name, "pick", X14)
        except (PacketError, DashboardRefused):
            continue
        assert isinstance(words, str)


# -- the simulated server --------------------------------------------------------------------------------


def asked(controller: Controller, method: str, path: str, body: bytes = b"") -> tuple[int, Any]:
    answer = controller.robot_api.respond(HttpRequest(method, path, {}, body))
    return answer.status, json.loads(answer.body)


def test_simulated_server_answers_arbitrary_requests(controller: Controller) -> None:
    assert asked(controller, "GET", f"{BASE}/openapi.json")[1]["info"]["version"] == "3.1.4"
    assert asked(controller, "GET", f"{BASE}/nothing")[0] == 404
    assert asked(controller, "GET", f"{BASE}/program/v1/load")[0] == 404  # exists only in 10.11
    assert asked(controller, "DELETE", f"{BASE}/program/v1/state")[0] == 405
    for body in (b"", b"[]", b"[" * 9999, b'{"action": "jump"}', b'{"action": 1}', b'{"name": "pick"}'):
        assert asked(controller, "PUT", f"{BASE}/program/v1/state", body)[0] == 400
    with socket.create_connection((controller.host, controller.ports["robot_api"]), 5) as link:
        link.sendall(b"hello\r\n\r\n")
        data = b""
        while piece := link.recv(4096):
            data += piece
    answer = HttpParser("response").feed(data)
    assert isinstance(answer, HttpResponse)
    assert answer.status == 400

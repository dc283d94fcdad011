"""Robot API of a simulated PolyScope X controller: one HTTP request and one JSON response per connection.

The table in `urlink.protocol.dashboard.robot_api` lists the requests. Each request has the same effect as the dashboard
command with the same name. The vendor's integration tests show three facts. Programs can be uploaded even in local
control. The upload of a new program is rejected with status 400 if a program with this name already exists. A
protective stop can be unlocked immediately.

Assumptions:

- The status and the body of other error responses. The status is 400 if the request cannot be read, 403 in local
  control, and 404 if the object does not exist. It is 405 if the method is not allowed, and 409 if the action is
  currently impossible.
- The response to an action is sent immediately.
- The version of the API on firmware before 10.12.
- The name of the control mode other than REMOTE.
- A download returns an uploaded program unchanged.
- The dates and the state of each program in the list of programs.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from http import HTTPStatus
from typing import Any
from urllib.parse import unquote

from linkcore.errors import PacketError
from linkcore.wire.http import HttpParser, HttpRequest, HttpResponse
from urlink.protocol.dashboard.commands import COMMANDS, NOT_IN_REMOTE_CONTROL
from urlink.protocol.dashboard.robot_api import BASE, REQUESTS, ROBOT_API, STORED_PROGRAMS, ApiRequest, find
from urlink.protocol.dashboard.stored_programs import PROGRAMS, parse_form, program_name

from ..programs.pendant import Pendant
from ..state import ControllerState
from .dashboard import DashboardInterface
from .interface import Interface, InterfaceClient, InterfaceReceiver

#: Command of the API -> dashboard command, if their names differ.
_COMMANDS = {"resume": "play"}


class RobotApiInterface(Interface):
    """Robot API of one controller.

    Args:
        state: State of the controller.
        dashboard: Dashboard, which executes the commands.
        pendant: Pendant, which stores the programs.

    Attributes:
        operational_mode: Operational mode, "AUTOMATIC" or "MANUAL".
    """

    def __init__(self, state: ControllerState, dashboard: DashboardInterface, pendant: Pendant) -> None:
        self._state = state
        self._pendant = pendant
        self._dashboard = dashboard
        # Name of an uploaded program -> time of the first upload, or of the last replacement, in ms since the
        # controller came up.
        self._created: dict[str, int] = {}
        self._modified: dict[str, int] = {}
        self.operational_mode = "AUTOMATIC"

    def is_offered(self) -> bool:
        return self._state.firmware >= ROBOT_API

    def receiver(self, client: InterfaceClient) -> InterfaceReceiver:
        return _Exchange(self, client)

    def respond(self, request: HttpRequest) -> HttpResponse:
        """Return the response to a request."""
        path = request.target.partition("?")[0]
        if path == f"{BASE}/openapi.json":
            # The first two entries are confirmed by the vendor's client, which requests the version.
            versions = {(10, 14): "5.0.107", (10, 12): "3.1.4", (10, 11): "3.0.0"}
            version = next(text for since, text in versions.items() if self._state.firmware >= since)
            return _answer(200, {"openapi": "3.0.3", "info": {"title": "Robot API", "version": version}})
        if path.startswith(BASE + PROGRAMS.rstrip("/")) and self._state.firmware >= STORED_PROGRAMS:
            return self._programs(request, path.removeprefix(BASE + PROGRAMS.rstrip("/")).strip("/"))
        known = {name: each for name in REQUESTS if (each := find(name, self._state.firmware)) is not None}
        there = {name: each for name, each in known.items() if BASE + each.path == path}
        if not there:
            return _refusal(404, f"nothing is at {path[:200]}")
        fitting = {name: each for name, each in there.items() if each.method == request.method}
        if not fitting:
            return _refusal(405, f"{request.method} is not taken there")
        if request.method == "GET":
            return _answer(200, {asked.reply: self._value(name) for name, asked in fitting.items()})
        return self._change(fitting, request.body)

    def _programs(self, request: HttpRequest, name: str) -> HttpResponse:
        """Return the response to a request that lists, downloads or uploads programs of the pendant."""
        files = self._pendant.files
        if name:
            wanted = unquote(name)
            if request.method != "GET":
                return _refusal(405, f"{request.method} is not taken there")
            if wanted not in files:
                return _refusal(404, f"there is no program {wanted[:200]}")
            return HttpResponse(200, "OK", {"Content-Type": "text/plain"}, files[wanted].encode())
        if request.method == "GET":
            return _answer(200, {"programs": list(map(self._described, files))})
        if request.method not in ("POST", "PUT"):
            return _refusal(405, f"{request.method} is not taken there")
        try:
            content = parse_form(request.headers.get("content-type", ""), request.body)[1]
            stored, text = program_name(content), content.decode("utf-8")
        except (PacketError, UnicodeDecodeError) as error:
            return _refusal(400, str(error))
        if request.method == "POST":
            if stored in files:
                return _refusal(400, f"{stored[:200]} is there")
            self._created[stored] = self._now
        elif stored not in files:
            return _refusal(404, f"{stored[:200]} is not there")
        else:
            self._modified[stored] = self._now
        files[stored] = text
        return _answer(200, {"programName": stored})

    @property
    def _now(self) -> int:
        return round(1000 * self._state.time)

    def _described(self, name: str) -> dict[str, str | int | None]:
        """Return the description of a program for the list of programs.

        Only the date of an event that has never happened is null.
        """
        created, modified = self._created.get(name, 0), self._modified.get(name)
        is_loaded = self._state.loaded == name
        return {
            "name": name,
            "description": "",
            "createdDate": created,
            "lastModifiedDate": modified,
            "lastSavedDate": created if modified is None else modified,
            "programState": self._value("programState") if is_loaded else "STOPPED",
        }

    def _change(self, fitting: Mapping[str, ApiRequest], body: bytes) -> HttpResponse:
        try:
            said = json.loads(body) if body else {}
        except (ValueError, RecursionError):
            said = None
        if not isinstance(said, dict):
            return _refusal(400, "the body is no object in JSON")
        for name, request in fitting.items():
            if all(
                isinstance(said.get(key), str) and value in ("", None, said[key]) for key, value in request.body.items()
            ):
                argument = next((str(said[key]) for key, value in request.body.items() if value == ""), "")
                return self._carry_out(_COMMANDS.get(name, name), argument)
        return _refusal(400, f"the body asks for nothing that is known: {str(said)[:200]}")

    def _carry_out(self, name: str, argument: str) -> HttpResponse:
        words = self._dashboard.carry_out(name, argument) or ""
        if COMMANDS[name].match(words):
            return _answer(200, {"message": words})
        if words == NOT_IN_REMOTE_CONTROL:
            return _refusal(403, "the robot is not in remote control")
        return _refusal(404 if words.startswith("File not found") else 409, words)

    def _value(self, name: str) -> str:
        state, program = self._state, self._dashboard.carry_out("programState", "") or ""
        values = {
            "robotmode": state.modes.robot_mode.name,
            "safetymode": state.modes.safety_mode.name.replace("ROBOT_EMERGENCY_STOP", "EMERGENCY_STOP"),
            "programState": program.partition(" ")[0],
            "get loaded program": state.loaded or "",
            "is in remote control": "REMOTE" if state.remote_control else "LOCAL",
            "get operational mode": self.operational_mode,
            "PolyscopeVersion": ".".join(map(str, state.firmware[:3])),
            "get robot model": state.model.name,
            "get serial number": state.serial,
        }
        return values[name]


class _Exchange(InterfaceReceiver):
    """Receiver of the only request of a connection."""

    def __init__(self, interface: RobotApiInterface, client: InterfaceClient) -> None:
        self._interface = interface
        self._client = client
        self._parser = HttpParser("request")

    def feed(self, data: bytes) -> None:
        if not self._client.is_open:
            return
        try:
            request = self._parser.feed(data)
            if request is None:
                return
            assert isinstance(request, HttpRequest)
            answer = self._interface.respond(request)
        except PacketError as error:
            answer = _refusal(400, str(error))
        self._client.send(answer.encode())
        self._client.finish()


def _answer(status: int, body: Mapping[str, Any]) -> HttpResponse:
    headers = {"Content-Type": "application/json"}
    return HttpResponse(status, HTTPStatus(status).phrase, headers, json.dumps(body).encode())


def _refusal(status: int, message: str) -> HttpResponse:
    return _answer(status, {"message": message})

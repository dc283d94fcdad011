"""The Robot API of PolyScope X: the table of its requests, and the client that sends them.

PolyScope X has no dashboard server. Instead, version 10.11 and later accept HTTP requests with JSON bodies. The table
lists the requests by the names of the dashboard commands. The answers are converted to replies of the dashboard server,
so that `Dashboard` parses both in the same way. Source: the vendor's own client library (docs/protocols/dashboard.md,
Robot API); for the requests of 10.14, the library as of 2026-08. The library does not define the following:

- EMERGENCY_STOP does not show which emergency stop is active. Assumption: the stop of the robot itself.
- `play` is assumed not to resume a paused program, so `resume` is sent if the program is paused.
- The answer if no program is loaded is unknown. An empty body, an empty name and null are all accepted.
- 10.14 has a path to set the operational mode, but its body is unknown. The request is not sent.
- The content of the answer to a flight report is unknown. It is not read.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any
from urllib.parse import quote

from linkcore.errors import BadValue, LocalError, PacketError
from linkcore.net.http_client import HttpClient
from linkcore.wire.fields import Version, version_text
from linkcore.wire.http import HttpRequest, HttpResponse

from ..firmware import Firmware
from .commands import DashboardRefused
from .stored_programs import PROGRAMS, StoredProgram, encode_form, parse_programs, parse_uploaded

#: Path of the Robot API on the controller.
BASE = "/universal-robots/robot-api"
#: First firmware that has the Robot API, and first firmware whose Robot API lists and stores programs.
ROBOT_API: Version = (10, 11)
STORED_PROGRAMS: Version = (10, 12)

_STATE, _PROGRAM, _LOADED = "/robotstate/v1/state", "/program/v1/state", "/program/v1/loaded"


@dataclass(frozen=True)
class ApiRequest:
    """One request of the Robot API.

    Attributes:
        method: HTTP method: GET, PUT, POST or DELETE.
        path: Path below `BASE`.
        body: JSON object. An empty value is replaced by the argument of the command. A value of None is sent as an
            empty string, because any string is accepted. If the object is empty, no body is sent.
        reply: Name of the member of the answer that is returned; empty for none.
        words: Reply of the dashboard server with the same meaning, with a placeholder for the member.
        names: Values of the member -> their names on the dashboard server.
        since: First firmware that has the request. It is valid until the next request for the same command.
        slow: Maximum time for the answer in seconds, if it is longer than for other requests.
    """

    method: str
    path: str
    body: Mapping[str, str | None] = field(default_factory=dict)
    reply: str = ""
    words: str = "{}"
    names: Mapping[str, str] = field(default_factory=dict)
    since: Version = ROBOT_API
    slow: float = 0.0


def _change(action: str, slow: float = 0.0) -> tuple[ApiRequest]:
    return (ApiRequest("PUT", _STATE, {"action": action}, slow=slow),)


def _program(action: str) -> tuple[ApiRequest]:
    return (ApiRequest("PUT", _PROGRAM, {"action": action}, slow=15.0),)


def _since_10_14(
    method: str, path: str, body: Mapping[str, str | None] = MappingProxyType({}), reply: str = "", slow: float = 0.0
) -> tuple[ApiRequest]:
    return (ApiRequest(method, path, body, reply, since=(10, 14), slow=slow),)


def _mode(path: str, words: str = "{}", names: Mapping[str, str] = MappingProxyType({})) -> tuple[ApiRequest]:
    return (ApiRequest("GET", path, reply="mode", words=words, names=names, since=(10, 12)),)


#: Name of the dashboard command -> its requests, oldest first. The dashboard has no command "resume".
REQUESTS: Mapping[str, tuple[ApiRequest, ...]] = MappingProxyType(
    {
        # Powering on can take more than 10 s.
        "power on": _change("POWER_ON", 60.0),
        "power off": _change("POWER_OFF", 15.0),
        "brake release": _change("BRAKE_RELEASE", 60.0),
        "unlock protective stop": _change("UNLOCK_PROTECTIVE_STOP", 15.0),
        "restart safety": _change("RESTART_SAFETY", 60.0),
        "play": _program("play"),
        "resume": _program("resume"),
        "pause": _program("pause"),
        "stop": _program("stop"),
        "programState": (ApiRequest("GET", _PROGRAM, reply="state"),),
        "load": (
            ApiRequest("PUT", "/program/v1/load", {"programName": ""}, slow=60.0),
            ApiRequest("PUT", _LOADED, {"name": ""}, since=(10, 12), slow=60.0),
        ),
        "get loaded program": (ApiRequest("GET", _LOADED, reply="name", words="Loaded program: {}", since=(10, 12)),),
        "robotmode": _mode("/robotstate/v1/robotmode", "Robotmode: {}", {"UPDATING": "UPDATING_FIRMWARE"}),
        "safetymode": _mode("/robotstate/v1/safetymode", "Safetymode: {}", {"EMERGENCY_STOP": "ROBOT_EMERGENCY_STOP"}),
        "is in remote control": _mode("/system/v1/controlmode"),
        "get operational mode": _mode("/system/v1/operationalmode"),
        "popup": _since_10_14("POST", "/popup/v1", {"title": None, "message": ""}),
        "close popup": _since_10_14("DELETE", "/popup/v1"),
        "close safety popup": _since_10_14("DELETE", "/popup/v1/safety"),
        "addToLog": _since_10_14("POST", "/system/v1/log", {"message": ""}),
        "PolyscopeVersion": _since_10_14("GET", "/versions/v1", reply="marketingVersion"),
        "get robot model": _since_10_14("GET", "/system/v1/information", reply="robotType"),
        "get serial number": _since_10_14("GET", "/system/v1/information", reply="serialNumber"),
        "shutdown": _since_10_14("PUT", "/system/v1/shutdown"),
        "generate flight report": _since_10_14("POST", "/supportfiles/v1", slow=180.0),
    }
)

#: Alternatives for queries and commands that the Robot API does not have.
_INSTEAD = {
    "running": "use program_state(), which returns whether a program is playing",
    "safetystatus": "use safety_mode()",
    "popup": "use robot.popup(), which shows a popup with a program",
    "set operational mode": "the request of 10.14 is not known",
    "clear operational mode": "the request of 10.14 is not known",
    "get robot model": "use robot.model",
    "version": "use robot.firmware",
    "PolyscopeVersion": "use robot.firmware",
}
#: Maximum number of characters of an answer that an error quotes.
_QUOTED = 200
#: Maximum time to send and store a program, in seconds (assumed).
_TRANSFER = 60.0


class RobotApi:
    """Client that executes dashboard commands over the Robot API.

    Args:
        client: HTTP client, connected to the Robot API.
        timeout: Maximum time for a request that is not slow, in seconds.
    """

    def __init__(self, client: HttpClient, timeout: float) -> None:
        self._client = client
        self._timeout = timeout

    def do(
        self, name: str, argument: str | None, firmware: Firmware, given_up: Callable[[], object] | None = None
    ) -> str:
        """Execute one command, and return the answer as a reply of the dashboard server.

        Args:
            name: Name of the command.
            argument: Argument of the command, or None.
            firmware: Firmware of the controller.
            given_up: Function that is called if the request was sent and no answer arrived; None for a query.

        Raises:
            LocalError: If this firmware has no request for the command. Nothing is sent.
            BadValue: If the command needs an argument. Nothing is sent.
            DashboardRefused: If the status of the answer does not report success.
            PacketError: If the answer has another form.
            RemoteError: If `HttpClient.ask` raises it.
        """
        if name == "is in remote control":
            return "true" if self._value(name, None, firmware) == "REMOTE" else "false"
        if name == "get loaded program":
            return self._value(name, None, firmware) or "No program loaded"
        if name == "play" and self._value("programState", None, firmware) == "PAUSED":
            name = "resume"
        words = self._value(name, argument, firmware, given_up)
        if name == "programState" and find("get loaded program", firmware) is not None:
            words += " " + self._value("get loaded program", None, firmware).removeprefix("Loaded program: ")
        return words.rstrip()

    # -- the programs on the controller ----------------------------------------------------------------

    def programs(self, firmware: Firmware) -> tuple[StoredProgram, ...]:
        """Return all programs. Raises the same errors as `do`."""
        return parse_programs(_text(self._programs("GET", "", firmware)))

    def download(self, name: str, firmware: Firmware) -> bytes:
        """Return the content of one program, as it is sent. Raises the same errors as `do`."""
        return self._programs("GET", quote(_argument("download_program", name), safe=""), firmware).body

    def upload(
        self, file_name: str, content: bytes, replaces: bool, firmware: Firmware, given_up: Callable[[], object] | None
    ) -> str | None:
        """Store or replace a program, and return the reported name. Raises the same errors as `do`."""
        form = encode_form(file_name, content)
        method = "PUT" if replaces else "POST"
        return parse_uploaded(_text(self._programs(method, "", firmware, *form, given_up=given_up)))

    def _programs(
        self,
        method: str,
        name: str,
        firmware: Firmware,
        content_type: str = "",
        body: bytes = b"",
        given_up: Callable[[], object] | None = None,
    ) -> HttpResponse:
        if firmware < STORED_PROGRAMS:
            which = version_text(STORED_PROGRAMS)
            raise LocalError(
                f"the Robot API of firmware {firmware} cannot list or store programs; {which} or later is required"
            )
        headers = {"Accept": "application/json"} | ({"Content-Type": content_type} if content_type else {})
        path = PROGRAMS + name
        asked = HttpRequest(method, BASE + path, headers, body)
        return self._exchange(asked, f"{method} {path}", _TRANSFER, given_up)

    # --------------------------------------------------------------------------------------------------

    def _value(
        self, name: str, argument: str | None, firmware: Firmware, given_up: Callable[[], object] | None = None
    ) -> str:
        request = find(name, firmware)
        if request is None:
            raise LocalError(_lacking(name, firmware))
        body = {key: _argument(name, argument) if value == "" else value or "" for key, value in request.body.items()}
        answer = self._ask(request, body, given_up)
        if not request.reply:
            return ""
        value = answer.get(request.reply)
        if value is not None and not isinstance(value, str):
            raise PacketError(
                f"{request.reply!r} is {value!r}; expected a string", packet=f"answer to GET {request.path}"
            )
        return request.words.format(request.names.get(value, value)) if value else ""

    def _ask(
        self, request: ApiRequest, body: Mapping[str, str], given_up: Callable[[], object] | None
    ) -> Mapping[str, Any]:
        headers = {"Accept": "application/json"} | ({"Content-Type": "application/json"} if body else {})
        data = json.dumps(body).encode() if body else b""
        asked = HttpRequest(request.method, BASE + request.path, headers, data)
        command = " ".join([request.method, request.path, *body.values()])
        text = _text(self._exchange(asked, command, request.slow, given_up))
        if not request.reply:
            return {}
        try:
            answer = json.loads(text) if text else {}
        except (ValueError, RecursionError):
            answer = None
        if not isinstance(answer, dict):
            raise PacketError(f"{text[:_QUOTED]!r} is not a JSON object", packet=f"answer to GET {request.path}")
        return answer

    def _exchange(
        self, request: HttpRequest, command: str, slow: float, given_up: Callable[[], object] | None
    ) -> HttpResponse:
        """Return the answer if it reports success."""
        response = self._client.ask(request, max(self._timeout, slow), given_up)
        if not 200 <= response.status < 300:
            text = _text(response)
            reply = f"{response.status} {response.reason}".rstrip() + (f": {text[:_QUOTED]}" if text else "")
            raise DashboardRefused(command, reply)
        return response


def _text(response: HttpResponse) -> str:
    return response.body.decode("utf-8", "backslashreplace")


def find(name: str, firmware: Firmware) -> ApiRequest | None:
    """Return the request for a dashboard command, or None if this firmware has none."""
    return next((each for each in reversed(REQUESTS.get(name, ())) if each.since <= firmware), None)


def _argument(name: str, argument: str | None) -> str:
    if not isinstance(argument, str) or not argument.strip():
        wanted = "a text" if name in ("popup", "addToLog") else "the name of a program"
        raise BadValue(f"{name!r} needs {wanted}; got {argument!r}")
    return argument


def _lacking(name: str, firmware: Firmware) -> str:
    begin = f"firmware {firmware} is PolyScope X, which has no dashboard server"
    instead = f"; {_INSTEAD[name]}" if name in _INSTEAD else ""
    if name not in REQUESTS:
        return f"{begin}, and its Robot API has no {name!r}{instead}"
    return f"{begin}; the Robot API has {name!r} in {version_text(REQUESTS[name][0].since)} or later{instead}"

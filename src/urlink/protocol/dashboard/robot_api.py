"""The Robot API of PolyScope X: the one table of its requests, and their client.

PolyScope X has no dashboard server. From 10.11 on it takes HTTP requests with bodies in JSON instead. The table has
them by the names of the dashboard's commands, and the answers are translated into replies of the dashboard server, so
that `Dashboard` reads both alike. Source: the vendor's own client library (docs/protocols/dashboard.md, Robot API), for
the requests of 10.14 its state of 2026-08. What is not in it:

- which of the emergency stops is meant by EMERGENCY_STOP: taken as the robot's own;
- that `play` does not go on with a paused program: `resume` is sent where it is paused;
- the answer where no program is loaded: an empty body, an empty name and null are all taken as none;
- the body that sets the operational mode, for which 10.14 has a path: it is not sent;
- what the answer to a flight report holds: it is not read.
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

#: Where it lies on the controller.
BASE = "/universal-robots/robot-api"
#: The first firmware that has it, and the first whose programs it lists and takes.
ROBOT_API: Version = (10, 11)
STORED_PROGRAMS: Version = (10, 12)

_STATE, _PROGRAM, _LOADED = "/robotstate/v1/state", "/program/v1/state", "/program/v1/loaded"


@dataclass(frozen=True)
class ApiRequest:
    """One request.

    Attributes:
        method: GET, PUT, POST or DELETE.
        path: below `BASE`.
        body: JSON object; an empty value is the command's argument, None any text, which is sent empty. No object:
            nothing is sent.
        reply: name of the member of the answer that is returned; empty for none.
        words: the answer in the dashboard server's words, with the member in it.
        names: values of the member -> what the dashboard server calls them.
        since: the first firmware that has it; it holds until the next one for the same command.
        slow: seconds that the answer may take, where that is longer than a moment.
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


#: name of the dashboard's command -> the requests for it, the oldest first. "resume" is not a command there.
REQUESTS: Mapping[str, tuple[ApiRequest, ...]] = MappingProxyType(
    {
        # Powering on may take more than 10 s.
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

#: What else answers a question that the Robot API does not.
_INSTEAD = {
    "running": "program_state() tells whether a program plays",
    "safetystatus": "safety_mode() is there",
    "popup": "robot.popup() shows one by a program",
    "set operational mode": "what 10.14 wants for it is not known here",
    "clear operational mode": "what 10.14 wants for it is not known here",
    "get robot model": "robot.model has it",
    "version": "robot.firmware has it",
    "PolyscopeVersion": "robot.firmware has it",
}
#: Characters of an answer that an error quotes.
_QUOTED = 200
#: Seconds that a program may take to be sent, and to be stored. A guess.
_TRANSFER = 60.0


class RobotApi:
    """Has commands of the dashboard carried out over the Robot API.

    Args:
        client: of its server.
        timeout: seconds for a request that is not slow.
    """

    def __init__(self, client: HttpClient, timeout: float) -> None:
        self._client = client
        self._timeout = timeout

    def do(
        self, name: str, argument: str | None, firmware: Firmware, given_up: Callable[[], object] | None = None
    ) -> str:
        """Have one command carried out; returns the answer in the dashboard server's words.

        Args:
            name, argument: of the command.
            firmware: of the controller.
            given_up: called where it was sent, and no answer came; None for a question.

        Raises:
            LocalError: this firmware has no request for it; BadValue: it needs an argument. Nothing was sent.
            DashboardRefused: the controller answered with a status that is none of success.
            PacketError: what it answered says something else.
            RemoteError: what `HttpClient.ask` raises.
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
        """All of them; raises as `do`."""
        return parse_programs(_text(self._programs("GET", "", firmware)))

    def download(self, name: str, firmware: Firmware) -> bytes:
        """One of them, as the controller sends it; raises as `do`."""
        return self._programs("GET", quote(_argument("download_program", name), safe=""), firmware).body

    def upload(
        self, file_name: str, content: bytes, replaces: bool, firmware: Firmware, given_up: Callable[[], object] | None
    ) -> str | None:
        """Store another one, or replace one; the name that the controller says it has. Raises as `do`."""
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
            raise LocalError(f"firmware {firmware}: the first whose Robot API has the programs on it is {which}")
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
            raise PacketError(f"{request.reply!r} is {value!r}", packet=f"answer to GET {request.path}")
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
            raise PacketError(f"{text[:_QUOTED]!r} is no object", packet=f"answer to GET {request.path}")
        return answer

    def _exchange(
        self, request: HttpRequest, command: str, slow: float, given_up: Callable[[], object] | None
    ) -> HttpResponse:
        """The answer, where it says that it was done."""
        response = self._client.ask(request, max(self._timeout, slow), given_up)
        if not 200 <= response.status < 300:
            text = _text(response)
            reply = f"{response.status} {response.reason}".rstrip() + (f": {text[:_QUOTED]}" if text else "")
            raise DashboardRefused(command, reply)
        return response


def _text(response: HttpResponse) -> str:
    return response.body.decode("utf-8", "backslashreplace")


def find(name: str, firmware: Firmware) -> ApiRequest | None:
    """The request for a command of the dashboard, or None where this firmware has none."""
    return next((each for each in reversed(REQUESTS.get(name, ())) if each.since <= firmware), None)


def _argument(name: str, argument: str | None) -> str:
    if not isinstance(argument, str) or not argument.strip():
        wanted = "a text" if name in ("popup", "addToLog") else "the name of a program"
        raise BadValue(f"{name!r} needs {wanted}, not {argument!r}")
    return argument


def _lacking(name: str, firmware: Firmware) -> str:
    begin = f"firmware {firmware} is PolyScope X, which has no dashboard server"
    instead = f"; {_INSTEAD[name]}" if name in _INSTEAD else ""
    if name not in REQUESTS:
        return f"{begin}, and its Robot API has nothing for {name!r}{instead}"
    return f"{begin}; the first whose Robot API has {name!r} is {version_text(REQUESTS[name][0].since)}{instead}"

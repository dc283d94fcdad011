"""Table of the commands of the dashboard server (port 29999), and the error if a command is refused.

The protocol consists of lines of text, with one reply to each command. Source: docs/protocols/dashboard.md, section
Releases, which lists the versions that the vendor's own client enforces. Punctuation and case of the replies changed
between generations. Therefore a reply is matched from its beginning, and case is ignored. Other sources:

- Further commands that need remote control (`stop`, `pause`, `shutdown`, `power off`, `restart safety`), and the text
  of the refusal in local mode: reports of users of the e-Series.
- The mode as a bare number, from a CB2 controller: the vendor's older table and two public clients.
- `No log message to add`, `Failed setting user role` and `Program loaded`: public clients that follow the vendor's
  older table.
- `could not understand`: the vendor's own client expects this reply from a controller that does not have the command.
- The kinds of flight report: a public client that follows the vendor's table for the e-Series.
- Maximum times of slow commands: for the reports, the times that the vendor's own client allows; for the others,
  assumed.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal, get_args

from linkcore.errors import RemoteError
from linkcore.wire.fields import Version

from ..headers import DASHBOARD_GREETING


class DashboardRefused(RemoteError):
    """Error if the controller did not execute a command, or if its reply does not confirm it.

    Attributes:
        command: Line that was sent.
        reply: Reply of the controller, unchanged.
    """

    __module__ = "urlink"  # users import it from this module, and tracebacks show it

    def __init__(self, command: str, reply: str) -> None:
        super().__init__(command, reply)
        self.command = command
        self.reply = reply

    def __str__(self) -> str:
        return f"{self.command!r}: the controller answered {self.reply!r}"


#: Greeting of the server.
GREETING = DASHBOARD_GREETING.decode("ascii") + " Robots Dashboard Server"

#: Reply of an e-Series controller in local mode, to commands that need remote control.
NOT_IN_REMOTE_CONTROL = (
    "Command is not allowed due to safety reasons, please switch robot to Remote Control mode and reconnect to "
    "port 29999"
)

#: Beginning of the reply to an unknown command.
COULD_NOT_UNDERSTAND = "could not understand"

#: First version without a dashboard server.
POLYSCOPE_X: Version = (10, 0)

OperationalMode = Literal["none", "manual", "automatic"]
UserRole = Literal["programmer", "operator", "none", "locked", "restricted"]
FlightReport = Literal["controller", "software", "system"]


@dataclass(frozen=True)
class DashboardCommand:
    """One command of the dashboard server.

    Attributes:
        name: Name, as it is sent.
        cb: First firmware of CB2 and CB3 that has the command; None if none has it.
        e: First firmware of the e-Series that has the command; None if none has it.
        success: Regular expression that matches the beginning of a reply if the command was executed.
        refusals: Beginnings of the replies that report a refusal.
        argument: Kind of the text that follows the name; empty if the command has no argument.
        choices: Allowed values of the argument; empty if any text is allowed.
        needs_remote_control: Whether the e-Series refuses the command in local mode.
        slow: Maximum time for the reply in seconds, if it is longer than for other commands.
        only_asks: Whether the command changes nothing.
    """

    name: str
    cb: Version | None
    e: Version | None
    success: str
    refusals: tuple[str, ...] = ()
    argument: str = ""
    choices: tuple[str, ...] = ()
    needs_remote_control: bool = False
    slow: float = 0.0
    only_asks: bool = False

    def first(self, firmware: Version) -> Version | None:
        """Return the first firmware of the generation of `firmware` that has the command, or None."""
        if firmware >= POLYSCOPE_X:
            return None
        return self.e if firmware >= (5, 0) else self.cb

    def is_on(self, firmware: Version) -> bool:
        """Return whether `firmware` has the command."""
        first = self.first(firmware)
        return first is not None and firmware >= first

    def match(self, reply: str) -> re.Match[str] | None:
        """Match `reply` with `success`; None if the command was not executed. The groups are the values in it."""
        return re.match(self.success, reply, re.IGNORECASE | re.ASCII)

    def is_refusal(self, reply: str) -> bool:
        """Return whether the reply is a known refusal."""
        return reply.casefold().startswith((*map(str.casefold, self.refusals), COULD_NOT_UNDERSTAND))


def _failed(name: str) -> tuple[str]:
    return (f"Failed to execute: {name}",)


_TABLE = (
    DashboardCommand(
        "load",
        (1, 4),
        (5, 0),
        r"Loading program: *(.*)",
        ("File not found:", "Error while loading program"),
        argument="path",
        needs_remote_control=True,
        slow=60.0,
    ),
    DashboardCommand("play", (1, 4), (5, 0), "Starting program", _failed("play"), needs_remote_control=True, slow=15.0),
    DashboardCommand("stop", (1, 4), (5, 0), "Stopped", _failed("stop"), needs_remote_control=True, slow=15.0),
    DashboardCommand(
        "pause", (1, 4), (5, 0), "Pausing program", _failed("pause"), needs_remote_control=True, slow=15.0
    ),
    DashboardCommand("quit", (1, 4), (5, 0), "Disconnected", only_asks=True),
    DashboardCommand("shutdown", (1, 4), (5, 0), "Shutting down", needs_remote_control=True),
    DashboardCommand("running", (1, 6), (5, 0), r"(?:Program|Robot) running: *(true|false)$", only_asks=True),
    DashboardCommand(
        "robotmode", (1, 6), (5, 0), r"(?:Robot ?mode: *)?(-?\d{1,9}|[A-Z]+(?:_[A-Z]+)*)$", only_asks=True
    ),
    DashboardCommand(
        "get loaded program",
        (1, 6),
        (5, 0),
        r"(?:Loaded program|Program loaded): *(\S.*)|No program loaded",
        only_asks=True,
    ),
    DashboardCommand("popup", (1, 6), (5, 0), "showing popup", argument="text"),
    DashboardCommand("close popup", (1, 6), (5, 0), "closing popup"),
    DashboardCommand("addToLog", (1, 8), (5, 0), "Added log message", ("No log message to add",), argument="text"),
    DashboardCommand("isProgramSaved", (1, 8), (5, 0), r"(true|false)(?: +(\S.*)|$)", only_asks=True),
    DashboardCommand("programState", (1, 8), (5, 0), r"(STOPPED|PLAYING|PAUSED)(?: +(\S.*)|$)", only_asks=True),
    DashboardCommand("PolyscopeVersion", (1, 8), (5, 0), r"(?:URSoftware *)?(\d+(?:\.\d+)+.*)", only_asks=True),
    DashboardCommand("version", None, (5, 0), r"(\d+(?:\.\d+)+)$", only_asks=True),
    DashboardCommand(
        "setUserRole",
        (3, 1),
        None,
        r"Setting user role: *(\w+)",
        ("Failed setting user role:",),
        argument="role",
        choices=get_args(UserRole),
    ),
    DashboardCommand("getUserRole", (3, 1), None, r"(PROGRAMMER|OPERATOR|NONE|LOCKED|RESTRICTED)$", only_asks=True),
    DashboardCommand(
        "set operational mode",
        None,
        (5, 0),
        r"Operational mode '?(MANUAL|AUTOMATIC)'? is set|Setting operational mode: *(MANUAL|AUTOMATIC)",
        argument="mode",
        choices=("manual", "automatic"),
    ),
    DashboardCommand("get operational mode", None, (5, 6), r"(NONE|MANUAL|AUTOMATIC)$", only_asks=True),
    DashboardCommand(
        "clear operational mode",
        None,
        (5, 0),
        r"No longer controlling the operational mode|Operational mode is no longer controlled",
    ),
    DashboardCommand("power on", (3, 0), (5, 0), "Powering on", needs_remote_control=True),
    DashboardCommand("power off", (3, 0), (5, 0), "Powering off", needs_remote_control=True),
    DashboardCommand("brake release", (3, 0), (5, 0), "Brake releasing", needs_remote_control=True),
    DashboardCommand("safetymode", (3, 0), (5, 0), r"Safety ?mode: *([A-Z]+(?:_[A-Z]+)*)$", only_asks=True),
    # One list has this command in firmware 3.11 and later, which is not verified.
    DashboardCommand("safetystatus", None, (5, 4), r"Safety ?status: *([A-Z]+(?:_[A-Z]+)*)$", only_asks=True),
    DashboardCommand(
        "unlock protective stop",
        (3, 1),
        (5, 0),
        "Protective stop releasing",
        ("Cannot unlock protective stop",),
        needs_remote_control=True,
    ),
    DashboardCommand("close safety popup", (3, 1), (5, 0), "closing safety popup"),
    DashboardCommand(
        "load installation",
        (3, 2),
        (5, 0),
        r"Loading installation: *(.*)",
        ("File not found:", "Failed to load installation"),
        argument="path",
        needs_remote_control=True,
        slow=60.0,
    ),
    DashboardCommand("restart safety", (3, 7), (5, 1), "Restarting safety", needs_remote_control=True, slow=15.0),
    DashboardCommand("is in remote control", None, (5, 6), r"(true|false)$", only_asks=True),
    DashboardCommand("get serial number", (3, 12), (5, 6), r"(\d\S*)$", only_asks=True),
    DashboardCommand("get robot model", (3, 12), (5, 6), r"(UR\d\S*(?: Long)?)$", only_asks=True),
    DashboardCommand(
        "generate flight report",
        (3, 13),
        (5, 8),
        r"Flight Report generated with id: *(\S.*)",
        argument="kind",
        choices=get_args(FlightReport),
        slow=180.0,
    ),
    DashboardCommand(
        "generate support file", (3, 13), (5, 8), r"Completed successfully: *(\S.*)", argument="directory", slow=600.0
    ),
    DashboardCommand("saveLog", (3, 13), (5, 8), "Log saved to disk", slow=30.0),
)

#: Name -> command.
COMMANDS: Mapping[str, DashboardCommand] = MappingProxyType({command.name: command for command in _TABLE})

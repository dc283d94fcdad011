"""Protocol of the dashboard server (port 29999), sans-IO: lines of text, and the values in the replies.

The server sends a greeting, and then one line of reply to each command line. A reply does not identify its command;
only the order does. If a reply is missing, the connection must not be used again.
Source: docs/protocols/dashboard.md, section Lines.
"""

from __future__ import annotations

import unicodedata
from typing import NamedTuple, TypeVar, cast

from linkcore.errors import BadValue, LocalError, PacketError, WrongPeer

from ..enums import ProgramState, RobotMode, RobotModeCB2, SafetyMode
from ..headers import DASHBOARD_GREETING
from .commands import COMMANDS, DashboardCommand, OperationalMode, UserRole

#: Maximum length of a line in bytes, without its end. The limit of a controller is unknown. Paths and messages are
#: shorter.
LONGEST_COMMAND = 1024
LONGEST_REPLY = 4096

# Unicode categories: control characters (including line ends), line and paragraph separators, surrogates.
_NOT_IN_A_LINE = {"Cc", "Zl", "Zp", "Cs"}

_Mode = TypeVar("_Mode", RobotMode, RobotModeCB2, SafetyMode)


class ProgramStatus(NamedTuple):
    """Reply to `programState`.

    Attributes:
        state: State of the program: STOPPED, PLAYING or PAUSED.
        name: Name of the program, `"<unnamed>"` if it was never saved; None if the controller does not report a name.
    """

    state: ProgramState
    name: str | None


class SavedProgram(NamedTuple):
    """Reply to `isProgramSaved`.

    Attributes:
        is_saved: Whether the loaded program has no unsaved changes.
        name: Name of the program; None if the controller does not report a name.
    """

    is_saved: bool
    name: str | None


# -- lines ---------------------------------------------------------------------------------------------


def encode_line(text: str) -> bytes:
    """Return a command as one line on the wire.

    Raises:
        BadValue: If the text is not one line, is blank, or is too long.
    """
    if not isinstance(text, str) or not text.strip():
        raise BadValue(f"{text!r} is not a dashboard command; expected a line of text")
    for character in text:
        if unicodedata.category(character) in _NOT_IN_A_LINE:
            raise BadValue(
                f"{character!r} in {text[:80]!r}: a dashboard command must not contain control characters or line ends"
            )
    line = text.encode("utf-8")
    if len(line) > LONGEST_COMMAND:
        raise BadValue(f"the dashboard command has {len(line)} bytes; expected at most {LONGEST_COMMAND}")
    return line + b"\n"


def command_line(command: DashboardCommand, argument: str | None = None) -> str:
    """Return the text to send for a command.

    Raises:
        BadValue: If the argument is missing, superfluous, not among the choices, or not valid in a line.

    >>> command_line(COMMANDS["load"], "pick.urp")
    'load pick.urp'
    """
    if not command.argument:
        if argument is not None:
            raise BadValue(f"the dashboard command {command.name!r} has no argument; remove {argument!r}")
        return command.name
    if not isinstance(argument, str) or not argument.strip():
        raise BadValue(f"the dashboard command {command.name!r} needs a {command.argument}; got {argument!r}")
    if command.choices and argument not in command.choices:
        known = ", ".join(map(repr, command.choices))
        raise BadValue(f"the {command.argument} of {command.name!r} is {argument!r}; expected one of {known}")
    text = f"{command.name} {argument}"
    encode_line(text)
    return text


class DashboardProtocol:
    """State of one connection. After the greeting, commands and replies alternate.

    Attributes:
        is_greeted: Whether the greeting was received, so that commands can be sent.
        settling: Always None, because each reply ends with a newline; see `linkcore.net.dialogue`.
    """

    settling: float | None = None

    def __init__(self) -> None:
        self.is_greeted = False
        self._is_asked = False
        self._rest = b""

    @property
    def is_in_step(self) -> bool:
        """Whether the greeting and all replies have arrived, and no unexpected bytes."""
        return self.is_greeted and not self._is_asked and not self._rest

    def ask(self, text: str) -> bytes:
        """Return the bytes of a command to send. The next `feed` returns its reply.

        Raises:
            BadValue: If the text is not one line of bounded length.
            LocalError: If a reply is missing or unexpected bytes have arrived, so that the next line might not be the
                reply to this command.
        """
        line = encode_line(text)
        if not self.is_in_step:
            raise LocalError(f"{text!r} cannot be sent, because the connection is out of step: use a new connection")
        self._is_asked = True
        return line

    def feed(self, data: bytes) -> str | None:
        """Process received bytes, and return the reply when it is complete, without line end and surrounding blanks.

        Bytes after the reply, or without a command, are kept. The connection then cannot be used any more.

        Raises:
            WrongPeer: If the data does not begin with the greeting, or a line has no end.
        """
        self._rest += data
        if not self.is_greeted:
            self._greet()
        if not self._is_asked or not self.is_greeted:
            self._bound(self._rest)
            return None
        line, end, rest = self._rest.partition(b"\n")
        self._bound(line)
        if not end:
            return None
        self._rest = rest
        self._is_asked = False
        # Replies should be ASCII. Bytes that are not text become escapes, so that a person can read them.
        return line.decode("utf-8", "backslashreplace").strip()

    def _greet(self) -> None:
        wanted = len(DASHBOARD_GREETING)
        if not DASHBOARD_GREETING.startswith(self._rest[:wanted]):
            raise WrongPeer(f"expected the greeting of a dashboard server, but received {self._rest[:32]!r}")
        line, end, rest = self._rest.partition(b"\n")
        if end:
            self._bound(line)
            self.is_greeted = True
            self._rest = rest

    def _bound(self, line: bytes) -> None:
        if len(line) > LONGEST_REPLY:
            raise WrongPeer(f"the line that starts with {line[:32]!r} is too long for a reply of a dashboard server")


# -- replies -------------------------------------------------------------------------------------------


def _groups(name: str, reply: str) -> tuple[str | None, ...]:
    match = COMMANDS[name].match(reply)
    if match is None:
        raise _unreadable(name, reply)
    return match.groups()


def _unreadable(name: str, reply: str) -> PacketError:
    return PacketError(f"{reply[:200]!r} is not a known reply to this command", packet=f"reply to {name!r}")


def _named(name: str, reply: str, modes: type[_Mode]) -> _Mode:
    """Return the mode whose name or number is in the reply."""
    said = (_groups(name, reply)[0] or "").upper()
    try:
        return modes(int(said))
    except ValueError:
        pass
    if said not in modes.__members__:
        raise _unreadable(name, reply)
    return modes[said]


def parse_truth(name: str, reply: str) -> bool:
    """Parse the true or false in the reply to `running` or `is in remote control`.

    Raises:
        PacketError: If the reply contains neither.

    >>> parse_truth("running", "Program running: false")
    False
    """
    return (_groups(name, reply)[0] or "").casefold() == "true"


def parse_robot_mode(reply: str, is_cb2: bool = False) -> RobotMode | RobotModeCB2:
    """Parse the mode in the reply to `robotmode`. It is a name, or a number on CB2 controllers.

    Raises:
        PacketError: If the mode is not known.

    >>> parse_robot_mode("Robotmode: IDLE"), parse_robot_mode("0", is_cb2=True)
    (<RobotMode.IDLE: 5>, <RobotModeCB2.RUNNING: 0>)
    """
    return _named("robotmode", reply, RobotModeCB2) if is_cb2 else _named("robotmode", reply, RobotMode)


def parse_safety_mode(name: str, reply: str) -> SafetyMode:
    """Parse the mode in the reply to `safetymode` or `safetystatus`.

    Raises:
        PacketError: If the mode is not known.
    """
    return _named(name, reply, SafetyMode)


def parse_program_state(reply: str) -> ProgramStatus:
    """Parse the reply to `programState`.

    Raises:
        PacketError: If the reply has another form.

    >>> parse_program_state("STOPPED <unnamed>")
    ProgramStatus(state=<ProgramState.STOPPED: 1>, name='<unnamed>')
    """
    state, name = _groups("programState", reply)
    return ProgramStatus(ProgramState[(state or "").upper()], name)


def parse_is_program_saved(reply: str) -> SavedProgram:
    """Parse the reply to `isProgramSaved`.

    Raises:
        PacketError: If the reply has another form.
    """
    truth, name = _groups("isProgramSaved", reply)
    return SavedProgram((truth or "").casefold() == "true", name)


def parse_loaded_program(reply: str) -> str | None:
    """Parse the path in the reply to `get loaded program`; None if no program is loaded.

    Raises:
        PacketError: If the reply has another form.
    """
    return _groups("get loaded program", reply)[0]


def parse_operational_mode(reply: str) -> OperationalMode:
    """Parse the mode in the reply to `get operational mode`.

    Raises:
        PacketError: If the reply has another form.
    """
    return cast(OperationalMode, parse_text("get operational mode", reply).casefold())


def parse_user_role(reply: str) -> UserRole:
    """Parse the role in the reply to `getUserRole`.

    Raises:
        PacketError: If the reply has another form.
    """
    return cast(UserRole, parse_text("getUserRole", reply).casefold())


def parse_text(name: str, reply: str) -> str:
    """Return the variable part of a reply, for example a version, a serial number or a file name.

    Raises:
        PacketError: If the reply has another form.

    >>> parse_text("PolyscopeVersion", "URSoftware 5.4.0.76837 (Jul 30 2019)")
    '5.4.0.76837 (Jul 30 2019)'
    """
    return (_groups(name, reply)[0] or "").strip()

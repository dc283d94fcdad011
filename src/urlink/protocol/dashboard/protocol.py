"""The dashboard server (29999), sans-IO: lines of text in and out, and the meaning of the replies.

A greeting, then one line of reply to each line of command. A reply does not say which command it answers: only the
order decides. After a reply that did not come, the connection must not be used again.
Source: docs/protocols/dashboard.md, section Lines.
"""

from __future__ import annotations

import unicodedata
from typing import NamedTuple, TypeVar, cast

from linkcore.errors import BadValue, LocalError, PacketError, WrongPeer

from ..enums import ProgramState, RobotMode, RobotModeCB2, SafetyMode
from ..headers import DASHBOARD_GREETING
from .commands import COMMANDS, DashboardCommand, OperationalMode, UserRole

#: Bytes of a line, its end not counted. The limit of a controller is not known; paths and messages are shorter.
LONGEST_COMMAND = 1024
LONGEST_REPLY = 4096

# Controls (the line ends among them), separators of lines and paragraphs, halves of a character.
_NOT_IN_A_LINE = {"Cc", "Zl", "Zp", "Cs"}

_Mode = TypeVar("_Mode", RobotMode, RobotModeCB2, SafetyMode)


class ProgramStatus(NamedTuple):
    """The reply to `programState`.

    Attributes:
        state: STOPPED, PLAYING or PAUSED.
        name: of the program, `"<unnamed>"` for one that was never saved; None where the controller names none.
    """

    state: ProgramState
    name: str | None


class SavedProgram(NamedTuple):
    """The reply to `isProgramSaved`.

    Attributes:
        is_saved: the loaded program has no unsaved changes.
        name: of the program; None where the controller names none.
    """

    is_saved: bool
    name: str | None


# -- lines ---------------------------------------------------------------------------------------------


def encode_line(text: str) -> bytes:
    """A command as one line on the wire.

    Raises:
        BadValue: the text is not one line, has no text in it, or is too long.
    """
    if not isinstance(text, str) or not text.strip():
        raise BadValue(f"a dashboard command is a line of text, not {text!r}")
    for character in text:
        if unicodedata.category(character) in _NOT_IN_A_LINE:
            raise BadValue(
                f"{character!r} in {text[:80]!r}: a dashboard command is one line without control characters"
            )
    line = text.encode("utf-8")
    if len(line) > LONGEST_COMMAND:
        raise BadValue(f"a dashboard command of {len(line)} bytes; at most {LONGEST_COMMAND} are sent")
    return line + b"\n"


def command_line(command: DashboardCommand, argument: str | None = None) -> str:
    """The text that is sent for a command.

    Raises:
        BadValue: the argument is missing, superfluous, not among the choices, or cannot be part of a line.

    >>> command_line(COMMANDS["load"], "pick.urp")
    'load pick.urp'
    """
    if not command.argument:
        if argument is not None:
            raise BadValue(f"the dashboard command {command.name!r} takes no argument, not {argument!r}")
        return command.name
    if not isinstance(argument, str) or not argument.strip():
        raise BadValue(f"the dashboard command {command.name!r} needs a {command.argument}, not {argument!r}")
    if command.choices and argument not in command.choices:
        known = ", ".join(map(repr, command.choices))
        raise BadValue(f"the {command.argument} of {command.name!r} is one of {known}, not {argument!r}")
    text = f"{command.name} {argument}"
    encode_line(text)
    return text


class DashboardProtocol:
    """One connection: the greeting, then question and answer in turn; a new one for each connection.

    Attributes:
        is_greeted: the greeting was received, so that commands can be sent.
        settling: None, since each reply ends with a newline; see `linkcore.net.dialogue`.
    """

    settling: float | None = None

    def __init__(self) -> None:
        self.is_greeted = False
        self._is_asked = False
        self._rest = b""

    @property
    def is_in_step(self) -> bool:
        """Greeted, every question answered, and nothing sent that was not asked for."""
        return self.is_greeted and not self._is_asked and not self._rest

    def ask(self, text: str) -> bytes:
        """The bytes that ask, whose answer the next `feed` will bring.

        Raises:
            BadValue: the text is not one line of bounded length.
            LocalError: this connection is not in step, so the next line to come might not be the answer to this.
        """
        line = encode_line(text)
        if not self.is_in_step:
            raise LocalError(f"{text!r} cannot be asked on a connection that is out of step")
        self._is_asked = True
        return line

    def feed(self, data: bytes) -> str | None:
        """The reply to what was asked, once it is whole; without the line's end and blanks around it.

        What comes after it, or with nothing asked, stays here: the connection is then out of step.

        Raises:
            WrongPeer: it does not begin with the greeting, or a line has no end.
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
        # It should be ASCII; what is not text is kept as escapes, so that a person can see it.
        return line.decode("utf-8", "backslashreplace").strip()

    def _greet(self) -> None:
        wanted = len(DASHBOARD_GREETING)
        if not DASHBOARD_GREETING.startswith(self._rest[:wanted]):
            raise WrongPeer(f"expected a dashboard server, but this begins with {self._rest[:32]!r}")
        line, end, rest = self._rest.partition(b"\n")
        if end:
            self._bound(line)
            self.is_greeted = True
            self._rest = rest

    def _bound(self, line: bytes) -> None:
        if len(line) > LONGEST_REPLY:
            raise WrongPeer(f"a dashboard server says short lines, but here is one that begins with {line[:32]!r}")


# -- replies -------------------------------------------------------------------------------------------


def _groups(name: str, reply: str) -> tuple[str | None, ...]:
    match = COMMANDS[name].match(reply)
    if match is None:
        raise _unreadable(name, reply)
    return match.groups()


def _unreadable(name: str, reply: str) -> PacketError:
    return PacketError(f"{reply[:200]!r} is no answer that is known", packet=f"reply to {name!r}")


def _named(name: str, reply: str, modes: type[_Mode]) -> _Mode:
    """The mode whose name, or number, is in the reply."""
    said = (_groups(name, reply)[0] or "").upper()
    try:
        return modes(int(said))
    except ValueError:
        pass
    if said not in modes.__members__:
        raise _unreadable(name, reply)
    return modes[said]


def parse_truth(name: str, reply: str) -> bool:
    """The true or false in the reply to `running` or `is in remote control`.

    Raises:
        PacketError: it says neither.

    >>> parse_truth("running", "Program running: false")
    False
    """
    return (_groups(name, reply)[0] or "").casefold() == "true"


def parse_robot_mode(reply: str, is_cb2: bool = False) -> RobotMode | RobotModeCB2:
    """The mode in the reply to `robotmode`, by its name or, as CB2 controllers say it, its number.

    Raises:
        PacketError: no mode that is known.

    >>> parse_robot_mode("Robotmode: IDLE"), parse_robot_mode("0", is_cb2=True)
    (<RobotMode.IDLE: 5>, <RobotModeCB2.RUNNING: 0>)
    """
    return _named("robotmode", reply, RobotModeCB2) if is_cb2 else _named("robotmode", reply, RobotMode)


def parse_safety_mode(name: str, reply: str) -> SafetyMode:
    """The mode in the reply to `safetymode` or `safetystatus`.

    Raises:
        PacketError: no mode that is known.
    """
    return _named(name, reply, SafetyMode)


def parse_program_state(reply: str) -> ProgramStatus:
    """What the reply to `programState` says.

    Raises:
        PacketError: it says something else.

    >>> parse_program_state("STOPPED <unnamed>")
    ProgramStatus(state=<ProgramState.STOPPED: 1>, name='<unnamed>')
    """
    state, name = _groups("programState", reply)
    return ProgramStatus(ProgramState[(state or "").upper()], name)


def parse_is_program_saved(reply: str) -> SavedProgram:
    """What the reply to `isProgramSaved` says.

    Raises:
        PacketError: it says something else.
    """
    truth, name = _groups("isProgramSaved", reply)
    return SavedProgram((truth or "").casefold() == "true", name)


def parse_loaded_program(reply: str) -> str | None:
    """The path in the reply to `get loaded program`, or None if there is none.

    Raises:
        PacketError: it says something else.
    """
    return _groups("get loaded program", reply)[0]


def parse_operational_mode(reply: str) -> OperationalMode:
    """The mode in the reply to `get operational mode`.

    Raises:
        PacketError: it says something else.
    """
    return cast(OperationalMode, parse_text("get operational mode", reply).casefold())


def parse_user_role(reply: str) -> UserRole:
    """The role in the reply to `getUserRole`.

    Raises:
        PacketError: it says something else.
    """
    return cast(UserRole, parse_text("getUserRole", reply).casefold())


def parse_text(name: str, reply: str) -> str:
    """What a reply says beside the words that are the same in each: a version, a serial number, the name of a file.

    Raises:
        PacketError: it says something else.

    >>> parse_text("PolyscopeVersion", "URSoftware 5.4.0.76837 (Jul 30 2019)")
    '5.4.0.76837 (Jul 30 2019)'
    """
    return (_groups(name, reply)[0] or "").strip()

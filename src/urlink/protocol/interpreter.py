"""Protocol of interpreter mode (port 30020), sans-IO: one statement per line, and one reply per line.

The reply to a statement is `ack: NUMBER: TEXT` or `discard: NUMBER: TEXT`. The reply to a query word is
`state: NUMBER: TEXT`. Public clients match replies loosely. Source: docs/protocols/urscript.md, section Interpreter
mode.
"""

from __future__ import annotations

import re
from typing import NamedTuple

from linkcore.errors import BadValue, LocalError, PacketError, WrongPeer

#: Command words of interpreter mode, which are not statements.
WORDS = ("skipbuffer", "abort", "statelastexecuted", "statelastinterpreted", "statelastcleared", "stateunexecuted")
#: Maximum length of a statement, in bytes. The limit of a controller is unknown; statements are far shorter than this.
LONGEST_STATEMENT = 8000
#: Maximum length of a reply, in bytes. A reply contains the text of the statement.
LONGEST_REPLY = LONGEST_STATEMENT + 1000

_REPLY = re.compile(r"(\w+): *(-?[0-9]{1,9}): *(.*)", re.DOTALL)


class Reply(NamedTuple):
    """Reply of a controller.

    Attributes:
        word: Kind of reply: "ack", "discard" or "state".
        number: Number of the statement, or the queried value.
        text: Text of the statement that was sent.
    """

    word: str
    number: int
    text: str


def statement_line(text: str) -> str:
    """Return a statement as one line. Line ends, which have no meaning in URScript, become blanks.

    Comments are removed.

    Raises:
        BadValue: If the text is not a string, is empty or only comments, has a control character, is a command word, or
            is too long.

    >>> statement_line("movej(\\n  q)  # there")
    'movej( q)'
    """
    if not isinstance(text, str):
        raise BadValue(f"the statement is {type(text).__name__}; expected a string")
    line = " ".join(filter(None, (_without_comment(each).strip() for each in text.splitlines())))
    if not line:
        raise BadValue(f"{text[:80]!r} is not a statement; expected a line of URScript")
    if line in WORDS:
        raise BadValue(f"{line!r} is a command word, not a statement; use the method of Interpreter for this word")
    for character in line:
        if character != "\t" and not character.isprintable():
            raise BadValue(f"{character!r} in {line[:80]!r}: a statement must not contain control characters")
    if len(line.encode()) > LONGEST_STATEMENT:
        raise BadValue(f"the statement has {len(line.encode())} bytes; expected at most {LONGEST_STATEMENT}")
    return line


def _without_comment(line: str) -> str:
    """Return the line without its comment, which would hide the following lines after joining."""
    quote = ""
    for at, character in enumerate(line):
        if quote:
            quote = "" if character == quote else quote
        elif character in "\"'":
            quote = character
        elif character == "#":
            return line[:at]
    return line


def parse_reply(line: str) -> Reply:
    """Parse one line from the controller.

    Raises:
        PacketError: If the line is not a known reply.

    >>> parse_reply("ack: 3: sync()")
    Reply(word='ack', number=3, text='sync()')
    """
    found = _REPLY.fullmatch(line)
    if found is None or found[1] not in ("ack", "discard", "state"):
        raise PacketError(f"{line[:200]!r} is not a known reply", packet="reply of interpreter mode")
    return Reply(found[1], int(found[2]), found[3])


class InterpreterProtocol:
    """State of one connection. Lines and replies alternate, without a greeting.

    Attributes:
        is_greeted: Always True.
        settling: Always None, because each reply has an explicit end.
    """

    is_greeted = True
    settling: float | None = None

    def __init__(self) -> None:
        self._rest = b""
        self._is_asked = False

    @property
    def is_in_step(self) -> bool:
        """Whether every line was answered, and no unexpected bytes have arrived."""
        return not self._is_asked and not self._rest

    def ask(self, text: str) -> bytes:
        """Return the bytes of a line to send.

        Raises:
            LocalError: If the reply to the previous line has not arrived.
        """
        if not self.is_in_step:
            raise LocalError(f"{text!r} cannot be sent, because the connection is out of step: use a new connection")
        self._is_asked = True
        return text.encode() + b"\n"

    def feed(self, data: bytes) -> str | None:
        """Process received bytes, and return the reply when it is complete.

        Raises:
            WrongPeer: If a line, or the unexpected data, is longer than `LONGEST_REPLY`.
        """
        self._rest += data
        line, end, rest = self._rest.partition(b"\n")
        if len(line) > LONGEST_REPLY:
            raise WrongPeer(f"the line that starts with {line[:32]!r} is too long for a reply of interpreter mode")
        if not self._is_asked and len(self._rest) > LONGEST_REPLY:
            raise WrongPeer(
                f"received {len(self._rest)} bytes without a request, which start with {line[:32]!r}; interpreter mode "
                "sends only replies"
            )
        if not end or not self._is_asked:
            return None
        self._rest, self._is_asked = rest, False
        return line.decode("utf-8", "backslashreplace").strip()

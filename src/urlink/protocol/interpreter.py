"""Interpreter mode (port 30020), sans-IO: one statement per line out, one reply per line back.

`ack: NUMBER: TEXT` or `discard: NUMBER: TEXT` for a statement, `state: NUMBER: TEXT` for a word that asks something;
public clients match replies loosely. Source: docs/protocols/urscript.md, section Interpreter mode.
"""

from __future__ import annotations

import re
from typing import NamedTuple

from linkcore.errors import BadValue, LocalError, PacketError, WrongPeer

#: Words that are not statements.
WORDS = ("skipbuffer", "abort", "statelastexecuted", "statelastinterpreted", "statelastcleared", "stateunexecuted")
#: Bytes. The limit of a controller is not known; this is far more than a statement has.
LONGEST_STATEMENT = 8000
#: Bytes of a reply: the text of the statement comes back.
LONGEST_REPLY = LONGEST_STATEMENT + 1000

_REPLY = re.compile(r"(\w+): *(-?[0-9]{1,9}): *(.*)", re.DOTALL)


class Reply(NamedTuple):
    """The reply of a controller.

    Attributes:
        word: "ack", "discard" or "state".
        number: of the statement, or the value that was queried.
        text: the statement that was sent.
    """

    word: str
    number: int
    text: str


def statement_line(text: str) -> str:
    """A statement as one line: line ends in it, which mean nothing in URScript, become blanks, and comments go.

    Raises:
        BadValue: no text, nothing but comments, a control character, a word that is not a statement, or too long.

    >>> statement_line("movej(\\n  q)  # there")
    'movej( q)'
    """
    if not isinstance(text, str):
        raise BadValue(f"a statement is text; got {type(text).__name__}")
    line = " ".join(filter(None, (_without_comment(each).strip() for each in text.splitlines())))
    if not line:
        raise BadValue(f"{text[:80]!r} is no statement")
    if line in WORDS:
        raise BadValue(f"{line!r} is no statement; interpreter mode has methods for such words")
    for character in line:
        if character != "\t" and not character.isprintable():
            raise BadValue(f"{character!r} in {line[:80]!r}: a statement holds no control characters")
    if len(line.encode()) > LONGEST_STATEMENT:
        raise BadValue(f"a statement of {len(line.encode())} bytes; at most {LONGEST_STATEMENT} are sent")
    return line


def _without_comment(line: str) -> str:
    """The line up to a comment, which would hide what follows it once all stands on one line."""
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
    """What a line of the controller says.

    Raises:
        PacketError: it says nothing that is known.

    >>> parse_reply("ack: 3: sync()")
    Reply(word='ack', number=3, text='sync()')
    """
    found = _REPLY.fullmatch(line)
    if found is None or found[1] not in ("ack", "discard", "state"):
        raise PacketError(f"{line[:200]!r} is no answer that is known", packet="reply of interpreter mode")
    return Reply(found[1], int(found[2]), found[3])


class InterpreterProtocol:
    """One connection: a line and its answer in turn. It has no greeting, and answers end where they say so.

    Attributes:
        is_greeted: always.
        settling: None.
    """

    is_greeted = True
    settling: float | None = None

    def __init__(self) -> None:
        self._rest = b""
        self._is_asked = False

    @property
    def is_in_step(self) -> bool:
        """Nothing was asked that was not answered, and nothing came that was not asked for."""
        return not self._is_asked and not self._rest

    def ask(self, text: str) -> bytes:
        """The bytes of a line.

        Raises:
            LocalError: the answer to the line before this one has not come.
        """
        if not self.is_in_step:
            raise LocalError(f"{text!r} cannot be sent on a connection that is out of step")
        self._is_asked = True
        return text.encode() + b"\n"

    def feed(self, data: bytes) -> str | None:
        """The answer, once it is whole.

        Raises:
            WrongPeer: a line, or what came with nothing asked, is longer than `LONGEST_REPLY`.
        """
        self._rest += data
        line, end, rest = self._rest.partition(b"\n")
        if len(line) > LONGEST_REPLY:
            raise WrongPeer(f"interpreter mode says short lines, but here is one that begins with {line[:32]!r}")
        if not self._is_asked and len(self._rest) > LONGEST_REPLY:
            raise WrongPeer(
                f"interpreter mode answers when it is asked, but here are {len(self._rest)} bytes that nothing asked "
                f"for, which begin with {line[:32]!r}"
            )
        if not end or not self._is_asked:
            return None
        self._rest, self._is_asked = rest, False
        return line.decode("utf-8", "backslashreplace").strip()

"""Text of one line to tokens (sections 1 and 3 of the language).

A line ends at its end, at ``%``, at a line feed, or in a string that is not closed. Spaces, tabs and carriage returns
separate tokens and mean nothing else. A number is what C's strtod takes; it has no sign. A name is a letter followed by
letters and digits: an underscore is not part of one. A string stands between quotation marks or backslashes.
"""

from __future__ import annotations

import enum
import re
from dataclasses import dataclass

from .arithmetic import NUMBER, parse_number

#: MRC keeps a name in 80 bytes and overruns them; a longer name is an error here.
LONGEST_NAME = 79

#: Each kind of token by the name of its `TokenType`, in the order in which they are tried. A string that is not closed
#: ends the line.
_TOKEN = re.compile(
    rf"""
    (?P<BLANK>   [ \t\r]+ )
  | (?P<NUMBER>  {NUMBER.pattern} )
  | (?P<NAME>    [A-Za-z][A-Za-z0-9]* )
  | \$ (?P<SYSTEM> [A-Za-z][A-Za-z0-9]* )
  | ["\\] (?P<STRING> [^"\\]* ) ["\\]
  | (?P<END>     (?=["\\%\n\0]) | \Z )
  | (?P<FOREIGN> [^\0-\x7f] )
  | (?P<SYMBOL>  == | != | >= | <= | @v | @a | . )
    """,
    re.VERBOSE,
)


class TokenType(enum.Enum):
    """The kind of a token."""

    NUMBER = "a number"
    STRING = "a text"
    NAME = "a name"
    SYSTEM = "a system variable"
    SYMBOL = "a symbol"
    #: The end of the line. Everything behind it is skipped.
    END = "the end of the line"
    #: A byte beyond ASCII. MRC's parser takes it for the end of all input.
    FOREIGN = "a character that is not ASCII"


@dataclass(frozen=True)
class Token:
    """A word of the language.

    Attributes:
        type: what it is.
        text: of a string without its quotation marks, of a system variable without the ``$``; of a symbol itself.
        column: of its first character, from 1.
        value: of a number.
    """

    type: TokenType
    text: str
    column: int
    value: float = 0.0

    def __str__(self) -> str:
        if self.type in (TokenType.END, TokenType.FOREIGN):
            return str(self.type.value)
        if self.type is TokenType.STRING:
            return f'"{self.text}"'
        return f"${self.text}" if self.type is TokenType.SYSTEM else self.text


def tokenize(line: str) -> list[Token]:
    """The tokens of a line, the last of which is its end. Takes any text; what it means is for the parser."""
    found = []
    for match in _TOKEN.finditer(line):
        name = str(match.lastgroup)
        if name != "BLANK":
            value = parse_number(match[name]) if name == "NUMBER" else 0.0
            found.append(Token(TokenType[name], match[name], match.start() + 1, value))
        if name == "END":
            break
    return found

"""Lexer: converts the text of one line to tokens (sections 1 and 3 of the language).

A line ends at the end of the text, at ``%``, at a line feed, or in a string that is not closed. Spaces, tabs and
carriage returns only separate tokens. A number has the syntax of C's strtod, without a sign. A name is a letter
followed by letters and digits, without underscores. A string is enclosed in quotation marks or backslashes.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass

from .arithmetic import parse_number

#: Maximum length of a name. MRC keeps a name in 80 bytes and overruns them; here a longer name is an error.
LONGEST_NAME = 79

_LETTERS = frozenset("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ")
_ALNUM = _LETTERS | frozenset("0123456789")
_NUMBER_START = frozenset("0123456789.")
_BLANK = frozenset(" \t\r")
_PAIRS = frozenset(("==", "!=", ">=", "<=", "@v", "@a"))


class TokenType(enum.Enum):
    """Kind of a token."""

    NUMBER = "a number"
    STRING = "a text"
    NAME = "a name"
    SYSTEM = "a system variable"
    SYMBOL = "a symbol"
    #: The end of the line. All text after it is skipped.
    END = "the end of the line"
    #: A byte beyond ASCII. MRC's parser takes it for the end of all input.
    FOREIGN = "a character that is not ASCII"


@dataclass(frozen=True)
class Token:
    """Token of the language.

    Attributes:
        type: Kind of the token.
        text: Text of the token: a string without its quotation marks, a system variable without the ``$``.
        column: Column of the first character, counted from 1.
        value: Value of a number.
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
    """Split a line into tokens, with its end as the last token.

    Accepts any text; the parser finds errors.
    """
    found = []
    place = 0
    while True:
        token, place = _next(line, place)
        found.append(token)
        if token.type is TokenType.END:
            return found


def _next(line: str, place: int) -> tuple[Token, int]:
    while place < len(line) and line[place] in _BLANK:
        place += 1
    column = place + 1
    first = line[place : place + 1]
    if first in ("", "%", "\n", "\0"):
        return Token(TokenType.END, "", column), place
    if first in _NUMBER_START:
        number = parse_number(line, place)
        if number is None:  # a point alone
            return Token(TokenType.SYMBOL, first, column), place + 1
        value, end = number
        return Token(TokenType.NUMBER, line[place:end], column, value), end
    if first in ('"', "\\"):
        # Either mark closes the string.
        end = place + 1
        while end < len(line) and line[end] not in ('"', "\\"):
            end += 1
        if end == len(line):
            return Token(TokenType.END, "", column), end
        return Token(TokenType.STRING, line[place + 1 : end], column), end + 1
    if first in _LETTERS:
        end = _end_of_name(line, place)
        return Token(TokenType.NAME, line[place:end], column), end
    if first == "$" and line[place + 1 : place + 2] in _LETTERS:
        end = _end_of_name(line, place + 1)
        return Token(TokenType.SYSTEM, line[place + 1 : end], column), end
    if line[place : place + 2] in _PAIRS:
        return Token(TokenType.SYMBOL, line[place : place + 2], column), place + 2
    if first > "\x7f":
        return Token(TokenType.FOREIGN, first, column), place + 1
    return Token(TokenType.SYMBOL, first, column), place + 1


def _end_of_name(line: str, place: int) -> int:
    while place < len(line) and line[place] in _ALNUM:
        place += 1
    return place

"""The words of a program, each with its place.

One expression knows them all. A line's end is a word too, but not inside brackets; indentation means nothing.
"""

from __future__ import annotations

import re
from typing import NamedTuple

from .errors import ScriptError
from .limits import MAX_TEXT

__all__ = ["KEYWORDS", "Source", "Token"]

_STATEMENTS = {"def", "sec", "thread", "end", "if", "elif", "else", "while", "return", "break", "continue", "pass"}
_OTHERS = {
    "halt",
    "global",
    "local",
    "run",
    "kill",
    "join",
    "and",
    "or",
    "xor",
    "not",
    "True",
    "False",
    "true",
    "false",
}
KEYWORDS = frozenset(_STATEMENTS | _OTHERS)

# That numbers may be hexadecimal is a guess.
_WORD = re.compile(
    r"""
      (?P<space>[ \t\r\f\v]+ | \#[^\n]*)
    | (?P<newline>\n)
    | (?P<number>0[xX][0-9a-fA-F]+ | (?:[0-9]+(?:\.[0-9]*)? | \.[0-9]+)(?:[eE][+-]?[0-9]+)?)
    | (?P<name>[A-Za-z_][A-Za-z_0-9]*)
    | (?P<string>"[^"\n]*" | '[^'\n]*')
    | (?P<mark>==|!=|<=|>=|[-+*/%<>=()\[\]:,])
    """,
    re.VERBOSE,
)


class Token(NamedTuple):
    """A word.

    Attributes:
        kind: `number`, `name`, `string`, `newline`, `end of text`, or the keyword or mark itself.
        text: as written.
        line, column: where it begins, from 1 on.
    """

    kind: str
    text: str
    line: int
    column: int


class Source:
    """A program's text, cut into words.

    Attributes:
        tokens: all of them, a newline and the end of the text last.

    Raises:
        ScriptError: there is something that is no word, or the text is too long.
    """

    def __init__(self, text: str) -> None:
        if len(text) > MAX_TEXT:
            raise ScriptError(1, 1, f"program_too_long:{len(text)}:")
        self._lines = text.split("\n")
        self.tokens: list[Token] = []
        line, begin, at, depth = 1, 0, 0, 0
        while at < len(text):
            match = _WORD.match(text, at)
            if match is None:
                raise self.error(line, at - begin + 1)
            kind, word = match.lastgroup or "", match.group()
            if kind == "newline":
                if not depth:
                    self.tokens.append(Token(kind, "", line, at - begin + 1))
                line, begin = line + 1, match.end()
            elif kind == "mark":
                # A bracket too many is for the parser to find.
                depth = max(0, depth + (word in "([") - (word in ")]"))
                self.tokens.append(Token(word, word, line, at - begin + 1))
            elif kind == "name" and word in KEYWORDS:
                self.tokens.append(Token(word, word, line, at - begin + 1))
            elif kind != "space":
                self.tokens.append(Token(kind, word, line, at - begin + 1))
            at = match.end()
        column = at - begin + 1
        self.tokens += [Token("newline", "", line, column), Token("end of text", "", line, column)]

    def error(self, line: int, column: int) -> ScriptError:
        """A syntax error there; the controller quotes the line."""
        return ScriptError(line, column, f"syntax_error_on_line:{line}:{self._lines[line - 1].rstrip()}:")

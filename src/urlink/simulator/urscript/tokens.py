"""Lexer, which splits the text of a program into tokens and records their places in the text.

One regular expression matches every token, together with the blanks and comments before the token. Line ends are
ordinary white space, because public programs that run on real controllers need this: two statements are on one line, or
an expression continues on the next line after `=`.

The work is proportional to the length of the text. Each character is examined once, because one alternative of the
expression always matches; the last alternative is `unknown`.
"""

from __future__ import annotations

import re
from bisect import bisect_right

from .errors import MAX_TEXT, MAX_TOKENS, ProgramError

#: Kinds of tokens. The first three are names of groups in `_TOKEN`. The kind of a keyword or of a punctuation mark is
#: its own text.
NUMBER, NAME, STRING, END = "number", "name", "string", "end of text"

_STATEMENTS = {"def", "sec", "thread", "end", "if", "elif", "else", "while", "return", "break", "continue", "pass"}
_SIMPLE = {"halt", "global", "local", "run", "kill", "join"}
_IN_EXPRESSIONS = {"and", "or", "xor", "not", "True", "False", "true", "false"}
KEYWORDS = frozenset(_STATEMENTS | _SIMPLE | _IN_EXPRESSIONS)

# It is assumed that hexadecimal numbers are allowed.
_TOKEN = re.compile(
    r"""
    \s* (?: \#[^\n]* \s* )*
    (?:
        (?P<number>0[xX][0-9a-fA-F]+ | (?:[0-9]+(?:\.[0-9]*)? | \.[0-9]+)(?:[eE][+-]?[0-9]+)?)
      | (?P<string>"[^"\n]*" | '[^'\n]*')
      | (?P<name>[A-Za-z_][A-Za-z_0-9]*)
      | (?P<mark>==|!=|<=|>=|[-+*/%<>=()\[\]:,.$])
      | (?P<end>\Z)
      | (?P<unknown>.)
    )
    """,
    re.VERBOSE,
)


class SourceText:
    """Text of a program, with methods that make errors with line and column.

    Attributes:
        text: Text of the program.

    Raises:
        ProgramError: If the text is too long.
    """

    def __init__(self, text: str) -> None:
        self.text = text
        self._line_starts: list[int] | None = None
        if len(text) > MAX_TEXT:
            raise ProgramError(1, 1, f"program_too_long:{len(text)}:")

    def line_and_column(self, place: int) -> tuple[int, int]:
        """Return the line and the column of a place, counted from 1."""
        if self._line_starts is None:
            self._line_starts = [0, *(match.end() for match in re.finditer("\n", self.text))]
        line = bisect_right(self._line_starts, place)
        return line, place - self._line_starts[line - 1] + 1

    def failure(self, place: int, text: str) -> ProgramError:
        """Return an error with this message for a place in the text."""
        return ProgramError(*self.line_and_column(place), text)

    def syntax_error(self, place: int) -> ProgramError:
        """Return a syntax error for a place in the text. The error quotes the line."""
        line, _ = self.line_and_column(place)
        begin = self.text.rfind("\n", 0, place) + 1
        end = self.text.find("\n", place)
        quoted = self.text[begin : len(self.text) if end < 0 else end].rstrip()
        return self.failure(place, f"syntax_error_on_line:{line}:{quoted}:")


def tokens_of(source: SourceText) -> tuple[list[str], list[str], list[int]]:
    """Return the tokens of a text: their kinds, texts and places.

    The kind of the last token is `END`.

    Raises:
        ProgramError: If there is an unknown character, or if there are too many tokens.
    """
    kinds: list[str] = []
    texts: list[str] = []
    places: list[int] = []
    for match in _TOKEN.finditer(source.text):
        kind = match.lastgroup or ""
        if kind == "end":
            break
        word, place = match[kind], match.start(kind)
        if kind == "unknown":
            raise source.syntax_error(place)
        kinds.append(word if kind == "mark" or word in KEYWORDS else kind)
        texts.append(word)
        places.append(place)
        if len(kinds) > MAX_TOKENS:
            raise source.failure(place, f"program_too_long:{len(kinds)}:")
    kinds.append(END)
    texts.append("")
    places.append(len(source.text))
    return kinds, texts, places

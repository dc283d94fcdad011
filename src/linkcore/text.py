"""Text from elsewhere, made safe to show: what came over the wire never steers a terminal or forges a line of a log."""

from __future__ import annotations

__all__ = ["printable"]


def printable(text: object) -> str:
    r"""The text of an object on one line, every character that is not printable written as its escape.

    That is all that moves the cursor, colours, renames the window, reverses the direction of writing or hides: control
    characters, ESC, C1, bidirectional overrides, line separators, lone surrogates. Used wherever text of a peer, or an
    error that may quote some, is printed or logged.

    >>> printable("stop\x1b[2J\u202e\n")
    'stop\\x1b[2J\\u202e\\n'
    """
    shown = str(text)
    if shown.isprintable():
        return shown
    return "".join(character if character.isprintable() else _escaped(character) for character in shown)


def _escaped(character: str) -> str:
    return character.encode("unicode_escape").decode("ascii")

"""Checks a user's source and wraps it so that its end can be distinguished from a stop.

A program itself reports that it begins and that it has reached its end: its first and last statements are a `textmsg`.
The user's source is between them, as a function that is called. Its own `return` is therefore also an end, while `halt`
and a stop by another client are not. Programs of public drivers show that a function can be defined within a program,
and threads and functions within that function. How deep the nesting might be is unknown.

The controller might read a text long after it was sent, because the network or the controller itself was delayed. By
then the program might no longer be wanted. Therefore a program that might move the arm first asks for permission
(`Permission`). It clears the `StartPlace`, reports that it begins, and waits, cycle by cycle and for a limited time,
until its own token is written there. The sender answers with a `sec` that writes this token, but only if the program is
still wanted. Without an answer, the program ends, and the arm has not moved. Each program has a unique token, because
several clients might send programs to one controller. The permission for one program must not start the program of
another client, which might no longer exist.

The place is an integer output register (with a 31-bit token) if programs have the upper range of registers, which no
fieldbus uses: since 3.9 and 5.3 (docs/protocols/rtde.md, Releases). According to the documentation, one program can
read what another program has written there: output registers are in the memory of the system. Older
firmware has flags of one bit each, which public drivers set with a `sec` (docs/protocols/urscript.md, Flags). A `sec`
is executed within one cycle of the controller, so no program sees a part of a token (script manual, "Secondary
Programs"). How long a real controller takes from the `textmsg` to the `sec` is unknown.

The check only counts words that open and end a block. The controller checks the rest.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from typing import Literal, NamedTuple

from linkcore.errors import BadValue
from linkcore.wire.fields import Since

from ..protocol.firmware import Firmware
from .text import identifier, quoted

#: The first firmwares with the upper range of registers, 24 to 47 (RTDE guide of the vendor).
HAS_REGISTERS = Since("3.9/5.3")
#: Maximum size in bytes. The controller's own limit is unknown; the largest public driver program has about 60 kB.
LARGEST = 1 << 20

_INDENT = "  "
# A string, a comment, or a word that opens or ends a block.
_TOKEN = re.compile(r"\"[^\"]*\"|#.*|\b(?:def|sec|thread|while|if|for|end)\b")
_HEAD = re.compile(r"\s*(def|sec)\s+([A-Za-z_][A-Za-z0-9_]*)\s*\(\s*([^)]*)\)\s*:")
# A statement that is incomplete, and would take the following marker as its continuation.
_UNFINISHED = re.compile(r"(?:[-+*/%=<>,(\[]|\b(?:and|or|not|xor))$")
_NUMBER_IN_TEXT = re.compile(r"^(syntax_error_on_line:)(\d+)")


class StartPlace(NamedTuple):
    """Place on the controller where the token of a permitted program is written.

    Attributes:
        register: Number of the integer output register; None for none.
        flags: Numbers of flags; the first one is the lowest bit of the token.
    """

    register: int | None
    flags: tuple[int, ...]

    def on(self, firmware: Firmware) -> StartPlace:
        """Return the part that is used on a firmware: the register, the flags, or nothing."""
        if self.register is not None and firmware in HAS_REGISTERS:
            return StartPlace(self.register, ())
        return StartPlace(None, self.flags)

    @property
    def tokens(self) -> int:
        """Number of tokens, which are counted from 1; a cleared place contains 0."""
        return (1 << 31) - 1 if self.register is not None else (1 << len(self.flags)) - 1

    def writing(self, token: int) -> list[str]:
        """Return the statements that write a token."""
        if self.register is not None:
            return [f"write_output_integer_register({self.register}, {token})"]
        return [f"set_flag({flag}, {bool(token >> bit & 1)})" for bit, flag in enumerate(self.flags)]

    def holds(self, token: int) -> str:
        """Return the condition that this token is written in the place."""
        if self.register is not None:
            return f"read_output_integer_register({self.register}) == {token}"
        parts = [f"get_flag({flag})" for flag in self.flags]
        return " and ".join(part if token >> bit & 1 else f"not {part}" for bit, part in enumerate(parts))


class Permission(NamedTuple):
    """Permission that a program waits for before it moves the arm.

    Attributes:
        place: Place where its token must be written.
        token: Token of this program, 1 to `StartPlace.tokens`.
        cycles: Time that it waits, in cycles of the controller.
    """

    place: StartPlace
    token: int
    cycles: int


class Wrapped(NamedTuple):
    """A program as it is sent.

    Attributes:
        name: Name that the controller reports.
        text: Whole lines of URScript.
        is_secondary: Whether it is a `sec`, which runs in addition to the main program.
        first: Number to subtract from the number of the first line to get the user's line number.
        above: The same for all other lines.
        indent: Indentation of the user's lines, in columns.
        lines: Number of lines that the user wrote.
        permission: Permission that it waits for before it moves the arm; None if it begins at once.
    """

    name: str
    text: str
    is_secondary: bool
    first: int
    above: int
    indent: int
    lines: int
    permission: Permission | None

    def place(self, line: int, column: int) -> tuple[int, int]:
        """Convert a line and column of the sent text to the line and column of the user's source."""
        own = line - (self.first if line == 1 else self.above)
        return min(max(own, 1), self.lines), max(column - self.indent, 1)

    def words(self, text: str) -> str:
        """Return the controller's error text, with a line number in it converted as by `place`.

        If a program ends in the middle of a statement, the controller reports the error in the next line. That line was
        not written by the user, so it is not quoted.
        """
        found = _NUMBER_IN_TEXT.match(text)
        if found is None:
            return text
        line = int(found[2])
        if line - (self.first if line == 1 else self.above) > self.lines:
            return f"{found[1]}{self.lines}: the program ends in the middle of a statement"
        quoted = text[found.end() :]
        own = quoted.replace(":" + " " * self.indent, ":", 1) if quoted.startswith(":") else quoted
        return f"{found[1]}{self.place(line, 1)[0]}{own}"


class _Item(NamedTuple):
    """A statement at the top level of the source, with its first and last line, counted from 0."""

    word: str
    first: int
    last: int


def start_marker(name: str) -> str:
    """Return the first `textmsg` of a program."""
    return f"{name} started"


def finish_marker(name: str) -> str:
    """Return the last `textmsg` of a program."""
    return f"{name} finished"


def expiry_marker(name: str) -> str:
    """Return the `textmsg` of a program that ends because it was not permitted."""
    return f"{name} was not permitted to go on"


def grant(permission: Permission) -> str:
    """Return the secondary program that permits the program waiting for this permission; it takes no time."""
    statements = [_INDENT + statement for statement in permission.place.writing(permission.token)]
    return "\n".join(["sec urlink_permission():", *statements, "end"]) + "\n"


def _read(source: str) -> list[str]:
    """Return the lines of a source.

    Raises:
        BadValue: If it is not a text that could be a program.
    """
    if not isinstance(source, str):
        raise BadValue(f"the program is of type {type(source).__name__}; expected a string")
    try:
        size = len(source.encode())
    except UnicodeEncodeError as error:
        raise BadValue(f"the program contains {source[error.start]!r}, which is not a valid character") from None
    if size > LARGEST:
        raise BadValue(f"the program has {size} bytes; the maximum is {LARGEST}")
    lines = source.replace("\r\n", "\n").rstrip("\n").split("\n")
    for number, line in enumerate(lines, 1):
        for character in line:
            if character != "\t" and (character < " " or character == "\x7f"):
                raise BadValue(f"line {number} of the program contains the control character {character!r}")
    return lines


def wrap(source: str, token: str, permission: Permission | None = None) -> Wrapped:
    """Wrap a user's source as it is sent.

    Statements at the top level run in order. If the last top-level item is a function (`def`), it is the program and is
    called at the end. A controller would also run the last of several functions. A `sec` remains a `sec`.

    Args:
        token: Text that makes the name unique.
        permission: Permission that it waits for; None to begin at once. A `sec`, which must not take time, never waits.

    Raises:
        BadValue: If there is nothing to run, a block without its `end`, an `end` without its block, an incomplete last
            statement, a program that needs arguments, several functions of which only the last would run, or a `sec`
            that is not alone.
    """
    lines = _read(source)
    items = _items(lines)
    kind = _kind(items)
    if kind == "sec":
        return _secondary(lines, items[0], token)
    called, called_line = "", ""
    if kind == "def":
        *others, last = [item for item in items if item.word == "def"]
        called = _called(lines[last.first], last.first)
        _check_used(lines, others, called)
        called_line = f"{called}()"
    return _program(f"{called or 'urlink'}_{token}", lines, called_line, permission)


def program(name: str, body: Sequence[str], permission: Permission | None = None) -> Wrapped:
    """Return the lines of a program of this library as they are sent."""
    return _program(identifier(name), list(body), "", permission)


def _program(name: str, lines: list[str], last: str, permission: Permission | None) -> Wrapped:
    begin = [f"textmsg({quoted(start_marker(name))})"]
    if permission is not None:
        begin = _asking(name, begin, permission)
    body = [
        f"def {name}():",
        *(_INDENT + line for line in begin),
        *(_INDENT + line if line.strip() else "" for line in lines),
        *([_INDENT + last] if last else []),
        f"{_INDENT}textmsg({quoted(finish_marker(name))})",
        "end",
    ]
    above = 1 + len(begin)
    return Wrapped(
        name,
        "\n".join(body) + "\n",
        is_secondary=False,
        first=above,
        above=above,
        indent=len(_INDENT),
        lines=len(lines),
        permission=permission,
    )


def _asking(name: str, begin: list[str], permission: Permission) -> list[str]:
    """Return `begin` and a wait for the permission; the wait restarts if another program's token is found."""
    place = permission.place
    begin = [*place.writing(0), *begin]
    is_permitted = place.holds(permission.token)
    return [
        *begin,
        "urlink_cycles = 0",
        f"while urlink_cycles < {permission.cycles} and not ({is_permitted}):",
        f"{_INDENT}urlink_cycles = urlink_cycles + 1",
        f"{_INDENT}if not ({place.holds(0)}):",
        *(_INDENT * 2 + line for line in begin),
        f"{_INDENT}end",
        f"{_INDENT}sync()",
        "end",
        f"if not ({is_permitted}):",
        f"{_INDENT}textmsg({quoted(expiry_marker(name))})",
        f"{_INDENT}halt",
        "end",
    ]


def _secondary(lines: list[str], item: _Item, token: str) -> Wrapped:
    # No public program has a function within a `sec`, so the statements of a `sec` stay where they are.
    head = _HEAD.match(lines[item.first])
    called = _called(lines[item.first], item.first)
    end = lines[item.last].rpartition("end")[0]
    if head is None or end.strip() or item.first == item.last or lines[item.first][head.end() :].strip():
        raise BadValue("a sec must have its head and its `end` on separate lines")
    name = f"{called}_{token}"
    text = [
        f"sec {name}():",
        f"{_INDENT}textmsg({quoted(start_marker(name))})",
        *lines[item.first + 1 : item.last],
        f"{_INDENT}textmsg({quoted(finish_marker(name))})",
        "end",
    ]
    return Wrapped(
        name,
        "\n".join(text) + "\n",
        is_secondary=True,
        first=-item.first,
        above=1 - item.first,
        indent=0,
        lines=len(lines),
        permission=None,
    )


def _kind(items: list[_Item]) -> Literal["def", "sec", "body"]:
    words = [item.word for item in items]
    if not words:
        raise BadValue("the program is empty")
    if "sec" in words:
        if len(words) > 1:
            raise BadValue("a sec must be sent alone, because it runs in addition to the program, not as a part of it")
        return "sec"
    spoken = [word for word in words if word != "thread"]
    return "def" if spoken[-1:] == ["def"] else "body"


def _called(line: str, number: int) -> str:
    """Return the name of the function that is called without arguments."""
    head = _HEAD.match(line)
    if head is None:
        raise BadValue(f"line {number + 1} of the program: expected something like 'def name():'; got {line.strip()!r}")
    arguments = [each for each in head[3].split(",") if each.strip()]
    if not all("=" in each for each in arguments):
        raise BadValue(f"line {number + 1} of the program: {head[2]} takes arguments; a program must not need any")
    return head[2]


def _check_used(lines: list[str], others: Sequence[_Item], called: str) -> None:
    """Check that the functions above the called one are not all separate programs.

    A function that is not used is legal, as in a collection of helper functions. But if none of the functions is used,
    the source consists of several programs, of which only the last would run.

    Raises:
        BadValue: If none of these functions is mentioned outside of itself.
    """
    code = [_TOKEN.sub(lambda found: "" if found[0][0] in '"#' else found[0], line) for line in lines]
    names = []
    for item in others:
        head = _HEAD.match(lines[item.first])
        if head is None:
            return
        rest = [*code[: item.first], *code[item.last + 1 :]]
        if any(re.search(rf"\b{head[2]}\b", line) for line in rest):
            return
        names.append(head[2])
    if names:
        raise BadValue(
            f"the program has several functions, but nothing calls {', '.join(names)}, so only the last one, {called}, "
            f"would run; call them in {called}, or send each with a separate run()"
        )


def _items(lines: list[str]) -> list[_Item]:
    """Return the statements and functions at the top level."""
    items: list[_Item] = []
    opened: list[tuple[str, int]] = []
    end = (0, "")
    for number, line in enumerate(lines):
        code = _TOKEN.sub(lambda found: "" if found[0].startswith("#") else found[0], line).strip()
        if code:
            end = (number, code)
        if not opened and code:
            first = re.match(r"\w+", code)
            items.append(_Item(first[0] if first else code[0], number, number))
        for word in _tokens(line, number):
            if word != "end":
                opened.append((word, number))
            elif not opened:
                raise BadValue(f"line {number + 1} of the program: this `end` closes no block")
            else:
                opened.pop()
                if not opened:
                    items[-1] = items[-1]._replace(last=number)
    if opened:
        word, number = opened[-1]
        raise BadValue(f"line {number + 1} of the program: `{word}` has no `end`")
    if _UNFINISHED.search(end[1]):
        raise BadValue(f"line {end[0] + 1} of the program: the program ends in the middle of a statement, {end[1]!r}")
    return items


def _tokens(line: str, number: int) -> Iterator[str]:
    """Yield the words in a line that open or end a block; strings and comments are skipped."""
    bare = _TOKEN.sub(lambda found: "" if found[0][0] in '"#' else found[0], line)
    if '"' in bare:
        raise BadValue(f"line {number + 1} of the program: a string is not closed")
    for found in _TOKEN.finditer(line):
        if found[0][0] not in '"#':
            yield found[0]

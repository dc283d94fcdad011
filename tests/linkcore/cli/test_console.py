"""Lines of stdin that arrive in pieces, and pauses without input."""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Iterator
from typing import TextIO

import pytest

from linkcore.cli import console
from linkcore.errors import LocalError


def forget_stdin() -> None:
    """Let the console read the replaced stdin; on Windows, a thread reads the stdin of the first call."""
    if sys.platform == "win32":
        console._chunks.cache_clear()


@pytest.fixture
def writer(monkeypatch: pytest.MonkeyPatch) -> Iterator[TextIO]:
    """Return the end of a pipe of which stdin is the other end."""
    reading, writing = os.pipe()
    with os.fdopen(reading) as stdin, os.fdopen(writing, "w") as writer:
        monkeypatch.setattr(sys, "stdin", stdin)
        forget_stdin()
        yield writer


def send(writer: TextIO, text: str) -> None:
    writer.write(text)
    writer.flush()


@pytest.mark.real_time
def test_lines_joins_partial_lines_and_ends_when_stdin_ends(writer: TextIO) -> None:
    lines = console.lines(lambda: True, pause=10.0)
    send(writer, "one\r\ntw")
    assert next(lines) == "one"
    send(writer, "o\nrest")
    assert next(lines) == "two"
    writer.close()
    assert list(lines) == []


@pytest.mark.real_time
def test_lines_yields_none_without_input(writer: TextIO) -> None:
    lines = console.lines(lambda: True, pause=0.0)
    assert [next(lines), next(lines)] == [None, None]
    send(writer, "\n")
    assert next(line for line in lines if line is not None) == ""


@pytest.mark.real_time
def test_lines_ends_when_the_caller_stops_it(writer: TextIO) -> None:
    send(writer, "one\n")
    wanted = iter([True, False])
    assert list(console.lines(lambda: next(wanted), pause=10.0)) == ["one"]


def test_read_stdin_rejects_stdin_without_descriptor(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdin", io.StringIO("one"))
    forget_stdin()
    with pytest.raises(LocalError, match="cannot wait for stdin"):
        console.read_stdin(0.0)


def test_keys_rejects_stdin_that_is_not_a_terminal(writer: TextIO) -> None:
    with pytest.raises(LocalError, match="stdin is not a terminal"), console.keys():
        pass

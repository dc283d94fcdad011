"""Progress bars of commands: on a terminal, on other streams, nested, and together with other output."""

from __future__ import annotations

import io
import logging
import re
import sys

import pytest

from linkcore.cli import progress as module
from linkcore.cli.progress import ProgressBar
from tests.waiting import until


class Terminal(io.StringIO):
    """Terminal that is both stdout and stderr."""

    def isatty(self) -> bool:
        return True

    @property
    def screen(self) -> str:
        """Visible text; each line shows the text after its last carriage return."""
        lines = []
        for line in self.getvalue().split("\n"):
            lines.append(re.split("\r", line.replace("\x1b[K", ""))[-1])
        return "\n".join(lines)


# Not fixtures: pytest replaces the streams again after the setup of a test.


def on_terminal(monkeypatch: pytest.MonkeyPatch) -> Terminal:
    """Make stdout and stderr the same terminal."""
    terminal = Terminal()
    monkeypatch.setattr(sys, "stdout", terminal)
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setattr(module, "_PERIOD", 0.001)
    monkeypatch.setattr(module, "_CALM", 0.0)
    monkeypatch.setenv("TERM", "xterm")
    return terminal


def with_lines(monkeypatch: pytest.MonkeyPatch) -> io.StringIO:
    """Make stderr a stream that is not a terminal."""
    stream = io.StringIO()
    monkeypatch.setattr(sys, "stderr", stream)
    monkeypatch.setattr(module, "_FIRST", 0.001)
    monkeypatch.setattr(module, "_LONGEST", 0.001)
    return stream


def test_terminal_shows_a_bar_and_erases_it(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = on_terminal(monkeypatch)
    with ProgressBar("writing") as progress:
        progress(0.5)
        until(lambda: f"writing [{'=' * 15}{' ' * 15}]  50%  0 s" in terminal.getvalue())
    assert terminal.screen == ""
    assert sys.stdout is terminal


def test_progress_shows_elapsed_time_when_length_is_unknown(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = on_terminal(monkeypatch)
    with ProgressBar("connecting"):
        until(lambda: "\rconnecting  0 s" in terminal.getvalue())


def test_output_appears_above_the_bar(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = on_terminal(monkeypatch)
    with ProgressBar("working") as progress:
        for number in range(3):
            drawn = terminal.getvalue().count("working")
            until(lambda drawn=drawn: terminal.getvalue().count("working") > drawn)  # type: ignore[misc]
            print(f"line {number}")
            progress(number / 3)
        logging.StreamHandler(sys.stderr).emit(logging.makeLogRecord({"msg": "logged"}))
    assert terminal.screen == "line 0\nline 1\nline 2\nlogged\n"


def test_bar_is_not_drawn_after_an_unfinished_line(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = on_terminal(monkeypatch)
    with ProgressBar("working") as progress:
        until(lambda: "working" in terminal.getvalue())
        print("continue? ", end="")
        asked = terminal.getvalue()
        assert asked.endswith("\r\x1b[Kcontinue? ")
        screen = ProgressBar._screen
        assert screen is not None
        assert not screen.is_at_start
        progress(text="the next step")
        until(lambda: "the next step" in terminal.getvalue())


def test_bar_with_the_latest_update_is_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = on_terminal(monkeypatch)
    with ProgressBar("outer") as outer:
        with ProgressBar("inner") as inner:
            until(lambda: "inner" in terminal.getvalue())
            outer(0.1)
            until(lambda: "outer [" in terminal.getvalue())
            inner(0.2)
            until(lambda: "inner [" in terminal.getvalue())
        shown = terminal.getvalue().count("outer [")
        until(lambda: terminal.getvalue().count("outer [") > shown)


def test_progress_prints_plain_lines_without_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    lines = with_lines(monkeypatch)
    with ProgressBar("reading") as progress:
        until(lambda: "reading: after 0 s\n" in lines.getvalue())
        progress(0.25)
        until(lambda: "reading: 25% after 0 s\n" in lines.getvalue())
    assert "\r" not in lines.getvalue()
    assert "\x1b" not in lines.getvalue()


def test_progress_shows_nothing_for_short_or_quiet_work(monkeypatch: pytest.MonkeyPatch) -> None:
    lines = with_lines(monkeypatch)
    monkeypatch.setattr(module, "_FIRST", 60.0)
    with ProgressBar("reading", quiet=True) as progress:
        progress(0.5)
        assert ProgressBar._screen is None
    with ProgressBar("reading") as progress:
        progress(0.5)
    assert lines.getvalue() == ""


def test_progress_estimates_the_remaining_time(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 100.0
    monkeypatch.setattr("linkcore.cli.progress.clock.now", lambda: now)
    progress = ProgressBar("reading\x1b run", quiet=True)
    now = 130.0
    progress(0.25)
    assert progress.line == "reading\\x1b run: 25% after 30 s, about 1 min 30 s left"
    now = 140.0
    assert progress.line.endswith("after 40 s, about 1 min 20 s left")
    assert progress.drawn(200).endswith("]  25%  40 s, about 1 min 20 s left")
    progress.next("drawing")
    assert progress.line == "drawing: after 0 s"


@pytest.mark.parametrize("columns", [1, 20, 60, 80])
def test_progress_line_fits_the_terminal(columns: int) -> None:
    progress = ProgressBar("reading " + "long/" * 40, quiet=True)
    progress(0.5)
    assert len(progress.drawn(columns)) < columns


def test_progress_works_when_no_thread_can_start(monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(thread: object) -> None:
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr("threading.Thread.start", refused)
    with ProgressBar("reading") as progress:
        progress(0.5)

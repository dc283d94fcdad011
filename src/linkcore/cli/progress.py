"""Progress of a command on stderr: one line that is redrawn on a terminal, plain lines elsewhere."""

from __future__ import annotations

import contextlib
import os
import sys
import threading
from typing import Any, ClassVar

from .. import clock
from ..text import printable

#: Width of a bar in characters.
_WIDTH = 30
#: Assumed number of columns of a terminal that does not report its size.
_COLUMNS = 80
#: Seconds between two drawings on a terminal, and seconds without other output before the first drawing.
_PERIOD, _CALM = 0.2, 0.5
#: Seconds until the first plain line; and maximum pause between two lines, in s. Each pause is twice as long as the
#: previous one, up to this maximum.
_FIRST, _LONGEST = 2.0, 60.0
#: Completed fraction, and elapsed time in s, from which the remaining time is estimated.
_KNOWN, _SETTLED = 0.05, 5.0


class ProgressBar:
    """Progress of work on stderr. Use it as a context manager, and call it with the completed fraction.

    On a terminal, one line below the output is redrawn five times a second. It disappears when something is printed,
    and appears again when nothing was printed for half a second. Elsewhere, a plain line is printed after 2 s and then
    after pauses that double up to a minute. If the work takes less time, nothing is shown.

    If two blocks are nested, the bar that was called last is shown.

    Args:
        text: Description of the work, such as "reading run.urlog".
        quiet: Whether to show nothing.
    """

    _screen: ClassVar[_Screen | None] = None

    def __init__(self, text: str, quiet: bool = False) -> None:
        self.text = text
        self.part = 0.0
        self._begun = self._updated = clock.now()
        self._quiet = quiet
        self._opened: _Screen | None = None
        self._outer: ProgressBar | None = None

    def __call__(self, part: float | None = None, text: str | None = None) -> None:
        """Set the completed fraction, 0 to 1, and the description; None leaves the value unchanged."""
        if part is not None:
            self.part = part
            self._updated = clock.now()
        if text is not None:
            self.text = text
        screen = ProgressBar._screen
        if screen is not None and not self._quiet:
            screen.bar = self
            if text is not None:
                # The program has continued. So if it asked a question on this line, the user has answered, and the
                # cursor is at the beginning of a line again.
                screen.is_at_start = True

    def next(self, text: str) -> None:
        """Begin the next part of the work, with a separate fraction and duration."""
        self._begun = clock.now()
        self(0.0, text)

    @property
    def line(self) -> str:
        """Progress as a line of text."""
        words = [f"{min(max(self.part, 0.0), 1.0):.0%}"] if self.part > 0.0 else []
        return f"{printable(self.text)}: {' '.join([*words, 'after', self._elapsed()])}"

    def drawn(self, columns: int) -> str:
        """Return the progress as a line for a terminal with the given number of columns."""
        bar, part = "", min(max(self.part, 0.0), 1.0)
        if part > 0.0:
            done = round(part * _WIDTH)
            bar = f" [{'=' * done}{' ' * (_WIDTH - done)}] {part:4.0%}"
        end = f"{bar}  {self._elapsed()}"
        # The line must not wrap, because a wrapped line could not be erased.
        return f"{printable(self.text)[: max(columns - 1 - len(end), 0)]}{end}"[: columns - 1]

    def _elapsed(self) -> str:
        elapsed = clock.now() - self._begun
        if self.part < _KNOWN or self.part >= 1.0 or elapsed < _SETTLED:
            return _duration(elapsed)
        left = max((self._updated - self._begun) / self.part - elapsed, 0.0)
        return f"{_duration(elapsed)}, about {_duration(left)} left"

    def __enter__(self) -> ProgressBar:
        self._begun = self._updated = clock.now()
        if self._quiet:
            return self
        screen = ProgressBar._screen
        if screen is None:
            ProgressBar._screen = self._opened = _Screen(self)
            self._opened.open()
        else:
            self._outer, screen.bar = screen.bar, self
        return self

    def __exit__(self, *exc: object) -> None:
        if self._opened is not None:
            ProgressBar._screen = None
            self._opened.close()
        elif ProgressBar._screen is not None and self._outer is not None:
            ProgressBar._screen.bar = self._outer


def _duration(seconds: float) -> str:
    whole = round(seconds)
    return f"{whole} s" if whole < 60 else f"{whole // 60} min {whole % 60:02} s"


class _Screen:
    """Screen that draws the current bar until it is closed.

    Attributes:
        bar: The bar to show.
        is_at_start: Whether the cursor is at the beginning of a line; otherwise nothing is drawn.
    """

    def __init__(self, bar: ProgressBar) -> None:
        self.bar = bar
        self.is_at_start = True
        self._stderr: Any = sys.stderr
        self._is_terminal = self._stderr.isatty() and os.environ.get("TERM") != "dumb"
        self._replaced: list[tuple[str, Any]] = []
        self._is_drawn = False
        self._calm_since = clock.now()
        # Re-entrant, because a signal handler that prints might interrupt a write.
        self._lock = threading.RLock()
        self._over = threading.Event()
        self._thread = threading.Thread(
            target=self._draw_again if self._is_terminal else self._print_lines, name="progress", daemon=True
        )

    def open(self) -> None:
        """Start to draw. If no thread can be started, nothing is shown."""
        with contextlib.suppress(RuntimeError):
            self._thread.start()
        if self._is_terminal:
            for name in ("stdout", "stderr"):
                stream = getattr(sys, name)
                if stream.isatty():
                    self._replaced.append((name, stream))
                    setattr(sys, name, _Above(stream, self))

    def close(self) -> None:
        """Erase the bar, so that the next line of output starts in the first column."""
        self._over.set()
        try:
            clock.join(self._thread)
        finally:  # even after Ctrl-C
            for name, stream in self._replaced:
                setattr(sys, name, stream)
            with self._lock:
                self._erase()

    def write(self, stream: Any, text: str) -> int:
        """Write to a stream of the terminal above the bar."""
        with self._lock:
            self._erase()
            self._calm_since = clock.now()
            if text:
                self.is_at_start = text.endswith("\n")
            written: int = stream.write(text)
            return written

    def _erase(self) -> None:
        if self._is_drawn:
            self._is_drawn = False
            self._put("\r\x1b[K")

    def _draw_again(self) -> None:
        while not self._over.wait(_PERIOD):
            with self._lock:
                is_calm = clock.now() - self._calm_since >= _CALM
                if self._is_drawn or (self.is_at_start and is_calm):
                    self._is_drawn = True
                    self._put(f"\r{self.bar.drawn(self._columns())}\x1b[K")

    def _columns(self) -> int:
        with contextlib.suppress(OSError, ValueError):
            return os.get_terminal_size(self._stderr.fileno()).columns or _COLUMNS
        return _COLUMNS

    def _print_lines(self) -> None:
        pause = _FIRST
        while not self._over.wait(pause):
            self._put(f"{self.bar.line}\n")
            pause = min(2.0 * pause, _LONGEST)

    def _put(self, text: str) -> None:
        # If the terminal or the pipe was closed, other code ends the command.
        with contextlib.suppress(OSError, ValueError):
            self._stderr.write(text)
            self._stderr.flush()


class _Above:
    """Stream of the terminal. Its text appears above the bar."""

    def __init__(self, stream: Any, screen: _Screen) -> None:
        self._stream = stream
        self._screen = screen

    def write(self, text: str) -> int:
        return self._screen.write(self._stream, text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

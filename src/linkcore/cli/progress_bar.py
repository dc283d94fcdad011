"""A progress bar on stderr; nothing if stderr is no terminal."""

from __future__ import annotations

import sys
import time
from types import TracebackType

from ..text import printable

__all__ = ["ProgressBar"]

#: Characters of a bar.
_WIDTH = 30
#: Seconds between two drawings, and before the first: shorter work needs no bar.
_PERIOD = 0.2


class ProgressBar:
    """A progress bar, as a context manager; call it with the fraction that is done, 0 to 1.

    Args:
        text: what is being done.
        quiet: do not draw on a terminal either.

    Attributes:
        is_shown: whether it is drawn.
    """

    def __init__(self, text: str, quiet: bool = False) -> None:
        self._text = text
        self.is_shown = sys.stderr.isatty() and not quiet
        self._next = time.monotonic() + _PERIOD
        self._is_drawn = False

    def __call__(self, part: float) -> None:
        """Draw it, if the last drawing is old enough."""
        now = time.monotonic()
        if not self.is_shown or now < self._next or part <= 0.0:  # 0: there is no progress to show
            return
        self._next = now + _PERIOD
        done = round(min(max(part, 0.0), 1.0) * _WIDTH)
        # The rest of the line is erased: the bar before may have been longer.
        bar = f"\r{printable(self._text)} [{'=' * done}{' ' * (_WIDTH - done)}] {part:4.0%}\x1b[K"
        print(bar, end="", file=sys.stderr, flush=True)
        self._is_drawn = True

    def __enter__(self) -> ProgressBar:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._is_drawn:  # erased, so that what is printed next stands alone
            print("\r\x1b[K", end="", file=sys.stderr, flush=True)

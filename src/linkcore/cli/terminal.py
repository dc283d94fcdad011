"""The terminal of a command: lines on stderr, signals that end it, and a view that is drawn repeatedly."""

from __future__ import annotations

import contextlib
import math
import os
import signal
import sys
from collections.abc import Callable, Iterator
from types import FrameType
from typing import TYPE_CHECKING, Any, TypeVar

from .. import clock
from ..text import printable

if TYPE_CHECKING:
    from rich.console import RenderableType


def tell(program: str, text: str) -> None:
    """One line on stderr, in the name of a program."""
    print(f"{program}: {printable(text)}", file=sys.stderr)


class Interrupted(KeyboardInterrupt):
    """Raised by a signal that ends the program.

    Attributes:
        number: of the signal.
    """

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


@contextlib.contextmanager
def _handled(handler: Callable[[int, FrameType | None], None], *numbers: signal.Signals) -> Iterator[None]:
    before: dict[signal.Signals, Any] = {}
    # Only the main thread may set handlers; elsewhere the surrounding program handles signals.
    with contextlib.suppress(ValueError):
        for number in numbers:
            before[number] = signal.signal(number, handler)
    try:
        yield
    finally:
        for number, old in before.items():
            signal.signal(number, old)


def raise_on_sigterm() -> contextlib.AbstractContextManager[None]:
    """A context in which SIGTERM unwinds the program as Ctrl-C does."""

    def handler(number: int, frame: FrameType | None) -> None:
        raise Interrupted(number)

    return _handled(handler, signal.SIGTERM)


class Interruption:
    """A context in which Ctrl-C and SIGTERM are only noted, so that no call is interrupted; a second one raises.

    Args:
        duration: seconds after which `wait` and `is_over` say that it is over, without a signal; None for never.

    Attributes:
        number: the signal that came, or None.
    """

    def __init__(self, duration: float | None = None) -> None:
        self.number: int | None = None
        self.end_after(duration)
        self._handled = _handled(self._note, signal.SIGINT, signal.SIGTERM)

    def _note(self, number: int, frame: FrameType | None) -> None:
        if self.number is not None:
            raise Interrupted(number)  # the second signal: end at once, without cleaning up
        self.number = number

    def end_after(self, duration: float | None) -> None:
        """Be over `duration` seconds from now."""
        self._until = math.inf if duration is None else clock.now() + duration

    @property
    def is_over(self) -> bool:
        """Whether a signal has come, or the duration is over."""
        return self.number is not None or clock.now() >= self._until

    @property
    def status(self) -> int:
        """The exit status: that of a program which the signal has ended, or 0."""
        return 0 if self.number is None else 128 + self.number

    def wait(self, seconds: float) -> bool:
        """Sleep until it is over, at most `seconds`; returns whether it is."""
        until = min(clock.now() + seconds, self._until)
        # A signal that is only noted does not end a sleep, so it sleeps in short steps.
        while self.number is None and (left := until - clock.now()) > 0:
            clock.sleep(min(left, 0.05))
        return self.is_over

    def __enter__(self) -> Interruption:
        self._handled.__enter__()
        return self

    def __exit__(self, *exc: object) -> None:
        self._handled.__exit__(None, None, None)


_T = TypeVar("_T")


@contextlib.contextmanager
def drawing(
    plain: bool, tell: Callable[[str], None], line: Callable[[_T], str], panel: Callable[[_T], RenderableType]
) -> Iterator[tuple[Callable[[_T], None], float]]:
    """A context with the function that shows a value, and the seconds between two of them.

    On a terminal the panel of a value is drawn over the one before by rich, ten times a second; elsewhere, and with
    `plain`, it is one line a second.
    """
    is_drawn = not plain and sys.stdout.isatty() and os.environ.get("TERM") != "dumb"
    if is_drawn:
        try:
            import rich  # noqa: F401
        except ImportError:
            tell("plain lines, since rich is not installed; pip install 'urlink-robot[cli]' adds it")
            is_drawn = False
    if not is_drawn:
        yield lambda value: print(line(value), flush=True), 1.0
        return
    from rich.console import Console
    from rich.live import Live

    # The last panel stays on the screen, where it can be read and copied.
    console, to_terminal = Console(), sys.stderr.isatty()
    with Live(console=console, auto_refresh=False, vertical_overflow="crop", redirect_stderr=to_terminal) as live:
        yield lambda value: live.update(panel(value), refresh=True), 0.1

"""Terminal functions for commands: lines on stderr, signals that end the command, and a view that is redrawn."""

from __future__ import annotations

import contextlib
import math
import os
import shlex
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
    """Print one line on stderr, which begins with the name of the program."""
    print(f"{program}: {printable(text)}", file=sys.stderr)


def quoted(argument: str) -> str:
    """Return `argument` as a user types it in a shell: quoted if it has characters that the shell interprets.

    The command prompt of Windows knows double quotes only.
    """
    text = shlex.quote(argument)
    return f'"{argument}"' if sys.platform == "win32" and text != argument else text


class Interrupted(KeyboardInterrupt):
    """Exception for a signal that ends the program.

    Attributes:
        number: Number of the signal.
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
    """Return a context in which SIGTERM raises an exception, as Ctrl-C does."""

    def handler(number: int, frame: FrameType | None) -> None:
        raise Interrupted(number)

    return _handled(handler, signal.SIGTERM)


class Interruption:
    """Context that only records Ctrl-C and SIGTERM, so that no call is interrupted.

    A second signal raises `Interrupted`.

    Args:
        duration: Seconds after which `wait` and `is_over` return True even without a signal; None for no limit.

    Attributes:
        number: Number of the received signal, or None.
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
        """Set the end to `duration` seconds from now; None for no end."""
        self._until = math.inf if duration is None else clock.now() + duration

    @property
    def is_over(self) -> bool:
        """Whether a signal was received, or the duration has passed."""
        return self.number is not None or clock.now() >= self._until

    @property
    def status(self) -> int:
        """Exit status of a program that the signal has ended, or 0 without a signal."""
        return 0 if self.number is None else 128 + self.number

    def wait(self, seconds: float) -> bool:
        """Sleep for at most `seconds`, or until `is_over` is true; return `is_over`."""
        until = min(clock.now() + seconds, self._until)
        # Sleep in short steps, because a signal that is only recorded does not end a sleep.
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
    """Yield a function that shows a value, and the interval in s at which to call the function.

    On a terminal, rich draws the panel of a value over the previous one, ten times a second. Elsewhere, and with
    `plain`, one line per second is printed.

    Args:
        plain: Whether to print lines even on a terminal.
        tell: Function that prints a line on stderr.
        line: Function that returns a value as a line of text.
        panel: Function that returns a value as a panel of rich.
    """
    is_drawn = not plain and sys.stdout.isatty() and os.environ.get("TERM") != "dumb"
    if is_drawn:
        try:
            import rich  # noqa: F401
        except ImportError:
            tell("printing plain lines, because rich is not installed; pip install 'urlink-robot[cli]' installs it")
            is_drawn = False
    if not is_drawn:
        yield lambda value: print(line(value), flush=True), 1.0
        return
    from rich.console import Console
    from rich.live import Live

    # The last panel stays on the screen, so that it can be read and copied.
    console, to_terminal = Console(), sys.stderr.isatty()
    with Live(console=console, auto_refresh=False, vertical_overflow="crop", redirect_stderr=to_terminal) as live:
        yield lambda value: live.update(panel(value), refresh=True), 0.1

"""Ctrl-C and SIGTERM, for commands that clean up before they end."""

from __future__ import annotations

import contextlib
import signal
import time
from types import FrameType, TracebackType
from typing import Any

__all__ = ["Interrupted", "Interruption", "raise_on_sigterm"]


class Interrupted(KeyboardInterrupt):
    """Raised by a signal that ends the program.

    Attributes:
        number: of the signal.
    """

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


def raise_on_sigterm() -> contextlib.AbstractContextManager[object]:
    """A context in which SIGTERM unwinds the program as Ctrl-C does."""

    def handler(number: int, frame: FrameType | None) -> None:
        raise Interrupted(number)

    return _Handlers({signal.SIGTERM: handler})


class Interruption:
    """A context in which Ctrl-C and SIGTERM are only noted, so that no call is interrupted; a second one raises.

    Attributes:
        number: the signal that came, or None.
    """

    def __init__(self) -> None:
        self.number: int | None = None
        self._handlers = _Handlers({signal.SIGINT: self._note, signal.SIGTERM: self._note})

    def _note(self, number: int, frame: FrameType | None) -> None:
        if self.number is not None:
            raise Interrupted(number)  # the second signal: end at once, without cleaning up
        self.number = number

    def wait(self, seconds: float) -> bool:
        """Sleep until a signal comes, at most `seconds`; returns whether one has come."""
        until = time.monotonic() + seconds
        while self.number is None:
            left = until - time.monotonic()
            if left <= 0:
                return False
            # A signal that is only noted does not end a sleep, so it sleeps in short steps.
            time.sleep(min(left, 0.05))
        return True

    def raise_if_any(self) -> None:
        """End the program as the signal would have ended it.

        Raises:
            Interrupted: a signal has come.
        """
        if self.number is not None:
            raise Interrupted(self.number)

    def __enter__(self) -> Interruption:
        self._handlers.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._handlers.__exit__(kind, error, trace)


class _Handlers:
    def __init__(self, wanted: dict[signal.Signals, Any]) -> None:
        self._wanted = wanted
        self._before: dict[signal.Signals, Any] = {}

    def __enter__(self) -> None:
        # Only the main thread may set handlers; elsewhere the surrounding program handles signals.
        with contextlib.suppress(ValueError):
            for number, handler in self._wanted.items():
                self._before[number] = signal.signal(number, handler)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

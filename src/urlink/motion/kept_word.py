"""The dialogue with a program that runs while words come: the same word answers each state, until it changes."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from ..interfaces.realtime.packets import RealtimeState
from ..urscript.links import InputRegisters, ReverseSocket
from .setpoints import STOP_WORD, WAIT_WORD, setpoint

__all__ = ["KeptWord", "word"]

_NO_SPEEDS = (0.0,) * 6


def word(values: Sequence[float]) -> bytes:
    """Six values, as a program by `urlink.urscript.yielding` reads them."""
    return setpoint(values, _NO_SPEEDS)


class KeptWord:
    """A dialogue with one such program.

    Args:
        body: makes the lines of the program, for its link.
        values: (6,) of the word; None for a word that only shows that this computer is alive.

    Attributes:
        values: as given; may be set by any thread.
        is_mute: whether states are no longer answered, because the user's loop sends the words.
    """

    farewell = STOP_WORD
    is_over = False
    survives_its_program = False

    def __init__(
        self, body: Callable[[ReverseSocket | InputRegisters], list[str]], values: Sequence[float] | None = None
    ) -> None:
        self.values = values
        self.is_mute = False
        self._body = body

    def body(self, link: ReverseSocket | InputRegisters) -> list[str]:
        return self._body(link)

    def step(self, received: bytes, state: RealtimeState, now: float) -> bytes:
        if self.is_mute:
            return b""
        return WAIT_WORD if self.values is None else word(self.values)

    def conclude(self) -> None: ...

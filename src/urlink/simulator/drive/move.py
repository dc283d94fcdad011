"""What a motion function of a program waits for."""

from __future__ import annotations

__all__ = ["Move"]


class Move:
    """One movement that was begun.

    Attributes:
        is_over: the function that began it returns: the movement has ended, has come within its blend radius of the
            target, has lasted as long as was asked, or another one took its place.
    """

    __slots__ = ("is_over",)

    def __init__(self) -> None:
        self.is_over = False

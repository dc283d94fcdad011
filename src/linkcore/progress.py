"""How far something long is."""

from __future__ import annotations

from collections.abc import Callable

__all__ = ["Progress", "unseen"]

#: Called with the part of the work that is done, 0 to 1.
Progress = Callable[[float], object]


def unseen(part: float) -> None:
    """Where nobody wants to know."""

"""Check of the timeouts of waits: no wait has a longer timeout than the clients of a world pass.

A timeout that is not passed on goes unnoticed as long as the awaited event happens, which is nearly always the case. So
each wait is checked when it starts.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
from collections.abc import Callable, Iterator
from typing import Any

from linkcore import clock

from .observed import replaced

__all__ = ["LONGEST", "watching"]

#: Longer than any timeout in worlds, and than every default of the library and of the compatibility layers, in s.
LONGEST = 1000.0


@contextlib.contextmanager
def watching(fault: Callable[[str], object]) -> Iterator[None]:
    """Check all waits while the block lasts."""

    def look(seconds: Any, where: str) -> None:
        if isinstance(seconds, (int, float)) and LONGEST < seconds < math.inf:
            fault(f"the library would wait {seconds:.4g} s in {where}, but no client has passed such a timeout")

    def of_part(slice_of: Callable[[Any], Any]) -> Callable[[Any], Any]:
        def wrapped(seconds: Any) -> Any:
            look(seconds, "a wait")
            return slice_of(seconds)

        return wrapped

    def of_wait(wait: Callable[..., Any]) -> Callable[..., Any]:
        def wrapped(attempt: Any, timeout: Any = None) -> Any:
            look(timeout, "a wait")
            return wait(attempt, timeout)

        return wrapped

    def of_timer(call_at: Callable[..., Any]) -> Callable[..., Any]:
        def wrapped(loop: Any, when: float, *rest: Any, **options: Any) -> Any:
            look(when - loop.time(), "a timer of the event loop")
            return call_at(loop, when, *rest, **options)

        return wrapped

    with (
        replaced(clock, "slice_of", of_part),
        replaced(clock, "wait", of_wait),
        replaced(asyncio.BaseEventLoop, "call_at", of_timer),
    ):
        yield

"""How long the library waits: no wait lasts longer than any timeout that a client of a world gives.

A timeout that is lost on its way goes unnoticed for as long as what is waited for comes, which it nearly always does.
So each wait is looked at as it begins.
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

#: s: longer than any timeout that worlds give, and than every default of the library and of what it stands in for.
LONGEST = 1000.0


@contextlib.contextmanager
def watching(fault: Callable[[str], object]) -> Iterator[None]:
    """Look at the waits, for as long as the block lasts."""

    def look(seconds: Any, where: str) -> None:
        if isinstance(seconds, (int, float)) and LONGEST < seconds < math.inf:
            fault(f"the library would wait {seconds:.4g} s in {where}: nobody has given such a timeout")

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

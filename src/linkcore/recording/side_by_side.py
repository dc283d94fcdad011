"""Parts of one long computation on several processors, in threads: for what lets go of the interpreter's lock."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

__all__ = ["side_by_side"]

T = TypeVar("T")

#: Threads at most: from some on, it is the memory that is waited for.
_THREADS = 4


def side_by_side(part: Callable[[int, int], T], begin: int, end: int, share: int) -> list[T]:
    """What `part` returns of each share of a range, in order.

    Args:
        part: is called with the begin and the end of a share; for several at a time where there are several processors.
        begin, end: the range.
        share: how much is worth a thread's while.

    Raises:
        Exception: what `part` raises, of the first share for which it does.
    """
    shares = [(at, min(at + share, end)) for at in range(begin, end, share)]
    threads = min(os.cpu_count() or 1, _THREADS, len(shares))
    if threads <= 1:
        return [part(*each) for each in shares]
    with ThreadPoolExecutor(threads, "linkcore recording") as pool:
        return list(pool.map(part, *zip(*shares, strict=True)))

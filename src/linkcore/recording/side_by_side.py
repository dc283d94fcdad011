"""Parts of one long computation on several processors, in threads: for functions that release the interpreter lock."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

__all__ = ["side_by_side"]

T = TypeVar("T")

#: Most threads: with more, the memory is the limit.
_THREADS = 4


def side_by_side(part: Callable[[int, int], T], begin: int, end: int, share: int) -> list[T]:
    """The results of `part` for each share of a range, in order.

    Args:
        part: called with the begin and the end of a share; in several threads if there are several processors.
        begin, end: the range.
        share: length of a share that is worth a thread.

    Raises:
        Exception: the error of `part`, for the first share that has one.
    """
    shares = [(at, min(at + share, end)) for at in range(begin, end, share)]
    threads = min(os.cpu_count() or 1, _THREADS, len(shares))
    if threads <= 1:
        return [part(*each) for each in shares]
    with ThreadPoolExecutor(threads, "linkcore recording") as pool:
        return list(pool.map(part, *zip(*shares, strict=True)))

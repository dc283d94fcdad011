"""Waits for a gripper: its state is read repeatedly, because no gripper reports a change by itself."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from linkcore import clock
from linkcore.errors import LinkTimeout

T = TypeVar("T")

#: Interval for reading the state of a moving gripper, in seconds.
POLL = 0.02


def read_until(read: Callable[[], T], is_done: Callable[[T], object], until: float, failure: str) -> T:
    """Return the first value for which `is_done` is true.

    Args:
        read: Function that returns the current value.
        is_done: Condition.
        until: Time in s of `linkcore.clock.now` at which the wait ends.
        failure: Text of the error.

    Raises:
        LinkTimeout: If there is no such value in time.
    """
    while not is_done(found := read()):
        left = until - clock.now()
        if left <= 0:
            raise LinkTimeout(failure)
        clock.sleep(min(POLL, left))
    return found

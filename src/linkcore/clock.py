"""The clock as a value: what a class takes as the default of its `clock`.

Simulated time (`linkcore.simulated`) takes the place of `time.monotonic` in each module that has it by a name. A
default is bound when its function is defined and would stay the real clock, so it is this function, which looks the
name up when it is called.
"""

from __future__ import annotations

import time

__all__ = ["monotonic"]


def monotonic() -> float:
    """Seconds of `time.monotonic`, of the simulated clock while time is simulated."""
    return time.monotonic()

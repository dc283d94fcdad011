"""When bytes arrived."""

from __future__ import annotations

import time
from typing import NamedTuple

__all__ = ["Stamp"]


class Stamp(NamedTuple):
    """When the bytes of a packet arrived, on two clocks.

    Attributes:
        monotonic: `time.monotonic()` in seconds; compare with it to learn an age.
        wall: `time.time()`, seconds since 1970 UTC; compare with it across machines.
    """

    monotonic: float
    wall: float

    @classmethod
    def now(cls) -> Stamp:
        """The stamp of this moment."""
        return cls(time.monotonic(), time.time())

    @property
    def age(self) -> float:
        """Seconds since then."""
        return time.monotonic() - self.monotonic

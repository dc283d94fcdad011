"""How long to wait before trying again."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from ..arguments import check_seconds
from ..errors import BadValue

__all__ = ["Backoff"]


@dataclass(frozen=True)
class Backoff:
    """Exponential, bounded, with jitter so that many clients do not come back in step.

    Attributes:
        first: seconds before the first try.
        factor: growth from try to try.
        most: seconds that no wait exceeds.
        jitter: share by which each wait is varied at random, 0 to 1.
        tries: how many tries before giving up; None tries for ever, 0 never.

    Raises:
        BadValue: a time that is none, a factor below 1, a jitter outside 0 to 1, or no number of tries.
    """

    first: float = 0.1
    factor: float = 2.0
    most: float = 5.0
    jitter: float = 0.2
    tries: int | None = None

    def __post_init__(self) -> None:
        check_seconds(self.first, "first")
        check_seconds(self.most, "most")
        if not (self.factor >= 1 and 0 <= self.jitter <= 1 and (self.tries is None or self.tries >= 0)):
            raise BadValue(f"{self}; expected a factor of at least 1, a jitter from 0 to 1, and no tries below 0")

    def waits(self) -> Iterator[float]:
        """Seconds to wait before each try; ends when it is time to give up.

        >>> list(Backoff(first=0.1, most=0.3, jitter=0, tries=4).waits())
        [0.1, 0.2, 0.3, 0.3]
        """
        # Imported here: it brings hashlib with it, and importing the library stays cheap.
        import random

        wait, done = self.first, 0
        while self.tries is None or done < self.tries:
            yield min(wait * (1 + random.uniform(-self.jitter, self.jitter)), self.most)
            wait = min(wait * self.factor, self.most)
            done += 1

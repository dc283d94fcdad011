"""Random numbers of the sensors, as pure functions of a seed and of an index.

No value depends on when, or how often, the others are read. So a sensor that no client reads costs nothing.

A table of normal numbers is drawn once for each seed, and is read at the index. Its length is prime, so that the
channels do not repeat together. `wandering` connects numbers of the table, which are some steps apart. The result has
the same standard deviation everywhere, and neighbouring steps correlate.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

_LENGTH = 8191
#: Distance in the table between two channels.
_CHANNEL = 1171


class Noise:
    """Random numbers of one robot, six at a time.

    Args:
        seed: Seed; None makes all numbers 0.
        scale: Standard deviation of the numbers.
    """

    def __init__(self, seed: int | None, scale: float = 1.0) -> None:
        self._table = (0.0,) * (_LENGTH + 6) if seed is None else _drawn(seed, scale)

    def white(self, index: int, channel: int) -> Sequence[float]:
        """Return six normal numbers, independent of those of other indices.

        Args:
            index: Number of a cycle, or of a rest.
            channel: Number of the quantity.
        """
        begin = (index * 6 + channel * _CHANNEL) % _LENGTH
        return self._table[begin : begin + 6]

    def wandering(self, steps: int, length: int, channel: int) -> Sequence[float]:
        """Return six normal numbers that change gradually.

        Args:
            steps: Number of steps, such as cycles.
            length: Number of steps between two independent numbers.
            channel: Number of the quantity.
        """
        knot, past = divmod(steps, length)
        b = past / length
        a = 1.0 - b
        scale = 1.0 / math.sqrt(a * a + b * b)
        a, b = a * scale, b * scale
        table = self._table
        begin, then = ((at * 6 + channel * _CHANNEL) % _LENGTH for at in (knot, knot + 1))
        return [a * x + b * y for x, y in zip(table[begin : begin + 6], table[then : then + 6], strict=True)]

    def held(self, rests: Sequence[int], channel: int) -> Sequence[float]:
        """Return six numbers of both signs, one for each joint; `scale` has to be 1.

        They are never close to 0, like the error of a friction whose direction is not known.

        Args:
            rests: Number of the rest of each joint, shape (6,).
            channel: Number of the quantity.
        """
        numbers = [self._table[(rest * 6 + channel * _CHANNEL) % _LENGTH + joint] for joint, rest in enumerate(rests)]
        # The mean square of 0.79 + 0.25 |n| is 1.
        return [math.copysign(0.79 + 0.25 * abs(n), n) for n in numbers]


@lru_cache(maxsize=64)
def _drawn(seed: int, scale: float) -> tuple[float, ...]:
    numbers: list[float] = (scale * np.random.default_rng(seed).standard_normal(_LENGTH)).tolist()
    return (*numbers, *numbers[:6])

"""Random numbers of the sensors, as pure functions of a seed and of an index.

No value depends on when, or how often, the others are read. So a sensor that no client reads costs nothing.

Tables of normal numbers, and of signs with a size close to 1, are drawn once for each seed, and are read at the index.
Their length is prime, so that the channels do not repeat together.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

_LENGTH = 8191
#: Distance in the table between two channels.
_CHANNEL = 1171
#: Fraction of a step of `switching` after which the numbers begin to change.
_HELD = 0.75


class Noise:
    """Random numbers of one robot, six at a time.

    Args:
        seed: Seed; None makes all numbers 0.
        scale: Standard deviation of the numbers.
    """

    def __init__(self, seed: int | None, scale: float = 1.0) -> None:
        self._table, self._signed = ((0.0,) * (_LENGTH + 6),) * 2 if seed is None else _drawn(seed, scale)

    def white(self, index: int, channel: int) -> Sequence[float]:
        """Return six normal numbers, independent of those of other indices.

        Args:
            index: Number of a cycle, or of a rest.
            channel: Number of the quantity.
        """
        begin = (index * 6 + channel * _CHANNEL) % _LENGTH
        return self._table[begin : begin + 6]

    def wandering(self, steps: int, length: int, channel: int) -> Sequence[float]:
        """Return six normal numbers that change gradually, with the same standard deviation at every step.

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
        begin = (knot * 6 + channel * _CHANNEL) % _LENGTH
        then = (begin + 6) % _LENGTH
        table = self._table
        return [a * x + b * y for x, y in zip(table[begin : begin + 6], table[then : then + 6], strict=True)]

    def switching(self, steps: int, length: int, channel: int) -> Sequence[float]:
        """Return six numbers of both signs, which stay the same for three quarters of `length` steps and then change.

        A few of them already have the standard deviation of all, because they are never close to 0.

        Args:
            steps: Number of steps, such as cycles.
            length: Number of steps between two independent numbers.
            channel: Number of the quantity.
        """
        knot, past = divmod(steps, length)
        begin = (knot * 6 + channel * _CHANNEL) % _LENGTH
        now, changed = self._signed[begin : begin + 6], past / length - _HELD
        if changed <= 0.0:
            return now
        b, then = changed / (1.0 - _HELD), (begin + 6) % _LENGTH
        return [x + b * (y - x) for x, y in zip(now, self._signed[then : then + 6], strict=True)]

    def held(self, rests: Sequence[int], channel: int) -> Sequence[float]:
        """Return six numbers of both signs, one for each joint.

        They are never close to 0, like the error of a friction whose direction is not known.

        Args:
            rests: Number of the rest of each joint, shape (6,).
            channel: Number of the quantity.
        """
        return [self._signed[(rest * 6 + channel * _CHANNEL) % _LENGTH + joint] for joint, rest in enumerate(rests)]


@lru_cache(maxsize=64)
def _drawn(seed: int, scale: float) -> tuple[tuple[float, ...], tuple[float, ...]]:
    numbers = np.random.default_rng(seed).standard_normal(_LENGTH)
    # The mean square of 0.79 + 0.25 |n| is 1.
    signed = np.copysign(0.79 + 0.25 * np.abs(numbers), numbers)
    both = ((scale * each).tolist() for each in (numbers, signed))
    first, second = ((*each, *each[:6]) for each in both)
    return first, second

"""The root of a growing function, by the method of Ridders.

In a bracket, an exponential function is fitted to both ends and the middle; its root and the middle are the ends of the
next bracket. It converges quadratically, and halves the bracket at least (C. Ridders, "A New Algorithm for Computing a
Single Root of a Real Continuous Function", IEEE Transactions on Circuits and Systems, 1979).
"""

from __future__ import annotations

import math
from collections.abc import Callable

__all__ = ["root"]

#: Most steps: each halves the bracket at least, so nothing is left of it. Six are usual.
_MOST_STEPS = 60


def root(function: Callable[[float], float], low: float, high: float, precision: float) -> float:
    """The root of a growing function.

    Args:
        function: not positive at `low`, and not negative at `high`, but for rounding.
        precision: of its value.
    """
    at_low, at_high = function(low), function(high)
    for _ in range(_MOST_STEPS):
        if at_low >= -precision:
            return low
        if at_high <= precision:
            return high
        middle = 0.5 * (low + high)
        at_middle = function(middle)
        x = middle - (middle - low) * at_middle / math.sqrt(at_middle * at_middle - at_low * at_high)
        # If the root is below the middle, x is above the middle, and the other way round.
        for place, value in ((middle, at_middle), (x, function(x))):
            if value < 0.0:
                low, at_low = place, value
            else:
                high, at_high = place, value
    return low

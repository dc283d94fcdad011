"""Six numbers, one per joint or coordinate, as users give them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from linkcore.errors import BadValue

FloatArray = NDArray[np.float64]
#: A row of numbers as users give it: joints, a pose. Text is not one, which `numpy.typing.ArrayLike` would take.
Numbers = Sequence[float] | NDArray[np.floating[Any]] | NDArray[np.integer[Any]]

#: The joints by name, from base to wrist 3.
JOINTS = ("base", "shoulder", "elbow", "wrist 1", "wrist 2", "wrist 3")


def numbers(values: ArrayLike, name: str) -> FloatArray:
    """A copy of `values` as float64.

    Raises:
        BadValue: they are not numbers, or not a regular array of them.
    """
    if isinstance(values, (str, bytes)):
        raise BadValue(f"{name} is {values!r}; expected numbers")
    try:
        array = np.array(values)
        if array.dtype.kind not in "fiu":
            raise TypeError(f"of type {array.dtype}")
        return array.astype(np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise BadValue(f"{name}: expected numbers ({error})") from None


def six(values: ArrayLike, name: str) -> FloatArray:
    """Six finite numbers as a read-only array; a copy.

    Raises:
        BadValue: not six, not numbers, or not finite.

    >>> six([0, 0, 0, 0, 0, 1], "q").tolist()
    [0.0, 0.0, 0.0, 0.0, 0.0, 1.0]
    """
    array = numbers(values, name)
    if array.shape != (6,):
        raise BadValue(f"{name} has the shape {array.shape}; expected six numbers")
    if not np.isfinite(array).all():
        raise BadValue(f"{name}[{int(np.argmin(np.isfinite(array)))}] is not finite: {array.tolist()}")
    array.flags.writeable = False
    return array


def six_limits(values: ArrayLike, name: str) -> FloatArray:
    """One limit for each joint, of a number for all of them or of six.

    Raises:
        BadValue: neither one nor six, or not finite and above zero.

    >>> six_limits(2, "speed").tolist()
    [2.0, 2.0, 2.0, 2.0, 2.0, 2.0]
    """
    given = numbers(values, name)
    limits = six(np.full(6, given) if given.ndim == 0 else given, name)
    if not (limits > 0.0).all():
        raise BadValue(f"{name} is {limits.tolist()}; expected positive limits")
    return limits

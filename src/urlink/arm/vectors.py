"""Checks of vectors from users, with six numbers: one for each joint or each coordinate."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from linkcore.errors import BadValue

FloatArray = NDArray[np.float64]
#: Row of numbers from a user, such as joint positions or a pose. This type excludes text, which
#: `numpy.typing.ArrayLike` would accept.
Numbers = Sequence[float] | NDArray[np.floating[Any]] | NDArray[np.integer[Any]]

#: Names of the joints, from base to wrist 3.
JOINTS = ("base", "shoulder", "elbow", "wrist 1", "wrist 2", "wrist 3")


def numbers(values: ArrayLike, name: str) -> FloatArray:
    """Copy `values` to a float64 array.

    Raises:
        BadValue: If `values` contains a value that is not a number, or rows of different lengths.
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
    """Copy six finite numbers to a read-only array.

    Raises:
        BadValue: If `values` is not six finite numbers.

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
    """Return six limits from one number for all joints, or from six numbers.

    Raises:
        BadValue: If `values` is neither one nor six finite numbers above zero.

    >>> six_limits(2, "speed").tolist()
    [2.0, 2.0, 2.0, 2.0, 2.0, 2.0]
    """
    given = numbers(values, name)
    limits = six(np.full(6, given) if given.ndim == 0 else given, name)
    if not (limits > 0.0).all():
        raise BadValue(f"{name} is {limits.tolist()}; expected positive limits")
    return limits

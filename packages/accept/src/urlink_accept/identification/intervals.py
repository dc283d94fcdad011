"""Least squares with intervals that hold on real logs.

The residuals of a real arm are not white noise: friction depends on load and temperature, and the residuals of one
movement are alike. Therefore the rows are cut into blocks, one movement after the other, and the fit is repeated with
random halves of the blocks. A number that depends on the choice of the movements gets a wide interval.

The values from random halves deviate from the value of all blocks as much as this value deviates from the true one, if
the blocks are independent.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from urlink.tools import Estimate, FloatArray

#: Largest number of blocks; more movements are joined. Number of equal blocks if there are few movements.
_MOST_BLOCKS, _EQUAL_BLOCKS = 24, 12
#: Smallest number of movements that are used as blocks. Number of random halves and their complements.
_LEAST_MOVEMENTS, _PAIRS = 8, 200
#: Smallest share of a half in the information about a factor.
_LEAST_SHARE = 0.05
#: Relative size of an eigenvalue that is rounding. Part of a factor in such a direction that makes it unknown.
_RANK, _HIDDEN = 1e-10, 1e-3
#: Degrees of freedom, and the quantiles of Student's t distribution for them that enclose 95 %.
_FREE = np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 15.0, 20.0, 30.0, 60.0, np.inf])
_STUDENT = np.array([12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.306, 2.228, 2.131, 2.086, 2.042, 2.0, 1.96])


@dataclass(frozen=True)
class Fit:
    """Result of a linear fit.

    Attributes:
        factors: Factors of the columns, shape (k,).
        halves: Factors of the fits of random halves of the blocks, shape (halves, k).
        blocks: Number of blocks.
        is_shown: Whether the columns show each factor, shape (k,). They do not if a column is a combination of others.
    """

    factors: FloatArray
    halves: FloatArray
    blocks: int
    is_shown: NDArray[np.bool_]

    def estimate(self, number: int) -> Estimate:
        """Return one factor with its interval, or an unknown estimate."""
        if not self.is_shown[number]:
            return Estimate.unknown("motion that separates this number from the others")
        return within(float(self.factors[number]), self.halves[:, number], self.blocks)


def student(free: float) -> float:
    """Return the number of standard deviations on each side that enclose 95 %, with these degrees of freedom."""
    # The quantiles are nearly linear in the inverse of the degrees of freedom.
    return float(np.interp(1.0 / max(free, 1.0), 1.0 / _FREE[::-1], _STUDENT[::-1]))


def within(value: float, halves: FloatArray, blocks: int) -> Estimate:
    """Return an estimate with the interval that follows from its values in random halves.

    Args:
        value: Value from all blocks.
        halves: Values from random halves of the blocks, shape (halves,).
        blocks: Number of blocks.
    """
    half = student(blocks - 1) * float(np.sqrt(((halves - value) ** 2).mean()))
    return Estimate(value, value - half, value + half)


def blocks_of(is_rest: NDArray[np.bool_]) -> NDArray[np.int_]:
    """Return the number of the block of each row, shape (n,). A block is a movement and the rest after it.

    Args:
        is_rest: Whether all joints are at rest, for each row in the order of time, shape (n,).
    """
    movement = np.concatenate(([0], np.cumsum(is_rest[:-1] & ~is_rest[1:])))
    movements = int(movement[-1]) + 1
    if movements < _LEAST_MOVEMENTS:
        return np.arange(len(is_rest)) * _EQUAL_BLOCKS // len(is_rest)
    return np.asarray(movement * min(movements, _MOST_BLOCKS) // movements)


def fit(columns: FloatArray, measured: FloatArray, blocks: NDArray[np.int_]) -> Fit:
    """Fit by least squares, with all rows and with random halves of the blocks.

    Args:
        columns: Columns, shape (n, k).
        measured: Measured values, shape (n,).
        blocks: Number of the block of each row, shape (n,).
    """
    # Scale the columns to about the same length, so that the products in a k by k matrix have enough digits.
    lengths = np.sqrt((columns**2).sum(axis=0))
    lengths[lengths == 0.0] = 1.0
    scaled = columns / lengths
    parts = [blocks == each for each in np.unique(blocks)]
    squares = np.array([scaled[rows].T @ scaled[rows] for rows in parts])
    sides = np.array([scaled[rows].T @ measured[rows] for rows in parts])
    # The same recording always has the same result.
    rng = np.random.default_rng(0)
    first = np.array([rng.permutation(len(parts)) < len(parts) // 2 for _ in range(_PAIRS)])
    chosen = np.concatenate((np.ones((1, len(parts)), dtype=bool), first, ~first)).astype(np.float64)
    inverses = np.linalg.pinv(np.einsum("hb,bij->hij", chosen, squares), hermitian=True)
    factors = np.einsum("hij,hj->hi", inverses, chosen @ sides) / lengths
    # Share of each block in the information about each factor. A half without that motion says nothing about it.
    whole = inverses[0]
    shares = np.einsum("ij,bjk,ki->bi", whole, squares, whole) / np.maximum(np.diag(whole), 1e-300)
    factors[1:] = np.where(chosen[1:] @ shares < _LEAST_SHARE, factors[0], factors[1:])
    sizes, ways = np.linalg.eigh(squares.sum(axis=0))
    hidden = np.abs(ways[:, sizes <= _RANK * sizes[-1]]).max(axis=1, initial=0.0)
    return Fit(factors[0], factors[1:], len(parts), hidden < _HIDDEN)

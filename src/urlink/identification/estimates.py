"""Least squares, with intervals."""

from __future__ import annotations

import math

import numpy as np

from ..arm_file import Estimate
from ..vectors import FloatArray

__all__ = ["fit", "of_ratio"]


def fit(columns: FloatArray, measured: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Least squares: the factors of the columns, their covariance, and what is left of each row.

    What is left over is seldom white: if neighbours are alike there are fewer independent rows than rows, by which the
    covariance is widened.

    Args:
        columns: (n, k), in the order of time.
        measured: (n,).
    """
    # Columns of about the same length, whose products a matrix of k by k then holds with enough digits.
    lengths = np.sqrt((columns**2).sum(axis=0))
    lengths[lengths == 0.0] = 1.0
    scaled = columns / lengths
    inverse = np.linalg.pinv(scaled.T @ scaled, hermitian=True)
    factors = inverse @ (scaled.T @ measured) / lengths
    left = measured - columns @ factors
    n, k = columns.shape
    variance = float(left @ left) / max(n - k, 1)
    total = float(left @ left)
    alike = float(left[1:] @ left[:-1]) / total if total > 0.0 else 0.0
    alike = min(max(alike, 0.0), 0.99)
    widened = (1.0 + alike) / (1.0 - alike) if alike > 2.0 / math.sqrt(n) else 1.0
    covariance = widened * variance * inverse / np.outer(lengths, lengths)
    return np.asarray(factors, dtype=np.float64), np.asarray(covariance, dtype=np.float64), left


def of_ratio(estimate: Estimate) -> Estimate:
    """One over it, with the interval."""
    if not estimate.is_known or estimate.low * estimate.high <= 0.0:
        return Estimate.unknown(estimate.needs or "more motion")
    return Estimate(1.0 / estimate.value, 1.0 / estimate.high, 1.0 / estimate.low)

"""The errors of the simulated sensors, against the log of a real UR3e."""

from __future__ import annotations

import importlib.util
import sys
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from tests import real_captures

pytestmark = [pytest.mark.captures("real"), pytest.mark.slow]

LOG = "ur3e_rtde.csv"


@cache
def script() -> ModuleType:
    """Return the benchmark that prints the table."""
    path = Path(__file__).resolve().parents[3] / "benchmarks/real_arms.py"
    spec = importlib.util.spec_from_file_location("real_arms", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def rows(field: str, *, noise: bool) -> list[Any]:
    log = script().read(real_captures.folder("real") / LOG)
    table = script().compare(log, script().simulate(log, LOG, noise=noise))
    return [row for row in table if row.field == field]


def test_current_without_noise_is_as_close_as_the_target_current() -> None:
    ceiling = [0.92, 0.97, 0.81, 0.96, 0.73]
    found = [row.r2 for row in rows("actual_current", noise=False)[:5]]
    assert (np.array(found) > np.array(ceiling) - 0.03).all(), found


def test_current_residual_has_the_spread_and_correlation_of_the_log() -> None:
    for row in rows("actual_current", noise=True):
        assert row.spread[1] == pytest.approx(row.spread[0], rel=0.2), row
        # A correlation below 0.5 has an error of 0.1 in a log of this length.
        assert row.correlation[1] == pytest.approx(row.correlation[0], rel=0.2, abs=0.1), row


def test_force_at_rest_has_mean_spread_and_correlation_of_the_log() -> None:
    force = rows("force_at_rest", noise=True)[:3]
    means, spreads = (np.array([getattr(row, name) for row in force]) for name in ("mean", "spread"))
    real, made = means.T
    assert np.linalg.norm(made - real) < 0.2 * np.linalg.norm(real)
    # The log has 19 rests, so the spread of one axis is known to a sixth only; compare that of the vector.
    real, made = (float(np.linalg.norm(each)) for each in spreads.T)
    assert made == pytest.approx(real, rel=0.2)
    for row in force:
        assert row.correlation[1] == pytest.approx(row.correlation[0], rel=0.2), row

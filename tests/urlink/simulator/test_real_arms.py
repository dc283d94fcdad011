"""The errors of the simulated sensors, and their parameters, against the logs of real arms."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from tests import real_captures
from urlink.arm.parameters import numbers, parameters

pytestmark = [pytest.mark.captures("real"), pytest.mark.slow]

LOG = "ur3e_rtde.csv"
#: Largest difference of a statistic of the simulator from that of the log, as a fraction.
NEAR = 0.2


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


@cache
def table(name: str, *, noise: bool, seed: int = 0) -> list[Any]:
    log = script().read(real_captures.folder("real") / name)
    return list(script().compare(log, script().simulate(log, name, noise=noise, seed=seed)))


def rows(field: str, *, noise: bool, seed: int = 0, name: str = LOG) -> Iterator[Any]:
    return (row for row in table(name, noise=noise, seed=seed) if row.field == field)


def test_current_without_noise_is_as_close_as_the_target_current() -> None:
    ceiling = [0.92, 0.97, 0.81, 0.96, 0.73]
    found = [row.r2 for row in rows("actual_current", noise=False)][:5]
    assert (np.array(found) > np.array(ceiling) - 0.03).all(), found


def test_current_residual_has_spread_and_correlation_of_the_log() -> None:
    for row in rows("actual_current", noise=True):
        assert row.spread[1] == pytest.approx(row.spread[0], rel=NEAR), row
        assert row.correlation[1] == pytest.approx(row.correlation[0], rel=NEAR), row


def test_force_at_rest_has_mean_spread_and_correlation_of_log() -> None:
    force = list(rows("force_at_rest", noise=True))
    for row in force:
        assert row.spread[1] == pytest.approx(row.spread[0], rel=NEAR), row
        assert row.correlation[1] == pytest.approx(row.correlation[0], rel=NEAR), row
    for row in force[:3]:
        assert row.mean[1] == pytest.approx(row.mean[0], rel=NEAR), row


@pytest.mark.parametrize("field", ["actual_current", "force_at_rest"])
def test_errors_of_many_seeds_have_the_spread_of_the_log(field: str) -> None:
    """One seed may differ by chance; the mean of ten seeds is the parameter itself."""
    spreads = np.array([[row.spread for row in rows(field, noise=True, seed=seed)] for seed in range(10)])
    real, made = spreads.mean(axis=0).T
    np.testing.assert_allclose(made, real, rtol=0.1)


def test_settled_arms_have_the_force_of_their_logs() -> None:
    for name in ("ur5e_led_by_hand.csv.gz", "ur5_cb3_at_rest.csv.gz"):
        for row in list(rows("force_at_rest", noise=True, name=name))[:3]:
            assert row.mean[1] == pytest.approx(row.mean[0], rel=0.25), (name, row)


def test_parameters_that_follow_from_logs_are_those_of_the_table() -> None:
    for each in script().derive(real_captures.folder("real")):
        if each.name == "friction":
            coulomb, viscous = (float(text) for text in each.texts[0].split())
            assert numbers("coulomb_current", "UR5e")[4] == coulomb
            assert numbers("viscous_current", "UR5e")[4] == viscous
            continue
        row = parameters()[each.name, each.of]
        value, low, high, source = each.texts
        assert (row.value, row.low, row.high) == (value, *(float(end) if end else None for end in (low, high))), each
        assert row.source.startswith(source), (row, source)
        assert row.evidence == "log", row


@pytest.mark.parametrize("name", ["ur3e_rtde.csv", "ur5e_led_by_hand.csv.gz", "ur5_cb3_at_rest.csv.gz"])
def test_noisy_measurements_at_rest_never_stand_still(name: str) -> None:
    """The requirement `values-live` of `urlink accept` depends on this, for real and for simulated arms."""
    log = script().read(real_captures.folder("real") / name)
    rest = ~log["target_qd"].any(axis=1)
    both = rest[1:] & rest[:-1]
    for values in (log, script().simulate(log, name)):
        for field in ("actual_q", "actual_current", "actual_tool_accelerometer"):
            assert np.diff(values[field], axis=0)[both].any(axis=1).all(), field

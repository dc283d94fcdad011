"""Planted parameters of joints are found again, with intervals that hold them."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from tests.urlink.identification.planted import COG, MODEL, MOTORS, PAYLOAD, columns
from urlink.arm_file import Estimate
from urlink.identification.joints import JointFit, fit, fit_joints, of_ratio

TRIALS = 200


def pairs(found: JointFit) -> dict[str, tuple[Estimate, float]]:
    """Each estimate with what was planted."""
    named = {
        "rotor": (found.rotor_inertias, MOTORS.rotor_inertias),
        "constant": (found.torque_constants, MOTORS.torque_constants),
        "coulomb": (found.coulomb, MOTORS.coulomb),
        "viscous": (found.viscous, MOTORS.viscous),
    }
    every = {
        f"{name} {joint}": (estimate, planted)
        for name, (estimates, values) in named.items()
        for joint, (estimate, planted) in enumerate(zip(estimates, values, strict=True))
    }
    return every | {"payload": (found.payload, PAYLOAD)}


@pytest.mark.slow
def test_planted_parameters_are_found_within_their_intervals() -> None:
    """In 95 of 100 trials at least, each of the 25 of them."""
    held: Counter[str] = Counter()
    for seed in range(TRIALS):
        found = fit_joints(MODEL, columns(np.random.default_rng(seed), rate=25.0))
        for name, (estimate, planted) in pairs(found).items():
            held[name] += estimate.low <= planted <= estimate.high
    assert len(held) == 25
    assert min(held.values()) >= 0.95 * TRIALS, held


def test_planted_parameters_are_found_within_five_percent() -> None:
    found = fit_joints(MODEL, columns(np.random.default_rng(1)))
    for name, (estimate, planted) in pairs(found).items():
        # The rotor of a wrist is a few hundredths of a Nm beside the noise.
        assert estimate.value == pytest.approx(planted, rel=0.05), name
    assert [each.value for each in found.payload_cog] == pytest.approx(COG, abs=2e-3)
    assert min(found.torque_r2[:3]) > 0.99


def test_a_joint_that_stands_tells_nothing_of_itself() -> None:
    given = columns(np.random.default_rng(2))
    for name in ("target_q", "target_qd", "target_qdd"):
        given[name] = given[name].copy()
        given[name][:, 4] = given[name][0, 4] if name == "target_q" else 0.0
    found = fit_joints(MODEL, given)
    assert "wrist 2 to accelerate" in found.rotor_inertias[4].needs
    assert "wrist 2 to turn faster" in found.coulomb[4].needs
    assert np.isnan(found.viscous[4].value)
    assert found.rotor_inertias[3].is_known


def test_without_currents_only_moments_are_told() -> None:
    given = columns(np.random.default_rng(3))
    del given["target_current"]
    found = fit_joints(MODEL, given)
    assert found.rotor_inertias[0].is_known
    assert "target_current" in found.torque_constants[0].needs


def test_rows_that_are_alike_widen_the_interval() -> None:
    rng = np.random.default_rng(5)
    column = np.linspace(-1.0, 1.0, 400)[:, np.newaxis]
    noise = rng.standard_normal(400)
    slow = np.convolve(noise, np.ones(10) / 10**0.5, mode="same")
    white, alike = (fit(column, column[:, 0] + each)[1][0, 0] for each in (noise, slow))
    assert alike > 3.0 * white


def test_the_interval_of_a_ratio() -> None:
    found = of_ratio(Estimate(0.1, 0.08, 0.125))
    assert (found.value, found.low, found.high) == pytest.approx((10.0, 8.0, 12.5))
    assert not of_ratio(Estimate(0.1, -0.1, 0.3)).is_known

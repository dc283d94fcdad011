"""Planted joint parameters are recovered, with intervals that contain them."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from packages.accept.tests.identification.planted import COG, MODEL, MOTORS, PAYLOAD, POSTURES, columns
from tests.matrix import trials
from urlink.arm.arm_file import Estimate
from urlink.simulator import Controller, Still
from urlink_accept.identification.intervals import blocks_of, fit, student
from urlink_accept.identification.joints import JointFit, fit_joints, of_ratio
from urlink_accept.identification.samples import COLUMNS, Samples
from urlink_accept.identification.tracking import start_rate

TRIALS = trials(50, 200)


def pairs(found: JointFit) -> dict[str, tuple[Estimate, float]]:
    """Return each estimate with its planted value."""
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
@pytest.mark.matrix
def test_planted_parameters_are_found_within_their_intervals() -> None:
    """The intervals contain 95 of 100 of the parameters; each parameter as often, within three standard deviations."""
    held: Counter[str] = Counter()
    for seed in range(TRIALS):
        found = fit_joints(MODEL, columns(np.random.default_rng(seed), rate=25.0))
        for name, (estimate, planted) in pairs(found).items():
            held[name] += estimate.low <= planted <= estimate.high
    assert len(held) == 25
    least = 0.95 - 3.0 * (0.95 * 0.05 / TRIALS) ** 0.5
    assert min(held.values()) >= least * TRIALS, held
    assert sum(held.values()) >= 0.945 * 25 * TRIALS, held


def test_planted_parameters_are_found_within_five_percent() -> None:
    found = fit_joints(MODEL, columns(np.random.default_rng(1)))
    for name, (estimate, planted) in pairs(found).items():
        # The rotor of a wrist contributes a few hundredths of a Nm, compared with the noise.
        assert estimate.value == pytest.approx(planted, rel=0.05), name
    assert [each.value for each in found.payload_cog] == pytest.approx(COG, abs=2e-3)
    assert min(found.torque_r2[:3]) > 0.99


def test_joint_at_rest_has_no_estimates() -> None:
    given = columns(np.random.default_rng(2))
    for name in ("target_q", "target_qd", "target_qdd"):
        given[name] = given[name].copy()
        given[name][:, 4] = given[name][0, 4] if name == "target_q" else 0.0
    found = fit_joints(MODEL, given)
    assert "wrist 2 to accelerate" in found.rotor_inertias[4].needs
    assert "wrist 2 to turn faster" in found.coulomb[4].needs
    assert np.isnan(found.viscous[4].value)
    assert found.rotor_inertias[3].is_known


def test_inertia_is_estimated_without_currents() -> None:
    given = columns(np.random.default_rng(3))
    del given["target_current"]
    found = fit_joints(MODEL, given)
    assert found.rotor_inertias[0].is_known
    assert "target_current" in found.torque_constants[0].needs


def test_correlated_rows_widen_interval() -> None:
    rng = np.random.default_rng(5)
    column = np.linspace(-1.0, 1.0, 400)[:, np.newaxis]
    noise = rng.standard_normal(400)
    slow = np.convolve(noise, np.ones(10) / 10**0.5, mode="same")
    blocks = np.arange(400) // 20
    white, alike = (fit(column, column[:, 0] + each, blocks).estimate(0) for each in (noise, slow))
    assert alike.high - alike.low > 2.0 * (white.high - white.low)


def test_misfit_of_movements_widens_interval() -> None:
    """If the movements have different factors, the interval contains most of them even without noise."""
    column = np.ones((200, 1))
    blocks = np.repeat(np.arange(10), 20)
    found = fit(column, np.where(blocks % 2, 1.0, 2.0), blocks).estimate(0)
    assert found.value == pytest.approx(1.5)
    assert 0.2 < found.high - found.value < 0.6


def test_interval_contains_the_factor_in_95_of_100_fits() -> None:
    rng = np.random.default_rng(6)
    held = 0
    for _ in range(300):
        columns = rng.standard_normal((240, 2))
        found = fit(columns, columns @ [1.0, -2.0] + rng.standard_normal(240), np.arange(240) // 20).estimate(1)
        held += found.low <= -2.0 <= found.high
    assert 0.92 * 300 <= held <= 0.99 * 300


def test_blocks_are_movements_or_equal_parts() -> None:
    movements = np.repeat([True, False] * 10, 5)
    assert np.bincount(blocks_of(movements)).tolist() == [5, *[10] * 9, 5]
    assert len(np.unique(blocks_of(np.tile(movements, 5)))) == 24
    assert np.bincount(blocks_of(np.zeros(120, dtype=bool))).tolist() == [10] * 12


def test_student_widens_for_few_blocks() -> None:
    assert student(1) == pytest.approx(12.706)
    assert student(7) == pytest.approx(2.365, rel=0.01)
    assert student(1e9) == pytest.approx(1.96)


@pytest.mark.parametrize("wait", [0.0, 0.02, 0.05], ids="after {} s".format)
@pytest.mark.parametrize("speed", [1.0, 0.6], ids="at {}".format)
def test_ramp_rate_is_correct_when_program_waits_before_moving(wait: float, speed: float) -> None:
    """The ramp starts with the program.

    Without this rule, a busy computer measured 7.2 instead of 6.25.
    """
    controller = Controller("UR5", "3.15", motion=Still(POSTURES[0]))
    controller.speed_fraction = speed
    names = ("target_q", "target_qd", "target_qdd")
    rows: dict[str, list[object]] = {name: [] for name in ("timestamp", "speed_scaling", *names)}
    for posture in POSTURES[1:3]:
        controller.take(f"def p():\n  sleep({wait})\n  movej({list(posture)}, a=4.0, v=2.2)\nend\n")
        for _ in range(400):
            controller.step()
            sample = controller.arm.sample
            rows["timestamp"].append(controller.time)
            rows["speed_scaling"].append(speed)
            for name in names:
                rows[name].append(list(getattr(sample, COLUMNS[name])))
    found = start_rate(Samples(Path("waits"), {name: np.array(each) for name, each in rows.items()}, "UR5"))
    assert found.value == pytest.approx(6.25, rel=0.01)
    assert found.low < 6.25 < found.high


def test_reciprocal_of_an_estimate_inverts_its_interval() -> None:
    found = of_ratio(Estimate(0.1, 0.08, 0.125))
    assert (found.value, found.low, found.high) == pytest.approx((10.0, 8.0, 12.5))
    assert not of_ratio(Estimate(0.1, -0.1, 0.3)).is_known

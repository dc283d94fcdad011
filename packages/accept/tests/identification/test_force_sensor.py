"""Offset of the force sensor and the payload that the controller does not know."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from urlink.arm.poses import rotvec_to_matrix
from urlink.arm.vectors import FloatArray
from urlink_accept.identification.force_sensor import force_offset
from urlink_accept.identification.samples import Samples

OFFSET = np.array([3.0, -8.0, 76.0, 0.2, -0.1, 0.05])
MASS, COG = 0.7, np.array([0.01, 0.0, 0.08])


def rests(turned: FloatArray, rng: np.random.Generator) -> Samples:
    """Return rests of 0.4 s, with one rotation vector of the tool each, shape (n, 3)."""
    count, rows = len(turned), 50
    q = np.repeat(0.1 * np.arange(count), rows)[:, np.newaxis] * np.ones(6)
    moved = np.zeros((count * rows, 6))
    moved[::rows] = 1.0
    turns: FloatArray = np.repeat(rotvec_to_matrix(turned), rows, axis=0)
    weight = np.array([0.0, 0.0, -9.82 * MASS])
    force = turns @ OFFSET[:3] + weight
    torque = turns @ OFFSET[3:] + np.cross(turns @ COG, weight)
    wrench: FloatArray = np.hstack((force, torque)) + rng.standard_normal((count * rows, 6)) * [
        *[0.1] * 3,
        *[0.003] * 3,
    ]
    pose: FloatArray = np.hstack((np.zeros((count * rows, 3)), np.repeat(turned, rows, axis=0)))
    columns: dict[str, FloatArray] = {
        "timestamp": np.linspace(0.0, 0.008 * (count * rows - 1), count * rows),
        "target_q": q,
        "target_qd": moved,
        "target_qdd": moved,
        "actual_TCP_pose": pose,
        "actual_TCP_force": wrench,
    }
    return Samples(Path("rests"), columns)


def test_offset_and_unset_payload_are_found() -> None:
    rng = np.random.default_rng(1)
    found = force_offset(rests(rng.uniform(-2.0, 2.0, (12, 3)), rng))
    assert found["unset_payload"][0].value == pytest.approx(MASS, abs=0.02)
    assert [each.value for each in found["force_offset"]] == pytest.approx(OFFSET, abs=0.1)
    assert all(each.low < each.value < each.high for each in found["force_offset"])


def test_offset_assumes_no_payload_if_the_tool_does_not_turn() -> None:
    rng = np.random.default_rng(2)
    turned = np.array([0.0, 0.0, 1.0]) * rng.uniform(-1.0, 1.0, (12, 1))
    found = force_offset(rests(turned, rng))
    assert "the offset assumes that it is 0" in found["unset_payload"][0].needs
    assert found["force_offset"][2].value == pytest.approx(OFFSET[2] - 9.82 * MASS, abs=0.1)


def test_few_rests_have_no_estimate() -> None:
    rng = np.random.default_rng(3)
    found = force_offset(rests(rng.uniform(-1.0, 1.0, (3, 3)), rng))
    assert not any(each.is_known for each in (*found["force_offset"], *found["unset_payload"]))

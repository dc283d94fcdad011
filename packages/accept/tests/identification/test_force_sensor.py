"""Offset of the force sensor and the payload that the controller does not know."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from urlink.arm.poses import rotvec_to_matrix
from urlink.arm.vectors import FloatArray
from urlink_accept.identification.force_sensor import fixed_force, force_offset
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


def swung(
    force_of: Callable[[FloatArray], FloatArray], axes: tuple[int, ...] = (0, 1)
) -> tuple[FloatArray, FloatArray]:
    """Return poses of a tool that turns by 17 degrees about each axis in turn, and its wrenches with noise."""
    rng = np.random.default_rng(2)
    angle = 0.3 * np.sin(np.linspace(0.0, 2.0 * np.pi, 600))
    turned: FloatArray = np.concatenate([angle[:, np.newaxis] * np.eye(3)[axis] for axis in axes])
    turned[:, 0] += 1e-3  # a tool that never turns exactly about one axis
    force = force_of(rotvec_to_matrix(turned)) + 0.5 * rng.standard_normal((len(turned), 3))
    return np.hstack((np.zeros_like(turned), turned)), np.hstack((force, np.zeros_like(turned)))


def test_offset_that_turns_with_the_tool_leaves_no_fixed_force() -> None:
    turning, staying = fixed_force(*swung(lambda turns: turns @ OFFSET[:3]))
    assert [each.value for each in turning] == pytest.approx(OFFSET[:3], abs=1.5)
    assert all(max(each.low, -each.high) < 0.5 for each in staying)


def test_force_in_the_frame_of_the_tool_is_fixed() -> None:
    _, staying = fixed_force(*swung(lambda turns: np.tile(OFFSET[:3], (len(turns), 1))))
    assert [each.value for each in staying] == pytest.approx(OFFSET[:3], abs=1.5)


def test_weight_of_an_unset_payload_is_fixed() -> None:
    weight = np.array([0.0, 0.0, -9.82 * MASS])
    _, staying = fixed_force(*swung(lambda turns: turns @ OFFSET[:3] + weight))
    assert staying[2].value == pytest.approx(weight[2], abs=1.5)
    assert staying[2].high < -3.0


def test_fixed_force_is_uncertain_when_the_tool_turns_about_its_axis_only() -> None:
    _, staying = fixed_force(*swung(lambda turns: turns @ OFFSET[:3], axes=(2,)))
    assert not staying[2].is_known or staying[2].high - staying[2].low > 6.0

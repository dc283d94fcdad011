"""Conversion of actions to joint positions and back."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from urlink import BadValue
from urlink.arm.kinematics import Arm
from urlink_gym import KINDS, Actions, Steps
from urlink_gym.actions import Blocked
from urlink_gym.arm_env import HOME

ARM = Arm("UR5e")
START = np.array(HOME)
FRACTIONS = st.lists(st.floats(-1.0, 1.0, width=32), min_size=6, max_size=6)


@pytest.mark.property
@pytest.mark.parametrize("kind", ["joint_deltas", "pose_deltas", "position_deltas"])
@given(fractions=FRACTIONS)
def test_between_inverts_target(kind: str, fractions: list[float]) -> None:
    actions = Actions(kind, ARM, Steps())
    numbers = np.array(fractions[: KINDS[kind]])
    q, done = actions.target(numbers, START)
    assert done == pytest.approx(numbers, abs=1e-5)
    assert actions.between(START, ARM.forward(START), q, ARM.forward(q)) == pytest.approx(numbers, abs=1e-5)


@pytest.mark.property
@given(fractions=FRACTIONS)
def test_joint_targets_move_by_at_most_one_step(fractions: list[float]) -> None:
    actions = Actions("joints", ARM, Steps(joint=0.02))
    wanted = START + 0.2 * np.array(fractions)
    target, done = actions.target(wanted, START)
    assert done == pytest.approx(target, abs=1e-6)
    assert np.abs(target - START).max() <= 0.02 + 1e-12
    near = np.abs(wanted - START) <= 0.02
    assert target[near] == pytest.approx(wanted[near])


@pytest.mark.property
@given(rows=st.lists(FRACTIONS, min_size=1, max_size=60))
def test_targets_of_tool_stay_in_box(rows: list[list[float]]) -> None:
    x, y, z = ARM.forward(START)[:3].tolist()
    box = ((x - 0.05, y - 0.03, z - 0.02), (x + 0.05, y + 0.03, z + 0.02))
    actions = Actions("pose_deltas", ARM, Steps(), box)
    q = START
    for row in rows:
        before = ARM.forward(q)
        q, done = actions.target(np.array(row), q)
        assert done[:3] == pytest.approx((ARM.forward(q) - before)[:3] / 0.01, abs=1e-4)
        assert (np.array(box[0]) < ARM.forward(q)[:3]).all()
        assert (ARM.forward(q)[:3] < np.array(box[1])).all()


def test_tool_outside_of_box_may_only_come_back() -> None:
    x, y, z = ARM.forward(START)[:3].tolist()
    actions = Actions("position_deltas", ARM, Steps(), ((x + 0.05, y - 0.1, z - 0.1), (x + 0.3, y + 0.1, z + 0.1)))
    further = ARM.forward(actions.target(np.array([-1.0, 0.0, 0.0]), START)[0])
    assert further[0] == pytest.approx(x, abs=1e-6)
    back = ARM.forward(actions.target(np.array([1.0, 0.0, 0.0]), START)[0])
    assert back[0] == pytest.approx(x + 0.01, abs=1e-6)


def test_target_raises_blocked_when_out_of_reach() -> None:
    actions = Actions("position_deltas", ARM, Steps(move=0.1))

    def move_away() -> None:
        q = START
        for _ in range(20):
            q, _ = actions.target(np.array([-1.0, 0.0, 0.0]), q)

    with pytest.raises(Blocked) as caught:
        move_away()
    assert caught.value.reason in ("reach", "singularity")


def test_actions_reject_unknown_kind() -> None:
    with pytest.raises(BadValue, match="action='speed'; expected one of joints, "):
        Actions("speed", ARM, Steps())


@pytest.mark.parametrize(
    "wrong", [{"move": 0.0}, {"turn": -1.0}, {"joint": float("nan")}, {"move": "1"}, {"move": 0.2}]
)
def test_steps_reject_invalid_numbers(wrong: dict[str, Any]) -> None:
    with pytest.raises(BadValue, match=next(iter(wrong))):
        Steps(**wrong)

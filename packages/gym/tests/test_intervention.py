"""Interventions: a function, a held button with freedrive, and a second arm."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from gymnasium.error import ResetNeeded

import urlink
from linkcore import clock
from packages.gym.tests.conftest import E_SERIES
from urlink import BadValue
from urlink.packets import DigitalBits
from urlink.simulator import Controller
from urlink_gym import ArmEnv, LeaderArm, held

Make = Callable[..., ArmEnv]


def test_intervention_replaces_action(make: Make) -> None:
    given = iter([None, [0.5, 0.0, 0.0], None])
    env = make(intervention=lambda env: next(given))
    env.reset()
    before, replaced, after = (env.step([0.0, 0.0, 1.0])[4] for _ in range(3))
    assert [info["intervention"] for info in (before, replaced, after)] == [False, True, False]
    assert replaced["intervene_action"] == pytest.approx([0.5, 0.0, 0.0], abs=1e-4)
    assert replaced["action"] == pytest.approx([0.5, 0.0, 0.0], abs=1e-4)
    assert "intervene_action" not in before
    assert after["action"] == pytest.approx([0.0, 0.0, 1.0], abs=1e-4)


def test_invalid_intervention_stops_arm(make: Make) -> None:
    env = make(intervention=lambda env: [1.0])
    env.reset()
    with pytest.raises(BadValue, match="intervention"):
        env.step([0.0, 0.0, 0.0])
    with pytest.raises(ResetNeeded):
        env.step([0.0, 0.0, 0.0])


@pytest.mark.parametrize("action", ["joints", "joint_deltas", "position_deltas"])
def test_arm_is_guided_while_button_is_held(make: Make, action: str) -> None:
    env = make(E_SERIES, action, freedrive_button=held(DigitalBits.STANDARD_3))
    env.reset()
    controller = env.robot.controller
    env.step(env.rest())
    controller.signals.set_digital_input(3, True)
    env.step(env.rest())
    controller.push([0.0, 3.0, 0.0, 0.0, 0.0, 0.0])
    infos: list[dict[str, Any]] = []
    begin, *_ = env.step(env.rest())
    for _ in range(20):
        end, *_, info = env.step(env.rest())
        infos.append(info)
    assert all(info["intervention"] for info in infos)
    assert end["tool_position"][1] - begin["tool_position"][1] > 0.01
    done = np.array([info["intervene_action"] for info in infos])
    if action == "position_deltas":
        assert 0.01 * done.sum(axis=0)[1] == pytest.approx(
            end["tool_position"][1] - begin["tool_position"][1], abs=0.002
        )
    elif action == "joint_deltas":
        assert 0.03 * done.sum(axis=0) == pytest.approx(end["q_actual"] - begin["q_actual"], abs=0.005)
    else:
        assert done[-1] == pytest.approx(end["q_actual"], abs=1e-5)
    controller.push([0.0] * 6)
    controller.signals.set_digital_input(3, False)
    env.step(env.rest())
    *_, info = env.step(env.rest())
    released = env.robot.realtime.wait().q_target
    assert not info["intervention"]
    # The policy continues from where the person has left the arm.
    for _ in range(10):
        env.step(env.rest())
    assert env.robot.realtime.wait().q_target == pytest.approx(released, abs=2e-3)


def test_stop_while_guided_ends_episode(make: Make) -> None:
    env = make(E_SERIES, freedrive_button=lambda state: True)
    env.reset()
    env.step(np.zeros(3))
    env.robot.controller.faults.protective_stop()
    for _ in range(20):
        *_, truncated, info = env.step(np.zeros(3))
        if truncated:
            break
    assert truncated
    assert "SafetyStop" in info["error"]


@pytest.mark.parametrize("action", ["joints", "joint_deltas", "pose_deltas"])
def test_arm_repeats_motion_of_leader(make: Make, simulated_time: urlink.Simulation, action: str) -> None:
    with Controller("UR5e", "5.11") as controller, urlink.connect(controller.address) as person:
        start = [0.3, -1.4, 1.4, -1.5, -1.5, 0.0]
        person.motion.move_joints(start, wait=True)
        with LeaderArm(controller.address, held(DigitalBits.TOOL_0)) as leader:
            env = make(E_SERIES, action, intervention=leader)
            begin, _ = env.reset()
            *_, info = env.step(env.rest())
            assert not info["intervention"]
            controller.signals.set_digital_input(16, True)
            env.step(env.rest())
            env.step(env.rest())
            turned = [0.4, *start[1:]]
            person.motion.move_joints(turned, speed=0.3)
            infos = [env.step(env.rest())[4] for _ in range(30)]
            assert all(info["intervention"] for info in infos)
            end, *_ = env.step(env.rest())
            if action == "pose_deltas":
                with urlink.connect(E_SERIES) as other:
                    arm = other.kinematics
                moved = arm.forward(turned)[:3] - arm.forward(start)[:3]
                assert end["tool_position"] - begin["tool_position"] == pytest.approx(moved, abs=5e-3)
            else:
                assert end["q_actual"] - begin["q_actual"] == pytest.approx([0.1, 0, 0, 0, 0, 0], abs=5e-3)


@pytest.mark.parametrize("button", [0, -1, True, "TOOL_0", None, 1.0])
def test_held_rejects_other_values_than_bits(button: Any) -> None:
    with pytest.raises(BadValue, match="DigitalBits"):
        held(button)


def test_leader_without_states_raises(simulated_time: urlink.Simulation) -> None:
    with Controller("UR5e", "5.11") as controller:
        leader = LeaderArm(controller.address, held(DigitalBits.TOOL_0))
        controller.close()
        clock.sleep(2.0)
        with pytest.raises(urlink.LinkTimeout):
            leader(None)  # type: ignore[arg-type]
        leader.close()

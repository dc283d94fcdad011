"""Every kind of action, the gripper, and chunks, with a simulated arm."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import pytest

import urlink
from lerobot_robot_urlink import UR
from urlink.arm import poses
from urlink.simulator import Controller

Q = [0.0, -1.5, 1.5, -1.5, -1.5, 0.0]
JOINTS = [f"joint_{number}.pos" for number in range(1, 7)]
DELTAS = [f"joint_{number}_delta.pos" for number in range(1, 7)]
POSE = [*(f"tcp_{axis}.pos" for axis in "xyz"), *(f"tcp_r{number}.pos" for number in range(1, 7))]
POSE_DELTAS = [f"tcp_{axis}_delta.pos" for axis in ("x", "y", "z", "rx", "ry", "rz")]
WATCHDOG = 2.0  # in s, long because the machine might be busy


def until(condition: Callable[[], object], seconds: float = 20.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "the condition did not become true in time"
        time.sleep(0.01)


def named(names: list[str], values: object) -> dict[str, float]:
    return dict(zip(names, np.asarray(values).tolist(), strict=True))


def seen(arm: UR, names: list[str]) -> np.ndarray:
    observation = arm.get_observation()
    return np.array([observation[name] for name in names])


def test_joint_deltas_add_up_and_are_limited(make: Callable[..., UR]) -> None:
    arm = make(action="joint_deltas", max_step=0.01, watchdog=WATCHDOG)
    arm.connect()
    assert list(arm.action_features) == DELTAS
    for _ in range(10):
        sent = arm.send_action(named(DELTAS, [0.005, 0, 0, 0, 0, 0.5]))
        assert list(sent) == DELTAS
        assert list(sent.values()) == pytest.approx([0.005, 0, 0, 0, 0, 0.01])
        time.sleep(0.02)
    # Without another action, the arm would continue until the watchdog brakes it.
    wanted = np.add(Q, [0.05, 0, 0, 0, 0, 0.1])
    until(lambda: arm.send_action(dict.fromkeys(DELTAS, 0.0)) and np.abs(seen(arm, JOINTS) - wanted).max() < 2e-3)


def test_pose_is_reached_in_steps(make: Callable[..., UR]) -> None:
    arm = make(action="pose", max_step=0.02, watchdog=WATCHDOG)
    arm.connect()
    goal = seen(arm, POSE) + np.array([0.03, -0.02, 0.04, *[0.0] * 6])
    turned = poses.rotvec_to_matrix([0.0, 0.0, 0.1]) @ goal[3:].reshape(2, 3).T
    goal[3:] = 1.3 * turned.T.ravel()  # a policy's columns do not have exactly length 1
    sent = []
    for _ in range(40):
        sent.append(arm.send_action(named(POSE, goal)))
        time.sleep(0.02)
    goal[3:] /= 1.3
    assert list(sent[-1].values()) == pytest.approx(goal, abs=1e-9)
    assert not np.allclose(list(sent[0].values()), goal, atol=1e-3)
    until(lambda: np.abs(seen(arm, POSE) - goal).max() < 1e-3)


def test_pose_deltas_are_along_axes_of_base(make: Callable[..., UR]) -> None:
    arm = make(action="pose_deltas", watchdog=WATCHDOG)
    arm.connect()
    start = seen(arm, POSE)
    for _ in range(10):
        sent = arm.send_action(named(POSE_DELTAS, [0.002, 0, -0.003, 0, 0, 0.01]))
        assert list(sent.values()) == pytest.approx([0.002, 0, -0.003, 0, 0, 0.01], abs=1e-9)
        time.sleep(0.02)
    wanted = start + np.array([0.02, 0, -0.03, *[0.0] * 6])
    wanted[3:] = (poses.rotvec_to_matrix([0, 0, 0.1]) @ start[3:].reshape(2, 3).T).T.ravel()
    until(lambda: arm.send_action(dict.fromkeys(POSE_DELTAS, 0.0)) and np.abs(seen(arm, POSE) - wanted).max() < 1e-3)


def test_invalid_and_unreachable_poses_are_rejected(make: Callable[..., UR]) -> None:
    arm = make(action="pose")
    arm.connect()
    here = seen(arm, POSE)
    with pytest.raises(urlink.Unreachable):
        arm.send_action(named(POSE, here + np.array([5.0, *[0.0] * 8])))
    with pytest.raises(urlink.BadValue, match="two columns of a rotation"):
        arm.send_action(named(POSE, [*here[:3], *here[3:6], *here[3:6]]))
    with pytest.raises(urlink.BadValue, match="turns a joint"):
        arm.send_action(named(POSE, [-here[0], -here[1], *here[2:]]))
    assert seen(arm, JOINTS) == pytest.approx(Q, abs=1e-3)


def test_unknown_kind_of_action_is_rejected(make: Callable[..., UR]) -> None:
    with pytest.raises(urlink.BadValue, match="joint_deltas"):
        make(action="torque")


def test_fingers_follow_only_accepted_actions(make: Callable[..., UR], controller: Controller) -> None:
    arm = make(gripper=True, watchdog=WATCHDOG)
    arm.connect()
    here = named(JOINTS, Q)
    with pytest.raises(urlink.BadValue, match=r"gripper\.pos"):
        arm.send_action(here)
    assert arm.send_action(here | {"gripper.pos": 1.5})["gripper.pos"] == 1.0
    until(lambda: arm.send_action(here | {"gripper.pos": 1.0}) and seen(arm, ["gripper.pos"])[0] == 1.0)
    controller.faults.protective_stop()
    until(lambda: not _works(arm, here | {"gripper.pos": 1.0}))
    closed = controller.gripper.position
    assert not _works(arm, here | {"gripper.pos": 0.0})
    assert not _works(arm, here | {"gripper.pos": 0.0})
    assert controller.gripper.position == closed


def _works(arm: UR, action: dict[str, float]) -> bool:
    try:
        arm.send_action(action)
    except urlink.LinkError:
        return False
    return True


def test_chunk_starts_at_observation_and_replaces_previous_chunk(make: Callable[..., UR]) -> None:
    arm = make(max_step=0.02, watchdog=WATCHDOG, gripper=True)
    arm.connect()
    with pytest.raises(urlink.LocalError, match="get_observation"):
        arm.send_chunk([named(JOINTS, Q) | {"gripper.pos": 0.0}] * 2)
    goal = np.add(Q, [0.3, 0, 0, 0, 0, 0])
    led = []
    for _ in range(12):
        arm.get_observation()
        time.sleep(0.1)  # computing time of the policy
        led.append(arm.send_chunk([named(JOINTS, goal) | {"gripper.pos": 1.0}] * 25, period=0.05))
        if np.abs(seen(arm, JOINTS) - goal).max() < 0.01:
            break
    for chunk in led:
        path = np.array([[action[name] for name in JOINTS] for action in chunk])
        assert np.abs(np.diff(path, axis=0)).max() <= 0.02 + 1e-9
    # A later chunk starts at the set-points of its observation rather than those of the first one.
    assert led[-1][0]["joint_1.pos"] > led[0][0]["joint_1.pos"] + 0.05
    until(lambda: np.abs(seen(arm, [*JOINTS, "gripper.pos"]) - [*goal, 1.0]).max() < 0.15)
    until(lambda: np.abs(seen(arm, JOINTS) - goal).max() < 0.01)
    arm.send_action(named(JOINTS, goal) | {"gripper.pos": 1.0})  # single actions are possible again


def test_send_chunk_raises_after_protective_stop(make: Callable[..., UR], controller: Controller) -> None:
    arm = make(watchdog=WATCHDOG)
    arm.connect()

    def works() -> bool:
        arm.get_observation()
        try:
            arm.send_chunk([named(JOINTS, Q)] * 10)
        except urlink.LinkError:
            return False
        return True

    assert works()
    controller.faults.protective_stop()
    until(lambda: not works())
    arm.get_observation()
    with pytest.raises(urlink.SafetyStop):
        arm.send_chunk([named(JOINTS, Q)] * 10)
    controller.faults.clear()
    until(works)

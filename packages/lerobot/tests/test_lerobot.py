"""Robot and teleoperator with LeRobot's own base classes and simulated arms."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from lerobot.robots import Robot, RobotConfig, make_robot_from_config
from lerobot.teleoperators import TeleoperatorConfig, make_teleoperator_from_config
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError
from lerobot.utils.import_utils import register_third_party_plugins

import urlink
from lerobot_robot_urlink import UR, URConfig, URLeader, URLeaderConfig
from urlink.packets import ProgramState
from urlink.simulator import Controller

NAMES = [f"joint_{number}.pos" for number in range(1, 7)]


# Do not import it from `tests`: draccus, which LeRobot needs, installs a package of that name.
def until(condition: Callable[[], object], seconds: float = 10.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "the condition did not become true in time"
        time.sleep(0.01)


def positions(arm: UR) -> np.ndarray:
    observation = arm.get_observation()
    return np.array([observation[name] for name in NAMES])


def test_lerobot_finds_robot_and_teleoperator_by_name(tmp_path: Path) -> None:
    register_third_party_plugins()
    kind = RobotConfig.get_choice_class("ur")
    assert kind is URConfig
    made = make_robot_from_config(URConfig(id="a", calibration_dir=tmp_path, address="sim://"))
    assert isinstance(made, UR)
    assert isinstance(made, Robot)
    assert TeleoperatorConfig.get_choice_class("ur_leader") is URLeaderConfig
    leader = make_teleoperator_from_config(URLeaderConfig(id="b", calibration_dir=tmp_path, address="sim://"))
    assert isinstance(leader, URLeader)


def test_features_are_available_without_connection(arm: UR) -> None:
    assert list(arm.action_features) == NAMES
    assert list(arm.observation_features)[:6] == NAMES
    assert not arm.is_connected
    assert arm.is_calibrated
    for use in (arm.get_observation, lambda: arm.send_action(dict.fromkeys(NAMES, 0.0))):
        with pytest.raises(DeviceNotConnectedError):
            use()


def test_observation_matches_declared_features(arm: UR) -> None:
    arm.connect()
    with pytest.raises(DeviceAlreadyConnectedError):
        arm.connect()
    observation = arm.get_observation()
    assert list(observation) == list(arm.observation_features)
    assert all(isinstance(value, float) for value in observation.values())
    arm.disconnect()
    assert not arm.is_connected
    arm.disconnect()
    arm.connect()  # it can be connected again
    assert arm.is_connected


def test_actions_move_arm_in_small_steps(arm: UR) -> None:
    arm.config.watchdog = 5.0  # long because the machine might be busy
    arm.connect()
    start = positions(arm)
    goal = start + np.array([0.3, 0, 0, 0, 0, 0.1])
    sent = []
    for _ in range(60):
        sent.append(arm.send_action(dict(zip(NAMES, goal.tolist(), strict=True))))
        time.sleep(0.02)
    led = np.array([[step[name] for name in NAMES] for step in sent])
    # The sent action is returned: at most one step at a time, and finally the goal.
    assert np.abs(np.diff(led, axis=0)).max() <= arm.config.max_step + 1e-9
    assert led[-1] == pytest.approx(goal)
    until(lambda: np.abs(positions(arm) - goal).max() < 0.01, 5.0)


@pytest.mark.parametrize("action", [{}, dict.fromkeys(NAMES, float("nan")), dict.fromkeys(NAMES, "x")])
def test_bad_actions_are_rejected(arm: UR, action: dict[str, object]) -> None:
    arm.connect()
    with pytest.raises(urlink.BadValue):
        arm.send_action(action)


def test_send_action_raises_during_a_stop_and_works_afterwards(arm: UR, controller: Controller) -> None:
    arm.connect()
    here = dict(zip(NAMES, positions(arm).tolist(), strict=True))
    arm.send_action(here)
    controller.faults.protective_stop()
    until(lambda: not _works(arm, here), 5.0)
    with pytest.raises(urlink.SafetyStop):
        arm.send_action(here)
    controller.faults.clear()
    until(lambda: _works(arm, here))


def _works(arm: UR, action: dict[str, float]) -> bool:
    try:
        arm.send_action(action)
    except urlink.LinkError:
        return False
    return True


def test_arm_brakes_without_actions(arm: UR, controller: Controller) -> None:
    arm.connect()
    goal = positions(arm) + np.array([1.0, 0, 0, 0, 0, 0])
    for _ in range(10):
        arm.send_action(dict(zip(NAMES, goal.tolist(), strict=True)))
        time.sleep(0.02)
    # As in a hanging process: no action, and no end.
    until(lambda: abs(arm.get_observation()["joint_1.vel"]) < 1e-3, 5.0)
    assert positions(arm)[0] < 0.9


def pause(controller: Controller) -> None:
    """Wait until the program of the servo has ended, because no action came."""
    with urlink.connect(controller.address, read_only=True) as robot:
        robot.realtime.wait_until(lambda state: state.program_state is ProgramState.STOPPED, timeout=60.0)


def test_action_after_pause_needs_restart_after_pause(make: Callable[..., UR], controller: Controller) -> None:
    for restarts in (False, True):
        arm = make(watchdog=0.5, restart_after_pause=restarts)
        arm.connect()
        here = dict(zip(NAMES, positions(arm).tolist(), strict=True))
        arm.send_action(here)
        pause(controller)
        if restarts:
            arm.send_action(here)
        else:
            with pytest.raises(urlink.ConnectionLost, match="watchdog"):
                arm.send_action(here)
        arm.disconnect()


def test_action_of_interrupted_process_does_not_restart(
    make: Callable[..., UR], controller: Controller, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Interrupted(urlink.Expiry):
        """Expiry that has noticed an interruption."""

        def check(self) -> None:
            raise urlink.LinkTimeout("this process was interrupted")

    monkeypatch.setattr(urlink, "Expiry", Interrupted)
    arm = make(watchdog=0.5, restart_after_pause=True)
    arm.connect()
    here = dict(zip(NAMES, positions(arm).tolist(), strict=True))
    arm.send_action(here)
    pause(controller)
    with pytest.raises(urlink.LinkTimeout, match="interrupted"):
        arm.send_action(here)


def test_leader_moves_follower(arm: UR, controller: Controller, tmp_path: Path) -> None:
    leader = URLeader(URLeaderConfig(id="leader", calibration_dir=tmp_path, address=controller.address))
    with pytest.raises(DeviceNotConnectedError):
        leader.get_action()
    leader.connect()
    try:
        assert list(leader.get_action()) == list(leader.action_features)
        assert set(leader.action_features) == set(arm.action_features)
        arm.connect()
        arm.send_action(leader.get_action())
    finally:
        leader.disconnect()
    assert os.listdir(tmp_path) == []  # no calibration is stored, because none is needed

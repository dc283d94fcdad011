"""LeRobot's own programs for recording and replaying: one simulated arm leads, another arm follows."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lerobot.scripts import lerobot_record as record_script
from lerobot.scripts import lerobot_replay as replay_script

import urlink
from lerobot_robot_urlink import UR, URConfig, URLeaderConfig
from urlink.simulator import Controller

FPS = 20
NAMES = [f"joint_{number}.pos" for number in range(1, 7)]


def test_teleoperation_is_recorded_and_replayed(
    make: Callable[..., UR], controller: Controller, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    options: dict[str, Any] = {"id": "arm", "calibration_dir": tmp_path / "none", "watchdog": 2.0, "fps": float(FPS)}
    dataset: dict[str, Any] = {"repo_id": "urlink/moved", "root": tmp_path / "moved"}
    with Controller("UR5e", "5.11") as leading, urlink.connect(leading.address) as leader:
        leader.motion.move_joints([0.0, -1.5, 1.5, -1.5, -1.5, 0.0], wait=True)
        config = record_script.RecordConfig(
            robot=URConfig(address=controller.address, **options),
            dataset=record_script.DatasetRecordConfig(
                **dataset, single_task="turn", fps=FPS, episode_time_s=3, num_episodes=1, push_to_hub=False
            ),
            teleop=URLeaderConfig(id="leader", calibration_dir=tmp_path / "none", address=leading.address),
            play_sounds=False,
        )
        motion = leader.motion.move_joints([0.3, -1.5, 1.5, -1.5, -1.5, 0.2], speed=0.2)
        made = record_script.record(config)
        motion.cancel()
    actions = np.array([made[number]["action"].tolist() for number in range(made.num_frames)])
    states = np.array([made[number]["observation.state"].tolist() for number in range(made.num_frames)])
    assert made.features["action"]["names"] == NAMES
    assert made.num_frames > FPS
    assert np.ptp(actions[:, 0]) > 0.1
    assert np.abs(states[:, :6] - actions).max() < 0.15  # the arm lags behind its leader

    with urlink.connect(controller.address) as robot:
        robot.motion.move_joints(actions[0].tolist(), wait=True)
        replayed = replay_script.DatasetReplayConfig(episode=0, repo_id=made.repo_id, root=made.root)
        with robot.realtime.history(20.0) as history:
            replay_script.replay(
                replay_script.ReplayConfig(
                    robot=URConfig(address=controller.address, **options), dataset=replayed, play_sounds=False
                )
            )
            turned = history.array("q_target")["q_target"][:, 0]
    # The arm moved along the recorded path to its end.
    assert turned.max() == pytest.approx(actions[:, 0].max(), abs=0.02)

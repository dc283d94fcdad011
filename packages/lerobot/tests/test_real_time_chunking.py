"""LeRobot's real-time chunking: the example, with LeRobot's own guidance and latencies, and a simulated arm."""

from __future__ import annotations

import importlib.util
import itertools
import time
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import torch

pytest.importorskip("lerobot.policies.rtc.latency_tracker", reason="this LeRobot has no real-time chunking")

import urlink
from lerobot_robot_urlink import UR
from packages.lerobot.tests.policies import HORIZON, STEP, SteadyPolicy, saved_policy
from urlink.simulator import Controller

NAMES = [f"joint_{number}.pos" for number in range(1, 7)]
PERIOD = 0.05


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    SteadyPolicy.calls.clear()
    SteadyPolicy.stalls.clear()


@pytest.fixture
def example() -> ModuleType:
    path = Path(__file__).parents[1] / "examples" / "real_time_chunking.py"
    spec = importlib.util.spec_from_file_location("real_time_chunking", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def turned(observation: dict[str, float], steps: int = HORIZON) -> list[dict[str, float]]:
    """Return a chunk that turns wrist 3 steadily."""
    here = np.array([observation[name] for name in NAMES])
    rows = here + np.outer(STEP * np.arange(steps), [0, 0, 0, 0, 0, 1])
    return [dict(zip(NAMES, row.tolist(), strict=True)) for row in rows]


def test_policy_gets_delay_and_rest_of_previous_chunk(
    example: ModuleType, controller: Controller, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    policy = saved_policy(tmp_path / "policy", 21, seconds=0.2)
    with urlink.connect(controller.address) as robot, robot.realtime.history(60.0) as history:
        example.main([controller.address, str(policy), "--fps", "20", "--seconds", "4", "--limits", limits(tmp_path)])
        states = history.array("q_target", "qd_target")
    assert "latency up to" in capsys.readouterr().out
    calls = SteadyPolicy.calls
    assert len(calls) > 4
    assert (calls[0]["delay"], calls[0]["left"]) == (0, None)
    for before, call in itertools.pairwise(calls):
        # 0.2 s of computing, and 0.03 s to send the points, take five steps of 0.05 s.
        assert 5 <= call["delay"] <= len(call["left"]) - 2
        done = HORIZON - len(call["left"])
        assert torch.equal(call["left"], before["chunk"][done:])
    # LeRobot's guidance leads the frozen part of a chunk to the previous chunk.
    for call in calls[1:]:
        frozen, left = slice(call["delay"]), call["left"][: call["delay"], 5]
        guided, free = (abs(call[name][frozen, 5] - left).mean() for name in ("chunk", "clean"))
        assert guided < 0.75 * free
    # Without jolts, although each chunk has another offset.
    assert states["q_target"][-1, 5] > 0.3
    assert np.abs(np.diff(states["qd_target"], axis=0)).max() < 0.04


def limits(tmp_path: Path) -> str:
    path = tmp_path / "limits.json"
    path.write_text('{"tool_speed": 1.0, "box": [[-1, -1, -0.5], [1, 1, 1.5]]}')
    return str(path)


def test_chunk_takes_effect_after_its_frozen_actions(make: Callable[..., UR]) -> None:
    arm = make(watchdog=2.0)
    arm.connect()
    assert (arm.chunk_time, arm.chunk_delay) == (0.0, 0.0)
    arm.send_chunk(turned(arm.get_observation()), PERIOD)
    end = time.monotonic() + 30.0
    while arm.chunk_time < 0.1:  # until the arm has executed the first actions
        assert time.monotonic() < end
        observation = arm.get_observation()
    assert arm.chunk_time < HORIZON * PERIOD
    arm.send_chunk(turned(observation), PERIOD, frozen=20)
    assert arm.chunk_delay == pytest.approx(1.0, abs=0.02)
    arm.get_observation()
    assert arm.chunk_time < 0.9


def test_frozen_actions_have_no_effect_at_rest(make: Callable[..., UR]) -> None:
    arm = make(watchdog=2.0)
    arm.connect()
    arm.send_chunk(turned(arm.get_observation()), PERIOD, frozen=20)
    assert arm.chunk_delay < 0.5


@pytest.mark.parametrize("frozen", [-1, HORIZON - 1, 1.0, True, "2"])
def test_send_chunk_rejects_invalid_frozen(make: Callable[..., UR], frozen: object) -> None:
    arm = make(watchdog=2.0)
    arm.connect()
    observation = arm.get_observation()
    with pytest.raises(urlink.BadValue, match="frozen"):
        arm.send_chunk(turned(observation), PERIOD, frozen=frozen)  # type: ignore[arg-type]


@pytest.mark.parametrize(("steps", "period"), [(0, PERIOD), (1, PERIOD), (9, 0.0), (9, -0.1), (9, float("nan"))])
def test_send_chunk_rejects_invalid_chunks(make: Callable[..., UR], steps: int, period: float) -> None:
    arm = make(watchdog=2.0)
    arm.connect()
    observation = arm.get_observation()
    with pytest.raises(urlink.BadValue, match="expected"):
        arm.send_chunk(turned(observation, steps), period)


def test_chunk_may_end_at_full_step(make: Callable[..., UR]) -> None:
    arm = make(watchdog=2.0, max_step=0.03)
    arm.connect()
    # Each action asks for the whole step, up to the last one.
    far = {name: value + 5.0 for name, value in arm.get_observation().items() if name in NAMES}
    sent = arm.send_chunk([far] * 10, PERIOD)
    assert sent[-1]["joint_6.pos"] - sent[0]["joint_6.pos"] == pytest.approx(9 * 0.03)


def test_example_needs_limits_for_real_arm(example: ModuleType, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        example.main(["192.168.0.1", "policy"])
    assert "--limits" in capsys.readouterr().err

"""Chunks of a slow policy on a simulated arm, in simulated time."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

import urlink
from linkcore import clock
from packages.gym.tests.conftest import CB3
from urlink import BadValue
from urlink_gym import ChunkFollower, Moment
from urlink_gym.arm_env import HOME

PERIOD, HORIZON = 0.05, 30
START = np.array(HOME)


def wave(time: float) -> np.ndarray:
    """Return the positions that a policy wants from a time on, shape (HORIZON, 6)."""
    times = time + PERIOD * np.arange(HORIZON)
    return START + np.outer(0.2 * np.sin(times) ** 2, [0.5, 0.0, 0.0, 0.0, 0.0, 1.0])


@pytest.fixture
def robot(simulated_time: urlink.Simulation) -> Iterator[urlink.Robot]:
    with urlink.connect(CB3) as robot:
        robot.motion.move_joints(START, speed=2.0, wait=True)
        yield robot


def run(
    follower: ChunkFollower, latencies: list[float], policy: Callable[[float], np.ndarray] = wave
) -> list[tuple[Moment, float, np.ndarray]]:
    """Follow one chunk for each latency; return the moments, and the results of `follow`."""
    found = []
    for latency in latencies:
        moment = follower.observe()
        clock.sleep(latency)
        found.append((moment, *follower.follow(moment, policy(moment.time))))
    return found


def test_frozen_steps_follow_longest_latency(robot: urlink.Robot) -> None:
    with ChunkFollower(robot, PERIOD) as follower:
        found = run(follower, [0.1, 0.1, 0.3] + 11 * [0.1])
        assert follower.late <= 1
    frozen = [moment.frozen for moment, _, _ in found]
    assert frozen[0] == 0
    # 0.1 s of computing, and 0.03 s to send the points, take three steps of 0.05 s.
    assert frozen[1:3] == [3, 3]
    assert set(frozen[3:13]) == {7}
    assert frozen[13] == 3


def test_chunk_begins_after_its_frozen_steps(robot: urlink.Robot) -> None:
    with ChunkFollower(robot, PERIOD) as follower:
        for moment, begins, _ in run(follower, 6 * [0.12])[1:]:
            assert begins == pytest.approx(moment.time + moment.frozen * PERIOD, abs=0.02)
        assert follower.late == 0


def test_frozen_steps_are_executed_unchanged(robot: urlink.Robot) -> None:
    rng = np.random.default_rng(3)
    with ChunkFollower(robot, PERIOD) as follower:
        found = run(follower, 6 * [0.12], lambda time: wave(time) + rng.uniform(-0.01, 0.01, 6))
    for moment, _, rows in found[1:]:
        assert len(moment.planned) >= moment.frozen > 0
        assert rows[: moment.frozen] == pytest.approx(moment.planned[: moment.frozen])
    for (before, _, rows), (moment, _, _) in itertools.pairwise(found):
        times = before.time + PERIOD * np.arange(len(rows))
        wanted = np.interp(moment.time, times, rows[:, 5])
        assert moment.planned[0, 5] == pytest.approx(wanted, abs=1e-9)


def test_arm_follows_policy_without_jolts(robot: urlink.Robot) -> None:
    with robot.realtime.history(60.0) as history:
        with ChunkFollower(robot, PERIOD) as follower:
            run(follower, 12 * [0.2])
            assert follower.stream.starved == 0
        states = history.array("time", "qd_target")
    assert np.abs(np.diff(states["qd_target"], axis=0)).max() / 0.008 < 12.0
    assert np.abs(states["qd_target"][:, 5]).max() > 0.1


def test_arm_rests_at_end_of_chunk_when_policy_hangs(robot: urlink.Robot) -> None:
    with ChunkFollower(robot, PERIOD) as follower:
        run(follower, [0.1, 0.1])
        clock.sleep(30.0)
        assert np.abs(robot.realtime.wait().qd_target).max() < 1e-3
        moment = follower.observe()
        assert moment.frozen == 0
        assert moment.planned.shape == (0, 6)
        follower.follow(moment, wave(moment.time))
        robot.realtime.wait_until(lambda state: np.abs(state.qd_target).max() > 0.02, timeout=5.0)


def test_late_chunk_takes_effect_and_is_counted(robot: urlink.Robot) -> None:
    with ChunkFollower(robot, PERIOD) as follower:
        found = run(follower, [0.1, 0.1, 0.6])
        moment, begins, _ = found[-1]
        assert begins > moment.time + moment.frozen * PERIOD + 0.2
        assert follower.late == 1
        assert follower.latency == pytest.approx(0.6, abs=0.01)


def test_steps_are_limited(robot: urlink.Robot) -> None:
    with ChunkFollower(robot, PERIOD, max_step=0.02) as follower:
        moment = follower.observe()
        _, rows = follower.follow(moment, np.tile(START + 1.0, (HORIZON, 1)))
        assert rows[0] == pytest.approx(START + 0.02, abs=1e-3)
        assert np.abs(np.diff(rows, axis=0)).max() <= 0.02 + 1e-9


@pytest.mark.parametrize(
    "chunk",
    [None, "left", [], [0.0] * 6, [[0.0] * 7] * 9, [[np.nan] * 6] * 9, [START], [START, START[:5]]],
    ids=["none", "text", "empty", "row", "seven", "nan", "short", "ragged"],
)
def test_follow_rejects_invalid_chunks(robot: urlink.Robot, chunk: Any) -> None:
    with ChunkFollower(robot, PERIOD) as follower:
        moment = follower.observe()
        with pytest.raises(BadValue, match="chunk"):
            follower.follow(moment, chunk)
        follower.follow(moment, wave(moment.time))


def test_chunk_shorter_than_frozen_steps_is_rejected(robot: urlink.Robot) -> None:
    with ChunkFollower(robot, PERIOD) as follower:
        run(follower, [0.3, 0.1])
        moment = follower.observe()
        with pytest.raises(BadValue, match=rf"{moment.frozen} of them are frozen"):
            follower.follow(moment, wave(moment.time)[: moment.frozen + 1])


def test_follow_raises_error_of_stop(robot: urlink.Robot) -> None:
    with ChunkFollower(robot, PERIOD) as follower:
        run(follower, [0.1])
        robot.controller.faults.protective_stop()
        with pytest.raises(urlink.SafetyStop):
            run(follower, 20 * [0.1])


def test_chunk_that_arm_cannot_follow_keeps_previous_one(robot: urlink.Robot) -> None:
    with ChunkFollower(robot, PERIOD, max_step=0.5) as follower:
        run(follower, [0.1, 0.1])
        moment = follower.observe()
        jumps = wave(moment.time)
        jumps[::2, 5] += 0.4
        with pytest.raises(BadValue, match=r"acceleration|speed"):
            follower.follow(moment, jumps)
        assert follower.observe().planned[0] == pytest.approx(moment.planned[0], abs=0.01)


@pytest.mark.parametrize("wrong", [{"period": 0.0}, {"period": "1"}, {"max_step": np.nan}, {"max_step": -1.0}], ids=str)
def test_follower_rejects_invalid_arguments(robot: urlink.Robot, wrong: dict[str, Any]) -> None:
    with pytest.raises(BadValue, match=next(iter(wrong))):
        ChunkFollower(robot, **({"period": PERIOD} | wrong))

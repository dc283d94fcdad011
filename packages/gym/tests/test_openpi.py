"""The example for openpi, with the released client and a stand-in for the policy server."""

from __future__ import annotations

import importlib.util
import threading
from collections.abc import Iterator
from functools import partial
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import urlink
from linkcore import clock
from packages.gym.tests.conftest import CB3
from packages.gym.tests.test_tasks import example
from urlink_gym.arm_env import HOME

if importlib.util.find_spec("openpi_client") is None:
    pytest.skip("openpi-client is not installed", allow_module_level=True)

from openpi_client.websocket_client_policy import WebsocketClientPolicy

from packages.gym.tests.policy_server import policy_server

HORIZON = 50

#: openpi-client 0.1.2 calls `connect` in a way that websockets 17.1 deprecates.
pytestmark = pytest.mark.filterwarnings("ignore:connect\\(\\) must be used as a context manager:DeprecationWarning")


@pytest.fixture
def openpi() -> ModuleType:
    return example("openpi_policy")


@pytest.fixture
def robot() -> Iterator[urlink.Robot]:
    # Long limits, because a busy machine delays the simulated robot.
    with urlink.connect("sim://ur5?firmware=3.15", silence=20.0, stale_after=20.0, start_timeout=20.0) as robot:
        robot.motion.move_joints(HOME, speed=2.0, wait=120.0)
        yield robot


class Wave:
    """Policy that moves wrist 3 steadily, and remembers its requests.

    Args:
        latencies: Computing times of the first requests, in s; the last one also applies to all others.
    """

    def __init__(self, *latencies: float) -> None:
        self.seen: list[dict[str, Any]] = []
        self.latencies = latencies
        self.never = threading.Event()

    def __call__(self, observation: dict[str, Any]) -> dict[str, Any]:
        self.seen.append(observation)
        # As long as a network computes.
        self.never.wait(self.latencies[min(len(self.seen), len(self.latencies)) - 1])
        planned = observation["planned"]
        begin = planned[0] if len(planned) else observation["joints"]
        rows = np.tile(np.append(begin, 1.0), (HORIZON, 1))
        rows[:, 5] += 0.01 * np.arange(HORIZON)
        return {"actions": rows.astype(np.float32), "server_timing": {"infer_ms": 1.0}}


def test_policy_of_server_moves_arm_and_gripper(openpi: ModuleType, robot: urlink.Robot) -> None:
    robot.gripper.activate()
    wave = Wave(0.1)
    args = openpi.parsed(["sim://", "--gripper", "--prompt", "turn", "--duration", "3"])
    with policy_server(wave, {"robot": "ur5"}) as port:
        policy = WebsocketClientPolicy("127.0.0.1", port)
        assert policy.get_server_metadata() == {"robot": "ur5"}
        openpi.run(robot, policy, args)
    first, later = wave.seen[0], wave.seen[-1]
    assert first["prompt"] == "turn"
    assert first["base_rgb"].shape == first["wrist_rgb"].shape == (224, 224, 3)
    assert first["joints"] == pytest.approx(HOME, abs=0.01)
    assert (first["frozen_steps"], len(first["planned"])) == (0, 0)
    assert later["frozen_steps"] > 0
    assert later["planned"].shape[1] == 6
    assert robot.realtime.wait().q_actual[5] > 0.1
    assert robot.gripper.wait().position > 200


def test_frozen_steps_follow_latency_of_server(openpi: ModuleType, robot: urlink.Robot) -> None:
    wave = Wave(0.05, 0.05, 0.4, 0.05)
    args = openpi.parsed(["sim://", "--duration", "2"])
    with policy_server(wave) as port:
        follower = openpi.run(robot, WebsocketClientPolicy("127.0.0.1", port), args)
    frozen = [each["frozen_steps"] for each in wave.seen]
    assert frozen[0] == 0
    # 0.4 s and 0.03 s to send the points take nine steps of 0.05 s; a busy machine needs more.
    assert min(frozen[3:10]) >= 9
    assert follower.latency >= 0.05


@pytest.mark.parametrize(
    "reply",
    [
        {},
        {"actions": None},
        {"actions": np.zeros((5, 3))},
        {"actions": np.full((50, 7), np.nan)},
        {"actions": np.zeros(7)},
        [1, 2],
    ],
    ids=["nothing", "none", "narrow", "nan", "row", "list"],
)
def test_invalid_reply_is_rejected_and_arm_stays(openpi: ModuleType, robot: urlink.Robot, reply: Any) -> None:
    with policy_server(lambda observation: reply) as port:
        policy = WebsocketClientPolicy("127.0.0.1", port)
        with pytest.raises(urlink.BadValue, match="expected finite rows of 7 numbers"):
            openpi.run(robot, policy, openpi.parsed(["sim://"]))
    assert robot.realtime.wait().q_actual == pytest.approx(HOME, abs=0.01)


def test_error_of_server_stops_arm(openpi: ModuleType, robot: urlink.Robot) -> None:
    wave = Wave(0.05)

    def fail_later(observation: dict[str, Any]) -> dict[str, Any]:
        if len(wave.seen) == 5:
            raise ValueError("out of memory")
        return wave(observation)

    with policy_server(fail_later) as port:
        policy = WebsocketClientPolicy("127.0.0.1", port)
        with pytest.raises(RuntimeError, match="out of memory"):
            openpi.run(robot, policy, openpi.parsed(["sim://"]))
    assert np.abs(robot.realtime.wait().qd_target).max() < 1e-3


def test_server_that_hangs_times_out_and_arm_stops(
    openpi: ModuleType, robot: urlink.Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(openpi, "ANSWER_TIMEOUT", 1.0)
    wave = Wave(0.05, 0.05, 60.0)
    with policy_server(wave) as port:
        policy = WebsocketClientPolicy("127.0.0.1", port)
        with pytest.raises(urlink.LinkTimeout, match="policy server did not answer within 1 s"):
            openpi.run(robot, policy, openpi.parsed(["sim://"]))
        wave.never.set()
    assert np.abs(robot.realtime.wait().qd_target).max() < 1e-3


class Hanging:
    """Policy whose server does not answer until the test ends, and the time at which it was asked."""

    def __init__(self) -> None:
        self.asked = -np.inf
        self.test_is_over = threading.Event()

    def infer(self, *question: Any) -> None:
        self.asked = clock.now()
        self.test_is_over.wait()


def test_answer_is_awaited_for_ten_seconds(openpi: ModuleType, simulated_time: urlink.Simulation) -> None:
    policy = Hanging()
    with urlink.connect(CB3) as robot:
        with pytest.raises(urlink.LinkTimeout, match="did not answer within 10 s"):
            openpi.run(robot, policy, openpi.parsed(["sim://"]))
        # The arm rests during the wait, so the block of the follower ends within a few cycles.
        assert 10.0 <= clock.now() - policy.asked < 11.0
        assert not robot.realtime.wait().qd_target.any()
    policy.test_is_over.set()


def test_connection_is_awaited_for_thirty_seconds(
    openpi: ModuleType, simulated_time: urlink.Simulation, monkeypatch: pytest.MonkeyPatch
) -> None:
    policy = Hanging()
    monkeypatch.setattr(openpi, "WebsocketClientPolicy", policy.infer)
    monkeypatch.setattr("sys.argv", ["openpi_policy.py", CB3])
    with pytest.raises(urlink.LinkTimeout, match="did not answer within 30 s"):
        openpi.main()
    assert clock.now() - policy.asked == pytest.approx(30.0, abs=1e-6)
    policy.test_is_over.set()


def test_server_that_is_absent_raises(openpi: ModuleType) -> None:
    with pytest.raises(ConnectionRefusedError):
        openpi.within(10.0, "the policy server", partial(WebsocketClientPolicy, "127.0.0.1", 1))


def test_real_arm_needs_limits(openpi: ModuleType, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        openpi.parsed(["192.168.0.1"])
    assert "--limits" in capsys.readouterr().err

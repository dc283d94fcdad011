"""LeRobot's asynchronous inference: its policy server and its robot client, over gRPC, with a simulated arm."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterator
from concurrent import futures
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("grpc", reason="LeRobot is installed without its extra async")

import grpc
from lerobot.transport import services_pb2_grpc

import urlink
from lerobot_robot_urlink import URConfig
from packages.lerobot.tests.policies import SteadyPolicy, saved_policy
from urlink.simulator import Controller

FPS = 30
#: Importing the server and the client replaces the handlers of the root logger, and does not close their files.
pytestmark = pytest.mark.filterwarnings("ignore:unclosed file:ResourceWarning")


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Work in a temporary folder, because LeRobot writes log files into the current folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    SteadyPolicy.calls.clear()
    SteadyPolicy.stalls.clear()
    handlers, level = logging.root.handlers[:], logging.root.level
    yield
    for handler in set(logging.root.handlers) - set(handlers):
        handler.close()
    logging.root.handlers[:] = handlers
    logging.root.setLevel(level)


@pytest.fixture
def server(folder: None, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """Address of a policy server."""
    from lerobot.async_inference import policy_server

    # The server refuses policies that it does not know, even if LeRobot knows them.
    monkeypatch.setattr(policy_server, "SUPPORTED_POLICIES", ["steady"])
    config = policy_server.PolicyServerConfig(fps=FPS, inference_latency=0.0, obs_queue_timeout=0.5)
    policies = policy_server.PolicyServer(config)
    grpc_server = grpc.server(futures.ThreadPoolExecutor(max_workers=4))
    services_pb2_grpc.add_AsyncInferenceServicer_to_server(policies, grpc_server)
    port = grpc_server.add_insecure_port("127.0.0.1:0")
    grpc_server.start()
    yield f"127.0.0.1:{port}"
    policies.stop()
    grpc_server.stop(1.0).wait(10.0)


class Client:
    """LeRobot's robot client, whose control loop runs in a thread.

    Attributes:
        error: Error that ended the control loop; None if none did.
    """

    def __init__(self, server: str, address: str, tmp_path: Path, **options: Any) -> None:
        from lerobot.async_inference.configs import RobotClientConfig
        from lerobot.async_inference.robot_client import RobotClient

        robot = URConfig(
            id="arm", calibration_dir=tmp_path / "none", address=address, fps=FPS, max_step=0.04, **options
        )
        policy = saved_policy(tmp_path / "policy", 21)
        self.client = RobotClient(
            RobotClientConfig(
                policy_type="steady",
                pretrained_name_or_path=str(policy),
                robot=robot,
                actions_per_chunk=20,
                server_address=server,
                fps=FPS,
            )
        )
        assert self.client.start()
        self.error: BaseException | None = None
        self._threads = [threading.Thread(target=call) for call in (self.client.receive_actions, self._control)]
        for thread in self._threads:
            thread.start()

    def _control(self) -> None:
        try:
            self.client.control_loop(task="turn")
        except BaseException as error:
            self.error = error
        finally:
            # As LeRobot's own program does.
            self.client.stop()

    def stop(self) -> None:
        self.client.shutdown_event.set()
        for thread in self._threads:
            thread.join(30.0)
            assert not thread.is_alive()


@pytest.fixture
def start(server: str, controller: Controller, tmp_path: Path) -> Iterator[Callable[..., Client]]:
    made: list[Client] = []

    def one(**options: Any) -> Client:
        made.append(Client(server, controller.address, tmp_path, **options))
        return made[-1]

    yield one
    for client in made:
        client.stop()


def until(condition: Callable[[], object], seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "the condition did not become true in time"
        time.sleep(0.01)


def test_client_moves_arm_by_chunks_of_server(start: Callable[..., Client], controller: Controller) -> None:
    client = start(watchdog=2.0)
    until(lambda: len(SteadyPolicy.calls) >= 3 and controller.arm.sample.q_actual[5] > 0.3)
    client.stop()
    assert client.error is None
    with urlink.connect(controller.address) as robot:
        assert np.abs(robot.realtime.wait().qd_actual).max() < 0.01
    # The second chunk starts where the first one has led to.
    first, second = (call["clean"][0, 5].item() for call in SteadyPolicy.calls[:2])
    assert second - first > 0.1


def test_client_continues_after_pause_of_slow_policy(start: Callable[..., Client], controller: Controller) -> None:
    SteadyPolicy.stalls[:] = [0.0, 3.0]
    client = start(watchdog=0.5, restart_after_pause=True)
    until(lambda: len(SteadyPolicy.calls) >= 3)
    begin = controller.arm.sample.q_actual[5]
    until(lambda: controller.arm.sample.q_actual[5] > begin + 0.1)
    client.stop()
    assert client.error is None


def test_watchdog_ends_client_of_slow_policy(start: Callable[..., Client], controller: Controller) -> None:
    SteadyPolicy.stalls[:] = [0.0, 4.0]
    client = start(watchdog=0.5)
    until(lambda: client.error is not None)
    assert isinstance(client.error, urlink.ConnectionLost)
    assert "watchdog" in str(client.error)
    until(lambda: max(map(abs, controller.arm.sample.qd_actual)) < 0.01)


def test_protective_stop_ends_client(start: Callable[..., Client], controller: Controller) -> None:
    client = start(watchdog=2.0)
    until(lambda: len(SteadyPolicy.calls) >= 2)
    controller.faults.protective_stop()
    until(lambda: client.error is not None)
    assert isinstance(client.error, urlink.SafetyStop)
    assert not client.client.robot.is_connected

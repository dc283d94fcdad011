"""The example of a robot behind HTTP, tested with the client of FastAPI."""

from __future__ import annotations

import importlib.util
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.waiting import until
from urlink.simulator import Controller

pytest.importorskip("fastapi")
pytest.importorskip("httpx2")

pytestmark = pytest.mark.real_time

EXAMPLE = Path(__file__).parents[2] / "examples" / "web_robot.py"
HOME = [0.0, -1.5, 1.5, -1.5, -1.5, 0.0]


@pytest.fixture
def controller() -> Iterator[Controller]:
    with Controller("UR5e", "5.11") as controller:
        yield controller


@pytest.fixture
def client(controller: Controller) -> Iterator[Any]:
    from fastapi.testclient import TestClient  # type: ignore[import-not-found,unused-ignore]

    spec = importlib.util.spec_from_file_location("web_robot", EXAMPLE)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    with TestClient(module.create_app(controller.address), base_url="http://localhost:8000") as client:
        yield client


def test_state_request_and_websocket_return_states(client: Any) -> None:
    assert len(client.get("/state").json()["q"]) == 6
    with client.websocket_connect("ws://localhost:8000/states") as socket:
        ages = [socket.receive_json()["age"] for _ in range(3)]
    assert all(0.0 <= age < 5.0 for age in ages)


def test_motion_requests_can_be_stopped_and_refused(client: Any, controller: Controller) -> None:
    assert client.post("/move_joints", json={"q": HOME}).json() == {"phase": "done"}
    assert client.get("/state").json()["q"] == pytest.approx(HOME, abs=1e-2)
    assert client.post("/move_joints", json={"q": [1.0]}).status_code == 422
    answers: list[Any] = []
    slow = {"q": [1.0, *HOME[1:]], "speed": 0.1}
    moving = threading.Thread(target=lambda: answers.append(client.post("/move_joints", json=slow)))
    moving.start()
    until(lambda: client.get("/state").json()["q"][0] > 0.02)
    client.post("/stop")
    moving.join(10.0)
    assert answers[0].status_code == 409
    assert "Cancelled" in answers[0].text
    controller.faults.protective_stop()
    until(lambda: client.get("/state").json()["refusal"] is not None)
    refused = client.post("/move_joints", json={"q": HOME})
    assert refused.status_code == 409
    assert "protective stop" in refused.text


@pytest.mark.parametrize("origin", ["http://elsewhere.example", "null", "http://localhost:8000.elsewhere.example", ""])
def test_cross_origin_requests_are_rejected(client: Any, controller: Controller, origin: str) -> None:
    from starlette.websockets import WebSocketDisconnect  # type: ignore[import-not-found,unused-ignore]

    before = client.get("/state").json()["q"]
    for path, body in (("/move_joints", {"q": HOME}), ("/stop", None)):
        refused = client.post(path, json=body, headers={"Origin": origin})
        assert (refused.status_code, "is not allowed" in refused.text) == (403, True)
    assert client.get("/state", headers={"Origin": origin}).status_code == 403
    with (
        pytest.raises(WebSocketDisconnect) as closed,
        client.websocket_connect("ws://localhost:8000/states", headers={"Origin": origin}) as socket,
    ):
        socket.receive_json()
    assert closed.value.code == 1008
    assert client.get("/state").json()["q"] == pytest.approx(before, abs=1e-2)


@pytest.mark.parametrize(
    "host", ["elsewhere.example", "elsewhere.example:8000", "localhost.elsewhere.example", "[", ""]
)
def test_requests_for_another_host_are_rejected(client: Any, host: str) -> None:
    """A page whose host name resolves to this computer sends no origin, and could read the answers."""
    from starlette.websockets import WebSocketDisconnect  # type: ignore[import-not-found,unused-ignore]

    rejected = client.get("/state", headers={"Host": host})
    assert (rejected.status_code, "is not allowed" in rejected.text) == (403, True)
    with (
        pytest.raises(WebSocketDisconnect) as closed,
        client.websocket_connect("ws://localhost:8000/states", headers={"Host": host}) as socket,
    ):
        socket.receive_json()
    assert closed.value.code == 1008


@pytest.mark.parametrize("host", ["localhost:8000", "LOCALHOST", "127.0.0.1:8000", "192.168.1.7:8000", "[::1]:8000"])
def test_requests_for_an_address_are_served(client: Any, host: str) -> None:
    assert client.get("/state", headers={"Host": host}).status_code == 200


def test_same_origin_requests_are_served(client: Any) -> None:
    own = {"Origin": "http://localhost:8000"}
    assert client.post("/stop", headers=own).json() == {"phase": "done"}
    with client.websocket_connect("ws://localhost:8000/states", headers=own) as socket:
        assert len(socket.receive_json()["q"]) == 6

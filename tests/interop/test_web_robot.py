"""The example of a robot behind HTTP, with FastAPI's own client."""

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
    with TestClient(module.create_app(controller.address)) as client:
        yield client


def test_state_and_states(client: Any) -> None:
    assert len(client.get("/state").json()["q"]) == 6
    with client.websocket_connect("/states") as socket:
        ages = [socket.receive_json()["age"] for _ in range(3)]
    assert all(0.0 <= age < 5.0 for age in ages)


def test_motions_pass_the_interlock_and_are_stopped(client: Any, controller: Controller) -> None:
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

"""Robot and servers of the tests of MCP."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("mcp")

import urlink
from packages.mcp.tests.clients import TOKEN
from urlink_mcp import Server

LIMITS = urlink.SessionLimits(tool_speed=0.5, joint_speed=1.05, box=((-1.0, -1.0, -0.2), (1.0, 1.0, 1.5)))


@pytest.fixture(scope="session")
def shared_robot(tmp_path_factory: pytest.TempPathFactory) -> Iterator[urlink.Robot]:
    """Simulated robot for all tests, with limits and points. A busy computer must not end its connection."""
    points = tmp_path_factory.mktemp("points") / "cell.json"
    how: dict[str, Any] = {"silence": 20.0, "stale_after": 20.0, "start_timeout": 20.0}
    with urlink.connect("sim://ur5e?firmware=5.11", limits=LIMITS, points=points, **how) as robot:
        robot.points.teach("home")
        yield robot


@pytest.fixture
def robot(shared_robot: urlink.Robot) -> Iterator[urlink.Robot]:
    """The same robot, at rest and at its first position before each test."""
    shared_robot.motion.move_joints(shared_robot.points["home"].q, 1.0, wait=60.0)
    yield shared_robot
    shared_robot.motion.stop(wait=20.0)


@pytest.fixture
def log(tmp_path: Path) -> Path:
    return tmp_path / "requests.jsonl"


@pytest.fixture
def server(robot: urlink.Robot, log: Path) -> Iterator[Server]:
    """Server over HTTP that offers all tools."""
    with Server({"arm": robot}, port=0, token=TOKEN, allow=True, log=log, settling=0.0) as server:
        yield server

"""Simulated arm of the tests, served to Prometheus."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

import urlink
from urlink_prometheus import RobotCollector, serve_metrics


@pytest.fixture
def port(urlink_robot: urlink.Robot) -> Iterator[int]:
    """Port of the server for the robot "arm"."""
    collector = RobotCollector({"arm": urlink_robot})
    with serve_metrics(collector, port=0) as port:
        urlink_robot.realtime.wait(20.0)
        yield port
    collector.close()

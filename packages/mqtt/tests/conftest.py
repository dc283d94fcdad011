from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest

import urlink
from packages.mqtt.tests.panel import Panel
from tests.mosquitto import broker
from urlink_mqtt import Broker, Server

__all__ = ["broker"]


@pytest.fixture
def panels(broker: int) -> Iterator[Callable[..., Panel]]:
    """Function that makes panels which are connected to the same broker."""
    made: list[Panel] = []

    def make(name: str = "panel", **options: Any) -> Panel:
        made.append(Panel(broker, name, **options))
        return made[-1]

    yield make
    for panel in made:
        panel.close()


@pytest.fixture
def server(broker: int, urlink_robot: urlink.Robot) -> Iterator[Server]:
    """Server that serves the simulated robot as "arm" and accepts commands."""
    where = Broker("127.0.0.1", broker)
    with Server(urlink_robot, "arm", where, status_rate=20.0, allow_commands=True) as server:
        yield server

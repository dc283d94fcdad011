"""Small promises of a mobile robot's client, each of which a forgotten or a late statement would break."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator

import pytest

import rhdlink
from rhdlink.plugins.turtle import Turtle

pytestmark = pytest.mark.simulated_time


@pytest.fixture
def host() -> Iterator[rhdlink.Host]:
    with rhdlink.Host([Turtle()], port=0) as host:
        yield host


def test_wrong_name_is_reported_before_missing_access(host: rhdlink.Host) -> None:
    with rhdlink.connect(host.address) as robot, pytest.raises(rhdlink.NotThere):
        robot["nonsense"] = 1


def test_closed_subscription_gets_nothing_more(host: rhdlink.Host) -> None:
    updates: list[object] = []
    with rhdlink.connect(host.address) as robot:
        subscription = robot.subscribe(updates.append)
        robot.sync()
        subscription.close()
        count = len(updates)
        robot.sync()
        assert robot._subscribers._subscribers == ()
    assert len(updates) == count


def test_asyncio_robot_is_closed_before_its_connection(host: rhdlink.Host, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[bool] = []

    async def run() -> None:
        async with rhdlink.connect_async(host.address) as robot:
            close = robot.variables.close

            def noting(timeout: float = 2.0) -> None:
                seen.append(robot._is_closed)
                close(timeout)

            monkeypatch.setattr(robot.variables, "close", noting, raising=False)

    asyncio.run(run())
    assert seen[0] is True

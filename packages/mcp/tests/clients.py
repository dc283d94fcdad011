"""Clients of the tests, made with the SDK."""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine
from pathlib import Path
from typing import Any, TypeVar

import httpx2
import mcp_types as types
from mcp import Client
from mcp.client.streamable_http import streamable_http_client

import urlink

T = TypeVar("T")

TOKEN = "a token that is long enough"
#: Generations of the protocol: how the SDK connects. The first one sends questions as requests of the server.
MODES = ["legacy", "auto"]

#: Function that receives the text of a question, and returns the answer of a person.
Person = Callable[[str], Awaitable[types.ElicitResult]]


class Asked:
    """Person who answers each question in the same way, and remembers the questions."""

    def __init__(self, action: str = "accept", content: dict[str, Any] | None = None) -> None:
        self.questions: list[str] = []
        self._result = types.ElicitResult(action=action, content=content)

    async def __call__(self, text: str) -> types.ElicitResult:
        self.questions.append(text)
        return self._result


def consenting() -> Asked:
    return Asked("accept", {"consent": True})


@contextlib.asynccontextmanager
async def connected(
    url: str | None, mode: str = "auto", person: Person | None = None, token: str | None = TOKEN, name: str = "tester"
) -> AsyncIterator[Client]:
    """Client over HTTP. Without a person, the client does not declare elicitation."""

    async def elicit(context: Any, params: Any) -> types.ElicitResult:
        assert person is not None
        return await person(params.message)

    headers = {} if token is None else {"Authorization": f"Bearer {token}"}
    assert url is not None
    async with (
        httpx2.AsyncClient(headers=headers, timeout=60.0) as http,
        Client(
            streamable_http_client(url, http_client=http),
            mode=mode,
            elicitation_callback=None if person is None else elicit,
            client_info=types.Implementation(name=name, version="1.5"),
        ) as client,
    ):
        yield client


def run(main: Coroutine[Any, Any, T]) -> T:
    """Run a coroutine, with a deadline."""

    async def limited() -> T:
        return await asyncio.wait_for(main, 120.0)

    return asyncio.run(limited())


def text(result: Any) -> str:
    return str(result.content[0].text)


def values(result: Any) -> dict[str, Any]:
    """Return the values of a result without an error."""
    assert not result.is_error, text(result)
    assert json.loads(text(result)) == result.structured_content
    return dict(result.structured_content)


def turned(robot: urlink.Robot, by: float) -> list[float]:
    """Return the joint positions of the robot with another angle of the base, in rad."""
    q = robot.realtime.wait(20.0).q_actual.tolist()
    q[0] += by
    return [float(each) for each in q]


def is_moving(robot: urlink.Robot) -> bool:
    return bool(robot.realtime.wait(20.0).qd_target.any())


async def rests_before(robot: urlink.Robot, goal: list[float]) -> None:
    """Wait until the arm is at rest, and check that it has not reached the goal of its motion."""
    await until(lambda: not is_moving(robot))
    assert abs(goal[0] - robot.realtime.wait(20.0).q_target[0]) > 0.5


def events(log: Path) -> list[tuple[str, str]]:
    """Return the tools and events of a log of requests."""
    rows = [json.loads(line) for line in log.read_text(encoding="utf-8").splitlines()]
    return [(row["tool"], row["event"]) for row in rows]


async def until(condition: Callable[[], bool]) -> None:
    """Wait in a thread until a condition of the robot is true."""
    end = asyncio.get_running_loop().time() + 60.0
    while not await asyncio.to_thread(condition):
        assert asyncio.get_running_loop().time() < end, "the condition did not become true within 60 s"

from __future__ import annotations

import socket
from collections.abc import Iterator

import pytest
import zenoh

import urlink
from urlink_zenoh import Server, open_session


def free_endpoint() -> str:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{listener.getsockname()[1]}"


@pytest.fixture
def endpoint() -> str:
    return free_endpoint()


@pytest.fixture
def router(endpoint: str) -> Iterator[zenoh.Session]:
    with open_session(listen=[endpoint], mode="router") as session:
        yield session


@pytest.fixture
def session(router: zenoh.Session, endpoint: str) -> Iterator[zenoh.Session]:
    """Session of a client."""
    with open_session([endpoint]) as session:
        yield session


@pytest.fixture
def server(router: zenoh.Session, endpoint: str, urlink_robot: urlink.Robot) -> Iterator[Server]:
    """Server that serves the simulated robot as "arm" over a router."""
    with open_session([endpoint]) as session, Server(session, {"arm": urlink_robot}) as server:
        yield server

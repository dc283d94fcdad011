"""Robot, server and certificates of the tests of OPC UA."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("asyncua")

import contextlib

import urlink
from packages.opcua.tests.clients import PASSWORD, Keys, certificate
from urlink_opcua import Access, Server
from urlink_opcua.access import read_certificate, read_private_key


@pytest.fixture(scope="session")
def keys(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Keys]:
    """Certificates by name. "expired" was valid yesterday, and "later" will be valid tomorrow."""
    folder = tmp_path_factory.mktemp("certificates")
    days = {"server": (-1, 2), "client": (-1, 2), "stranger": (-1, 2), "expired": (-2, -1), "later": (1, 2)}
    return {name: certificate(folder, name, *valid) for name, valid in days.items()}


@pytest.fixture(scope="session")
def access(keys: dict[str, Keys]) -> Access:
    """Access of the clients "client", "expired" and "later", and of a user with a password."""
    trusted = [read_certificate(str(keys[name].certificate)) for name in ("client", "expired", "later")]
    return Access(trusted, "operator", PASSWORD)


@pytest.fixture(scope="session")
def shared_robot() -> Iterator[urlink.Robot]:
    """Simulated robot for all tests, because a server takes seconds to start."""
    with urlink.connect("sim://ur5e?firmware=5.11", silence=20.0, stale_after=20.0, start_timeout=20.0) as robot:
        robot.controller.pendant.files["pick.urp"] = "def pick():\n  sleep(600)\nend"
        robot.controller.pendant.files["turn.urp"] = (
            "def turn():\n  write_output_integer_register(24, read_input_integer_register(24) + 1)\n"
            "  movej([1.5, -1.5, 1.5, -1.5, -1.5, 0.0], a=1.4, v=0.05)\nend"
        )
        yield robot


def serving(robot: urlink.Robot, keys: dict[str, Keys], access: Access, *, allow: bool) -> Server:
    certificate = read_certificate(str(keys["server"].certificate))
    key = read_private_key(str(keys["server"].private_key), certificate)
    # A busy computer interrupts the server, which must not make these tests fail.
    options = {"certificate": certificate, "private_key": key, "settling": 0.0}
    return Server({"arm": robot}, port=0, rate=50.0, allow=allow, access=access, **options)


@pytest.fixture(scope="session")
def shared_server(shared_robot: urlink.Robot, keys: dict[str, Keys], access: Access) -> Iterator[Server]:
    with serving(shared_robot, keys, access, allow=True) as server:
        yield server


@pytest.fixture
def server(shared_server: Server, shared_robot: urlink.Robot) -> Iterator[Server]:
    """Server that accepts commands. After the test, no program runs."""
    yield shared_server
    with contextlib.suppress(urlink.DashboardRefused):
        shared_robot.dashboard.stop()


@pytest.fixture
def robot(shared_robot: urlink.Robot) -> urlink.Robot:
    return shared_robot


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("files")

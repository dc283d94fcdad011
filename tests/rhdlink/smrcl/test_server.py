"""The port of a mission server, as programs written for MRC use it; the dialogue is tested in test_dialogue."""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from linkcore.errors import BadAddress, BadValue, Closed, ConnectFailed, ConnectionLost
from rhdlink import Host
from rhdlink.host.plugins.turtle import SmrTurtle, Turtle
from rhdlink.host.world import World
from rhdlink.smrcl import MissionServer
from rhdlink.smrcl.recipients import MOST_BACKLOG
from rhdlink.smrcl.robot_link import PluginLink
from tests.waiting import until

pytestmark = pytest.mark.real_time

SECONDS = 20.0


class Client:
    """Client that sends and reads lines."""

    def __init__(self, server: MissionServer) -> None:
        self.socket = socket.create_connection(("127.0.0.1", server.port), timeout=SECONDS)
        self._lines = self.socket.makefile("r", encoding="latin-1", newline="\n")

    def send(self, *lines: str) -> None:
        self.socket.sendall("".join(f"{line}\n" for line in lines).encode("latin-1"))

    def line(self) -> str:
        """Return the next line, or "" at the end of the connection."""
        try:
            return self._lines.readline().rstrip("\n")
        except ConnectionResetError:
            return ""

    def ask(self, line: str) -> str:
        self.send(line)
        return self.line()

    def close(self) -> None:
        self._lines.close()
        self.socket.close()

    def reset(self) -> None:
        """Reset the connection without closing it properly."""
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
        self.close()


@pytest.fixture
def turtle() -> Turtle:
    return Turtle(World(1000.0))


@pytest.fixture
def server(turtle: Turtle) -> Iterator[MissionServer]:
    with MissionServer(turtle, port=0) as server:
        yield server


@pytest.fixture
def client(server: MissionServer) -> Iterator[Client]:
    with contextlib.closing(Client(server)) as client:
        yield client


def is_stopped(turtle: Turtle) -> bool:
    return turtle.cmdtransvel == turtle.cmdrotvel == 0


def test_client_drives_the_robot(client: Client, turtle: Turtle, server: MissionServer) -> None:
    assert client.ask("fwd 0.1") == "ID1 queued"
    assert client.ask("getevent 5") == "ID1 started"
    assert float(client.ask("eval $odox")) < 0.1
    assert client.ask("getevent 5") == "ID1 stopcond 0.000000"
    assert turtle.world.odometry.x == pytest.approx(0.1, abs=0.01)
    assert client.ask("fwd (") == "ID2 queued"
    assert client.ask("getevent 5") == "ID2 syntaxerror"
    assert server.failures[-1].text == "fwd ("


def test_several_clients_share_the_robot(client: Client, server: MissionServer) -> None:
    with contextlib.closing(Client(server)) as other:
        assert client.ask("shared = 7") == "ID1 queued"
        until(lambda: other.ask("eval shared") == "7.000000 ")
        assert other.ask('set "xmlon" 1') == "ID1 queued"
        while "finished" not in other.line():
            pass
        assert other.ask("eval 1") == '<eval ="1.000000" />'
        assert client.ask("eval 1") == "1.000000 "
        assert other.ask("logoff") == "ok"
        assert other.line() == ""
    assert client.ask("eval shared") == "7.000000 "


def test_robot_stops_when_its_client_vanishes(client: Client, turtle: Turtle, server: MissionServer) -> None:
    """The client was driving the robot, and no other client knows its intention."""
    assert client.ask("eval 1") == "1.000000 "
    other = Client(server)
    assert other.ask("drive") == "ID1 queued"
    until(lambda: turtle.cmdtransvel > 1000)
    other.reset()
    until(lambda: is_stopped(turtle))
    assert client.ask("eval 1") == "1.000000 "


def test_number_of_clients_is_limited(turtle: Turtle) -> None:
    with MissionServer(turtle, port=0, clients=1) as server:
        first = Client(server)
        assert first.ask("eval 1") == "1.000000 "
        second = Client(server)
        assert second.line() == ""
        assert first.ask("eval 2") == "2.000000 "
        first.close()
        second.close()


def test_silent_clients_lose_their_slots(turtle: Turtle) -> None:
    with MissionServer(turtle, port=0, clients=2, inactivity_timeout=0.0) as server:
        silent = [Client(server), Client(server)]
        until(lambda: len(server._handlers) == 2)
        newcomers = [Client(server), Client(server)]
        assert [each.ask("eval 1") for each in newcomers] == ["1.000000 "] * 2
        assert [each.line() for each in silent] == ["", ""]
        for client in (*silent, *newcomers):
            client.close()


def test_busy_clients_keep_their_slots(turtle: Turtle) -> None:
    with MissionServer(turtle, port=0, clients=3, inactivity_timeout=0.0) as server:
        driver, queued, waiting = Client(server), Client(server), Client(server)
        assert driver.ask("drive") == "ID1 queued"
        until(lambda: turtle.cmdtransvel > 1000)
        assert queued.ask("fwd 0.1") == "ID1 queued"
        waiting.send("getevent 60")
        until(lambda: any(each.session is not None and each.session.is_waiting for each in server._handlers))
        newcomer = Client(server)
        assert newcomer.line() == ""
        assert queued.ask("eval 1") == "1.000000 "
        assert not is_stopped(turtle)
        for client in (driver, queued, waiting, newcomer):
            client.close()


def test_flood_of_lines_does_not_delay_the_robot(client: Client, turtle: Turtle) -> None:
    count = MOST_BACKLOG + 500
    client.send("fwd 0.05", *["eval 1"] * count)
    assert client.line() == "ID1 queued"
    assert [client.line() for _ in range(count)] == ["1.000000 "] * count
    until(lambda: turtle.world.odometry.x > 0.04)


def test_too_long_line_ends_only_its_client(client: Client, server: MissionServer) -> None:
    with contextlib.closing(Client(server)) as other:
        assert other.ask("x" * 300).startswith("error a line has at most")
        assert other.line() == ""
    assert client.ask("eval 1") == "1.000000 "


@pytest.mark.parametrize("compat", ["sound", "mrc"])
def test_errors_of_clients_do_not_end_the_server(compat: str, tmp_path: Path) -> None:
    with (
        MissionServer(SmrTurtle(World(1000.0)), port=0, compat=compat, log_folder=tmp_path) as server,
        contextlib.closing(Client(server)) as client,
    ):
        client.send('set "odowidth" 0', "fwd 1 @v 0.3 : ($cmdtime > 0.2)", 'log "$odox"', 'control "savelog" "../x"')
        client.send("b = 5")
        until(lambda: client.ask("eval b") == "5.000000 ", SECONDS)
        with contextlib.closing(Client(server)) as another:
            assert another.ask("eval 1+1") == "2.000000 "
        assert server.failure is None
        assert any("cannot save a log as '../x'" in failure.reason for failure in server.failures)


def test_exit_ends_the_client_or_the_server_in_mrc_profile(client: Client, turtle: Turtle) -> None:
    assert client.ask("exit") == "ok"
    assert client.line() == ""
    with MissionServer(turtle, port=0, compat="mrc") as server, contextlib.closing(Client(server)) as other:
        # Like MRC, the server connects to the robot only when a client has connected.
        assert other.ask("exit") == "ok"
        assert other.line() == ""
        assert server.wait(SECONDS)


def test_waiting_server_ends_when_it_cannot_connect() -> None:
    with MissionServer("localhost:1", port=0, waits=True) as server, contextlib.closing(Client(server)) as client:
        client.send("fwd 1")
        assert client.line() == ""
        with pytest.raises(ConnectFailed):
            server.wait(SECONDS)


def test_server_ends_when_its_robot_disconnects(turtle: Turtle) -> None:
    with Host([turtle], port=0) as host, MissionServer(host.address, port=0) as server:
        client = Client(server)
        assert client.ask("eval 1") == "1.000000 "
        host.close()
        with pytest.raises(ConnectionLost):
            server.wait(SECONDS)
        assert isinstance(server.failure, ConnectionLost)
        assert client.line() == ""
        client.close()


def test_ended_server_leaves_the_robot_stopped(turtle: Turtle) -> None:
    with MissionServer(turtle, port=0) as server:
        client = Client(server)
        assert client.ask("drive") == "ID1 queued"
        until(lambda: turtle.cmdtransvel > 1000)
    assert is_stopped(turtle)
    assert client.line() == ""
    client.close()
    assert "ended" in repr(server)
    with pytest.raises(Closed, match="has already run"):
        server.start()


def test_start_raises_the_reason_of_a_failure(turtle: Turtle, server: MissionServer) -> None:
    with pytest.raises(BadAddress, match=str(server.port)):
        MissionServer(turtle, port=server.port).run()
    with pytest.raises(BadValue, match="at least 1"):
        MissionServer(turtle, clients=0)
    with pytest.raises(BadValue, match="inactivity_timeout"):
        MissionServer(turtle, inactivity_timeout=-1.0)
    with pytest.raises(BadValue, match="expected 'sound', 'mrc'"):
        MissionServer(turtle, compat="loud")
    with pytest.raises(Closed, match="is not running"):
        _ = MissionServer(turtle).port
    with pytest.raises(ConnectFailed):
        MissionServer("localhost:1", port=0).start()


def test_callbacks_and_providers_of_a_server_are_used() -> None:
    said: list[str] = []
    link = PluginLink([Turtle(World(1000.0))], is_realtime=True)
    server = MissionServer(link, port=0).on("vision", lambda text: {"vis0": float(len(text))})
    server.on_said(lambda what: said.append(what.text)).provide("$l0", lambda: 4.5)
    with server, contextlib.closing(Client(server)) as client:
        assert client.ask('vision "look"') == "ID1 queued"
        until(lambda: client.ask("eval $vis0 ; $l0") == "4.000000 4.500000 ")
    link.close()
    assert 'vision "look"' in said

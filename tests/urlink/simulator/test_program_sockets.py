"""Sockets of programs, tested against real listeners."""

from __future__ import annotations

import contextlib
import os
import socket
from collections.abc import Iterator

import pytest

import urlink
from linkcore.errors import BadValue
from tests import platforms
from tests.waiting import until
from urlink import Trajectory, TrajectoryPoint
from urlink.simulator import Controller, Still
from urlink.simulator.programs.program_world import MOST, MOST_WAITING, ProgramSockets, Target


def refuse_all(address: str, port: int) -> Target | None:
    """Return a target only for addresses of this computer."""
    return Target(address, port) if address.startswith("127.") else None


@pytest.fixture
def listener() -> Iterator[socket.socket]:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        listener.settimeout(10)
        yield listener


@pytest.fixture
def sockets() -> Iterator[ProgramSockets]:
    sockets = ProgramSockets(refuse_all)
    yield sockets
    sockets.close_all()


def port(listener: socket.socket) -> int:
    return int(listener.getsockname()[1])


def opened(sockets: ProgramSockets, listener: socket.socket, name: str = "s") -> socket.socket:
    sockets.open(name, "127.0.0.1", port(listener))
    peer, _ = listener.accept()
    peer.settimeout(10)
    until(lambda: sockets.state(name) == "open")
    return peer


def descriptors() -> int:
    return len(os.listdir("/proc/self/fd"))


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost", "127.1.2.3"])
@pytest.mark.simulated_time
def test_loopback_host_is_always_reachable(host: str) -> None:
    sockets = ProgramSockets(refuse_all)
    with socket.create_server(("0.0.0.0", 0)) as listener:
        sockets.open("s", host, port(listener))
        until(lambda: sockets.state("s") == "open")
        sockets.close_all()


@pytest.mark.simulated_time
def test_socket_fails_when_no_server_listens(sockets: ProgramSockets, listener: socket.socket) -> None:
    number = port(listener)
    listener.close()
    sockets.open("s", "127.0.0.1", number)
    until(lambda: sockets.state("s") == "failed")
    assert not sockets.send("s", b"x")
    assert sockets.received("s") == b""


@pytest.mark.parametrize(
    "host", ["192.0.2.1", "10.0.0.1", "example.com", "", "0.0.0.0", "2130706433", "::1%nowhere", "fe80::1%9", "1.2.3"]
)
@pytest.mark.simulated_time
@platforms.needs_linux
def test_other_hosts_are_refused_without_a_socket(host: str, sockets: ProgramSockets, listener: socket.socket) -> None:
    before = descriptors()
    sockets.open("s", host, port(listener))
    assert sockets.state("s") in ("failed", "closed")
    assert descriptors() == before


@pytest.mark.parametrize("number", [0, -1, 65536])
def test_invalid_port_is_refused(number: int, sockets: ProgramSockets) -> None:
    sockets.open("s", "127.0.0.1", number)
    assert sockets.state("s") == "closed"


@pytest.mark.simulated_time
def test_other_hosts_are_tried_when_the_route_allows_them() -> None:
    asked: list[str] = []

    def route(address: str, port: int) -> Target:
        asked.append(address)
        return Target(address, port)

    sockets = ProgramSockets(route)
    # The address is reserved for documentation: no host has it, and the attempt to connect only starts.
    sockets.open("s", "192.0.2.1", 9)
    assert asked == ["192.0.2.1"]
    assert sockets.state("s") in ("connecting", "failed")
    sockets.close_all()


@pytest.mark.real_time
@platforms.needs_linux
def test_reopening_a_name_closes_its_previous_socket(sockets: ProgramSockets, listener: socket.socket) -> None:
    before = descriptors()
    with opened(sockets, listener) as first, opened(sockets, listener) as second:
        assert first.recv(10) == b""
        assert sockets.send("s", b"2")
        assert second.recv(10) == b"2"
        sockets.open("s", "192.0.2.1", 1)
        assert sockets.state("s") == "closed"
        assert second.recv(10) == b""
    assert descriptors() == before


@pytest.mark.simulated_time
def test_number_of_sockets_is_limited(sockets: ProgramSockets, listener: socket.socket) -> None:
    peers = [opened(sockets, listener, f"s{n}") for n in range(MOST)]
    sockets.open("more", "127.0.0.1", port(listener))
    assert sockets.state("more") == "closed"
    sockets.close("s0")
    peers.append(opened(sockets, listener, "more"))
    for peer in peers:
        peer.close()


@pytest.mark.real_time
def test_peer_has_to_wait_when_the_program_never_reads(sockets: ProgramSockets, listener: socket.socket) -> None:
    with opened(sockets, listener) as peer:
        peer.setblocking(False)

        def is_full() -> bool:
            try:
                peer.send(b"x" * 65536)
            except BlockingIOError:
                return len(sockets.received("s")) == MOST_WAITING
            sockets.received("s")
            return False

        until(is_full)
        assert len(sockets.received("s")) == MOST_WAITING


@pytest.mark.real_time
@platforms.needs_linux
def test_close_all_leaves_no_descriptors_open(listener: socket.socket) -> None:
    before = descriptors()
    sockets = ProgramSockets(refuse_all)
    with opened(sockets, listener, "a"), opened(sockets, listener, "b"):
        sockets.open("c", "127.0.0.1", port(listener))
        sockets.close_all()
        sockets.close_all()
        listener.accept()[0].close()
    assert descriptors() == before


@pytest.mark.simulated_time
def test_reachable_addresses_are_allowed() -> None:
    with Controller("UR5e", "5.11", reachable=["192.0.2.7", "2001:DB8::1"]) as controller:

        def allows(host: str) -> bool:
            answers: list[bool] = []
            controller.call(lambda: answers.append(controller._route(host, 9) == Target(host, 9)))
            return answers[0]

        assert allows("192.0.2.7")
        assert allows("2001:db8::1")
        assert not allows("192.0.2.8")


@pytest.mark.simulated_time
def test_addresses_of_connected_clients_are_allowed(monkeypatch: pytest.MonkeyPatch) -> None:
    with Controller("UR5e", "5.11") as controller:
        assert controller._server is not None
        assert controller._route("192.0.2.8", 9) is None
        monkeypatch.setattr(type(controller._server), "peers", {"192.0.2.8"})
        assert controller._route("192.0.2.8", 9) == Target("192.0.2.8", 9)


def test_reachable_addresses_must_be_numeric() -> None:
    with pytest.raises(BadValue, match="numeric"):
        Controller("UR5e", reachable=["example.com"])


@pytest.mark.real_time
def test_servo_and_follow_work_on_two_loopback_addresses() -> None:
    hosts = ("127.0.0.2", "127.0.0.3")
    with contextlib.ExitStack() as stack:
        for host in hosts:
            try:
                stack.enter_context(socket.create_server((host, 0))).close()
            except OSError:
                pytest.skip(platforms.MACHINE)
        made = [stack.enter_context(Controller("UR5e", "5.11", host=host, motion=Still())) for host in hosts]
        for controller in made:
            robot = stack.enter_context(urlink.connect(controller.address, stale_after=10, silence=20))
            q = robot.realtime.wait().q_actual.tolist()
            with robot.motion.servo(watchdog=5.0) as servo:
                servo.send([q[0] + 0.001, *q[1:]])
            there = Trajectory([TrajectoryPoint(q, 0.0), TrajectoryPoint([q[0] + 0.05, *q[1:]], 1.0)])
            robot.motion.follow(there, watchdog=5.0, start_tolerance=0.1, wait=60)
            assert robot.realtime.wait().q_actual[0] == pytest.approx(q[0] + 0.05, abs=0.01)

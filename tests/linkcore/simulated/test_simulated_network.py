"""Connections between simulated computers, with faults of the network and of the computers."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import select
import selectors
import socket
import struct
import sys
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from linkcore.deferred import Deferred
from linkcore.errors import ConnectFailed, ConnectionLost, LinkTimeout
from linkcore.net.transport import TcpTransport
from linkcore.simulated import Computer, Simulation, simulated_time
from linkcore.simulated.network import ReceiveBuffer
from tests import platforms

if sys.platform != "win32":
    import fcntl
    import termios

posix = platforms.needs_linux

PORT = 30001
RESET = struct.pack("ii", 1, 0)


@pytest.fixture
def sim() -> Iterator[Simulation]:
    with simulated_time(1, latency=0.001, jitter=0.0, limit=1000.0) as simulation:
        yield simulation


@pytest.fixture
def robot(sim: Simulation) -> Computer:
    return sim.computer("robot", "192.168.0.2")


def serve(sim: Simulation, computer: Computer, talk: Callable[[socket.socket], object]) -> threading.Thread:
    """Start a server on a computer that serves one client."""
    with sim.on(computer):
        listener = socket.socket()
        listener.bind(("", PORT))
        listener.listen()

        def run() -> None:
            with listener, listener.accept()[0] as link:
                talk(link)

        thread = threading.Thread(target=run)
        thread.start()
    return thread


def unacknowledged(link: socket.socket) -> int:
    (count,) = struct.unpack("i", fcntl.ioctl(link, termios.TIOCOUTQ, bytes(4)))
    return int(count)


def echo(link: socket.socket) -> None:
    while data := link.recv(4096):
        link.sendall(data)


def test_simulated_connection_sends_and_receives(sim: Simulation, robot: Computer) -> None:
    serve(sim, robot, echo)
    with socket.create_connection(("robot", PORT), timeout=1.0) as link:
        assert link.getpeername() == ("192.168.0.2", PORT)
        assert link.getsockname()[0] == "192.168.0.1"
        begun = sim.now
        link.sendall(b"hello")
        assert link.recv(100) == b"hello"
        assert sim.now - begun == pytest.approx(0.002, abs=1e-4)
        link.shutdown(socket.SHUT_WR)
        assert link.recv(100) == b""


def test_socket_has_no_peer_before_the_handshake_ends(sim: Simulation, robot: Computer) -> None:
    """Otherwise a program that polls would consider the socket open, and then the failed receive as its end."""
    serve(sim, robot, echo)
    with socket.socket() as link:
        link.setblocking(False)
        begun = sim.now
        assert link.connect_ex((robot.address, PORT)) == errno.EINPROGRESS
        for seconds in (0.0005, 0.001):
            time.sleep(seconds)
            with pytest.raises(OSError, match="not connected"):
                link.getpeername()
        assert 0.001 < sim.now - begun < 0.002
        time.sleep(0.001)
        assert link.getpeername() == (robot.address, PORT)


def test_connect_fails_without_listener_host_or_power(sim: Simulation, robot: Computer) -> None:
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection((robot.address, PORT), timeout=1.0)
    with pytest.raises(socket.gaierror):
        socket.create_connection(("nowhere", PORT))
    robot.power_off()
    with pytest.raises(TimeoutError):
        socket.create_connection((robot.address, PORT), timeout=5.0)
    assert sim.now == pytest.approx(5.0, abs=0.1)
    transport = TcpTransport("robot", PORT, silence=1.0)
    robot.power_on()
    with pytest.raises(ConnectFailed, match="refused"):
        transport.open(1.0)
    assert sim.open_sockets == 0


def test_data_is_delivered_after_a_network_cut(sim: Simulation, robot: Computer) -> None:
    """As with TCP, data of a connection that was not reset is delivered when the network works again."""
    came: list[tuple[float, bytes]] = []

    def take(link: socket.socket) -> None:
        while data := link.recv(4096):
            came.append((sim.now, data))

    thread = serve(sim, robot, take)
    link = socket.create_connection(("robot", PORT))
    link.sendall(b"before")
    time.sleep(0.1)
    sim.network.cut(sim.here, robot)
    link.sendall(b"meanwhile")
    time.sleep(3.0)
    assert [data for _, data in came] == [b"before"]
    sim.network.mend(sim.here, robot)
    link.close()
    thread.join(60.0)
    assert [data for _, data in came] == [b"before", b"meanwhile"]
    assert came[1][0] > 3.1


def test_aborted_data_is_not_delivered_after_a_cut(sim: Simulation, robot: Computer) -> None:
    came: list[bytes] = []

    def take(link: socket.socket) -> None:
        came.append(link.recv(4096))

    serve(sim, robot, take)
    transport = TcpTransport("robot", PORT, silence=1.0)
    transport.open(1.0)
    sim.network.cut(sim.here, robot)
    transport.send(b"move", 1.0)
    time.sleep(0.5)
    transport.abort()
    time.sleep(0.5)
    sim.network.mend(sim.here, robot)
    time.sleep(100.0)
    # The reset was lost too, so the connection stays half open at the other end.
    assert came == []
    assert len(robot.ends) == 1


@platforms.needs_linux
def test_unacknowledged_data_ends_connection_after_user_timeout(sim: Simulation, robot: Computer) -> None:
    """The data arrives, but its acknowledgement does not."""
    came: list[bytes] = []

    def take(link: socket.socket) -> None:
        came.append(link.recv(4096))
        time.sleep(10.0)

    serve(sim, robot, take)
    transport = TcpTransport("robot", PORT, silence=0.5)
    transport.open(1.0)
    sim.network.route(robot, sim.here).is_silent = True
    transport.send(b"heard", 1.0)
    begun = sim.now
    with pytest.raises(LinkTimeout):
        transport.receive(0.4)
    with pytest.raises(ConnectionLost, match="no longer acknowledges"):
        transport.receive(0.4)
    assert sim.now - begun == pytest.approx(0.5, abs=0.01)
    assert came == [b"heard"]


def test_receive_timeout_of_the_kernel_is_simulated(sim: Simulation, robot: Computer) -> None:
    serve(sim, robot, echo)
    transport = TcpTransport("robot", PORT, silence=2.0)
    transport.open(1.0)
    begun = sim.now
    with pytest.raises(LinkTimeout):
        transport.receive()
    assert sim.now - begun == pytest.approx(2.0, abs=1e-3)
    transport.send(b"x", 1.0)
    assert transport.receive()[0] == b"x"
    transport.close()
    assert sim.now - begun < 2.1  # all sent data is acknowledged, so close does not wait


def test_close_waits_for_unacknowledged_data(sim: Simulation, robot: Computer) -> None:
    came: list[bytes] = []
    serve(sim, robot, lambda link: came.append(link.recv(100)))
    transport = TcpTransport("robot", PORT, silence=2.0)
    transport.open(1.0)
    transport.send(b"last", 1.0)
    transport.close()
    time.sleep(1.0)
    assert came == [b"last"]


def test_abort_ends_a_waiting_receive(sim: Simulation, robot: Computer) -> None:
    serve(sim, robot, echo)
    transport = TcpTransport("robot", PORT, silence=100.0)
    transport.open(1.0)
    sim.at(5.0, lambda: None)
    threading.Timer(3.0, transport.abort).start()
    with pytest.raises(ConnectionLost, match="closed by this program"):
        transport.receive()
    assert sim.now == pytest.approx(3.0, abs=0.01)


def test_killed_computer_resets_its_connections(sim: Simulation, robot: Computer) -> None:
    def hold(link: socket.socket) -> None:
        link.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESET)
        time.sleep(1000.0)

    serve(sim, robot, hold)
    with socket.create_connection(("robot", PORT), timeout=10.0) as link:
        sim.at(1.0, robot.kill)
        with pytest.raises(ConnectionResetError):
            link.recv(1)
        assert sim.now == pytest.approx(1.001, abs=1e-3)
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("robot", PORT), timeout=1.0)


def test_rebooted_computer_resets_old_connections(sim: Simulation, robot: Computer) -> None:
    serve(sim, robot, echo)
    with socket.create_connection(("robot", PORT), timeout=60.0) as link:
        robot.power_off()
        link.sendall(b"x")
        time.sleep(10.0)
        robot.power_on()
        with pytest.raises(ConnectionResetError):
            link.recv(1)


def test_suspended_computer_accepts_data_until_buffers_are_full(sim: Simulation, robot: Computer) -> None:
    """The kernel still accepts data until its buffers are full."""
    serve(sim, robot, echo)
    with socket.create_connection(("robot", PORT), timeout=1.0) as link:
        robot.suspend()
        sent = 0
        with contextlib.suppress(TimeoutError):
            while sent < 1_000_000:
                sent += link.send(bytes(10_000))
        assert 200_000 < sent < 400_000
        robot.resume()
        came = 0
        while came < sent:
            came += len(link.recv(65536))


def is_reset(link: socket.socket) -> None:
    with pytest.raises(ConnectionResetError):
        link.recv(1)


def test_network_reset_raises_on_both_sides(sim: Simulation, robot: Computer) -> None:
    serve(sim, robot, is_reset)
    with socket.create_connection(("robot", PORT), timeout=60.0) as link:
        sim.network.reset(sim.here, robot)
        with pytest.raises(ConnectionResetError):
            link.recv(1)


@pytest.mark.parametrize("way", ["there", "back"])
@pytest.mark.parametrize("is_asked_here", [True, False])
def test_network_reset_during_a_handshake_refuses_the_connection(
    sim: Simulation, robot: Computer, way: str, is_asked_here: bool
) -> None:
    """The reset comes while either the connection request or its answer is in transit."""
    server, client = (robot, sim.here) if is_asked_here else (sim.here, robot)
    with sim.on(server), socket.socket() as listener:
        listener.bind(("", PORT))
        listener.listen()
        sim.at(0.0005 if way == "there" else 0.0015, lambda: sim.network.reset(sim.here, robot))
        with sim.on(client):
            with pytest.raises(ConnectionRefusedError):
                socket.create_connection((server.address, PORT), timeout=60.0)
            assert sim.now < 0.002
            with socket.create_connection((server.address, PORT), timeout=60.0):  # the next attempt succeeds
                pass


@posix
def test_poll_select_and_selectors_are_simulated(sim: Simulation, robot: Computer) -> None:
    serve(sim, robot, echo)
    with socket.create_connection(("robot", PORT)) as link:
        poll = select.poll()
        poll.register(link, select.POLLIN)
        assert poll.poll(100) == []
        assert sim.now == pytest.approx(0.102, abs=1e-3)
        assert select.select([link], [link], [], 1.0) == ([], [link], [])
        link.sendall(b"x")
        assert poll.poll(1000) == [(link.fileno(), select.POLLIN)]
        with selectors.DefaultSelector() as selector:
            selector.register(link, selectors.EVENT_READ, "data")
            ((key, mask),) = selector.select(1.0)
            assert (key.data, mask) == ("data", selectors.EVENT_READ)
            link.recv(1)
            begun = sim.now
            assert selector.select(0.5) == []
            assert sim.now - begun == pytest.approx(0.5, abs=1e-3)


def test_selector_reports_data_until_it_is_read(sim: Simulation, robot: Computer) -> None:
    with contextlib.ExitStack() as links, selectors.DefaultSelector() as selector:
        pairs = [socket.socketpair() for _ in range(3)]
        for number, (here, there) in enumerate(pairs):
            links.enter_context(here)
            links.enter_context(there)
            selector.register(here, selectors.EVENT_READ, number)

        def ready(timeout: float = 0.1) -> list[int]:
            return [key.data for key, _ in selector.select(timeout)]

        assert ready() == []
        pairs[1][1].send(b"ab")
        pairs[0][1].send(b"c")
        time.sleep(0.01)
        assert sorted(ready()) == sorted(ready()) == [0, 1]
        assert select.select([selector.fileno()], [], [], 1.0)[0] == [selector.fileno()]
        pairs[0][0].recv(1)
        pairs[1][0].recv(1)
        assert ready() == [1]
        selector.modify(pairs[2][0], selectors.EVENT_WRITE, 2)
        assert sorted(ready()) == [1, 2]
        selector.modify(pairs[2][0], selectors.EVENT_READ, 2)
        # As with epoll, a closed socket is no longer reported, but can still be unregistered.
        pairs[1][0].close()
        assert ready() == []
        selector.unregister(pairs[1][0])
        pairs[2][1].close()
        assert ready() == [2]
        with pytest.raises(OSError, match="Bad file descriptor"):
            selector.register(9999, selectors.EVENT_READ)
    assert sim.open_sockets == 0


@pytest.mark.parametrize(
    ("fault", "end", "returned"), [("hold", "release", [b"a", b"bc"]), ("suspend", "resume", [b"abc"])]
)
@posix
def test_kernel_acknowledges_while_threads_are_stopped(
    sim: Simulation, robot: Computer, fault: str, end: str, returned: list[bytes]
) -> None:
    """Its kernel still acknowledges data. With a held interpreter lock, a waiting `recv` gets the first data only."""
    came: list[bytes] = []
    ticks: list[float] = []

    def take(link: socket.socket) -> None:
        while data := link.recv(4096):
            came.append(data)
            ticks.append(sim.now)

    thread = serve(sim, robot, take)
    with socket.create_connection(("robot", PORT)) as link:
        begun = sim.now
        time.sleep(0.1)
        sim.schedule(f"{fault}=robot@{begun + 0.2:.3f}", f"{end}=robot@{begun + 1.0:.3f}")
        time.sleep(0.2)
        for byte in (b"a", b"b", b"c"):
            link.send(byte)
            time.sleep(0.1)
        assert came == []
        assert unacknowledged(link) == 0
        time.sleep(1.0)
        assert came == returned
        assert ticks[0] == pytest.approx(begun + 1.0, abs=1e-3)
        link.send(b"d")
    thread.join()
    assert came == [*returned, b"d"]


def test_timeout_expires_while_the_interpreter_lock_is_held(sim: Simulation, robot: Computer) -> None:
    outcome: list[str] = []

    def take(link: socket.socket) -> None:
        link.settimeout(0.5)
        with contextlib.suppress(TimeoutError):
            outcome.append(link.recv(10).decode())
        outcome.append(f"late at {sim.now:.2f}")
        outcome.append(link.recv(10).decode())

    thread = serve(sim, robot, take)
    with socket.create_connection(("robot", PORT)) as link:
        sim.at(sim.now + 0.1, robot.hold)
        sim.at(sim.now + 2.0, robot.release)
        time.sleep(1.0)
        link.send(b"after")
        thread.join()
    assert outcome == ["late at 2.00", "after"]


def test_asyncio_streams_work_in_simulated_time(sim: Simulation, robot: Computer) -> None:
    serve(sim, robot, echo)

    async def talk() -> bytes:
        reader, writer = await asyncio.open_connection("robot", PORT)
        writer.write(b"hello\n")
        line = await reader.readline()
        writer.close()
        await writer.wait_closed()
        return line

    assert asyncio.run(talk()) == b"hello\n"


@pytest.mark.property
@given(
    seed=st.integers(0, 2**32),
    faults=st.lists(
        st.tuples(st.sampled_from(["cut", "mend", "deaf", "suspend", "resume"]), st.floats(0.0, 5.0)), max_size=8
    ),
    sizes=st.lists(st.integers(1, 60_000), min_size=1, max_size=12),
)
def test_received_bytes_are_a_prefix_of_sent_bytes(
    seed: int, faults: list[tuple[str, float]], sizes: list[int]
) -> None:
    """All sent bytes arrive once the network works again, if neither side has aborted the connection."""
    sent = b"".join(bytes([number % 256]) * size for number, size in enumerate(sizes))
    came = bytearray()

    def take(link: socket.socket) -> None:
        while data := link.recv(7000):
            came.extend(data)

    with simulated_time(seed, limit=10_000) as sim:
        robot = sim.computer("robot", "192.168.0.2")
        actions: dict[str, Callable[[], object]] = {
            "cut": lambda: sim.network.cut(sim.here, robot),
            "mend": lambda: sim.network.mend(sim.here, robot),
            "deaf": lambda: setattr(sim.network.route(robot, sim.here), "is_silent", True),
            "suspend": robot.suspend,
            "resume": lambda: None if robot.is_running else robot.resume(),
        }
        thread = serve(sim, robot, take)
        link = socket.create_connection(("robot", PORT))
        for name, when in faults:
            sim.at(sim.now + when, actions[name])
        sim.at(sim.now + 10.0, actions["mend"])
        sim.at(sim.now + 10.0, actions["resume"])
        for size, start in zip(sizes, [sum(sizes[:n]) for n in range(len(sizes))], strict=True):
            link.sendall(sent[start : start + size])
            time.sleep(0.1)
        link.shutdown(socket.SHUT_WR)
        thread.join(1000.0)
        assert bytes(came) == sent
        link.close()


def test_event_loop_of_powered_off_computer_ends_with_simulation() -> None:
    ended: list[BaseException] = []

    async def waits_again() -> None:
        try:
            await asyncio.sleep(100.0)
        finally:
            await asyncio.sleep(1.0)

    def program() -> None:
        try:
            asyncio.run(waits_again())
        except BaseException as error:
            ended.append(error)

    with simulated_time(1) as sim:
        robot = sim.computer("robot", "192.168.0.2")
        with sim.on(robot):
            threading.Thread(target=program, daemon=True).start()
        time.sleep(1.0)
        robot.power_off()
    assert [type(error).__name__ for error in ended] == ["Ended"]


class Late(Deferred):
    """Data whose bytes are made when they are read, and counted."""

    made = 0

    def __init__(self, data: bytes) -> None:
        super().__init__(data[:1])
        self._data = data

    def __len__(self) -> int:
        return len(self._data)

    def __bytes__(self) -> bytes:
        self.made += 1
        return self._data


@pytest.mark.property
@given(
    st.lists(st.tuples(st.binary(min_size=1, max_size=9), st.booleans())),
    st.lists(st.tuples(st.integers(1, 12), st.booleans())),
)
def test_receive_buffer_returns_the_bytes_in_order(
    chunks: list[tuple[bytes, bool]], sizes: list[tuple[int, bool]]
) -> None:
    buffer, expected = ReceiveBuffer(), b"".join(data for data, _ in chunks)
    for data, is_late in chunks:
        buffer.put(Late(data) if is_late else data)
    for size, is_whole in sizes:
        assert len(buffer) == len(expected)
        if not expected:
            break
        assert buffer.peek(size) == expected[:size]
        taken = bytes(buffer.take_deferred(size) if is_whole else buffer.take(size))
        assert taken == expected[: len(taken)]
        assert 0 < len(taken) <= size
        expected = expected[len(taken) :]


def test_receive_buffer_makes_no_bytes_of_a_single_packet() -> None:
    buffer, packet = ReceiveBuffer(), Late(b"abc")
    buffer.put(packet)
    assert buffer.take_deferred(65536) is packet
    assert (packet.made, len(buffer)) == (0, 0)


def passed_on(sim: Simulation, robot: Computer, before: Callable[[socket.socket], object] = lambda link: None) -> Any:
    """Send a packet from a robot by `End.pass_on`; return the result, the received bytes and the time it took."""
    found: list[Any] = []

    def talk(link: Any) -> None:
        def pass_on() -> None:
            begun = sim.now
            found.extend((link._end.pass_on(Late(b"packet")), sim.now - begun))

        time.sleep(0.5)
        before(link)
        sim.at(0.8, pass_on)
        time.sleep(2.0)

    thread = serve(sim, robot, talk)
    with socket.create_connection(("robot", PORT), timeout=1.0) as link:
        link.settimeout(3.0)
        data = b"".join(iter(partial(link.recv, 100), b""))
    thread.join()
    return found[0], data, found[1]


def test_packet_is_passed_on_while_nothing_else_happens(sim: Simulation, robot: Computer) -> None:
    is_sent, data, seconds = passed_on(sim, robot)
    assert (is_sent, data) == (True, b"packet")
    assert seconds == pytest.approx(0.001, abs=1e-4)


@pytest.mark.parametrize("reason", ["something is due", "unacknowledged", "silent", "suspended", "closing"])
def test_packet_is_not_passed_on_while_something_can_happen(sim: Simulation, robot: Computer, reason: str) -> None:
    def disturb(link: socket.socket) -> None:
        if reason == "something is due":
            sim.at(0.8005, lambda: None)
        elif reason == "unacknowledged":
            sim.at(0.79, lambda: sim.network.silence(robot, sim.here))
            sim.at(0.795, lambda: link.send(b"first"))
            sim.at(0.9, lambda: sim.network.mend(robot, sim.here))
        elif reason == "silent":
            sim.at(0.79, lambda: sim.network.silence(robot, sim.here))
            sim.at(0.9, lambda: sim.network.mend(robot, sim.here))
        elif reason == "suspended":
            sim.at(0.79, sim.here.suspend)
            sim.at(0.9, sim.here.resume)
        else:
            sim.at(0.79, lambda: link.shutdown(socket.SHUT_WR))

    is_sent, data, seconds = passed_on(sim, robot, disturb)
    assert (is_sent, seconds) == (False, 0.0)
    assert data == (b"first" if reason == "unacknowledged" else b"")

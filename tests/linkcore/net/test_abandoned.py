"""Abandoned data does not arrive later, but data sent before an orderly close arrives.

The peers in this module have a small receive buffer and do not read. So sent data stays in the kernel of this side, as
it does when the network is down, but the tests need no network for that.
"""

from __future__ import annotations

import os
import select
import shutil
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Iterator

import pytest

from linkcore.errors import ConnectionLost, LinkTimeout
from linkcore.net import transport as module
from linkcore.net.transport import TcpTransport
from tests import platforms
from tests.waiting import until
from tests.witnesses import sockets_made

pytestmark = pytest.mark.real_time

#: Time limit for events that must happen at once, in seconds.
TIMEOUT = 10.0
BLOCK = b"movej" * 1000


@pytest.fixture
def listener() -> Iterator[socket.socket]:
    with socket.socket() as listener:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)  # connections inherit it
        listener.bind(("127.0.0.1", 0))
        listener.listen()
        listener.settimeout(TIMEOUT)
        yield listener


@pytest.fixture
def peer(listener: socket.socket, transport: TcpTransport) -> Iterator[socket.socket]:
    connection, _ = listener.accept()
    connection.settimeout(TIMEOUT)
    with connection:
        yield connection


@pytest.fixture
def transport(listener: socket.socket) -> Iterator[TcpTransport]:
    transport = TcpTransport("127.0.0.1", listener.getsockname()[1], silence=TIMEOUT)
    transport.open(TIMEOUT)
    yield transport
    transport.abort()


def fill(transport: TcpTransport) -> int:
    """Send until the kernel accepts no more; return the number of accepted bytes."""
    taken = 0
    while (sent := transport.send_some(BLOCK)) or transport.wait_for_room(0.05):
        taken += sent
    return taken


def drained(connection: socket.socket) -> tuple[int, bool]:
    """Read to the end of the connection; return the number of bytes, and whether the end was orderly."""
    total = 0
    try:
        while data := connection.recv(1 << 16):
            total += len(data)
    except ConnectionResetError:
        return total, False
    return total, not platforms.was_reset(connection)


def test_abort_discards_data_in_the_kernel(transport: TcpTransport, peer: socket.socket) -> None:
    taken = fill(transport)
    transport.abort()
    arrived, in_order = drained(peer)
    assert arrived < taken
    assert not in_order


def test_abort_takes_effect_while_another_thread_sends(transport: TcpTransport, peer: socket.socket) -> None:
    errors: list[Exception] = []
    taken = fill(transport)

    def send() -> None:
        try:
            transport.send(BLOCK * 10_000, TIMEOUT)
        except ConnectionLost as error:
            errors.append(error)

    waiting = threading.Thread(target=send)
    waiting.start()
    time.sleep(0.05)  # most likely in poll by then; the outcome is the same if not
    began = time.monotonic()
    transport.abort()
    waiting.join(TIMEOUT)
    assert time.monotonic() - began < TIMEOUT / 2
    assert errors
    assert drained(peer)[0] < taken


def test_abort_takes_effect_while_another_thread_receives(transport: TcpTransport, peer: socket.socket) -> None:
    errors: list[Exception] = []

    def receive() -> None:
        try:
            transport.receive()
        except ConnectionLost as error:
            errors.append(error)

    waiting = threading.Thread(target=receive)
    waiting.start()
    taken = fill(transport)
    transport.abort()
    waiting.join(TIMEOUT)
    assert errors
    assert drained(peer)[0] < taken


def test_close_delivers_sent_data(transport: TcpTransport, peer: socket.socket) -> None:
    taken = fill(transport)
    closing = threading.Thread(target=transport.close, args=(TIMEOUT,))
    closing.start()
    assert drained(peer) == (taken, True)
    closing.join(TIMEOUT)
    assert not closing.is_alive()


@platforms.needs_acknowledgements
def test_close_stops_waiting_after_its_timeout(transport: TcpTransport, peer: socket.socket) -> None:
    taken = fill(transport)
    began = time.monotonic()
    transport.close(0.1)
    assert 0.1 <= time.monotonic() - began < TIMEOUT / 2
    arrived, in_order = drained(peer)
    assert arrived < taken
    assert not in_order


def test_close_is_quick_when_all_data_is_delivered(transport: TcpTransport, peer: socket.socket) -> None:
    transport.send(b"set_digital_out(0, True)\n", TIMEOUT)
    began = time.monotonic()
    transport.close(TIMEOUT)
    assert time.monotonic() - began < TIMEOUT / 2
    assert drained(peer) == (25, True)


@platforms.needs_acknowledgements
def test_abort_ends_a_waiting_close(transport: TcpTransport, peer: socket.socket) -> None:
    taken = fill(transport)
    closing = threading.Thread(target=transport.close, args=(TIMEOUT,))
    closing.start()
    time.sleep(0.02)  # most likely waiting by then; the outcome is the same if not
    transport.abort()
    closing.join(TIMEOUT / 2)
    assert not closing.is_alive()
    assert drained(peer)[0] < taken


def test_send_raises_after_close_has_begun(transport: TcpTransport, peer: socket.socket) -> None:
    fill(transport)
    closing = threading.Thread(target=transport.close, args=(TIMEOUT,))
    closing.start()

    def is_refused() -> bool:
        try:
            transport.send_some(b"movej")
        except ConnectionLost:
            return True
        return False

    until(is_refused)
    transport.abort()
    closing.join(TIMEOUT)


@platforms.needs_linux
def test_killed_process_sends_no_more_data(listener: socket.socket) -> None:
    source = (
        "import sys, time\n"
        "from linkcore.net.transport import TcpTransport\n"
        "transport = TcpTransport('127.0.0.1', int(sys.argv[1]), silence=60)\n"
        "transport.open(10)\n"
        "taken = 0\n"
        "while (sent := transport.send_some(b'movej' * 1000)) or transport.wait_for_room(0.05):\n"
        "    taken += sent\n"
        "print(taken, flush=True)\n"
        "time.sleep(60)\n"
    )
    command = [sys.executable, "-c", source, str(listener.getsockname()[1])]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        connection, _ = listener.accept()
        with connection:
            connection.settimeout(TIMEOUT)
            assert process.stdout is not None
            taken = int(process.stdout.readline())
            process.kill()
            process.wait(TIMEOUT)
            assert drained(connection)[0] < taken


@platforms.needs_linux
def test_kernel_discards_unacknowledged_data_after_silence(listener: socket.socket) -> None:
    """The kernel must do so while this process is suspended, so the test calls neither `abort` nor `close`."""
    transport = TcpTransport("127.0.0.1", listener.getsockname()[1], silence=0.3)
    transport.open(TIMEOUT)
    connection, _ = listener.accept()
    with connection:
        taken = fill(transport)
        with pytest.raises(ConnectionLost, match="no longer acknowledges"):
            transport.receive(TIMEOUT)
        connection.settimeout(TIMEOUT)
        assert drained(connection)[0] < taken
    transport.abort()


@platforms.needs_fork
def test_forked_child_cannot_end_the_connection(listener: socket.socket) -> None:
    """The fork happens in a separate process with one thread, because forking a process with more is unsafe."""
    source = (
        "import os, sys\n"
        "from linkcore.net.transport import TcpTransport\n"
        "from linkcore.errors import LocalError\n"
        "transport = TcpTransport('127.0.0.1', int(sys.argv[1]), silence=60)\n"
        "transport.open(10)\n"
        "child = os.fork()\n"
        "if child == 0:\n"
        "    try:\n"
        "        transport.receive(0)\n"
        "    except LocalError:\n"
        "        transport.close()\n"
        "        transport.abort()\n"
        "        os._exit(0)\n"
        "    os._exit(1)\n"
        "_, status = os.waitpid(child, 0)\n"
        "transport.send(b'%d' % status, 10)\n"
        "print(transport.receive(10)[0].decode())\n"
        "transport.close()\n"
    )
    command = [sys.executable, "-c", source, str(listener.getsockname()[1])]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        connection, _ = listener.accept()
        with connection:
            connection.settimeout(TIMEOUT)
            assert connection.recv(10) == b"0", "the forked child must get LocalError from receive()"
            connection.sendall(b"still here")
            assert process.communicate(timeout=TIMEOUT)[0] == "still here\n"


# -- loss of the network ---------------------------------------------------------------------------------

_CUT = """
import socket, subprocess, sys, time
from linkcore.net.transport import TcpTransport

def loopback(state):
    subprocess.run(["ip", "link", "set", "lo", state], check=True)

loopback("up")
with socket.create_server(("127.0.0.1", 0)) as server:
    transport = TcpTransport("127.0.0.1", server.getsockname()[1], silence=60)
    transport.open(10)
    peer, _ = server.accept()
    peer.settimeout(float(sys.argv[2]))
    loopback("down")
    transport.send(b"movej", 1)
    if sys.argv[1] != "keep":
        getattr(transport, sys.argv[1])()
    time.sleep(0.3)
    loopback("up")
    try:
        print("arrived:", peer.recv(10))
    except OSError as error:
        print("nothing:", type(error).__name__)
"""


def cut(doing: str, seconds: float) -> str:
    """Cut the network, send, call the method `doing` (or "keep"), and restore the network.

    Returns:
        Report of the data that arrives within `seconds`.
    """
    if sys.platform != "linux" or shutil.which("unshare") is None or shutil.which("ip") is None:
        pytest.skip(platforms.NETWORKS)
    alone = ["unshare", "--net"] if os.geteuid() == 0 else ["unshare", "--net", "--map-root-user"]
    if subprocess.run([*alone, "true"], capture_output=True, check=False).returncode:
        pytest.skip(platforms.NETWORKS)
    command = [*alone, sys.executable, "-c", _CUT, doing, str(seconds)]
    return subprocess.run(command, capture_output=True, text=True, timeout=30, check=True).stdout.strip()


@pytest.mark.slow
@pytest.mark.parametrize("doing", ["abort", "close"])
def test_abandoned_data_is_lost_when_the_network_returns(doing: str) -> None:
    # Linux sends again after 0.2, 0.6 and 1.4 s, so data that is not abandoned arrives in that time (see below).
    assert cut(doing, 2.0).startswith("nothing")


@pytest.mark.slow
def test_kept_data_arrives_when_the_network_returns() -> None:
    """Control for the test above: it would detect the data."""
    assert cut("keep", 10.0) == "arrived: b'movej'"


# -- options of the socket -----------------------------------------------------------------------------


def test_timeval_supports_32_and_64_bit_times() -> None:
    """A timeval has two words of 4 bytes, or of 8 bytes if time_t has 64 bits (even on 32-bit systems)."""
    little = sys.byteorder == "little"
    assert module._timeval(2.5, 8).hex() == ("0200000020a10700" if little else "000000020007a120")
    assert module._timeval(2.5, 16).hex() == (
        "020000000000000020a1070000000000" if little else "0000000000000002000000000007a120"
    )


def test_timeval_of_zero_is_not_an_endless_timeout(transport: TcpTransport, peer: socket.socket) -> None:
    assert module._timeval(0.0, 16) != bytes(16)


def test_socket_options_discard_data_and_limit_retries(transport: TcpTransport, peer: socket.socket) -> None:
    with sockets_made() as made:
        transport.open(TIMEOUT)
    (connection,) = made
    linger = struct.Struct("hh" if sys.platform == "win32" else "ii")
    assert connection.getsockopt(socket.SOL_SOCKET, socket.SO_LINGER, linger.size) == linger.pack(1, 0)
    if hasattr(socket, "TCP_USER_TIMEOUT"):
        assert connection.getsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT) == TIMEOUT * 1000


def test_half_closed_peer_ends_a_waiting_send(transport: TcpTransport, peer: socket.socket) -> None:
    """The peer has closed its sending side and does not read; `receive` would report a closed connection."""
    fill(transport)
    peer.shutdown(socket.SHUT_WR)
    assert select.select([transport], [], [], TIMEOUT)[0]
    # Only Linux wakes a waiting send; elsewhere it ends with its timeout.
    with pytest.raises(ConnectionLost if platforms.IS_LINUX else LinkTimeout):
        transport.send(BLOCK * 10_000, TIMEOUT if platforms.IS_LINUX else 0.0)

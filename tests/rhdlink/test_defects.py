"""The defects of the original server that section 13 of the protocol notes lists: rhdlink has none of them.

The numbers of the tests are the numbers of that list. Hostile clients attack a host with its own clock, while a witness
client syncs repeatedly. If a single client can stop the host, the witness times out, on any machine.
"""

from __future__ import annotations

import socket
import struct
from collections.abc import Iterator
from contextlib import ExitStack, suppress

import numpy as np
import pytest

from linkcore.errors import BadValue
from rhdlink.host.host import Host
from rhdlink.host.plugin import Plugin
from rhdlink.host.server import MOST_NEW
from rhdlink.variables.database import Database
from rhdlink.variables.declarations import Read, Write
from rhdlink.variables.value_types import Int32
from tests import platforms
from tests.rhdlink.raw_client import RawClient
from tests.waiting import until

pytestmark = pytest.mark.simulated_time


class Robot(Plugin):
    counter = Read(Int32)
    calibration = Read(Int32, 3)
    speed = Write(Int32)
    arm = Write(Int32, 4)

    def __init__(self) -> None:
        self.seen: list[tuple[int, bool]] = []
        self.words = np.zeros(4, np.int32)

    def init(self, config: object) -> None:
        self.calibration = [1, 2, 3]

    def periodic(self, tick: int) -> None:
        self.counter = tick
        if not self.seen or self.seen[-1] != (self.speed, self.is_updated(Robot.speed)):
            self.seen.append((self.speed, self.is_updated(Robot.speed)))
        self.words = self.arm


@pytest.fixture
def robot() -> Robot:
    return Robot()


@pytest.fixture
def host(robot: Robot) -> Iterator[Host]:
    # The period is so short that a hostile client cannot act unnoticed within it: the witness needs fifty periods.
    with Host([robot], period=0.002, port=0, client_timeout=30.0) as host:
        yield host


def witness(host: Host, syncs: int = 50) -> None:
    """Check that another client connects and is answered in later rounds, and that the plugin runs in between."""
    with RawClient(host.port) as client:
        client.greeting()
        last = client.value("tick")
        for _ in range(syncs):
            client.sync()
            tick, counter = client.value("tick"), client.value("counter")
            assert tick > last
            assert counter == tick - 1
            last = tick


def int32(*values: int) -> bytes:
    return struct.pack(f">{len(values)}i", *values)


# id 0 is speed, with one word; id 1 is arm, with four
ENTRY = int32(0, 7, 8, 1234)
HOSTILE_WRITES = {
    "id 100": int32(1, 100, 0, 0, 5),
    "id -1": int32(1, -1, 0, 0, 5),
    "id 10^6": int32(1, 10**6, 0, 0, 5),
    "id 2^31-1": int32(1, 2**31 - 1, 0, 0, 5),
    "id -2^31": int32(1, -(2**31), 0, 0, 5),
    "id is the number of variables": int32(1, 2, 0, 0, 5),
    "a valid entry before a hostile entry": int32(2) + ENTRY + int32(77, 0, 0, 5),
    "count -1": int32(-1),
    "count -2^31": int32(-(2**31)),
    "count 2^31-1": int32(2**31 - 1),
    "count above the number of variables": int32(3) + 3 * ENTRY,
}


@pytest.mark.parametrize("access", [b"aw", b"ar"])
@pytest.mark.parametrize("payload", HOSTILE_WRITES.values(), ids=HOSTILE_WRITES)
def test_1_and_13_hostile_ids_and_counts_close_only_their_link(
    host: Host, robot: Robot, access: bytes, payload: bytes
) -> None:
    with RawClient(host.port, access) as client:
        client.greeting()
        client.send(b"r" + access[1:] + b"dw" + payload + b"ee")
        assert client.is_closed()
    witness(host)
    assert host.stats.bad_clients == 1
    assert [speed for speed, _ in robot.seen] == [0]
    assert host.writers == 0


def test_2_reader_cannot_move_the_robot(host: Host, robot: Robot) -> None:
    with RawClient(host.port) as client:
        client.greeting()
        client.send(b"rrdw" + int32(1) + ENTRY + b"ee")
        client.batch()
        client.sync()
        client.sync()
    assert robot.seen == [(0, False)]
    assert host.stats.refused_writes == 1


def test_2_refused_writer_cannot_move_the_robot(host: Host, robot: Robot) -> None:
    with RawClient(host.port, b"aw") as master, RawClient(host.port, b"aw") as second:
        assert master.greeting().granted == "w"
        assert second.greeting().granted == "r"
        second.send(b"rrdw" + int32(1) + ENTRY + b"ee")
        second.batch()
        master.sync({})
        master.sync({})
        assert robot.seen == [(0, False)]
        # If it still tries to write, its connection is closed; the master stays connected.
        second.send(b"rwee")
        assert second.is_closed()
        master.sync({"speed": 3})
        master.sync({})
        master.sync({})
    assert (3, True) in robot.seen


HALVES = {
    "one byte": b"r",
    "ready without an end": b"rr",
    "a count without entries": b"rrdw" + int32(2),
    "half an entry": b"rrdw" + int32(1, 0, 0),
    "all bytes except the last": b"rrdw" + int32(1) + ENTRY + b"e",
}


@pytest.mark.parametrize("half", HALVES.values(), ids=HALVES)
def test_3_half_a_package_delays_no_client_and_can_be_completed(host: Host, half: bytes) -> None:
    whole = b"rrdw" + int32(2) + ENTRY + int32(1, 0, 0, 1, 2, 3, 4) + b"ee"
    if not whole.startswith(half):
        whole = b"rrdw" + int32(1) + ENTRY + b"ee"
    with RawClient(host.port) as client:
        client.greeting()
        client.send(half)
        witness(host)
        client.send(whole[len(half) :])
        client.batch()


@pytest.mark.parametrize("stray", [b"x", b"\0", b"ree", b"drxx", b"GET / HTTP/1.0\r\n\r\n", b"\xff" * 4096])
def test_3_stray_bytes_end_only_their_own_connection(host: Host, stray: bytes) -> None:
    with RawClient(host.port) as client:
        client.greeting()
        client.send(stray + b"rree")
        assert client.is_closed()
    witness(host)


@pytest.mark.parametrize("said", [b"", b"a"])
def test_4_silence_in_the_handshake_delays_no_client(host: Host, said: bytes) -> None:
    with ExitStack() as stack:
        silent = [stack.enter_context(RawClient(host.port, said)) for _ in range(5)]
        witness(host)
        for client in silent:
            client.send(b"ar"[len(said) :])
            client.greeting()


def test_4_number_of_silent_connections_is_bounded(host: Host) -> None:
    with ExitStack() as stack:
        silent = [stack.enter_context(RawClient(host.port, b"")) for _ in range(MOST_NEW + 1)]
        assert silent[0].is_closed()
        witness(host)
        silent[-1].send(b"ar")
        silent[-1].greeting()


@pytest.mark.parametrize("said", [b"xr", b"ax", b"GET", b"\0\0", b"rree"])
def test_4_invalid_handshake_is_closed_without_a_reply(host: Host, said: bytes) -> None:
    with RawClient(host.port, said) as client, suppress(ConnectionResetError):
        assert client.socket.recv(100) == b""
    witness(host, 3)


def test_5_connecting_client_gets_its_handshake_undisturbed(host: Host) -> None:
    with RawClient(host.port) as steady:
        steady.greeting()
        for _ in range(60):
            with RawClient(host.port) as client:
                handshake = client.greeting()
                assert [row.name for row in handshake.read] == ["tick", "counter", "calibration"]
                assert [row.name for row in handshake.write] == ["speed", "arm"]
                # `batch` rejects a table, or a package that belongs to another client's handshake.
                assert len(steady.sync().data) == 2
                client.sync()


def test_6_host_sends_nothing_unsolicited(host: Host) -> None:
    with RawClient(host.port) as quiet, RawClient(host.port) as other:
        quiet.greeting()
        other.greeting()
        for _ in range(5):
            other.sync()
        # Ticks have passed since the handshake; the reply must contain the current values.
        quiet.sync()
        assert quiet.value("tick") > other.value("tick")
        quiet.socket.setblocking(False)
        with pytest.raises(BlockingIOError):
            quiet.socket.recv(1)


def test_7_refused_writer_is_granted_read_access(host: Host) -> None:
    with RawClient(host.port, b"aw") as master, RawClient(host.port, b"aw") as second:
        assert (master.greeting().granted, second.greeting().granted) == ("w", "r")


def test_8_only_newly_set_variables_are_sent(host: Host) -> None:
    with RawClient(host.port) as client:
        client.greeting()
        client.sync()
        for _ in range(3):
            # The ids are those of tick and counter; calibration was set only once, long ago.
            (_, data) = client.sync().data
            assert data.ids.tolist() == [0, 1]


def test_8_resend_original_sends_all_variables_set_once(robot: Robot) -> None:
    with Host([robot], period=0.002, port=0, resend="original") as host, RawClient(host.port) as client:
        client.greeting()
        for _ in range(3):
            (_, data) = client.sync().data
            assert data.ids.tolist() == [0, 1, 2]


def test_9_silent_master_delays_a_synchronized_host_one_period(robot: Robot) -> None:
    # A tick waits for at most one period: with a thousand periods, the witness would time out.
    with Host([robot], period=0.005, port=0, synchronized=True) as host, RawClient(host.port, b"aw") as master:
        master.greeting()
        witness(host, 20)
        master.sync({"speed": 5})
        witness(host, 5)


def test_10_every_reader_gets_the_write_table(robot: Robot) -> None:
    with ExitStack() as stack:
        host = stack.enter_context(Host([robot], period=0.002, port=0, allwriters=True))
        first, last = (stack.enter_context(RawClient(host.port, b"aw")) for _ in range(2))
        first.greeting()
        last.greeting()
        assert host.writers == 2
        last.close()
        until(lambda: host.writers == 1)
        # The reader gets the slot of the writer that was granted access last.
        reader = stack.enter_context(RawClient(host.port))
        reader.greeting()
        first.sync({"speed": 6})
        assert [data.direction for data in reader.sync().data] == ["w", "r"]
        assert reader.value("speed") == 6


def test_11_index_equal_to_the_length_changes_no_neighbour(robot: Robot) -> None:
    with Host([robot], period=0.002, port=0) as host:
        with pytest.raises(BadValue):
            robot.calibration = [1, 2, 3, 4]
        with pytest.raises(IndexError):
            robot.arm[4]
        witness(host, 1)


@pytest.mark.real_time
@platforms.needs_reusable_ports
def test_12_port_is_reusable_immediately_and_only_local(robot: Robot, own_port: int) -> None:
    with Host([robot], period=0.002, port=own_port):
        client = RawClient(own_port)
        client.greeting()
    # The host closed its connection first, so its end of the connection is still in a waiting state.
    with Host([Robot()], period=0.002, port=own_port) as host:
        assert host.port == own_port
        witness(host, 1)
        # A server that listened on all addresses would also answer at this other address of the machine.
        with pytest.raises(OSError):  # noqa: PT011  (refused, or no such address)
            socket.create_connection(("127.0.0.2", own_port), timeout=1.0)
    client.close()


def test_14_width_of_time_stamps_is_a_setting(robot: Robot) -> None:
    with Host([robot], period=0.002, port=0, width=4) as host, RawClient(host.port, b"aw", width=4) as master:
        assert master.greeting().width == 4
        master.send(b"rwdw" + int32(1, 0, 2_000_000_000, 1, 999_999, 0, 42) + b"ee")
        master.batch()
        until(lambda: (42, True) in robot.seen)
        with RawClient(host.port, width=4) as reader:
            reader.greeting()
            identity = reader.tables.write.find("speed")
            assert identity is not None
            assert reader.tables.write.stamp(identity) == (2_000_000_000 + (1 << 32), 999_999)


def test_14_wrong_width_is_detected(host: Host, robot: Robot) -> None:
    with RawClient(host.port, b"aw") as master:
        master.greeting()
        master.send(
            b"rwdw" + int32(2, 0, 2_000_000_000, 0, 999_999, 0, 42, 1, 2_000_000_000, 0, 0, 0, 1, 2, 3, 4) + b"ee"
        )
        assert master.is_closed()
    assert [speed for speed, _ in robot.seen] == [0]


class Wide(Plugin):
    big = Read(Int32, 4000)
    speed = Write(Int32)

    def __init__(self) -> None:
        self._number = 0

    def periodic(self, tick: int) -> None:
        self.big = [tick] * 4000


def test_15_client_that_does_not_read_delays_no_other_client() -> None:
    with Host([Wide()], period=0.002, port=0, client_timeout=30.0) as host, RawClient(host.port, b"") as deaf:
        deaf.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 16)
        deaf.send(b"ar")
        deaf.socket.setblocking(False)
        # Requests without reading succeed until the host stops reading, which bounds the host's buffer.
        with RawClient(host.port) as other:
            other.greeting()
            refused = 0
            while refused < 100:
                try:
                    deaf.socket.send(b"rree" * (1 << 16))
                    refused = 0
                except BlockingIOError:
                    refused += 1
                last = other.value("tick")
                other.sync()
                assert other.value("tick") > last
        assert host.stats.bad_clients == 0
        deaf.socket.setblocking(True)
        deaf.socket.settimeout(10.0)
        deaf.greeting()
        ticks = []
        for _ in range(20):
            deaf.batch()
            ticks.append(deaf.value("tick"))
        assert ticks == sorted(set(ticks))


def test_15_client_that_does_not_read_is_closed_eventually() -> None:
    with Host([Wide()], period=0.002, port=0, client_timeout=0.1) as host, RawClient(host.port, b"") as deaf:
        deaf.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        deaf.send(b"ar" + b"rree" * 2000)
        until(lambda: host.stats.clients == 1)
        until(lambda: host.stats.clients == 0)
        witnessed = RawClient(host.port)
        witnessed.greeting()
        witnessed.close()


def test_3_client_with_half_a_package_is_closed_eventually(robot: Robot) -> None:
    with Host([robot], period=0.002, port=0, client_timeout=0.1) as host:
        with RawClient(host.port, b"aw") as master:
            master.greeting()
            master.send(b"rwdw")
            assert master.is_closed()
        # A client that has not begun a package may be silent forever.
        with RawClient(host.port) as reader, RawClient(host.port, b"aw") as other:
            reader.greeting()
            other.greeting()
            other.send(b"r")
            assert other.is_closed()
            reader.sync()


@pytest.mark.parametrize("length", [0, -1, 1 << 31])
def test_16_lengths_are_checked(length: int) -> None:
    with pytest.raises(BadValue):
        Database().read.add("big", length)


def test_16_long_variables_keep_their_values() -> None:
    class Early(Plugin):
        first = Read(Int32, 300)

        def init(self, config: object) -> None:
            self.first = range(300)
            self.host.database.read.add("second", 200)

        def periodic(self, tick: int) -> None: ...

    with Host([Early()], period=0.002, port=0) as host, RawClient(host.port) as client:
        client.greeting()
        assert client.words("first") == list(range(300))
        assert client.words("second") == [0] * 200


def test_17_host_ends_in_order_with_connected_clients(robot: Robot) -> None:
    ended: list[str] = []

    class Ending(Plugin):
        def __init__(self, name: str) -> None:
            self.name = name

        def periodic(self, tick: int) -> None: ...

        def terminate(self) -> None:
            ended.append(self.name)

    with ExitStack() as stack:
        with Host([Ending("first"), robot, Ending("last")], period=0.002, port=0) as host:
            clients = [stack.enter_context(RawClient(host.port, access)) for access in (b"aw", b"ar", b"")]
            for client in clients[:2]:
                client.greeting()
        assert ended == ["last", "first"]
        assert all(client.is_closed() for client in clients)


@pytest.mark.slow
def test_all_attacks_at_once_do_not_disturb_other_clients(host: Host, robot: Robot) -> None:
    """Thirty connections attack repeatedly, each in its own way; the master and a reader must miss nothing."""
    worst = [
        b"",
        b"a",
        b"arr",
        b"arrrdw" + int32(2**31 - 1),
        b"arrrdw" + int32(1, -1),
        b"aw" + b"rwdw" + int32(1, 10**6) + b"ee",
        b"ar" + b"\xff" * 65536,
        b"ar" + b"rree" * 100,
        b"\0" * 100,
        b"ardw" + int32(1) + ENTRY,
    ]
    with ExitStack() as stack:
        master = stack.enter_context(RawClient(host.port, b"aw"))
        reader = stack.enter_context(RawClient(host.port))
        master.greeting()
        reader.greeting()
        hostile: list[socket.socket] = []
        for number in range(150):
            link = stack.enter_context(socket.create_connection(("127.0.0.1", host.port)))
            link.setblocking(False)
            with suppress(OSError):
                link.send(worst[number % len(worst)])
            hostile.append(link)
            if len(hostile) > 30:
                hostile.pop(0).close()
            before = master.value("tick")
            # The reader must receive the written value in the next round at the latest.
            master.sync({"speed": number})
            assert master.value("tick") > before
            reader.sync()
            assert reader.value("speed") == number
            assert reader.value("counter") == reader.value("tick") - 1
    assert 1234 not in {speed for speed, _ in robot.seen}
    assert host.failure is None

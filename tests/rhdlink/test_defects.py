"""The defects of the original server that section 13 of the protocol notes lists: ours has none of them.

Each test is numbered as there. Hostile clients do their worst against a host that ticks by itself, while a witness has
one sync answered after the other: a host that one client can stop fails by the deadline of the witness, on any machine.
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
    # A period that a hostile client cannot hide in: the witness needs fifty of them.
    with Host([robot], period=0.002, port=0, client_timeout=30.0) as host:
        yield host


def witness(host: Host, syncs: int = 50) -> None:
    """Another client comes and is answered, each time in a later round, and the robot's plugin has run in between."""
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
    "a good entry before a hostile one": int32(2) + ENTRY + int32(77, 0, 0, 5),
    "count -1": int32(-1),
    "count -2^31": int32(-(2**31)),
    "count 2^31-1": int32(2**31 - 1),
    "count above the number of variables": int32(3) + 3 * ENTRY,
}


@pytest.mark.parametrize("access", [b"aw", b"ar"])
@pytest.mark.parametrize("payload", HOSTILE_WRITES.values(), ids=HOSTILE_WRITES)
def test_1_and_13_hostile_ids_and_counts_close_their_connection_only(
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


def test_2_a_reader_cannot_move_the_robot(host: Host, robot: Robot) -> None:
    with RawClient(host.port) as client:
        client.greeting()
        client.send(b"rrdw" + int32(1) + ENTRY + b"ee")
        client.batch()
        client.sync()
        client.sync()
    assert robot.seen == [(0, False)]
    assert host.stats.refused_writes == 1


def test_2_nor_can_a_refused_writer(host: Host, robot: Robot) -> None:
    with RawClient(host.port, b"aw") as master, RawClient(host.port, b"aw") as second:
        assert master.greeting().granted == "w"
        assert second.greeting().granted == "r"
        second.send(b"rrdw" + int32(1) + ENTRY + b"ee")
        second.batch()
        master.sync({})
        master.sync({})
        assert robot.seen == [(0, False)]
        # And if it insists on being a writer, it goes; the master stays.
        second.send(b"rwee")
        assert second.is_closed()
        master.sync({"speed": 3})
        master.sync({})
        master.sync({})
    assert (3, True) in robot.seen


HALVES = {
    "one byte": b"r",
    "ready without an end": b"rr",
    "a count and no entries": b"rrdw" + int32(2),
    "half an entry": b"rrdw" + int32(1, 0, 0),
    "everything but the last byte": b"rrdw" + int32(1) + ENTRY + b"e",
}


@pytest.mark.parametrize("half", HALVES.values(), ids=HALVES)
def test_3_half_a_package_holds_up_nobody_and_can_be_completed(host: Host, half: bytes) -> None:
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
def test_3_stray_bytes_end_their_own_connection(host: Host, stray: bytes) -> None:
    with RawClient(host.port) as client:
        client.greeting()
        client.send(stray + b"rree")
        assert client.is_closed()
    witness(host)


@pytest.mark.parametrize("said", [b"", b"a"])
def test_4_silence_in_the_handshake_holds_up_nobody(host: Host, said: bytes) -> None:
    with ExitStack() as stack:
        silent = [stack.enter_context(RawClient(host.port, said)) for _ in range(5)]
        witness(host)
        for client in silent:
            client.send(b"ar"[len(said) :])
            client.greeting()


def test_4_silent_connections_do_not_pile_up(host: Host) -> None:
    with ExitStack() as stack:
        silent = [stack.enter_context(RawClient(host.port, b"")) for _ in range(MOST_NEW + 1)]
        assert silent[0].is_closed()
        witness(host)
        silent[-1].send(b"ar")
        silent[-1].greeting()


@pytest.mark.parametrize("said", [b"xr", b"ax", b"GET", b"\0\0", b"rree"])
def test_4_what_is_no_handshake_is_closed_without_a_byte(host: Host, said: bytes) -> None:
    with RawClient(host.port, said) as client, suppress(ConnectionResetError):
        assert client.socket.recv(100) == b""
    witness(host, 3)


def test_5_who_connects_meanwhile_gets_its_own_handshake_and_disturbs_nobody(host: Host) -> None:
    with RawClient(host.port) as steady:
        steady.greeting()
        for _ in range(60):
            with RawClient(host.port) as client:
                handshake = client.greeting()
                assert [row.name for row in handshake.read] == ["tick", "counter", "calibration"]
                assert [row.name for row in handshake.write] == ["speed", "arm"]
                # `batch` refuses a table, or a package that belongs to another client's handshake.
                assert len(steady.sync().data) == 2
                client.sync()


def test_6_nothing_is_sent_that_was_not_asked_for(host: Host) -> None:
    with RawClient(host.port) as quiet, RawClient(host.port) as other:
        quiet.greeting()
        other.greeting()
        for _ in range(5):
            other.sync()
        # Ticks have passed since the handshake; the reply is of now, not of then.
        quiet.sync()
        assert quiet.value("tick") > other.value("tick")
        quiet.socket.setblocking(False)
        with pytest.raises(BlockingIOError):
            quiet.socket.recv(1)


def test_7_a_refused_writer_is_told_so(host: Host) -> None:
    with RawClient(host.port, b"aw") as master, RawClient(host.port, b"aw") as second:
        assert (master.greeting().granted, second.greeting().granted) == ("w", "r")


def test_8_only_what_was_set_since_is_sent(host: Host) -> None:
    with RawClient(host.port) as client:
        client.greeting()
        client.sync()
        for _ in range(3):
            # tick and counter; calibration was set once, long ago
            (_, data) = client.sync().data
            assert data.ids.tolist() == [0, 1]


def test_8_the_original_s_way_can_be_had(robot: Robot) -> None:
    with Host([robot], period=0.002, port=0, resend="original") as host, RawClient(host.port) as client:
        client.greeting()
        for _ in range(3):
            (_, data) = client.sync().data
            assert data.ids.tolist() == [0, 1, 2]


def test_9_a_silent_master_costs_a_synchronized_host_one_period(robot: Robot) -> None:
    # One period is the longest that a tick waits: were it a thousand, the witness would run out of time.
    with Host([robot], period=0.005, port=0, synchronized=True) as host, RawClient(host.port, b"aw") as master:
        master.greeting()
        witness(host, 20)
        master.sync({"speed": 5})
        witness(host, 5)


def test_10_every_reader_is_sent_the_write_table_whoever_left_before(robot: Robot) -> None:
    with ExitStack() as stack:
        host = stack.enter_context(Host([robot], period=0.002, port=0, allwriters=True))
        first, last = (stack.enter_context(RawClient(host.port, b"aw")) for _ in range(2))
        first.greeting()
        last.greeting()
        assert host.writers == 2
        last.close()
        until(lambda: host.writers == 1)
        # It gets the slot of the writer that was granted last.
        reader = stack.enter_context(RawClient(host.port))
        reader.greeting()
        first.sync({"speed": 6})
        assert [data.direction for data in reader.sync().data] == ["w", "r"]
        assert reader.value("speed") == 6


def test_11_an_index_equal_to_the_length_reaches_no_neighbour(robot: Robot) -> None:
    with Host([robot], period=0.002, port=0) as host:
        with pytest.raises(BadValue):
            robot.calibration = [1, 2, 3, 4]
        with pytest.raises(IndexError):
            robot.arm[4]
        witness(host, 1)


@pytest.mark.real_time
def test_12_the_port_is_free_again_at_once_and_of_this_machine_only(robot: Robot, own_port: int) -> None:
    with Host([robot], period=0.002, port=own_port):
        client = RawClient(own_port)
        client.greeting()
    # The host closed first, so that its end of the connection lingers.
    with Host([Robot()], period=0.002, port=own_port) as host:
        assert host.port == own_port
        witness(host, 1)
        # Another address of this machine, which a server that listens everywhere would answer on.
        with pytest.raises(OSError):  # noqa: PT011  (refused, or no such address)
            socket.create_connection(("127.0.0.2", own_port), timeout=1.0)
    client.close()


def test_14_the_width_of_stamps_is_a_setting_and_not_the_machine_s(robot: Robot) -> None:
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


def test_14_the_wrong_width_is_noticed(host: Host, robot: Robot) -> None:
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


def test_15_a_client_that_does_not_read_holds_up_nobody_and_keeps_nothing() -> None:
    with Host([Wide()], period=0.002, port=0, client_timeout=30.0) as host, RawClient(host.port, b"") as deaf:
        deaf.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 16)
        deaf.send(b"ar")
        deaf.socket.setblocking(False)
        # Asking without reading works until the host reads no further, which is how it bounds what it keeps.
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


def test_15_a_client_that_does_not_read_is_closed_in_the_end() -> None:
    with Host([Wide()], period=0.002, port=0, client_timeout=0.1) as host, RawClient(host.port, b"") as deaf:
        deaf.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        deaf.send(b"ar" + b"rree" * 2000)
        until(lambda: host.stats.clients == 1)
        until(lambda: host.stats.clients == 0)
        witnessed = RawClient(host.port)
        witnessed.greeting()
        witnessed.close()


def test_3_a_client_that_leaves_a_package_half_sent_is_closed_in_the_end(robot: Robot) -> None:
    with Host([robot], period=0.002, port=0, client_timeout=0.1) as host:
        with RawClient(host.port, b"aw") as master:
            master.greeting()
            master.send(b"rwdw")
            assert master.is_closed()
        # A client that has begun nothing may be silent for as long as it likes.
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


def test_16_lengths_beyond_127_and_values_set_before_another_variable_is_made() -> None:
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


def test_17_the_end_is_in_order_whoever_is_connected(robot: Robot) -> None:
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
def test_all_at_once(host: Host, robot: Robot) -> None:
    """Thirty connections, each hostile in its own way, over and over; the master and a reader miss nothing."""
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
            # What the master writes now is what the reader is told in the round after, at the latest.
            master.sync({"speed": number})
            assert master.value("tick") > before
            reader.sync()
            assert reader.value("speed") == number
            assert reader.value("counter") == reader.value("tick") - 1
    assert 1234 not in {speed for speed, _ in robot.seen}
    assert host.failure is None

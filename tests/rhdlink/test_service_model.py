"""The service compared with a simple model: clients connect, write, read, misbehave and leave in any order."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from linkcore.errors import BadValue, LocalError
from rhdlink.host.service import Client, Service
from rhdlink.variables import database as database_module
from rhdlink.variables.database import Database
from rhdlink.wire.decoder import Limits, ServerDecoder
from rhdlink.wire.messages import SymbolRow, encode_data

READ = {"tick": 1, "encoders": 2, "scan": 5, "once": 1}
WRITE = {"speed": 1, "arm": 3, "lamp": 1}
SLOTS = 3

words = st.integers(-(2**31), 2**31 - 1)


def int32(*values: int) -> bytes:
    return struct.pack(f">{len(values)}i", *values)


@dataclass
class Peer:
    """State of a client: the values that it knows, and the variables that it still has to receive."""

    client: Client
    access: str
    stream: ServerDecoder
    tables: Database
    dirty_read: set[str] = field(default_factory=set)
    dirty_write: set[str] = field(default_factory=set)
    asks: bool = False
    writes: dict[str, list[int]] | None = None

    @property
    def is_busy(self) -> bool:
        return self.writes is not None


class Rounds(RuleBasedStateMachine):
    def __init__(self) -> None:
        super().__init__()
        self.peers: list[Peer] = []

    @initialize(
        allwriters=st.booleans(), resend=st.sampled_from(["changed", "original"]), width=st.sampled_from([2, 4])
    )
    def begin(self, allwriters: bool, resend: str, width: int) -> None:
        self.database = Database(
            [SymbolRow(*item) for item in READ.items()], [SymbolRow(*item) for item in WRITE.items()]
        )
        self.allwriters, self.original, self.width = allwriters, resend == "original", width
        self.service = Service(
            self.database,
            clients=SLOTS,
            allwriters=allwriters,
            resend=resend,  # type: ignore[arg-type]
            width=width,
        )
        self.values = {name: [0] * length for name, length in {**READ, **WRITE}.items()}
        self.ever: set[str] = set()

    @property
    def writers(self) -> list[Peer]:
        return [peer for peer in self.peers if peer.access == "w"]

    # -- events ---------------------------------------------------------------------------------------

    @rule(access=st.sampled_from("rw"), cut=st.booleans())
    def comes(self, access: str, cut: bool) -> None:
        client = self.service.connect("client")
        assert (client is None) == (len(self.peers) == SLOTS)
        if client is None:
            return
        asked = b"a" + access.encode()
        greeting = self.service.receive(client, asked[:1]) if cut else b""
        assert greeting == b""
        greeting = self.service.receive(client, asked[1:] if cut else asked)
        granted = "w" if access == "w" and (self.allwriters or not self.writers) else "r"
        stream = ServerDecoder(width=self.width)
        stream.feed(greeting)
        handshake = stream.take_handshake()
        assert handshake is not None
        assert stream.waiting == 0
        assert handshake.granted == granted
        tables = Database(handshake.read, handshake.write)
        for data in handshake.data:
            tables.table(data.direction).receive(data)
        peer = Peer(client, granted, stream, tables)
        self.peers.append(peer)
        # The handshake contains all values that were set before it.
        self.check_values(peer, set(self.values))

    @rule(name=st.sampled_from(sorted(READ)), data=st.data())
    def robot_sets(self, name: str, data: st.DataObject) -> None:
        value = data.draw(st.lists(words, min_size=READ[name], max_size=READ[name]))
        identity = self.database.read.find(name)
        assert identity is not None
        self.database.read.set(identity, value)
        self.values[name] = value
        self.ever.add(name)
        for peer in self.peers:
            peer.dirty_read.add(name)

    @precondition(lambda self: any(not peer.is_busy for peer in self.peers))
    @rule(data=st.data(), asks=st.booleans(), cuts=st.integers(0, 3))
    def client_asks(self, data: st.DataObject, asks: bool, cuts: int) -> None:
        peer = data.draw(st.sampled_from([peer for peer in self.peers if not peer.is_busy]), label="client")
        names = data.draw(st.lists(st.sampled_from(sorted(WRITE)), unique=True), label="writes")
        peer.writes = {}
        entries = b""
        for name in names:
            value = data.draw(st.lists(words, min_size=WRITE[name], max_size=WRITE[name]))
            peer.writes[name] = value
            entries += int32(list(WRITE).index(name), *[7] * self.width, *value)
        peer.asks = asks
        request = b"r" + peer.access.encode() if asks else b""
        request += b"dw" + int32(len(names)) + entries + b"ee"
        step = max(len(request) // (cuts + 1), 1)
        for at in range(0, len(request), step):
            assert peer.client.request is None
            assert self.service.receive(peer.client, request[at : at + step]) == b""
        assert peer.client.request is not None
        assert peer.client.failure is None

    @precondition(lambda self: self.peers)
    @rule(data=st.data())
    def client_goes(self, data: st.DataObject) -> None:
        peer = data.draw(st.sampled_from(self.peers), label="client")
        self.service.disconnect(peer.client)
        self.peers.remove(peer)
        if peer.access == "w" and peer.writes:
            self.last_words.append(peer.writes)

    @precondition(lambda self: any(not peer.is_busy for peer in self.peers))
    @rule(data=st.data(), nonsense=st.sampled_from([b"xx", b"dr", b"dw" + int32(-1), b"dw" + int32(1, 3), b"tw"]))
    def client_misbehaves(self, data: st.DataObject, nonsense: bytes) -> None:
        peer = data.draw(st.sampled_from([peer for peer in self.peers if not peer.is_busy]), label="client")
        self.service.receive(peer.client, nonsense + b"ee")
        assert peer.client.failure is not None
        self.service.disconnect(peer.client)
        self.peers.remove(peer)

    last_words: list[dict[str, list[int]]]

    @initialize()
    def no_client_has_left(self) -> None:
        self.last_words = []

    @rule()
    def a_round(self) -> None:
        taken: list[tuple[Peer | None, dict[str, list[int]]]] = [(None, writes) for writes in self.last_words]
        self.last_words = []
        for peer in sorted(self.peers, key=lambda peer: peer.client.slot or 0):
            if peer.writes is not None and peer.access == "w":
                taken.append((peer, peer.writes))
        written: set[str] = set()
        for author, writes in taken:
            self.values.update(writes)
            written |= set(writes)
            for peer in self.peers:
                if peer is author and [peer] == self.writers:
                    # A sole writer does not receive its own values.
                    for name, value in writes.items():
                        identity = peer.tables.write.find(name)
                        assert identity is not None
                        peer.tables.write.set(identity, value)
                else:
                    peer.dirty_write |= set(writes)
        replies = dict(self.service.sync())
        for identity, name in enumerate(WRITE):
            assert bool(self.database.write.updated[identity]) == (name in written)
            assert self.database.write.value(identity).tolist() == self.values[name]
        for peer in self.peers:
            is_due = peer.asks and peer.writes is not None
            assert (peer.client in replies) == is_due
            if is_due:
                self.check_reply(peer, replies[peer.client])
            peer.asks, peer.writes = False, None

    def check_reply(self, peer: Peer, reply: bytes) -> None:
        peer.stream.feed(reply)
        batch = peer.stream.take_batch()
        assert batch is not None
        assert peer.stream.waiting == 0
        is_sole = [peer] == self.writers
        assert [data.direction for data in batch.data] == (["r"] if is_sole else ["w", "r"])
        sent = {
            data.direction: {list(WRITE if data.direction == "w" else READ)[number] for number in data.ids.tolist()}
            for data in batch.data
        }
        assert sent["r"] == (self.ever if self.original else peer.dirty_read)
        if not is_sole:
            assert sent["w"] == peer.dirty_write
        for data in batch.data:
            assert data.ids.tolist() == sorted(data.ids.tolist())
            peer.tables.table(data.direction).receive(data)
        peer.dirty_read = set()
        if not is_sole:
            peer.dirty_write = set()
        # After a reply a client knows all values, with one exception: values that others wrote before it became the
        # sole writer, because a sole writer does not receive the write table.
        self.check_values(peer, set(self.values) - peer.dirty_write)

    def check_values(self, peer: Peer, names: set[str]) -> None:
        for name in names:
            table = peer.tables.table("r" if name in READ else "w")
            identity = table.find(name)
            assert identity is not None
            assert table.value(identity).tolist() == self.values[name]

    @invariant()
    def seats_are_counted(self) -> None:
        if hasattr(self, "service"):
            assert self.service.clients == sorted(
                (peer.client for peer in self.peers), key=lambda client: client.slot or 0
            )
            assert self.service.writers == len(self.writers)
            assert self.allwriters or self.service.writers <= 1


TestRounds = pytest.mark.property(Rounds.TestCase)
TestRounds.settings = settings(stateful_step_count=40, deadline=None)


@pytest.mark.property
@given(st.lists(st.one_of(st.binary(max_size=60), st.sampled_from([b"aw", b"ar", b"rwee", b"rree", b"dw", b"ee"]))))
def test_any_bytes_are_served_or_close_the_connection(pieces: list[bytes]) -> None:
    service = Service(Database([SymbolRow("tick", 1)], [SymbolRow("speed", 1), SymbolRow("arm", 3)]))
    client = service.connect("stranger")
    assert client is not None
    for piece in pieces:
        service.receive(client, piece)
        service.sync()
        if client.failure is not None:
            break
    service.disconnect(client)
    assert service.clients == []
    assert service.sync() == []


def service(clients: int = 10, width: int = 2) -> tuple[Service, Database]:
    database = Database([SymbolRow(*item) for item in READ.items()], [SymbolRow(*item) for item in WRITE.items()])
    return Service(database, clients=clients, width=width), database


def granted(served: Service, access: bytes = b"ar") -> Client:
    client = served.connect("client")
    assert client is not None
    assert served.receive(client, access)
    return client


def asked(served: Service, *clients: Client) -> list[bytes]:
    """Return the replies of a round in which these clients send requests."""
    for client in clients:
        assert served.receive(client, b"rree") == b""
    replies = dict(served.sync())
    return [replies.pop(client) for client in clients]


def speed(value: int) -> bytes:
    """Return a request that sets the first write variable."""
    return b"rwdw" + int32(1, 0, 7, 7, value) + b"ee"


def test_each_client_receives_only_new_values() -> None:
    served, database = service()

    def package(direction: str, *ids: int) -> bytes:
        return database.table(direction).encode(np.array(ids, np.int64), 2)

    master, often, seldom = granted(served, b"aw"), granted(served), granted(served)
    database.read.set(0, 1)
    assert asked(served, often) == [package("w") + package("r", 0) + b"ee"]
    database.read.set(1, [2, 3])
    newcomer = granted(served)  # its handshake contains all these values
    clients = (master, often, seldom, newcomer)
    news = [package("r", *ids) + b"ee" for ids in ((0, 1), (1,), (0, 1), ())]
    assert asked(served, *clients) == [news[0], *(package("w") + each for each in news[1:])]
    served.receive(master, speed(5))
    served.receive(often, b"rree")
    nothing = package("r") + b"ee"
    # The sole writer knows its own values.
    assert dict(served.sync()) == {master: nothing, often: package("w", 0) + nothing}
    assert asked(served, often, seldom) == [package("w") + nothing, package("w", 0) + nothing]


def test_equal_replies_are_encoded_once(monkeypatch: pytest.MonkeyPatch) -> None:
    served, database = service()
    readers = [granted(served) for _ in range(5)]
    database.read.set(0, 1)
    encoded: list[str] = []

    def encode(direction: str, *rest: Any) -> bytes:
        encoded.append(direction)
        return encode_data(direction, *rest)

    monkeypatch.setattr(database_module, "encode_data", encode)
    assert len(set(asked(served, *readers))) == 1
    assert encoded == ["w", "r"]


def test_values_of_a_reader_are_counted_but_ignored(caplog: pytest.LogCaptureFixture) -> None:
    served, database = service()
    assert (served.refused_writes, served.refused_clients, served.bad_clients) == (0, 0, 0)
    reader = granted(served)
    two = b"rrdw" + int32(2, 0, 7, 7, 5, 2, 7, 7, 6) + b"ee"
    for number in (1, 2):
        served.receive(reader, two)
        assert reader.requests == number
        assert reader in dict(served.sync())
    assert (served.refused_writes, reader.refused_writes) == (4, 4)
    assert not database.write.updated.any()
    assert database.write.value(0)[0] == 0
    assert caplog.text.count("may only read") == 1
    # A request as a writer is rejected, because the client would wait for a reply that never comes.
    served.receive(reader, b"rwee")
    assert reader.failure == "requests as a writer without permission to write"
    assert served.bad_clients == 1


def test_data_after_the_access_request_is_a_request() -> None:
    served, _ = service()
    assert granted(served, b"arrree").is_asking


def test_last_requests_of_a_writer_are_applied_once() -> None:
    served, database = service()
    writer = granted(served, b"aw" + speed(5) + speed(6) + b"xx")
    served.disconnect(writer)
    assert served.sync() == []
    assert (database.write.value(0)[0], database.write.updated[0]) == (6, True)
    assert served.sync() == []
    assert not database.write.updated[0]


def test_service_buffers_four_kilobytes_before_it_has_replied() -> None:
    served, _ = service()
    client = granted(served, b"arrree")
    served.receive(client, bytes(4096))
    assert client.may_send
    served.receive(client, b"r")
    assert not client.may_send


def test_service_limits_slots_and_accepts_no_variables_later() -> None:
    database = Database([SymbolRow("tick", 1)])
    assert Service(database, clients=10_000).slots == 10_000
    with pytest.raises(BadValue, match="clients"):
        Service(Database(), clients=10_001)
    with pytest.raises(LocalError):
        database.read.add("late")


def test_default_is_ten_slots_and_one_writer() -> None:
    served = Service(Database())
    assert served.slots == 10
    for _ in range(2):
        granted(served, b"aw")
    assert served.writers == 1


def test_disconnected_client_frees_its_slot_only_once() -> None:
    served, _ = service(clients=1)
    first = granted(served)
    served.disconnect(first)
    second = granted(served)
    # The end of a connection might be reported more than once.
    served.disconnect(first)
    assert served.clients == [second]
    assert served.is_full


def test_slot_taken_during_a_handshake_is_not_reused() -> None:
    served, _ = service(clients=1)
    slow = served.connect("slow")
    assert slow is not None
    granted(served)
    assert served.receive(slow, b"ar") == b""
    assert slow.failure == "no free slot was left when access was requested"
    assert (served.refused_clients, served.bad_clients) == (1, 0)
    assert slow.slot is None


@pytest.mark.parametrize("width", [2, 4])
def test_request_size_limit_is_all_variables_plus_a_kilobyte(width: int) -> None:
    served, database = service(width=width)
    every = database.write.encode(np.arange(len(database.write)), width)
    fill = b"rw" * ((1024 - 6 - 2) // 2)  # without the head of the package and the end
    for more, is_refused in ((b"", False), (b"rw", True)):
        writer = granted(served, b"aw")
        served.receive(writer, fill + more + every + b"ee")
        assert (writer.failure is not None) == is_refused
        served.disconnect(writer)


def test_given_limits_are_applied() -> None:
    generous = Service(Database(write=[SymbolRow("speed", 1)]), limits=Limits(batch=1 << 20))
    writer = granted(generous, b"aw")
    generous.receive(writer, b"rw" * 10_000 + b"ee")
    assert writer.failure is None

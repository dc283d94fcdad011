"""The service against a simple model: several clients come, write, read, misbehave and go, in any order."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from rhdlink.database import Database
from rhdlink.service import Guest, Service
from rhdlink.wire import Row, ServerStream

READ = {"tick": 1, "encoders": 2, "scan": 5, "once": 1}
WRITE = {"speed": 1, "arm": 3, "lamp": 1}
SEATS = 3

words = st.integers(-(2**31), 2**31 - 1)


def int32(*values: int) -> bytes:
    return struct.pack(f">{len(values)}i", *values)


@dataclass
class Client:
    """What a client knows, and what it is owed."""

    guest: Guest
    access: str
    stream: ServerStream
    tables: Database
    read_news: set[str] = field(default_factory=set)
    write_news: set[str] = field(default_factory=set)
    asks: bool = False
    writes: dict[str, list[int]] | None = None

    @property
    def is_busy(self) -> bool:
        return self.writes is not None


class Rounds(RuleBasedStateMachine):
    def __init__(self) -> None:
        super().__init__()
        self.clients: list[Client] = []

    @initialize(
        allwriters=st.booleans(), resend=st.sampled_from(["changed", "original"]), width=st.sampled_from([2, 4])
    )
    def begin(self, allwriters: bool, resend: str, width: int) -> None:
        self.database = Database([Row(*item) for item in READ.items()], [Row(*item) for item in WRITE.items()])
        self.allwriters, self.original, self.width = allwriters, resend == "original", width
        self.service = Service(
            self.database,
            clients=SEATS,
            allwriters=allwriters,
            resend=resend,  # type: ignore[arg-type]
            width=width,
        )
        self.values = {name: [0] * length for name, length in {**READ, **WRITE}.items()}
        self.ever: set[str] = set()

    @property
    def writers(self) -> list[Client]:
        return [client for client in self.clients if client.access == "w"]

    # -- what may happen --------------------------------------------------------------------------

    @rule(access=st.sampled_from("rw"), cut=st.booleans())
    def comes(self, access: str, cut: bool) -> None:
        guest = self.service.arrive("client")
        assert (guest is None) == (len(self.clients) == SEATS)
        if guest is None:
            return
        asked = b"a" + access.encode()
        greeting = self.service.receive(guest, asked[:1]) if cut else b""
        assert greeting == b""
        greeting = self.service.receive(guest, asked[1:] if cut else asked)
        granted = "w" if access == "w" and (self.allwriters or not self.writers) else "r"
        stream = ServerStream(width=self.width)
        stream.feed(greeting)
        handshake = stream.take_handshake()
        assert handshake is not None
        assert stream.waiting == 0
        assert handshake.granted == granted
        tables = Database(handshake.read, handshake.write)
        for data in handshake.data:
            tables.table(data.direction).receive(data)
        client = Client(guest, granted, stream, tables)
        self.clients.append(client)
        # The handshake holds everything that was set before it.
        self.check_values(client, set(self.values))

    @rule(name=st.sampled_from(sorted(READ)), data=st.data())
    def robot_sets(self, name: str, data: st.DataObject) -> None:
        value = data.draw(st.lists(words, min_size=READ[name], max_size=READ[name]))
        identity = self.database.read.find(name)
        assert identity is not None
        self.database.read.set(identity, value)
        self.values[name] = value
        self.ever.add(name)
        for client in self.clients:
            client.read_news.add(name)

    @precondition(lambda self: any(not client.is_busy for client in self.clients))
    @rule(data=st.data(), asks=st.booleans(), cuts=st.integers(0, 3))
    def client_asks(self, data: st.DataObject, asks: bool, cuts: int) -> None:
        client = data.draw(st.sampled_from([client for client in self.clients if not client.is_busy]), label="client")
        names = data.draw(st.lists(st.sampled_from(sorted(WRITE)), unique=True), label="writes")
        client.writes = {}
        entries = b""
        for name in names:
            value = data.draw(st.lists(words, min_size=WRITE[name], max_size=WRITE[name]))
            client.writes[name] = value
            entries += int32(list(WRITE).index(name), *[7] * self.width, *value)
        client.asks = asks
        request = b"r" + client.access.encode() if asks else b""
        request += b"dw" + int32(len(names)) + entries + b"ee"
        step = max(len(request) // (cuts + 1), 1)
        for at in range(0, len(request), step):
            assert client.guest.request is None
            assert self.service.receive(client.guest, request[at : at + step]) == b""
        assert client.guest.request is not None
        assert client.guest.failure is None

    @precondition(lambda self: self.clients)
    @rule(data=st.data())
    def client_goes(self, data: st.DataObject) -> None:
        client = data.draw(st.sampled_from(self.clients), label="client")
        self.service.leave(client.guest)
        self.clients.remove(client)
        if client.access == "w" and client.writes:
            self.last_words.append(client.writes)

    @precondition(lambda self: any(not client.is_busy for client in self.clients))
    @rule(data=st.data(), nonsense=st.sampled_from([b"xx", b"dr", b"dw" + int32(-1), b"dw" + int32(1, 3), b"tw"]))
    def client_misbehaves(self, data: st.DataObject, nonsense: bytes) -> None:
        client = data.draw(st.sampled_from([client for client in self.clients if not client.is_busy]), label="client")
        self.service.receive(client.guest, nonsense + b"ee")
        assert client.guest.failure is not None
        self.service.leave(client.guest)
        self.clients.remove(client)

    last_words: list[dict[str, list[int]]]

    @initialize()
    def nobody_has_left(self) -> None:
        self.last_words = []

    @rule()
    def a_round(self) -> None:
        taken: list[tuple[Client | None, dict[str, list[int]]]] = [(None, writes) for writes in self.last_words]
        self.last_words = []
        for client in sorted(self.clients, key=lambda client: client.guest.seat or 0):
            if client.writes is not None and client.access == "w":
                taken.append((client, client.writes))
        written: set[str] = set()
        for author, writes in taken:
            self.values.update(writes)
            written |= set(writes)
            for client in self.clients:
                if client is author and [client] == self.writers:
                    # It is not told what it wrote itself.
                    for name, value in writes.items():
                        identity = client.tables.write.find(name)
                        assert identity is not None
                        client.tables.write.set(identity, value)
                else:
                    client.write_news |= set(writes)
        replies = dict(self.service.sync())
        for identity, name in enumerate(WRITE):
            assert bool(self.database.write.updated[identity]) == (name in written)
            assert self.database.write.value(identity).tolist() == self.values[name]
        for client in self.clients:
            is_due = client.asks and client.writes is not None
            assert (client.guest in replies) == is_due
            if is_due:
                self.check_reply(client, replies[client.guest])
            client.asks, client.writes = False, None

    def check_reply(self, client: Client, reply: bytes) -> None:
        client.stream.feed(reply)
        batch = client.stream.take_batch()
        assert batch is not None
        assert client.stream.waiting == 0
        is_sole = [client] == self.writers
        assert [data.direction for data in batch.data] == (["r"] if is_sole else ["w", "r"])
        told = {
            data.direction: {list(WRITE if data.direction == "w" else READ)[number] for number in data.ids.tolist()}
            for data in batch.data
        }
        assert told["r"] == (self.ever if self.original else client.read_news)
        if not is_sole:
            assert told["w"] == client.write_news
        for data in batch.data:
            assert data.ids.tolist() == sorted(data.ids.tolist())
            client.tables.table(data.direction).receive(data)
        client.read_news = set()
        if not is_sole:
            client.write_news = set()
        # Whatever was said when: after a reply a client knows all, but for what others wrote before one became the
        # sole writer, which is not sent the write table.
        self.check_values(client, set(self.values) - client.write_news)

    def check_values(self, client: Client, names: set[str]) -> None:
        for name in names:
            table = client.tables.table("r" if name in READ else "w")
            identity = table.find(name)
            assert identity is not None
            assert table.value(identity).tolist() == self.values[name]

    @invariant()
    def seats_are_counted(self) -> None:
        if hasattr(self, "service"):
            assert self.service.guests == sorted(
                (client.guest for client in self.clients), key=lambda guest: guest.seat or 0
            )
            assert self.service.writers == len(self.writers)
            assert self.allwriters or self.service.writers <= 1


TestRounds = pytest.mark.property(Rounds.TestCase)
TestRounds.settings = settings(stateful_step_count=40, deadline=None)


@pytest.mark.property
@given(st.lists(st.one_of(st.binary(max_size=60), st.sampled_from([b"aw", b"ar", b"rwee", b"rree", b"dw", b"ee"]))))
def test_arbitrary_bytes_give_a_value_or_a_closed_connection(pieces: list[bytes]) -> None:
    service = Service(Database([Row("tick", 1)], [Row("speed", 1), Row("arm", 3)]))
    guest = service.arrive("stranger")
    assert guest is not None
    for piece in pieces:
        service.receive(guest, piece)
        service.sync()
        if guest.failure is not None:
            break
    service.leave(guest)
    assert service.guests == []
    assert service.sync() == []

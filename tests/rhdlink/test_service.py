"""The bytes of the host must equal those of the original server, for the same tables and the same events.

Details that the threads and clocks of the original decided come from the recording: the values and stamps of read
variables, and the round in which a request was read. The host decides the rest: the recipients of each table, its
content and its order.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from rhdlink.host.service import Client, Service
from rhdlink.variables.database import Database
from rhdlink.wire.decoder import ClientDecoder, ServerDecoder
from rhdlink.wire.messages import Batch, Handshake, encode_data
from tests.fakes.rhd import entries
from tests.real_captures import folder

pytestmark = pytest.mark.captures("rhd")


@pytest.fixture
def recorded() -> Path:
    return folder("rhd")


class Connection(NamedTuple):
    """Recorded connection, with both directions split into batches."""

    width: int
    handshake: Handshake
    greeting: bytes
    requests: list[bytes]
    batches: list[tuple[Batch, bytes]]


def connection(folder: Path, name: str) -> Connection:
    sent = (folder / f"{name}.s2c.bin").read_bytes()
    stream = ServerDecoder()
    stream.feed(sent)
    handshake = stream.take_handshake()
    assert handshake is not None
    greeting, at = sent[: stream.offset], stream.offset
    batches = []
    while (batch := stream.take_batch()) is not None:
        batches.append((batch, sent[at : at + batch.size]))
        at += batch.size
    layout = Database(write=handshake.write).write.layout
    asked = (folder / f"{name}.c2s.bin").read_bytes()
    client = ClientDecoder(layout, width=handshake.width)
    client.feed(asked)
    client.take_access()
    requests, at = [], 2
    while (request := client.take_request()) is not None:
        requests.append(asked[at : at + request.size])
        at += request.size
    assert at == len(asked)
    return Connection(handshake.width, handshake, greeting, requests, batches)


class Original:
    """Service in the state that the original server had at the start of the connection."""

    def __init__(self, recording: Connection, allwriters: bool = False) -> None:
        self.handshake = recording.handshake
        self.database = Database(recording.handshake.read, recording.handshake.write)
        for data in recording.handshake.data:
            self.database.table(data.direction).receive(data, updates=False)
        self.service = Service(self.database, resend="original", width=recording.width, allwriters=allwriters)
        self.width = recording.width

    def connect(self, access: bytes) -> tuple[Client, bytes]:
        client = self.service.connect("test")
        assert client is not None
        return client, self.service.receive(client, access)

    def happens(self, batch: Batch) -> None:
        """Set the read variables whose stamp or value in this batch differs from before, and no others."""
        for data in batch.data:
            if data.direction == "r":
                for identity, stamp, words in entries(data):
                    table = self.database.read
                    if tuple(table.stamps[identity]) != stamp or (table.value(identity) != words).any():
                        table.set(identity, words, stamp)  # type: ignore[arg-type]

    def writes(self, master: Client, batch: Batch) -> None:
        """Let the master write the values that this batch contains."""
        for data in batch.data:
            if data.direction == "w":
                values = np.zeros(self.database.write.layout.words, np.int32)
                values[data.selection.cells] = data.values
                stamps = np.zeros((len(self.database.write), 2), np.int64)
                stamps[data.selection.rows] = data.stamps
                self.service.receive(master, b"rw" + encode_data("w", data.selection, values, stamps) + b"ee")

    def mark_what_was_set(self, batch: Batch) -> None:
        """Mark the variables that the original had set before this connection; they appear in its first batch."""
        for data in batch.data:
            if data.direction == "r":
                self.database.read.updated[data.ids] = True


READERS = ("reader64", "reader64naive", "reader32", "reader_orig2014")
WRITERS = ("writer64", "writer64naive", "writer32", "writer_orig2014")


@pytest.mark.parametrize("name", [*READERS, *WRITERS])
def test_handshake_and_replies_equal_those_of_the_original(recorded: Path, name: str) -> None:
    recording = connection(recorded, name)
    ours = Original(recording)
    client, greeting = ours.connect(recording.greeting[:2])
    assert greeting == recording.greeting
    ours.mark_what_was_set(recording.batches[0][0])
    assert len(recording.requests) == len(recording.batches) == 50
    for request, (batch, raw) in zip(recording.requests, recording.batches, strict=True):
        assert ours.service.receive(client, request) == b""
        ours.happens(batch)
        ((_, reply),) = ours.service.sync()
        assert reply == raw
    assert client.failure is None


def test_reader_receives_the_values_of_the_master(recorded: Path) -> None:
    recording = connection(recorded, "reader64_with_master")
    ours = Original(recording)
    master, _ = ours.connect(b"aw")
    client, greeting = ours.connect(b"ar")
    assert greeting == recording.greeting
    ours.mark_what_was_set(recording.batches[0][0])
    for request, (batch, raw) in zip(recording.requests, recording.batches, strict=True):
        ours.service.receive(client, request)
        ours.writes(master, batch)
        ours.happens(batch)
        replies = dict(ours.service.sync())
        assert replies[client] == raw
        # The write table is not sent to a sole writer.
        assert replies[master] == b"dr" + raw.partition(b"dr")[2]


def test_allwriters_also_sends_a_writer_its_own_values(recorded: Path) -> None:
    recordings = [connection(recorded, f"allwriters64_{letter}") for letter in "AB"]
    ours = Original(recordings[0], allwriters=True)
    clients = []
    for recording in recordings:
        client, greeting = ours.connect(b"aw")
        assert greeting[:2] == recording.greeting[:2] == b"aw"
        clients.append(client)
        # The original sends this batch unsolicited; rhdlink does not.
        ours.mark_what_was_set(recording.batches[0][0])
    rounds: dict[int, list[tuple[Client, bytes, Batch, bytes]]] = {}
    for client, recording in zip(clients, recordings, strict=True):
        assert len(recording.batches) == len(recording.requests) + 1
        for request, (batch, raw) in zip(recording.requests, recording.batches[1:], strict=True):
            rounds.setdefault(tick(batch), []).append((client, request, batch, raw))
    assert len(rounds) == 20
    for _, asked in sorted(rounds.items()):
        for client, request, batch, _ in asked:
            ours.service.receive(client, request)
            ours.happens(batch)
        assert ours.service.sync() == [(client, raw) for client, _, _, raw in asked]


def tick(batch: Batch) -> int:
    """Return the round of the server in which the batch was sent."""
    return next(int(data.values[0]) for data in batch.data if data.direction == "r")


@pytest.mark.parametrize("name", ["second_writer64", "second_writer_continues64"])
def test_second_writer_is_granted_read_access(recorded: Path, name: str) -> None:
    recording = connection(recorded, name)
    assert recording.handshake.granted is None
    ours = Original(recording)
    master, _ = ours.connect(b"aw")
    client, greeting = ours.connect(b"aw")
    # The only difference: the original omits the answer, so librhd considers the server broken (defect 7).
    assert greeting == b"ar" + recording.greeting
    for request, (batch, raw) in zip(recording.requests, recording.batches[1:], strict=False):
        ours.mark_what_was_set(batch)
        ours.writes(master, batch)
        ours.service.receive(client, request)
        ours.happens(batch)
        assert dict(ours.service.sync())[client] == raw

"""Recorded connections of the original programs, decoded and compared with the output of the original client."""

from __future__ import annotations

import numpy as np
import pytest

from linkcore.errors import PacketError
from rhdlink.variables.database import Database, TimeStamp
from rhdlink.wire.data import TableLayout
from rhdlink.wire.decoder import ClientDecoder, ServerDecoder
from rhdlink.wire.messages import Batch, Handshake, Request, encode_access, encode_data, encode_ready
from tests.fakes.rhd import entries
from tests.rhdlink import recorded

pytestmark = pytest.mark.captures("rhd")

#: name -> words of a time stamp, batches after the handshake, granted access
STREAMS: dict[str, tuple[int, int, str | None]] = {
    "reader64": (2, 50, "r"),
    "reader64naive": (4, 50, "r"),
    "reader32": (2, 50, "r"),
    "reader_orig2014": (2, 50, "r"),
    "writer64": (2, 50, "w"),
    "writer64naive": (4, 50, "w"),
    "writer32": (2, 50, "w"),
    "writer_orig2014": (2, 50, "w"),
    "reader64_with_master": (2, 50, "r"),
    "second_writer64": (2, 0, None),
    "second_writer_continues64": (2, 4, None),
    "late_first_sync64": (2, 5, "r"),
    "late_first_sync_orig2014": (2, 5, "r"),
    "allwriters64_A": (2, 11, "w"),
    "allwriters64_B": (2, 11, "w"),
    "race_corrupted_reader64": (2, 43, "r"),
}
PRINTED = [name for name in STREAMS if name.startswith(("reader", "writer"))]


def whole(data: bytes) -> tuple[ServerDecoder, Handshake, list[Batch]]:
    stream = ServerDecoder()
    stream.feed(data)
    handshake = stream.take_handshake()
    assert handshake is not None
    return stream, handshake, batches_of(stream)


def batches_of(stream: ServerDecoder) -> list[Batch]:
    batches = []
    while (batch := stream.take_batch()) is not None:
        batches.append(batch)
    return batches


def requests_of(data: bytes, handshake: Handshake) -> list[Request]:
    stream = ClientDecoder(TableLayout([row.length for row in handshake.write]), width=handshake.width)
    stream.feed(data)
    assert stream.take_access() in ("r", "w")
    requests = []
    while (request := stream.take_request()) is not None:
        requests.append(request)
    assert stream.waiting == 0
    return requests


def plain(batch: Batch | Request) -> list[object]:
    return [
        (data.direction, data.ids.tolist(), data.stamps.tolist(), data.values.tolist(), batch.size)
        for data in batch.data
    ]


@pytest.mark.parametrize("name", STREAMS)
def test_every_recorded_stream_is_decoded_to_its_last_byte(name: str) -> None:
    width, count, granted = STREAMS[name]
    stream, handshake, batches = whole(recorded.from_server(name))
    assert (handshake.width, len(batches), handshake.granted) == (width, count, granted)
    assert stream.waiting == 0
    assert [row.name for row in handshake.write] == ["speedl", "speedr", "cmdarr", "resetmotorr"]
    assert handshake.read[0] == ("tick", 1)


@pytest.mark.parametrize("name", PRINTED)
def test_decoded_values_equal_the_output_of_the_original(name: str) -> None:
    _, handshake, batches = whole(recorded.from_server(name))
    requests = requests_of(recorded.from_client(name), handshake)
    tables = recorded.printed(name)
    database = Database(handshake.read, handshake.write)
    # `changed` has no meaning in the _64 sources. The naive build loses the microseconds of all received stamps.
    has_changed, has_micros = not ("64" in name and "naive" not in name), handshake.width == 2

    def compare(lines: list[recorded.Line]) -> None:
        assert len(lines) == len(handshake.read) + len(handshake.write)
        for line in lines:
            table = database.table(line.direction)
            assert table.rows[line.identity] == (line.name, line.length)
            assert table.value(line.identity).tolist() == line.values
            stamp = table.stamp(line.identity)
            assert stamp.seconds == line.seconds
            if has_micros or line.microseconds:
                assert stamp.microseconds == line.microseconds
            assert table.updated[line.identity] == line.updated
            if has_changed:
                assert table.changed[line.identity] == bool(line.changed)

    for data in handshake.data:
        database.table(data.direction).receive(data, updates=False)
    compare(tables[0])
    assert len(tables) == len(batches) + 2  # the original client prints the last sync twice
    for batch, request, lines in zip(batches, requests, tables[1:], strict=False):
        database.read.begin_round()
        database.write.begin_round(updates=False)
        for data in request.data:
            for identity, stamp, values in entries(data):
                database.write.set(identity, values, TimeStamp(*stamp))
        database.write.updated[database.write.dirty.take()] = False  # sent
        for data in batch.data:
            database.table(data.direction).receive(data, updates=data.direction == "r")
        compare(lines)


@pytest.mark.parametrize("name", STREAMS)
def test_decoding_does_not_depend_on_chunking(name: str) -> None:
    data = recorded.from_server(name)
    _, handshake, batches = whole(data)
    stream, found = ServerDecoder(), []
    for at in range(len(data)):
        stream.feed(data[at : at + 1])
        if stream.handshake is None:
            stream.take_handshake()
        else:
            found += batches_of(stream)
    assert stream.handshake is not None
    assert [plain(each) for each in found] == [plain(each) for each in batches]
    assert stream.handshake[:4] == handshake[:4]
    for ours, theirs in zip(stream.handshake.data, handshake.data, strict=True):
        assert ours.words.tolist() == theirs.words.tolist()


@pytest.mark.parametrize("name", STREAMS)
def test_decoding_works_when_cut_in_two_anywhere(name: str) -> None:
    """Every seventh byte is a cut. The recordings are similar, and each starts where another leaves gaps."""
    data = recorded.from_server(name)
    stream, handshake, batches = whole(data)
    if batches:
        # Keep the handshake and the last batches, which contain tables in one case.
        size = sum(batch.size for batch in batches)
        data = data[: len(data) - size] + data[len(data) - batches[-1].size :]
        batches = batches[-1:]
    for at in range(1 + list(STREAMS).index(name) % 7, len(data), 7):
        stream = ServerDecoder()
        stream.feed(data[:at])
        first = stream.take_handshake()
        early = batches_of(stream) if first is not None else []
        stream.feed(data[at:])
        second = stream.take_handshake()
        assert second is not None
        assert second[:4] == handshake[:4]
        assert [plain(each) for each in early + batches_of(stream)] == [plain(each) for each in batches]


@pytest.mark.parametrize("name", ["writer64", "writer64naive", "allwriters64_A", "second_writer_continues64"])
def test_request_decoding_does_not_depend_on_chunking(name: str) -> None:
    _, handshake, _ = whole(recorded.from_server(name))
    data = recorded.from_client(name)
    requests = requests_of(data, handshake)
    stream, found = ClientDecoder(TableLayout([row.length for row in handshake.write]), width=handshake.width), []
    for at in range(len(data)):
        stream.feed(data[at : at + 1])
        if stream.take_access() is not None:
            while (request := stream.take_request()) is not None:
                found.append(request)
    assert [(each.ready, plain(each)) for each in found] == [(each.ready, plain(each)) for each in requests]


@pytest.mark.parametrize("name", PRINTED)
def test_encoding_reproduces_the_recorded_bytes(name: str) -> None:
    data = recorded.from_server(name)
    _, handshake, batches = whole(data)
    database = Database(handshake.read, handshake.write)
    for package in handshake.data:
        database.table(package.direction).receive(package)
    again = database.encode_handshake(handshake.granted, handshake.width)
    for batch in batches:
        for package in batch.data:
            table = database.table(package.direction)
            table.receive(package)
            again += table.encode(package.ids, handshake.width)
        again += b"ee"
    assert again == data

    asked = encode_access(handshake.granted or "w")
    for request in requests_of(recorded.from_client(name), handshake):
        assert request.ready is not None
        asked += encode_ready(request.ready)
        for package in request.data:
            table = database.write
            table.receive(package)
            asked += encode_data("w", table.select(package.ids, handshake.width), table.values, table.stamps)
        asked += b"ee"
    assert asked == recorded.from_client(name)


def test_handshake_is_decoded_when_its_last_byte_arrives() -> None:
    for name, size in (("reader64", 1582), ("reader64naive", 1726)):
        stream = ServerDecoder()
        stream.feed(recorded.from_server(name)[: size - 1])
        assert stream.take_handshake() is None
        stream.feed(b"e")
        assert stream.take_handshake() is not None


def test_wrong_width_is_rejected_with_its_offset() -> None:
    stream = ServerDecoder(width=4)
    stream.feed(recorded.from_server("reader64"))
    with pytest.raises(PacketError, match="do not fit time stamps of 4 words") as caught:
        stream.take_handshake()
    assert caught.value.offset == 710  # 4 before byte 714, which section 12 states as the end of the id


def test_values_are_words_of_32_bits() -> None:
    _, handshake, _ = whole(recorded.from_server("reader64"))
    assert handshake.data[1].values.dtype == np.int32

"""The byte format: any bytes give a value or a documented error, and encoded data is decoded to the same values."""

from __future__ import annotations

import itertools
import struct
from collections.abc import Callable, Iterator, Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from linkcore.errors import BadValue, PacketError
from rhdlink.variables.database import Database, TimeStamp
from rhdlink.wire import decoder as decoder_module
from rhdlink.wire.data import DataPackage, Selection, TableLayout
from rhdlink.wire.decoder import ClientDecoder, Limits, ServerDecoder
from rhdlink.wire.messages import (
    END,
    Batch,
    Handshake,
    Request,
    SymbolRow,
    encode_access,
    encode_data,
    encode_ready,
    encode_table,
)
from rhdlink.wire.schema import schema
from tests.fakes.rhd import entries

names = st.text(st.characters(min_codepoint=1, max_codepoint=255), min_size=1, max_size=32)
rows = st.lists(st.builds(SymbolRow, names, st.integers(1, 9)), max_size=6).map(tuple)
widths = st.sampled_from([2, 4])
words = st.integers(-(2**31), 2**31 - 1)
stamps = st.builds(TimeStamp, st.integers(0, 2**32 - 1), st.integers(0, 999_999))
lengths = st.lists(st.integers(1, 9), min_size=1, max_size=8) | st.builds(
    lambda count, length: [length] * count, st.integers(1, 8), st.integers(1, 5)
)


@st.composite
def databases(draw: st.DrawFn) -> Database:
    database = Database(draw(rows), draw(rows))
    for table in (database.read, database.write):
        for identity, row in enumerate(table):
            table.set(identity, draw(st.lists(words, min_size=row.length, max_size=row.length)), draw(stamps))
    return database


def cut(data: bytes, cuts: Sequence[int]) -> list[bytes]:
    places = sorted({0, len(data), *(each % (len(data) + 1) for each in cuts)})
    return [data[begin:end] for begin, end in itertools.pairwise(places)]


def plain(found: Batch | Request | Handshake) -> object:
    data = [(each.direction, each.ids.tolist(), each.stamps.tolist(), each.values.tolist()) for each in found.data]
    if isinstance(found, Handshake):
        return (found[:4], data)
    return (found.ready, data) if isinstance(found, Request) else data


def read_server(pieces: Sequence[bytes], width: int | None = None, limits: Limits | None = None) -> list[object]:
    """Return all values that the decoder produces; an error is the last element."""
    stream = ServerDecoder(width=width, limits=limits)
    found: list[object] = []
    for piece in pieces:
        stream.feed(piece)
        try:
            if stream.handshake is None:
                handshake = stream.take_handshake()
                if handshake is None:
                    continue
                found.append(plain(handshake))
            while (batch := stream.take_batch()) is not None:
                found.append(plain(batch))
        except PacketError as error:
            return [*found, str(error)]
    return found


def read_client(pieces: Sequence[bytes], layout: TableLayout, width: int, limits: Limits | None = None) -> list[object]:
    stream = ClientDecoder(layout, width=width, limits=limits)
    found: list[object] = []
    for piece in pieces:
        stream.feed(piece)
        try:
            if stream.access is None:
                access = stream.take_access()
                if access is None:
                    continue
                found.append(access)
            while (request := stream.take_request()) is not None:
                found.append(plain(request))
        except PacketError as error:
            return [*found, str(error)]
    return found


# -- round trips -------------------------------------------------------------------------------


@pytest.mark.property
@given(databases(), st.sampled_from([None, "r", "w"]), widths, st.lists(st.integers(0, 10_000), max_size=6))
def test_handshake_survives_a_round_trip(database: Database, granted: str | None, width: int, cuts: list[int]) -> None:
    data = database.encode_handshake(granted, width)
    (found,) = read_server(cut(data, cuts), width)
    tables = (database.write, database.read)
    assert found == (
        (granted, width, tuple(database.write.rows), tuple(database.read.rows)),
        [(table.direction, list(range(len(table))), table.stamps.tolist(), table.values.tolist()) for table in tables],
    )


@pytest.mark.property
@given(databases(), widths)
def test_width_is_inferred_from_the_structure(database: Database, width: int) -> None:
    (found,) = read_server([database.encode_handshake("r", width)])
    if database.read.rows or database.write.rows:
        assert found == read_server([database.encode_handshake("r", width)], width)[0]


@pytest.mark.property
@given(lengths, widths, st.data())
def test_packages_survive_a_round_trip_and_match_construct(sizes: list[int], width: int, data: st.DataObject) -> None:
    layout = TableLayout(sizes)
    values = np.array(data.draw(st.lists(words, min_size=layout.words, max_size=layout.words)), np.int32)
    times = np.array([data.draw(stamps) for _ in sizes], np.int64).reshape(-1, 2)
    stream = ClientDecoder(layout, width=width)
    stream.feed(b"aw")
    stream.take_access()
    # Several packages use one decoder, because later packages are decoded with data remembered from earlier ones.
    for _ in range(4):
        ids = data.draw(st.lists(st.integers(0, len(sizes) - 1), max_size=len(sizes)))
        raw = encode_data("w", Selection(layout, np.array(ids, np.int64), width), values, times)
        oracle = schema("data", "client", sizes, width).parse(raw)
        assert [each.id for each in oracle["items"]] == ids
        for entry in oracle["items"]:
            start = int(layout.offsets[entry.id])
            assert list(entry.data) == values[start : start + sizes[entry.id]].tolist()
            seconds, micros = times[entry.id].tolist()
            assert list(entry.stamp) == ([seconds, micros] if width == 2 else [seconds, 0, micros, 0])
        if data.draw(st.booleans()):
            for byte in raw:
                stream.feed(bytes([byte]))
                assert stream.take_request() is None
            stream.feed(b"ee")
        else:
            stream.feed(raw + b"ee")
        request = stream.take_request()
        assert request is not None
        (package,) = request.data
        assert package.ids.tolist() == ids
        assert [(identity, stamp, value.tolist()) for identity, stamp, value in entries(package)] == [
            (each.id, tuple(times[each.id].tolist()), list(each.data)) for each in oracle["items"]
        ]


@pytest.mark.property
@given(rows)
def test_tables_match_construct(table: tuple[SymbolRow, ...]) -> None:
    declared = schema("table", "server")
    parsed = declared.parse(encode_table("r", table))
    assert [(row.name.rstrip(b"\0").decode("latin-1"), row.length) for row in parsed["items"]] == list(table)
    assert declared.build(parsed) == encode_table("r", table)


def test_small_packages_match_construct() -> None:
    assert schema("access", "client").build({"second": b"w"}) == encode_access("w")
    assert schema("ready", "client").build({"second": b"r"}) == encode_ready("r")
    assert schema("end", "server").parse(END).second == ord("e")


def test_64_bit_time_stamps_are_decoded() -> None:
    database = Database(read=[SymbolRow("tick", 1)])
    late = TimeStamp(2**33 + 5, 7)
    database.read.set(0, 1, late)
    (found,) = read_server([database.encode_handshake("r", 4)])
    assert found[1][1][2] == [list(late)]  # type: ignore[index]


def test_last_entry_of_a_repeated_variable_is_used() -> None:
    database = Database(write=[SymbolRow("a", 1), SymbolRow("b", 2)])
    stream = ClientDecoder(database.write.layout)
    entry = struct.Struct(">iiii")
    stream.feed(b"awdw" + struct.pack(">i", 2) + entry.pack(0, 1, 2, 10) + entry.pack(0, 3, 4, 20) + b"ee")
    stream.take_access()
    request = stream.take_request()
    assert request is not None
    database.write.receive(request.data[0])
    assert (database.write.value(0).tolist(), database.write.stamp(0)) == ([20], (3, 4))


@pytest.mark.parametrize(
    ("ids", "is_ordered", "values"),
    [
        ([], True, [0, 0, 0, 0, 0]),
        ([2], True, [0, 0, 0, 10, 0]),
        ([1, 2], True, [0, 10, 11, 12, 0]),
        ([0, 3], True, [10, 0, 0, 0, 11]),
        ([2, 1], False, [0, 11, 12, 10, 0]),
        ([1, 1], False, [0, 12, 13, 0, 0]),
        ([0, 0, 2], False, [11, 0, 0, 12, 0]),  # first and last are as far apart as in three consecutive ids
    ],
)
def test_values_are_assigned_to_their_variables(ids: list[int], is_ordered: bool, values: list[int]) -> None:
    database = Database(write=[SymbolRow("a", 1), SymbolRow("b", 2), SymbolRow("c", 1), SymbolRow("d", 1)])
    table = database.write
    found = Selection(table.layout, np.array(ids, np.int64), 2)
    assert found.is_ordered == is_ordered
    value = itertools.count(10)
    entries = [struct.pack(">3i", each, 0, 0) + b"".join(_int32(value, table.rows[each].length)) for each in ids]
    stream = ClientDecoder(table.layout)
    stream.feed(b"awdw" + struct.pack(">i", len(ids)) + b"".join(entries) + b"ee")
    stream.take_access()
    request = stream.take_request()
    assert request is not None
    table.receive(request.data[0])
    assert table.values.tolist() == values


@pytest.mark.parametrize("ids", [[], [0], [0, 1, 2], [1, 2], [2, 0]])
@pytest.mark.parametrize("sizes", [[2, 2, 2], [1, 3, 2]])
@pytest.mark.parametrize("width", [2, 4])
def test_entries_survive_a_round_trip(ids: list[int], sizes: list[int], width: int) -> None:
    """Variables of equal length are packed as a table, others one by one."""
    layout = TableLayout(sizes)
    values = np.arange(-3, layout.words - 3, dtype=np.int32)
    high = 7 << 32 if width == 4 else 0
    times = np.array([[high + 2**31 + each, high + each] for each in range(3)], np.int64)
    selection = Selection(layout, np.array(ids, np.int64), width)
    raw, own = b"", []
    for each in ids:
        words = [word for number in times[each].tolist() for word in (number & 0xFFFFFFFF, number >> 32)[: width // 2]]
        own += values[sum(sizes[:each]) : sum(sizes[: each + 1])].tolist()
        raw += struct.pack(f">i{width}I{sizes[each]}i", each, *words, *own[len(own) - sizes[each] :])
    assert selection.pack(values, times) == raw
    package = DataPackage.read("r", selection, b"head" + raw, 4)
    assert (package.values.tolist(), package.stamps.tolist()) == (own, times[ids].tolist())


def _int32(values: Iterator[int], count: int) -> Iterator[bytes]:
    return (struct.pack(">i", next(values)) for _ in range(count))


def test_package_must_not_have_more_entries_than_variables() -> None:
    raw = b"awdw" + struct.pack(">i", 2) + 2 * struct.pack(">iiii", 0, 0, 0, 0) + b"ee"
    assert "counts 2; expected 0 to 1" in str(read_client([raw], TableLayout([1]), 2)[-1])


# -- invalid data ------------------------------------------------------------------------------

HANDSHAKE = Database(
    read=[SymbolRow("tick", 1), SymbolRow("line", 8)], write=[SymbolRow("speed", 1), SymbolRow("arm", 3)]
).encode_handshake("r")
#: Offsets of packages in the handshake, which consists of ar, tw and its rows, tr and its rows, dw, and dr.
TW, TR, DW, DR = 2, 2 + 80, 2 + 160, 2 + 160 + 6 + 12 + 12 + 12 + 4


def changed(at: int, what: bytes) -> bytes:
    return HANDSHAKE[:at] + what + HANDSHAKE[at + len(what) :]


@pytest.mark.parametrize(
    ("data", "reason", "offset"),
    [
        (b"xr", "expected 'tw'", 0),
        (b"ax", "expected 'ar' or 'aw'", 1),
        (b"ee", "expected 'tw'", 0),
        (changed(TW, b"tr"), "expected 'tw'", TW),
        (changed(TR, b"tw"), "expected 'tr'", TR),
        (changed(TW + 2, struct.pack(">i", -1)), "counts -1; expected 0 to 8192", TW + 2),
        (changed(TW + 2, struct.pack(">i", 1 << 26)), "counts 67108864", TW + 2),
        (changed(TW + 6, struct.pack(">i", 0)), "has 0 words", TW + 6),
        (changed(TW + 6, struct.pack(">i", -1)), "has -1 words", TW + 6),
        (changed(TW + 6, struct.pack(">i", 1 << 30)), "has 1073741824 words", TW + 6),
        (changed(TW + 10, b"n" * 33), "has no end within 33 bytes", TW + 10),
        (changed(DW, b"dr"), "expected b'dw", DW),
        (changed(DW + 2, struct.pack(">i", 1)), "expected b'dw", DW),
        (changed(DW + 6, struct.pack(">i", 1)), r"expected b'\x00\x00\x00\x00'", DW + 6),
        (changed(len(HANDSHAKE) - 2, b"xx"), "expected b'e'", len(HANDSHAKE) - 2),
    ],
)
def test_invalid_handshake_raises_reason_and_offset(data: bytes, reason: str, offset: int) -> None:
    stream = ServerDecoder(width=2)
    stream.feed(data)
    with pytest.raises(PacketError) as caught:
        stream.take_handshake()
    assert reason in str(caught.value)
    assert caught.value.offset == offset
    # The decoder keeps its error, and no longer stores received data.
    stream.feed(HANDSHAKE)
    with pytest.raises(PacketError) as again:
        stream.take_handshake()
    assert again.value is caught.value
    assert stream.waiting == 0


@pytest.mark.parametrize(
    ("data", "reason", "offset"),
    [
        (b"rr", "expected 'dr', 'dw' or 'ee'", 0),
        (b"ar", "expected 'dr', 'dw' or 'ee'", 0),
        (b"dx", "expected 'dr', 'dw' or 'ee'", 0),
        (b"dr" + struct.pack(">i", 3), "counts 3; expected 0 to 2", 2),
        (b"dr" + struct.pack(">i", -1), "counts -1", 2),
        (b"dr" + struct.pack(">ii", 1, 2), "entry of variable 2 in 'dr'; expected 0 to 1", 6),
        (b"dr" + struct.pack(">ii", 1, -1), "entry of variable -1", 6),
        (b"dr" + struct.pack(">ii", 1, 1000000), "entry of variable 1000000", 6),
        (b"dr" + struct.pack(">iiiii", 2, 0, 0, 0, 0) + struct.pack(">i", 2**31 - 1), "of variable 2147483647", 22),
        (encode_table("r", [SymbolRow("tick", 2)]), "table 'tr' differs from the table in the handshake", 0),
    ],
)
def test_invalid_batch_raises_reason_and_offset(data: bytes, reason: str, offset: int) -> None:
    stream = ServerDecoder()
    stream.feed(HANDSHAKE + data)
    stream.take_handshake()
    with pytest.raises(PacketError) as caught:
        stream.take_batch()
    assert reason in str(caught.value)
    assert f"batch at byte {len(HANDSHAKE)}" in str(caught.value)
    assert caught.value.offset == offset


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"dr\0\0\0\0", "expected 'rr', 'rw', 'dw' or 'ee'"),
        (b"rx", "expected 'rr', 'rw', 'dw' or 'ee'"),
        (b"tw", "expected 'rr', 'rw', 'dw' or 'ee'"),
        (b"dw" + struct.pack(">ii", 1, 100), "entry of variable 100 in 'dw'; expected 0 to 1"),
        (b"dw" + struct.pack(">ii", 1, -1), "entry of variable -1"),
        (b"dw" + struct.pack(">ii", 1, 2), "entry of variable 2"),
        (b"dw" + struct.pack(">i", -1), "counts -1; expected 0 to 2"),
        (b"dw" + struct.pack(">i", 2**31 - 1), "counts 2147483647"),
    ],
)
def test_invalid_request_raises_the_reason(data: bytes, reason: str) -> None:
    for pieces in ([b"aw" + data], [bytes([byte]) for byte in b"aw" + data]):
        found = read_client(pieces, TableLayout([1, 3]), 2)
        assert found[0] == "w"
        assert reason in str(found[-1])


@pytest.mark.parametrize("data", [b"x", b"ax", b"ww", b"ra"])
def test_invalid_access_request_is_rejected(data: bytes) -> None:
    assert "expected 'ar' or 'aw'" in str(read_client([data], TableLayout([1]), 2)[-1])


def test_limits_of_a_handshake_are_enforced() -> None:
    for limits, reason in (
        (Limits(variables=1), "counts 2; expected 0 to 1"),
        (Limits(length=7), "variable 1 has 8 words; expected 1 to 7"),
        (Limits(words=3), "has 4 words; expected at most 3"),
        (Limits(batch=len(HANDSHAKE) - 1), f"no end within {len(HANDSHAKE) - 1} bytes"),
        (Limits(batch=100), "no end within 100 bytes"),
    ):
        assert reason in str(read_server([HANDSHAKE], limits=limits)[-1])
    # The tables alone show that the handshake is too large, before its values have arrived.
    assert "no end within" in str(read_server([HANDSHAKE[:DW]], limits=Limits(batch=len(HANDSHAKE) - 1))[-1])
    assert read_server([HANDSHAKE[:DW]], limits=Limits(batch=len(HANDSHAKE))) == []
    assert Limits() == Limits(variables=8192, length=4096, words=1_048_576, batch=16_777_216)
    (found,) = read_server([HANDSHAKE], limits=Limits(variables=2, length=8, words=9, batch=len(HANDSHAKE)))
    assert not isinstance(found, str)


def test_largest_allowed_batch_is_accepted() -> None:
    batch = b"dr\0\0\0\0" * 100 + b"ee"
    for pieces in ([HANDSHAKE, batch], [HANDSHAKE, *(batch[at : at + 1] for at in range(len(batch)))]):
        assert read_server(pieces, limits=Limits(batch=len(batch)))[-1] == [("r", [], [], [])] * 100
        # The batch is also rejected if only its end exceeds the limit.
        for size in (len(batch) - 1, len(batch) - 2):
            assert f"no end within {size} bytes" in str(read_server(pieces, limits=Limits(batch=size))[-1])


def test_too_large_package_is_rejected_before_it_arrives() -> None:
    limits = Limits(batch=1000)
    layout = TableLayout([1, 300])
    announced = b"dw" + struct.pack(">ii", 2, 1)
    assert "no end within 1000 bytes" in str(read_client([b"aw", announced], layout, 2, limits)[-1])
    table = b"tr" + struct.pack(">i", 100)
    for rows in (table, table + bytes(1000)):
        found = read_server([HANDSHAKE, rows], limits=limits)
        assert ("no end within" in str(found[-1])) == (len(rows) > 1000)


def test_decoder_reuses_selection_if_variables_are_the_same(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """With eleven kinds of packages, including an empty one, the first is forgotten when the eleventh arrives."""
    layout = TableLayout([1] * 10)
    decoder = ClientDecoder(layout)
    decoder.feed(b"aw")
    decoder.take_access()
    values, times = np.zeros(10, np.int32), np.zeros((10, 2), np.int64)

    def send(count: int) -> Selection:
        decoder.feed(encode_data("w", Selection(layout, np.arange(count), 2), values, times) + b"ee")
        request = decoder.take_request()
        assert request is not None
        return request.data[0].selection

    kinds = [send(count) for count in range(10)]
    with monkeypatch.context() as patched:
        patched.setattr(decoder_module, "Cursor", None)  # single entries must not be read
        assert [send(count) for count in range(10)] == kinds
    send(10)
    assert send(0) is not kinds[0]
    assert send(9) is kinds[9]


@pytest.mark.parametrize("name", ["variables", "length", "words", "batch"])
def test_limits_must_be_positive(name: str) -> None:
    with pytest.raises(BadValue, match=f"Limits.{name} is 0"):
        Limits(**{name: 0})


def test_batch_without_an_end_is_rejected() -> None:
    limits = Limits(batch=1000)
    for endless in (b"dr\0\0\0\0" * 300, encode_table("r", [SymbolRow("tick", 1), SymbolRow("line", 8)]) * 30):
        assert "no end within 1000 bytes" in str(read_server([HANDSHAKE, endless], limits=limits)[-1])
    for endless in (b"rr" * 600, b"dw\0\0\0\0" * 300):
        assert "no end within 1000 bytes" in str(read_client([b"ar", endless], TableLayout([1]), 2, limits)[-1])


@pytest.mark.parametrize("width", [0, 1, 3, 8])
def test_decoders_reject_invalid_widths(width: int) -> None:
    with pytest.raises(BadValue, match="expected 2 or 4"):
        ServerDecoder(width=width)
    with pytest.raises(BadValue, match="expected 2 or 4"):
        ClientDecoder(TableLayout([1]), width=width)


def test_largest_allowed_row_is_encoded() -> None:
    assert encode_table("r", [SymbolRow("n" * 32, 2**31 - 1)]) == b"tr\0\0\0\1\x7f\xff\xff\xff" + b"n" * 32 + b"\0"


@pytest.mark.parametrize(
    "row", [SymbolRow("n" * 33, 1), SymbolRow("a\0b", 1), SymbolRow("€", 1), SymbolRow("a", 0), SymbolRow("a", 1 << 31)]
)
def test_invalid_rows_are_rejected(row: SymbolRow) -> None:
    with pytest.raises(BadValue):
        encode_table("r", [row])


@pytest.mark.parametrize("encode", [encode_access, encode_ready, lambda letter: encode_table(letter, [])])
def test_invalid_directions_are_rejected(encode: Callable[[str], bytes]) -> None:
    with pytest.raises(BadValue, match="expected 'r' or 'w'"):
        encode("x")


def test_decoders_require_the_handshake_first() -> None:
    with pytest.raises(BadValue, match="before take_handshake"):
        ServerDecoder().take_batch()
    with pytest.raises(BadValue, match="before take_access"):
        ClientDecoder(TableLayout([1])).take_request()


def bytewise(data: bytes) -> list[bytes]:
    return [data[at : at + 1] for at in range(len(data))]


def test_decoding_does_not_depend_on_chunking() -> None:
    table = encode_table("r", [SymbolRow("tick", 1), SymbolRow("line", 8)])
    one = b"dr" + struct.pack(">i4i", 1, 0, 5, 6, 7)
    server = HANDSHAKE + one + b"ee" + table + one + b"dw\0\0\0\0ex" + b"ee"
    data = ("r", [0], [[5, 6]], [7])
    found = [[data], [data, ("w", [], [], [])], []]
    for width in (2, None):
        assert read_server([server], width)[1:] == read_server(bytewise(server), width)[1:] == found
    two = b"dw" + struct.pack(">i4i6i", 2, 0, 1, 2, 3, 1, 4, 5, 6, 7, 8)
    client = b"aw" + b"rwee" + two + b"rree" + two + b"ee" + b"rrrwee"
    written = ("w", [0, 1], [[1, 2], [4, 5]], [3, 6, 7, 8])
    requests = ["w", ("w", []), ("r", [written]), (None, [written]), ("w", [])]
    for cuts in ([client], bytewise(client)):
        assert read_client(cuts, TableLayout([1, 3]), 2) == requests
    assert read_client([b"ar"], TableLayout([1]), 2) == ["r"]


def test_received_pieces_are_appended_without_copies() -> None:
    decoder = ClientDecoder(TableLayout([1]))
    decoder.feed(b"aw")
    decoder.take_access()
    for piece in (b"r", b"r"):
        decoder.feed(piece)
    buffer = decoder._buffer
    for _ in range(100):
        decoder.feed(b"dw\0\0\0\0")
        assert decoder._buffer is buffer
    # Decoded data is removed when more data arrives.
    decoder.feed(b"eer")
    assert decoder.take_request() is not None
    decoder.feed(b"r")
    assert decoder.waiting == len(decoder._buffer) == 2


# -- any bytes ---------------------------------------------------------------------------------

pieces = st.sampled_from(
    [b"ar", b"aw", b"tw", b"tr", b"dw", b"dr", b"ee", b"rr", b"rw", b"\0\0\0\0", b"\0\0\0\1", b"\0\0\0\2"]
) | st.binary(max_size=12)
noise = st.lists(pieces, max_size=30).map(b"".join)
places = st.lists(st.integers(0, 10_000), max_size=8)


@pytest.mark.property
@given(noise, places, st.sampled_from([None, 2, 4]))
def test_any_server_bytes_do_not_depend_on_chunking(data: bytes, cuts: list[int], width: int | None) -> None:
    assert read_server(cut(data, cuts), width) == read_server([data], width)


@pytest.mark.property
@given(noise, places)
def test_bytes_after_a_handshake_do_not_depend_on_chunking(data: bytes, cuts: list[int]) -> None:
    limits = Limits(batch=4096)
    assert read_server([HANDSHAKE, *cut(data, cuts)], None, limits) == read_server([HANDSHAKE, data], None, limits)


@pytest.mark.property
@given(noise, places, widths, lengths)
def test_any_client_bytes_do_not_depend_on_chunking(data: bytes, cuts: list[int], width: int, sizes: list[int]) -> None:
    layout = TableLayout(sizes)
    assert read_client(cut(data, cuts), layout, width) == read_client([data], layout, width)


@pytest.mark.property
@given(databases(), st.integers(0, 10_000), st.integers(0, 255), places)
def test_corrupted_handshake_result_does_not_depend_on_chunking(
    database: Database, at: int, byte: int, cuts: list[int]
) -> None:
    data = bytearray(database.encode_handshake("r"))
    data[at % len(data)] = byte
    assert read_server(cut(bytes(data), cuts)) == read_server([bytes(data)])


@pytest.mark.property
@given(st.data())
def test_package_with_many_entries_decodes_when_split_anywhere(data: st.DataObject) -> None:
    """Data remembered from the last package speeds up the next one, but must never change it."""
    count = data.draw(st.integers(2, 40))
    sizes = data.draw(st.lists(st.integers(1, 3), min_size=count, max_size=count))
    layout = TableLayout(sizes)
    values, times = np.arange(layout.words, dtype=np.int32), np.zeros((count, 2), np.int64)
    stream = ClientDecoder(layout)
    stream.feed(b"aw")
    stream.take_access()
    ids = list(range(count))
    for _ in range(4):
        if data.draw(st.booleans()):
            one, other = data.draw(st.tuples(st.integers(0, count - 1), st.integers(0, count - 1)))
            ids[one], ids[other] = ids[other], ids[one]
        raw = encode_data("w", Selection(layout, np.array(ids), 2), values, times) + b"ee"
        for piece in cut(raw, data.draw(places)):
            assert stream.take_request() is None
            stream.feed(piece)
        request = stream.take_request()
        assert request is not None
        assert request.data[0].ids.tolist() == ids


def test_printed_schema_shows_the_fields_of_a_package() -> None:
    lines = str(schema("data", "server", lengths=[1, 3])).splitlines()
    assert lines[0] == "data, size varies"
    assert [line.split()[1:3] for line in lines[2:5]] == [
        ["letter", "Bytes[1]"],
        ["second", "Bytes[1]"],
        ["items", "Struct[...],"],
    ]
    assert [line.split()[:2] for line in lines[5:]] == [
        ["id", "Int32sb"],
        ["stamp", "Int32ub[2]"],
        ["data", "Int32sb[...]"],
    ]

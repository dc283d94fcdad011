"""Decoders and dissection come from the same declaration and must agree on any bytes."""

from __future__ import annotations

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from linkcore.errors import PacketError
from rhdlink.variables.database import Database
from rhdlink.wire.data import DataPackage, TableLayout
from rhdlink.wire.decoder import ClientDecoder, ServerDecoder
from rhdlink.wire.dissection import Piece, dissect
from rhdlink.wire.messages import SymbolRow
from tests.fakes.rhd import entries

READ, WRITE = (SymbolRow("tick", 1), SymbolRow("scan", 3)), (SymbolRow("speed", 1), SymbolRow("arm", 2))
TABLES: dict[str, tuple[SymbolRow, ...]] = {"r": READ, "w": WRITE}


def int32(*values: int) -> bytes:
    return b"".join(value.to_bytes(4, "big", signed=True) for value in values)


small = st.integers(-1, 3)
words = st.integers(-(2**31), 2**31 - 1)


@st.composite
def packages(draw: st.DrawFn, width: int, sender: str) -> bytes:
    """Draw a package that is valid or almost valid."""
    kind = draw(st.sampled_from("derrrtx" if sender == "client" else "dddetxr"))
    if kind == "d":
        direction = draw(st.sampled_from("wwwr" if sender == "client" else "rw"))
        lengths = [row.length for row in TABLES[direction]]
        ids = draw(st.lists(st.sampled_from([0, 1, 0, 1, 0, 1, -1, 2]), max_size=2))
        count = draw(st.sampled_from([len(ids)] * 9 + [len(ids) + 1]))
        entries = b""
        for identity in ids:
            length = lengths[identity] if 0 <= identity < 2 else 1
            entries += int32(identity, *draw(st.lists(words, min_size=width + length, max_size=width + length)))
        return f"d{direction}".encode() + int32(count) + entries
    if kind == "t":
        return b"tr" + int32(2) + b"".join(int32(row.length) + row.name.encode().ljust(33, b"\0") for row in READ)
    return {"e": b"ee", "r": draw(st.sampled_from([b"rr", b"rw", b"rx"])), "x": draw(st.binary(max_size=3))}[kind]


@pytest.mark.parametrize(
    ("words", "stamp"),
    [
        ((0, 0, 0, 0), [0, 0]),
        ((5, 1, 999_999, 0), [(1 << 32) + 5, 999_999]),
        ((-1, 0, 7, 0), [(1 << 32) - 1, 7]),
        ((-5, -1, -1, -1), [-5, -1]),
        ((0, -(2**31), 0, 2**31 - 1), [-(2**63), (2**31 - 1) << 32]),
    ],
)
def test_four_word_time_stamps_are_signed_64_bit_numbers(words: tuple[int, ...], stamp: list[int]) -> None:
    (piece,) = dissect(b"dw" + int32(1, 0, *words, 8), "client", TABLES, 4)
    assert piece.parts[1].content["stamp"] == stamp


def test_variable_without_words_is_shown() -> None:
    """The decoders reject such a variable, which servers never have, but the dissection shows it."""
    table = b"tw" + int32(1, 0) + b"none".ljust(33, b"\0")
    (_, piece) = dissect(table + b"dw" + int32(1, 0, 1, 2), "server")
    assert (piece.error, piece.parts[1].content["words"]) == (None, [])


def decoded(package: DataPackage) -> list[tuple[int, tuple[int, ...], list[int]]]:
    return [(identity, stamp, values.tolist()) for identity, stamp, values in entries(package)]


def shown(piece: Piece) -> list[tuple[int, tuple[int, ...], list[int]]]:
    return [
        (part.content["id"], tuple(part.content["stamp"]), part.content["words"])
        for part in piece.parts
        if "words" in part.content
    ]


def shown_batches(pieces: list[Piece]) -> list[list[list[tuple[int, tuple[int, ...], list[int]]]]]:
    """Return the data packages of each complete batch, up to the first invalid piece."""
    batches: list[list[list[tuple[int, tuple[int, ...], list[int]]]]] = []
    current: list[list[tuple[int, tuple[int, ...], list[int]]]] = []
    for piece in pieces:
        if piece.error is not None:
            break
        if piece.package[0] == "e":
            batches.append(current)
            current = []
        elif piece.package[0] == "d":
            current.append(shown(piece))
    return batches


@pytest.mark.property
@given(st.data(), st.sampled_from([2, 4]))
def test_dissection_agrees_with_the_decoder_of_client_bytes(data: st.DataObject, width: int) -> None:
    raw = b"".join(data.draw(st.lists(packages(width, "client"), max_size=8)))
    decoder = ClientDecoder(TableLayout([row.length for row in WRITE]), width=width)
    decoder.feed(b"aw" + raw)
    decoder.take_access()
    batches, refused = [], False
    try:
        while (request := decoder.take_request()) is not None:
            batches.append([decoded(package) for package in request.data])
    except PacketError:
        refused = True
    pieces = list(dissect(raw, "client", TABLES, width))
    assert b"".join(part.data for piece in pieces for part in piece.parts) == raw
    assert shown_batches(pieces) == batches
    # The dissection shows access requests anywhere; it does not know that only the first bytes can be one.
    assume(all(piece.package[:1] != "a" for piece in pieces))
    # The dissection must mark everything that the decoder rejects. Incomplete data makes the decoder wait.
    wrong = [piece.error for piece in pieces if piece.error is not None]
    assert refused == bool(wrong and not any("ends within" in error or "one byte" in error for error in wrong))


@pytest.mark.property
@given(st.data(), st.sampled_from([2, 4]))
def test_dissection_agrees_with_the_decoder_of_server_bytes(data: st.DataObject, width: int) -> None:
    greeting = Database(READ, WRITE).encode_handshake("r", width)
    raw = b"".join(data.draw(st.lists(packages(width, "server"), max_size=8)))
    decoder = ServerDecoder(width=width)
    decoder.feed(greeting + raw)
    handshake = decoder.take_handshake()
    assert handshake is not None
    batches, refused = [[decoded(package) for package in handshake.data]], False
    try:
        while (batch := decoder.take_batch()) is not None:
            batches.append([decoded(package) for package in batch.data])
    except PacketError:
        refused = True
    pieces = list(dissect(greeting + raw, "server", width=width))
    assert b"".join(part.data for piece in pieces for part in piece.parts) == greeting + raw
    assert shown_batches(pieces) == batches
    assume(all(piece.package[:1] != "a" for piece in pieces[1:]))
    wrong = [piece.error for piece in pieces if piece.error is not None]
    assert refused == bool(wrong and not any("ends within" in error or "one byte" in error for error in wrong))

"""Layouts compared with bytes written by hand: every offset in this module was counted independently of the code."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import pytest

from linkcore.errors import BadValue, LocalError, PacketError
from linkcore.wire.fields import (
    Coded,
    Float32b,
    Float64b,
    Header,
    Int8sb,
    Int8ub,
    Int16ub,
    Int32sb,
    Int32ub,
    Mask64,
    OpenInt,
    Text,
)
from linkcore.wire.packet import IntVector, State, Vector, packet, wire
from tests.oracle import parse

SIZE = Header(size=Int32sb)
SIZE_AND_TYPE = Header(size=Int32sb, type=Int8ub)


class Mode(OpenInt):
    IDLE = 5


@packet(header=SIZE)
class Cells(State):
    """State of 8-byte cells only, so all bytes are swapped in one step."""

    time: float = wire(Float64b, "s", "time")
    q: Vector = wire(Float64b[3], "rad", "joints")
    bits: int = wire(Mask64, "bits", "inputs")
    mode: Mode = wire(Coded(Float64b, Mode), "", "mode")
    modes: tuple[Mode, ...] = wire(Coded(Float64b, Mode)[2], "", "modes")


CELLS = struct.pack(">i d 3d Q d 2d", 68, 1.5, -1.0, 0.25, 1e300, 0x1234, 5.0, 5.0, 77.0)


@packet(header=SIZE_AND_TYPE, type=7)
class Mixed(State):
    """State with fields of all widths, and two interleaved fields."""

    count: int = wire(Int16ub, "", "count")
    currents: Vector = wire(Float32b[2], "A", "currents")
    q: Vector = wire(Float64b[2], "rad", "joints", interleave="joint")
    modes: tuple[Mode, ...] = wire(Coded(Int8ub, Mode)[2], "", "modes", interleave="joint")
    checksum: IntVector = wire(Int32ub[2], "", "checksum")
    flag: bool = wire(Coded(Int8ub, bool), "", "flag")


MIXED = struct.pack(">iB H 2f dBdB 2I B", 42, 7, 500, 0.5, -2.0, 1.25, 5, -1.25, 200, 1, 2**32 - 1, 1)


@packet(header=SIZE_AND_TYPE, type=8)
class Note(State):
    """State with text, so its number of bytes is not fixed."""

    number: int = wire(Int16ub, "", "number")
    title: str = wire(Text(Int8ub), "", "title")
    level: int = wire(Int8sb, "", "level")
    text: str = wire(Text(least=2), "", "text")


NOTE = struct.pack(">iB H B 3s b 4s", 16, 8, 300, 3, b"top", -2, b"body")


def plain(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray) else value


@pytest.mark.parametrize(
    ("cls", "data", "values"),
    [
        (
            Cells,
            CELLS,
            {
                "time": 1.5,
                "q": [-1.0, 0.25, 1e300],
                "bits": 0x1234,
                "mode": Mode.IDLE,
                "modes": (Mode.IDLE, Mode(77)),
            },
        ),
        (
            Mixed,
            MIXED,
            {
                "count": 500,
                "currents": [0.5, -2.0],
                "q": [1.25, -1.25],
                "modes": (Mode.IDLE, Mode(200)),
                "checksum": [1, 2**32 - 1],
                "flag": True,
            },
        ),
        (Note, NOTE, {"number": 300, "title": "top", "level": -2, "text": "body"}),
    ],
)
def test_layout_reads_and_writes_handwritten_bytes(cls: type[State], data: bytes, values: dict[str, Any]) -> None:
    layout = cls.LAYOUTS.of()
    state = layout.decode(data)
    assert {name: plain(getattr(state, name)) for name in values} == values
    assert layout.encode(values) == data
    slowly = parse(layout, data)
    assert {name: list(value) if isinstance(value, list) else value for name, value in slowly.items()} == {
        name: list(value) if isinstance(value, (list, tuple)) else value for name, value in values.items()
    }
    assert state.tail == b""
    assert layout.decode(data + b"more").tail == (b"" if layout.has_text else b"more")


def test_layout_has_correct_sizes_offsets_and_strides() -> None:
    assert Cells.LAYOUTS.of().size == 68
    assert {name: place.offset for name, place in Cells.LAYOUTS.of().places.items()} == {
        "time": 4,
        "q": 12,
        "bits": 36,
        "mode": 44,
        "modes": 52,
    }
    mixed = Mixed.LAYOUTS.of()
    assert mixed.size == 42
    assert {name: (place.offset, place.stride) for name, place in mixed.places.items()} == {
        "count": (5, 2),
        "currents": (7, 4),
        "q": (15, 9),
        "modes": (23, 9),
        "checksum": (33, 4),
        "flag": (41, 1),
    }
    # For a layout with text, the size is the minimum, and the offsets assume empty text.
    assert Note.LAYOUTS.of().size == 9
    assert repr(Note.LAYOUTS.of()) == "<Layout Note since 0.0, 9+ bytes>"
    assert repr(mixed) == "<Layout Mixed since 0.0, 42 bytes>"


def test_vectors_are_read_only_with_the_declared_type() -> None:
    cells, mixed = Cells.LAYOUTS.of().decode(CELLS), Mixed.LAYOUTS.of().decode(MIXED)
    for vector in (cells.q, mixed.currents, mixed.q):
        assert vector.dtype == np.float64
        assert vector.dtype.isnative
    # The width is the width on the wire, which may differ from the width of a C long.
    assert mixed.checksum.dtype == np.uint32
    for vector in (cells.q, mixed.currents, mixed.q, mixed.checksum):
        with pytest.raises(ValueError, match="read-only"):
            vector[0] = 1


@pytest.mark.parametrize(("cls", "data"), [(Cells, CELLS), (Mixed, MIXED), (Note, NOTE)])
def test_short_packet_error_reports_lengths(cls: type[State], data: bytes) -> None:
    layout = cls.LAYOUTS.of()
    for length in range(5, layout.size):
        with pytest.raises(PacketError, match="the packet is too short") as caught:
            layout.decode(data[:length])
        error = caught.value
        assert (error.packet, error.expected, error.actual, error.offset) == (
            cls.__name__,
            layout.size,
            length,
            length,
        )


def test_decode_error_behind_a_text_reports_its_real_offset() -> None:
    layout = Note.LAYOUTS.of()
    with pytest.raises(PacketError, match="title runs past the end") as caught:
        layout.decode(struct.pack(">iB H B 2s", 10, 8, 300, 3, b"to"))
    assert (caught.value.offset, caught.value.expected, caught.value.actual) == (7, 11, 10)
    with pytest.raises(PacketError, match="level runs past the end") as caught:
        layout.decode(struct.pack(">iB H B 3s", 11, 8, 300, 3, b"top"))
    # The offset is after three characters of text, not the offset for empty text.
    assert (caught.value.offset, caught.value.expected, caught.value.actual) == (11, 12, 11)
    with pytest.raises(PacketError, match="text is too short") as caught:
        layout.decode(NOTE[:-3])
    assert (caught.value.offset, caught.value.expected, caught.value.actual) == (12, 2, 1)


def test_omitted_fields_are_encoded_as_zero() -> None:
    assert Cells.LAYOUTS.of().encode({}) == struct.pack(">i8x24x8x8x16x", 68)
    assert Mixed.LAYOUTS.of().encode({}) == struct.pack(">iB37x", 42, 7)
    assert Note.LAYOUTS.of().encode({}) == struct.pack(">iB4x", 9, 8)


def test_tail_is_included_in_the_size() -> None:
    data = Mixed.LAYOUTS.of().encode({"count": 500}, tail=b"new")
    assert data[:5] == struct.pack(">iB", 45, 7)
    assert Mixed.LAYOUTS.decode(data).tail == b"new"


@pytest.mark.parametrize(
    ("cls", "fields"),
    [
        (Cells, {"speed": 1.0}),
        (Cells, {"time": "late"}),
        (Cells, {"time": None}),
        (Cells, {"time": 10**400}),
        (Cells, {"time": 1j}),
        (Cells, {"q": [1.0, 2.0]}),
        (Cells, {"q": 1.0}),
        (Cells, {"q": ["a", "b", "c"]}),
        (Cells, {"q": [[1.0], [2.0, 3.0], [4.0]]}),
        (Cells, {"bits": -1}),
        (Cells, {"bits": 2**64}),
        (Cells, {"bits": float("nan")}),
        (Cells, {"bits": "all"}),
        (Cells, {"mode": "IDLE"}),
        (Cells, {"modes": [5]}),
        (Mixed, {"speed": 1}),
        (Mixed, {"count": 65536}),
        (Mixed, {"count": -1}),
        (Mixed, {"count": 1.5}),
        (Mixed, {"count": "1"}),
        (Mixed, {"currents": [1.0]}),
        (Mixed, {"currents": [1e39, 0.0]}),
        (Mixed, {"currents": "ab"}),
        (Mixed, {"q": 5}),
        (Mixed, {"modes": [300, 0]}),
        (Mixed, {"modes": [None, 0]}),
        (Mixed, {"checksum": [2**32, 0]}),
        (Note, {"title": "x" * 256}),
        (Note, {"level": 128}),
    ],
)
def test_encode_rejects_invalid_values(cls: type[State], fields: dict[str, Any]) -> None:
    with pytest.raises(BadValue) as caught:
        cls.LAYOUTS.of().encode(fields)
    assert isinstance(caught.value, (LocalError, ValueError))
    assert next(iter(fields)) in str(caught.value)


def test_dtype_reads_many_packets_at_once() -> None:
    table = np.frombuffer(CELLS + CELLS, Cells.dtype())
    assert table.dtype.itemsize == 68
    assert table["message_size"].tolist() == [68, 68]
    assert table["q"].tolist() == [[-1.0, 0.25, 1e300]] * 2
    assert table["bits"].tolist() == [0x1234] * 2
    (mixed,) = np.frombuffer(MIXED, Mixed.dtype())
    assert mixed.dtype.itemsize == 42
    assert mixed["joint"]["q"].tolist() == [1.25, -1.25]
    assert mixed["joint"]["modes"].tolist() == [5, 200]
    assert mixed["checksum"].tolist() == [1, 2**32 - 1]
    assert mixed["flag"] == 1
    with pytest.raises(BadValue, match="Note contains text"):
        Note.dtype()


def test_dissection_covers_every_byte_once() -> None:
    for cls, data in ((Cells, CELLS), (Mixed, MIXED), (Note, NOTE), (Mixed, MIXED + b"tail")):
        rows = sorted(cls.LAYOUTS.of().decode(data).dissect(), key=lambda row: row.offset)
        assert b"".join(row.data for row in rows) == data
        assert [row.offset for row in rows] == [sum(len(row.data) for row in rows[:n]) for n in range(len(rows))]
    rows = list(Mixed.LAYOUTS.of().decode(MIXED + b"tail").dissect())
    assert [(row.name, row.offset) for row in rows] == [
        ("size", 0),
        ("type", 4),
        ("count", 5),
        ("currents", 7),
        ("q[0]", 15),
        ("modes[0]", 23),
        ("q[1]", 24),
        ("modes[1]", 32),
        ("checksum", 33),
        ("flag", 41),
        ("tail", 42),
    ]
    assert {row.name: row.value for row in rows}["q[1]"] == -1.25
    assert {row.name: row.unit for row in rows}["q[1]"] == "rad"
    text = {row.name: row.value for row in Note.LAYOUTS.of().decode(NOTE).dissect()}
    assert text == {"size": 16, "type": 8, "number": 300, "title": "top", "level": -2, "text": "body"}

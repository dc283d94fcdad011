"""Packets: declared fields, layouts for each version, and states."""

from __future__ import annotations

import copy
import pickle
import struct
from typing import Any

import numpy as np
import pytest

from linkcore.clock import Stamp
from linkcore.errors import PacketError
from linkcore.wire.fields import Coded, Float64b, Header, Int8ub, Int16ub, Int32sb, Int32ub, OpenInt, Raw, Text
from linkcore.wire.packet import IntVector, State, Vector, packet, wire

SIZE = Header(size=Int32sb)
SIZE_AND_TYPE = Header(size=Int32sb, type=Int8ub)


class Colour(OpenInt):
    RED = 1


@packet(header=SIZE, reorder=("2.0", ["time", "force", "pose"]))
class Grown(State):
    """State whose fields were appended by one release after another; the oldest release has another order."""

    time: float = wire(Float64b, "s", "time since start")
    pose: Vector = wire(Float64b[2], "m", "pose")
    force: Vector = wire(Float64b[2], "N", "force & <torque>")
    status: float | None = wire(Float64b, "", "status", since="2.5/3.1")
    extra: Vector | None = wire(Float64b[3], "kg", "extra", since="3.2")


@packet(header=SIZE_AND_TYPE, type=3)
class Board(State):
    """State with another field width before 2.0, removed fields, and an optional block."""

    bits: int = wire(Int32ub, "bits", "bits", before=("2.0", Int16ub))
    old: int | None = wire(Int8ub, "", "old", until="2.0")
    has_more: bool = wire(Coded(Int8ub, bool), "", "more follows")
    more: int | None = wire(Int16ub, "", "more", block="has_more")
    colour: Colour = wire(Coded(Int8ub, Colour), "", "colour")
    last: int | None = wire(Int8ub, "", "last", since="2.1")


@packet(header=SIZE_AND_TYPE, type=9)
class Said(State):
    """State with a number in its new layout; if the new layout leaves too little text, the old one is used."""

    number: int | None = wire(Int32sb, "", "number", since="2.0")
    text: str = wire(Text(least=4), "", "text", before=("2.0", Text()))


@packet(header=SIZE_AND_TYPE, type=10)
class Lost(State):
    """State with a field that later releases of the same generation no longer send."""

    early: int | None = wire(Int32ub, "", "early", since="1.7", until="1.8")
    late: int | None = wire(Int8ub, "", "late", since="1.8")
    later: int | None = wire(Int16ub, "", "later", since="3.0")


@packet(header=SIZE_AND_TYPE, type=12)
class Twined(State):
    """State with an interleaved group of fields, which a later version extended."""

    before: int = wire(Int8ub, "", "before")
    position: Vector = wire(Float64b[2], "rad", "position", interleave="joint")
    mode: tuple[Colour, ...] | None = wire(Coded(Int8ub, Colour)[2], "", "mode", interleave="joint", since="2.0")
    count: IntVector = wire(Int16ub[2], "", "count")


@packet(header=SIZE_AND_TYPE, type=11)
class Whole(State):
    payload: bytes = wire(Raw(), "", "payload")


def test_fields_have_their_declared_unit_and_text() -> None:
    assert list(Grown.FIELDS) == ["time", "pose", "force", "status", "extra"]
    assert Grown.FIELDS["force"].unit == "N"
    assert Grown.time.__doc__ == "time since start [s]"
    assert Grown.status.__doc__ == "status"
    assert Grown.__doc__ is not None


def test_versions_with_the_same_fields_share_a_layout() -> None:
    assert [(layout.first, layout.size) for layout in Grown.LAYOUTS.all] == [
        ((0, 0), 44),
        ((2, 0), 44),
        ((2, 5), 52),
        ((3, 2), 76),
    ]
    # 3.0 has no status, like 2.0, so both have the same layout.
    assert Grown.LAYOUTS.of("3.0") is Grown.LAYOUTS.of("2.0")
    assert Grown.LAYOUTS.of("2.9") is Grown.LAYOUTS.of("3.1") is Grown.LAYOUTS.of((2, 5, 3))
    assert Grown.LAYOUTS.of() is Grown.LAYOUTS.of("9.9")
    assert [(layout.first, layout.has_block, layout.size) for layout in Board.LAYOUTS.all] == [
        ((0, 0), False, 10),
        ((0, 0), True, 12),
        ((2, 0), False, 11),
        ((2, 0), True, 13),
        ((2, 1), False, 12),
        ((2, 1), True, 14),
    ]


def test_packet_class_decodes_old_and_new_field_order() -> None:
    old, new = Grown("1.0", pose=[1, 2], force=[3, 4]), Grown("2.0", pose=[1, 2], force=[3, 4])
    assert struct.unpack(">i5d", bytes(old)) == (44, 0, 3, 4, 1, 2)
    assert struct.unpack(">i5d", bytes(new)) == (44, 0, 1, 2, 3, 4)
    assert old.pose.tolist() == new.pose.tolist() == [1, 2]
    assert old.status is None
    assert old.extra is None


def test_interleaved_fields_decode_with_and_without_new_field() -> None:
    old, new = (
        Twined("1.0", before=1, position=[2, 3], count=[4, 5]),
        Twined("2.0", before=1, position=[2, 3], mode=[1, 9]),
    )
    assert struct.unpack(">iBB2d2H", bytes(old)) == (26, 12, 1, 2, 3, 4, 5)
    assert struct.unpack(">iBBdBdB2H", bytes(new)) == (28, 12, 1, 2, 1, 3, 9, 0, 0)
    for state in (old, new):
        assert (state.before, state.position.tolist()) == (1, [2.0, 3.0])
    assert old.mode is None
    assert new.mode == (Colour.RED, 9)
    assert (old.count.tolist(), new.count.tolist()) == ([4, 5], [0, 0])
    assert old.count.dtype == np.uint16


def test_version_without_the_packet_raises_packet_error() -> None:
    @packet(header=SIZE, reorder=None)
    class Late(State):
        x: float = wire(Float64b, "", "x", since="2.0", until="4.0")

    assert Late("3.9").x == 0.0
    for version in ("1.9", "4.0", "5.1"):
        with pytest.raises(PacketError, match="this firmware does not send it") as caught:
            Late(version)
        assert (caught.value.packet, caught.value.version) == ("Late", version)


def sizes(cls: type[State], size: int, version: tuple[int, ...] | None = None) -> list[tuple[int, ...]]:
    return [layout.first for layout in cls.LAYOUTS.fitting(size, version)]


def test_layout_is_chosen_by_length() -> None:
    assert sizes(Grown, 52)[0] == (2, 5)
    assert sizes(Grown, 76)[0] == (3, 2)
    # If the packet is longer than the longest layout that fits, the rest is the tail.
    assert sizes(Grown, 60)[0] == (2, 5)
    assert sizes(Grown, 800)[0] == (3, 2)
    with pytest.raises(PacketError, match="too short") as caught:
        sizes(Grown, 43)
    assert (caught.value.expected, caught.value.actual, caught.value.offset) == (44, 43, 43)


def test_layout_is_chosen_by_length_and_version() -> None:
    # The old and the new order have the same length, so only the version distinguishes them.
    assert sizes(Grown, 44, (1, 0)) == [(0, 0)]
    assert sizes(Grown, 44, (2, 0)) == [(2, 0)]
    # If the packet is longer than the layout of its version, only extensions of this layout are candidates.
    assert sizes(Grown, 76, (2, 0)) == [(3, 2), (2, 5), (2, 0)]
    assert sizes(Grown, 76, (1, 0)) == [(0, 0)]
    with pytest.raises(PacketError, match=r"Grown of firmware 3\.2.*expected 76 bytes, got 52"):
        sizes(Grown, 52, (3, 2))


def test_field_removed_in_a_release_is_still_decoded_if_present() -> None:
    early = Lost("1.7", early=7)
    assert Lost.LAYOUTS.decode(bytes(early), (1, 8)).early == 7
    # In another generation, the same bytes are a tail instead.
    assert Lost.LAYOUTS.decode(bytes(early), (3, 0)).to_dict() == {"late": 0, "later": 0}
    assert Lost.LAYOUTS.decode(bytes(early), (3, 0)).tail == b"\x07"


@pytest.mark.parametrize("version", ["1.0", "2.0", "2.1"])
@pytest.mark.parametrize("more", [0, 5])
def test_block_is_present_when_its_flag_is_set(version: str, more: int) -> None:
    state = Board(version, bits=9, has_more=bool(more), more=more, colour=Colour.RED)
    for firmware in (tuple(map(int, version.split("."))), None):
        again = Board.LAYOUTS.decode(bytes(state), firmware)
        # Without a version, 12 bytes are either the old form with the block or the new form without it.
        if len(bytes(state)) != 12 or firmware is not None:
            assert again.to_dict() == state.to_dict()
    assert state.more == (more or None)
    assert state.colour is Colour.RED


def test_optional_block_before_tail_is_decoded_if_flag_is_set() -> None:
    data = Board.LAYOUTS.of("2.1", {"has_more": True}).encode({"has_more": 1, "more": 3, "last": 4}, b"\x09\x09")
    state = Board.LAYOUTS.decode(data, (2, 1))
    assert (state.more, state.last, state.tail) == (3, 4, b"\x09\x09")
    data = Board.LAYOUTS.of("2.1").encode({"last": 4}, b"\x09\x09\x09")
    state = Board.LAYOUTS.decode(data, (2, 1))
    assert (state.more, state.last, state.tail) == (None, 4, b"\x09\x09\x09")


def test_short_text_is_decoded_with_the_old_layout() -> None:
    new, old = Said("2.0", number=5, text="long enough"), Said("1.0", text="short")
    assert (Said.LAYOUTS.decode(bytes(new)).number, Said.LAYOUTS.decode(bytes(new)).text) == (5, "long enough")
    # The new layout has at least nine bytes, but with text this length does not identify the layout.
    for text in ("short", "abcd", "x"):
        state = Said.LAYOUTS.decode(bytes(Said("1.0", text=text)))
        assert (state.number, state.text) == (None, text)
    with pytest.raises(PacketError, match="text is too short"):
        Said.LAYOUTS.decode(bytes(old), (2, 0))


def test_states_are_immutable() -> None:
    state: Any = Grown("3.2")
    for name in ("time", "pose", "extra", "tail", "received", "anything"):
        with pytest.raises(AttributeError):
            setattr(state, name, 1.0)
    with pytest.raises(ValueError, match="read-only"):
        state.pose[0] = 1.0
    assert not hasattr(state, "__dict__")


def test_states_with_equal_bytes_are_equal() -> None:
    one, same, other = Grown("3.2", time=1.0), Grown("3.2", time=1.0), Grown("3.2", time=2.0)
    assert one == same
    assert hash(one) == hash(same)
    assert one != other
    assert len({one, same, other}) == 2
    assert one != bytes(one)
    assert Whole() != Said("1.0")  # a different class, so the bytes are not compared


@pytest.mark.parametrize(
    "state",
    [
        Grown("1.0", time=2.0, force=[1, 2]),
        Grown("3.2", extra=[1, 2, 3]),
        Board("2.0", has_more=True, more=3),
        Board("2.0"),
        Said("1.0", text="hm"),
        Said("2.0", text="hm, hm"),
        Whole(payload=b"\x00\xff"),
    ],
)
def test_states_can_be_pickled_and_copied(state: State) -> None:
    stamped = type(state).LAYOUTS.of()  # any layout will do
    assert stamped.packet is type(state)
    again = pickle.loads(pickle.dumps(state))
    assert again == state
    assert again.to_dict() == state.to_dict()
    assert copy.copy(state) is state
    assert copy.deepcopy(state) is state


def test_pickled_state_keeps_its_stamp() -> None:
    stamp = Stamp(12.5, 1.7e9)
    state = Grown.LAYOUTS.decode(bytes(Grown("3.2")), None, stamp)
    assert state.received == stamp
    assert pickle.loads(pickle.dumps(state)).received == stamp
    assert Grown("3.2").received is None


def test_to_dict_and_str_use_plain_values() -> None:
    assert Grown("2.5", time=1.5, pose=[1, 2]).to_dict() == {
        "time": 1.5,
        "pose": [1.0, 2.0],
        "force": [0.0, 0.0],
        "status": 0.0,
    }
    assert Board("2.0", colour=7).to_dict() == {"bits": 0, "has_more": False, "colour": "UNKNOWN_7"}
    assert Whole(payload=b"\x00\xff").to_dict() == {"payload": "00ff"}
    assert str(Grown("2.0", pose=[0.1, 2])) == "Grown(time=0, pose=[0.1, 2], force=[0, 0])"
    assert repr(Board("2.0", colour=1)) == "Board(bits=0, has_more=False, colour=RED)"


def test_received_text_is_escaped_in_str_and_html() -> None:
    evil = Said("1.0", text="<script>&\n\x1b[2J\r")
    assert str(evil).isprintable()
    html = evil._repr_html_()
    assert "<script>" not in html
    assert "&lt;script&gt;&amp;" in html
    assert "\x1b" not in html
    # Texts of the schema are escaped as well.
    assert "force &amp; &lt;torque&gt;" in Grown("2.0")._repr_html_()
    assert "<td>N</td>" in Grown("2.0")._repr_html_()


def test_dtype_follows_the_version() -> None:
    assert Grown.dtype("1.0").names == ("message_size", "time", "force", "pose")
    assert Grown.dtype("2.5").itemsize == 52
    assert Grown.dtype().itemsize == 76
    many = np.frombuffer(bytes(Grown("2.0", time=1)) + bytes(Grown("2.0", time=2)), Grown.dtype("2.0"))
    assert many["time"].tolist() == [1.0, 2.0]


def test_layouts_cache_is_bounded_for_any_lengths() -> None:
    for size in range(76, 2000):
        state = Grown.LAYOUTS.decode(bytes(size))
        assert len(state.tail) == size - 76
    kept = sum(len(value) for value in vars(Grown.LAYOUTS).values() if isinstance(value, dict))
    assert kept < 1000

"""Every layout of every packet class, compared with construct, and tested with random bytes.

The cases are generated from the classes, so a new layout is tested automatically.
"""

from __future__ import annotations

import copy
import math
import pickle
import struct
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from construct import ConstructError
from hypothesis import given, settings
from hypothesis import strategies as st

from linkcore.errors import PacketError
from linkcore.wire.fields import Array, Coded, Mask64, OpenInt, Raw, Shape
from linkcore.wire.layout import Place
from linkcore.wire.packet import State
from linkcore.wire.state_layouts import StateLayout
from tests.oracle import parse
from urlink import decode
from urlink.packets import RealtimeState, RobotMessage, RobotState
from urlink.protocol.firmware import RELEASES, Firmware, Release
from urlink.protocol.ports import Interface
from urlink.protocol.primary import robot_message, robot_state
from urlink.protocol.primary.decoder import PackageDecoder
from urlink.protocol.primary.robot_state import SUB_PACKAGES
from urlink.protocol.realtime import packets as realtime

pytestmark = pytest.mark.property

CLASSES = sorted(
    {
        item
        for module in (realtime, robot_state, robot_message)
        for item in vars(module).values()
        if isinstance(item, type) and issubclass(item, State) and item.FIELDS
    },
    key=lambda cls: cls.__name__,
)
LAYOUTS = [layout for cls in CLASSES for layout in cls.LAYOUTS.all]


def name_of(layout: StateLayout) -> str:
    block = "-block" if layout.has_block else ""
    return f"{layout.packet.__name__}-{'.'.join(map(str, layout.first))}{block}"


# For tests that decode fifteen packets at once, or draw a value for each of fifty fields.
FEWER = settings(max_examples=max(settings().max_examples // 3, 1))

every_layout = pytest.mark.parametrize("layout", LAYOUTS, ids=name_of)
every_release = pytest.mark.parametrize("release", RELEASES, ids=lambda release: str(release.since))


def test_cases_include_all_classes() -> None:
    assert {RealtimeState, RobotMessage} < {*CLASSES}
    assert len(LAYOUTS) == len({name_of(layout) for layout in LAYOUTS}) > len(CLASSES) > 30


def same(one: Any, other: Any) -> bool:
    """Whether two values are equal in every bit, even for NaN."""
    if isinstance(one, np.ndarray):
        one = one.tolist()
    if isinstance(one, (tuple, list)):
        return len(one) == len(other) and all(map(same, one, other))
    if isinstance(one, float):
        return isinstance(other, float) and struct.pack("=d", one) == struct.pack("=d", other)
    return type(one) is type(other) and bool(one == other)


def packets(layout: StateLayout, extra: int = 0) -> st.SearchStrategy[bytes]:
    """Random bytes that are long enough for the layout."""
    longest = layout.size + (60 if layout.has_text else extra)
    return st.binary(min_size=layout.size, max_size=longest)


def doubles(size: int) -> st.SearchStrategy[bytes]:
    """Bytes that contain valid codes, masks and quantities, which random bytes rarely do."""
    cell = st.one_of(
        st.floats().map(lambda number: struct.pack(">d", number)),
        st.integers(-3, 300).map(lambda number: struct.pack(">d", number)),
        st.integers(0, 2**20).map(lambda number: struct.pack(">Q", number)),
    )
    # Repeat a few cells: drawing each of 150 cells takes longer and finds hardly more.
    return st.lists(cell, min_size=1, max_size=7).map(lambda cells: (bytes(4) + b"".join(cells) * size)[:size])


# -- the fast decoder and construct


@every_layout
@given(data=st.data())
def test_fast_decoder_equals_construct(layout: StateLayout, data: st.DataObject) -> None:
    strategy = packets(layout, extra=9)
    packet = data.draw(st.one_of(strategy, doubles(layout.size)) if layout.of_cells else strategy)
    try:
        state = layout.decode(packet)
    except PacketError:
        # Only text can run past the end. Construct then fails too, because the packet is too short for it.
        assert layout.has_text
        with pytest.raises(ConstructError):
            parse(layout, packet)
        return
    slowly = parse(layout, packet)
    assert list(slowly) == list(layout.places)
    for name, value in slowly.items():
        fast = getattr(state, name)
        assert same(fast, value), (name, fast, value)
        if isinstance(fast, np.ndarray):
            # The bytes of the array must also equal the bytes on the wire, in native order.
            wide = np.array(value, fast.dtype)
            assert fast.tobytes() == wide.tobytes()
            assert fast.shape == (layout.places[name].count,)
            assert not fast.flags.writeable
    for name in layout.packet.FIELDS.keys() - layout.places.keys():
        assert getattr(state, name) is None
    assert state.tail == packet[layout.end(packet) :]
    assert bytes(state) == packet


@every_release
@FEWER
@given(data=st.data())
def test_packets_of_release_decode_like_construct(release: Release, data: st.DataObject) -> None:
    """This includes the choice of the layout by version and length, and by length alone."""
    raw = bytearray(
        data.draw(st.one_of(st.binary(min_size=release.realtime, max_size=release.realtime), doubles(release.realtime)))
    )
    raw[:4] = release.realtime.to_bytes(4, "big")
    slowly = parse(RealtimeState.LAYOUTS.of(release.since), bytes(raw))
    for version in (release.since, None):
        (state,) = decode(bytes(raw), "realtime", version)
        assert all(same(getattr(state, name), value) for name, value in slowly.items())

    # Draw all bytes at once, because many small draws would take most of the time.
    rest = data.draw(st.binary(min_size=release.first_state_size, max_size=release.first_state_size))
    body = []
    for kind, size in release.state.items():
        sub, rest = bytearray(rest[:size]), rest[size:]
        sub[:5] = struct.pack(">iB", size, kind)
        if kind == 3 and size > 61:
            # The flag shows whether the Euromap block is present. These sizes do not include the block.
            sub[63 if size == 64 else 67] = 0
        body.append(bytes(sub))
    package = struct.pack(">iB", release.first_state_size, 16) + b"".join(body)
    for version in (release.since, None):
        (whole,) = decode(package, "primary", version)
        assert isinstance(whole, RobotState)
        assert [bytes(part) for part in whole] == body
        for part in whole:
            slowly = parse(type(part).LAYOUTS.of(release.since), bytes(part))
            assert part.tail == b""
            assert all(same(getattr(part, name), value) for name, value in slowly.items())


# -- encode and decode


def element_of(shape: Shape) -> Shape:
    return shape.element if isinstance(shape, Array) else shape


def element(place: Place) -> st.SearchStrategy[Any]:
    """Values that the shape of one element can hold."""
    shape = element_of(place.shape)
    if isinstance(shape, Raw):
        longest = 40 if shape.prefix is None else 20
        if type(shape) is Raw:
            return st.binary(max_size=longest)
        # Only characters that can be encoded: others would be written as escapes, which are read differently.
        return st.text(st.characters(codec="utf-8"), min_size=shape.least, max_size=longest)
    assert place.number is not None
    code = place.number.code
    if code == "d" and isinstance(shape, Coded):
        return st.integers(-(2**31) + 1, 2**31 - 1)
    if code in "fd":
        return st.floats(width=32 if code == "f" else 64)
    if shape is Mask64:
        return st.integers(0, 2**48 - 1)
    if isinstance(shape, Coded) and shape.meaning is bool:
        return st.booleans()
    bits = 8 * place.width
    return st.integers(0, 2**bits - 1) if code.isupper() else st.integers(-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)


def repeated(one: st.SearchStrategy[Any], count: int) -> st.SearchStrategy[list[Any]]:
    return one.map(lambda value: [value] * count)


def numbers(place: Place) -> st.SearchStrategy[list[Any]]:
    """Numbers of the field's type, from one draw of all their bytes."""
    assert place.number is not None
    code = f">{place.count}{place.number.code}"
    return st.binary(min_size=place.size, max_size=place.size).map(lambda raw: list(struct.unpack(code, raw)))


def values(layout: StateLayout) -> st.SearchStrategy[dict[str, Any]]:
    fields: dict[str, st.SearchStrategy[Any]] = {}
    for name, place in layout.places.items():
        one = element(place)
        if place.count is None:
            fields[name] = one
        elif place.shape.read is None:
            fields[name] = st.one_of(repeated(one, place.count), numbers(place))
        else:
            fields[name] = st.lists(one, min_size=place.count, max_size=place.count)
        if name in layout.packet.LAYOUTS.blocks:
            fields[name] = st.just(layout.has_block)
    return st.fixed_dictionaries(fields)


@every_layout
@FEWER
@given(data=st.data())
def test_encoded_values_are_decoded_again(layout: StateLayout, data: st.DataObject) -> None:
    given_values = data.draw(values(layout))
    packet = layout.encode(given_values)
    assert int.from_bytes(packet[:4], "big") == len(packet)
    state = layout.decode(packet)
    for name, value in given_values.items():
        assert same_number(getattr(state, name), value), name
    # Users and simulators do the same: they choose the layout by version, and give all fields.
    built = layout.packet(layout.first, **given_values)
    assert built == state
    assert built.to_dict().keys() >= given_values.keys()
    again = layout.encode({name: getattr(built, name) for name in given_values})
    assert again == packet
    if not layout.has_text:
        assert len(packet) == layout.size
        assert layout.encode(given_values, b"tail")[4:] == packet[4:] + b"tail"


def same_number(one: Any, other: Any) -> bool:
    """Whether two values are equal; 5 may become JointMode(5), 1 may become 1.0, and NaN equals NaN."""
    if isinstance(other, list):
        return len(one) == len(other) and all(map(same_number, list(one), other))
    if isinstance(other, float) and math.isnan(other):
        return math.isnan(one)
    return bool(one == other)


@every_layout
@given(data=st.data())
def test_dtype_equals_decoder(layout: StateLayout, data: st.DataObject) -> None:
    if layout.has_text:
        return
    one, two = (data.draw(st.binary(min_size=layout.size, max_size=layout.size)) for _ in range(2))
    table = np.frombuffer(one + two, layout.dtype)
    assert table.dtype.itemsize == layout.size
    assert len(table) == 2
    for row, packet in zip(table, (one, two), strict=True):
        assert row["message_size"] == struct.unpack(">i", packet[:4])[0]
        state = layout.decode(packet)
        for name, place in layout.places.items():
            column = row[name] if place.field.interleave is None else row[place.field.interleave][name]
            value = getattr(state, name)
            read = place.shape.read
            if read is None:
                assert place.number is not None
                with np.errstate(invalid="ignore"):  # a signalling NaN in four bytes
                    wide = np.asarray(column).astype(np.asarray(value).dtype)
                assert np.array_equal(wide, np.asarray(value), equal_nan=place.number.kind[0] == "f")
            else:  # masks and codes stay numbers; the field's conversion must give the decoded value
                numbers = np.asarray(column).ravel().tolist()
                converted = tuple(map(read, numbers))
                assert same(value if place.count else (value,), converted)


# -- methods of every state, with any contents


def views_hold(state: State) -> None:
    shown = state.to_dict()
    assert plain(shown)
    for text in (str(state), repr(state)):
        assert text.startswith(type(state).__name__)
        assert "\n" not in text
        assert "\x1b" not in text
    page = state._repr_html_()
    assert page.count("<table>") == page.count("</table>")
    assert "\x1b" not in page
    # Text from the wire cannot open a tag: the page has only the tags of tables.
    bare = page
    for tag in ("table", "caption", "tr", "th", "td"):
        bare = bare.replace(f"<{tag}>", "").replace(f"</{tag}>", "")
    assert "<" not in bare
    assert ">" not in bare
    again = pickle.loads(pickle.dumps(state))
    assert type(again) is type(state)
    assert again == state
    assert hash(again) == hash(state)
    assert bytes(again) == bytes(state)
    assert str(again) == str(state)
    assert copy.copy(state) == copy.deepcopy(state) == state
    assert state != object()
    with pytest.raises(AttributeError):
        state.something = 1  # type: ignore[attr-defined]


def plain(value: Any) -> bool:
    """Whether a value consists only of built-in types, as JSON and similar formats require."""
    if isinstance(value, dict):
        return all(type(key) is str and plain(item) for key, item in value.items())
    if isinstance(value, list):
        return all(map(plain, value))
    return type(value) in (bool, int, float, str)


@every_layout
@given(data=st.data())
def test_any_state_can_be_shown_pickled_and_compared(layout: StateLayout, data: st.DataObject) -> None:
    packet = data.draw(packets(layout, extra=3))
    try:
        state = layout.decode(packet)
    except PacketError:
        assert layout.has_text
        return
    views_hold(state)
    other = layout.decode(packet[:-1] + bytes([packet[-1] ^ 1])) if not layout.has_text else None
    assert other is None or other != state
    for name in layout.packet.FIELDS:
        with pytest.raises(AttributeError):
            setattr(state, name, 0)
        value = getattr(state, name)
        if isinstance(value, np.ndarray):
            with pytest.raises(ValueError, match="read-only"):
                value[0] = 0
    rows = list(state.dissect())
    ordered = sorted(rows, key=lambda row: row.offset)
    assert b"".join(row.data for row in ordered) == packet


@given(st.binary(max_size=30), st.text(max_size=20))
def test_html_of_text_from_the_wire_is_escaped(raw: bytes, text: str) -> None:
    evil = f"<b onclick='x'>&amp;</td>{text}".encode("utf-8", "replace") + raw
    for kind in (0, 99):
        data = struct.pack(">iBQbB", 15 + len(evil), 20, 0, -2, kind) + evil
        (state,) = decode(data, "primary")
        views_hold(state)


# -- arbitrary bytes


@st.composite
def nearly_packages(draw: st.DrawFn) -> bytes:
    """Packages of valid types and sizes with random contents, which reach deeper code than random bytes do."""
    kind = draw(st.sampled_from([5, 16, 16, 16, 20, 20, 20, 24, 25, 22, 99, 255]))
    if kind == 16:
        body = b""
        for _ in range(draw(st.integers(0, 4))):
            sub = draw(st.integers(0, 15))
            sizes = sorted({layout.size for cls in SUB_PACKAGES.get(sub, ()) for layout in cls.LAYOUTS.all}) or [9]
            size = max(draw(st.sampled_from(sizes)) + draw(st.sampled_from([0, 0, 0, -1, 1, 16])), 5)
            body += struct.pack(">iB", size, sub) + draw(st.binary(min_size=size - 5, max_size=size - 5))
    elif kind == 20:
        body = (
            draw(st.binary(min_size=9, max_size=9)) + bytes([draw(st.integers(0, 15))]) + draw(st.binary(max_size=60))
        )
    else:
        body = draw(st.binary(max_size=200))
    size = 5 + len(body) + draw(st.sampled_from([0, 0, 0, 0, 0, 0, -1, 1]))
    return struct.pack(">iB", max(size, 0), kind) + body


@st.composite
def nearly_realtime(draw: st.DrawFn) -> bytes:
    size = draw(
        st.sampled_from([*sorted({layout.size for layout in RealtimeState.LAYOUTS.all}), 508, 540, 820, 1228, 4092])
    )
    return (
        size.to_bytes(4, "big")
        + draw(st.binary(min_size=16, max_size=16)) * ((size - 4) // 16)
        + bytes((size - 4) % 16)
    )


def firmwares() -> Iterator[Firmware | None]:
    yield None
    yield from (release.since for release in RELEASES)


anything = st.lists(st.one_of(st.binary(max_size=60), nearly_packages(), nearly_realtime()), max_size=4).map(b"".join)


def facts_hold(error: PacketError, data: bytes, firmware: Firmware | None) -> None:
    assert error.packet
    assert 0 <= error.offset <= len(data)
    assert (error.expected is None) == (error.actual is None)
    assert error.version == (None if firmware is None else str(firmware))
    assert str(error.offset) in str(error)


@pytest.mark.parametrize("interface", ["realtime", "primary", "secondary"])
@given(data=anything, firmware=st.sampled_from(list(firmwares())))
def test_any_bytes_give_states_or_packet_error(interface: Interface, data: bytes, firmware: Firmware | None) -> None:
    try:
        states = decode(data, interface, firmware)
    except PacketError as error:
        facts_hold(error, data, firmware)
        return
    assert b"".join(map(bytes, states)) == data
    for state in states:
        views_hold(state)


@given(data=nearly_packages())
def test_single_package_is_decoded_or_rejected(data: bytes) -> None:
    """The decoder of a protocol gets packages without the checks of a frame boundary."""
    for version in (None, Firmware(1, 8), Firmware(5, 4)):
        try:
            state = PackageDecoder(version).decode(data)
        except PacketError:
            continue
        views_hold(state)
        if isinstance(state, RobotState):
            assert sum(map(len, map(bytes, state))) + 5 == len(data)
            for part in state:
                views_hold(part)
        if isinstance(state, RobotMessage):
            assert state.IS_EVENT


def test_every_code_field_accepts_unknown_numbers() -> None:
    """Enums are open, because the next release might send a new number."""
    coded = 0
    for layout in LAYOUTS:
        for place in layout.places.values():
            shape = element_of(place.shape)
            meaning: Any = shape.meaning if isinstance(shape, Coded) else bool
            if meaning is not bool:
                assert issubclass(meaning, OpenInt)
                assert meaning(12345) == 12345
                coded += 1
    assert coded > 50

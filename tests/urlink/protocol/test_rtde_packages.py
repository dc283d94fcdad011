"""RTDE packages of both sides and both protocol versions: layouts, frame boundaries, and recorded connections."""

from __future__ import annotations

import struct
from collections import Counter
from contextlib import suppress
from itertools import pairwise

import construct
import pytest
from hypothesis import given
from hypothesis import strategies as st

from linkcore.errors import BadValue, PacketError, WrongPeer
from linkcore.wire.framing import Framer
from linkcore.wire.packet import State
from tests import real_captures
from tests.fakes.rtde import RequestBoundary
from tests.oracle import parse
from tests.urlink.protocol.rtde_material import recordings, replies, requests
from urlink.packets import RealtimeState
from urlink.protocol.rtde.packets import (
    REPLIES,
    REQUESTS,
    ControllerVersionReply,
    DataPackage,
    InputsReply,
    MessageLevel,
    OutputsReply,
    OutputsRequest,
    ProtocolReply,
    ProtocolRequest,
    RtdeBoundary,
    RtdeMessage,
    decode_reply,
    decode_request,
    split_names,
)


def cut(stream: bytes, at: list[int]) -> list[bytes]:
    places = [0, *sorted(n % (len(stream) + 1) for n in at), len(stream)]
    return [stream[start:end] for start, end in pairwise(places)]


def framer(side: str) -> Framer:
    return Framer(RequestBoundary() if side == "request" else RtdeBoundary())


@pytest.mark.parametrize(
    ("hexed", "protocol", "kind", "values"),
    [
        ("0005 56 0002", 1, ProtocolRequest, {"wanted": 2}),
        (
            "0010 4f 405f400000000000 612c20622c",
            2,
            OutputsRequest,
            {"frequency": 125.0, "names": "a, b,"},
        ),
        ("0008 4f 612c20622c", 1, OutputsRequest, {"names": "a, b,"}),
        ("0009 4d 02 6869 01 78 03", 1, RtdeMessage, {"message": "hi", "source": "x", "level": MessageLevel.INFO}),
        ("0006 55 07 0102", 1, DataPackage, {"recipe": 7, "payload": b"\1\2"}),
    ],
)
def test_handwritten_requests_are_decoded(
    hexed: str, protocol: int, kind: type[State], values: dict[str, object]
) -> None:
    data = bytes.fromhex(hexed)
    state = decode_request(data, protocol)  # type: ignore[arg-type]
    assert type(state) is kind
    assert {name: getattr(state, name) for name in values} == values
    assert bytes(kind("2.0" if kind in (RtdeMessage, DataPackage) else f"{protocol}.0", **values)) == data


@pytest.mark.parametrize(
    ("hexed", "protocol", "kind", "values"),
    [
        ("0004 56 01", 1, ProtocolReply, {"accepted": True}),
        (
            "0013 76 00000005 00000008 00000000 00000000",
            2,
            ControllerVersionReply,
            {"major": 5, "minor": 8, "bugfix": 0, "build": 0},
        ),
        ("000a 4f 01 444f55424c45", 2, OutputsReply, {"recipe": 1, "types": "DOUBLE"}),
        ("0009 4f 444f55424c45", 1, OutputsReply, {"recipe": None, "types": "DOUBLE"}),
        ("000a 49 02 494e5f555345", 1, InputsReply, {"recipe": 2, "types": "IN_USE"}),
        ("0006 4d 01 6869", 1, RtdeMessage, {"message": "hi", "source": None, "level": MessageLevel.ERROR}),
        ("0006 55 070102", 1, DataPackage, {"recipe": None, "payload": b"\7\1\2"}),
        ("0006 55 07 0102", 2, DataPackage, {"recipe": 7, "payload": b"\1\2"}),
    ],
)
def test_handwritten_replies_are_decoded(
    hexed: str, protocol: int, kind: type[State], values: dict[str, object]
) -> None:
    data = bytes.fromhex(hexed)
    state = decode_reply(data, protocol)  # type: ignore[arg-type]
    assert type(state) is kind
    assert {name: getattr(state, name) for name in values} == values
    assert bytes(kind(f"{protocol}.0", **{name: value for name, value in values.items() if value is not None})) == data


def test_split_names_drops_one_trailing_empty_name() -> None:
    assert split_names("a, b ,") == ("a", "b")
    assert split_names("") == ()
    assert split_names(",a") == ("", "a")
    assert split_names("a,,") == ("a", "")


def test_text_longer_than_its_length_field_is_rejected() -> None:
    with pytest.raises(BadValue, match="message"):
        RtdeMessage("2.0", message="x" * 256)
    assert len(bytes(RtdeMessage("1.0", message="x" * 256))) == 3 + 1 + 256


def test_unknown_and_short_packages_raise() -> None:
    with pytest.raises(PacketError, match="unknown type 88"):
        decode_reply(b"\0\3X", 2)
    with pytest.raises(PacketError, match="expected 4 bytes, got 3"):
        decode_reply(b"\0\3S", 2)
    with pytest.raises(PacketError, match="expected 3 bytes, got 2"):
        decode_request(b"\0\2", 2)


@pytest.mark.property
@pytest.mark.parametrize("protocol", [1, 2])
@pytest.mark.parametrize("side", ["request", "reply"])
@given(data=st.data())
def test_joined_packages_are_framed_again(side: str, protocol: int, data: st.DataObject) -> None:
    drawn = data.draw(st.lists(requests(protocol) if side == "request" else replies(protocol), max_size=8))
    stream = b"".join(map(bytes, drawn))
    whole = framer(side).feed(stream)
    assert whole == list(map(bytes, drawn))
    pieces = cut(stream, data.draw(st.lists(st.integers(0, 2000), max_size=12)))
    in_pieces, in_bytes = framer(side), framer(side)
    assert [frame for piece in pieces for frame in in_pieces.feed(piece)] == whole
    assert [frame for n in range(len(stream)) for frame in in_bytes.feed(stream[n : n + 1])] == whole
    decode = decode_request if side == "request" else decode_reply
    assert [decode(frame, protocol) for frame in whole] == drawn  # type: ignore[arg-type]


@pytest.mark.property
@pytest.mark.parametrize("protocol", [1, 2])
@pytest.mark.parametrize("side", ["request", "reply"])
@given(kind=st.sampled_from(sorted(REQUESTS)), body=st.binary(max_size=80))
def test_any_body_decodes_like_construct_or_raises(side: str, protocol: int, kind: int, body: bytes) -> None:
    frame = struct.pack(">HB", 3 + len(body), kind) + body
    table, decode = (REQUESTS, decode_request) if side == "request" else (REPLIES, decode_reply)
    version = (2, 0) if side == "request" and kind in b"MU" else (protocol, 0)
    layout = table[kind].LAYOUTS.of(version)
    try:
        state = decode(frame, protocol)  # type: ignore[arg-type]
    except PacketError:
        with pytest.raises(construct.ConstructError):
            parse(layout, frame)
        return
    assert {name: getattr(state, name) for name in layout.places} == parse(layout, frame)
    assert bytes(state) == frame


@pytest.mark.property
@pytest.mark.parametrize("side", ["request", "reply"])
@given(junk=st.binary(max_size=300), data=st.data())
def test_any_bytes_are_framed_or_counted(side: str, junk: bytes, data: st.DataObject) -> None:
    """Each byte is in a frame, skipped or buffered. The result does not depend on chunking."""
    here = [bytes(each) for each in data.draw(st.lists(replies(2) if side == "reply" else requests(2), max_size=4))]
    stream = b"".join(here[:2]) + junk + b"".join(here[2:])
    whole = framer(side)
    try:
        frames = whole.feed(stream)
    except WrongPeer:
        return
    assert sum(map(len, frames)) + whole.skipped + len(whole.rest) == len(stream)
    in_pieces = framer(side)
    in_pieces_frames = [
        frame for piece in cut(stream, data.draw(st.lists(st.integers(0, 500)))) for frame in in_pieces.feed(piece)
    ]
    # The buffered part may differ: when the boundary is lost, it is searched again only after some more bytes.
    assert frames[: len(in_pieces_frames)] == in_pieces_frames
    for frame in frames:
        with suppress(PacketError):
            (decode_request if side == "request" else decode_reply)(frame, 2)


def test_lost_boundary_is_found_again() -> None:
    data = bytes(DataPackage("2.0", recipe=1, payload=bytes(range(56))))
    stream = framer("reply")
    frames = stream.feed(data + b"\0\1\2" + data * 5)
    assert frames == [data] * 6
    assert (stream.skipped, stream.resyncs) == (3, 1)


def test_unknown_package_is_framed_by_its_size() -> None:
    stream = framer("reply")
    first, other = bytes(ProtocolReply(accepted=True)), b"\0\5Zab"
    assert stream.feed(first + other + first) == [first, other, first]


@pytest.mark.parametrize(
    ("first", "who"),
    [
        (b"Connected: Universal Robots Dashboard Server\n", "dashboard"),
        (bytes(RealtimeState("5.4")), "30003"),
    ],
)
def test_wrong_peer_is_recognised(first: bytes, who: str) -> None:
    with pytest.raises(WrongPeer, match=who):
        framer("reply").feed(first)
    bytewise = framer("reply")
    with pytest.raises(WrongPeer, match=who):
        [bytewise.feed(first[n : n + 1]) for n in range(len(first))]


@pytest.mark.captures("rtde")
def test_every_recorded_connection_is_framed() -> None:
    """All data of both directions are packages of known types, and the result does not depend on chunking."""
    count = 0
    for recording in recordings(real_captures.folder("rtde")):
        for side, stream, table in (("request", recording.sent, REQUESTS), ("reply", recording.received, REPLIES)):
            whole, bytewise = framer(side), framer(side)
            frames = whole.feed(stream)
            assert (whole.rest, whole.skipped) == (b"", 0), recording.name
            step = max(len(stream) // 3000, 1)  # feed long streams in small pieces, short ones byte by byte
            assert [
                frame for n in range(0, len(stream), step) for frame in bytewise.feed(stream[n : n + step])
            ] == frames, recording.name
            told = recording.row["client_packages" if side == "request" else "server_packages_kept"]
            assert Counter(chr(frame[2]) for frame in frames) == Counter(
                {kind: int(number) for kind, _, number in (part.partition("=") for part in told.split())}
            ), recording.name
            assert {frame[2] for frame in frames} <= table.keys()
        count += 1
    assert count >= 76

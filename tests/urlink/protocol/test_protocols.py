"""Packet protocols: streams split at any position, lost and found frame boundaries, and wrong peers."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from linkcore.clock import Stamp
from linkcore.errors import PacketError, WrongPeer
from linkcore.net.transport import Finished
from linkcore.streaming.packet_queue import block
from linkcore.wire.framing import Framer
from linkcore.wire.packet import State
from tests.fakes.link import ScriptedTransport
from urlink.packets import (
    AdditionalInfo,
    JointData,
    KeyMessage,
    MasterboardData,
    OtherPackage,
    PopupMessage,
    ProgramStateMessage,
    RealtimeState,
    RobotModeData,
    RobotState,
    TextMessage,
    ToolData,
    UnknownSubPackage,
    UnnamedMessage12,
    VersionMessage,
)
from urlink.protocol.firmware import RELEASES, Firmware, Release, release_of
from urlink.protocol.primary.protocol import PackageBoundary, PrimaryProtocol
from urlink.protocol.primary.robot_state import SUB_PACKAGES
from urlink.protocol.realtime.protocol import RealtimeBoundary, RealtimeProtocol
from urlink.session.identity import Identity
from urlink.session.source import Source

Session = type[RealtimeProtocol] | type[PrimaryProtocol]


def fed(kind: Session, *chunks: bytes) -> tuple[list[bytes], Framer]:
    """Return the frames of a stream that arrives in these chunks, and check the byte counts after each chunk."""
    framer = kind().framer
    boundary: type[RealtimeBoundary | PackageBoundary] = (
        RealtimeBoundary if kind is RealtimeProtocol else PackageBoundary
    )
    bound = boundary.largest + boundary.pace
    frames: list[bytes] = []
    total = 0
    for chunk in chunks:
        frames += framer.feed(chunk)
        total += len(chunk)
        assert framer.skipped + sum(map(len, frames)) + len(framer.rest) == total
        assert len(framer.rest) < bound
    return frames, framer


def bytewise(stream: bytes) -> list[bytes]:
    return [stream[n : n + 1] for n in range(len(stream))]


def cut(stream: bytes, at: Sequence[int]) -> list[bytes]:
    places = [0, *sorted(n % (len(stream) + 1) for n in at), len(stream)]
    return [stream[start:end] for start, end in pairwise(places)]


def realtime(number: int, version: str = "5.10", **fields: Any) -> bytes:
    """Packet `number` of a connection; only the time differs from the others."""
    return bytes(RealtimeState(version, time=12.0 + number * 0.008, q_actual=[0.5, -1.5, 1.0, 0, 0.1, 3], **fields))


def robot_state(version: str = "5.8", first: bool = False, number: int = 0) -> bytes:
    """A state as this firmware sends it."""
    release = release_of(Firmware.parse(version))
    parts = []
    for kind, size in release.state.items():
        if kind in release.first_state_only and not first:
            continue
        (cls,) = (each for each in SUB_PACKAGES[kind] if size in {layout.size for layout in each.LAYOUTS.all})
        fields: dict[str, Any] = (
            {"timestamp": number} if kind == 0 else {"q_actual": [0.1, -1.2, 1.3, -0.4, 2.5, 0.6]} if kind == 1 else {}
        )
        parts.append(cls(version, **fields))
    return bytes(RobotState(*parts))


VERSION = bytes(VersionMessage("5.8", project_name="URControl", major=5, minor=8, build_date="x" * 20))
MESSAGE_12 = bytes(UnnamedMessage12(timestamp=2**64 - 1, source=-2, third=1))
KEY = bytes(KeyMessage(title="PROGRAM_XXX_STARTED", text="job.urp"))
MODBUS = struct.pack(">iBi", 9, 5, 0)
VARIABLES = bytes(ProgramStateMessage(message_type=1))
UNKNOWN = struct.pack(">iB", 25, 77) + b"nobody knows it here"
LEAK_560, LEAK_9 = robot_state("1.8"), MODBUS


def test_leaked_packages_have_sizes_of_firmware_1_8() -> None:
    assert (len(LEAK_560), len(LEAK_9)) == (560, 9)


# -- complete streams, split at any position


@pytest.mark.parametrize("release", RELEASES, ids=lambda release: str(release.since))
def test_complete_streams_do_not_depend_on_chunking(release: Release) -> None:
    version = str(release.since)
    packets = [realtime(n, version) for n in range(4)]
    packages = [VERSION, MESSAGE_12, robot_state(version, first=True), KEY, robot_state(version), MODBUS, VARIABLES]
    for kind, parts in ((RealtimeProtocol, packets), (PrimaryProtocol, packages)):
        stream = b"".join(parts)
        for chunks in ([stream], bytewise(stream), parts, cut(stream, [3, 4, 5, 1000, 1001])):
            frames, framer = fed(kind, *chunks)
            assert frames == parts
            assert (framer.skipped, framer.resyncs, framer.rest) == (0, 0, b"")


@pytest.mark.parametrize("part", [0, 1, 3, 4, 12, 700])
@pytest.mark.parametrize("begun", [0, 5])
def test_realtime_packets_before_incomplete_packet_are_framed(part: int, begun: int) -> None:
    packets = [realtime(n) for n in range(6)]
    size = len(packets[0])
    chunks = cut(b"".join(packets), sorted({size, size + begun, 4 * size + part}))
    frames, framer = fed(RealtimeProtocol, *chunks)
    assert frames == packets
    assert all(type(frame) is bytes for frame in frames)
    assert (framer.skipped, framer.resyncs, framer.rest) == (0, 0, b"")


#: Enough packets that the largest size which a forged header can declare ends among them.
MANY_PACKETS = [realtime(n) for n in (1, 2, 3)]
MANY_STATES = [robot_state(number=n) for n in range(120)]
GOOD_PACKAGES = [VERSION, MESSAGE_12, KEY, MODBUS, VARIABLES, UNKNOWN, robot_state(), robot_state(first=True), LEAK_560]

damage: st.SearchStrategy[Callable[[bytes], bytes]] = st.one_of(
    st.just(lambda packet: packet),
    st.integers(0, 2**32 - 1).map(lambda size: lambda packet: size.to_bytes(4, "big") + packet[4:]),
    st.integers(0, 70_000).map(lambda size: lambda packet: size.to_bytes(4, "big") + packet[4:]),
    st.integers(0, 1400).map(lambda at: lambda packet: packet[:at]),
    st.tuples(st.integers(0, 1400), st.binary(min_size=1, max_size=9)).map(
        lambda put: lambda packet: packet[: put[0]] + put[1] + packet[put[0] :]
    ),
    st.tuples(st.integers(4, 700), st.binary(min_size=1, max_size=9)).map(
        lambda put: lambda packet: packet[: put[0]] + put[1] + packet[put[0] + len(put[1]) :]
    ),
)


@st.composite
def damaged_streams(draw: st.DrawFn, kind: Session) -> bytes:
    """Good packets, damaged packets, garbage and leaked packages, in any order after one good packet."""
    parts = [realtime(0) if kind is RealtimeProtocol else VERSION]
    for number in range(1, draw(st.integers(1, 7))):
        if kind is RealtimeProtocol:
            packet = draw(
                st.sampled_from([realtime(number), realtime(number), realtime(number, "3.4"), LEAK_560, LEAK_9])
            )
        else:
            packet = draw(st.sampled_from(GOOD_PACKAGES))
        parts.append(draw(damage)(packet))
        parts.append(draw(st.one_of(st.just(b""), st.just(b""), st.binary(max_size=20), st.just(bytes(7)))))
    return b"".join(parts)


@pytest.mark.property
@pytest.mark.parametrize("kind", [RealtimeProtocol, PrimaryProtocol])
@given(data=st.data())
def test_damaged_stream_does_not_depend_on_chunking(kind: Session, data: st.DataObject) -> None:
    stream = data.draw(damaged_streams(kind))
    whole, framer = fed(kind, stream)
    # When the boundary is lost, a packet may be held back until `pace` more bytes have arrived.
    more = b"\xff" * RealtimeBoundary.pace
    in_the_end, _ = fed(kind, stream + more)
    for chunks in (bytewise(stream), cut(stream, data.draw(st.lists(st.integers(0, 2**16), max_size=6)))):
        frames, other = fed(kind, *chunks)
        assert frames == whole[: len(frames)]
        if frames == whole:
            # Bytes that cannot begin a packet may be skipped now or together with the next bytes.
            assert other.skipped + len(other.rest) == framer.skipped + len(framer.rest)
            assert other.resyncs == framer.resyncs
        frames, _ = fed(kind, *chunks, *bytewise(more))
        assert frames[: len(whole)] == whole
        assert frames == in_the_end[: len(frames)]
    # A frame is decoded or raises an error; the session continues in both cases.
    session = kind()
    for frame in session.framer.feed(stream):
        try:
            state: State = session.decode(frame, Stamp(1.0, 2.0))
        except PacketError:
            continue
        assert bytes(state) == frame
        assert state.received == Stamp(1.0, 2.0)


@pytest.mark.property
@pytest.mark.parametrize("kind", [RealtimeProtocol, PrimaryProtocol])
@given(
    chunks=st.lists(
        st.one_of(st.binary(max_size=200), st.just(bytes(500)), st.just(b"\x00\x00\x10\x14" * 90)), max_size=8
    )
)
def test_arbitrary_bytes_keep_counts_and_memory_limit(kind: Session, chunks: list[bytes]) -> None:
    try:
        fed(kind, *chunks)
    except WrongPeer:
        return
    # After a good packet, the peer is never rejected, and the next good packets are found after any bytes.
    first = realtime(0) if kind is RealtimeProtocol else VERSION
    later = MANY_PACKETS if kind is RealtimeProtocol else MANY_STATES
    frames, framer = fed(kind, first, *chunks, *later)
    assert frames[0] == first
    assert frames[-1] == later[-1]
    assert framer.rest == b""


@pytest.mark.parametrize("kind", [RealtimeProtocol, PrimaryProtocol])
@pytest.mark.parametrize(
    "piece", [bytes(4096), b"\xff" * 4096, b"\x00\x00\x10\x14" * 1024, b"\x00\x00\xff\xff\x10" * 900]
)
def test_memory_is_bounded(kind: Session, piece: bytes) -> None:
    first = realtime(0) if kind is RealtimeProtocol else VERSION
    _, framer = fed(kind, first, *[piece] * 40)
    assert len(framer.rest) < (4096 + 12 if kind is RealtimeProtocol else 65536 + 5) + 256


# -- the real-time frame boundary


@pytest.mark.parametrize("version", ["1.8", "3.0", "3.4", "5.10"])
@pytest.mark.parametrize(
    "garbage",
    [
        b"\x00",
        b"\xff" * 5,
        bytes(811),
        b"\x00\x00\x02\xfc" * 3,
        LEAK_560,
        LEAK_9,
        LEAK_560 + LEAK_9,
        realtime(0)[9:600],
    ],
    ids=["zero", "ff", "zeros", "sizes", "leak-560", "leak-9", "leaks", "half a packet"],
)
def test_realtime_packets_around_garbage_are_all_found(version: str, garbage: bytes) -> None:
    packets = [realtime(n, version) for n in range(4)]
    for chunks in ([packets[0], garbage, *packets[1:]], bytewise(packets[0] + garbage + b"".join(packets[1:]))):
        frames, framer = fed(RealtimeProtocol, *chunks)
        assert frames == packets
        assert (framer.skipped, framer.resyncs, framer.rest) == (len(garbage), 1, b"")
    between = garbage.join(packets)
    frames, framer = fed(RealtimeProtocol, between)
    assert frames == packets
    assert (framer.skipped, framer.resyncs) == (3 * len(garbage), 3)


def test_packet_is_framed_without_waiting_for_the_next() -> None:
    """This also holds after garbage."""
    for garbage in (b"", LEAK_560, b"\xff" * 99):
        framer = RealtimeProtocol().framer
        framer.feed(realtime(0) + garbage)
        for number in (1, 2):
            assert framer.feed(realtime(number)) == [realtime(number)]


def test_garbage_before_first_packet_is_skipped() -> None:
    packets = [realtime(n) for n in range(3)]
    frames, framer = fed(RealtimeProtocol, b"\xff" * 77 + b"".join(packets))
    assert frames == packets
    assert framer.skipped == 77


@pytest.mark.parametrize("size", [0, 4, 5, 499, 508, 716, 812, 1212, 1219, 1221, 1228, 4092, 65535, 2**31, 2**32 - 1])
def test_wrong_size_loses_only_that_realtime_packet(size: int) -> None:
    packets = [realtime(n) for n in range(5)]
    lying = size.to_bytes(4, "big") + packets[2][4:]
    for join in (bytewise, lambda stream: [stream]):
        frames, framer = fed(RealtimeProtocol, *join(b"".join([*packets[:2], lying, *packets[3:]])))
        assert frames == [*packets[:2], *packets[3:]]
        assert framer.skipped == 1220


@pytest.mark.parametrize("lost", [1, 8, 700])
def test_missing_bytes_lose_realtime_packet_and_the_next(lost: int) -> None:
    packets = [realtime(n) for n in range(5)]
    stream = b"".join([packets[0], packets[1][:-lost], *packets[2:]])
    frames, framer = fed(RealtimeProtocol, stream)
    # Its size is trusted, so the missing bytes are taken from the next packet.
    assert [frames[0], *frames[2:]] == [packets[0], *packets[3:]]
    assert framer.skipped == 1220 - lost


@pytest.mark.parametrize("more", [1, 8, 700])
def test_inserted_bytes_lose_only_that_realtime_packet(more: int) -> None:
    packets = [realtime(n) for n in range(5)]
    stream = b"".join([packets[0], packets[1][:500], b"\xee" * more, packets[1][500:], *packets[2:]])
    frames, framer = fed(RealtimeProtocol, stream)
    assert [frames[0], *frames[2:]] == [packets[0], *packets[2:]]
    assert framer.skipped == more


def test_digital_bits_equal_to_size_are_not_a_boundary() -> None:
    """Inputs 2, 6, 7 and 10 are on, which is 1220 as an integer, at the same offset of each packet."""
    packets = [realtime(n, digital_input_bits=1220, motor_temperatures=[25.0] * 6) for n in range(6)]
    assert packets[0][688:692] == packets[0][:4]
    # The stream continues in the middle of a packet, before the digital bits.
    for chunks in (lambda stream: [stream], bytewise):
        frames, framer = fed(RealtimeProtocol, *chunks(packets[0] + packets[1][100:] + b"".join(packets[2:])))
        assert frames == [packets[0], *packets[2:]]
        assert framer.skipped == 1120


@pytest.mark.parametrize("header", ["000004c4", "0000032c", "000001fc", "00000ffc"])
def test_doubles_similar_to_headers_are_not_a_boundary(header: str) -> None:
    (double,) = struct.unpack(">d", bytes.fromhex(header + "3ff00000"))
    (other,) = struct.unpack(">d", bytes.fromhex("3ff00000" + header))
    fields: dict[str, Any] = {
        "qd_actual": [double] * 6,
        "I_actual": [other] * 6,
    }
    packets = [realtime(n, **fields) for n in range(6)]
    for chunks in (lambda stream: [stream], bytewise):
        frames, _ = fed(RealtimeProtocol, *chunks(packets[0] + packets[1][7:] + b"".join(packets[2:])))
        assert frames == [packets[0], *packets[2:]]


def test_new_packet_size_is_accepted_after_two_packets() -> None:
    old, new = [realtime(n, "5.9") for n in range(2)], [realtime(n, "5.10") for n in range(2, 6)]
    frames, framer = fed(RealtimeProtocol, b"".join(old + new))
    # The first packet of the new size shows that the boundary is lost.
    assert frames == [*old, *new[1:]]
    assert framer.skipped == 1220
    session = RealtimeProtocol()
    frames = session.framer.feed(b"".join(old + new))
    # Each packet is decoded by its own length, although the boundary uses a newer length by now.
    states = [session.decode(frame) for frame in frames]
    assert [state.payload_mass for state in states] == [None, None, 0.0, 0.0, 0.0]
    assert all(state.tail == b"" for state in states)


# -- the package frame boundary


@pytest.mark.parametrize(
    "garbage",
    [
        b"\x00",
        bytes(9),
        b"\xff" * 300,
        b"\x00\x00\x02\xcc\x10",
        b"\x00\x00\x00\x18\x15\xff",
        b"\x00\x00\x40\x00\x63" + bytes(40),
        b"\x00\x00\x01\x00\x63" + b"\xaa" * 30,
        robot_state()[300:],
        bytes(range(256)),
    ],
)
@pytest.mark.parametrize("before", [VERSION, robot_state()], ids=["message", "state"])
def test_packages_around_garbage_are_all_found(garbage: bytes, before: bytes) -> None:
    later = [robot_state(number=n) for n in range(1, 4)]
    parts = [before, garbage, later[0], KEY, MODBUS, later[1], later[2]]
    for chunks in (parts, [b"".join(parts)], bytewise(b"".join(parts))):
        frames, framer = fed(PrimaryProtocol, *chunks)
        assert frames == [before, later[0], KEY, MODBUS, later[1], later[2]]
        assert (framer.skipped, framer.resyncs, framer.rest) == (len(garbage), framer.resyncs, b"")
        assert framer.resyncs >= 1


def test_message_after_garbage_is_found_with_next_package() -> None:
    frames, framer = fed(PrimaryProtocol, VERSION, b"\xee" * 20, KEY)
    assert frames == [VERSION]
    assert framer.feed(robot_state()) == [KEY, robot_state()]
    # Other packages do not prove a boundary, so they are skipped with the garbage.
    frames, framer = fed(PrimaryProtocol, VERSION, b"\xee" * 20, MODBUS, robot_state())
    assert frames == [VERSION, robot_state()]
    assert framer.skipped == 29


@pytest.mark.parametrize("length", [0x110, 0x114, 0x210, 0x214, 0x310, 0x514, 0x1010, 0x1410])
def test_size_that_resembles_a_type_is_found_after_zeros(length: int) -> None:
    """The pattern of a header matches one byte too early, but this must not hide the header itself."""
    part = UnknownSubPackage(payload=bytes(length - 10))
    state = bytes(RobotState(part))
    assert len(state) == length
    for zeros in range(1, 6):
        frames, framer = fed(PrimaryProtocol, VERSION + b"\xee" + bytes(zeros) + state + KEY)
        assert frames == [VERSION, state, KEY]
        assert framer.skipped == 1 + zeros


@pytest.mark.parametrize("size", [0, 4, 5, 6, 300, 715, 717, 816, 2000, 8191, -1, 2**31 - 1])
def test_wrong_size_loses_only_that_state(size: int) -> None:
    states = [robot_state(number=n) for n in range(16)]
    lying = struct.pack(">i", size) + states[1][4:]
    parts = [states[0], lying, *states[2:]]
    for chunks in ([b"".join(parts)], parts, bytewise(b"".join(parts))):
        frames, _ = fed(PrimaryProtocol, *chunks)
        good = [frame for frame in frames if frame in states]
        assert good == [states[0], *states[2:]]
        # Any other frames are small, and come from inside the damaged state.
        assert all(frame[:5] in lying for frame in frames if frame not in states)


def test_boundary_is_found_after_largest_wrong_size() -> None:
    states = [robot_state(number=n) for n in range(120)]
    lying = struct.pack(">i", 65536) + states[0][4:]
    frames, framer = fed(PrimaryProtocol, VERSION, lying, *states[1:])
    assert frames == [VERSION, *states[1:]]
    assert framer.skipped == len(lying)


def test_damaged_state_between_boundaries_fails_alone() -> None:
    states = [robot_state(number=n) for n in range(3)]
    broken = states[1][:5] + b"\x00\x00\x00\x03" + states[1][9:]
    session = PrimaryProtocol()
    outcome: list[State | None] = []
    for chunk in (states[0], broken, states[2]):
        for frame in session.framer.feed(chunk):
            try:
                outcome.append(session.decode(frame))
            except PacketError:
                outcome.append(None)
    kinds = [type(state).__name__ for state in outcome]
    assert kinds in (["RobotState", "NoneType", "RobotState"], ["RobotState", "RobotState"])
    assert outcome[0] is not None
    assert bytes(outcome[0]) == states[0]
    assert outcome[-1] is not None
    assert bytes(outcome[-1]) == states[2]


def test_unknown_packages_and_sub_packages_are_passed_on() -> None:
    subs = bytes(RobotModeData("5.8")) + struct.pack(">iB", 8, 14) + b"new" + bytes(ToolData("5.8"))
    unknown_sub = struct.pack(">iB", 5 + len(subs), 16) + subs
    longer = JointData.LAYOUTS.of("5.8").encode({}, b"appended")
    longer_state = struct.pack(">iB", 5 + len(longer), 16) + longer
    parts = [VERSION, UNKNOWN, UNKNOWN, unknown_sub, longer_state, UNKNOWN, robot_state()]
    for chunks in (parts, bytewise(b"".join(parts))):
        assert fed(PrimaryProtocol, *chunks)[0] == parts
    session = PrimaryProtocol()
    states = [session.decode(frame) for frame in session.framer.feed(b"".join(parts))]
    unknown = states[1]
    assert isinstance(unknown, OtherPackage)
    assert (unknown.type, unknown.payload) == (77, UNKNOWN[5:])
    state = states[3]
    assert isinstance(state, RobotState)
    assert [type(part) for part in state] == [RobotModeData, UnknownSubPackage, ToolData]
    state = states[4]
    assert isinstance(state, RobotState)
    assert state.joint_data is not None
    assert state.joint_data.tail == b"appended"


# -- wrong peers


@pytest.mark.parametrize("size", [1, 4, 7, 10**6])
@pytest.mark.parametrize(
    ("kind", "stream", "text"),
    [
        *[
            (PrimaryProtocol, realtime(0, version), "the real-time interface .port 30003")
            for version in ("1.8", "3.4", "5.4", "5.10")
        ],
        (PrimaryProtocol, bytes(RealtimeState("5.10")), "the real-time interface .port 30003"),
        (RealtimeProtocol, VERSION, "a primary or secondary interface .port 30001 or 30002"),
        (RealtimeProtocol, robot_state("1.8"), "a primary or secondary interface"),
        # A real-time packet could also have this length, 716 bytes.
        (RealtimeProtocol, robot_state("5.8"), "a primary or secondary interface"),
        (RealtimeProtocol, robot_state("5.8", first=True), "a primary or secondary interface"),
        (PrimaryProtocol, b"Connected: Universal Robots Dashboard Server\n", "the dashboard server .port 29999"),
        (RealtimeProtocol, b"Connected: Universal Robots Dashboard Server\n", "the dashboard server .port 29999"),
    ],
    ids=lambda value: value if isinstance(value, str) else None,
)
def test_wrong_port_is_named(kind: Session, stream: bytes, text: str, size: int) -> None:
    chunks = [stream[at : at + size] for at in range(0, len(stream), size)]
    expected = "a primary or secondary interface" if kind is PrimaryProtocol else "the real-time interface"
    with pytest.raises(WrongPeer, match=f"expected {expected} .port 3000.*, but this is {text}.*begins with b'"):
        fed(kind, *chunks)


@pytest.mark.parametrize("kind", [RealtimeProtocol, PrimaryProtocol])
def test_peer_without_valid_packets_raises_wrong_peer(kind: Session) -> None:
    chunks = [b"HTTP/1.1 400 Bad Request\r\n" * 40] * 100
    with pytest.raises(WrongPeer, match="without a valid packet"):
        fed(kind, *chunks)


def test_peer_with_valid_packet_is_never_rejected() -> None:
    packets = [realtime(n) for n in range(3)]
    frames, _ = fed(RealtimeProtocol, packets[0], VERSION, robot_state("5.8"), packets[1], packets[2])
    assert frames == packets
    states = [robot_state(number=n) for n in range(2)]
    frames, _ = fed(PrimaryProtocol, states[0], b"\xee" + realtime(0), states[1])
    assert frames == states


# -- the version that a controller reports


def popup_of_cb2() -> bytes:
    return bytes(
        PopupMessage("1.8", is_error=True, title="Popup", text="a text that is long enough for the new format")
    )


def version_message(major: int, minor: int) -> bytes:
    layout = f"{major}.{minor}"
    return bytes(
        VersionMessage(layout, project_name="URControl", major=major, minor=minor, build_date="Jul 08 2016, 16:07:20")
    )


def test_version_message_selects_layout_of_later_packets() -> None:
    assert PrimaryProtocol().firmware is None
    session = PrimaryProtocol()
    version = session.decode(version_message(1, 8))
    assert isinstance(version, VersionMessage)
    assert session.firmware == Firmware(1, 8)
    popup = session.decode(popup_of_cb2())
    assert isinstance(popup, PopupMessage)
    assert (popup.request_id, popup.is_error, popup.title) == (None, True, "Popup")
    # The meaning of the same length depends on the generation: an old board with a tail, or a newer, longer board.
    board = MasterboardData.LAYOUTS.of("1.8").encode({"robot_voltage_48V": 48.0}, b"12345678")
    state = session.decode(struct.pack(">iB", 5 + len(board), 16) + board)
    assert isinstance(state, RobotState)
    assert state.masterboard_data is not None
    assert (state.masterboard_data.robot_voltage_48V, state.masterboard_data.tail) == (48.0, b"12345678")


def test_packet_too_short_for_version_fails_alone() -> None:
    session = PrimaryProtocol()
    short = bytes(RobotState(RobotModeData("3.4"), AdditionalInfo("3.4")))
    assert isinstance(session.decode(short), RobotState)  # the firmware is unknown, so the length decides
    session.decode(version_message(5, 8))
    with pytest.raises(PacketError, match=r"RobotModeData of firmware 5\.8.*expected 47 bytes, got 46"):
        session.decode(short)
    assert isinstance(session.decode(robot_state("5.8")), RobotState)
    # A controller that returns with a different firmware sends a new version message.
    session.decode(version_message(3, 4))
    assert isinstance(session.decode(short), RobotState)
    assert session.firmware == (3, 4, 0, 0)


def test_sessions_are_independent() -> None:
    one, other = PrimaryProtocol(), PrimaryProtocol()
    one.decode(VERSION)
    one.framer.feed(VERSION[:9])
    assert other.firmware is None
    assert other.framer.rest == b""


def test_text_that_contains_packet_headers_is_framed_whole() -> None:
    """While the boundary is known, a size is trusted, and the inside of a package is not searched."""
    text = bytes(TextMessage(text="\x00\x00\x00\x18\x14\x00\x00\x02\x2c\x10"))
    parts = [VERSION, text, robot_state()]
    assert fed(PrimaryProtocol, *bytewise(b"".join(parts)))[0] == parts


@pytest.mark.real_time
def test_packages_next_to_bad_package_are_counted_once() -> None:
    broken = of_type(16, of_type(0, b"too short for robot mode data"[:20]))
    longer = JointData.LAYOUTS.of("5.8").encode({}, b"appended")
    chunk = UNKNOWN + of_type(16, longer) + broken + UNKNOWN + robot_state()
    transport = ScriptedTransport()
    source = Source(lambda: Identity(Firmware(5, 11), True, None), lambda name: transport, None, 5.0, None, False)
    stream = source.stream("primary", "script", lambda: None)
    transport.put(VERSION + chunk, Finished())
    stream.subscribe(lambda state: None, policy=block)
    assert stream.join(10)
    stream.close()
    stats = stream.stats
    assert (stats.received, stats.failed, stats.unknown, stats.tails) == (6, 1, 2, 1)


def of_type(kind: int, body: bytes) -> bytes:
    return struct.pack(">iB", 5 + len(body), kind) + body


def test_each_unknown_type_is_logged_once(caplog: pytest.LogCaptureFixture) -> None:
    session = PrimaryProtocol()
    unknown = of_type(77, b"x" * 4) + of_type(78, b"y" * 4)
    states = [of_type(16, bytes(RobotModeData("5.4")) + of_type(77 + number % 2, b"?" * 3)) for number in range(6)]
    frames = session.framer.feed(states[0] + unknown + b"".join(states))
    for frame in frames:
        session.decode(frame)
    assert session.unknown == len(frames)
    told = [record.message for record in caplog.records]
    assert len(told) == len(set(told)) == 4
    session.decode(of_type(5, bytes(4)))
    assert session.unknown == len(frames), "MODBUS info is a known type, although its contents are unknown"

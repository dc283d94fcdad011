"""Framer, which cuts a stream into packets. A packet here is ``#``, a size of two digits, a payload and ``.``."""

from __future__ import annotations

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from linkcore.errors import RemoteError, WrongPeer
from linkcore.wire.framing import Framer


class HashBoundary:
    largest = 99 + 3
    pace = 1
    size, head = 0, b""
    last: bytes | bytearray = b""

    def __str__(self) -> str:
        return "hashes"

    def declared(self, buffer: bytes | bytearray, at: int) -> int:
        digits = buffer[at + 1 : at + 3]
        return int(digits) if buffer[at : at + 1] == b"#" and digits.isdigit() and int(digits) >= 4 else 0

    def whole(self, buffer: bytes | bytearray) -> list[bytes]:
        return []

    def check(self, buffer: bytes | bytearray, at: int) -> tuple[int, int]:
        assert at < len(buffer), "the framer checks beyond the end of the buffer"
        there = len(buffer) - at
        if there < 3:
            return 0, 3
        size = self.declared(buffer, at)
        if not size:
            return 0, 0
        if there < size or buffer[at + size - 1 : at + size] == b".":
            return size, size
        # A damaged end is accepted if the next packet starts at the expected offset.
        if there < size + 3:
            return size, size + 3
        return size if self.declared(buffer, at + size) else 0, 0

    def search(self, buffer: bytes | bytearray, start: int) -> tuple[int, int, int]:
        for at in range(start, len(buffer) - 2):
            size, need = self.check(buffer, at)
            if size or need > len(buffer) - at:
                return at, size, need
        return max(start, len(buffer) - 2), 0, 4

    def peer(self, buffer: bytes | bytearray) -> str | None:
        return "a dog" if buffer.startswith(b"wau") else None


class WholeBoundary(HashBoundary):
    """Boundary that cuts whole packets of one size in one step, like the boundaries of the robot's interfaces."""

    def whole(self, buffer: bytes | bytearray) -> list[bytes]:
        found: list[bytes] = []
        at = 0
        first = self.declared(buffer, 0)
        while first and self.declared(buffer, at) == first and buffer[at + first - 1 : at + first] == b".":
            found.append(bytes(buffer[at : at + first]))
            at += first
        return found


def packet(payload: bytes) -> bytes:
    return b"#%02d%b." % (len(payload) + 4, payload)


def fed(*pieces: bytes, boundary: type[HashBoundary] = HashBoundary) -> tuple[list[bytes], Framer]:
    framer = Framer(boundary())
    total = 0
    frames = []
    for piece in pieces:
        frames += framer.feed(piece)
        total += len(piece)
        assert framer.skipped + sum(map(len, frames)) + len(framer.rest) == total
        assert len(framer.rest) < boundary.largest + boundary.pace
    return frames, framer


def bytewise(data: bytes) -> list[bytes]:
    return [data[n : n + 1] for n in range(len(data))]


ONE, TWO, THREE = packet(b"one"), packet(b""), packet(b"three" * 15)


def test_framer_cuts_packets_at_their_boundaries() -> None:
    frames, framer = fed(ONE + TWO + THREE)
    assert frames == [ONE, TWO, THREE]
    assert (framer.skipped, framer.resyncs, framer.rest) == (0, 0, b"")


def test_framer_keeps_an_unfinished_packet() -> None:
    frames, framer = fed(ONE + THREE[:-1])
    assert frames == [ONE]
    assert framer.rest == THREE[:-1]
    assert framer.feed(THREE[-1:]) == [THREE]
    assert framer.rest == b""


@pytest.mark.parametrize("boundary", [HashBoundary, WholeBoundary])
def test_framer_ignores_empty_input(boundary: type[HashBoundary]) -> None:
    frames, framer = fed(b"", ONE[:2], b"", ONE[2:], b"", TWO, boundary=boundary)
    assert frames == [ONE, TWO]
    assert framer.rest == b""


def test_is_between_packets_after_whole_packets_only() -> None:
    framer = Framer(HashBoundary())
    assert framer.is_between_packets
    for piece, is_between in ((ONE[:1], False), (ONE[1:], True), (b"x", False), (TWO[:-1], False), (TWO[-1:], True)):
        framer.feed(piece)
        assert framer.is_between_packets == is_between


@pytest.mark.parametrize("garbage", [b"x", b"##", b"#0", b"#00", b"#xx", b"long and without end"])
def test_framer_resynchronises_after_garbage_and_counts_bytes(garbage: bytes) -> None:
    frames, framer = fed(ONE + garbage + TWO + ONE)
    assert frames == [ONE, TWO, ONE]
    assert (framer.skipped, framer.resyncs) == (len(garbage), 1)
    frames, framer = fed(ONE, garbage, TWO, garbage, garbage, ONE)
    assert frames == [ONE, TWO, ONE]
    assert (framer.skipped, framer.resyncs) == (3 * len(garbage), 2)


def test_wrong_size_does_not_swallow_following_packets() -> None:
    frames, framer = fed(b"#30abc." + ONE + TWO + THREE)
    assert frames == [ONE, TWO, THREE]
    assert (framer.skipped, framer.resyncs) == (7, 1)


def test_packet_with_damaged_end_is_framed_before_valid_header() -> None:
    damaged = ONE[:-1] + b"!"
    frames, framer = fed(damaged)
    assert frames == []
    assert framer.rest == damaged
    assert framer.feed(TWO) == [damaged, TWO]
    frames, framer = fed(damaged, b"xyz", TWO)
    assert frames == [TWO]


def test_wrong_peer_is_recognised_by_the_first_bytes_only() -> None:
    with pytest.raises(WrongPeer, match=r"expected hashes, but this is a dog: it begins with b'wauwau'") as caught:
        fed(b"wauwau")
    assert isinstance(caught.value, RemoteError)
    assert fed(ONE + b"wau" + TWO)[0] == [ONE, TWO]
    assert fed(b"xwau" + TWO)[0] == [TWO]


def test_peer_without_packets_raises_wrong_peer_after_the_limit() -> None:
    framer = Framer(HashBoundary(), limit=1000)
    assert framer.feed(b"x" * 1000) == []
    with pytest.raises(WrongPeer, match="without a valid packet"):
        framer.feed(b"x" * 10)
    # A peer that has sent one packet is accepted, however many bytes are skipped later.
    framer = Framer(HashBoundary(), limit=1000)
    framer.feed(ONE)
    for _ in range(100):
        assert framer.feed(b"x" * 100) == []
    assert framer.feed(TWO) == [TWO]
    # Without a limit every peer is accepted, even one that identifies itself as something else.
    framer = Framer(HashBoundary(), limit=None)
    assert framer.feed(b"wauwau" * 1000 + ONE) == [ONE]


def test_framer_raises_wrong_peer_exactly_beyond_skip_limit() -> None:
    framer = Framer(HashBoundary(), limit=1000)
    framer.feed(b"x" * 1002)
    assert framer.skipped == 1000
    with pytest.raises(WrongPeer, match="received 1002 bytes"):
        framer.feed(b"xx")
    # The default limit is 64 KiB.
    framer = Framer(HashBoundary())
    framer.feed(b"x" * (65536 + 2))
    with pytest.raises(WrongPeer, match="received 65538 bytes"):
        framer.feed(b"xx")


def test_two_packets_in_one_chunk_confirm_the_peer() -> None:
    framer = Framer(WholeBoundary(), limit=1000)
    assert framer.feed(ONE + TWO + b"x") == [ONE, TWO]
    assert framer.feed(b"x" * 5000) == []
    assert framer.feed(TWO) == [TWO]


def test_resynchronising_does_not_search_for_each_byte() -> None:
    class SlowBoundary(HashBoundary):
        pace = 50
        searches = 0

        def search(self, buffer: bytes | bytearray, start: int) -> tuple[int, int, int]:
            self.searches += 1
            return super().search(buffer, start)

    boundary = SlowBoundary()
    framer = Framer(boundary)
    for _ in range(1000):
        framer.feed(b"x")
    assert 1000 / 60 < boundary.searches < 1000 / 40


@pytest.mark.property
@given(
    st.lists(
        st.one_of(
            st.binary(max_size=60).map(packet),
            st.binary(max_size=20),
            st.text("#.0123", max_size=12).map(str.encode),
        ),
        max_size=12,
    ).map(b"".join),
    st.sampled_from([HashBoundary, WholeBoundary]),
    st.data(),
)
@example(b"#30abc.#04.#08abcd.#09", HashBoundary, None)
@example(b"#04.xxx#04.#04.", WholeBoundary, None)
def test_frames_do_not_depend_on_chunking(
    stream: bytes, boundary: type[HashBoundary], data: st.DataObject | None
) -> None:
    if HashBoundary().peer(stream):
        return
    whole, framer = fed(stream, boundary=boundary)
    # These bytes decide packets that are still undecided.
    more = b"x" * 99
    in_the_end, _ = fed(stream + more, boundary=boundary)
    ways = [bytewise(stream)]
    if data is not None:
        cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=5)))
        ways.append([stream[start:end] for start, end in zip([0, *cuts], [*cuts, len(stream)], strict=True)])
    for pieces in ways:
        frames, other = fed(*pieces, boundary=boundary)
        assert frames == whole[: len(frames)]
        if frames == whole:
            assert other.skipped + len(other.rest) == framer.skipped + len(framer.rest)
            assert other.resyncs == framer.resyncs
        frames, _ = fed(*pieces, *bytewise(more), boundary=boundary)
        assert frames[: len(whole)] == whole
        assert frames == in_the_end[: len(frames)]

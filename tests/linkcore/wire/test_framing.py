"""The loop that cuts a stream, with a border as simple as can be: ``#``, a size of two digits, a payload, ``.``."""

from __future__ import annotations

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from linkcore.errors import RemoteError, WrongPeer
from linkcore.wire.framing import Framer


class HashBorder:
    header = 3
    largest = 99

    def __str__(self) -> str:
        return "hashes"

    def size_at(self, buffer: bytes, at: int) -> int:
        digits = buffer[at + 1 : at + 3]
        return int(digits) if buffer[at : at + 1] == b"#" and digits.isdigit() and int(digits) >= 4 else 0

    def whole(self, buffer: bytes) -> list[bytes]:
        return []

    def is_broken(self, buffer: bytes, at: int, size: int) -> bool | None:
        if buffer[at + size - 1 : at + size] == b".":
            return False
        # A damaged end is forgiven when the next packet stands where it should.
        return None if at + size + 3 > len(buffer) else self.size_at(buffer, at + size) == 0

    def find(self, buffer: bytes, start: int) -> tuple[int, bool]:
        for at in range(start, len(buffer) - 2):
            if self.size_at(buffer, at):
                return at, True
        return max(start, len(buffer) - 2), False

    def peer(self, buffer: bytes) -> str | None:
        return "a dog" if buffer.startswith(b"wau") else None


def packet(payload: bytes) -> bytes:
    return b"#%02d%b." % (len(payload) + 4, payload)


def fed(*pieces: bytes) -> tuple[list[bytes], Framer]:
    framer = Framer(HashBorder())
    total = 0
    frames = []
    for piece in pieces:
        frames += framer.feed(piece)
        total += len(piece)
        assert framer.skipped + sum(map(len, frames)) + len(framer.rest) == total
        assert len(framer.rest) < HashBorder.largest + HashBorder.header
    return frames, framer


def bytewise(data: bytes) -> list[bytes]:
    return [data[n : n + 1] for n in range(len(data))]


ONE, TWO, THREE = packet(b"one"), packet(b""), packet(b"three" * 15)


def test_packets_are_cut_at_their_borders() -> None:
    frames, framer = fed(ONE + TWO + THREE)
    assert frames == [ONE, TWO, THREE]
    assert (framer.skipped, framer.resyncs, framer.rest) == (0, 0, b"")


def test_an_unfinished_packet_waits() -> None:
    frames, framer = fed(ONE + THREE[:-1])
    assert frames == [ONE]
    assert framer.rest == THREE[:-1]
    assert framer.feed(THREE[-1:]) == [THREE]
    assert framer.rest == b""


def test_nothing_is_nothing() -> None:
    frames, framer = fed(b"", ONE[:2], b"", ONE[2:], b"")
    assert frames == [ONE]
    assert framer.rest == b""


@pytest.mark.parametrize("garbage", [b"x", b"##", b"#0", b"#00", b"#xx", b"long and without end"])
def test_a_lost_border_is_found_again_and_counted(garbage: bytes) -> None:
    frames, framer = fed(ONE + garbage + TWO + ONE)
    assert frames == [ONE, TWO, ONE]
    assert (framer.skipped, framer.resyncs) == (len(garbage), 1)
    frames, framer = fed(ONE, garbage, TWO, garbage, garbage, ONE)
    assert frames == [ONE, TWO, ONE]
    assert (framer.skipped, framer.resyncs) == (3 * len(garbage), 2)


def test_a_size_that_lies_does_not_swallow_what_is_inside() -> None:
    frames, framer = fed(b"#30abc." + ONE + TWO + THREE)
    assert frames == [ONE, TWO, THREE]
    assert (framer.skipped, framer.resyncs) == (7, 1)


def test_what_cannot_be_told_yet_waits_for_the_next_header() -> None:
    damaged = ONE[:-1] + b"!"
    frames, framer = fed(damaged)
    assert frames == []
    assert framer.rest == damaged
    assert framer.feed(TWO) == [damaged, TWO]
    frames, framer = fed(damaged, b"xyz", TWO)
    assert frames == [TWO]


def test_somebody_else_is_told_by_the_first_bytes_and_only_by_them() -> None:
    with pytest.raises(WrongPeer, match=r"expected hashes, but this is a dog: it begins with b'wauwau'") as caught:
        fed(b"wauwau")
    assert isinstance(caught.value, RemoteError)
    assert fed(ONE + b"wau" + TWO)[0] == [ONE, TWO]
    assert fed(b"xwau" + TWO)[0] == [TWO]


def test_patience_with_a_peer_that_sends_no_packet_ends() -> None:
    framer = Framer(HashBorder())
    assert framer.feed(b"x" * framer.patience) == []
    with pytest.raises(WrongPeer, match="no packet among them"):
        framer.feed(b"x" * 10)
    # Somebody who has sent a packet once is right, however much is lost later.
    framer = Framer(HashBorder())
    framer.feed(ONE)
    for _ in range(100):
        assert framer.feed(b"x" * 1000) == []
    assert framer.feed(TWO) == [TWO]


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
    st.data(),
)
@example(b"#30abc.#04.#08abcd.#09", None)
def test_it_does_not_matter_how_the_bytes_are_cut(stream: bytes, data: st.DataObject | None) -> None:
    if HashBorder().peer(stream):
        return
    frames, framer = fed(stream)
    again, other = fed(*bytewise(stream))
    assert again == frames
    assert (other.skipped, other.resyncs, other.rest) == (framer.skipped, framer.resyncs, framer.rest)
    if data is not None:
        cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=5)))
        pieces = [stream[start:end] for start, end in zip([0, *cuts], [*cuts, len(stream)], strict=True)]
        assert fed(*pieces)[0] == frames

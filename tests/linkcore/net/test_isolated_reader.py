"""Data that two processes share: the slot with the newest packet, and the records of the pipe."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from linkcore.clock import Stamp
from linkcore.net.isolated_reader import CONNECTED, DATA, LOST, HandedOver, Records, Slot

stamps = st.builds(Stamp, st.floats(0, 1e9), st.floats(0, 2e9))


@pytest.mark.property
@given(st.lists(st.tuples(st.binary(max_size=2000), stamps), min_size=1, max_size=5), st.integers(0, 31))
def test_slot_returns_the_newest_packet_whole_or_none(packets: list[tuple[bytes, Stamp]], torn: int) -> None:
    slot = Slot()
    try:
        other = Slot(slot.descriptor)
        assert other.get() is None
        for number, (packet, stamp) in enumerate(packets, 1):
            slot.put(packet, stamp)
            assert other.get() == (number, packet, stamp)
        # A reader that reads in the middle of a write may find bytes of different packets.
        slot._memory[torn] ^= 0xFF
        found = other.get()
        assert found is None or found[1:] == packets[-1]
        slot.clear()
        assert other.get() is None
        slot.put(bytes(1 << 17), Stamp(0, 0))  # longer than the slot
        assert other.get() is None
        other._memory.close()
    finally:
        slot.close()
        slot.close()


@pytest.mark.property
@given(
    st.lists(
        st.builds(HandedOver, st.sampled_from([CONNECTED, DATA, LOST]), st.binary(max_size=50), stamps), max_size=6
    ),
    st.lists(st.integers(0, 400), max_size=10),
)
def test_records_do_not_depend_on_chunking(records: list[HandedOver], cuts: list[int]) -> None:
    data = b"".join(map(bytes, records))
    places = sorted({0, len(data), *(min(cut, len(data)) for cut in cuts)})
    taker = Records()
    found = [record for a, b in itertools.pairwise(places) for record in taker.feed(data[a:b])]
    assert found == records

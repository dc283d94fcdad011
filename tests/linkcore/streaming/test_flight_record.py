"""Tests of the flight record: its order, its bounds, and the record of sent bytes."""

import tracemalloc

import pytest

from linkcore import clock
from linkcore.streaming import flight_record
from linkcore.streaming.flight_record import LONGEST, SECONDS, FlightRecord, Received, SentRecord


def test_chunks_keep_order_and_times() -> None:
    record = FlightRecord(10, 10_000)
    for number in range(3):
        record.keep(bytes([number]))
        record.keep(float(number))
    assert record.chunks == [Received(0.0, b"\0"), Received(1.0, b"\1"), Received(2.0, b"\2")]
    assert record.since(1.0) == ([b"\1", b"\2"], [1.0, 2.0])


def test_oldest_chunk_leaves_a_full_record() -> None:
    record = FlightRecord(2, 10_000)
    for number in range(5):
        record.keep(bytes([number]))
        record.keep(float(number))
    assert [each.data for each in record.chunks] == [b"\3", b"\4"]


def test_batches_are_limited_by_their_size() -> None:
    record = FlightRecord(5000, 3_000_000)
    for number in range(200):
        record.keep(bytes(65_536))
        record.keep(float(number))
        record.batch(65_536)
        assert sum(len(each.data) for each in record.chunks) <= 3_000_000 + (1 << 20) + 65_536
    assert record.chunks[-1].time == 199.0


def test_ten_seconds_at_500_hz_need_less_than_7_mb() -> None:
    record = FlightRecord(5000, 7_000_000)
    tracemalloc.start()
    for number in range(6000):
        record.keep(bytes(1220))
        record.keep(number / 500 + 0.001)
    size, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert size < 7_000_000
    assert record.chunks[-1].time - record.chunks[0].time == pytest.approx(SECONDS, abs=0.01)


def test_sent_record_keeps_the_beginning_of_long_messages() -> None:
    record = SentRecord(1_000_000)
    record.keep("primary", memoryview(b"x" * 10_000))
    (sent,) = record.messages
    assert (sent.channel, len(sent.data)) == ("primary", LONGEST)


def test_sent_record_is_limited_in_size_and_time(monkeypatch: pytest.MonkeyPatch) -> None:
    record, now = SentRecord(100_000), 0.0
    monkeypatch.setattr(clock, "now", lambda: now)
    for number in range(2000):
        now = number * 0.01
        record.keep("program", bytes(56))
    assert sum(len(each.data) + 192 for each in record.messages) <= 100_000 + 64 * 250
    assert record.messages[0].time >= now - SECONDS - 64 * 0.01


def test_sent_record_counts_each_message_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Counting all messages again would delay a servo loop by a millisecond at regular times."""
    count, memory = 0, flight_record._memory

    def counting(sent: flight_record.Sent) -> int:
        nonlocal count
        count += 1
        return memory(sent)

    monkeypatch.setattr(flight_record, "_memory", counting)
    record = SentRecord(1_000_000)
    for _ in range(4096):
        record.keep("program", bytes(56))
    assert len(record.messages) == 1_000_000 // 248
    # Once when they are added, and once when they are removed.
    assert count == 4096 + 4096 - 1_000_000 // 248


def test_sent_record_keeps_a_message_that_is_sent_while_it_is_trimmed(monkeypatch: pytest.MonkeyPatch) -> None:
    record, memory = SentRecord(64 * 248), flight_record._memory
    late = [bytes(100)]

    def interrupted(sent: flight_record.Sent) -> int:
        if late:
            record.keep("program", late.pop())  # in a signal handler
        return memory(sent)

    monkeypatch.setattr(flight_record, "_memory", interrupted)
    for _ in range(64):
        record.keep("program", bytes(56))
    assert [len(each.data) for each in record.messages] == [56] * 64 + [100]
    for _ in range(128):
        record.keep("program", bytes(56))
    # All messages were counted, so the limit holds, apart from the messages since the last time.
    assert sum(map(memory, record.messages)) <= (64 + 64) * 248

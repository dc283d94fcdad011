"""Streams that an event loop reads, over real sockets: they lose no packets and leave no tasks or threads."""

from __future__ import annotations

import asyncio
import contextlib
import functools
import threading
import time
from collections.abc import AsyncIterator, Callable, Coroutine
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from linkcore.aio.async_stream import AsyncStream
from linkcore.aio.loop_connection import LoopConnection
from linkcore.aio.packets import LoopQueue
from linkcore.errors import BadValue, Closed, ConnectFailed, LinkTimeout, LocalError
from linkcore.net.awaited import AwaitedTcp
from linkcore.streaming.connection_life import Backoff, ConnectionEvent, ConnectionState
from linkcore.streaming.fanout import FanOut
from linkcore.streaming.packet_queue import Policy, block, drop_oldest, latest
from linkcore.streaming.stream import Stream
from tests.fakes.link import AT_ONCE, BAD, Count, CountProtocol, counts

pytestmark = pytest.mark.real_time

#: Time limit of a test, in seconds, even on a busy machine.
SOON = 20.0

Test = Callable[[], Coroutine[Any, Any, None]]


def awaited(test: Test) -> Callable[[], None]:
    """Run a test in its own loop with a time limit, and check that it leaves no task and no thread."""

    @functools.wraps(test)
    def run() -> None:
        async def bounded() -> None:
            await asyncio.wait_for(test(), SOON)
            assert asyncio.all_tasks() == {asyncio.current_task()}

        threads = threading.active_count()
        asyncio.run(bounded())
        assert threading.active_count() == threads

    return run


class Peer:
    """Server that accepts connections one after the other. The test writes to them."""

    def __init__(self) -> None:
        self._connections: asyncio.Queue[asyncio.StreamWriter] = asyncio.Queue()
        self.port = 0
        self.readers: list[asyncio.StreamReader] = []
        self.writers: list[asyncio.StreamWriter] = []

    async def accepted(self) -> asyncio.StreamWriter:
        return await self._connections.get()

    async def take(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.readers.append(reader)
        self.writers.append(writer)
        await self._connections.put(writer)


@contextlib.asynccontextmanager
async def listening() -> AsyncIterator[Peer]:
    peer = Peer()
    server = await asyncio.start_server(peer.take, "127.0.0.1", 0)
    peer.port = server.sockets[0].getsockname()[1]
    try:
        yield peer
    finally:
        server.close()
        for writer in peer.writers:
            writer.close()
        await asyncio.sleep(0)  # the loop closes the connections in this step


def connection_to(
    peer: Peer, *, silence: float | None = None, backoff: Backoff = AT_ONCE, tcp: type[AwaitedTcp] = AwaitedTcp
) -> LoopConnection:
    transport = tcp("127.0.0.1", peer.port, silence=silence or 2.0)
    loop = asyncio.get_running_loop()
    return LoopConnection(
        "script", transport, CountProtocol, FanOut(Count), backoff=backoff, silence=silence, timeout=5.0, loop=loop
    )


def stream_to(peer: Peer, **options: Any) -> AsyncStream[Count]:
    return stream_of(connection_to(peer, **options))


def stream_of(connection: LoopConnection) -> AsyncStream[Count]:
    return AsyncStream(Stream(connection, Count))


async def come(condition: Callable[[], object]) -> None:
    while not condition():
        await asyncio.sleep(0.001)


async def numbers(packets: AsyncIterator[Count], count: int) -> list[int]:
    found: list[int] = []
    async for packet in packets:
        found.append(packet.number)
        if len(found) == count:
            break
    return found


@awaited
async def test_packets_arrive_in_order_and_are_counted() -> None:
    async with listening() as peer, stream_to(peer) as stream:
        assert stream.latest is None
        seen: list[int] = []
        subscription = await stream.subscribe(lambda packet: seen.append(packet.number))
        packets = stream.iterate(block)
        await packets.open()
        writer = await peer.accepted()
        data = counts(*range(100), BAD, *range(100, 200))
        writer.write(data[:7])
        await writer.drain()
        writer.write(data[7:])
        assert await numbers(packets, 200) == seen == list(range(200))
        assert stream.latest == Count(number=199)
        assert (stream.stats.received, stream.stats.decoded, stream.stats.failed) == (201, 200, 1)
        assert (packets.stats.offered, packets.stats.delivered, packets.stats.dropped) == (200, 200, 0)
        assert (subscription.stats.offered, subscription.stats.delivered) == (200, 200)


@awaited
async def test_on_deadline_is_called_in_the_loop_thread() -> None:
    async with listening() as peer, stream_to(peer) as stream:
        late: asyncio.Queue[tuple[float, int]] = asyncio.Queue()
        thread = threading.get_ident()
        subscription = await stream.subscribe(
            lambda packet: None,
            deadline=0.01,
            on_deadline=lambda age: late.put_nowait((age, threading.get_ident())),
        )
        await peer.accepted()
        age, where = await late.get()
        assert (age >= 0.01, where) == (True, thread)
        threads = threading.active_count()
        subscription.close()
        await come(lambda: threading.active_count() < threads)
        with pytest.raises(BadValue, match="without a deadline"):
            await stream.subscribe(lambda packet: None, on_deadline=print)


@awaited
async def test_join_waits_for_the_end() -> None:
    async with listening() as peer, stream_to(peer) as stream:
        assert await stream.join()  # returns at once, because the stream was not started
        await stream.start()
        await peer.accepted()
        assert not await stream.join(0.01)
        joining = asyncio.create_task(stream.join())
        await asyncio.sleep(0)
        assert not joining.done()
        await stream.close()
        assert await joining
        assert await stream.description() == {}


@awaited
async def test_unknown_attribute_raises_attribute_error() -> None:
    async with listening() as peer, stream_to(peer) as stream:
        for held in (stream, stream.of(Count)):
            with pytest.raises(AttributeError):
                held.lates = None  # type: ignore[attr-defined]
        await stream.start()


@awaited
async def test_slow_iterator_drops_the_oldest_and_counts_drops() -> None:
    async with listening() as peer, stream_to(peer) as stream:
        some, newest = stream.iterate(drop_oldest(3)), stream.iterate(latest)
        await some.open()
        await newest.open()
        (await peer.accepted()).write(counts(*range(10)))
        await come(lambda: stream.stats.received == 10)
        assert some.stats.waiting == 3
        assert await numbers(some, 3) == [7, 8, 9]
        assert await numbers(newest, 1) == [9]
        assert stream.stats.dropped == 7 + 9
        await some.aclose()
        peer.writers[0].write(counts(10, 11))
        await come(lambda: stream.stats.received == 12)
        # A packet that is still queued when the iterator is closed counts as dropped.
        await newest.aclose()
        assert stream.stats.dropped == 7 + 9 + 1
        assert (some.stats.offered, some.stats.delivered, some.stats.dropped) == (10, 3, 7)


@awaited
async def test_block_policy_pauses_reading_while_the_queue_is_full() -> None:
    numbered = range(1000, 16_000)  # 75 kB; one read returns at most 64 KiB
    async with listening() as peer, stream_to(peer, silence=0.3) as stream:
        packets = stream.iterate(Policy(100, drop=None))
        await packets.open()
        (await peer.accepted()).write(counts(*numbered))
        await come(lambda: packets.stats.waiting >= 100)
        waiting = packets.stats.waiting
        await asyncio.sleep(0.4)  # longer than `silence`, which is not measured while reading is paused
        assert packets.stats.waiting == waiting <= 100 + 65536 // 5
        assert stream.stats.received == waiting < len(numbered)
        assert await numbers(packets, len(numbered)) == list(numbered)
        assert (packets.stats.offered, packets.stats.dropped, stream.stats.reconnects) == (len(numbered), 0, 0)


@awaited
async def test_stream_reconnects_and_delivers_again() -> None:
    async with listening() as peer, stream_to(peer) as stream:
        events = stream.of(ConnectionEvent).iterate()
        await events.open()
        packets = stream.iterate(block)
        await packets.open()
        for number in range(3):
            writer = await peer.accepted()
            writer.write(counts(number))
            assert await numbers(packets, 1) == [number]
            writer.close()
        await peer.accepted()
        await come(lambda: stream.stats.reconnects == 3)
        assert stream.latest is None  # the packet of the previous connection was dropped
        states = [(await anext(events)).state for _ in range(6)]
        again = [ConnectionState.LOST, ConnectionState.CONNECTING, ConnectionState.CONNECTED]
        assert [state for state in states if state in again][-3:] in (
            again,
            again[1:] + again[:1],
            again[2:] + again[:2],
        )


@awaited
async def test_silence_ends_connection_but_blocked_event_loop_does_not() -> None:
    async with listening() as peer, stream_to(peer, silence=0.3) as stream:
        packets = stream.iterate(block)
        await packets.open()
        writer = await peer.accepted()
        writer.write(counts(1))
        assert await numbers(packets, 1) == [1]
        writer.write(counts(2))  # this packet waits in the kernel while the loop is blocked
        time.sleep(0.7)
        assert await numbers(packets, 1) == [2]
        assert stream.stats.reconnects == 0
        with pytest.raises(LinkTimeout, match=r"no Count from script within 0\.1 s"):
            await stream.wait(0.1)
        again = await peer.accepted()  # reconnected after 0.3 s of silence
        await come(lambda: stream.stats.reconnects == 1)
        again.write(counts(3))
        assert await numbers(packets, 1) == [3]


@awaited
async def test_cancelled_wait_loses_no_packet_and_no_queue() -> None:
    async with listening() as peer, stream_of(connection := connection_to(peer)) as stream:
        packets = stream.iterate(block)
        await packets.open()
        writer = await peer.accepted()
        for number in range(20):
            waiting = asyncio.create_task(anext(packets))
            await asyncio.sleep(0)
            with pytest.raises(LocalError, match="another task is already waiting"):
                await anext(packets)
            writer.write(counts(number))
            waiting.cancel()
            with pytest.raises(asyncio.CancelledError):
                await waiting
            assert await numbers(packets, 1) == [number]
        found = asyncio.create_task(stream.wait_until(lambda packet: packet.number == 22, 10))
        await asyncio.sleep(0.01)
        writer.write(counts(20, 21, 22, 23))
        assert (await found).number == 22
        asyncio.get_running_loop().call_later(0.02, lambda: writer.write(counts(24)))
        with pytest.raises(LinkTimeout, match=r"no packet met the condition within 0\.3 s; examined 1 Count"):
            await stream.wait_until(lambda packet: packet.number == 99, 0.3)
        assert stream.latest == Count(number=24)
        # The queues of the ended waits are removed.
        assert len(connection.fan_out.sinks) == 1


@awaited
async def test_refused_connection_raises_and_the_next_use_retries() -> None:
    async with listening() as peer:
        port = peer.port
    nobody = Peer()
    nobody.port = port
    async with stream_to(nobody) as stream:
        for _ in range(2):
            with pytest.raises(ConnectFailed, match="refused"):
                await stream.wait()
    with pytest.raises(Closed):
        await stream.wait()


@awaited
async def test_close_ends_iteration_and_pending_connects() -> None:
    class Never(AwaitedTcp):
        async def connect(self, timeout: float) -> None:
            await asyncio.Event().wait()

    async with listening() as peer, stream_to(peer) as stream:
        ending = asyncio.create_task(numbers(stream.iterate(), 10))
        await peer.accepted()
        await stream.close()
        assert await ending == []
        assert stream.connection is ConnectionState.CLOSED
    loop = asyncio.get_running_loop()
    connection = LoopConnection("never", Never("::1", 1, silence=1), CountProtocol, FanOut(Count), loop=loop)
    never = AsyncStream(Stream(connection, Count))
    waiting = asyncio.create_task(never.wait(10))
    await asyncio.sleep(0.01)
    await never.close()
    with pytest.raises(Closed):
        await waiting


@awaited
async def test_close_during_the_start_of_a_stream_raises_closed() -> None:
    """A signal handler might close the stream before the start is recorded."""
    loop = asyncio.get_running_loop()
    connection = LoopConnection("never", AwaitedTcp("::1", 1, silence=1), CountProtocol, FanOut(Count), loop=loop)
    with pytest.raises(Closed, match="never was closed"):
        await connection.connected(connection.abandon)


@awaited
async def test_blocking_calls_raise_only_in_the_event_loop_thread() -> None:
    async with listening() as peer, stream_of(connection := connection_to(peer)) as stream:
        threaded = stream.stream
        with pytest.raises(LocalError, match=r"thread of the event loop.*await the call instead"):
            threaded.start()
        waiting = asyncio.create_task(asyncio.to_thread(threaded.wait, SOON))
        writer = await peer.accepted()
        await come(lambda: connection.fan_out.sinks)
        with pytest.raises(LocalError, match="await the call instead"):
            threaded.wait()
        writer.write(counts(5))
        assert (await waiting).number == 5
        await asyncio.to_thread(connection.send, b"hello", SOON)
        assert await peer.readers[0].readexactly(5) == b"hello"
        await asyncio.to_thread(connection.abort)
        await peer.accepted()
        await come(lambda: stream.stats.reconnects == 1)
        # A thread that closes the stream waits until the loop has closed it.
        await asyncio.to_thread(threaded.close, SOON)
        assert stream.connection is ConnectionState.CLOSED
    # Only this test uses the thread pool of the loop.
    await asyncio.get_running_loop().shutdown_default_executor()


class _Connection:
    """Part of a connection that a queue uses."""

    def __init__(self) -> None:
        self.is_held = False

    def hold(self, queue: object) -> None:
        self.is_held = True

    def release(self, queue: object) -> None:
        self.is_held = False


@pytest.mark.property
@given(
    st.integers(1, 5),
    st.booleans(),
    st.lists(st.one_of(st.integers(1, 8), st.just("take"), st.just("close")), max_size=30),
)
def test_queue_counts_every_packet(limit: int, drops: bool, steps: list[int | str]) -> None:
    connection: Any = _Connection()
    queue = LoopQueue((drop_oldest(limit) if drops else Policy(limit, drop=None)), connection)
    given_number, is_closed, taken = 0, False, []
    for step in steps:
        if step == "take":
            packet = queue.take()
            if packet is not None:
                taken.append(packet)
        elif step == "close":
            queue.close()
            is_closed = True
        elif isinstance(step, int):
            queue.offer(range(given_number, given_number + step))
            given_number += 0 if is_closed else step
        assert queue.offered == given_number == queue.taken + queue.dropped + queue.waiting
        assert taken == sorted(set(taken))
        if drops:
            assert queue.waiting <= limit
            assert not connection.is_held
        else:
            assert queue.dropped == 0 or is_closed
            assert connection.is_held or queue.waiting < limit

"""Ends of streams that an event loop reads, while other threads and tasks use them."""

from __future__ import annotations

import asyncio
import contextlib
import time

import pytest

from linkcore import clock
from linkcore.aio import loop_connection
from linkcore.aio.async_stream import AsyncStream
from linkcore.errors import LinkError
from linkcore.net.awaited import AwaitedTcp
from linkcore.streaming.connection_life import ConnectionState
from linkcore.streaming.packet_queue import Policy, block, drop_oldest
from tests.fakes.link import Count, counts
from tests.linkcore.aio.test_async_stream import awaited, come, connection_to, listening, stream_of, stream_to

pytestmark = pytest.mark.real_time

#: Maximum duration of an ending on a busy machine, in s. A wait that is not ended takes longer.
_AT_ONCE = 3.0


@awaited
async def test_closed_iterator_gets_no_more_packets() -> None:
    async with listening() as peer, stream_of(connection := connection_to(peer)) as stream:
        packets, other = stream.iterate(block), stream.iterate(block)
        await packets.open()
        await other.open()
        writer = await peer.accepted()
        await packets.aclose()
        writer.write(counts(1))
        assert (await other.__anext__()).number == 1
        assert len(connection.fan_out.sinks) == 1
        await other.aclose()


@awaited
async def test_stream_continues_when_a_full_iterator_is_closed() -> None:
    async with listening() as peer, stream_to(peer) as stream:
        full, other = stream.iterate(Policy(2, drop=None)), stream.iterate(drop_oldest(100))
        await full.open()
        await other.open()
        writer = await peer.accepted()
        writer.write(counts(1, 2, 3))
        await come(lambda: full.stats.waiting == 3)
        await full.aclose()
        writer.write(counts(4))
        assert [(await asyncio.wait_for(other.__anext__(), _AT_ONCE)).number for _ in range(4)] == [1, 2, 3, 4]
        await other.aclose()


@awaited
async def test_iterator_of_two_tasks_counts_each_packet_once() -> None:
    async with listening() as peer, stream_to(peer) as stream:
        packets = stream.iterate(block)
        first, second = (asyncio.ensure_future(packets.next(None)) for _ in range(2))
        writer = await peer.accepted()
        await come(lambda: first.done() or second.done() or stream.connection is ConnectionState.CONNECTED)
        await asyncio.sleep(0)
        writer.write(counts(1, 2, 3))
        await come(lambda: packets.stats.offered >= 3)
        assert packets.stats.offered == 3
        second.cancel()
        first.cancel()
        await asyncio.gather(first, second, return_exceptions=True)
        await packets.aclose()


@awaited
async def test_join_returns_when_a_thread_closes_an_unread_stream() -> None:
    async with listening() as peer:
        connection = connection_to(peer)
        stream = stream_of(connection)

        def begin_and_close() -> None:
            connection.start_quietly()
            connection.abandon()

        thread = asyncio.get_running_loop().run_in_executor(None, begin_and_close)
        while connection.state is not ConnectionState.CLOSED:  # block the loop, so that it does not read
            time.sleep(0.001)
        await thread
        begun = clock.now()
        assert await asyncio.to_thread(connection.join, 2 * _AT_ONCE)
        assert clock.now() - begun < _AT_ONCE
        await _without_threads(stream)


@awaited
async def test_abort_from_a_thread_waits_until_the_loop_has_aborted() -> None:
    handover, loop_connection._HANDOVER = loop_connection._HANDOVER, 2 * _AT_ONCE
    try:
        async with listening() as peer, stream_of(connection := connection_to(peer)) as stream:
            packets = stream.iterate(block)
            await packets.open()
            begun = clock.now()
            await asyncio.to_thread(connection.abort)
            assert clock.now() - begun < _AT_ONCE
            await packets.aclose()
            await _without_threads(stream)
    finally:
        loop_connection._HANDOVER = handover


@awaited
async def test_thread_can_close_a_connecting_stream() -> None:
    is_connecting, may_connect = asyncio.Event(), asyncio.Event()

    class Slow(AwaitedTcp):
        async def connect(self, timeout: float) -> None:
            is_connecting.set()
            await may_connect.wait()
            await super().connect(timeout)

    async with listening() as peer:
        connection = connection_to(peer, tcp=Slow)
        stream = stream_of(connection)
        connecting = asyncio.ensure_future(connection.connected())
        await is_connecting.wait()
        begun = clock.now()
        await asyncio.to_thread(connection.abandon)
        assert clock.now() - begun < _AT_ONCE
        may_connect.set()
        with contextlib.suppress(LinkError):
            await connecting
        await stream.close()
        await _without_threads(stream)


async def _without_threads(stream: AsyncStream[Count]) -> None:
    """Close the stream, and end the threads that the test used."""
    await stream.close()
    await asyncio.get_running_loop().shutdown_default_executor()

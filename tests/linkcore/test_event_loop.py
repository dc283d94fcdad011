"""Threads of one robot for calls that wait, and what a task that awaits them is told."""

from __future__ import annotations

import asyncio
import threading

import pytest

from linkcore.errors import Closed
from linkcore.event_loop import Workers

pytestmark = pytest.mark.simulated_time


def test_a_call_that_waits_for_a_thread_ends_as_closed() -> None:
    """And not as if somebody had cancelled its task."""
    workers = Workers("robot", 1)
    is_over = threading.Event()

    async def main() -> None:
        first = asyncio.create_task(workers.make(lambda: is_over.wait(60.0)))
        second = asyncio.create_task(workers.make(lambda: True))
        await asyncio.sleep(0.1)
        workers.close()
        with pytest.raises(Closed, match="robot was closed"):
            await second
        is_over.set()
        assert await first
        with pytest.raises(Closed, match="robot was closed"):
            await workers.make(lambda: True)

    asyncio.run(main())

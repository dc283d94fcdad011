"""Standard input and output as the connection to one client.

The SDK reads standard input in a thread that cannot be interrupted, so a server that ends would wait for its client.
These streams use daemon threads instead. While they are open, everything else that the process prints goes to standard
error, because one foreign line would break the protocol.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import queue
import threading
from concurrent.futures import Future
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from typing_extensions import Self

__all__ = ["StandardStreams"]

#: Number of received lines that are buffered. When the buffer is full, the client has to wait.
_BUFFERED = 64


class StandardStreams:
    """Standard input and output, for the event loop that is running; an async context manager.

    The object stands for both files that the SDK's `stdio_server` accepts: it is iterated over for lines, and has
    `write` and `flush`. Only one can be open in a process.
    """

    def __init__(self) -> None:
        self._lines: asyncio.Queue[str | None] = asyncio.Queue(_BUFFERED)
        self._texts: queue.SimpleQueue[tuple[bytes, Future[None]] | None] = queue.SimpleQueue()
        self._files = (-1, -1)

    async def __aenter__(self) -> Self:
        loop = asyncio.get_running_loop()
        self._files = os.dup(0), os.dup(1)
        nothing = os.open(os.devnull, os.O_RDONLY)
        os.dup2(nothing, 0)
        os.close(nothing)
        os.dup2(2, 1)
        for target in (lambda: self._read(loop), self._write):
            threading.Thread(target=target, name="mcp standard streams", daemon=True).start()
        return self

    async def __aexit__(self, *exc: object) -> None:
        # The copies stay open, because a thread might still be blocked on them.
        self._texts.put(None)
        for copy, original in zip(self._files, (0, 1), strict=True):
            os.dup2(copy, original)

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> str:
        line = await self._lines.get()
        if line is None:
            raise StopAsyncIteration
        return line

    async def write(self, text: str) -> None:
        """Write a text, and wait until the client's pipe has accepted it.

        Raises:
            OSError: If the client has closed the pipe.
        """
        written: Future[None] = Future()
        self._texts.put((text.encode(), written))
        await asyncio.wrap_future(written)

    async def flush(self) -> None:
        """Do nothing, because `write` does not buffer."""

    def _read(self, loop: asyncio.AbstractEventLoop) -> None:
        with (
            contextlib.suppress(RuntimeError, OSError),  # the loop has ended
            os.fdopen(self._files[0], "rb", closefd=False) as file,
        ):
            for line in file:
                asyncio.run_coroutine_threadsafe(self._lines.put(line.decode("utf-8", "replace")), loop).result()
        with contextlib.suppress(RuntimeError):
            asyncio.run_coroutine_threadsafe(self._lines.put(None), loop)

    def _write(self) -> None:
        while (item := self._texts.get()) is not None:
            data, written = item
            try:
                while data:
                    data = data[os.write(self._files[1], data) :]
            except OSError as error:
                written.set_exception(error)
            else:
                with contextlib.suppress(Exception):  # the writer was cancelled
                    written.set_result(None)

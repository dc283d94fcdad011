"""A connection that a thread reads: opened, read, and opened again when it is lost.

transport -> receiver -> fan-out -> queues -> callbacks
[------ reader thread --------]   [own threads]
"""

from __future__ import annotations

import threading
from functools import partial

from .. import clock
from ..errors import LinkTimeout, LocalError
from ..threads import started
from .connection import Connection
from .receiver import Receiver
from .scheduling import urgent


class ThreadConnection(Connection):
    """A connection with a reader thread of its own; the arguments are those of `Connection`."""

    _reader: threading.Thread | None = None

    @property
    def is_running(self) -> bool:
        """A reader has been started, and has not ended."""
        reader = self._reader
        return reader is not None and reader.is_alive()

    def reads_here(self) -> bool:
        """The current thread is the one that reads."""
        return threading.current_thread() is self._reader

    def refuse_to_wait(self, what: str) -> None:
        """Raise where the current thread would wait for itself.

        Raises:
            LocalError: it is the one that reads.
        """
        if self.reads_here():
            raise LocalError(
                f"{what} would wait for ever: it was called in an inline callback, so by the thread that reads "
                f"{self.name}, which reads nothing meanwhile; subscribe without inline=True, or wait in another thread"
            )

    def look(self) -> None:
        """Nothing to do: the thread only reads, and waits for nothing else."""

    def _launch(self) -> None:
        # Known before it starts, so that it finds itself there.
        self._reader = threading.Thread(target=self._read, name=f"{self.name} reader", daemon=True)
        try:
            started(self._reader)
        except LocalError:
            self._reader = None
            raise

    def _join_reader(self, timeout: float) -> bool:
        reader = self._reader
        if reader is None or self.reads_here():
            return True
        return clock.join(reader, timeout)

    # -- the reader thread -----------------------------------------------------------------------

    @urgent()
    def _read(self) -> None:
        while True:
            try:
                self._connect_and_receive()
            except Exception as error:
                wait = self._next_try(error)
            else:
                wait = self._next_try(None)
            if wait is None:
                return
            with self._changed:
                if clock.wait(partial(self._changed.wait_for, lambda: self._life.is_closed), wait):
                    break
        self._finish(None)

    def _connect_and_receive(self) -> None:
        """One connection, until the transport or the protocol raises, or it is closed."""
        self._connecting()
        self._transport.open(self._timeout)
        if not self._life.is_closed:  # closed while connecting: that could not see this socket
            self._receive(self._opened())

    def _receive(self, receiver: Receiver) -> None:
        """Hand out what comes, until the transport raises or the peer has been silent for too long."""
        receive, take, silence = self._transport.receive, self._take, self.silence
        silence.end(clock.now())
        while True:
            try:
                data, stamp = receive(silence.wait)
            except LinkTimeout:
                silence.timed_out()
            else:
                take(receiver, data, stamp)

"""The short way to a callback that is known to be quick: the reader calls it itself.

Handing a packet to another thread costs more than reading it: on a machine that is otherwise idle
most of the latency, and most of the processor time, is the waking of that thread. So a subscription
that has proved quick is served by the reader. It is taken at its word only as long as it keeps it: a few
calls within a second that last longer send it back to its own thread (fewer may be the machine's
fault), and should a call not return, a second thread, which looks every `PATIENCE` seconds, takes
over the reading. The others then have waited up to twice that long; nothing is lost, since what is
not read waits in the socket. Each time it is sent back, it has to be quick for longer to return.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from typing import Any

from .subscription import QUICK, Subscription

__all__ = ["PATIENCE", "Relieved", "Shortcut"]

#: Seconds after which a call that has not returned loses the reader. Looking more often costs more:
#: every 20 ms, a third of the processor time that reading at 500 Hz takes.
PATIENCE = 0.05
#: Slow calls within a second that are put down to the machine.
_FORGIVEN = 3


class Relieved(Exception):
    """Another thread reads on; the one that this is raised in has nothing left to do."""


class Shortcut:
    """Stands in for the inbox of one subscription, and calls back at once.

    Args:
        subscription: whose callback it is.
        withdraw: told when the subscription was too slow; it puts the inbox back.
        read_on: becomes the reader, in the thread that calls it.
    """

    def __init__(
        self,
        subscription: Subscription,
        withdraw: Callable[[Shortcut], object],
        read_on: Callable[[], object],
    ) -> None:
        self.subscription = subscription
        self.inbox = subscription.inbox
        self._withdraw = withdraw
        self._read_on = read_on
        self._role = threading.Lock()
        self._since: float | None = None
        self._slow = 0
        self._slow_since = float("-inf")
        self._relieved = False
        self._ended = threading.Lock()
        self._ended.acquire()
        threading.Thread(target=self._watch, name=f"{subscription.name} watch", daemon=True).start()

    def offer(self, packets: Sequence[Any]) -> None:
        """Call back with each packet, in the reader thread.

        Raises:
            Relieved: it took so long that another thread has become the reader.
        """
        since = self._since = time.monotonic()
        done = self.subscription.deliver(packets)
        with self._role:
            self._since = None
            relieved = self._relieved
        if relieved:
            raise Relieved
        if not done:
            self.inbox.offer(packets)
        elif time.monotonic() - since > QUICK * len(packets):
            if since - self._slow_since > 1.0:
                self._slow_since, self._slow = since, 0
            self._slow += 1
            if self._slow > _FORGIVEN:
                self._withdraw(self)

    def end(self) -> None:
        """Watch no longer."""
        if self._ended.locked():
            self._ended.release()

    def _watch(self) -> None:
        while not self._ended.acquire(timeout=PATIENCE):
            with self._role:
                if self._since is None or time.monotonic() - self._since < PATIENCE:
                    continue
                self._relieved = True
            self._withdraw(self)
            self._read_on()
            return

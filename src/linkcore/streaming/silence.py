"""Measurement of the silence of a peer, based on the result of each wait for bytes. It uses no sockets (sans-IO).

Only the reader thread can measure silence. The time since the last packet does not prove a silence, because packets
might be waiting in the socket while this process is suspended, or blocked by a C call that holds the interpreter lock.
But if the kernel waits for bytes and this wait times out, nothing has arrived. So the silence is the sum of the waits
that have timed out since the last packet. An interruption of this process never increases this sum.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable

from ..errors import BadValue, LinkTimeout

_log = logging.getLogger(__name__)

#: Tolerance in s for a sum of waits that is below a limit only because floating-point numbers are rounded.
_ROUNDING = 1e-6


class _Watch:
    """Callback, with the seconds of silence after which it is called."""

    def __init__(self, seconds: float, hook: Callable[[float], object]) -> None:
        self.seconds = seconds
        self.hook = hook
        self.is_told = False


class SilenceMonitor:
    """Sum of the silence of a peer.

    Only one thread reports the results of waits. Any thread may add and remove watches.

    Args:
        name: Name of the stream, used in messages.
        limit: Seconds of silence after which the connection is considered lost; None for no limit.

    Attributes:
        limit: Limit of the silence, or None.
        wait: Maximum duration in s of the next wait for bytes; None for no limit.
        last: Time of `linkcore.clock.now` at which the last packet arrived. The reader sets it for each packet.
        is_quiet: Whether a wait has timed out, or bytes without a complete packet have arrived, since the last packet.
            If so, the reader calls `end` for the next packet.
    """

    def __init__(self, name: str, limit: float | None) -> None:
        self._name = name
        self.limit = limit
        self._watches: tuple[_Watch, ...] = ()  # replaced, never changed
        # Held while watches are replaced, and while `wait` is computed from them; not for each packet. Otherwise a
        # watch of another thread, or its deadline, could be lost. Re-entrant for signal handlers.
        self._changing = threading.RLock()
        self._quiet = 0.0
        self._unconfirmed = 0.0
        self.last = 0.0
        self.is_quiet = False
        self.wait = limit

    def watch(self, seconds: float, hook: Callable[[float], object]) -> Callable[[], None]:
        """Call `hook` with the seconds of silence when they reach `seconds`, once for each silence.

        Returns:
            Function that removes the hook.

        Raises:
            BadValue: If `seconds` is not a positive number, or exceeds the limit.
        """
        if not (seconds > 0 and (self.limit is None or seconds <= self.limit)):
            raise BadValue(f"seconds={seconds!r}; expected a positive number, at most silence={self.limit}")
        watch = _Watch(seconds, hook)
        with self._changing:
            self._watches = (*self._watches, watch)
        self._plan()

        def remove() -> None:
            with self._changing:
                self._watches = tuple(each for each in self._watches if each is not watch)

        return remove

    def end(self, now: float) -> None:
        """Record that a packet arrived at `now`, or that a connection was made."""
        for watch in self._watches:
            watch.is_told = False
        self.last = now
        self._quiet = self._unconfirmed = 0.0
        self.is_quiet = False
        self._plan()

    def timed_out(self) -> None:
        """Record that the kernel has waited for `wait` seconds, and that nothing has arrived.

        Raises:
            LinkTimeout: If the silence has reached the limit, so that the connection is considered lost.
        """
        if self.wait is not None:
            self.is_quiet = True
            self._quiet += self.wait
            self._tell(self._quiet, "nothing was received")
            self._plan()

    def no_packet(self, now: float) -> None:
        """Record that bytes arrived at `now` which do not complete a packet.

        This is silence as well. But the reader might have been delayed while the rest of the packet arrived. So only
        the silence up to the previous arrival of bytes is certain.

        Raises:
            LinkTimeout: If the silence has reached the limit, so that the connection is considered lost.
        """
        self.is_quiet = True
        self._tell(self._unconfirmed, "bytes, but no complete packet, were received")
        self._unconfirmed = now - self.last

    def _tell(self, quiet: float, what: str) -> None:
        for watch in self._watches:
            if quiet + _ROUNDING >= watch.seconds and not watch.is_told:
                watch.is_told = True
                try:
                    watch.hook(quiet)
                except Exception:
                    _log.exception("%s: the callback for silence raised", self._name)
        if self.limit is not None and quiet + _ROUNDING >= self.limit:
            raise LinkTimeout(f"{self._name}: {what} for {self.limit:g} s")

    def _plan(self) -> None:
        """Compute `wait`."""
        with self._changing:
            limits = [watch.seconds for watch in self._watches]
            if self.limit is not None:
                limits.append(self.limit)
            left = [limit - self._quiet for limit in limits]
            self.wait = min((seconds for seconds in left if seconds > _ROUNDING), default=None)

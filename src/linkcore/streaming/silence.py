"""How long a peer has been silent, sans-IO: computed from the result of each wait for bytes.

Only the reader thread can measure it. Time that has passed since the last packet proves nothing: this process may have
been suspended, or kept by a C call that holds the interpreter's lock, while packets wait in the socket. But when the
kernel's own wait for bytes runs out, nothing has come. So silence is the sum of the waits that ran out since the last
packet, and a stall of this process never adds to it.
"""

from __future__ import annotations

import logging
from collections.abc import Callable

from ..errors import BadValue, LinkTimeout

_log = logging.getLogger(__name__)

#: Seconds by which a sum of waits may fall short of a limit, for the rounding of floating-point numbers.
_ROUNDING = 1e-6


class _Watch:
    """A callback, and the seconds of silence after which it is called."""

    def __init__(self, seconds: float, hook: Callable[[float], object]) -> None:
        self.seconds = seconds
        self.hook = hook
        self.is_told = False


class SilenceMonitor:
    """Adds up the silence of a peer. One thread reports to it; watches come and go from any.

    Args:
        name: of the stream, for messages.
        limit: seconds of silence after which the connection counts as lost; None for never.

    Attributes:
        limit: the same.
        wait: seconds that the next wait for bytes may last; None for as long as it takes.
        last: when the last packet came, by `linkcore.clock.now`; set by the reader for each.
        is_quiet: a wait ran out, or bytes came that completed no packet, since then. The reader then calls `end`.
    """

    def __init__(self, name: str, limit: float | None) -> None:
        self._name = name
        self.limit = limit
        self._watches: tuple[_Watch, ...] = ()  # replaced, never changed
        self._quiet = 0.0
        self._unconfirmed = 0.0
        self.last = 0.0
        self.is_quiet = False
        self.wait = limit

    def watch(self, seconds: float, hook: Callable[[float], object]) -> Callable[[], None]:
        """Call `hook` with the seconds of silence when there are so many, once for each silence.

        Returns:
            what takes the hook away again.

        Raises:
            BadValue: no such number of seconds, or more than the limit.
        """
        if not (seconds > 0 and (self.limit is None or seconds <= self.limit)):
            raise BadValue(f"seconds={seconds!r}; expected a positive number, at most silence={self.limit}")
        watch = _Watch(seconds, hook)
        self._watches = (*self._watches, watch)
        self.wait = self._next_wait()

        def remove() -> None:
            self._watches = tuple(each for each in self._watches if each is not watch)

        return remove

    def end(self, now: float) -> None:
        """A packet came at `now`, or a connection was made."""
        for watch in self._watches:
            watch.is_told = False
        self.last = now
        self._quiet = self._unconfirmed = 0.0
        self.is_quiet = False
        self.wait = self._next_wait()

    def timed_out(self) -> None:
        """The kernel has waited for `wait` seconds, and nothing came.

        Raises:
            LinkTimeout: the connection counts as lost.
        """
        if self.wait is not None:
            self.is_quiet = True
            self._quiet += self.wait
            self._tell(self._quiet, "nothing came")
            self.wait = self._next_wait()

    def no_packet(self, now: float) -> None:
        """Bytes came at `now`, but they complete no packet.

        That is silence as well. But the reader may have been held up while the rest of the packet came. So only what
        was true when bytes came last, and is still true now, is certain.

        Raises:
            LinkTimeout: the connection counts as lost.
        """
        self.is_quiet = True
        self._tell(self._unconfirmed, "bytes came, but no packet,")
        self._unconfirmed = now - self.last

    def _tell(self, quiet: float, what: str) -> None:
        for watch in self._watches:
            if quiet + _ROUNDING >= watch.seconds and not watch.is_told:
                watch.is_told = True
                try:
                    watch.hook(quiet)
                except Exception:
                    _log.exception("%s: what was told of a silence raised", self._name)
        if self.limit is not None and quiet + _ROUNDING >= self.limit:
            raise LinkTimeout(f"{self._name}: {what} for {self.limit:g} s")

    def _next_wait(self) -> float | None:
        limits = [watch.seconds for watch in self._watches]
        if self.limit is not None:
            limits.append(self.limit)
        left = [limit - self._quiet for limit in limits]
        return min((seconds for seconds in left if seconds > _ROUNDING), default=None)

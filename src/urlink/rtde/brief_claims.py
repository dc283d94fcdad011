"""Inputs that are claimed for a setting, and given back when none has followed for a while.

An input belongs to one client at a time, and most other clients fail where one is taken. So nothing is held for longer
than a burst of settings: whoever asks later gets it.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from typing import Any

from linkcore.clock import monotonic
from linkcore.errors import Closed
from linkcore.streaming.connection import Connection

from ..interfaces.rtde.protocol import Requests
from ..interfaces.rtde.recipes import Outputs
from .shared_registers import Claims

#: Seconds that connecting and claiming may take. In a local network it is a few cycles of the controller.
CLAIM_TIMEOUT = 0.25
#: Seconds after the last setting at which everything is given back.
HOLD = 2.0
#: Packages a second meanwhile. The first of them ends connecting, and each is an occasion to give back.
_HEARTBEAT = 50.0


class BriefClaims:
    """Claims of one robot, on one connection that is there as long as they are.

    Args:
        connect: makes the connection and the claims of a plan; the connection is not kept up when it is lost.
        clock: seconds that only grow.
    """

    def __init__(
        self, connect: Callable[[Requests], tuple[Connection, Claims]], clock: Callable[[], float] = monotonic
    ) -> None:
        self._connect = connect
        self._clock = clock
        self._lock = threading.Lock()  # one claim at a time
        #: replaced as a whole, so that whoever gives back needs no lock
        self._standing: tuple[Connection, Claims] | None = None
        self._used = 0.0
        self._is_closed = False

    def claim(self, names: tuple[str, ...], *, wait: bool) -> Callable[[Mapping[str, Any]], None] | None:
        """What writes these inputs, masks included, without waiting; None where that would have to be waited for.

        Args:
            names: of the inputs.
            wait: until they are claimed, `CLAIM_TIMEOUT` at most; otherwise they have to be.

        Raises:
            InputInUse, NoSuchVariable: they cannot be had.
            LinkError: RTDE cannot be had.
        """
        self._used = self._clock()
        # In a signal handler, who has the lock waits for this very call to end.
        if not self._lock.acquire(timeout=CLAIM_TIMEOUT if wait else 0.0):
            return None
        try:
            standing = self._standing
            if standing is not None and (standing[0].is_over or standing[0].failure is not None):
                standing = self._standing = None
            if wait:
                claims = self._open(names) if standing is None else standing[1]
                claims.claim(names)
            elif standing is None or not standing[1].has(names):
                return None
            else:
                claims = standing[1]
        finally:
            self._lock.release()
        return claims.put

    def _open(self, names: tuple[str, ...]) -> Claims:
        """Claims on a new connection, which begins with these."""
        connection, claims = self._connect(Requests(("timestamp",), _HEARTBEAT, inputs=[names]))

        def look(state: Outputs) -> None:
            if self._clock() - self._used > HOLD:
                self.give_back()

        self._standing = connection, claims  # before it connects: whoever closes the robot meanwhile ends that too
        try:
            if self._is_closed:
                raise Closed(f"{connection.name} was closed")
            connection.subscribe_inline(Outputs, look)
        except BaseException:
            self.abort()  # in a process that was held up, it may come up yet
            raise
        return claims

    def give_back(self, timeout: float = 1.0) -> None:
        """Disconnect, in good order: what was written arrives. From any thread; idempotent."""
        standing, self._standing = self._standing, None
        if standing is not None:
            standing[0].close(timeout)

    def abort(self) -> None:
        """Disconnect, and discard what has not arrived."""
        standing, self._standing = self._standing, None
        if standing is not None:
            standing[0].abandon()

    def close(self, timeout: float) -> None:
        """Give everything back, for good. Idempotent."""
        self._is_closed = True
        self.give_back(timeout)

"""What the three interfaces of ur_rtde have in common: a connection, and the pace of a loop."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from datetime import timedelta
from typing import TYPE_CHECKING

import urlink
from linkcore.errors import Cancelled, LocalError, RemoteError
from linkcore.text import printable

if TYPE_CHECKING:
    from typing_extensions import Self

__all__ = ["NotOffered", "RtdeInterface", "succeeds"]

_log = logging.getLogger(__name__)

#: Seconds to wait for a connection that was lost, in `reconnect`.
_RECONNECT_TIMEOUT = 10.0


class NotOffered(LocalError, NotImplementedError):
    """A call of the other client that is not offered here; the message names what replaces it."""

    __module__ = "urlink"  # where users import it from, and what a traceback shows


def succeeds(act: Callable[[], object]) -> bool:
    """Whether the call succeeded. Its error goes to the log, since the other client only returns False."""
    try:
        act()
    except (RemoteError, Cancelled) as error:
        _log.warning("%s", printable(error))
        return False
    return True


class RtdeInterface:
    """A robot on a connection of its own. A context manager that disconnects.

    Args:
        hostname: address of the robot, or any other that `urlink.connect` takes.
        frequency: of the loop that `initPeriod` and `waitPeriod` pace, in Hz; -1 for the controller's rate.

    Raises:
        ConnectFailed, LinkTimeout, WrongPeer: there is no controller at the address.
    """

    def __init__(self, hostname: str, frequency: float = -1.0) -> None:
        self._robot = urlink.connect(hostname)
        rate = float(self._robot.firmware.rate)
        self._frequency = rate if frequency <= 0.0 else frequency

    def isConnected(self) -> bool:
        """Whether data of the robot arrives."""
        return self._robot.primary.connection is urlink.ConnectionState.CONNECTED

    def reconnect(self) -> bool:
        """Wait until data arrives again, 10 s at most. A lost connection is made again without this call."""
        return succeeds(lambda: self._robot.primary.wait(_RECONNECT_TIMEOUT))

    def disconnect(self) -> None:
        """End what moves, and disconnect; the object cannot be used again."""
        self._robot.close()

    def initPeriod(self) -> timedelta:
        """The present time, at which a round of a loop begins; for `waitPeriod`."""
        return timedelta(seconds=time.monotonic())

    def waitPeriod(self, t_cycle_start: timedelta) -> None:
        """Sleep until one period after the time that `initPeriod` has returned."""
        left = t_cycle_start.total_seconds() + 1.0 / self._frequency - time.monotonic()
        if left > 0.0:
            time.sleep(left)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.disconnect()

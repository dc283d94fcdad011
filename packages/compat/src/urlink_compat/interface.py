"""What the interfaces of ur_rtde have in common: a connection, the pace of a loop, and modes that last.

Servo, speeds, force mode and freedrive are begun and changed by single calls of the other client. In this library each
of them is a block of `robot.motion`, which ends whatever happens. Here the first call opens the block, and later calls
use it. It is opened again if its settings have changed, or if it has ended because no set-point came within its
watchdog time.
"""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Callable, Sequence
from datetime import timedelta
from typing import TYPE_CHECKING, Any, TypeVar

import urlink
from linkcore import clock
from urlink import Cancelled, InputInUse, NotOffered, RemoteError
from urlink.tools import BlockMotion, printable

if TYPE_CHECKING:
    from typing_extensions import Self

    from urlink.tools import LinkName

__all__ = ["Blocks", "NotOffered", "RtdeInterface", "is_given", "succeeds"]

_log = logging.getLogger(__name__)

#: Seconds to wait for a connection that was lost, in `reconnect`.
_RECONNECT_TIMEOUT = 10.0


def succeeds(act: Callable[[], object]) -> bool:
    """Whether the call succeeded. Its error goes to the log, since the other client only returns False."""
    try:
        act()
    except (RemoteError, Cancelled) as error:
        _log.warning("%s", printable(error))
        return False
    return True


def is_given(values: Sequence[object] | None) -> bool:
    """Whether an argument that may be left out is there. It may be an array, which has no truth of its own."""
    return values is not None and len(values) > 0


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
        return timedelta(seconds=clock.now())

    def waitPeriod(self, t_cycle_start: timedelta) -> None:
        """Sleep until one period after the time that `initPeriod` has returned."""
        left = t_cycle_start.total_seconds() + 1.0 / self._frequency - clock.now()
        if left > 0.0:
            clock.sleep(left)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.disconnect()


B = TypeVar("B", bound=BlockMotion)


class Blocks:
    """The open block; there is at most one."""

    def __init__(self, robot: urlink.Robot) -> None:
        self._robot = robot
        self._open: BlockMotion | None = None
        self._settings: tuple[Any, ...] = ()

    @property
    def is_open(self) -> bool:
        """Something lasts."""
        return self._open is not None and not self._open.done

    def opened(self, kind: type[B], settings: tuple[Any, ...], make: Callable[[LinkName], B]) -> B:
        """The open block of this class with these settings; if there is none, it is opened.

        Args:
            kind: its class.
            settings: what `make` depends on; another value opens the block again.
            make: makes the block, over a link.

        Raises:
            LinkError: the block cannot be opened now.
        """
        present = self._open
        if isinstance(present, kind) and self.is_open and settings == self._settings:
            return present
        self.close()
        made = self._entered(make)
        self._open, self._settings = made, settings
        return made

    def _entered(self, make: Callable[[LinkName], B]) -> B:
        """Open a block over registers if they are free, else over a reverse connection."""
        firmware = self._robot.firmware
        if firmware >= ((5, 3) if firmware.is_e_series else (3, 9)):
            with contextlib.suppress(InputInUse):
                return make("rtde").__enter__()
        return make("reverse").__enter__()

    def close(self) -> None:
        """End the block, and wait until the arm stands still, two seconds at most."""
        block, self._open = self._open, None
        if block is not None:
            block.__exit__(None, None, None)

"""Common parts of the interfaces of ur_rtde: a connection, the timing of a loop, and modes that last.

In the other client, single calls begin and change a servo, speeds, force mode and freedrive. In this library, each of
them is a block of `robot.motion`, which always ends. Here, the first call opens the block, and later calls use it. It
is opened again if its settings have changed, or if it has ended because no set-point arrived within its watchdog time.
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

#: Maximum time in s to wait for a lost connection in `reconnect`.
_RECONNECT_TIMEOUT = 10.0


def succeeds(act: Callable[[], object]) -> bool:
    """Call `act`; return whether it succeeded. The error is logged, because the other client only returns False."""
    try:
        act()
    except (RemoteError, Cancelled) as error:
        _log.warning("%s", printable(error))
        return False
    return True


def is_given(values: Sequence[object] | None) -> bool:
    """Return whether an optional argument is given. It may be an array, which has no truth value."""
    return values is not None and len(values) > 0


class RtdeInterface:
    """Robot with its own connection. It is a context manager that disconnects.

    Args:
        hostname: Address of the robot, or any other address that `urlink.connect` accepts.
        frequency: Frequency of the loop for `initPeriod` and `waitPeriod`, in Hz; -1 for the controller's rate.
        limits: Limits of the session; see `urlink.SessionLimits`. The other client does not have this argument.

    Raises:
        ConnectFailed: If the controller cannot be reached.
        LinkTimeout: If the controller does not answer in time.
        WrongPeer: If another service answers at the address.
    """

    def __init__(self, hostname: str, frequency: float = -1.0, *, limits: urlink.SessionLimits | None = None) -> None:
        self._robot = urlink.connect(hostname, limits=limits)
        rate = float(self._robot.firmware.rate)
        self._frequency = rate if frequency <= 0.0 else frequency

    def isConnected(self) -> bool:
        """Return whether data from the robot arrives."""
        return self._robot.primary.connection is urlink.ConnectionState.CONNECTED

    def reconnect(self) -> bool:
        """Wait up to 10 s until data arrives again. A lost connection is restored automatically without this call."""
        return succeeds(lambda: self._robot.primary.wait(_RECONNECT_TIMEOUT))

    def disconnect(self) -> None:
        """End the motion, and disconnect. The object cannot be used again."""
        self._robot.close()

    def initPeriod(self) -> timedelta:
        """Return the current time at the beginning of a cycle, for `waitPeriod`."""
        return timedelta(seconds=clock.now())

    def waitPeriod(self, t_cycle_start: timedelta) -> None:
        """Sleep until one period after the time that `initPeriod` returned."""
        left = t_cycle_start.total_seconds() + 1.0 / self._frequency - clock.now()
        if left > 0.0:
            clock.sleep(left)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.disconnect()


B = TypeVar("B", bound=BlockMotion)


class Blocks:
    """Holder of the open block, at most one."""

    def __init__(self, robot: urlink.Robot) -> None:
        self._robot = robot
        self._open: BlockMotion | None = None
        self._settings: tuple[Any, ...] = ()

    @property
    def is_open(self) -> bool:
        """Whether a block is open."""
        return self._open is not None and not self._open.done

    def opened(self, kind: type[B], settings: tuple[Any, ...], make: Callable[[LinkName], B]) -> B:
        """Return the open block of this class with these settings, or open it.

        Args:
            kind: Class of the block.
            settings: Settings that `make` depends on. If they differ, the block is opened again.
            make: Function that makes the block over a link.

        Raises:
            LinkError: If the block cannot be opened now.
        """
        present = self._open
        if isinstance(present, kind) and self.is_open and settings == self._settings:
            return present
        self.close()
        made = self._entered(make)
        self._open, self._settings = made, settings
        return made

    def _entered(self, make: Callable[[LinkName], B]) -> B:
        """Open a block over registers if they are free, otherwise over a reverse connection."""
        firmware = self._robot.firmware
        if firmware >= ((5, 3) if firmware.is_e_series else (3, 9)):
            with contextlib.suppress(InputInUse):
                return make("rtde").__enter__()
        return make("reverse").__enter__()

    def close(self) -> None:
        """End the block, and wait up to two seconds until the arm is at rest."""
        block, self._open = self._open, None
        if block is not None:
            block.__exit__(None, None, None)

"""Modes that last: servo, speeds, force mode and freedrive, which the other client begins and changes by single calls.

In this library each of them is a block of `robot.motion`, which ends whatever happens. Here the first call opens the
block, and later calls use it. It is opened again if its settings have changed, or if it has ended because no set-point
came within its watchdog time.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeVar

import urlink
from urlink.interfaces.rtde.protocol import InputInUse
from urlink.motion.linked_block import LinkedBlock

if TYPE_CHECKING:
    from urlink.motion.motions import LinkName

__all__ = ["Blocks"]

B = TypeVar("B", bound=LinkedBlock)


class Blocks:
    """The open block; there is at most one."""

    def __init__(self, robot: urlink.Robot) -> None:
        self._robot = robot
        self._open: LinkedBlock | None = None
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

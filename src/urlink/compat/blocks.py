"""What lasts: servo, speeds, force mode and freedrive, which the other client begins and changes by single calls.

In this library each of them is a block of `robot.motion`, which ends whatever happens. Here the first call opens it,
and the next ones find it open. It is opened anew where what it was opened with has changed, or where it has ended
because nothing came for longer than its watchdog allows.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeVar

import urlink
from urlink.motion.linked_block import LinkedBlock
from urlink.rtde import InputInUse

if TYPE_CHECKING:
    from urlink.motion.motions import LinkName

__all__ = ["Blocks"]

B = TypeVar("B", bound=LinkedBlock)


class Blocks:
    """The block that is open; there is one at most."""

    def __init__(self, robot: urlink.Robot) -> None:
        self._robot = robot
        self._open: LinkedBlock | None = None
        self._settings: tuple[Any, ...] = ()

    @property
    def is_open(self) -> bool:
        """Something lasts."""
        return self._open is not None and not self._open.done

    def opened(self, kind: type[B], settings: tuple[Any, ...], make: Callable[[LinkName], B]) -> B:
        """The block of this kind, with these settings.

        Args:
            kind: its class.
            settings: what `make` is made with, to be compared.
            make: makes it, over a link.

        Raises:
            LinkError: it cannot be had now.
        """
        present = self._open
        if isinstance(present, kind) and self.is_open and settings == self._settings:
            return present
        self.close()
        made = self._entered(make)
        self._open, self._settings = made, settings
        return made

    def _entered(self, make: Callable[[LinkName], B]) -> B:
        """Over registers where there are any that can be had, and over a reverse connection otherwise."""
        firmware = self._robot.firmware
        if firmware >= ((5, 3) if firmware.is_e_series else (3, 9)):
            with contextlib.suppress(InputInUse):
                return make("rtde").__enter__()
        return make("reverse").__enter__()

    def close(self) -> None:
        """End what lasts, and wait until the arm stands or two seconds are over."""
        block, self._open = self._open, None
        if block is not None:
            block.__exit__(None, None, None)

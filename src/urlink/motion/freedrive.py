"""Freedrive as a block: a person moves the arm by hand."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from linkcore.arguments import check_number
from linkcore.errors import BadValue, LocalError

from ..firmware import Firmware
from ..urscript import yielding
from .context import MotionContext
from .kept_word import KeptWord
from .linked import Link
from .linked_block import LinkedBlock

__all__ = ["Freedrive"]

_NOTHING = (0.0,) * 6
#: The first releases that have freedrive in a program, and freedrive along selected axes.
_FREEDRIVE, _AXES = Firmware(3, 0), Firmware(5, 10)


class Freedrive(LinkedBlock):
    """Freedrive while a ``with`` block is open; made by `robot.freedrive`.

    Args:
        context: the robot.
        axes: (6,) of the frame that are free; None for all.
        frame: (6,) pose in the base frame.
        watchdog: s without a word from this computer after which the robot ends freedrive.
        open_link: opens the link to the program.

    Raises:
        BadValue: a number out of range, or no axis is free.
        LocalError: this firmware has no freedrive, or none along selected axes.
    """

    def __init__(
        self,
        context: MotionContext,
        axes: tuple[bool, ...] | None,
        frame: tuple[float, ...],
        watchdog: float,
        open_link: Callable[[], Link],
    ) -> None:
        firmware = context.who.identity.firmware
        if firmware < _FREEDRIVE:
            raise LocalError(f"freedrive is used from firmware {_FREEDRIVE} on, not on {firmware}")
        if axes is not None and not any(axes):
            raise BadValue("no axis is free; expected one at least")
        if axes is not None and firmware < _AXES:
            raise LocalError(f"firmware {firmware} frees all axes or none; {_AXES} is the first that takes axes")
        seconds = check_number(watchdog, "watchdog", 0.05, 10.0)
        body = partial(yielding.freedrive, firmware, axes=axes, frame=frame, watchdog=seconds)
        super().__init__(context, "freedrive", KeptWord(body, _NOTHING), open_link)

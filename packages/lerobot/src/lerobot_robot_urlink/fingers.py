"""Gripper of an arm, commanded in a dedicated thread, because its replies take longer than a set-point may take."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

from linkcore import clock
from urlink import BadValue, LinkError, Robot

from .joints import GRIPPER

__all__ = ["Fingers", "closing"]

#: Interval, in s, at which the fingers are read; maximum time, in s, for the thread to end.
_POLL, _END = 0.05, 20.0


def closing(action: dict[str, Any]) -> int:
    """Return the requested position of a Robotiq gripper, 0 (open) to 255 (closed).

    Values outside 0 to 1 are limited to this range.

    Raises:
        BadValue: If the action has no position of the gripper, or if it is not a number.
    """
    try:
        return round(255.0 * min(max(float(action[GRIPPER]), 0.0), 1.0))
    except (KeyError, TypeError, ValueError) as error:
        raise BadValue(f"invalid action, {error!r}; expected the number {GRIPPER}") from None


class Fingers:
    """Move the fingers to the wanted position, and read their position.

    Args:
        robot: Robot with the gripper. The gripper is activated here: its fingers close and open unless it is active.

    Attributes:
        wanted: Function that returns the wanted position, 0 to 255, or None; the thread calls it.
    """

    def __init__(self, robot: Robot) -> None:
        self._gripper = robot.gripper
        self._gripper.activate()
        self._position = self._gripper.position()
        self.wanted: Callable[[], int | None] = lambda: None
        self._error: LinkError | None = None
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._work, name="urlink-lerobot-gripper", daemon=True)
        self._thread.start()

    def _work(self) -> None:
        told = None
        while not clock.wait(self._over.wait, _POLL):
            try:
                wanted = self.wanted()
                if wanted is not None and wanted != told:
                    self._gripper.move(wanted, wait=False)
                    told = wanted
                self._position = self._gripper.position()
            except LinkError as error:
                self._error, told, self.wanted = error, None, lambda: None

    def position(self) -> float:
        """Return the last position of the fingers, 0 (open) to 1 (closed)."""
        return self._position / 255.0

    def check(self) -> None:
        """Raise the error since the last check: a `GripperFault`, or an error of the connection."""
        error, self._error = self._error, None
        if error is not None:
            raise error

    def close(self) -> None:
        """End the thread; the fingers continue to their last target."""
        self._over.set()
        self._thread.join(_END)

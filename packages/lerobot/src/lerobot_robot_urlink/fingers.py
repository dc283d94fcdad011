"""The gripper beside the arm: asked for in a thread of its own, since its answers take longer than a set-point may."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

from linkcore import clock
from urlink import BadValue, LinkError, Robot

from .joints import GRIPPER

__all__ = ["Fingers", "closing"]

#: Seconds between two looks at the fingers, and for the thread to end.
_POLL, _END = 0.05, 20.0


def closing(action: dict[str, Any]) -> int:
    """The position of a Robotiq gripper, 0 (open) to 255 (closed), that an action asks for.

    Raises:
        BadValue: it asks for none, or for no number; one beyond 0 to 1 is the end of that.
    """
    try:
        return round(255.0 * min(max(float(action[GRIPPER]), 0.0), 1.0))
    except (KeyError, TypeError, ValueError) as error:
        raise BadValue(f"an action needs {GRIPPER}: {error!r}") from None


class Fingers:
    """Moves the fingers where they are wanted, and looks where they are.

    Args:
        robot: whose gripper it is; activated here, by which its fingers close and open unless they were active.

    Attributes:
        wanted: returns the position, 0 to 255, or None; the thread asks it.
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
        """Where they were at the last look, 0 (open) to 1 (closed)."""
        return self._position / 255.0

    def check(self) -> None:
        """Raise the error that has come since the last check: a `GripperFault`, or that of the connection."""
        error, self._error = self._error, None
        if error is not None:
            raise error

    def close(self) -> None:
        """End the thread; the fingers go on to where they were told."""
        self._over.set()
        self._thread.join(_END)

"""The one way by which anything that moves the arm leaves.

Asking the gate and sending happen under the gate's own lock: once a stop has been heard, nothing follows.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from linkcore.streaming.stream import Stream

from .safety import Safety

__all__ = ["Outlet"]

#: Seconds that the controller may take to accept text. A stop that is heard meanwhile waits for that long at most.
SEND_TIMEOUT = 0.5


class Outlet:
    """Sends to a robot, if the gate lets it.

    Args:
        stream: whose connection takes URScript text: the primary interface.
        safety: the gate.
    """

    def __init__(self, stream: Callable[[], Stream[Any]], safety: Safety) -> None:
        self._stream = stream
        self._safety = safety

    def motion(self, text: str, *, brakes: bool = False) -> None:
        """Send URScript that may move the arm.

        Args:
            text: whole lines; the last newline may be left out.
            brakes: it can only bring the arm to rest. An arm that nobody has enabled can move all the same, by a
                program that went on while it could not be heard, and can then be stopped.

        Raises:
            SafetyStop: a stop holds; NotEnabled if only `safety.enable()` is missing.
            NotRunning: the robot does not run, or nothing is known of it.
            RemoteError: it could not be sent.
        """
        self._safety.attend(closely=True)
        self._safety.reconsider(moves=True)
        with self._safety.lock:
            self._safety.admit(brakes)
            self._send(text)

    def command(self, text: str) -> None:
        """Send URScript that moves nothing: outputs, payload, popups. It needs no more than a running robot.

        Raises:
            NotRunning: the robot does not run, or nothing is known of it.
            RemoteError: it could not be sent.
        """
        self._safety.attend()
        self._safety.reconsider(moves=False)
        with self._safety.lock:
            self._safety.admit_command()
            self._send(text)

    def setpoint(self, send: Callable[[], object], *, brakes: bool = False) -> None:
        """Let `send` send something that moves the arm, or that `brakes` it, over another connection; it has to be
        quick.

        Raises:
            SafetyStop, NotRunning: as `motion`; `send` was not called.
            Exception: whatever `send` raises.
        """
        with self._safety.lock:
            self._safety.admit(brakes)
            send()

    def _send(self, text: str) -> None:
        self._stream()._connection.send((text.rstrip("\n") + "\n").encode(), SEND_TIMEOUT)

"""What the simulated grippers share: time and lock, and the lines of text of grippers behind the URCap of Robotiq."""

from __future__ import annotations

import threading
from abc import abstractmethod
from collections.abc import Callable, Iterable, Mapping

from linkcore.names import StrictAttributes


class MountedGripper(StrictAttributes):
    """Gripper of a simulated controller.

    Args:
        clock: Function that returns the time of the controller, in s.

    Attributes:
        is_connected: Whether the gripper is connected. If not, its server rejects requests.
        fault: Fault of the gripper; 0 for none. It can be set.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        self.is_connected = True
        self.fault = 0
        # Tests read the gripper while the server's thread replies to clients.
        self._lock = threading.RLock()
        self._clock = clock
        self._seen = clock()

    @abstractmethod
    def _advance(self) -> None:
        """Advance the gripper to the current time of the controller. The caller holds the lock."""

    def _elapsed(self) -> float:
        """Return the time since the last call, in s."""
        now = self._clock()
        # Ignore negative differences: after a reboot of the controller, its clock starts again at 0.
        seconds, self._seen = max(now - self._seen, 0.0), now
        return seconds


class UrcapGripper(MountedGripper):
    """Gripper of Robotiq, whose URCap replies to lines of text.

    Args:
        clock: See `MountedGripper`.
        writable: Names of the variables that clients can set, and their maximum values.
        readable: Names of all variables.

    Attributes:
        registers: Values that clients have set, by name; see `urlink.protocol.gripper.protocol`.
    """

    def __init__(self, clock: Callable[[], float], writable: Mapping[str, int], readable: Iterable[str]) -> None:
        super().__init__(clock)
        self.registers = dict.fromkeys(writable, 0)
        self._writable = writable
        self._readable = frozenset((*readable, *writable))

    def reply(self, line: str) -> str | None:
        """Return the reply to a line from a client, without a line ending; None if the line gets no reply."""
        with self._lock:
            self._advance()
            return self._answer(line.split())

    def _answer(self, words: list[str]) -> str | None:
        if words[:1] == ["GET"] and len(words) == 2:
            if words[1] not in self._readable or not self.is_connected:
                return "?"
            return f"{words[1]} {self._read(words[1])}"
        if words[:1] == ["SET"] and len(words) > 1 and len(words) % 2:
            pairs = dict(zip(words[1::2], words[2::2], strict=True))
            if all(self._is_value(name, value) for name, value in pairs.items()):
                self._write({name: int(value) for name, value in pairs.items()})
                return "ack"
        return "?" if words else None

    def _is_value(self, name: str, value: str) -> bool:
        return value.isdecimal() and len(value) < 4 and int(value) <= self._writable.get(name, -1)

    @abstractmethod
    def _read(self, name: str) -> int:
        """Return the value of a variable."""

    @abstractmethod
    def _write(self, values: dict[str, int]) -> None:
        """Set variables."""

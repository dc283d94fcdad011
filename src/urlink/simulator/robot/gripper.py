"""A Robotiq 2F-85 on the flange of a simulated arm: its registers, its fingers, and what is between them.

Fingers move at constant speed and stop at once. The range of speeds is that of the data sheet (20 to 150 mm/s over a
stroke of 85 mm). Guesses: that activation closes and opens the fingers at half of the speed; that they go to exactly 0
and 255; the motor current; that an object is gripped at any force; and that the object status of fingers that were
stopped is "at the requested position". The gripper is not in the arm's payload.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence

from linkcore.errors import BadValue
from urlink.interfaces.gripper.protocol import READABLE, WRITABLE

#: m between the open fingers.
STROKE = 0.085
#: Counts a second at speed 0 and 255.
_SLOWEST, _FASTEST = 0.020 / STROKE * 255, 0.150 / STROKE * 255
#: Counts a second at which the fingers move while the gripper is activated.
_ACTIVATING = _FASTEST / 2
#: `OBJ`: moving, stopped while opening or closing, at the requested position.
_MOVING, _STOPPED_OPENING, _STOPPED_CLOSING, _AT_REQUEST = range(4)
#: `FLT` if something is requested before the gripper is activated.
_NOT_ACTIVATED = 7


class SimulatedGripper:
    """The gripper of a simulated controller; it comes up reset, with its fingers open.

    Args:
        clock: seconds of the controller.

    Attributes:
        registers: the values that were set, by name; see `urlink.interfaces.gripper.protocol`.
        is_connected: whether the controller is connected to it; if not, it answers `?`.
        fault: the number of its fault, `FLT`; can be set. Activating clears it.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        self.registers = dict.fromkeys(WRITABLE, 0)
        self.is_connected = True
        self.fault = 0
        # Tests read it while the server's thread answers clients.
        self._lock = threading.Lock()
        self._clock = clock
        self._seen = clock()
        self._position = 0.0
        self._object: float | None = None
        self._is_inside = False
        #: positions that it moves to before it is activated
        self._calibration: list[float] = []
        self._is_active = False
        self._stop = _AT_REQUEST

    # -- for tests -------------------------------------------------------------------------------------

    def place(self, width: float, *, inside: bool = False) -> None:
        """Put an object between the fingers, which they cannot close upon; with `inside`, around them, which
        they cannot open against. It replaces an object that was there.

        Args:
            width: m, of the object from finger to finger, or of the hole in it.
            inside: whether the fingers grip it from inside.

        Raises:
            BadValue: wider than the stroke, or negative.
        """
        if not 0.0 <= width <= STROKE:
            raise BadValue(f"width={width!r} m; expected 0 to the stroke of {STROKE:g} m")
        with self._lock:
            self._advance()
            self._object, self._is_inside = 255 * (1.0 - width / STROKE), inside
            # Fingers in its place are pushed aside, and hold it.
            if self._is_blocked_at(self._position):
                self._position = self._object

    def take_away(self) -> None:
        """Take the object away: the fingers continue to their requested position."""
        with self._lock:
            self._advance()
            self._object = None

    # -- status ----------------------------------------------------------------------------------------

    @property
    def position(self) -> int:
        """Position of the fingers, 0 (open) to 255 (closed)."""
        with self._lock:
            self._advance()
            return round(self._position)

    @property
    def is_active(self) -> bool:
        """Whether it has been activated."""
        with self._lock:
            self._advance()
            return self._is_active

    @property
    def holds_object(self) -> bool:
        """Whether the fingers press on something."""
        with self._lock:
            self._advance()
            return self._stop in (_STOPPED_OPENING, _STOPPED_CLOSING)

    def reply(self, line: str) -> str | None:
        """The reply to a line of a client, without its end; None if there is none."""
        with self._lock:
            self._advance()
            return self._answer(line.split())

    def exchange(self, values: dict[str, int], names: Sequence[str]) -> list[int]:
        """Set registers, and read others in the same moment."""
        with self._lock:
            self._advance()
            if values:
                self._write(values)
            return [self._read(name) for name in names]

    def _answer(self, words: list[str]) -> str | None:
        if words[:1] == ["GET"] and len(words) == 2:
            if words[1] not in READABLE or not self.is_connected:
                return "?"
            return f"{words[1]} {self._read(words[1])}"
        if words[:1] == ["SET"] and len(words) > 1 and len(words) % 2:
            pairs = dict(zip(words[1::2], words[2::2], strict=True))
            if all(_is_value(name, value) for name, value in pairs.items()):
                self._write({name: int(value) for name, value in pairs.items()})
                return "ack"
        return "?" if words else None

    def _read(self, name: str) -> int:
        if name == "POS":
            return round(self._position)
        if name == "PRE":
            return self.registers["POS"]
        if name == "STA":
            return 3 if self._is_active else 1 if self.registers["ACT"] else 0
        if name == "OBJ":
            return self._stop
        if name == "FLT":
            return self.fault
        if name == "COU":
            return {_MOVING: 20, _AT_REQUEST: 0}.get(self._stop, 10 + self.registers["FOR"] // 4)
        return self.registers[name]

    def _write(self, values: dict[str, int]) -> None:
        was_on = self.registers["ACT"]
        self.registers.update(values)
        if not self.registers["ACT"]:
            self._is_active, self._calibration, self.fault, self._stop = False, [], 0, _AT_REQUEST
        elif not was_on:
            self.fault, self._calibration = 0, [255.0, 0.0]
        elif not self._is_active and self.registers["GTO"]:
            self.fault = _NOT_ACTIVATED
        # The object status of the last motion does not hold for a new one.
        if self._is_active and not self.registers["GTO"]:
            self._stop = _AT_REQUEST
        elif self._is_active and values.keys() & {"POS", "GTO"}:
            self._go(0.0)

    # -- its fingers -----------------------------------------------------------------------------------

    def _advance(self) -> None:
        """Move the fingers to their present position."""
        now = self._clock()
        # The clock starts again at 0 when the controller was rebooted.
        seconds, self._seen = max(now - self._seen, 0.0), now
        while seconds > 0.0 and self._calibration:
            seconds = self._travel(self._calibration[0], _ACTIVATING, seconds)
            if self._stop != _MOVING:
                del self._calibration[0]
                self._is_active = not self._calibration
                if self._is_active and self.fault == _NOT_ACTIVATED:
                    self.fault = 0
        if self._is_active:
            self._go(seconds)

    def _go(self, seconds: float) -> None:
        if self.registers["GTO"]:
            speed = _SLOWEST + (_FASTEST - _SLOWEST) * self.registers["SPE"] / 255
            self._travel(float(self.registers["POS"]), speed, seconds)

    def _travel(self, goal: float, speed: float, seconds: float) -> float:
        """Move for at most `seconds`; returns the seconds that are left over."""
        end, stop = goal, _AT_REQUEST
        if self._is_blocked_at(goal):
            assert self._object is not None
            end, stop = self._object, _STOPPED_OPENING if self._is_inside else _STOPPED_CLOSING
        distance = end - self._position
        needed = abs(distance) / speed
        if needed > seconds:
            self._position += speed * seconds if distance > 0.0 else -speed * seconds
            self._stop = _MOVING
            return 0.0
        self._position, self._stop = end, stop
        return seconds - needed

    def _is_blocked_at(self, position: float) -> bool:
        """Whether the object is in the way of this position."""
        if self._object is None:
            return False
        return position < self._object if self._is_inside else position > self._object


def _is_value(name: str, value: str) -> bool:
    return name in WRITABLE and value.isdecimal() and len(value) < 4 and int(value) <= WRITABLE[name]

"""Simulated Robotiq 2F-85 gripper: registers, fingers, gripped object and serial line.

The fingers move at constant speed and stop instantly. The range of speeds is from the data sheet (20 to 150 mm/s over a
stroke of 85 mm). The mass of the gripper is not part of the arm's payload. The following is assumed:

- The activation closes and then opens the fingers at half of the maximum speed.
- The fingers reach the positions 0 and 255 exactly.
- The values of the motor current.
- The fingers stop at an object with any force setting.
- If a client has stopped the fingers, the object status is "at the requested position".

On a serial line, the gripper answers as slave 9 over Modbus RTU. The registers and bits are from the manufacturer's
manual, as public drivers use them. The tests contain the bytes of some examples in this manual. Two more facts are
assumed: an invalid request gets no answer, and answers are sent immediately.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from linkcore.errors import BadValue
from urlink.protocol.gripper.protocol import READABLE, WRITABLE

from .mounted_gripper import UrcapGripper

#: Distance between the open fingers, in m.
STROKE = 0.085
#: Speed of the fingers at the speed settings 0 and 255, in counts per second.
_SLOWEST, _FASTEST = 0.020 / STROKE * 255, 0.150 / STROKE * 255
#: Speed of the fingers during the activation, in counts per second.
_ACTIVATING = _FASTEST / 2
#: `OBJ`: moving, stopped while opening or closing, at the requested position.
_MOVING, _STOPPED_OPENING, _STOPPED_CLOSING, _AT_REQUEST = range(4)
#: Value of `FLT` if a motion is requested before the gripper is activated.
_NOT_ACTIVATED = 7


class SimulatedGripper(UrcapGripper):
    """Gripper of a simulated controller. Initially, it is reset, and its fingers are open.

    Args:
        clock: Function that returns the time of the controller, in s.

    Attributes:
        registers: Values that clients have set, by name; see `urlink.protocol.gripper.protocol`.
        is_connected: Whether the gripper is connected to the controller. If not, the reply to a query is `?`.
        fault: Fault number (`FLT`). It can be set; an activation of the gripper clears it.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        super().__init__(clock, WRITABLE, READABLE)
        self._position = 0.0
        self._object: float | None = None
        self._is_inside = False
        #: Positions to which the fingers still have to move during the activation.
        self._calibration: list[float] = []
        self._is_active = False
        self._stop = _AT_REQUEST

    # -- for tests -------------------------------------------------------------------------------------

    def place(self, width: float, *, inside: bool = False) -> None:
        """Put an object between the fingers, so that the fingers stop at it when they close.

        With `inside`, the object surrounds the fingers, so that the fingers stop at it when they open. The object
        replaces the previous object.

        Args:
            width: Width of the object between the fingers, or of the hole in the object, in m.
            inside: Whether the fingers grip the object from inside.

        Raises:
            BadValue: If the width is negative or exceeds the stroke.
        """
        if not 0.0 <= width <= STROKE:
            raise BadValue(f"width={width!r} m; expected 0 to the stroke of {STROKE:g} m")
        with self._lock:
            self._advance()
            self._object, self._is_inside = 255 * (1.0 - width / STROKE), inside
            # If a finger is where the object is placed, move the fingers to the surface of the object. They then grip
            # it.
            if self._is_blocked_at(self._position):
                self._position = self._object

    def take_away(self) -> None:
        """Remove the object. The fingers then continue to the requested position."""
        with self._lock:
            self._advance()
            self._object = None

    # -- status ----------------------------------------------------------------------------------------

    @property
    def position(self) -> int:
        """Position of the fingers, from 0 (open) to 255 (closed)."""
        with self._lock:
            self._advance()
            return round(self._position)

    @property
    def is_active(self) -> bool:
        """Whether the gripper has been activated."""
        with self._lock:
            self._advance()
            return self._is_active

    @property
    def holds_object(self) -> bool:
        """Whether the fingers press on an object."""
        with self._lock:
            self._advance()
            return self._stop in (_STOPPED_OPENING, _STOPPED_CLOSING)

    def exchange(self, values: dict[str, int], names: Sequence[str]) -> list[int]:
        """Set registers, and return the values of other registers at the same moment."""
        with self._lock:
            self._advance()
            if values:
                self._write(values)
            return [self._read(name) for name in names]

    def _read(self, name: str) -> int:
        shown = self.registers | {
            "POS": round(self._position),
            "PRE": self.registers["POS"],
            "STA": 3 if self._is_active else 1 if self.registers["ACT"] else 0,
            "OBJ": self._stop,
            "FLT": self.fault,
            "COU": {_MOVING: 20, _AT_REQUEST: 0}.get(self._stop, 10 + self.registers["FOR"] // 4),
        }
        return shown[name]

    def _write(self, values: dict[str, int]) -> None:
        was_on = self.registers["ACT"]
        self.registers.update(values)
        if not self.registers["ACT"]:
            self._is_active, self._calibration, self.fault, self._stop = False, [], 0, _AT_REQUEST
        elif not was_on:
            self.fault, self._calibration = 0, [255.0, 0.0]
        elif not self._is_active and self.registers["GTO"]:
            self.fault = _NOT_ACTIVATED
        # Reset the object status of the previous motion, because it does not apply to a new motion.
        if self._is_active and not self.registers["GTO"]:
            self._stop = _AT_REQUEST
        elif self._is_active and values.keys() & {"POS", "GTO"}:
            self._go(0.0)

    # -- its fingers -----------------------------------------------------------------------------------

    def _advance(self) -> None:
        """Advance the fingers to the current time of the controller."""
        seconds = self._elapsed()
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
        """Move the fingers towards `goal` for at most `seconds`, and return the remaining time in s."""
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
        """Whether the object prevents the fingers from reaching this position."""
        if self._object is None:
            return False
        return position < self._object if self._is_inside else position > self._object


# -- Modbus RTU -----------------------------------------------------------------------------------

#: Slave address; first register that clients write; first register that clients read; number of registers of each kind.
_SLAVE, _TOLD, _TELLS, _COUNT = 9, 0x03E8, 0x07D0, 3
_READ_HOLDING, _READ_INPUT, _WRITE_ONE, _WRITE = 0x03, 0x04, 0x06, 0x10
#: Exception codes: unknown function, unknown address, invalid number of registers.
_NO_FUNCTION, _NO_ADDRESS, _NO_VALUE = 1, 2, 3
#: Number of bytes of a read request, and of a request that writes one register.
_SHORT = 8
#: Name of a gripper register -> bit of the action request.
_ACTION = {"ACT": 0, "GTO": 3, "ATR": 4, "ARD": 5}


def crc(data: bytes) -> bytes:
    """Return the checksum that follows a frame: CRC-16/MODBUS, low byte first.

    >>> crc(bytes.fromhex("09 03 07 D0 00 03")).hex(" ")
    '04 0e'
    """
    value = 0xFFFF
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = (value >> 1) ^ 0xA001 if value & 1 else value >> 1
    return value.to_bytes(2, "little")


class ModbusGripper:
    """Gripper as a device on a serial line. Call it with received bytes; it returns the bytes of its answer.

    Args:
        gripper: Gripper that the device controls. Another client may use the gripper through the URCap at the same
            time.
    """

    def __init__(self, gripper: SimulatedGripper) -> None:
        self._gripper = gripper
        self._told = bytearray(2 * _COUNT)
        self._waiting = b""

    def __call__(self, data: bytes) -> bytes:
        """Return the answers to all requests that are complete with these bytes.

        Requests to other slaves and broken requests have no answer.
        """
        self._waiting += data
        answers = b""
        while len(self._waiting) >= _SHORT:
            size = 9 + self._waiting[6] if self._waiting[1] == _WRITE else _SHORT
            if len(self._waiting) < size:
                break
            frame, self._waiting = self._waiting[:size], self._waiting[size:]
            if crc(frame[:-2]) != frame[-2:]:
                # Discard all bytes, because the start of the next request is unknown. A real device detects the start
                # by the silence before it.
                self._waiting = b""
            elif frame[0] == _SLAVE:
                answer = self._answer(frame[1], frame[2:-2])
                answers += answer + crc(answer)
        return answers

    def _answer(self, function: int, body: bytes) -> bytes:
        first, number = int.from_bytes(body[:2], "big"), int.from_bytes(body[2:4], "big")
        if function in (_READ_HOLDING, _READ_INPUT):
            place = first - _TELLS if first >= _TELLS else first - _TOLD
            whole = self._tells() if first >= _TELLS else bytes(self._told)
            if not 1 <= number <= _COUNT:
                return self._refused(function, _NO_VALUE)
            if not 0 <= place <= _COUNT - number:
                return self._refused(function, _NO_ADDRESS)
            part = whole[2 * place : 2 * (place + number)]
            return bytes((_SLAVE, function, len(part))) + part
        if function in (_WRITE, _WRITE_ONE):
            values = body[5:] if function == _WRITE else body[2:4]
            place, count = first - _TOLD, len(values) // 2
            if function == _WRITE and (number != count or not count or body[4] != len(values)):
                return self._refused(function, _NO_VALUE)
            if not 0 <= place <= _COUNT - count:
                return self._refused(function, _NO_ADDRESS)
            self._told[2 * place : 2 * (place + count)] = values
            self._tell()
            return bytes((_SLAVE, function)) + body[:4]
        return self._refused(function, _NO_FUNCTION)

    def _refused(self, function: int, why: int) -> bytes:
        return bytes((_SLAVE, function | 0x80, why))

    def _tell(self) -> None:
        """Pass the written bytes to the gripper: action request, 0, 0, position, speed, force."""
        values = {name: self._told[0] >> bit & 1 for name, bit in _ACTION.items()}
        self._gripper.exchange(values | {"POS": self._told[3], "SPE": self._told[4], "FOR": self._told[5]}, ())

    def _tells(self) -> bytes:
        """Return the bytes that clients read.

        They are status, 0, fault, requested position, position, and current in units of 10 mA.
        """
        names = ("ACT", "GTO", "STA", "OBJ", "FLT", "PRE", "POS", "COU")
        active, goes, status, found, fault, wanted, position, current = self._gripper.exchange({}, names)
        return bytes((active | goes << 3 | status << 4 | found << 6, 0, fault, wanted, position, current))

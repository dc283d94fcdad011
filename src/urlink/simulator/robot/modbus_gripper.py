"""The Robotiq 2F-85 as it answers on a serial line: Modbus RTU, slave 9.

Registers and bits are those of the maker's manual as public drivers use them; the bytes of some of the manual's
examples are in the tests. Guesses: that what it does not understand gets no answer, and that it answers at once.
"""

from __future__ import annotations

from .gripper import SimulatedGripper

#: Its address; the first register of what is written and of what is read; how many of each.
_SLAVE, _TOLD, _TELLS, _COUNT = 9, 0x03E8, 0x07D0, 3
_READ_HOLDING, _READ_INPUT, _WRITE_ONE, _WRITE = 0x03, 0x04, 0x06, 0x10
#: Exceptions: a function, an address, a number of registers that there is not.
_NO_FUNCTION, _NO_ADDRESS, _NO_VALUE = 1, 2, 3
#: Bytes of a request that is read, and of one with one register.
_SHORT = 8
#: Bits of the action request, by register of the gripper.
_ACTION = {"ACT": 0, "GTO": 3, "ATR": 4, "ARD": 5}


def crc(data: bytes) -> bytes:
    """The check of a frame, which follows it: CRC-16/MODBUS, low byte first.

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
    """A device on a serial line: called with the bytes that come, it returns those that it answers with.

    Args:
        gripper: that it is; another client may use it through its URCap meanwhile.
    """

    def __init__(self, gripper: SimulatedGripper) -> None:
        self._gripper = gripper
        self._told = bytearray(2 * _COUNT)
        self._waiting = b""

    def __call__(self, data: bytes) -> bytes:
        """The answers to the requests that these bytes complete; those that are for others or broken have none."""
        self._waiting += data
        answers = b""
        while len(self._waiting) >= _SHORT:
            size = 9 + self._waiting[6] if self._waiting[1] == _WRITE else _SHORT
            if len(self._waiting) < size:
                break
            frame, self._waiting = self._waiting[:size], self._waiting[size:]
            if crc(frame[:-2]) != frame[-2:]:
                # Where the next one begins cannot be seen: a real line knows by its silence.
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
        """Have the gripper do what was written: action request, 0, 0, position, speed, force."""
        values = {name: self._told[0] >> bit & 1 for name, bit in _ACTION.items()}
        self._gripper.exchange(values | {"POS": self._told[3], "SPE": self._told[4], "FOR": self._told[5]}, ())

    def _tells(self) -> bytes:
        """Status, 0, fault, requested position, position, current in units of 10 mA."""
        names = ("ACT", "GTO", "STA", "OBJ", "FLT", "PRE", "POS", "COU")
        active, goes, status, found, fault, wanted, position, current = self._gripper.exchange({}, names)
        return bytes((active | goes << 3 | status << 4 | found << 6, 0, fault, wanted, position, current))

"""Messages to a program that receives one message in each cycle: functions that pack, date and read a message."""

from __future__ import annotations

import struct
from collections.abc import Sequence

from .links import FOLLOW, SCALE, STOP, WAIT

_MESSAGE = struct.Struct(">13i")
#: Largest date, and largest number of a message in a register. It is the largest signed 32-bit integer, which is
#: reached after 49 days at 500 Hz. After it, the numbers of messages begin at 1 again, because a register that was
#: never written contains 0.
LARGEST = 0x7FFF_FFFF
#: End of a message with a set-point.
_FOLLOW_BYTES = FOLLOW.to_bytes(4, "big")
#: Number of bytes of a message without its date.
MESSAGE_SIZE = _MESSAGE.size

#: Message after which the program brakes and ends.
STOP_MESSAGE = _MESSAGE.pack(*[0] * 12, STOP)
#: Message without a set-point. It only shows that this computer is still connected.
WAIT_MESSAGE = _MESSAGE.pack(*[0] * 12, WAIT)


def setpoint(q: Sequence[float], qd: Sequence[float]) -> bytes:
    """Pack a set-point in the format that the streaming program reads.

    Args:
        q: Positions, shape (6,), in rad.
        qd: Speeds with which the program continues from `q` until the next set-point arrives, shape (6,), in rad/s.
    """
    return packed(q, qd, FOLLOW)


def packed(first: Sequence[float], second: Sequence[float], mode: int) -> bytes:
    """Pack twelve numbers and a command for a program from `urlink.script.links`, without the date."""
    return _MESSAGE.pack(*[round(each * SCALE) for each in (*first, *second)], mode)


def dated(message: bytes, date: int, pauses: int = 0) -> bytes:
    """Return a message in the form in which it is sent: with its date, and with the number of pauses.

    Args:
        message: Message without its date. It ends with the command.
        date: Date in cycles, which is appended to the message.
        pauses: Number of pauses of the program so far. The program uses this number to recognize set-points from before
            a pause (`urlink.script.links`).
    """
    if pauses and len(message) == MESSAGE_SIZE and message.endswith(_FOLLOW_BYTES):
        message = message.removesuffix(_FOLLOW_BYTES) + (WAIT + pauses).to_bytes(4, "big")
    return message + min(date, LARGEST).to_bytes(4, "big")


def read_message(message: bytes) -> tuple[list[float], list[float], int]:
    """Unpack a message without its date; return joint positions in rad, joint speeds in rad/s, and the command."""
    *numbers, mode = _MESSAGE.unpack(message)
    values = [each / SCALE for each in numbers]
    return values[:6], values[6:], mode

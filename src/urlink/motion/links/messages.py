"""Messages to a program that follows this computer cycle by cycle: how they are packed, dated and read."""

from __future__ import annotations

import struct
from collections.abc import Sequence

from ...script.links import FOLLOW, SCALE, STOP, WAIT

_MESSAGE = struct.Struct(">13i")
#: Largest date, and largest number of a message in a register: the largest number with 32 bits, reached after 49 days
#: at 500 Hz. After it, the numbers begin at 1 again, because a register that was never written contains 0.
LARGEST = 0x7FFF_FFFF
#: End of a message with a set-point.
_FOLLOW_BYTES = FOLLOW.to_bytes(4, "big")
#: Number of bytes of a message without its date.
MESSAGE_SIZE = _MESSAGE.size

#: Message to brake and end the program.
STOP_MESSAGE = _MESSAGE.pack(*[0] * 12, STOP)
#: Message without a set-point. It only shows that this computer is alive.
WAIT_MESSAGE = _MESSAGE.pack(*[0] * 12, WAIT)


def setpoint(q: Sequence[float], qd: Sequence[float]) -> bytes:
    """Pack a set-point in the format that the streaming program reads.

    Args:
        q: Positions, shape (6,), in rad.
        qd: Speeds of the program from there until the next set-point arrives, shape (6,), in rad/s.
    """
    return packed(q, qd, FOLLOW)


def packed(first: Sequence[float], second: Sequence[float], mode: int) -> bytes:
    """Pack two times six numbers and a command for a program of `urlink.script.links`, without the date."""
    return _MESSAGE.pack(*[round(each * SCALE) for each in (*first, *second)], mode)


def dated(message: bytes, date: int, pauses: int = 0) -> bytes:
    """Return a message as it is sent (`urlink.script.links`).

    Args:
        message: Message, with the command at its end.
        date: Date in cycles, which is added after the message.
        pauses: Number of pauses of the program so far. With it, set-points from before a pause can be distinguished
            from later ones.
    """
    if pauses and len(message) == MESSAGE_SIZE and message.endswith(_FOLLOW_BYTES):
        message = message.removesuffix(_FOLLOW_BYTES) + (WAIT + pauses).to_bytes(4, "big")
    return message + min(date, LARGEST).to_bytes(4, "big")


def read_message(message: bytes) -> tuple[list[float], list[float], int]:
    """Return the content of a message without its date: joint positions in rad, joint speeds in rad/s, command."""
    *numbers, mode = _MESSAGE.unpack(message)
    values = [each / SCALE for each in numbers]
    return values[:6], values[6:], mode

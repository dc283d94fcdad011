"""Messages to a program that obeys this computer cycle by cycle: how they are packed, dated and read."""

from __future__ import annotations

import struct
from collections.abc import Sequence

from ...script.links import FOLLOW, SCALE, STOP, WAIT

_MESSAGE = struct.Struct(">13i")
#: Largest date, and largest number of a message in a register, as large as 32 bits hold: after 49 days at 500 Hz. After
#: it the numbers begin at 1 again, since 0 is what a register holds that nobody has written.
LARGEST = 0x7FFF_FFFF
#: The end of a message with a set-point.
_FOLLOW_BYTES = FOLLOW.to_bytes(4, "big")
#: Bytes of a message without its date.
MESSAGE_SIZE = _MESSAGE.size

#: Brake, and end the program.
STOP_MESSAGE = _MESSAGE.pack(*[0] * 12, STOP)
#: No set-point yet; it only shows that this computer is alive.
WAIT_MESSAGE = _MESSAGE.pack(*[0] * 12, WAIT)


def setpoint(q: Sequence[float], qd: Sequence[float]) -> bytes:
    """A set-point as the streaming program reads it.

    Args:
        q: (6,) rad.
        qd: (6,) rad/s with which the program goes on from there until the next one comes.
    """
    return packed(q, qd, FOLLOW)


def packed(first: Sequence[float], second: Sequence[float], mode: int) -> bytes:
    """Two times six numbers and what to do, as a program by `urlink.script.links` reads them, without the date."""
    return _MESSAGE.pack(*[round(each * SCALE) for each in (*first, *second)], mode)


def dated(message: bytes, date: int, pauses: int = 0) -> bytes:
    """A message as it is sent (`urlink.script.links`).

    Args:
        message: what to do is its end.
        date: cycles; comes after it.
        pauses: of the program, so far: set-points after a pause are distinguished from those before.
    """
    if pauses and len(message) == MESSAGE_SIZE and message.endswith(_FOLLOW_BYTES):
        message = message.removesuffix(_FOLLOW_BYTES) + (WAIT + pauses).to_bytes(4, "big")
    return message + min(date, LARGEST).to_bytes(4, "big")


def read_message(message: bytes) -> tuple[list[float], list[float], int]:
    """The content of a message without its date: joint positions, rad, joint speeds, rad/s, and the command."""
    *numbers, mode = _MESSAGE.unpack(message)
    values = [each / SCALE for each in numbers]
    return values[:6], values[6:], mode

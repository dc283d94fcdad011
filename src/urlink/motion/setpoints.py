"""What is said to the streaming program: its words, and how it is to follow them."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass

from ..firmware import Firmware
from ..urscript.programs import FOLLOW, SCALE, STOP, WAIT, InputRegisters, ReverseSocket, missable, streaming

__all__ = ["STOP_WORD", "WAIT_WORD", "WORD_SIZE", "Servoing", "read_word", "setpoint"]

_WORD = struct.Struct(">13i")
#: Bytes of a word.
WORD_SIZE = _WORD.size

#: Brake, and end the program.
STOP_WORD = _WORD.pack(*[0] * 12, STOP)
#: There is nothing to do yet, but the client is there.
WAIT_WORD = _WORD.pack(*[0] * 12, WAIT)


def setpoint(q: Sequence[float], qd: Sequence[float]) -> bytes:
    """A set-point as the streaming program reads it.

    Args:
        q: (6,) rad.
        qd: (6,) rad/s with which the program goes on from there until the next one comes.
    """
    return _WORD.pack(*[round(each * SCALE) for each in (*q, *qd)], FOLLOW)


def read_word(word: bytes) -> tuple[list[float], list[float], int]:
    """What a word says: positions of the joints, rad, their speeds, rad/s, and what to do."""
    *numbers, mode = _WORD.unpack(word)
    values = [each / SCALE for each in numbers]
    return values[:6], values[6:], mode


@dataclass(frozen=True)
class Servoing:
    """How set-points are followed.

    Attributes:
        firmware: of the controller.
        speeds: (6,) rad/s at most of each joint.
        watchdog: seconds without one after which the robot brakes.
        lookahead_time, gain: of ``servoj``, where the firmware has them.
    """

    firmware: Firmware
    speeds: tuple[float, ...]
    watchdog: float
    lookahead_time: float
    gain: float

    @property
    def missable(self) -> int:
        """Cycles without a set-point after which the robot brakes."""
        return missable(self.watchdog, self.firmware.rate)

    def coasting(self, missed: int) -> float:
        """For how many cycles at full speed the program on the robot goes on in so many without a set-point."""
        n = min(missed, self.missable)
        return n - n * (n + 1) / (2.0 * self.missable)

    def share(self, missed: int) -> float:
        """The part of its speed that it has in the last of them."""
        return 1.0 - min(missed, self.missable) / self.missable

    def body(self, link: ReverseSocket | InputRegisters) -> list[str]:
        """The lines of the program that gets its set-points by `link`."""
        return streaming(
            self.firmware,
            link,
            speeds=self.speeds,
            watchdog=self.watchdog,
            lookahead_time=self.lookahead_time,
            gain=self.gain,
        )

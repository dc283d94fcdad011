"""The words of the streaming program, and the parameters by which it follows set-points."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass

from ..firmware import Firmware
from ..urscript.links import FOLLOW, SCALE, STOP, WAIT, InputRegisters, ReverseSocket, missable
from ..urscript.streaming import COASTING, streaming

__all__ = ["STOP_WORD", "WAIT_WORD", "WORD_SIZE", "Servoing", "read_word", "setpoint"]

_WORD = struct.Struct(">13i")
#: Bytes of a word.
WORD_SIZE = _WORD.size

#: Brake, and end the program.
STOP_WORD = _WORD.pack(*[0] * 12, STOP)
#: No set-point yet; it only shows that this computer is there.
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
        period: seconds between two set-points, where they do not come in each cycle.
    """

    firmware: Firmware
    speeds: tuple[float, ...]
    watchdog: float
    lookahead_time: float
    gain: float
    period: float = 0.0

    @property
    def _coasting(self) -> float:
        """Seconds. With three periods, a loop that is slower than the controller still leads the arm evenly."""
        return max(COASTING, 3.0 * self.period)

    @property
    def coastable(self) -> int:
        """Cycles without a set-point in which the program on the robot goes on by itself."""
        return missable(min(self.watchdog, self._coasting), self.firmware.rate)

    @property
    def late(self) -> float:
        """Seconds of lateness that may be made up for at once, since the robot has gone on by itself meanwhile."""
        return self.coastable / self.firmware.rate

    def coasting(self, missed: int) -> float:
        """For how many cycles at full speed the program on the robot goes on in so many without a set-point."""
        n = min(missed, self.coastable)
        return n - n * (n + 1) / (2.0 * self.coastable)

    def share(self, missed: int) -> float:
        """The part of its speed that it has in the last of them."""
        return 1.0 - min(missed, self.coastable) / self.coastable

    def body(self, link: ReverseSocket | InputRegisters) -> list[str]:
        """The lines of the program that gets its set-points by `link`."""
        return streaming(
            self.firmware,
            link,
            speeds=self.speeds,
            watchdog=self.watchdog,
            coasting=self._coasting,
            lookahead_time=self.lookahead_time,
            gain=self.gain,
        )

"""The words of the streaming program, and the parameters by which it follows set-points."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass

from ..firmware import Firmware
from ..urscript.links import FOLLOW, SCALE, STOP, WAIT, InputRegisters, ReverseSocket, missable
from ..urscript.streaming import COASTING, streaming

__all__ = ["STOP_WORD", "WAIT_WORD", "WORD_SIZE", "Servoing", "dated", "read_word", "setpoint"]

_WORD = struct.Struct(">13i")
#: Largest date, as large as 32 bits hold: after 49 days at 500 Hz.
_LAST_DATE = 0x7FFF_FFFF
#: Bytes of a word without its date.
WORD_SIZE = _WORD.size

#: Brake, and end the program.
STOP_WORD = _WORD.pack(*[0] * 12, STOP)
#: No set-point yet; it only shows that this computer is alive.
WAIT_WORD = _WORD.pack(*[0] * 12, WAIT)


def setpoint(q: Sequence[float], qd: Sequence[float]) -> bytes:
    """A set-point as the streaming program reads it.

    Args:
        q: (6,) rad.
        qd: (6,) rad/s with which the program goes on from there until the next one comes.
    """
    return _WORD.pack(*[round(each * SCALE) for each in (*q, *qd)], FOLLOW)


def dated(word: bytes, date: int) -> bytes:
    """A word as it is sent: after it comes its date (`urlink.urscript.links`), cycles."""
    return word + min(date, _LAST_DATE).to_bytes(4, "big")


def read_word(word: bytes) -> tuple[list[float], list[float], int]:
    """The content of a word without its date: joint positions, rad, joint speeds, rad/s, and the command."""
    *numbers, mode = _WORD.unpack(word)
    values = [each / SCALE for each in numbers]
    return values[:6], values[6:], mode


@dataclass(frozen=True)
class Servoing:
    """The parameters by which set-points are followed.

    Attributes:
        firmware: of the controller.
        speeds: (6,) rad/s, the largest of each joint.
        watchdog: seconds without a set-point after which the robot brakes.
        lookahead_time, gain: of ``servoj``, if the firmware has them.
        period: seconds between two set-points, if they do not come in each cycle; else 0.
    """

    firmware: Firmware
    speeds: tuple[float, ...]
    watchdog: float
    lookahead_time: float
    gain: float
    period: float = 0.0

    @property
    def _coasting(self) -> float:
        """Seconds of coasting: three periods, so that a loop slower than the controller moves the arm evenly."""
        return max(COASTING, 3.0 * self.period)

    @property
    def coastable(self) -> int:
        """Cycles for which the program on the robot coasts at most."""
        return missable(min(self.watchdog, self._coasting), self.firmware.rate)

    @property
    def late(self) -> float:
        """Seconds of lateness that may be made up for at once, since the robot has coasted meanwhile."""
        return self.coastable / self.firmware.rate

    def coasting(self, missed: int) -> float:
        """Number of cycles at full speed that lead as far as coasting for `missed` cycles."""
        n = min(missed, self.coastable)
        return n - n * (n + 1) / (2.0 * self.coastable)

    def share(self, missed: int) -> float:
        """The fraction of the full speed after coasting for `missed` cycles."""
        return 1.0 - min(missed, self.coastable) / self.coastable

    def body(self, link: ReverseSocket | InputRegisters) -> list[str]:
        """The lines of the program, which receives its set-points over `link`."""
        return streaming(
            self.firmware,
            link,
            speeds=self.speeds,
            watchdog=self.watchdog,
            coasting=self._coasting,
            lookahead_time=self.lookahead_time,
            gain=self.gain,
        )

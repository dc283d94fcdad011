"""Cycles of a controller of which no packet came, counted by the controller's own clock.

Each packet of a controller that sends one every cycle has the time of its cycle. Between two packets whose times are
several periods apart, packets are missing: the controller did not send them, or they were lost before they came here.
Times of arrival cannot show that, since packets that were held up come later, all at once, with none missing.

A clock that goes backwards, or ahead by more than an hour, is another clock (`ANOTHER_CLOCK`): nothing is counted then.
The same rule holds while packets are received (`MissedCycles`) and for columns of a recording (`gaps_of`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

#: Seconds that a clock goes on at most between two packets of one connection; more is the time of something else.
ANOTHER_CLOCK = 3600.0
#: No comparison with it holds.
_NO_TIME = float("nan")
#: Parts of a period by which two packets in a row may be late: the primary interface has a period of 12.5 cycles, and
#: sends after 12 or 13 (docs/protocols/primary.md, section Time stamps).
_SLACK = 0.5


class Gap(NamedTuple):
    """Packets that are missing between two others.

    Attributes:
        start: arrival of the last packet before them, s since the recording began.
        end: arrival of the first packet after them, s since the recording began.
        cycles: how many are missing.
        seconds: from the one packet to the other by the controller's clock.
    """

    start: float
    end: float
    cycles: int
    seconds: float


class Missing(NamedTuple):
    """How much is missing.

    Attributes:
        cycles: that are missing.
        gaps: places where some are missing.
        longest: seconds of the longest gap by the controller's clock, from packet to packet.
    """

    cycles: int = 0
    gaps: int = 0
    longest: float = 0.0

    def plus(self, other: Missing) -> Missing:
        """Both together."""
        return Missing(self.cycles + other.cycles, self.gaps + other.gaps, max(self.longest, other.longest))

    def text(self, received: int) -> str:
        """For people: "363 of 475 cycles are missing (2 gaps, the longest 0.400 s)".

        Args:
            received: packets that are not missing.
        """
        count = f"{self.cycles} of {self.cycles + received} cycles {'is' if self.cycles == 1 else 'are'} missing"
        return f"{count} ({self.gaps} gap{'' if self.gaps == 1 else 's'}, the longest {self.longest:.3f} s)"


class MissedCycles:
    """Counts missing cycles of one connection while its packets come.

    Args:
        moment: the time of a packet by the controller's clock, s, from its bytes; None where it has none.
        periods: seconds from one packet to the next; several where it is not known which, until two packets show it.
        time: what `moment` returns, of a packet of `size` bytes: one call of C code (`struct.Struct.unpack_from`).
        size: of the packets that have a time, in bytes; -1 if they have several sizes.

    Attributes:
        missing: how much, so far; replaced as a whole, so that other threads can read it.
        duplicates: Packets so far with the same time as the packet before.
        last: the time of the newest packet that has one, s by the controller's clock; NaN before the first.
        at_most: the longest step between two packets with none missing, s; 0 while the period is not known.
    """

    def __init__(
        self,
        moment: Callable[[bytes], float | None],
        periods: Iterable[float],
        *,
        time: Callable[[bytes], Sequence[Any]] = tuple,
        size: int = -1,
    ) -> None:
        self.missing = Missing()
        self.duplicates = 0
        self.time = time
        self.size = size
        self._moment = moment
        self._period, *self._shorter = sorted(periods, reverse=True)
        self._set_at_most()
        self.last = _NO_TIME

    def take(self, frames: Sequence[bytes]) -> None:
        """Packets have come, at least one, in order. `Receiver` calls it unless one has come that follows on `last`."""
        time, size, last, at_most = self.time, self.size, self.last, self.at_most
        for frame in frames:
            quick = time(frame)[0] if len(frame) == size else _NO_TIME
            if 0.0 < quick - last <= at_most:
                last = quick
                continue
            moment = self._moment(frame)
            if moment is not None:
                self._step(moment - last)
                last, at_most = moment, self.at_most
        self.last = last

    def _set_at_most(self) -> None:
        self.at_most = 0.0 if self._shorter else (1.0 + _SLACK) * self._period

    def _step(self, step: float) -> None:
        if step == 0.0:
            self.duplicates += 1
        while self._shorter and 0.0 < step < (1.0 - _SLACK / 2) * self._period:
            self._period = self._shorter.pop(0)
            self._set_at_most()
        if (1.0 + _SLACK) * self._period < step <= ANOTHER_CLOCK:
            self.missing = self.missing.plus(Missing(max(round(step / self._period) - 1, 1), 1, step))


def gaps_of(
    moments: NDArray[np.float64], arrivals: NDArray[np.float64], periods: Iterable[float], begins: Sequence[int] = ()
) -> list[Gap]:
    """Where cycles are missing between the rows of a recording.

    Args:
        moments: time of each row by the controller's clock, s, (n,).
        arrivals: of each row, s since the recording began, (n,).
        periods: as for `MissedCycles`.
        begins: rows with which a connection begins: what is missing before them is not counted.
    """
    steps = np.diff(moments)
    steps[np.asarray(begins, np.intp) - 1] = np.nan
    period, *shorter = sorted(periods, reverse=True)
    smallest = float(np.min(steps[steps > 0], initial=np.inf))
    while shorter and smallest < (1.0 - _SLACK / 2) * period:
        period = shorter.pop(0)
    rows = np.flatnonzero((steps > (1.0 + _SLACK) * period) & (steps <= ANOTHER_CLOCK))
    return [
        Gap(float(arrivals[row]), float(arrivals[row + 1]), max(round(step / period) - 1, 1), step)
        for row, step in zip(rows.tolist(), steps[rows].tolist(), strict=True)
    ]

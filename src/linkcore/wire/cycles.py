"""Counting of the controller cycles whose packets never arrived, based on the controller's own clock.

If a controller sends a packet in every cycle, each packet has the time of its cycle. If the times of two consecutive
packets are several periods apart, packets are missing between them. The controller did not send these packets, or they
were lost on the way. Arrival times cannot show missing packets: packets that were only delayed arrive later, all at
once, and none of them is missing.

If a clock goes backwards, or jumps ahead by more than an hour, it is a different clock (`ANOTHER_CLOCK`), and nothing
is counted. The same rule applies while packets are received (`MissedCycles`) and to columns of a recording (`gaps_of`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

#: Maximum step in s between two packets of one connection. A larger step shows that it is a different clock.
ANOTHER_CLOCK = 3600.0
#: NaN, because every comparison with NaN is false.
_NO_TIME = float("nan")
#: Part of a period by which the next packet may be late. The primary interface has a period of 12.5 cycles, and sends
#: after 12 or 13 cycles (docs/protocols/primary.md, section Time stamps).
_SLACK = 0.5


class Gap(NamedTuple):
    """Missing packets between two received packets.

    Attributes:
        start: Arrival of the last packet before the gap, in s since the start of the recording.
        end: Arrival of the first packet after the gap, in s since the start of the recording.
        cycles: Number of missing packets.
        seconds: Time between the two packets by the controller's clock, in s.
    """

    start: float
    end: float
    cycles: int
    seconds: float


class Missing(NamedTuple):
    """Summary of the missing cycles.

    Attributes:
        cycles: Number of missing cycles.
        gaps: Number of gaps.
        longest: Duration of the longest gap by the controller's clock, from packet to packet, in s.
    """

    cycles: int = 0
    gaps: int = 0
    longest: float = 0.0

    def plus(self, other: Missing) -> Missing:
        """Return the sum of both."""
        return Missing(self.cycles + other.cycles, self.gaps + other.gaps, max(self.longest, other.longest))

    def text(self, received: int) -> str:
        """Return a readable text: "363 of 475 cycles are missing (2 gaps, the longest 0.400 s)".

        Args:
            received: Number of received packets.
        """
        count = f"{self.cycles} of {self.cycles + received} cycles {'is' if self.cycles == 1 else 'are'} missing"
        return f"{count} ({self.gaps} gap{'' if self.gaps == 1 else 's'}, the longest {self.longest:.3f} s)"


class MissedCycles:
    """Counter of the missing cycles of one connection, used while its packets arrive.

    Args:
        moment: Function that returns the time of a packet by the controller's clock in s, from its bytes; None if the
            packet has no time.
        periods: Possible periods of the packets, in s. If there are several, two packets show which one applies.
        time: Function that returns the same as `moment` for a packet of `size` bytes, as the first element. It is a
            single call of C code (`struct.Struct.unpack_from`).
        size: Size in bytes of the packets that have a time; -1 if they have several sizes.

    Attributes:
        missing: Missing cycles so far. It is replaced as a whole, so that other threads can read it.
        duplicates: Number of packets so far with the same time as the previous packet.
        last: Time of the newest packet that has a time, by the controller's clock, in s; NaN before the first packet.
        at_most: Longest step in s between two packets without a missing one; 0 while the period is unknown.
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
        """Count one or more received packets, in order.

        `Receiver` does not call this for a single packet that directly follows `last`.
        """
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

    def moment_of(self, head: bytes) -> float:
        """Return the time of a packet by the controller's clock in s, from its first bytes; NaN if it has none."""
        moment = self._moment(head) if self.size < 0 else self.time(head)[0]
        return _NO_TIME if moment is None else moment

    def is_next(self, moment: float) -> bool:
        """Whether no packet is missing before a packet with this time of the controller's clock, in s."""
        return 0.0 < moment - self.last <= (1.0 + _SLACK) * self._period

    def take_moment(self, moment: float) -> None:
        """Count one received packet, given its time by the controller's clock, in s."""
        step = moment - self.last
        if not 0.0 < step <= self.at_most:
            self._step(step)
        self.last = moment

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
    """Return the gaps between the rows of a recording.

    Args:
        moments: Time of each row by the controller's clock, in s, shape (n,).
        arrivals: Arrival of each row in s since the start of the recording, shape (n,).
        periods: See `MissedCycles`.
        begins: Indices of the first row of each connection. Cycles that are missing before these rows do not count.
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

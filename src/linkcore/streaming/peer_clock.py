"""The clock of a peer compared with the clock of this computer, from the times in its packets and when they arrived.

A packet has the time of the peer at which it was made, and arrives later. How long it was under way is unknown, but
two things are: it was no less than nothing; and the quickest of many took no longer than the handshake of their TCP
connection, which went there and back. So the packets that came quickest show the relation of both clocks, but for that
round trip: `OffsetEstimator` keeps the quickest packet of each second of the last minute, and puts under these the
highest line that lies above none. The slope of the line is the drift.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

#: Seconds by which a packet may be quicker than the quickest before it. If it is more, a clock was set.
EARLIER = 0.1
#: The most that two clocks drift apart, as a fraction: Linux adjusts its own by up to 500 ppm, and a crystal is within
#: 100 ppm.
_MOST_DRIFT = 600e-6
#: How far the drift may be another one before and after the minute in which it was measured. Chosen: a crystal changes
#: by about 0.04 ppm/K² away from 25 degC.
_WANDER = 2e-6
#: Seconds of which the quickest packet is kept, how many of these, and between two looks at a packet.
_SECONDS, _MOST, _STEP = 1.0, 60, 0.04
#: Packets of which the quickest counts.
_LEAST = 8
#: Of n packets with delays of mean J, the quickest is later than 7 J / n in one of a thousand cases, if the delays are
#: exponential or uniform.
_RARE = 7.0

_Point = tuple[float, float]


class OffsetEstimate(NamedTuple):
    """How two clocks go beside each other.

    Attributes:
        moment: s on the peer's clock to which the others belong.
        way: s from there to the arrival of the quickest packet on this computer's clock; both clocks run from another
            zero, so only its change means anything.
        slope: s by which `way` grows in a second of the peer.
        error: s by which the quickest packets may have been slower than those that could have come.
        unsure: by how much `slope` may be off.
        round_trip: s of the quickest handshake; the quickest packet took no more.
    """

    moment: float
    way: float
    slope: float
    error: float
    unsure: float
    round_trip: float

    def to_local(self, time: float, latency: float = 0.0) -> float:
        """Monotonic s of this computer at a time of the peer.

        Args:
            time: s on the peer's clock.
            latency: s that the peer may take from the time in a packet until it sends it.
        """
        return time + self.way + self.slope * (time - self.moment) - self._half(latency)

    def to_peer(self, time: float, latency: float = 0.0) -> float:
        """s on the peer's clock at monotonic s of this computer; `to_local` the other way."""
        zero = self.to_local(self.moment, latency)
        return self.moment + (time - zero) / (1.0 + self.slope)

    def bound(self, time: float, latency: float = 0.0) -> float:
        """s by which both may be off at a time of the peer."""
        unmeasured = math.inf if math.isinf(self.round_trip) else self._half(latency)
        return unmeasured + self.error + self.unsure * abs(time - self.moment)

    def _half(self, latency: float) -> float:
        """s by which the quickest packet is taken to be later than its time: half of what it can be at most."""
        return 0.5 * (latency if math.isinf(self.round_trip) else self.round_trip + latency)


class _Second(NamedTuple):
    """The packets of about a second: time and delay of the quickest, how many there are, and their mean delay."""

    moment: float
    way: float
    packets: int
    mean: float

    @property
    def lucky(self) -> float:
        """Seconds by which the quickest may be slower than one that was not held up at all."""
        return _RARE * (self.mean - self.way) / self.packets

    def and_one(self, moment: float, way: float) -> _Second:
        packets = self.packets + 1
        quickest = (moment, way) if way <= self.way else (self.moment, self.way)
        return _Second(*quickest, packets, self.mean + (way - self.mean) / packets)


_EMPTY = _Second(math.nan, math.inf, 0, 0.0)


class OffsetEstimator:
    """Estimates the offset between the clock of a peer and this computer's, over all connections to the peer.

    One thread, the one that reads, writes it.

    Attributes:
        due: when the next packet is to be looked at, by `linkcore.clock.now`.
        restarts: how often the peer's clock has begun again, or was set.
    """

    def __init__(self) -> None:
        self.due = 0.0
        self.restarts = 0
        # Those that are over, and the present one. Replaced as a whole, so that other threads can read them.
        self._seconds: tuple[_Second, ...] = ()
        self._present = _EMPTY
        self._until = -math.inf
        self._round_trip = math.inf
        #: of the newest packet; and the way below which a packet has a wrong time
        self._last, self._floor = -math.inf, -math.inf
        self._suspect: tuple[float, float] | None = None
        #: of the present connection no packet has shown yet that its clock is that of the last one
        self._is_new = False
        self._known: tuple[object, object, OffsetEstimate | None] = (None, None, None)

    def connected(self, round_trip: float) -> None:
        """A connection was made, by a handshake of so many seconds; `inf` where there was none."""
        self._close_second()
        self._round_trip = min(self._round_trip, round_trip)
        self._is_new, self._suspect, self._floor = True, None, -math.inf
        self.due = 0.0

    def take(self, moment: float, arrival: float) -> None:
        """A packet has come.

        Args:
            moment: its time by the peer's clock, s; NaN where it has none.
            arrival: by this computer's, monotonic s.
        """
        way = arrival - moment
        if not (moment >= self._last and way >= self._floor) and not self._is_another(moment, way):
            self.due = 0.0
            return
        self._last, self._suspect = moment, None
        if not self._present.packets:
            self._until = moment + _SECONDS
        self._present = self._present.and_one(moment, way)
        if self._present.packets >= _LEAST:
            if self._is_new:
                self._recognise()
            if moment >= self._until:
                self._close_second()
        # Each packet, until there are some of which the quickest counts.
        self.due = arrival + _STEP if self._seconds and not self._is_new else 0.0

    def _is_another(self, moment: float, way: float) -> bool:
        """Whether it is the second packet by a clock that is not the one before. One alone may have a wrong time."""
        suspect = self._suspect
        if not math.isfinite(way):
            return False
        self._suspect = moment, way
        if suspect is None or moment < suspect[0] or abs(way - suspect[1]) > EARLIER:
            return False
        self._restart()
        self._present = _EMPTY
        return True

    def _recognise(self) -> None:
        """Whether the clock of a new connection goes on where the last one was, or the peer was off meanwhile."""
        self._is_new = False
        if self._seconds:
            last, present = self._seconds[-1], self._present
            most = EARLIER + _MOST_DRIFT * (present.moment - last.moment)
            if not -most <= present.way - last.way <= most + min(self._round_trip, 1.0):
                self._restart()
        self._set_floor()

    def _set_floor(self) -> None:
        lowest = min([each.way for each in self._seconds], default=math.inf)
        self._floor = min(lowest, self._present.way) - EARLIER - _MOST_DRIFT * _MOST

    def _restart(self) -> None:
        self.restarts += 1
        self._seconds = ()
        self._floor = -math.inf

    def _close_second(self) -> None:
        if self._present.packets >= _LEAST:
            self._seconds = (*self._seconds[1 - _MOST :], self._present)
            self._set_floor()
        self._present = _EMPTY

    # -- from any thread -----------------------------------------------------------------------------

    @property
    def relation(self) -> OffsetEstimate | None:
        """How both clocks go; None before the first packet with a time."""
        seconds, present = self._seconds, self._present
        is_counted = present.packets >= _LEAST and not self._is_new
        if not seconds:
            if not present.packets:
                return None
            # The packets of the first second show no drift.
            error = present.lucky if present.packets >= _LEAST else math.inf
            return OffsetEstimate(present.moment, present.way, 0.0, error, _MOST_DRIFT, self._round_trip)
        newest = present if is_counted else _EMPTY
        known = self._known
        if known[2] is None or known[0] is not seconds or known[1] is not newest:
            relation = _line((*seconds, newest) if is_counted else seconds, self._round_trip)
            self._known = known = (seconds, newest, relation)
        return known[2]


def _line(seconds: Sequence[_Second], round_trip: float) -> OffsetEstimate:
    """The highest line below the quickest packets: highest in the middle of their time."""
    middle = 0.5 * (seconds[0].moment + seconds[-1].moment)
    points = [(each.moment - middle, each.way) for each in seconds]
    slope = 0.0
    if len(points) > 1:
        (x1, y1), (x2, y2) = lowest_edge(points, 0.0)
        slope = min(max((y2 - y1) / (x2 - x1), -_MOST_DRIFT), _MOST_DRIFT)
    heights = [way - slope * moment for moment, way in points]
    way = min(heights)
    error = 2.0 * _median(height - way for height in heights) + _median(each.lucky for each in seconds)
    span = seconds[-1].moment - seconds[0].moment
    unsure = min(2.0 * error / span + _WANDER, _MOST_DRIFT) if span > 0.0 else _MOST_DRIFT
    return OffsetEstimate(middle, way, slope, error, unsure, round_trip)


def lowest_edge(points: Iterable[_Point], at: float) -> tuple[_Point, _Point]:
    """The edge of the lower hull of two or more points with increasing x, where x is `at`: none is below its line."""
    hull: list[_Point] = []
    for x, y in points:
        while len(hull) > 1:
            (x1, y1), (x2, y2) = hull[-2:]
            if (y2 - y1) * (x - x2) < (y - y2) * (x2 - x1):
                break
            hull.pop()
        hull.append((x, y))
    return next(((one, other) for one, other in itertools.pairwise(hull) if other[0] >= at), (hull[0], hull[-1]))


def _median(values: Iterable[float]) -> float:
    ordered = sorted(values)
    return ordered[len(ordered) // 2]

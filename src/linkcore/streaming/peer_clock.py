"""Comparison of a peer's clock with the clock of this computer, based on times in packets and arrival times.

A packet contains the time of the peer at which the packet was made, and arrives later. The delay of a packet is
unknown, but it has two limits. It cannot be negative. And the delay of the quickest of many packets is not longer than
the handshake of the TCP connection, which is a round trip. So the quickest packets show the relation of both clocks,
with an uncertainty of this round trip. `OffsetEstimator` keeps the quickest packet of each second of the last minute.
It computes the highest line that is not above any of these packets. The slope of this line is the drift.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

#: Seconds by which a packet may be quicker than the quickest earlier packet. If a packet is even quicker, one of the
#: clocks was probably set.
EARLIER = 0.1
#: Maximum drift between two clocks, as a fraction: Linux adjusts its clock by up to 500 ppm, and a crystal is within
#: 100 ppm.
_MOST_DRIFT = 600e-6
#: Assumed difference, as a fraction, between the measured drift and the drift before or after the measured minute. The
#: value is chosen: the frequency of a crystal changes by about 0.04 ppm/K² away from 25 degC.
_WANDER = 2e-6
#: Length in s of the interval of which the quickest packet is kept, maximum number of these intervals, and time in s
#: between two packets that are examined.
_SECONDS, _MOST, _STEP = 1.0, 60, 0.04
#: Minimum number of packets of which the quickest one is used.
_LEAST = 8
#: If n packets have exponential or uniform delays with the mean J, the quickest of them is later than 7 J / n in one of
#: a thousand cases.
_RARE = 7.0

_Point = tuple[float, float]


class OffsetEstimate(NamedTuple):
    """Relation between the clock of a peer and the clock of this computer.

    Attributes:
        moment: Time on the peer's clock for which the other values are valid, in s.
        way: Arrival time of the quickest packet on this computer's clock minus `moment`, in s. The two clocks have
            different zero points, so only changes of `way` are meaningful.
        slope: Growth of `way` per second of the peer.
        error: Seconds by which the quickest packets might have been slower than the quickest possible packets.
        unsure: Maximum error of `slope`.
        round_trip: Duration of the quickest handshake, in s. The quickest packet took no longer.
    """

    moment: float
    way: float
    slope: float
    error: float
    unsure: float
    round_trip: float

    def to_local(self, time: float, latency: float = 0.0) -> float:
        """Return the monotonic time of this computer at a time of the peer, in s.

        Args:
            time: Time on the peer's clock, in s.
            latency: Maximum seconds from the time in a packet until the peer sends the packet.
        """
        return time + self.way + self.slope * (time - self.moment) - self._half(latency)

    def to_peer(self, time: float, latency: float = 0.0) -> float:
        """Return the time on the peer's clock at a monotonic time of this computer, in s: the inverse of `to_local`."""
        zero = self.to_local(self.moment, latency)
        return self.moment + (time - zero) / (1.0 + self.slope)

    def bound(self, time: float, latency: float = 0.0) -> float:
        """Return the maximum error of `to_local` and `to_peer` at a time of the peer, in s."""
        unmeasured = math.inf if math.isinf(self.round_trip) else self._half(latency)
        return unmeasured + self.error + self.unsure * abs(time - self.moment)

    def _half(self, latency: float) -> float:
        """Return the assumed delay of the quickest packet in s, which is half of its maximum delay."""
        return 0.5 * (latency if math.isinf(self.round_trip) else self.round_trip + latency)


class _Second(NamedTuple):
    """Packets of about one second: time and delay of the quickest packet, number of packets, and mean delay."""

    moment: float
    way: float
    packets: int
    mean: float

    @property
    def lucky(self) -> float:
        """Seconds by which the quickest packet might be slower than a packet without any extra delay."""
        return _RARE * (self.mean - self.way) / self.packets

    def and_one(self, moment: float, way: float) -> _Second:
        packets = self.packets + 1
        quickest = (moment, way) if way <= self.way else (self.moment, self.way)
        return _Second(*quickest, packets, self.mean + (way - self.mean) / packets)


_EMPTY = _Second(math.nan, math.inf, 0, 0.0)


class OffsetEstimator:
    """Estimator of the offset between the clocks of a peer and of this computer, over all connections to the peer.

    Only the thread that reads the stream changes it.

    Attributes:
        due: Time of `linkcore.clock.now` from which the next packet is examined.
        restarts: Number of times that the peer's clock has started again, or was set.
    """

    def __init__(self) -> None:
        self.due = 0.0
        self.restarts = 0
        # The completed seconds, and the current one. Both are replaced as a whole, so that other threads can read them.
        self._seconds: tuple[_Second, ...] = ()
        self._present = _EMPTY
        self._until = -math.inf
        self._round_trip = math.inf
        #: Time of the newest packet, and the smallest plausible `way`; a packet below it has a wrong time.
        self._last, self._floor = -math.inf, -math.inf
        self._suspect: tuple[float, float] | None = None
        #: True until it is known whether the current connection has the same clock as the previous one.
        self._is_new = False
        self._known: tuple[object, object, OffsetEstimate | None] = (None, None, None)

    def connected(self, round_trip: float) -> None:
        """Record a new connection.

        Args:
            round_trip: Duration of its handshake in s; `inf` if there was no handshake.
        """
        self._close_second()
        self._round_trip = min(self._round_trip, round_trip)
        self._is_new, self._suspect, self._floor = True, None, -math.inf
        self.due = 0.0

    def take(self, moment: float, arrival: float) -> None:
        """Use a received packet.

        Args:
            moment: Time of the packet on the peer's clock, in s; NaN if it has none.
            arrival: Time of its arrival on this computer's monotonic clock, in s.
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
        # Every packet is examined until there are enough packets to use the quickest one.
        self.due = arrival + _STEP if self._seconds and not self._is_new else 0.0

    def _is_another(self, moment: float, way: float) -> bool:
        """Whether this is the second packet in a row that shows a different clock.

        A single such packet might have a wrong time.
        """
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
        """Check whether the clock of a new connection continues the previous one.

        If it does not, for example because the peer was switched off meanwhile, restart the estimate.
        """
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
        """Relation of both clocks; None before the first packet with a time."""
        seconds, present = self._seconds, self._present
        is_counted = present.packets >= _LEAST and not self._is_new
        if not seconds:
            if not present.packets:
                return None
            # The drift cannot be estimated from the packets of the first second.
            error = present.lucky if present.packets >= _LEAST else math.inf
            return OffsetEstimate(present.moment, present.way, 0.0, error, _MOST_DRIFT, self._round_trip)
        newest = present if is_counted else _EMPTY
        known = self._known
        if known[2] is None or known[0] is not seconds or known[1] is not newest:
            relation = _line((*seconds, newest) if is_counted else seconds, self._round_trip)
            self._known = known = (seconds, newest, relation)
        return known[2]


def _line(seconds: Sequence[_Second], round_trip: float) -> OffsetEstimate:
    """Return the line below the quickest packets that is the highest in the middle of their time."""
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
    """Return the edge of the lower convex hull at x = `at`.

    No point is below the line through this edge.

    Args:
        points: Two or more points (x, y) with increasing x.
        at: x coordinate.
    """
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

"""Conversion between a controller's clock and this computer's clock, for other sensors and for simultaneous actions.

The measurement is in `linkcore.streaming.peer_clock`. No packet shows the delay between the time in a state and the
moment when the controller sends the state. This delay is assumed to be one cycle (`state_latency`).
"""

from __future__ import annotations

from linkcore import clock
from linkcore.names import StrictAttributes
from linkcore.streaming.peer_clock import OffsetEstimate, OffsetEstimator
from linkcore.streaming.stream import Stream

from ..arm.parameters import number
from ..protocol.realtime.packets import RealtimeState
from .identity import KnownIdentity


class RobotClock(StrictAttributes):
    """Relation between a controller's clock and this computer's monotonic clock; made by `Robot.clock`.

    The controller's clock counts seconds since the controller was started: `RealtimeState.time`, and ``timestamp`` in
    RTDE. This computer's clock is `linkcore.clock.now`, which is also used for `state.received.monotonic`. On Linux, it
    equals `time.monotonic` until this computer is suspended for the first time. All members wait for the first state if
    none has arrived yet, and raise `LinkTimeout` if none arrives.
    """

    def __init__(self, stream: Stream[RealtimeState], who: KnownIdentity) -> None:
        self._stream = stream
        self._who = who

    def to_local(self, time: float) -> float:
        """Convert a time of the controller to this computer's monotonic time, both in seconds.

        The maximum error is `bound`, which grows with the distance of the time from the last minute. Times before a
        restart of the controller cannot be converted.
        """
        return self._relation().to_local(time, self._latency)

    def to_controller(self, time: float) -> float:
        """Convert a monotonic time of this computer to a time of the controller, in seconds. Inverse of `to_local`."""
        return self._relation().to_peer(time, self._latency)

    @property
    def offset(self) -> float:
        """Current time of the controller's clock minus the current time of this computer's clock, in seconds."""
        now = clock.now()
        return self.to_controller(now) - now

    @property
    def drift(self) -> float:
        """Relative rate by which the controller's clock is faster than this computer's clock: 1e-4 is 100 ppm."""
        return -self._relation().slope / (1.0 + self._relation().slope)

    @property
    def bound(self) -> float:
        """Maximum error when converting the current time, in seconds.

        It is `inf` until eight states have arrived, and for a recording. It assumes that the fastest state of each
        second took no longer to arrive than the handshake of its connection plus one cycle of the controller. Half of
        that time makes up nearly all of the bound.
        """
        relation = self._relation()
        latency = self._latency
        return relation.bound(relation.to_peer(clock.now(), latency), latency)

    @property
    def restarts(self) -> int:
        """Number of times that the controller's clock was reset, for example because the controller restarted."""
        return self._peer.restarts

    @property
    def _peer(self) -> OffsetEstimator:
        return self._stream._connection.counters.clock_offset

    @property
    def _latency(self) -> float:
        return number("state_latency") / self._who.last.firmware.rate

    def _relation(self) -> OffsetEstimate:
        relation = self._peer.relation
        while relation is None:
            self._stream.wait()
            relation = self._peer.relation
        return relation

    def __repr__(self) -> str:
        relation = self._peer.relation
        if relation is None:
            return "<RobotClock: no state has arrived>"
        return f"<RobotClock: {self.offset:+.4f} s, {1e6 * self.drift:+.0f} ppm, within {1e3 * self.bound:.1f} ms>"

"""A controller's clock compared with this computer's: for data of other sensors, and for simultaneous events.

What is measured, and how, is `linkcore.streaming.peer_clock`. What no packet shows is how long a controller takes from
the time in a state until it sends it; that it is one cycle is a guess (`state_latency`).
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
    """The clock of a controller, and this computer's monotonic clock; made by `Robot.clock`.

    The controller's is that of `RealtimeState.time`, and of ``timestamp`` in RTDE: seconds since it was started. This
    computer's is `linkcore.clock.now`, which `state.received.monotonic` has too. On Linux it equals `time.monotonic`
    until this computer is suspended for the first time. All of these wait for the first state, if none has come yet,
    and raise `LinkTimeout` if none does.
    """

    def __init__(self, stream: Stream[RealtimeState], who: KnownIdentity) -> None:
        self._stream = stream
        self._who = who

    def to_local(self, time: float) -> float:
        """The monotonic time of this computer, s, at a time of the controller, s.

        It is right within `bound`, which grows with the distance of that time from the last minute. A time from before
        a restart of the controller means nothing.
        """
        return self._relation().to_local(time, self._latency)

    def to_controller(self, time: float) -> float:
        """The time of the controller, s, at a monotonic time of this computer, s; `to_local` is the inverse."""
        return self._relation().to_peer(time, self._latency)

    @property
    def offset(self) -> float:
        """Seconds by which the controller's clock is ahead of this computer's, now."""
        now = clock.now()
        return self.to_controller(now) - now

    @property
    def drift(self) -> float:
        """How much faster than this computer's clock that of the controller goes: 1e-4 is 100 ppm."""
        return -self._relation().slope / (1.0 + self._relation().slope)

    @property
    def bound(self) -> float:
        """Seconds within which the conversion of a time of now is right; `inf` until eight states have come, and in a
        recording.

        It holds if the quickest state of a second took no longer to come than the handshake of its connection, and a
        cycle of the controller before that. Half of that time is nearly all of the bound.
        """
        relation = self._relation()
        latency = self._latency
        return relation.bound(relation.to_peer(clock.now(), latency), latency)

    @property
    def restarts(self) -> int:
        """How often the controller's clock has begun again, as it does when a controller is started again."""
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
            return "<RobotClock: no state has come>"
        return f"<RobotClock: {self.offset:+.4f} s, {1e6 * self.drift:+.0f} ppm, within {1e3 * self.bound:.1f} ms>"

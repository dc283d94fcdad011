"""Cost of `robot.clock` in the receive path, and cost of a conversion.

Real-time packets of an e-Series go through a receiver with the stamps of 500 Hz. It takes turns with a receiver whose
clock is never used. The run is long enough to fill the last minute of the clock.

    python benchmarks/peer_clock.py
    python benchmarks/peer_clock.py --quick    # a quarter of the rounds
"""

from __future__ import annotations

import argparse
import math
import time

import numpy as np

from linkcore.clock import Stamp
from linkcore.streaming.receiver import Receiver
from linkcore.streaming.statistics import StreamCounters
from urlink.packets import RealtimeState
from urlink.protocol.realtime.protocol import RealtimeProtocol

#: Packets per second, and packets per turn.
RATE, TURN = 500, 1000


class Path:
    """A receiver, and its time for a packet."""

    def __init__(self, *, is_looked_at: bool) -> None:
        protocol = RealtimeProtocol()
        self.counters = StreamCounters()
        self.counters.connected(protocol, 1e-4)
        self._receiver = Receiver("realtime", protocol, self.counters)
        self._is_looked_at = is_looked_at

    def run(self, packets: list[bytes], began: float) -> float:
        """Return the processor time, in s, for one of these packets."""
        stamps = [Stamp(began + i / RATE, 0.0) for i in range(len(packets))]
        if not self._is_looked_at:
            self.counters.clock_offset.due = math.inf
        begun = time.process_time()
        for packet, stamp in zip(packets, stamps, strict=True):
            self._receiver.feed(packet, stamp)
        return (time.process_time() - begun) / len(packets)


def turn_of(number: int) -> list[bytes]:
    """Return the packets of one turn, with their times."""
    return [bytes(RealtimeState("5.10", time=(number * TURN + i) / RATE)) for i in range(TURN)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="a quarter of the rounds")
    options = parser.parse_args()
    with_clock, without = paths = Path(is_looked_at=True), Path(is_looked_at=False)
    costs: dict[Path, list[float]] = {path: [] for path in paths}
    begins = time.monotonic()
    for number in range(35 if options.quick else 140):
        packets = turn_of(number)
        for path in paths if number % 2 else paths[::-1]:
            costs[path].append(path.run(packets, begins + number * TURN / RATE))
    clocked, bare = (float(np.median(costs[path])) for path in (with_clock, without))
    relation = with_clock.counters.clock_offset.relation
    assert relation is not None
    assert relation.bound(number * TURN / RATE) < 1e-3
    assert without.counters.clock_offset.relation is None
    begun = time.process_time()
    for _ in range(10_000):
        relation = with_clock.counters.clock_offset.relation
        assert relation is not None
        relation.to_peer(begins)
    conversion = (time.process_time() - begun) / 10_000
    ratio = clocked / bare
    print(
        f"a real-time packet to a state, with the clock: {clocked * 1e6:.2f} us, {ratio:.3f} times the time without it"
    )
    print(f"a time of this computer to one of the controller: {conversion * 1e6:.2f} us")


if __name__ == "__main__":
    main()

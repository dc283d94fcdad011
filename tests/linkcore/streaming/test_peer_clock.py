"""Clock of a peer: conversions are correct within their bound, whatever delays the packets have."""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from functools import partial

import pytest

from linkcore.streaming.peer_clock import OffsetEstimator

#: Interval between packets, in s.
PERIOD = 0.002

DELAYS: dict[str, Callable[[random.Random], float]] = {
    "none": lambda chance: 0.0,
    "uniform": lambda chance: chance.uniform(0.0, 0.002),
    "exponential": lambda chance: chance.expovariate(1 / 0.001),
    "with long ones": lambda chance: 0.0001 * chance.paretovariate(1.2),
    "bursts": lambda chance: 0.03 * chance.random() ** 8,
}


class Wire:
    """Peer with a known clock, and the arrivals of its packets."""

    def __init__(self, seed: int, delay: Callable[[random.Random], float]) -> None:
        self.chance = chance = random.Random(seed)
        self.delay = delay
        self.drift = chance.uniform(-100e-6, 100e-6)
        self.there, self.back = chance.uniform(5e-5, 5e-4), chance.uniform(5e-5, 5e-4)
        #: Local monotonic time, in s, at time 0 of the peer.
        self.zero = chance.uniform(-1e5, 1e5)
        self.clock = OffsetEstimator()
        self.time = chance.uniform(0.0, 1e6)

    def local(self, time: float) -> float:
        return self.zero + time / (1.0 + self.drift)

    def connect(self) -> None:
        self.clock.connected(self.there + self.back + self.delay(self.chance) + self.delay(self.chance))

    def run(self, seconds: float) -> tuple[int, int]:
        """Return the number of checks, and the number of conversions outside their bound."""
        wrong = looks = 0
        arrival = -math.inf
        until = self.time + seconds
        while self.time < until:
            self.time += PERIOD
            # Packets do not overtake each other.
            arrival = max(arrival, self.local(self.time) + self.back + self.delay(self.chance))
            if arrival >= self.clock.due:
                self.clock.take(self.time, arrival)
                relation = self.clock.relation
                if relation is not None and self.chance.random() < 0.1:
                    looks += 1
                    ahead = self.chance.uniform(-1.0, 1.0)
                    time = self.time + ahead
                    off = relation.to_local(time) - self.local(time)
                    wrong += abs(off) > relation.bound(time)
                    there_and_back = relation.to_peer(relation.to_local(time))
                    assert there_and_back == pytest.approx(time, abs=1e-6)
        return looks, wrong


@pytest.mark.slow
@pytest.mark.parametrize("kind", DELAYS)
def test_clock_conversions_are_correct_within_the_bound(kind: str) -> None:
    looks = wrong = 0
    for seed in range(12):
        wire = Wire(seed, DELAYS[kind])
        for connected in (0.5, 20.0, 3.0, 40.0):
            wire.connect()
            found = wire.run(connected)
            looks, wrong = looks + found[0], wrong + found[1]
            wire.time += wire.chance.choice([0.1, 2.0, 30.0])
        assert wire.clock.restarts == 0
    assert looks > 1500
    assert wrong <= 0.001 * looks


@pytest.mark.parametrize("kind", ["none", "uniform", "exponential"])
def test_clock_error_bound_is_about_half_of_the_round_trip(kind: str) -> None:
    wire = Wire(1, DELAYS[kind])
    wire.connect()
    wire.run(30.0)
    relation = wire.clock.relation
    assert relation is not None
    assert relation.bound(wire.time) < 0.5 * relation.round_trip + 1.2e-3
    assert -relation.slope / (1.0 + relation.slope) == pytest.approx(wire.drift, abs=2e-5)


def test_clock_bound_is_infinite_before_enough_packets() -> None:
    clock = OffsetEstimator()
    assert [clock.relation] == [None]
    clock.connected(1e-4)
    clock.take(5.0, 105.0)
    assert clock.relation is not None
    assert clock.relation.bound(5.0) == math.inf
    clock.take(math.nan, 106.0)
    assert clock.relation.to_local(5.0) == pytest.approx(105.0, abs=1e-3)


def test_clock_bound_is_infinite_without_a_handshake() -> None:
    wire = Wire(2, DELAYS["none"])
    wire.clock.connected(math.inf)
    wire.run(3.0)
    relation = wire.clock.relation
    assert relation is not None
    assert relation.bound(wire.time) == math.inf
    assert relation.to_local(wire.time) == pytest.approx(wire.local(wire.time) + wire.back)


@pytest.mark.parametrize("uptime", [0.1, 30.0, 1e4])
def test_restart_of_the_peer_is_detected(uptime: float) -> None:
    """The restart is detected even if the uptime is larger than before and the peer was away for hours."""
    wire = Wire(3, DELAYS["uniform"])
    wire.time = 5.0
    wire.connect()
    wire.run(10.0)
    was, away = wire.local(wire.time), 40.0 + 2.0 * uptime
    wire.time, wire.zero = uptime, was + away - uptime
    wire.connect()
    looks, wrong = wire.run(5.0)
    assert wire.clock.restarts == 1
    assert looks > 10
    assert wrong <= 1  # the first packets may still be attributed to the old clock


def test_single_packet_with_a_wrong_time_is_not_a_restart() -> None:
    wire = Wire(4, DELAYS["none"])
    wire.connect()
    wire.run(3.0)
    wire.clock.due = 0.0
    wire.clock.take(1e-230, wire.local(wire.time))
    wire.clock.take(wire.time + 50.0, wire.local(wire.time))
    assert wire.run(3.0)[1] == 0
    assert wire.clock.restarts == 0


def late_by(seconds: float, chance: random.Random) -> float:
    return seconds


def test_late_packets_do_not_count_as_a_restart_of_the_peer() -> None:
    wire = Wire(5, DELAYS["uniform"])
    wire.connect()
    wire.run(20.0)
    for late in (3.0, 2.0, 1.5, 1.0, 0.5, 0.3):
        wire.delay = partial(late_by, late)
        assert wire.run(0.5)[1] == 0
    wire.delay = lambda chance: 0.2 + chance.uniform(0.0, 0.02)
    looks, wrong = wire.run(5.0)
    assert (wrong, wire.clock.restarts) == (0, 0)
    assert looks > 5

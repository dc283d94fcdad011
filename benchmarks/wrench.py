"""Processor time of a compensated state, compared with a plain state: received, framed and decoded, and its force read.

Both run in this process, one after the other, on the same bytes. A plain state is decoded, and the force and the pose
of its tool are read. A compensated state also computes the wrench and reads its force.

python benchmarks/wrench.py
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

from _simulated import simulated

import urlink
from urlink.arm.arm_file import Estimate
from urlink.motion import MeasuredPayload, WrenchStream
from urlink.packets import RealtimeState

#: Largest accepted ratio.
LIMIT = 1.2


def payload() -> MeasuredPayload:
    """Return a measured payload with plain numbers."""

    def of(value: float) -> Estimate:
        return Estimate(value, value - 0.1, value + 0.1)

    offset = tuple(map(of, (10.0, -20.0, 70.0, 0.1, -0.2, 0.3)))
    return MeasuredPayload(
        of(1.8), (of(0.01), of(-0.02), of(0.06)), offset, "sensor", 8, (1.0, 0.1), (0.5, 0.0, 0.0, 0.05), (0, 0, 9.82)
    )


def seconds_for(robot: urlink.Robot, count: int, use: Callable[[RealtimeState], object]) -> float:
    """Return the processor time of this process for each state that a loop over the stream receives, in s."""
    states = iter(robot.realtime)
    next(states)
    begun = time.process_time()
    for _ in range(count):
        use(next(states))
    return (time.process_time() - begun) / count


def measure(quick: bool) -> tuple[float, float]:
    """Return the processor time of a plain and of a compensated state, in s; the medians of alternating rounds."""
    with simulated("UR5e", "5.11") as address, urlink.connect(address, read_only=True) as robot:
        wrenches = WrenchStream(robot.realtime, robot.kinematics, payload())
        rounds = []
        for _ in range(5 if quick else 15):
            plain = seconds_for(robot, 400, lambda state: state.tcp_force[2])
            compensated = seconds_for(robot, 400, lambda state: wrenches.compensate(state).force[2])
            rounds.append((plain, compensated))
    plains, compensateds = (sorted(each) for each in zip(*rounds, strict=True))
    return plains[len(plains) // 2], compensateds[len(compensateds) // 2]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="run a third of the rounds")
    options = parser.parse_args()
    plain, compensated = measure(options.quick)
    ratio = compensated / plain
    verdict = "ok" if ratio <= LIMIT else "TOO MUCH"
    print(f"plain {plain * 1e6:.1f} us, compensated {compensated * 1e6:.1f} us a state: {ratio:.2f} times, {verdict}")
    raise SystemExit(ratio > LIMIT)


if __name__ == "__main__":
    main()

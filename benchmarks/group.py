"""Time difference between two arms of a group, over many starts, in simulated time.

Two controllers run on separate computers, whose clocks differ by up to 200 ppm, with 0.3 to 0.8 ms for each direction
of the network. Both turn wrist 3 forth and back. The time at which each arm was at a position is calculated from its
reports and the true time. With `--load`, this computer stops once during each motion, for up to this number of ms. With
`--reconnects`, all connections of one arm are reset before every tenth start.

    python benchmarks/group.py                               # 100 starts
    python benchmarks/group.py --quick                       # 6 starts
    python benchmarks/group.py --firmware 3.15               # of the second arm
    python benchmarks/group.py --starts 1000 --load 20 --reconnects
    python benchmarks/group.py --streams                     # points that the robots buffer, instead of set-points
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence

import numpy as np

import urlink
from urlink import Trajectory
from urlink.arm.vectors import FloatArray
from urlink.simulator import Controller

#: Angle of each motion, in rad, and its duration, in s.
WAY, SECONDS = 0.3, 0.3


class Side:
    """One arm and its computer."""

    def __init__(self, sim: urlink.Simulation, host: str, firmware: str) -> None:
        self.sim, self.host = sim, host
        self.rate = 500.0 if firmware[0] == "5" else 125.0
        self.computer = sim.computer(host.replace(".", "-"), host)
        self.computer.rate = 1.0 + sim.random.uniform(-1e-4, 1e-4)
        with sim.on(self.computer):
            time.sleep(sim.random.uniform(0.0, 0.01))
            model = "UR5e" if firmware[0] == "5" else "UR5"
            self.controller = Controller(model, firmware, host=host, ports="standard").start()
        self.robot = urlink.connect(host)
        #: time by its clock, and position of wrist 3 in rad
        self.rows: list[tuple[float, float]] = []
        self.robot.realtime.subscribe(self._hear, inline=True)

    def _hear(self, state: urlink.RealtimeState) -> None:
        self.rows.append((state.time, float(state.q_target[5])))

    def true(self) -> tuple[float, float]:
        """Return the time of the simulation, and the time of this computer's clock."""
        server, state = self.controller._server, self.controller._state
        assert server is not None
        with self.sim.on(self.computer):
            cycles = (time.monotonic() - server._epoch) * self.rate + server._first
        return self.sim.now, (cycles - (state.cycle - state.uptime)) / self.rate

    def reset(self) -> None:
        """Reset all its connections, and connect again."""
        self.sim.network.reset(self.sim.here, self.computer)
        time.sleep(0.1)
        self.robot.realtime.wait(timeout=10.0)
        self.robot.safety.wait_until_clear(timeout=10.0)
        time.sleep(1.0)

    def way(self, began: tuple[float, float], start: float) -> tuple[FloatArray, FloatArray]:
        """Return true times, and the completed fraction of the motion at each of them."""
        (sim_began, own_began), (sim_ended, own_ended) = began, self.true()
        rows = np.array(self.rows)
        times = sim_began + (rows[:, 0] - own_began) * (sim_ended - sim_began) / (own_ended - own_began)
        return times, np.abs(rows[:, 1] - start) / WAY

    def close(self) -> None:
        self.robot.close()
        with self.sim.on(self.computer):
            self.controller.close()


def apart(one: tuple[FloatArray, FloatArray], other: tuple[FloatArray, FloatArray]) -> FloatArray:
    """Return the time difference in s at each position that the first arm reported.

    Positions near the ends of the motion are left out, because both arms are at rest there.
    """
    (when, part), (other_when, other_part) = one, other
    inside, other_inside = (part > 0.1) & (part < 0.9), (other_part > 0.05) & (other_part < 0.95)
    return np.interp(part[inside], other_part[other_inside], other_when[other_inside]) - when[inside]


def turn(group: urlink.Group, goals: Sequence[FloatArray], *, streams: bool, under_way: Callable[[], object]) -> None:
    """Turn to the goals, by set-points or by buffered points.

    `under_way` is called when the motion has started.
    """
    if not streams:
        motion = group.move_joints(goals, time=SECONDS)
        under_way()
        motion.wait()
        return
    rest = np.zeros((2, 6))
    here = [robot.realtime.wait().q_target for robot in group.robots]
    with group.stream() as stream:
        paths = [Trajectory.from_arrays([0.0, SECONDS], each, rest, rest) for each in zip(here, goals, strict=True)]
        stream.append(paths, wait=False)
        under_way()
        stream.wait_until_dry()


def measure(
    seed: int,
    starts: int,
    firmware: str,
    load: float = 0.0,
    *,
    reconnects: bool = False,
    streams: bool = False,
) -> tuple[list[float], list[float]]:
    """Return the median and the largest time difference of each start, in s.

    Args:
        load: Maximum time, in s, for which this computer stops during each motion.
        reconnects: Whether connections are reset before every tenth start.
        streams: Whether streams are used instead of followed trajectories.
    """
    medians, most = [], []
    with urlink.simulated_time(seed, latency=3e-4, jitter=5e-4) as sim:
        sides = [Side(sim, "192.168.0.100", "5.11"), Side(sim, "192.168.0.101", firmware)]
        group = urlink.Group(*(side.robot for side in sides))
        time.sleep(1.0)

        def hold() -> None:
            began = sim.now + sim.random.uniform(0.05, 0.35)
            sim.at(began, sim.here.hold)
            sim.at(began + sim.random.uniform(0.0, load), sim.here.release)

        for number in range(starts):
            if reconnects and number % 10 == 9:
                sides[number // 10 % 2].reset()
            here = [side.robot.realtime.wait().q_target for side in sides]
            goals = [q + np.array([0, 0, 0, 0, 0, -WAY if number % 2 else WAY]) for q in here]
            for side in sides:
                side.rows.clear()
            began = [side.true() for side in sides]
            turn(group, goals, streams=streams, under_way=hold)
            one, other = (side.way(marked, float(q[5])) for side, marked, q in zip(sides, began, here, strict=True))
            seconds = np.abs(apart(one, other))
            medians.append(float(np.median(seconds)))
            most.append(float(seconds.max()))
            time.sleep(sim.random.uniform(0.0, 0.05))
        for side in sides:
            side.close()
    return medians, most


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="6 starts")
    parser.add_argument("--starts", type=int, default=100)
    parser.add_argument("--firmware", default="5.11", help="firmware of the second arm")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--load", type=float, default=0.0, help="maximum time for which this computer stops, ms")
    parser.add_argument("--reconnects", action="store_true", help="reset the connections before every tenth start")
    parser.add_argument("--streams", action="store_true", help="use streams instead of followed trajectories")
    options = parser.parse_args()
    starts = 6 if options.quick else options.starts
    medians, most = measure(
        options.seed,
        starts,
        options.firmware,
        1e-3 * options.load,
        reconnects=options.reconnects,
        streams=options.streams,
    )
    print(f"two arms, {len(medians)} starts: median difference of a motion at most {1e3 * max(medians):.2f} ms")
    print(f"largest difference {1e3 * max(most):.2f} ms, in half of the starts at most {1e3 * np.median(most):.2f}")


if __name__ == "__main__":
    main()

"""How far apart two arms of a group are, over many starts, in simulated time.

Two controllers on computers of their own, whose clocks are up to 200 ppm apart, with 0.3 to 0.8 ms on each way of the
network. Both turn wrist 3 there and back; from what they report, by the true time, follows when each was where. With
`--load`, this computer stands still once on each way, for up to so many ms; with `--reconnects`, all connections of
one arm are reset before every tenth start.

    python benchmarks/group.py                               # 100 starts
    python benchmarks/group.py --quick                       # 6 starts
    python benchmarks/group.py --firmware 3.15               # of the second arm
    python benchmarks/group.py --starts 1000 --load 20 --reconnects
    python benchmarks/group.py --streams                     # points that the robots hold, and not set-points
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

#: rad there and back, and s for each.
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
        #: time by its clock, and rad of wrist 3
        self.rows: list[tuple[float, float]] = []
        self.robot.realtime.subscribe(self._hear, inline=True)

    def _hear(self, state: urlink.RealtimeState) -> None:
        self.rows.append((state.time, float(state.q_target[5])))

    def true(self) -> tuple[float, float]:
        """The time of the simulation, and what its clock shows then."""
        server, state = self.controller._server, self.controller._state
        assert server is not None
        with self.sim.on(self.computer):
            cycles = (time.monotonic() - server._epoch) * self.rate + server._first
        return self.sim.now, (cycles - (state.cycle - state.uptime)) / self.rate

    def reset(self) -> None:
        """All its connections are lost, and made again."""
        self.sim.network.reset(self.sim.here, self.computer)
        time.sleep(0.1)
        self.robot.realtime.wait(timeout=10.0)
        self.robot.safety.wait_until_clear(timeout=10.0)
        time.sleep(1.0)

    def way(self, began: tuple[float, float], start: float) -> tuple[FloatArray, FloatArray]:
        """True times, and the part of the way that is behind it then."""
        (sim_began, own_began), (sim_ended, own_ended) = began, self.true()
        rows = np.array(self.rows)
        times = sim_began + (rows[:, 0] - own_began) * (sim_ended - sim_began) / (own_ended - own_began)
        return times, np.abs(rows[:, 1] - start) / WAY

    def close(self) -> None:
        self.robot.close()
        with self.sim.on(self.computer):
            self.controller.close()


def apart(one: tuple[FloatArray, FloatArray], other: tuple[FloatArray, FloatArray]) -> FloatArray:
    """s between both, at each place that the first has reported; not near the ends of the way, where both stand."""
    (when, part), (other_when, other_part) = one, other
    inside, other_inside = (part > 0.1) & (part < 0.9), (other_part > 0.05) & (other_part < 0.95)
    return np.interp(part[inside], other_part[other_inside], other_when[other_inside]) - when[inside]


def turn(group: urlink.Group, goals: Sequence[FloatArray], *, streams: bool, under_way: Callable[[], object]) -> None:
    """Turn there, by set-points or by points that the robots hold; `under_way` is called once that was begun."""
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
    """Of each start, s between both in the median of the way, and at most.

    Args:
        load: s for which this computer stands still on each way, at most.
        reconnects: connections are reset before every tenth.
        streams: they are streams, and not followed trajectories.
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
    parser.add_argument("--firmware", default="5.11", help="of the second arm")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--load", type=float, default=0.0, help="ms for which this computer stands, at most")
    parser.add_argument("--reconnects", action="store_true", help="reset the connections before every tenth start")
    parser.add_argument("--streams", action="store_true", help="streams, and not followed trajectories")
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
    print(f"two arms, {len(medians)} starts: in the median of the way {1e3 * max(medians):.2f} ms apart at most")
    print(
        f"at the worst moment {1e3 * max(most):.2f} ms, in half of the starts no more than {1e3 * np.median(most):.2f}"
    )


if __name__ == "__main__":
    main()

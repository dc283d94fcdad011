"""Benchmark: processor time of a controller at 500 Hz in a world, and the share of MuJoCo.

A UR5e with its gripper moves above a table with ten objects, in cycles of 2 ms. Each figure is the processor time per
cycle of robot time, the best of several runs: of the controller alone, of the controller in the world, and of MuJoCo
alone in the same state with the same number of steps. The second figure is the speed compared with real time.

    python packages/mujoco/tests/benchmark.py
    python packages/mujoco/tests/benchmark.py --quick
    python packages/mujoco/tests/benchmark.py --json      # prints one JSON object
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import mujoco

from urlink.simulator import Controller, Demonstration
from urlink_mujoco import MujocoWorld

OBJECTS = 10
#: Length of a cycle, in s.
CYCLE = 0.002


def scene() -> str:
    """Return a table with boxes and cylinders of 6 cm, in two rows of five."""
    things = (
        f'<body pos="{-0.3 - 0.12 * (i % 5)} {0.1 + 0.15 * (i // 5)} .03"><freejoint/>'
        f'<geom type="{"box" if i % 2 else "cylinder"}" size=".03 .03 .03" mass=".2"/></body>'
        for i in range(OBJECTS)
    )
    table = '<geom type="box" pos="-.5 0 -.05" size=".5 .6 .05"/>'
    return f"<mujoco><worldbody>{table}{''.join(things)}</worldbody></mujoco>"


def cost(advance: Callable[[int], object], cycles: int, runs: int) -> float:
    """Return the processor time per cycle, in s, of the fastest run."""
    least = float("inf")
    for _ in range(runs):
        begin = time.thread_time()
        advance(cycles)
        least = min(least, (time.thread_time() - begin) / cycles)
    return least


def measured(cycles: int, runs: int) -> dict[str, float]:
    """Return the time per cycle, in µs, of each part."""
    alone = Controller("UR5e", noise=False, motion=Demonstration())
    found = {"controller alone": cost(alone.step, cycles, runs)}
    controller = Controller("UR5e", noise=False, motion=Demonstration())
    with TemporaryDirectory() as folder:
        path = Path(folder) / "objects.xml"
        path.write_text(scene())
        world = MujocoWorld(path, controller)
    controller.step(250)  # objects come to rest on the table
    found["controller in the world"] = cost(controller.step, cycles, runs)

    def shown(cycles: int) -> None:
        for _ in range(cycles):
            controller.step()
            controller.realtime_packet()

    found["and a real-time packet"] = cost(shown, cycles, runs)
    steps = round(CYCLE / world.model.opt.timestep)

    def steps_alone(cycles: int) -> None:
        for _ in range(steps * cycles):
            mujoco.mj_step(world.model, world.data)

    found["MuJoCo alone"] = cost(steps_alone, cycles, runs)
    return {name: 1e6 * seconds for name, seconds in found.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    found = measured(*((100, 5) if args.quick else (500, 10)))
    if args.json:
        print(json.dumps({"objects": OBJECTS, "us_per_cycle": found}))
        return
    for name, value in found.items():
        print(f"{name:24} {value:7.0f} µs per cycle of {1e3 * CYCLE:g} ms, {1e6 * CYCLE / value:6.1f} times real time")
    print(f"controller in the world / MuJoCo alone = {found['controller in the world'] / found['MuJoCo alone']:.1f}")


if __name__ == "__main__":
    main()

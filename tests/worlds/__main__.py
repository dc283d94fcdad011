"""Run simulated worlds: ``python -m tests.worlds --seeds 300 --jobs 2``; ``--seed 17`` runs one and prints its log.

``--traces`` prints the checksum of each run, which is the same in every process and every version of Python.

``--planted NAME --seeds 10000`` injects a defect of `planted`, and searches for the first seed that shows it.
"""

from __future__ import annotations

import argparse
import os
import re
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from itertools import islice

from .drawn import draw
from .planted import NAMES, SHOWN, planted, worlds
from .running import Outcome, run
from .world import World


def shrunk(world: World, most: int = 300) -> World:
    """Return a smaller, simpler and shorter world with the same fault."""
    wrong = kind(run(world).faults[0])
    tried = 0
    is_smaller = True
    while is_smaller and tried < most:
        is_smaller = False
        for smaller in world.smaller():
            tried += 1
            if any(kind(fault) == wrong for fault in run(smaller).faults):
                world, is_smaller = smaller, True
                break
            if tried >= most:
                break
    return world


def kind(fault: str) -> str:
    """Return the text of a fault without numbers and names."""
    return re.sub(r"\w*\d[\w.]*", "#", fault.splitlines()[0])


def on_one_processor() -> None:
    """Bind this process to one processor, because its threads take turns and moving them costs time."""
    if hasattr(os, "sched_setaffinity"):
        allowed = sorted(os.sched_getaffinity(0))
        os.sched_setaffinity(0, {allowed[os.getpid() % len(allowed)]})


def show(world: World, result: Outcome) -> None:
    print(world)
    print("\n".join(result.log))
    for fault in result.faults:
        print("FAULT:", fault)


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.worlds", description=__doc__)
    parser.add_argument("--seeds", type=int, default=300, help="number of worlds (default: %(default)d)")
    parser.add_argument("--first", type=int, default=0, help="seed of the first world (default: %(default)d)")
    parser.add_argument("--jobs", type=int, default=1, help="parallel processes (default: %(default)d)")
    parser.add_argument("--seed", type=int, help="run only this world, and print its events")
    parser.add_argument("--shrink", action="store_true", help="make a world with a fault smaller")
    parser.add_argument("--until", action="store_true", help="stop at the first fault, and make its world smaller")
    parser.add_argument("--traces", action="store_true", help="print a checksum of all events of each world")
    parser.add_argument("--shown", metavar="NAME", choices=SHOWN, help="run the world that shows this defect")
    parser.add_argument("--planted", metavar="NAME", choices=NAMES, help=f"inject a defect: {', '.join(NAMES)}")
    given = parser.parse_args()
    if given.planted is not None:
        rest = ["--first", str(given.first), "--seeds", str(given.seeds), "--jobs", str(given.jobs), "--until"]
        with planted(given.planted) as root:
            found = worlds(root, rest if given.seed is None else ["--seed", str(given.seed), "--shrink"])
        print(found.stdout, end="")
        return found.returncode
    if given.shown is not None:
        small, tries = SHOWN[given.shown]
        for world in (replace(small, seed=seed) for seed in range(tries)):
            result = run(world)
            if result.faults:
                show(world, result)
                return 1
        return 0
    if given.seed is not None:
        world = draw(given.seed)
        result = run(world)
        if given.shrink and result.faults:
            world = shrunk(world)
            result = run(world)
        show(world, result)
        return bool(result.faults)
    begun, done, simulated, moved, failed = time.perf_counter(), 0, 0.0, 0.0, 0
    seeds = iter(range(given.first, given.first + given.seeds))
    with ProcessPoolExecutor(given.jobs, initializer=on_one_processor) as pool:
        while some := list(islice(seeds, 100)):
            # Since Python 3.14, a process of the pool cannot import functions of this module.
            for seed, result in zip(some, pool.map(run, map(draw, some)), strict=True):
                done += 1
                simulated += result.simulated
                moved += result.moved
                if given.traces:
                    print(f"{seed} {result.trace:08x}", flush=True)
                if result.faults:
                    failed += 1
                    print(f"python -m tests.worlds --seed {seed}    # {result.faults[0].splitlines()[0]}", flush=True)
                    if given.until:
                        pool.shutdown(cancel_futures=True)
                        print(f"after {done} worlds and {time.perf_counter() - begun:.0f} s", flush=True)
                        world = shrunk(draw(seed))
                        show(world, run(world))
                        return 1
    seconds = time.perf_counter() - begun
    print(
        f"{done} worlds, {failed} with faults; {simulated:.0f} s of simulated time, in {moved:.0f} s of it "
        f"the arm moved; {seconds:.0f} s"
    )
    return bool(failed)


if __name__ == "__main__":
    sys.exit(main())

"""Programs of many runs, each drawn by its seed: which of them are run, and what is kept to go on from.

With ``--state FILE`` each run is one line of JSON there; who starts the program again with the same file goes on with
the runs that it has not, and sums up all of them. ``--first 17 --runs 1`` without the file repeats one.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

__all__ = ["add_arguments", "tried"]


def add_arguments(parser: argparse.ArgumentParser, runs: int) -> None:
    """Which runs; so many by default."""
    parser.add_argument("--first", type=int, default=0, help="seed of the first run (0)")
    parser.add_argument("--runs", type=int, default=runs, help="how many, with the seeds that follow (%(default)d)")
    parser.add_argument("--seconds", type=float, default=float("inf"), help="of processor time: no run begins after")
    parser.add_argument("--state", type=Path, help="a file of what was run, to go on from")


def tried(args: argparse.Namespace, run: Callable[[int], dict[str, Any]]) -> Iterator[dict[str, Any]]:
    """What each run has given, with its seed: first those of the file, then the others as they are run."""
    seeds = range(args.first, args.first + args.runs)
    lines = args.state.read_text().splitlines() if args.state and args.state.exists() else []
    kept = [each for each in map(json.loads, lines) if each["seed"] in seeds]
    yield from kept
    left = sorted(set(seeds) - {each["seed"] for each in kept})
    until = time.process_time() + args.seconds
    for seed in left:
        if time.process_time() > until:
            return
        began = time.process_time()
        found = {"seed": seed, **run(seed)}
        found["processor"] = round(time.process_time() - began, 2)
        if args.state:
            with args.state.open("a") as file:
                file.write(json.dumps(found) + "\n")
        yield found

"""Options of programs with many runs, each drawn by its seed: the runs to make, and a file to resume from.

With ``--state FILE``, each run is stored in that file as one line of JSON. If the program is started again with the
same file, it makes the missing runs and sums up all of them. ``--first 17 --runs 1`` without a file repeats one run.
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
    """Add the options that select the runs; `runs` is the default number."""
    parser.add_argument("--first", type=int, default=0, help="seed of the first run (default: 0)")
    parser.add_argument(
        "--runs", type=int, default=runs, help="number of runs, with consecutive seeds (default: %(default)d)"
    )
    parser.add_argument("--seconds", type=float, default=float("inf"), help="start no run after this processor time")
    parser.add_argument("--state", type=Path, help="file with the results of runs, to resume from")


def tried(args: argparse.Namespace, run: Callable[[int], dict[str, Any]]) -> Iterator[dict[str, Any]]:
    """Yield the result of each run with its seed: first the runs in the file, then the others as they finish."""
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

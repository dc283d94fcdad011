"""Whether intervals hold: ``python -m packages.accept.tests.identification.halves LOG --model UR3e``.

A log of a real arm has no planted values. Instead, parts of the log must agree. The program identifies the arm from the
first and the second half of the log, and from ten random halves and the other rows of each. A random half consists of
half of the movements, each with parts of the rests before and after it. If the log contains only few movements, it
consists of pieces of equal time. The program prints

- the numbers whose intervals from the two parts are disjoint, and
- the width of each interval from the whole log, compared with the spread of the ten random halves, which is the
  difference of the largest and the smallest value.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from urlink.arm.arm_file import ArmFile, Estimate
from urlink_accept.identification import identify
from urlink_accept.identification.samples import Samples, read_samples

#: Number of random halves; smallest number of movements; number of pieces if there are fewer movements.
HALVES, MOVEMENTS, PIECES = 10, 8, 20
#: Largest fraction of disjoint intervals, and largest mean of width by spread.
DISJOINT, WIDTH = 0.02, 1.5


@dataclass(frozen=True)
class Agreement:
    """Agreement of the parts of a log.

    Attributes:
        whole: Name of a number -> its estimate from the whole log.
        ordered: Names that are disjoint between the first and the second half.
        compared: Number of the names that both of these halves show.
        random: Names that are disjoint between a random half and the other rows, one entry for each pair.
        compared_at_random: Number of compared pairs.
        widths: Name -> width of the interval from the whole log, by the spread of the random halves.
    """

    whole: dict[str, Estimate]
    ordered: list[str]
    compared: int
    random: list[str]
    compared_at_random: int
    widths: dict[str, float]


def named(found: ArmFile) -> dict[str, Estimate]:
    """Return the known numbers by their names. The residual of the calibration is not a number of the arm."""
    return {
        f"{name} {number}" if len(each) > 1 else name: estimate
        for name, each in found.estimates.items()
        for number, estimate in enumerate(each)
        if estimate.is_known and name != "calibration"
    }


def agreement(samples: Samples, model: str, seed: int = 0) -> Agreement:
    """Measure the agreement of the parts of a log."""
    whole = named(identify(samples, model))
    count = len(samples["timestamp"])
    first = np.arange(count) < count // 2
    one, two = (named(identify(part(samples, rows), model)) for rows in (first, ~first))
    ordered = [name for name in one.keys() & two.keys() if disjoint(one[name], two[name])]
    values: dict[str, list[float]] = {name: [] for name in whole}
    at_random, compared = [], 0
    for rows in random_halves(samples, np.random.default_rng(seed)):
        half, rest = (named(identify(part(samples, each), model)) for each in (rows, ~rows))
        for name in values.keys() & half.keys():
            values[name].append(half[name].value)
        shared = half.keys() & rest.keys()
        compared += len(shared)
        at_random += [name for name in shared if disjoint(half[name], rest[name])]
    widths = {
        name: (whole[name].high - whole[name].low) / np.ptp(each)
        for name, each in values.items()
        if len(each) == HALVES
    }
    return Agreement(whole, ordered, len(one.keys() & two.keys()), at_random, compared, widths)


def part(samples: Samples, rows: NDArray[np.bool_]) -> Samples:
    return Samples(
        samples.path,
        {name: column[rows] for name, column in samples.items()},
        samples.model,
        None if samples.arrival is None else samples.arrival[rows],
    )


def random_halves(samples: Samples, rng: np.random.Generator) -> Iterator[NDArray[np.bool_]]:
    """Yield the rows of random halves, which are cut in the middle of rests."""
    rest = samples.is_rest
    edges = np.flatnonzero(np.diff(np.concatenate(([False], rest, [False])).astype(int))).reshape(-1, 2)
    piece = np.zeros(len(rest), dtype=int)
    piece[[(begin + end) // 2 for begin, end in edges[1:].tolist() if end < len(rest)]] = 1
    piece = np.cumsum(piece)
    if piece[-1] + 1 < MOVEMENTS:
        piece = np.arange(len(rest)) * PIECES // len(rest)
    count = int(piece[-1]) + 1
    for _ in range(HALVES):
        yield np.isin(piece, rng.permutation(count)[: count // 2])


def disjoint(a: Estimate, b: Estimate) -> bool:
    return a.high < b.low or b.high < a.low


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m packages.accept.tests.identification.halves",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("log", type=Path, help="a recording or a table with the targets of the joints")
    parser.add_argument("--model", help="arm, if the log does not name it")
    parser.add_argument("--seed", type=int, default=0, help="seed of the random halves (default: %(default)d)")
    args = parser.parse_args()
    samples = read_samples(args.log)
    found = agreement(samples, args.model or samples.model or "", args.seed)
    for name, width in sorted(found.widths.items(), key=lambda each: -each[1]):
        value = found.whole[name]
        print(f"{name:24} {value.value:11.5g} ({value.low:.5g} to {value.high:.5g}); width by spread {width:.2f}")
    mean, median = np.mean(list(found.widths.values())), np.median(list(found.widths.values()))
    print(f"first and second half: {len(found.ordered)} of {found.compared} disjoint {found.ordered}")
    print(f"random halves and other rows: {len(found.random)} of {found.compared_at_random} disjoint {found.random}")
    print(f"{len(found.widths)} widths by spread: mean {mean:.2f}, median {median:.2f}")
    shares = len(found.ordered) / found.compared, len(found.random) / found.compared_at_random
    return int(max(shares) > DISJOINT or mean > WIDTH)


if __name__ == "__main__":
    sys.exit(main())

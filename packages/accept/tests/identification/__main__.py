"""`urlink identify` on arms with planted parameters: ``python -m packages.accept.tests.identification --runs 200``.

Each run draws an arm, records 10 s of it with noise, and identifies it. For each number, the program counts how often
its interval contains the planted value, and how often the number is within 5 % of it. With ``--state FILE`` the next
call continues with the remaining runs.
"""

from __future__ import annotations

import argparse
import sys
from functools import partial
from typing import Any

import numpy as np

from tests import trials
from urlink.arm.arm_file import Estimate
from urlink_accept.identification import identify
from urlink_accept.identification.samples import Samples

from .planted import OWN, planted, recorded

#: Largest factor by which a drawn parameter may differ from that of `planted`.
FACTOR = 1.3
#: Noise of the controller's results, in Nm and A; required fraction of the runs whose interval contains the planted
#: value. The intervals are made for 95 %.
NOISE, HELD = 0.1, 0.9
NEAR = 0.05
#: Mean delay of packets, in s; largest relative error of the controller's clock.
LATE, DRIFT = 5e-4, 5e-4


def drawn(seed: int, rate: int) -> tuple[dict[str, list[float]], Samples]:
    """Return the planted values by name, and the recording with `rate` rows per second."""
    rng = np.random.default_rng(seed)
    values = {
        name: (np.array(each) * FACTOR ** rng.uniform(-1.0, 1.0, len(each))).tolist() for name, each in OWN.items()
    }
    whole = recorded(planted(seed, **values), seed, 500 // rate)
    columns = dict(whole)
    for name in ("target_moment", "target_current"):
        columns[name] = columns[name] + NOISE * rng.standard_normal(columns[name].shape)
    # The error of a current is the difference between the actual and the target current, so it contains this noise too.
    values["current_noise"] = [float(np.hypot(each, NOISE)) for each in values["current_noise"]]
    drift = float(rng.uniform(-DRIFT, DRIFT))
    times = columns["timestamp"]
    arrival = times / (1.0 + drift) + rng.exponential(LATE, len(times))
    return values | {"clock_drift": [drift]}, Samples(whole.path, columns, whole.model, arrival)


def run(rate: int, seed: int) -> dict[str, Any]:
    """Return each number's relative error, and whether its interval contains the true value."""
    values, samples = drawn(seed, rate)
    found = identify(samples)
    return {
        f"{name} {number}": off(estimate, truth)
        for name, each in values.items()
        for number, (estimate, truth) in enumerate(zip(found.estimates[name], each, strict=True))
    }


def off(estimate: Estimate, truth: float) -> list[float | bool]:
    if not estimate.is_known:
        return [float("inf"), False]
    return [float(abs(estimate.value / truth - 1.0)), bool(estimate.low <= truth <= estimate.high)]


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m packages.accept.tests.identification",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    trials.add_arguments(parser, runs=200)
    parser.add_argument(
        "--rate", type=int, choices=(125, 500), default=125, help="rows per second (default: %(default)d)"
    )
    args = parser.parse_args()
    runs = list(trials.tried(args, partial(run, args.rate)))
    names = [name for name, value in runs[0].items() if isinstance(value, list)]
    wrong = 0
    for name in names:
        apart, holds = np.array([each[name] for each in runs], dtype=float).T
        is_wrong = holds.mean() < HELD
        wrong += is_wrong
        print(
            f"{name:20} held in {int(holds.sum())} of {len(runs)}, within {NEAR:.0%} in {int((apart <= NEAR).sum())}; "
            f"median error {np.median(apart):.2%}, largest {apart.max():.2%}{'  NOT HELD' if is_wrong else ''}"
        )
    print(f"{len(runs)} runs, {len(names)} numbers: {wrong} held in less than {HELD:.0%}")
    print(f"{sum(each['processor'] for each in runs):.0f} s of processor time")
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())

"""Run workloads for a long time; their memory, descriptors, threads and objects must not grow.

Run it with ``nox -f nightly.py -s soak``.

Each workload runs in its own process, so that the report names the workload that grows. The program exits with 1 if
anything grows, or if a workload fails.
"""

from __future__ import annotations

import argparse
import array
import subprocess
import sys
import threading
import time
import traceback

from tests.soak.gauges import Sample, sample, trends
from tests.soak.workloads import WORKLOADS, Workload

NAMES = [each.__name__ for each in WORKLOADS]

#: Minimum number of samples; a shorter run shows no trend.
LEAST_SAMPLES = 20


class Rounds:
    """Repeats one workload in a thread, until `end` is called or a round fails."""

    def __init__(self, workload: Workload) -> None:
        self._workload = workload
        self.count = 0
        self.failure: str | None = None
        self.ended = threading.Event()
        self._thread = threading.Thread(target=self._work, name=workload.__name__, daemon=True)
        self._thread.start()

    def _work(self) -> None:
        try:
            with self._workload() as one_round:
                while not self.ended.is_set():
                    one_round()
                    self.count += 1
        except BaseException:
            self.failure = traceback.format_exc()
            self.ended.set()

    def end(self, timeout: float = 60.0) -> None:
        self.ended.set()
        self._thread.join(timeout)
        if self._thread.is_alive():
            self.failure = f"the round did not end within {timeout:g} s"


def run(workload: Workload, seconds: float, interval: float) -> bool:
    """Run a workload and print the result; return whether it ran to the end and nothing grew."""
    rounds = Rounds(workload)
    # Store plain numbers: stored objects would be counted in the following samples.
    taken = array.array("d")
    begin = time.monotonic()
    while not rounds.ended.wait(interval) and time.monotonic() - begin < seconds:
        taken.extend(sample(time.monotonic() - begin))
    rounds.end()
    width = len(Sample._fields)
    samples = [Sample(*taken[first : first + width]) for first in range(0, len(taken), width)]
    lines = [f"{workload.__name__}: {rounds.count} rounds in {time.monotonic() - begin:.0f} s"]
    is_good = rounds.failure is None
    if rounds.failure is not None:
        lines.append(rounds.failure)
    if len(samples) < LEAST_SAMPLES:
        lines.append(f"  only {len(samples)} samples, too few for a trend")
        is_good = False
    else:
        found = trends(samples)
        lines += [f"  {trend}" for trend in found]
        is_good = is_good and all(trend.is_flat for trend in found)
    print("\n".join(lines), flush=True)
    return is_good


def main() -> int:
    parser = argparse.ArgumentParser(prog="soak", description=__doc__)
    parser.add_argument("--minutes", type=float, default=20.0, help="duration in minutes (default: %(default)g)")
    parser.add_argument("--interval", type=float, default=5.0, help="seconds between samples (default: %(default)g)")
    parser.add_argument("--in-process", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument(
        "names", nargs="*", metavar="WORKLOAD", help=f"workloads to run, of {', '.join(NAMES)} (default: all)"
    )
    options = parser.parse_args()
    if sys.platform != "linux":
        parser.error("this program reads memory, descriptors and threads from /proc, so it needs Linux")
    if unknown := set(options.names) - set(NAMES):
        parser.error(f"unknown workload {', '.join(unknown)}; expected some of {', '.join(NAMES)}")
    if options.in_process:
        (chosen,) = (each for each in WORKLOADS if each.__name__ in options.names)
        return 0 if run(chosen, 60 * options.minutes, options.interval) else 1
    arguments = ["--in-process", f"--minutes={options.minutes}", f"--interval={options.interval}"]
    command = [sys.executable, "-m", "tests.soak", *arguments]
    processes = [subprocess.Popen([*command, name]) for name in options.names or NAMES]
    try:
        statuses = [process.wait(60 * options.minutes + 180) for process in processes]
    finally:
        for process in processes:
            process.kill()
    return max(statuses)


if __name__ == "__main__":
    sys.exit(main())

"""Measure how many small changes to the program its tests detect: ``nox -f nightly.py -s mutants``.

Prints a row for each module, and every mutation that no test detected. ``docs/reliability.md`` has the results.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from collections import Counter
from pathlib import Path

from tests.mutants.engine import run_group
from tests.mutants.targets import GROUPS, ROOT


def main() -> int:
    parser = argparse.ArgumentParser(prog="mutants", description=__doc__)
    parser.add_argument("groups", nargs="*", metavar="GROUP", help=f"groups out of {', '.join(GROUPS)} (default: all)")
    parser.add_argument("--only", metavar="MODULE", help="mutate only this module, named without .py")
    parser.add_argument("--tests", nargs="+", metavar="PATH", help="run these tests instead of the tests of the group")
    parser.add_argument("--sample", type=int, metavar="N", help="try N random mutations of each module (default: all)")
    parser.add_argument("--seed", type=int, default=1, help="seed of the random choice (default: %(default)s)")
    parser.add_argument(
        "--jobs", type=int, default=os.cpu_count() or 1, help="parallel processes (default: %(default)s)"
    )
    parser.add_argument(
        "--budget", type=float, default=60.0, help="seconds of tests per mutation (default: %(default)g)"
    )
    parser.add_argument("--drawn", metavar="FROM:TO", help="try this range of the defects of the group `drawn`")
    parser.add_argument(
        "--report", type=Path, metavar="FILE", help="write the results to FILE, one JSON object per line"
    )
    parser.add_argument("--into", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if unknown := [name for name in options.groups if name not in GROUPS]:
        parser.error(f"unknown group {', '.join(unknown)}; expected {', '.join(GROUPS)}")
    if options.into is not None:
        (name,) = options.groups
        first, _, last = (options.drawn or ":").partition(":")
        drawn = slice(int(first or 0), int(last) if last else None) if name == "drawn" else None
        results = run_group(
            name, options.only, options.tests, options.sample, options.jobs, options.budget, options.seed, drawn
        )
        with options.into.open("a") as file:
            file.writelines(json.dumps(each.as_json()) + "\n" for each in results)
        return 0

    report: Path = options.report or ROOT / "build" / "mutants.jsonl"
    report.parent.mkdir(exist_ok=True)
    report.write_text("")
    for name in options.groups or GROUPS:
        # Run each group in its own process, because every group collects tests and imports the tested modules.
        argv = [argument for argument in sys.argv[1:] if argument not in options.groups]
        command = [sys.executable, "-m", "tests.mutants", name, *argv, "--into", str(report)]
        subprocess.run(command, cwd=ROOT, env={**os.environ, "HYPOTHESIS_PROFILE": "mutants"}, check=True)
    print_report(report)
    return 0


def print_report(report: Path) -> None:
    results = [json.loads(line) for line in report.read_text().splitlines()]
    modules: dict[str, Counter[str]] = {}
    for each in results:
        if not each["is_control"]:
            modules.setdefault(each["path"], Counter())[each["outcome"]] += 1
    modules["in all"] = sum(modules.values(), Counter())
    print(f"{'module':48}{'mutants':>8}{'killed':>8}{'lived':>7}{'uncovered':>10}{'rate':>8}")
    for path, counts in modules.items():
        alive = counts["survived"] + counts["uncovered"]
        print(
            f"{path.removeprefix('src/'):48}{counts.total():8}{counts['killed']:8}"
            f"{counts['survived']:7}{counts['uncovered']:10}{alive / max(counts.total(), 1):8.1%}"
        )
    controls = Counter(each["outcome"] for each in results if each["is_control"])
    print(f"\n{controls.total() - controls['survived']} of {controls.total()} runs without a mutation failed")
    print("\nnot detected:")
    for each in results:
        if not each["is_control"] and each["outcome"] in ("survived", "uncovered"):
            mutation = each["mutation"]
            print(
                f"{each['path']}:{mutation['line']}: {mutation['before']}  ->  {mutation['after']}  ({each['outcome']})"
            )


if __name__ == "__main__":
    sys.exit(main())

"""How many small changes to the program its tests notice: ``nox -f nightly.py -s mutants``.

Prints a row for each module, and every mutation that no test noticed. ``docs/reliability.md`` says what came of it.
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
    parser.add_argument("groups", nargs="*", metavar="GROUP", help=f"of {', '.join(GROUPS)}; all by default")
    parser.add_argument("--only", metavar="MODULE", help="this module alone, by its name without .py")
    parser.add_argument("--tests", nargs="+", metavar="PATH", help="instead of all tests that the group names")
    parser.add_argument("--sample", type=int, metavar="N", help="of each module N mutations at random; all by default")
    parser.add_argument("--seed", type=int, default=1, help="of that choice (%(default)s)")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="processes side by side (%(default)s)")
    parser.add_argument("--budget", type=float, default=60.0, help="seconds of tests for a mutation (%(default)g)")
    parser.add_argument("--drawn", metavar="FROM:TO", help="of the group drawn, these of the defects of `drawn`")
    parser.add_argument("--report", type=Path, metavar="FILE", help="write every result there, one JSON object a line")
    parser.add_argument("--into", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if unknown := [name for name in options.groups if name not in GROUPS]:
        parser.error(f"no group {', '.join(unknown)}; there are {', '.join(GROUPS)}")
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
        # A process for each, because every group collects tests and imports what they test.
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
    print(f"\nof {controls.total()} runs without a mutation {controls.total() - controls['survived']} failed")
    print("\nnot noticed:")
    for each in results:
        if not each["is_control"] and each["outcome"] in ("survived", "uncovered"):
            mutation = each["mutation"]
            print(
                f"{each['path']}:{mutation['line']}: {mutation['before']}  ->  {mutation['after']}  ({each['outcome']})"
            )


if __name__ == "__main__":
    sys.exit(main())

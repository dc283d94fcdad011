"""Time to import urlink in addition to numpy, each in fresh interpreters, in turn.

The names of urlink are imported at their first use. So there is a row for the package alone, for a program that decodes
bytes, for a program that connects, and for all names.

python benchmarks/imports.py            # 25 interpreters each
python benchmarks/imports.py --quick    # 7
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile

import numpy as np

#: The interpreter itself measures the time, without its own start.
TIMED = "import time; began = time.perf_counter(); {}; print(time.perf_counter() - began)"
STATEMENTS = {
    "numpy": "import numpy",
    "urlink": "import numpy, urlink",
    "urlink.decode": "import numpy, urlink; urlink.decode",
    "urlink.connect": "import numpy, urlink; urlink.connect",
    "every name": "import numpy; from urlink import *",
    "urlink.simulator": "import numpy, urlink.simulator",
    "rhdlink.connect": "import numpy, rhdlink; rhdlink.connect",
}


def seconds(statement: str, cache: str) -> float:
    # An installed package contains its bytecode. A checkout may not be allowed to write it.
    environment = {**os.environ, "PYTHONPYCACHEPREFIX": cache, "PYTHONDONTWRITEBYTECODE": ""}
    command = [sys.executable, "-c", TIMED.format(statement)]
    done = subprocess.run(command, check=True, capture_output=True, text=True, env=environment)
    return float(done.stdout)


def compare(rounds: int, cache: str) -> dict[str, dict[str, float]]:
    """Return the median milliseconds for each statement.

    The time in addition to numpy is also returned as a fraction of the time of numpy.
    """
    for statement in STATEMENTS.values():  # once, so that all modules are compiled and in the disk cache
        seconds(statement, cache)
    times = {name: np.zeros(rounds) for name in STATEMENTS}
    for number in range(rounds):
        for name in STATEMENTS if number % 2 else reversed(STATEMENTS):
            times[name][number] = seconds(STATEMENTS[name], cache)
    numpy = times["numpy"]
    return {
        name: {
            "ms": float(np.median(each)) * 1e3,
            "on_top_ms": float(np.median(each - numpy)) * 1e3,
            "share": float(np.median((each - numpy) / numpy)),
        }
        for name, each in times.items()
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="7 interpreters each instead of 25")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as cache:
        figures = compare(7 if options.quick else 25, cache)
    if options.json:
        print(json.dumps(figures))
        return
    print(f"{'in a fresh interpreter (median)':36} {'ms':>8} {'added':>8} {'of numpy':>9}")
    for name, row in figures.items():
        print(f"{name:36} {row['ms']:8.1f} {row['on_top_ms']:8.1f} {row['share']:9.2f}")


if __name__ == "__main__":
    main()

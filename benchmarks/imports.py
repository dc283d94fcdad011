"""What `import urlink` costs beyond `import numpy`, each in fresh interpreters, in turns.

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

#: The interpreter times the import by itself, without its own start.
TIMED = "import time; began = time.perf_counter(); import {}; print(time.perf_counter() - began)"
MODULES = ("numpy", "urlink", "urlink.simulator")


def seconds_to_import(module: str, cache: str) -> float:
    # An installed package has its bytecode; a checkout may not be allowed to write it.
    environment = {**os.environ, "PYTHONPYCACHEPREFIX": cache, "PYTHONDONTWRITEBYTECODE": ""}
    command = [sys.executable, "-c", TIMED.format(module)]
    done = subprocess.run(command, check=True, capture_output=True, text=True, env=environment)
    return float(done.stdout)


def compare(rounds: int, cache: str) -> dict[str, float]:
    for module in MODULES:  # once, so that all are compiled and in the cache of the disk
        seconds_to_import(module, cache)
    times = {module: [0.0] * rounds for module in MODULES}
    for number in range(rounds):
        for module in MODULES if number % 2 else reversed(MODULES):
            times[module][number] = seconds_to_import(module, cache)
    numpy, urlink, simulator = (np.array(times[module]) for module in MODULES)
    return {
        "numpy_ms": float(np.median(numpy)) * 1e3,
        "urlink_ms": float(np.median(urlink)) * 1e3,
        "simulator_ms": float(np.median(simulator)) * 1e3,
        "beyond_numpy_ms": float(np.median(urlink - numpy)) * 1e3,
        "ratio": float(np.median(urlink / numpy)),
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
    print("import in a fresh interpreter (median)")
    print(f"  numpy                    {figures['numpy_ms']:8.1f} ms")
    print(f"  urlink                   {figures['urlink_ms']:8.1f} ms   {figures['ratio']:.2f} x")
    print(f"  urlink.simulator         {figures['simulator_ms']:8.1f} ms")
    print(f"  urlink beyond numpy      {figures['beyond_numpy_ms']:8.1f} ms   (goal: at most 60 ms)")


if __name__ == "__main__":
    main()

"""Rate and jitter of a 500 Hz simulator and of a servo loop, as ratios to the same program on another system.

The simulator runs in the same process. A state is received every 2 ms, and the servo loop answers each state with one
set-point. The intervals are those between the arrivals of the states, and between the returns of `servo.send`.

    python benchmarks/systems.py                                   # 20 s each
    python benchmarks/systems.py --against python .ci/wine.py run LAB benchmarks/systems.py
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time

import numpy as np

import urlink

HOME = (0.0, -1.57, 1.57, -1.57, -1.57, 0.0)


def described(times: list[float]) -> dict[str, float]:
    """Return the rate in Hz, and the spread of the intervals in ms."""
    intervals = np.diff(times) * 1e3
    return {
        "rate": 1e3 / float(intervals.mean()),
        "standard deviation": float(intervals.std()),
        "99 %": float(np.percentile(np.abs(intervals - 2.0), 99)),
    }


def measure(seconds: float) -> dict[str, dict[str, float]]:
    """Return the figures of the states and of the servo loop."""
    arrived: list[float] = []
    sent: list[float] = []
    with urlink.connect("sim://ur5e?firmware=5.11") as robot:
        robot.motion.move_joints(HOME).wait(60)
        subscription = robot.realtime.subscribe(lambda state: arrived.append(time.perf_counter()), inline=True)
        time.sleep(seconds)
        subscription.close()
        with robot.motion.servo() as servo:
            start = robot.realtime.wait()
            for state in robot.realtime:
                t = state.time - start.time
                if t > seconds:
                    break
                servo.send(start.q_target + np.array([0, 0, 0, 0, 0, 0.05 * (1 - np.cos(2 * np.pi * t))]))
                sent.append(time.perf_counter())
    return {"states": described(arrived), "servo": described(sent)}


def main() -> None:
    parser = argparse.ArgumentParser(description="Measure the rate and the jitter on this system.")
    parser.add_argument("--seconds", type=float, default=20.0, help="duration of each measurement (default: 20)")
    parser.add_argument("--json", action="store_true", help="print the figures as JSON")
    parser.add_argument(
        "--against", nargs=argparse.REMAINDER, metavar="COMMAND", help="command that runs this program elsewhere"
    )
    options = parser.parse_args()
    here = measure(options.seconds)
    if options.json:
        print(json.dumps(here))
        return
    there = None
    if options.against:
        command = [*options.against, "--json", "--seconds", str(options.seconds)]
        done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True, timeout=60 + 10 * options.seconds)
        there = json.loads(done.stdout.strip().splitlines()[-1])
    print(f"{'':28}{sys.platform:>12}" + ("" if there is None else f"{'other':>12}{'ratio':>8}"))
    for kind, figures in here.items():
        for name, value in figures.items():
            unit = "Hz" if name == "rate" else "ms"
            line = f"{f'{kind}, {name} ({unit})':28}{value:12.3f}"
            print(line if there is None else f"{line}{there[kind][name]:12.3f}{there[kind][name] / value:8.2f}")


if __name__ == "__main__":
    main()

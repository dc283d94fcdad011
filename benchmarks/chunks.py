"""Chunks of a policy that computes for 0.05 to 1 s: a stream, compared with a loop around ``servoJ`` of ur_rtde.

A simulated e-Series controller runs in a separate process. Both programs follow the same data: chunks of positions,
speeds and accelerations for the next 2.5 s, with a point every 50 ms. Each chunk has its own error of at most 3 mrad,
because policies contradict themselves. `robot.motion.stream` replaces its tail by each chunk. The other loop does what
examples of ur_rtde do: it sends the point that is due with ``servoJ(q, 0, 0, 0.05, 0.1, 300)``, and changes to the next
chunk when it is available. With `--simulated`, the stream runs in simulated time, so other programs on this computer do
not matter.

Speeds, accelerations and jerks are calculated from the joint's target positions, by differences of 10 ms. Errors are
differences between the arm and the policy's intention, on the clock of the stream or of this computer. The part of the
error that a constant lag explains is left out.

    python benchmarks/chunks.py                     # 60 s each; the second needs ur_rtde
    python benchmarks/chunks.py --output FILE       # writes the figures, and the last seconds of both
    python benchmarks/chunks.py --simulated         # the stream alone
"""

from __future__ import annotations

import argparse
import json
import math
import random
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
from _simulated import simulated

import urlink
from urlink import TrajectoryPoint

READY = np.array([0.0, -1.6, 1.6, -1.6, -1.6, 0.0])
WAY = np.array([0.3, 0.0, 0.0, 0.0, 0.0, 1.0])
PERIOD, HORIZON = 0.05, 50
#: ur_rtde has the ports of a real controller built in; no other program here uses this address.
HOST = ("--ports", "standard", "--host", "127.9.21.1")
#: Maximum jerk of the stream, in rad/s³.
JERK = 100.0
#: Time, in s, of the arm that is kept for a figure.
SHOWN = 6.0


def meant(t: float) -> tuple[float, float, float]:
    """Return the intended position (rad), speed and acceleration along `WAY`; at rest at 0."""
    c, s = math.cos(t), math.sin(t)
    return 0.15 * (1 - c) ** 2, 0.3 * (1 - c) * s, 0.3 * (s * s + (1 - c) * c)


class Policy:
    """Policy that returns chunks, each after its own computing time."""

    def __init__(self, seed: int) -> None:
        self._luck = random.Random(seed)
        self._mean = 0.3

    def chunk(self, t: float) -> list[TrajectoryPoint]:
        """Return the chunk for the time from `t`, after the computing time."""
        # The computing time drifts, and has jitter.
        self._mean = min(max(self._mean * self._luck.uniform(0.7, 1.4), 0.05), 1.0)
        time.sleep(min(max(self._luck.gauss(self._mean, 0.2 * self._mean), 0.05), 1.0))
        off = self._luck.uniform(-0.003, 0.003)
        made = []
        for step in range(HORIZON):
            q, qd, qdd = meant(t + PERIOD * step)
            made.append(TrajectoryPoint(READY + (q + off) * WAY, t + PERIOD * step, qd * WAY, qdd * WAY))
        return made


def streamed(robot: urlink.Robot, seconds: float) -> dict[str, Any]:
    policy, chunks = Policy(1), 0
    with robot.motion.stream(jerk=JERK) as stream:
        stream.append(policy.chunk(0.0)[1:], wait=False)
        while stream.time < seconds:
            looked = stream.time
            stream.replace(looked, policy.chunk(looked))
            chunks += 1
        starved = stream.starved
        stream.clear()
        stream.wait_until_dry()
    return {"chunks": chunks, "starved": starved}


def looped(address: str, seconds: float) -> dict[str, Any]:
    from rtde_control import RTDEControlInterface  # type: ignore[import-not-found]

    control = RTDEControlInterface(address.partition("?")[0])
    policy = Policy(1)
    begun = time.monotonic()
    newest = policy.chunk(0.0)
    begun, count, missed = time.monotonic(), 1, 0
    over = threading.Event()

    def think() -> None:
        nonlocal newest, count
        while not over.is_set():
            newest = policy.chunk(time.monotonic() - begun)
            count += 1

    thread = threading.Thread(target=think)
    thread.start()
    try:
        while (t := time.monotonic() - begun) < seconds:
            due = next((point for point in newest if point.time >= t), None)
            if due is None:
                missed += 1
            else:
                control.servoJ(due.q.tolist(), 0.0, 0.0, PERIOD, 0.1, 300.0)
            time.sleep(max(begun + (math.floor(t / PERIOD) + 1) * PERIOD - time.monotonic(), 0.0))
        control.servoStop()
        control.stopScript()
    finally:
        over.set()
        thread.join()
        control.disconnect()
    return {"chunks": count, "starved": missed}


def figures(rows: list[tuple[float, float]], seconds: float) -> dict[str, Any]:
    """Return the figures of rows with time (s) and target position (rad) of wrist 3."""
    time_, q = np.array(rows).T
    time_ -= time_[0]
    grid = np.arange(0.0, time_[-1], 0.01)
    q = np.interp(grid, time_, q)
    qd = np.diff(q) / 0.01
    qdd = np.diff(qd) / 0.01
    qddd = np.diff(qdd) / 0.01
    moves = np.flatnonzero(np.abs(qd) > 1e-3)
    first, last = int(moves[0]), min(int(moves[-1]), int(moves[0]) + round(seconds / 0.01))
    t = grid[first:last] - grid[first]
    wanted = np.vectorize(lambda t: meant(t)[0])
    # The lag that explains most of the error.
    lags = np.arange(-0.5, 1.5, 0.005)
    lag = lags[int(np.argmin([np.abs(q[first:last] - wanted(np.maximum(t - lag, 0.0))).mean() for lag in lags]))]
    error = np.abs(q[first:last] - wanted(np.maximum(t - lag, 0.0)))
    tenth = len(t) // 6
    inside = slice(first + 50, last - 50)
    return {
        "acceleration": float(np.abs(qdd[inside]).max()),
        "jerk": float(np.abs(qddd[inside]).max()),
        "jerk_99": float(np.percentile(np.abs(qddd[inside]), 99)),
        "error_first": float(np.percentile(error[:tenth], 99)),
        "error_last": float(np.percentile(error[-tenth:], 99)),
        "lag": float(lag),
        "curve": {"time": t[-round(SHOWN / 0.01) :].tolist(), "q": q[last - round(SHOWN / 0.01) : last].tolist()},
        "jerks": qddd[last - round(SHOWN / 0.01) : last].tolist(),
    }


def measure(name: str, seconds: float) -> dict[str, Any]:
    with simulated("UR5e", "5.11", *HOST) as address:
        return follow(name, address, seconds, stale_after=20.0, silence=30.0, reverse_peer="127.0.0.1")


def follow(name: str, address: str, seconds: float, **options: Any) -> dict[str, Any]:
    """Return the figures of one of the two programs."""
    with urlink.connect(address, **options) as robot:
        robot.motion.move_joints(READY, 2.0, 10.0).wait()
        rows: list[tuple[float, float]] = []
        with robot.realtime.subscribe(lambda state: rows.append((state.time, float(state.q_target[5])))):
            done = streamed(robot, seconds) if name == "stream" else looped(address, seconds)
        return {**done, **figures(rows, seconds)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="10 s instead of 60 s")
    parser.add_argument("--output", type=Path, help="write the figures as JSON")
    parser.add_argument("--simulated", action="store_true", help="run only the stream, in simulated time")
    options = parser.parse_args()
    seconds = 10.0 if options.quick else 60.0
    found = {}
    for name in ("stream",) if options.simulated else ("stream", "servoJ"):
        try:
            if options.simulated:
                with urlink.simulated_time(1):
                    found[name] = follow(name, "sim://ur5e?firmware=5.11", seconds)
            else:
                found[name] = measure(name, seconds)
        except ImportError:
            print(f"{name:8} needs ur_rtde")
            continue
        row = found[name]
        print(
            f"{name:8} {row['chunks']} chunks, out of points {row['starved']} times; jerk at most {row['jerk']:.0f}, "
            f"in 99 % {row['jerk_99']:.0f} rad/s³; acceleration {row['acceleration']:.1f} rad/s²; "
            f"error (99 %) {1e3 * row['error_first']:.1f} mrad at first, {1e3 * row['error_last']:.1f} at last"
        )
    if options.output:
        options.output.write_text(json.dumps({"seconds": seconds, "runs": found}) + "\n")


if __name__ == "__main__":
    main()

"""How quickly does a state become a set-point, and in how many cycles does it at all?

A simulated e-Series controller in a process of its own runs the uploaded program at 500 Hz; here, a loop answers each
state with a set-point through `robot.motion.servo`.

    python benchmarks/setpoints.py                     # 60 s
    python benchmarks/setpoints.py --output FILE       # writes the figures that the docs show
"""

from __future__ import annotations

import argparse
import json
import math
import multiprocessing
import time
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

import urlink
from urlink.simulator import Controller

RATE = 500
READY = [0.0, -1.6, 1.6, -1.6, -1.6, 0.0]


def serve(pipe: Connection) -> None:
    with Controller("UR5e", "5.11") as controller:
        pipe.send(dict(controller.ports))
        pipe.recv()


def measure(seconds: float) -> tuple[np.ndarray, np.ndarray, int]:
    """Seconds from the arrival of each state to its set-point having been sent, seconds that `send` took, and the
    cycles in which there was no state to answer, because a newer one was there already."""
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    server = context.Process(target=serve, args=(there,))
    server.start()
    ports = "&".join(f"{name}={number}" for name, number in here.recv().items())
    answered: list[float] = []
    sending: list[float] = []
    missed = 0
    with urlink.connect(f"ur://127.0.0.1?{ports}") as robot:
        robot.motion.move_joints(READY).wait()
        with robot.motion.servo() as servo:
            begin = last = robot.realtime.wait(5).time
            for state in robot.realtime:
                t = state.time - begin
                angle = 0.2 * math.sin(t) ** 2
                before = time.monotonic()
                servo.send([*READY[:5], READY[5] + angle])
                after = time.monotonic()
                assert state.received is not None
                answered.append(after - state.received.monotonic)
                sending.append(after - before)
                missed += round((state.time - last) * RATE) - 1 if len(answered) > 1 else 0
                last = state.time
                if t > seconds:
                    break
            print(servo.stats)
    here.send("done")
    server.join(10)
    return np.array(answered), np.array(sending), missed


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="5 s instead of 60 s")
    parser.add_argument("--output", type=Path, help="write the figures as JSON")
    options = parser.parse_args()
    seconds = 5.0 if options.quick else 60.0
    answered, sending, missed = measure(seconds)
    cycles = len(answered) + missed
    met = float(np.sum(answered <= 0.5 / RATE)) / cycles
    figures = {
        "rate": RATE,
        "seconds": seconds,
        "share_met": met,
        "skipped": missed,
        **{f"answer_{p}": float(np.percentile(answered, p)) for p in (50, 99)},
        **{f"send_{p}": float(np.percentile(sending, p)) for p in (50, 99)},
    }
    print(f"{cycles} cycles at {RATE} Hz: {met:.4%} answered within half a cycle, {missed} skipped")
    for name, what in (("answer", "state to set-point sent"), ("send", "send()")):
        print(f"{what}: p50 {figures[f'{name}_50'] * 1e6:.1f} us, p99 {figures[f'{name}_99'] * 1e6:.1f} us")
    if options.output is not None:
        options.output.parent.mkdir(parents=True, exist_ok=True)
        options.output.write_text(json.dumps(figures, indent=1) + "\n")


if __name__ == "__main__":
    main()

"""Simulated time that passes in a second of processor time.

A controller of 500 Hz, a network and a client run in `urlink.simulated_time`: with one subscription of the real-time
interface while the arm is at rest, with the same during a `move_joints`, and with a `servo` block that sends a
set-point in each cycle. Each case runs with several seeds, because the seed determines how often threads change. Two
further figures are measured in the same run and in turn, which no scheduler can avoid. One is the same controller
stepped in a loop that makes the packet of each cycle, without a client, a clock or a thread. The other is the change
from one thread to another and back.

    python benchmarks/simulated_time.py            # 10 s of simulated time each, five seeds
    python benchmarks/simulated_time.py --quick    # 2 s, three seeds
    python benchmarks/simulated_time.py --json     # prints one JSON object
"""

from __future__ import annotations

import argparse
import json
import math
import statistics
import threading
import time
from collections.abc import Callable

import urlink
from linkcore.simulated import Simulation
from urlink.simulator import Controller, Still

MODEL, FIRMWARE, RATE = "UR5e", "5.11", 500
HOST = "192.168.0.100"
READY = (0.0, -1.6, 1.6, -1.6, -1.6, 0.0)
#: Goal, as a multiple of real time.
GOAL = 60.0
#: Number of thread changes that are timed at once.
CHANGES = 5000


def subscribed(robot: urlink.Robot, seconds: float) -> None:
    """Wait with one subscription while the arm is at rest."""
    with robot.realtime.subscribe(lambda state: None):
        time.sleep(seconds)


def moving(robot: urlink.Robot, seconds: float) -> None:
    """Wait with one subscription while the arm moves."""
    with robot.realtime.subscribe(lambda state: None):
        robot.motion.move_joints([*READY[:5], 1.0], time=seconds).wait()


def servo(robot: urlink.Robot, seconds: float) -> None:
    """Send a set-point in each cycle."""
    with robot.motion.servo() as block:
        q = robot.realtime.wait(1.0).q_target.copy()
        for cycle in range(round(seconds * RATE)):
            robot.realtime.wait(1.0)
            q[5] = 0.5 - 0.5 * math.cos(cycle / RATE)
            block.send(q)


CASES: dict[str, Callable[[urlink.Robot, float], None]] = {
    "one subscription": subscribed,
    "move_joints": moving,
    "servo": servo,
}


def simulated(case: Callable[[urlink.Robot, float], None], seconds: float, seed: int) -> float:
    """Return the processor time for one second of simulated time, in s."""
    with urlink.simulated_time(seed) as sim:
        cell = sim.computer("cell", HOST)
        with sim.on(cell):
            controller = standing().start()
        with urlink.connect(HOST) as robot:
            robot.realtime.wait(1.0)
            taken = measured(sim, lambda: case(robot, seconds))
        with sim.on(cell):
            controller.close()
    return taken


def measured(sim: Simulation, run: Callable[[], object]) -> float:
    begun, now = time.process_time(), sim.now
    run()
    return (time.process_time() - begun) / (sim.now - now)


def standing() -> Controller:
    motion = Still()
    motion.start(READY)
    return Controller(MODEL, FIRMWARE, host=HOST, ports="standard", motion=motion)


def stepped(seconds: float) -> float:
    """Return the same for a controller that is stepped, with the packet of each cycle."""
    controller = standing()
    controller.step(10)
    begun = time.process_time()
    for _ in range(round(seconds * RATE)):
        controller.step()
        controller.realtime_packet()
    return (time.process_time() - begun) / seconds


def change_of_threads() -> float:
    """Return the processor time of a change from one thread to another, in s."""
    here, there = threading.Lock(), threading.Lock()
    here.acquire()
    there.acquire()

    def answer() -> None:
        for _ in range(CHANGES):
            there.acquire()
            here.release()

    thread = threading.Thread(target=answer)
    thread.start()
    begun = time.process_time()
    for _ in range(CHANGES):
        there.release()
        here.acquire()
    taken = time.process_time() - begun
    thread.join()
    return taken / CHANGES / 2


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="2 s with three seeds instead of 10 s with five")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    options = parser.parse_args()
    seconds, seeds = (2.0, 3) if options.quick else (10.0, 5)
    runs: dict[str, list[float]] = {name: [] for name in CASES}
    steps, changes = [], []
    for seed in range(seeds):
        for name, case in CASES.items():
            runs[name].append(simulated(case, seconds, seed))
            steps.append(stepped(seconds))
            changes.append(change_of_threads())
    floor, change = statistics.median(steps), statistics.median(changes)
    figures = {
        name: {
            "times_real_time": 1.0 / statistics.median(taken),
            "microseconds_a_cycle": 1e6 * statistics.median(taken) / RATE,
            "times_the_stepped_controller": statistics.median(taken) / floor,
        }
        for name, taken in {**runs, "stepped, no client": steps}.items()
    }
    if options.json:
        print(json.dumps({**figures, "microseconds_a_change_of_threads": 1e6 * change}))
        return
    print(f"{seconds:g} s of simulated time at {RATE} Hz, processor time, medians of {seeds} seeds")
    for name, row in figures.items():
        print(
            f"  {name:20} {row['times_real_time']:6.1f} x real time {row['microseconds_a_cycle']:6.0f} µs per cycle"
            f" {row['times_the_stepped_controller']:6.2f} x the stepped controller"
        )
    print(
        f"  a change of threads takes {1e6 * change:.1f} µs; the goal is {GOAL:g} x, "
        f"{1e6 / GOAL / RATE:.0f} µs per cycle"
    )


if __name__ == "__main__":
    main()

"""Simulated time that passes in a second of processor time.

A program of a robot cell runs in `urlink.simulated_time`: a loop of `move_joints`, an output and a pause of 1 s. It
runs on an e-Series and on a CB3, with one subscription that reads `q_actual` and without one, and with four arms at
once. It also runs on an e-Series at `frequency=125`, for which no floor and goal are set. A `servo` block sends a
set-point in each cycle of 500 Hz. Two further figures are measured in the same run and in turn. One is a controller
that is stepped in a loop that makes the packet of each cycle, without a client, a clock or a thread. The other is the
change from one thread to another and back.

    python benchmarks/simulated_time.py            # 20 s of simulated time each, medians of five seeds
    python benchmarks/simulated_time.py --quick    # 3 s, three seeds
    python benchmarks/simulated_time.py --json     # prints one JSON object
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import statistics
import threading
import time
from collections.abc import Callable
from functools import partial

import urlink
from linkcore.simulated import Simulation
from urlink.simulator import Controller, Still

E_SERIES, CB3 = "sim://ur5e?firmware=5.11", "sim://ur5?firmware=3.15"
#: e-Series that executes 125 cycles per second instead of 500.
SLOW = f"{E_SERIES}&frequency=125"
RATE = 500
READY, AWAY = (0.0, -1.6, 1.6, -1.6, -1.6, 0.0), (0.6, -1.4, 1.4, -1.6, -1.6, 0.5)
#: Duration of the pause in the cell program, in s.
PAUSE = 1.0
#: Number of thread changes that are timed at once.
CHANGES = 5000


def cell(robot: urlink.Robot, sim: Simulation, seconds: float) -> None:
    """Move, set an output and pause, until the simulated time has passed."""
    until, is_away = sim.now + seconds, False
    while sim.now < until:
        is_away = not is_away
        robot.motion.move_joints(AWAY if is_away else READY).wait()
        robot.io.set_digital_out(0, is_away)
        time.sleep(PAUSE)


def subscribed(robot: urlink.Robot, sim: Simulation, seconds: float) -> None:
    """Run the cell program while a subscription reads one field of each state."""
    with robot.realtime.subscribe(lambda state: state.q_actual):
        cell(robot, sim, seconds)


def servo(robot: urlink.Robot, sim: Simulation, seconds: float) -> None:
    """Send a set-point in each cycle."""
    with robot.motion.servo() as block:
        q = robot.realtime.wait(1.0).q_target.copy()
        for cycle in range(round(seconds * RATE)):
            robot.realtime.wait(1.0)
            q[5] = 0.5 - 0.5 * math.cos(cycle / RATE)
            block.send(q)


Program = Callable[[urlink.Robot, Simulation, float], None]


def four(robots: list[urlink.Robot], sim: Simulation, seconds: float) -> None:
    """Run the cell program on four arms, in a thread each."""
    threads = [threading.Thread(target=subscribed, args=(robot, sim, seconds)) for robot in robots]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()


#: Name -> program, address, number of arms, and floor and goal as multiples of real time.
CASES: dict[str, tuple[Program, str, int, tuple[float, float]]] = {
    "e-Series, subscription": (subscribed, E_SERIES, 1, (20.0, 60.0)),
    "e-Series": (cell, E_SERIES, 1, (50.0, 100.0)),
    "e-Series, servo": (servo, E_SERIES, 1, (4.0, 8.0)),
    "four e-Series": (subscribed, E_SERIES, 4, (5.0, 15.0)),
    "CB3, subscription": (subscribed, CB3, 1, (60.0, 150.0)),
    "CB3": (cell, CB3, 1, (60.0, 150.0)),
    "e-Series at 125 Hz, subscription": (subscribed, SLOW, 1, (math.nan, math.nan)),
}


def simulated(case: Program, address: str, arms: int, seconds: float, seed: int) -> float:
    """Return the processor time for one second of simulated time, in s."""
    with urlink.simulated_time(seed) as sim, contextlib.ExitStack() as stack:
        robots = [stack.enter_context(urlink.connect(address)) for _ in range(arms)]
        for robot in robots:
            robot.realtime.wait(1.0)
        run = partial(four, robots) if arms > 1 else partial(case, robots[0])
        begun, now = time.process_time(), sim.now
        run(sim, seconds)
        return (time.process_time() - begun) / (sim.now - now)


def stepped(seconds: float) -> float:
    """Return the same for a controller that is stepped, with the packet of each cycle."""
    motion = Still()
    motion.start(READY)
    controller = Controller("UR5e", "5.11", motion=motion)
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
    parser.add_argument("--quick", action="store_true", help="3 s with three seeds instead of 20 s with five")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    options = parser.parse_args()
    seconds, seeds = (3.0, 3) if options.quick else (20.0, 5)
    for case, address, arms, _ in CASES.values():  # imports are not measured
        simulated(case, address, arms, 0.5, 0)
    runs: dict[str, list[float]] = {name: [] for name in CASES}
    steps, changes = [], []
    for seed in range(seeds):
        for name, (case, address, arms, _) in CASES.items():
            runs[name].append(simulated(case, address, arms, seconds, seed))
            steps.append(stepped(1.0))
            changes.append(change_of_threads())
    floor, change = statistics.median(steps), statistics.median(changes)
    figures = {
        name: {
            "times_real_time": 1.0 / statistics.median(taken),
            "times_the_stepped_controller": statistics.median(taken) / floor,
        }
        for name, taken in {**runs, "stepped, no client": steps}.items()
    }
    if options.json:
        print(json.dumps({**figures, "microseconds_a_change_of_threads": 1e6 * change}))
        return
    print(f"{seconds:g} s of simulated time, processor time, medians of {seeds} seeds")
    for name, row in figures.items():
        least, goal = CASES[name][3] if name in CASES else (math.nan, math.nan)
        wanted = "" if math.isnan(least) else f"(floor {least:g}, goal {goal:g})"
        print(
            f"  {name:32} {row['times_real_time']:6.1f} x real time {wanted:21} "
            f"{row['times_the_stepped_controller']:6.2f} x the stepped controller"
        )
    print(f"  a change of threads takes {1e6 * change:.1f} µs")


if __name__ == "__main__":
    main()

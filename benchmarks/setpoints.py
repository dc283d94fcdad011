"""Time from a state to its set-point, and the number of cycles in which the set-point is sent when it is due.

A simulated e-Series controller in a separate process runs the uploaded program at 500 Hz. A loop in this process
answers each state with a set-point, using `robot.motion.servo`. A set-point is due when the state of its cycle usually
arrives: at the time of that state on the controller's clock, plus the median of the differences to the clock here. So a
cycle also counts as missed if the sender or the machine delayed the state; a separate line shows how many states were
not delayed. A cycle without a set-point counts as missed.

The capability of the machine itself is measured before and after, for half of the time each: a process sends the same
number of bytes at the same rate by the clock to a loop around `recv`.

    python benchmarks/setpoints.py                     # 60 s
    python benchmarks/setpoints.py --output FILE       # writes the figures
"""

from __future__ import annotations

import argparse
import json
import math
import multiprocessing
import socket
import time
from pathlib import Path

import numpy as np
from _simulated import simulated

import urlink

RATE = 500
#: Size of a real-time packet, in bytes.
SIZE = 1220
READY = (0.0, -1.6, 1.6, -1.6, -1.6, 0.0)
#: Fraction of the cycles that should be met within half a cycle.
GOAL = 0.999
#: Number of cycles before the stream calls the loop directly; they are sent, but not measured.
WARMING = 250


def send_by_the_clock(port: int, count: int) -> None:
    with socket.create_connection(("127.0.0.1", port)) as link:
        link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        begin = time.monotonic()
        for number in range(count):
            wait = begin + number / RATE - time.monotonic()
            if wait > 0:
                time.sleep(wait)
            link.sendall(bytes(SIZE))


def bare(seconds: float) -> float:
    """Return the fraction of the cycles that a loop around `recv` meets."""
    count = round(seconds * RATE)
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
        sender = multiprocessing.get_context("spawn").Process(target=send_by_the_clock, args=(port, count))
        sender.start()
        link, _ = listener.accept()
    met = []
    with link:
        for _ in range(count):
            link.recv(SIZE, socket.MSG_WAITALL)
            met.append(time.monotonic())
    sender.join(10)
    off = np.array(met) - np.arange(count) / RATE
    return float(np.mean(np.abs(off - np.median(off)) <= 0.5 / RATE))


def measure(seconds: float) -> dict[str, float]:
    """Return the figures of one run."""
    rows: list[tuple[float, float, float, float]] = []
    arrivals: list[tuple[float, float]] = []

    def note(state: urlink.packets.RealtimeState) -> None:
        assert state.received is not None
        arrivals.append((state.time, state.received.monotonic))

    with simulated("UR5e", "5.11") as address, urlink.connect(address) as robot:
        robot.motion.move_joints(READY).wait()
        # With this watchdog, a delay is counted instead of ending the run.
        with robot.motion.servo(watchdog=1.0) as servo, robot.realtime.subscribe(note):
            begin = robot.realtime.wait(5).time
            for state in robot.realtime:
                t = state.time - begin
                q = [*READY[:5], 0.2 * math.sin(t) ** 2]
                before = time.monotonic()
                servo.send(q)
                after = time.monotonic()
                assert state.received is not None
                rows.append((state.time, state.received.monotonic, before, after))
                if t > seconds + WARMING / RATE:
                    break
    clock, arrived, before_, after_ = np.array(rows[WARMING:]).T
    every, all_arrived = np.array([each for each in arrivals if clock[0] <= each[0] <= clock[-1]]).T
    cycles = round((clock[-1] - clock[0]) * RATE) + 1
    way = np.median(all_arrived - every)
    due = clock + way
    in_time = np.sum(np.abs(all_arrived - every - way) <= 0.5 / RATE)
    return {
        "rate": RATE,
        "seconds": seconds,
        "cycles": cycles,
        "skipped": cycles - len(clock),
        "share_met": float(np.sum(np.abs(after_ - due) <= 0.5 / RATE)) / cycles,
        "share_answered": float(np.sum(after_ - arrived <= 0.5 / RATE)) / cycles,
        "share_arrived": float(in_time) / cycles,
        **{f"send_{p}": float(np.percentile(after_ - before_, p)) for p in (50, 99)},
        **{f"answer_{p}": float(np.percentile(after_ - arrived, p)) for p in (50, 99)},
        **{f"due_{p}": float(np.percentile(after_ - due, p)) for p in (50, 99)},
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="5 s instead of 60 s")
    parser.add_argument("--output", type=Path, help="write the figures as JSON")
    options = parser.parse_args()
    seconds = 5.0 if options.quick else 60.0
    before = bare(seconds / 2)
    figures = measure(seconds)
    figures["share_bare"] = (before + bare(seconds / 2)) / 2
    print(f"{figures['cycles']} cycles at {RATE} Hz, {figures['skipped']} of them skipped")
    print(f"  sent within half a cycle of when due      {figures['share_met']:8.3%}   (goal: {GOAL:.1%})")
    print(f"  ... of the arrival of the state           {figures['share_answered']:8.3%}")
    print(f"  states that arrived within half a cycle   {figures['share_arrived']:8.3%}")
    print(f"  a bare loop around recv                   {figures['share_bare']:8.3%}")
    for name, what in (("send", "send()"), ("answer", "arrival of a state to sent"), ("due", "due to sent")):
        p50, p99 = (figures[f"{name}_{p}"] * 1e6 for p in (50, 99))
        print(f"  {what:30} p50 {p50:7.0f} us   p99 {p99:7.0f} us")
    if options.output is not None:
        options.output.parent.mkdir(parents=True, exist_ok=True)
        options.output.write_text(json.dumps(figures, indent=1) + "\n")


if __name__ == "__main__":
    main()

"""Jitter experiment of the original driver: the regularity of updates at the callback.

A simulated CB3 controller in a separate process sends at 125 Hz, and the callback records the time of each call. With
the original C++ driver, 99 % of the updates arrived between 7.5 and 8.5 ms after the previous one.

    python benchmarks/jitter.py                     # 60 s
    python benchmarks/jitter.py --output FILE       # writes the histogram that the docs show
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import time
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

import urlink
from urlink.simulator import Controller, Demonstration

RATE = 125
BAND = (7.5e-3, 8.5e-3)


def serve(pipe: Connection) -> None:
    with Controller("UR5", "3.4", motion=Demonstration()) as controller:
        pipe.send(dict(controller.ports))
        pipe.recv()


def measure(seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the periods between callbacks, and between the arrivals of their bytes, in s."""
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    server = context.Process(target=serve, args=(there,))
    server.start()
    ports = "&".join(f"{name}={number}" for name, number in here.recv().items())
    called: list[float] = []
    arrived: list[float] = []

    def note(state: urlink.packets.RealtimeState) -> None:
        called.append(time.monotonic())
        arrived.append(state.received.monotonic if state.received is not None else 0.0)

    with urlink.connect(f"ur://127.0.0.1?{ports}") as robot:
        robot.realtime.wait(5)
        subscription = robot.realtime.subscribe(note)
        time.sleep(seconds)
        subscription.close()
        stats = robot.realtime.stats
    here.send("done")
    server.join(10)
    own = subscription.stats
    assert stats.received == stats.decoded + stats.failed
    assert own.offered == own.delivered + own.dropped + own.raised + own.waiting
    if own.dropped or stats.failed:
        raise SystemExit(f"packets were lost: {stats}, {own}")
    return np.diff(called), np.diff(arrived)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="5 s instead of 60 s")
    parser.add_argument("--output", type=Path, help="write the histogram as JSON")
    options = parser.parse_args()
    seconds = 5.0 if options.quick else 60.0
    called, arrived = measure(seconds)
    share = {
        name: float(np.mean((periods >= BAND[0]) & (periods <= BAND[1])))
        for name, periods in {"callback": called, "arrival": arrived}.items()
    }
    edges = np.linspace(6.0, 10.0, 81)
    counts, _ = np.histogram(np.clip(called * 1e3, edges[0], edges[-1]), edges)
    print(f"{len(called)} periods at {RATE} Hz: mean {called.mean() * 1e3:.4f} ms, std {called.std() * 1e6:.1f} us")
    print(f"share between 7.5 and 8.5 ms: callbacks {share['callback']:.4%}, received bytes {share['arrival']:.4%}")
    if options.output is not None:
        options.output.parent.mkdir(parents=True, exist_ok=True)
        result = {
            "rate": RATE,
            "seconds": seconds,
            "share_in_band": share["callback"],
            "share_in_band_of_arrivals": share["arrival"],
            "periods_ms": {"edges": edges.round(4).tolist(), "counts": counts.tolist()},
        }
        options.output.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()

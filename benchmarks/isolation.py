"""Age of the robot's states in a program that computes all the time.

A sender in another process writes real-time packets at 500 Hz; each packet contains the time of sending. The receiver
reads them while a thread computes in pure Python: once as usual, once with each of `urlink.realtime_options`, and once
with a separate process that reads (`connect(..., isolate=True)`). There are two figures for each, in ms:

- callback: from sending to an inline callback;
- asked: the age of `stream.latest` when the main thread reads it, after 20 ms in a C function that blocks all threads.

    python benchmarks/isolation.py            # 10 s per run
    python benchmarks/isolation.py --quick    # 2 s per run
"""

from __future__ import annotations

import argparse
import contextlib
import json
import logging
import multiprocessing
import time
from multiprocessing.connection import Connection
from typing import Any

import numpy as np
from end_to_end import send, spin

import urlink
from linkcore.net.isolated_transport import IsolatedTransport
from linkcore.net.transport import TcpTransport, Transport
from linkcore.streaming.connection_life import Backoff
from urlink.packets import RealtimeState
from urlink.protocol.firmware import Firmware
from urlink.protocol.realtime.protocol import RealtimeProtocol
from urlink.session.identity import Identity
from urlink.session.source import Source

#: Options of each way, and whether another process reads.
WAYS: dict[str, tuple[dict[str, Any], bool]] = {
    "as usual": ({}, False),
    "priority=50": ({"priority": 50}, False),
    "gc='freeze', lock_memory": ({"gc": "freeze", "lock_memory": True}, False),
    "switch_interval=0.0005": ({"switch_interval": 0.0005}, False),
    "isolate": ({}, True),
    "isolate, switch_interval=0.0005": ({"switch_interval": 0.0005}, True),
}
#: Time, in s, for which the main thread blocks all other threads.
HOLD = 0.02


def send_until_left(ports: Connection, seconds: float) -> None:
    with contextlib.suppress(ConnectionError):  # the receiver has received enough
        send(ports, seconds, 0, 1)


def receive(port: int, results: Connection, seconds: float, way: str) -> None:
    logging.getLogger("linkcore").setLevel(logging.ERROR)
    options, is_isolated = WAYS[way]
    report = urlink.realtime_options(**options)
    spin(True)

    def transport(interface: str) -> Transport:
        if not is_isolated:
            return TcpTransport("127.0.0.1", port, silence=5.0)
        boundary = "urlink.protocol.realtime.protocol:RealtimeBoundary"
        decode = RealtimeProtocol().decode
        return IsolatedTransport("127.0.0.1", port, silence=5.0, boundary=boundary, decode=decode)

    identity = Identity(Firmware(5, 10), True, None)
    source = Source(lambda: identity, transport, Backoff(tries=0), 5.0, 5.0, False)
    stream = source.stream("realtime", "benchmark", lambda: None)
    called: list[float] = []
    asked: list[float] = []

    def note(state: RealtimeState) -> None:
        called.append(time.monotonic() - state.time)

    stream.subscribe(note, inline=True)
    numbers = list(range(1000))
    began = time.perf_counter()
    sum(numbers * 100)
    numbers *= max(round(HOLD / (time.perf_counter() - began) * 100), 1)
    until = time.monotonic() + seconds - 0.5
    while time.monotonic() < until:
        sum(numbers)  # in C, during which no other thread runs
        state = stream.latest
        if state is not None:
            asked.append(time.monotonic() - state.time)
        time.sleep(0.005)
    stream.close()
    figures = {
        f"{what} {name} ms": float(np.percentile(values[len(values) // 10 :], share)) * 1e3
        for what, values in (("callback", called), ("asked", asked))
        for name, share in (("p50", 50), ("p99", 99))
    }
    results.send({**figures, "refused": ", ".join(report.refused)})


def run(way: str, seconds: float) -> dict[str, Any]:
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    sender = context.Process(target=send_until_left, args=(there, seconds), daemon=True)
    sender.start()
    mine, theirs = context.Pipe()
    receiver = context.Process(target=receive, args=(here.recv(), theirs, seconds, way))
    receiver.start()
    figures: dict[str, Any] = mine.recv()
    receiver.join(10)
    sender.terminate()
    sender.join(10)
    return figures


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="2 s per run instead of 10 s")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    options = parser.parse_args()
    figures = {way: run(way, 2.0 if options.quick else 10.0) for way in WAYS}
    if options.json:
        print(json.dumps(figures))
        return
    for way, values in figures.items():
        shown = ", ".join(f"{name} {value:.2f}" for name, value in values.items() if name != "refused")
        print(f"{way:32} {shown}{'; refused: ' + values['refused'] if values['refused'] else ''}")


if __name__ == "__main__":
    main()

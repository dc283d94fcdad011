"""From a sender in another process to the user's callback: latency, processor time, and the effect of a flood.

A sender process writes real-time packets to loopback sockets. The receiver is either the loop that a person would write
by hand (`recv`, cut at the length, read the time), or a urlink stream in one of three ways: with an inline callback,
with a callback in a dedicated thread, or with a `for` loop. Each receiver has a separate process. They take turns, so
that all run under the same conditions. The figures are ratios to the bare loop.

    python benchmarks/end_to_end.py            # 10 s per run
    python benchmarks/end_to_end.py --quick    # 2 s per run
    python benchmarks/end_to_end.py --instructions   # processor instructions per packet, with valgrind
    python benchmarks/end_to_end.py --instructions --batch 10   # the same when 10 packets arrive at once

On a shared machine, times of the same receiver differ by a fifth from run to run. The number of instructions that the
receiver executes for a packet, outside the kernel, differs less: by a hundredth for the bare loop, and by less than a
tenth for an inline callback. So two revisions of the receive path are compared by instructions. With another thread,
the number differs by up to a sixth, because the cost of waiting and waking depends on other programs.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import logging
import multiprocessing
import os
import re
import shutil
import socket
import struct
import subprocess
import sys
import threading
import time
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any

import numpy as np

from linkcore.errors import RemoteError
from linkcore.net.transport import TcpTransport
from linkcore.streaming.connection_life import Backoff
from linkcore.streaming.packet_queue import drop_oldest
from urlink.packets import RealtimeState
from urlink.protocol.firmware import Firmware
from urlink.session.identity import Identity
from urlink.session.source import Source

RATE = 500
#: Packet rate at which instructions are counted, in Hz. Valgrind is slow. Packets that arrive while it processes the
#: previous packet are read together, which costs less, so at 500 Hz the count would depend on the load of the computer.
COUNTED_RATE = 100
#: Number of packets before the measurement starts: half a second, for imports, caches and other first-time costs.
WARM_UP = 250
#: The loop written by hand, and the ways to use a stream.
WAYS = ("bare", "inline", "own thread", "iteration")
PACKET = bytes(RealtimeState("5.10", q_actual=[0.1, -1.5, 1.2, -1.3, -1.5, 0.0]))
SIZE = len(PACKET)
_TIME = struct.Struct(">d")


def send(ports: Connection, seconds: float, flood: int, batch: int, rate: int = RATE) -> None:
    """Serve one connection: paced packets with the time of sending, or a flood of packets.

    Paced packets are sent `batch` at a time. Their times are one period apart, like those of a controller whose packets
    were delayed.
    """
    with socket.create_server(("127.0.0.1", 0)) as server:
        ports.send(server.getsockname()[1])
        connection, _ = server.accept()
        with connection:
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            if flood:
                many = PACKET * 64
                for _ in range(flood // 64):
                    connection.sendall(many)
            else:
                head, tail = PACKET[:4], PACKET[12:]
                start = time.monotonic() + 0.2
                for number in range(0, int(seconds * rate), batch):
                    pause = start + number / rate - time.monotonic()
                    if pause > 0:
                        time.sleep(pause)
                    now = time.monotonic() if batch == 1 else start + number / rate
                    times = (now + each / rate for each in range(batch))
                    connection.sendall(b"".join(head + _TIME.pack(each) + tail for each in times))
            connection.shutdown(socket.SHUT_WR)
            with contextlib.suppress(ConnectionResetError):
                connection.recv(1)  # until the receiver has finished


def receive_raw(port: int, results: Connection, total: int, busy: bool) -> None:
    """Receive with the loop that a person would write by hand."""
    spin(busy)
    latencies = []
    count = 0
    with socket.create_connection(("127.0.0.1", port)) as connection:
        meter = Meter()
        rest = b""
        while True:
            data = connection.recv(65536)
            if not data:
                break
            now = time.monotonic()
            rest += data
            at = 0
            while len(rest) - at >= 4:
                (size,) = struct.unpack_from(">i", rest, at)
                if len(rest) - at < size:
                    break
                packet = rest[at : at + size]
                count += 1
                if not total:
                    latencies.append(now - _TIME.unpack_from(packet, 4)[0])
                    if len(latencies) == WARM_UP:
                        meter = Meter()
                at += size
            rest = rest[at:]
        results.send(meter.report(count, latencies))


def receive_stream(port: int, results: Connection, total: int, busy: bool, way: str) -> None:
    """Receive with a urlink stream, in one of the three ways to use it."""
    logging.getLogger("linkcore").setLevel(logging.ERROR)  # the end of the sender is expected
    spin(busy)
    latencies: list[float] = []
    meters = [Meter()]
    seen = [0]

    def measure(state: RealtimeState) -> None:
        latencies.append(time.monotonic() - state.time)
        if len(latencies) == WARM_UP:
            meters.append(Meter())

    def count(state: RealtimeState) -> None:
        seen[0] += 1

    callback = count if total else measure
    transport = TcpTransport("127.0.0.1", port, silence=5.0)
    identity = Identity(Firmware(5, 10), True, None)
    source = Source(lambda: identity, lambda interface: transport, Backoff(tries=0), 5.0, 5.0, False)
    stream = source.stream("realtime", "benchmark", lambda: None)
    if way == "iteration":
        with contextlib.suppress(RemoteError):  # the stream raises this when the sender ends
            for state in stream.iterate(drop_oldest(256)):
                callback(state)
        outcome = meters[-1].report(stream.stats.received, latencies)
        outcome["dropped"] = stream.stats.decoded - (seen[0] if total else len(latencies))
    else:
        subscription = stream.subscribe(callback, inline=way == "inline")
        stream.join(600)
        outcome = meters[-1].report(stream.stats.received, latencies)
        own = subscription.stats
        assert own.offered == own.delivered + own.dropped + own.raised + own.waiting == stream.stats.decoded, own
        assert own.delivered == (seen[0] if total else len(latencies)), own
        outcome["dropped"] = own.dropped
    stats = stream.stats
    assert stats.received == stats.decoded + stats.failed, stats
    assert stats.failed == 0, stats
    stream.close()
    results.send(outcome)


def spin(busy: bool) -> None:
    """Start a Python thread that computes all the time, like a user's program might."""

    def work() -> None:
        value = 1
        while True:
            value = value * 1103515245 % 2147483648

    if busy:
        threading.Thread(target=work, daemon=True).start()


class Meter:
    """Measurement of processor time and latencies from now on."""

    def __init__(self) -> None:
        self.cpu, self.began = time.process_time(), time.monotonic()

    def report(self, count: int, latencies: list[float]) -> dict[str, Any]:
        outcome: dict[str, Any] = {
            "count": count,
            "measured": max(len(latencies) - WARM_UP, 0),
            "seconds": time.monotonic() - self.began,
            "cpu": time.process_time() - self.cpu,
        }
        if latencies:
            warm = latencies[WARM_UP:]
            outcome["p50"], outcome["p99"] = (float(np.percentile(warm, share)) * 1e6 for share in (50, 99))
        return outcome


def sending(seconds: float, flood: int, batch: int = 1, rate: int = RATE) -> tuple[BaseProcess, int]:
    """Start a process that sends, and return it with its port."""
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    sender = context.Process(target=send, args=(there, seconds, flood, batch, rate))
    sender.start()
    return sender, here.recv()


def receive(way: str, port: int, results: Connection, total: int, busy: bool) -> None:
    """Receive with the loop written by hand, or with a stream."""
    if way == "bare":
        receive_raw(port, results, total, busy)
    else:
        receive_stream(port, results, total, busy, way)


def run(way: str, seconds: float, flood: int, busy: bool) -> dict[str, Any]:
    """Run one sender process and one receiver process."""
    sender, port = sending(seconds, flood)
    context = multiprocessing.get_context("spawn")
    mine, theirs = context.Pipe()
    process = context.Process(target=receive, args=(way, port, theirs, flood, busy))
    process.start()
    outcome: dict[str, Any] = mine.recv()
    process.join(10)
    sender.join(10)
    if outcome["count"] != (flood or int(seconds * RATE)):
        raise SystemExit(f"{way}: {outcome['count']} packets arrived, of {flood or seconds * RATE}")
    return outcome


def compare(seconds: float, rounds: int, busy: bool) -> dict[str, float]:
    """Return the medians over the rounds of the ratios to the bare loop of the same round."""
    turns = [{way: run(way, seconds, 0, busy) for way in WAYS} for _ in range(rounds)]
    figures = {f"bare {name} us": [turn["bare"][name] for turn in turns] for name in ("p50", "p99")}
    figures["bare cpu us"] = [turn["bare"]["cpu"] / turn["bare"]["measured"] * 1e6 for turn in turns]
    for way in WAYS[1:]:
        for name in ("p50", "p99", "cpu"):
            figures[f"{way} {name} ratio"] = [turn[way][name] / turn["bare"][name] for turn in turns]
        figures[f"{way} dropped"] = [turn[way]["dropped"] for turn in turns]
    return {name: float(np.median(values)) for name, values in figures.items()}


def flood(packets: int, rounds: int) -> dict[str, float]:
    """Return the medians over the rounds of the ratios of packets per second."""
    turns = [{way: run(way, 0, packets, False) for way in WAYS} for _ in range(rounds)]
    figures = {"bare packets per s": [turn["bare"]["count"] / turn["bare"]["seconds"] for turn in turns]}
    for way in WAYS[1:]:
        figures[f"{way} ratio"] = [turn["bare"]["seconds"] / turn[way]["seconds"] for turn in turns]
        figures[f"{way} dropped share"] = [turn[way]["dropped"] / turn[way]["count"] for turn in turns]
    return {name: float(np.median(values)) for name, values in figures.items()}


def instructions(way: str, batch: int) -> float:
    """Return the instructions per packet, as the difference between a longer and a shorter run."""
    counts = [_instructions(way, packets, batch) for packets in (500, 2000)]
    return (counts[1] - counts[0]) / 1500


def _instructions(way: str, packets: int, batch: int) -> int:
    sender, port = sending(packets / COUNTED_RATE, 0, batch, COUNTED_RATE)
    # Waiting threads of numpy spin in a loop, which would be counted.
    env = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "PYTHONHASHSEED": "0"}
    receiver = [sys.executable, __file__, "--receive", way, str(port)]
    counted = ["valgrind", "--tool=callgrind", "--callgrind-out-file=/dev/null", *receiver]
    done = subprocess.run(counted, env=env, capture_output=True, text=True, timeout=300)
    sender.join(10)
    found = re.search(r"Collected : (\d+)", done.stderr)
    if done.returncode or found is None:
        raise SystemExit(f"{way}: the receiver under valgrind ended with {done.returncode}: {done.stderr[-500:]}")
    return int(found[1])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="2 s per run instead of 10 s, and fewer packets")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--instructions", action="store_true", help="count instructions, with valgrind")
    parser.add_argument(
        "--batch", type=int, default=1, help="number of packets that arrive at once, for --instructions"
    )
    parser.add_argument("--receive", nargs=2, metavar=("WAY", "PORT"), help="only receive (used with valgrind)")
    options = parser.parse_args()
    if options.receive:
        way, port = options.receive
        _, results = multiprocessing.Pipe()
        receive(way, int(port), results, 0, False)
        return
    if options.instructions:
        if shutil.which("valgrind") is None:
            parser.error("--instructions needs valgrind (apt install valgrind)")
        found = {way: instructions(way, options.batch) for way in WAYS}
        for way, count in found.items():
            print(f"{way:12} {count:8.0f} instructions per packet, {count / found['bare']:.2f} of bare")
        return
    seconds, rounds = (2.0, 1) if options.quick else (10.0, 3)
    figures = {
        "500 Hz": compare(seconds, rounds, busy=False),
        "500 Hz, with a busy Python thread": compare(seconds, rounds, busy=True),
        "flood": flood(64 * (4000 if options.quick else 8000), rounds),
    }
    if options.json:
        print(json.dumps(figures))
        return
    for title, values in figures.items():
        print(title)
        for name, value in values.items():
            print(f"  {name:24} {value:12.3f}")


if __name__ == "__main__":
    main()

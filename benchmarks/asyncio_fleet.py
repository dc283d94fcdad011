"""Ten robots at 500 Hz in one program: read by one event loop, compared with one thread per robot.

A sender in another process writes real-time packets to ten connections; each packet contains the time of sending. The
receiver is either one event loop with ten tasks, or ten threads with a `for` loop each. No packet may be lost. Both
take turns, each in a separate process. The figures are those of the loop, and their ratios to the figures of the
threads.

    python benchmarks/asyncio_fleet.py            # 10 s per run
    python benchmarks/asyncio_fleet.py --quick    # 2 s per run
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import functools
import json
import logging
import multiprocessing
import socket
import struct
import threading
import time
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from linkcore.aio.async_stream import AsyncStream
from linkcore.aio.loop_connection import LoopConnection
from linkcore.errors import RemoteError
from linkcore.net.awaited import AwaitedTcp
from linkcore.net.transport import TcpTransport
from linkcore.streaming.connection_life import Backoff
from linkcore.streaming.packet_queue import block
from linkcore.streaming.stream import Stream
from urlink.packets import RealtimeState
from urlink.protocol.firmware import Firmware
from urlink.session.identity import Identity
from urlink.session.source import Source

ROBOTS = 10
RATE = 500
#: Number of packets of each robot before the measurement starts.
WARM_UP = 250
PACKET = bytes(RealtimeState("5.10", q_actual=[0.1, -1.5, 1.2, -1.3, -1.5, 0.0]))
_TIME = struct.Struct(">d")


def send(pipe: Connection, seconds: float) -> None:
    """Serve ten connections in turn, each at 500 Hz."""
    with socket.create_server(("127.0.0.1", 0), backlog=ROBOTS) as server, contextlib.ExitStack() as stack:
        pipe.send(server.getsockname()[1])
        robots = [stack.enter_context(server.accept()[0]) for _ in range(ROBOTS)]
        for robot in robots:
            robot.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        head, tail = PACKET[:4], PACKET[12:]
        start = time.monotonic() + 0.2
        steps = int(seconds * RATE) * ROBOTS
        for step in range(steps):
            # The robots of a fleet have different clocks, so their packets do not arrive together.
            pause = start + step / (RATE * ROBOTS) - time.monotonic()
            if pause > 0:
                time.sleep(pause)
            robots[step % ROBOTS].sendall(head + _TIME.pack(time.monotonic()) + tail)
        for robot in robots:
            robot.shutdown(socket.SHUT_WR)
        pipe.recv()


def source(port: int, **options: Any) -> Source:
    identity = Identity(Firmware(5, 10), True, None)
    tcp = options.pop("tcp")
    return Source(
        lambda: identity,
        lambda interface: tcp("127.0.0.1", port, silence=5.0),
        Backoff(tries=0),
        5.0,
        5.0,
        False,
        **options,
    )


class Latencies:
    """Latencies from sending to the user's code, and processor time after the warm-up."""

    def __init__(self) -> None:
        self.robots: list[list[float]] = []
        self.cpu = 0.0
        self._lock = threading.Lock()

    def of_one(self) -> list[float]:
        with self._lock:
            self.robots.append([])
            return self.robots[-1]

    def begin(self) -> None:
        self.cpu = time.process_time()

    def report(self, dropped: int) -> dict[str, Any]:
        cpu = time.process_time() - self.cpu
        warm = [value for robot in self.robots for value in robot[WARM_UP:]]
        p50, p99 = (float(np.percentile(warm, share)) * 1e6 for share in (50, 99))
        return {
            "received": sum(map(len, self.robots)),
            "dropped": dropped,
            "p50 us": p50,
            "p99 us": p99,
            "cpu us a packet": cpu / len(warm) * 1e6,
            "threads": threading.active_count(),
        }


def read_with_loop(port: int, results: Connection) -> None:
    logging.getLogger("linkcore").setLevel(logging.ERROR)  # the end of the sender is expected
    latencies = Latencies()

    async def read(stream: AsyncStream[RealtimeState]) -> int:
        mine = latencies.of_one()
        packets = stream.iterate(block)
        with contextlib.suppress(RemoteError):  # the sender has ended
            async for state in packets:
                mine.append(time.monotonic() - state.time)
                if len(mine) == WARM_UP:
                    latencies.begin()
        await stream.close()
        return packets.stats.dropped

    async def fleet() -> dict[str, Any]:
        made = source(
            port, tcp=AwaitedTcp, connection=functools.partial(LoopConnection, loop=asyncio.get_running_loop())
        )
        streams = [AsyncStream(made.stream("realtime", f"robot {n}", lambda: None)) for n in range(ROBOTS)]
        return latencies.report(sum(await asyncio.gather(*map(read, streams))))

    results.send(asyncio.run(fleet()))


def read_with_threads(port: int, results: Connection) -> None:
    logging.getLogger("linkcore").setLevel(logging.ERROR)
    latencies = Latencies()

    def read(stream: Stream[RealtimeState]) -> None:
        mine = latencies.of_one()
        with contextlib.suppress(RemoteError):
            for state in stream.iterate(block):
                mine.append(time.monotonic() - state.time)
                if len(mine) == WARM_UP:
                    latencies.begin()

    made = source(port, tcp=TcpTransport)
    streams = [made.stream("realtime", f"robot {n}", lambda: None) for n in range(ROBOTS)]
    threads = [threading.Thread(target=read, args=(stream,)) for stream in streams]
    for thread in threads:
        thread.start()
    time.sleep(0.5)
    running = threading.active_count()
    for thread in threads:
        thread.join()
    outcome = latencies.report(sum(stream.stats.decoded for stream in streams) - sum(map(len, latencies.robots)))
    for stream in streams:
        stream.close()
    results.send({**outcome, "threads": running})


def run(read: Any, seconds: float) -> dict[str, Any]:
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    sender = context.Process(target=send, args=(there, seconds))
    sender.start()
    mine, theirs = context.Pipe()
    reader = context.Process(target=read, args=(here.recv(), theirs))
    reader.start()
    outcome: dict[str, Any] = mine.recv()
    here.send("done")
    reader.join(10)
    sender.join(10)
    expected = int(seconds * RATE) * ROBOTS
    if outcome["received"] != expected or outcome["dropped"]:
        raise SystemExit(f"{read.__name__}: {outcome} of {expected}")
    return outcome


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="2 s per run instead of 10 s, and one round")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    options = parser.parse_args()
    seconds, rounds = (2.0, 1) if options.quick else (10.0, 3)
    turns = [(run(read_with_loop, seconds), run(read_with_threads, seconds)) for _ in range(rounds)]
    figures: dict[str, float] = {"lost": 0}  # zero, because `run` ends the program if a packet is lost
    for name in ("p50 us", "p99 us", "cpu us a packet", "threads"):
        figures[f"loop {name}"] = float(np.median([loop[name] for loop, _ in turns]))
        figures[f"loop to threads, {name.removesuffix(' us')}"] = float(
            np.median([loop[name] / threads[name] for loop, threads in turns])
        )
    if options.json:
        print(json.dumps(figures))
        return
    print(f"{ROBOTS} robots at {RATE} Hz")
    for name, value in figures.items():
        print(f"  {name:36} {value:12.3f}")


if __name__ == "__main__":
    main()

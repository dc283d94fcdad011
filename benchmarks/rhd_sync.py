"""Time of a sync between a client and a host of rhdlink, and of reading a variable.

A sync is compared with a bare echo of the same number of bytes, and a read with a property of a plain Python class.

Client and host are separate processes on one machine, in lockstep: each request is one tick of the host, which sets
variables and answers. The echo sends a request of the same size to a process that only answers with the same number of
bytes. Both are measured in turn, so that they run under the same conditions. The important figure is their ratio.

Each process has its own processor, like a robot's daemon and its client. Without this, a scheduler might put both ends
of the echo on one processor, where waking the other end costs almost nothing. It might put the ends of the sync, which
work longer, on two processors. The ratio would then compare two placements, and would be about ten times as high.
`--free` shows this.

A read (`robot.encl`) is measured alone, between two syncs: values change only at syncs, so each read in between takes
the same time. The important figure is its ratio to the plain property in the same process; the goal is at most 1 us.

Jitter is the delay of a host's ticks when it keeps time on its own, with a reader that syncs at each tick. It is
measured alone, and with hostile clients that send half packages, rubbish or nothing, or that connect thirty times per
second.

    python benchmarks/rhd_sync.py            # about 60 s
    python benchmarks/rhd_sync.py --quick    # about 10 s
"""

from __future__ import annotations

import argparse
import json
import logging
import multiprocessing
import os
import socket
import statistics
import threading
import time
import timeit
from collections.abc import Callable, Iterator
from multiprocessing.connection import Connection
from typing import NamedTuple

import numpy as np

import rhdlink
from rhdlink import Bool, Float64, Host, Int32, Int64, Plugin, Read, Scaled, Variables

#: Microseconds of the C client and the C server in lockstep, section 14 of the protocol notes, on another machine.
_C = {"10 of 10": 20.8, "100 of 100": 72.0, "1000 of 1000": 505.0, "1 of 1000": 77.0}


#: Set if processes are not tied to processors. It is an environment variable, because the processes are spawned.
_FREE = "RHD_SYNC_FREE"


class Case(NamedTuple):
    name: str
    lengths: tuple[int, ...]
    changing: int
    most: float


CASES = (
    Case("10 of 10", (1,) * 10, 10, 3.0),
    Case("100 of 100", (1,) * 100, 100, 3.0),
    Case("1000 of 1000", (1,) * 1000, 1000, 4.0),
    Case("1 of 1000", (1,) * 1000, 1, 3.0),
    Case("100 of 100, mixed lengths", (1, 2, 3, 8, 1, 17, 1, 4, 6, 1) * 10, 100, 4.0),
    Case("1000 of 1000, mixed lengths", (1, 2, 3, 8, 1, 17, 1, 4, 6, 1) * 100, 1000, 4.0),
)


class Changing(Plugin):
    """Plugin that sets the first of its variables at each tick."""

    def __init__(self, case: Case) -> None:
        self._case = case

    def init(self, config: object) -> None:
        table = self.host.database.read
        ids = [table.add(f"v{number}", length) for number, length in enumerate(self._case.lengths)]
        self._table = table
        self._selection = table.select(ids[: self._case.changing])
        self._words = np.arange(sum(self._case.lengths[: self._case.changing]), dtype=np.int32)
        self.host.database.write.add("speed")

    def periodic(self, tick: int) -> None:
        self._words += 1
        self._table.set_many(self._selection, self._words)


def use_processor(number: int) -> None:
    """Stay on one processor, if the system supports it and has several."""
    if os.environ.get(_FREE) is None and hasattr(os, "sched_setaffinity") and (os.cpu_count() or 1) > number:
        os.sched_setaffinity(0, {number})


def serve(ports: Connection, case: Case) -> None:
    use_processor(1)
    with Host([Changing(case)], port=0, pacing="lockstep") as host:
        ports.send(host.port)
        while ports.recv():
            ports.send((time.process_time(), host.tick))


def echo(ports: Connection, asked: int, answered: int) -> None:
    use_processor(1)
    answer = bytes(answered)
    with socket.create_server(("127.0.0.1", 0)) as server:
        ports.send(server.getsockname()[1])
        link, _ = server.accept()
        link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        with link:
            while True:
                left = asked
                while left:
                    data = link.recv(min(left, 1 << 16))
                    if not data:
                        return
                    left -= len(data)
                link.sendall(answer)


def timed(call: Callable[[], object], seconds: float) -> float:
    """Return the microseconds of one call, as the median of rounds with many calls."""
    rounds = []
    until = time.perf_counter() + seconds
    while time.perf_counter() < until:
        began = time.perf_counter()
        for _ in range(100):
            call()
        rounds.append((time.perf_counter() - began) / 100)
    return statistics.median(rounds) * 1e6


def sizes(case: Case) -> tuple[int, int]:
    """Return the bytes of a request with one value, and of its answer, including the tick."""
    return 2 + 6 + 16 + 2, 6 + 16 + sum(12 + 4 * length for length in case.lengths[: case.changing]) + 2


def measure(case: Case, seconds: float, turns: int) -> dict[str, object]:
    spawn = multiprocessing.get_context("spawn")
    asked, answered = sizes(case)
    ours, theirs = spawn.Pipe()
    host = spawn.Process(target=serve, args=(theirs, case))
    host.start()
    port = ours.recv()
    other_ours, other_theirs = spawn.Pipe()
    bare = spawn.Process(target=echo, args=(other_theirs, asked, answered))
    bare.start()
    request = bytes(asked)
    with (
        rhdlink.connect(f"127.0.0.1:{port}", access="w") as robot,
        socket.create_connection(("127.0.0.1", other_ours.recv())) as link,
    ):
        link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

        def sync() -> None:
            robot["speed"] = 1
            robot.sync()

        def raw() -> None:
            link.sendall(request)
            left = answered
            while left:
                left -= len(link.recv(min(left, 1 << 16)))

        syncs, echoes = [], []
        sync()
        before = robot["tick"]
        sync()
        sync()
        assert robot["tick"] == before + 2
        assert robot.fresh(f"v{case.changing - 1}")

        def spent() -> tuple[float, int]:
            ours.send(True)
            cpu, ticks = ours.recv()
            return cpu + time.process_time(), ticks

        cpu = ticks = 0.0
        for _ in range(turns):
            cpu_before, ticks_before = spent()
            syncs.append(timed(sync, seconds))
            cpu_after, ticks_after = spent()
            cpu, ticks = cpu + cpu_after - cpu_before, ticks + ticks_after - ticks_before
            echoes.append(timed(raw, seconds))
    ours.send(False)
    host.join()
    bare.join()
    ratios = [one / other for one, other in zip(syncs, echoes, strict=True)]
    return {
        "case": case.name,
        "bytes": answered,
        "sync_us": round(statistics.median(syncs), 1),
        "echo_us": round(statistics.median(echoes), 1),
        "cpu_us": round(cpu / ticks * 1e6, 1),
        "ratio": round(statistics.median(ratios), 2),
        "at_most": case.most,
        "original_us": _C.get(case.name),
    }


class Plain:
    """Class with a plain property, with which a read is compared."""

    def __init__(self) -> None:
        self._value = 5

    @property
    def value(self) -> int:
        return self._value


#: Variables to read, and the maximum time in microseconds; None if there is no goal.
READS = (
    ("encl", 1.0),
    ("ticks", 1.0),
    ("distance", 1.0),
    ("ratio", 1.0),
    ("on", 1.0),
    ("big", 1.0),
    ("line", None),
    ("by name", None),
)


def reads(seconds: float) -> Iterator[dict[str, object]]:
    """Yield the nanoseconds of reading each type, and of a plain property, in turn."""

    class Robot(Plugin):
        encl = Read(Int32)
        ticks = Read(Int64)
        distance = Read(Float64)
        ratio = Read(Scaled(1e-5))
        on = Read(Bool)
        big = Read(Float64, order="big")
        line = Read(Int32, 8)

    class Side(Variables):
        encl = Read(Int32)
        ticks = Read(Int64)
        distance = Read(Float64)
        ratio = Read(Scaled(1e-5))
        on = Read(Bool)
        big = Read(Float64, order="big")
        line = Read(Int32, 8)

    plain = Plain()
    with Host([Robot()], port=0, pacing="lockstep") as host, rhdlink.connect(host.address, Side) as robot:
        robot.sync()
        for name, most in READS:
            statement = 'robot["encl"]' if name == "by name" else f"robot.{name}"
            timers = [
                timeit.Timer(each, globals={"robot": robot, "plain": plain}) for each in (statement, "plain.value")
            ]
            number = 20_000
            rounds: list[tuple[float, float]] = []
            until = time.perf_counter() + seconds
            while time.perf_counter() < until or len(rounds) < 3:
                ours, theirs = (timer.timeit(number) / number * 1e9 for timer in timers)
                rounds.append((ours, theirs))
            yield {
                "read": name,
                "ns": round(statistics.median(ours for ours, _ in rounds)),
                "property_ns": round(statistics.median(theirs for _, theirs in rounds)),
                "ratio": round(statistics.median(ours / theirs for ours, theirs in rounds), 1),
                "at_most_us": most,
            }


def keep_time(ports: Connection, period: float, seconds: float) -> None:
    use_processor(1)
    logging.getLogger("rhdlink").setLevel(logging.ERROR)  # hostile clients cause expected warnings
    with Host([Changing(CASES[1])], period=period, port=0, clients=64) as host:
        ports.send(host.port)
        time.sleep(seconds)
        stats = host.stats
        ports.send((stats.ticks, stats.overruns, stats.late_median, stats.late_p99, stats.late_worst))
        ports.recv()


def pester(port: int, over: threading.Event) -> None:
    """Act as hostile clients until `over` is set, with thirty connections per second."""
    says = (b"", b"a", b"ar", b"rr", b"arrwdw\x00\x00\x00\x05", b"aw" + b"\xff" * 100, b"GET / HTTP/1.0\r\n\r\n")
    open_ones: list[socket.socket] = []
    number = 0
    while not over.wait(1 / 30):
        try:
            pest = socket.create_connection(("127.0.0.1", port), 1.0)
            open_ones.append(pest)
            pest.sendall(says[number % len(says)])
        except OSError:
            pass  # refused or disconnected, as expected
        number += 1
        if len(open_ones) > 20:
            open_ones.pop(0).close()
    for pest in open_ones:
        pest.close()


def jitter(period: float, seconds: float, hostile: bool) -> dict[str, object]:
    spawn = multiprocessing.get_context("spawn")
    ours, theirs = spawn.Pipe()
    host = spawn.Process(target=keep_time, args=(theirs, period, seconds))
    host.start()
    port = ours.recv()
    over = threading.Event()
    pest = threading.Thread(target=pester, args=(port, over))
    with rhdlink.connect(f"127.0.0.1:{port}") as robot:
        if hostile:
            pest.start()
        syncs = 0
        while not ours.poll():
            robot.sync()
            syncs += 1
    over.set()
    if hostile:
        pest.join()
    ticks, overruns, median, p99, worst = ours.recv()
    ours.send(None)
    host.join()
    return {
        "period_ms": period * 1e3,
        "hostile": hostile,
        "ticks": ticks,
        "syncs": syncs,
        "overruns": overruns,
        "late_median_us": round(median * 1e6),
        "late_p99_us": round(p99 * 1e6),
        "late_worst_us": round(worst * 1e6),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="run for some seconds instead of a minute")
    parser.add_argument("--json", action="store_true", help="print one JSON object per line")
    parser.add_argument("--free", action="store_true", help="leave the choice of processors to the system")
    args = parser.parse_args()
    if args.free:
        os.environ[_FREE] = "1"
    seconds, turns, long = (0.15, 3, 2.0) if args.quick else (0.5, 7, 10.0)
    use_processor(0)
    results = []
    for case in CASES:
        results.append(measure(case, seconds, turns))
        found = results[-1]
        if args.json:
            print(json.dumps(found))
        else:
            original = "" if found["original_us"] is None else f"; the C pair, elsewhere: {found['original_us']} us"
            print(
                f"{found['case']:28} {found['bytes']:6} bytes   sync {found['sync_us']:7} us, CPU of both "
                f"{found['cpu_us']:6} us   echo {found['echo_us']:6} us   x {found['ratio']:5} (at most "
                f"{found['at_most']}{original})"
            )
    for found in reads(seconds):
        print(
            json.dumps(found)
            if args.json
            else f"read of {found['read']:10} {found['ns']:6} ns   plain property {found['property_ns']:4} ns   "
            f"x {found['ratio']:5}" + ("" if found["at_most_us"] is None else f" (at most {found['at_most_us']:g} us)")
        )
    for period, hostile in ((0.01, False), (0.002, False), (0.01, True)):
        late = jitter(period, long, hostile)
        beside = " with hostile clients" if hostile else ""
        print(
            json.dumps(late)
            if args.json
            else f"tick at {late['period_ms']:g} ms{beside}: {late['ticks']} ticks, {late['syncs']} syncs, "
            f"{late['overruns']} overruns, median delay {late['late_median_us']} us, "
            f"p99 {late['late_p99_us']} us, worst {late['late_worst_us']} us"
        )


if __name__ == "__main__":
    main()

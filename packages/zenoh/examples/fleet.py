"""Run a fleet on one computer: simulated robots in several processes, a router, and a collector that records them all.

    python fleet.py --robots 8 --processes 2 --seconds 20
    python fleet.py --robots 100 --processes 4 --speed 0.1 --seconds 30 --each
    python fleet.py --robots 100 --processes 4 --pace 0.1 --seconds 30

Halfway, the router is killed; two seconds later it is started again. At the end, the program prints for each robot how
many packets were offered to the collector, how many it received, how many were lost, and the longest gap between two
packets in the recording. It also prints the processor time of each part.

A simulated arm takes about 5 % of a processor at 125 Hz, including its reader and publisher. So a hundred arms need
more than two processors. With --speed, the time of the robots passes faster or slower: with 0.1, each robot has 12.5
cycles and sends 12.5 packets per second. With --pace, the robots are recordings of a simulated arm, and the number is
their playback speed.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

import urlink
import urlink_zenoh
from urlink import RecordingWriter
from urlink.packets import Chunk, Stamp
from urlink.simulator import Controller, Demonstration, Still

FIRMWARE = "3.15"
#: Maximum time, in s, from the start until every robot is recorded.
TIMEOUT = 90.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robots", type=int, default=4)
    parser.add_argument("--processes", type=int, default=2, help="number of processes that serve the robots")
    parser.add_argument("--seconds", type=float, default=10.0)
    how = parser.add_mutually_exclusive_group()
    how.add_argument("--speed", type=float, default=1.0, help="speed of the simulated robots' time (default: 1)")
    how.add_argument("--pace", type=float, help="play recordings at this speed instead of simulating")
    parser.add_argument("--each", action="store_true", help="print a line for each robot")
    parser.add_argument("--directory", help="directory for recordings (default: a temporary one)")
    parser.add_argument("--part", help=argparse.SUPPRESS)
    parser.add_argument("--endpoint", help=argparse.SUPPRESS)
    parser.add_argument("rest", nargs="*", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.part is not None:
        parts = {"router": router, "robots": robots}
        parts[args.part](args.endpoint, args.rest, args.speed)
        return
    with tempfile.TemporaryDirectory() as scratch:
        demonstrate(args, Path(args.directory or scratch))


# -- the processes ---------------------------------------------------------------------------------------


def router(endpoint: str, rest: Sequence[str], speed: float) -> None:
    """Run a router until stdin ends. Any router of Zenoh would do, for example `zenohd`."""
    with urlink_zenoh.open_session(listen=[endpoint], mode="router"):
        report()


def robots(endpoint: str, rest: Sequence[str], speed: float) -> None:
    """Serve some robots until stdin ends.

    Each argument is `NAME`, for a simulated robot, or `NAME=ADDRESS`.
    """
    with contextlib.ExitStack() as stack:
        connected: dict[str, urlink.Robot] = {}
        for each in rest:
            name, _, address = each.partition("=")
            if not address:
                controller = stack.enter_context(Controller("UR5", FIRMWARE, motion=Still(), stepped=speed != 1.0))
                if speed != 1.0:
                    stack.enter_context(controller.passing(speed))
                address = controller.address
            # The fewer cycles per second, the longer it takes until a packet arrives.
            connected[name] = stack.enter_context(urlink.connect(address, silence=10.0))
        session = stack.enter_context(urlink_zenoh.open_session([endpoint]))
        stack.enter_context(urlink_zenoh.Server(session, connected, status_rate=1.0, interfaces=("realtime",)))
        report()


def report() -> None:
    """Print a line when everything is running; when stdin ends, print the processor time since then."""
    print("up", flush=True)
    began, cpu = time.monotonic(), time.process_time()
    sys.stdin.read()
    print(json.dumps({"seconds": time.monotonic() - began, "cpu": time.process_time() - cpu}), flush=True)


class Part:
    """A process with one of the parts above."""

    def __init__(self, part: str, endpoint: str, *rest: str) -> None:
        command = [sys.executable, __file__, "--part", part, "--endpoint", endpoint, *rest]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    def wait_up(self) -> None:
        line = self._process.stdout.readline() if self._process.stdout else ""
        if line != "up\n":
            raise SystemExit(f"a process did not start; it printed {line!r}")

    def end(self) -> float:
        """End the process normally, and return the fraction of one processor that it used."""
        out, _ = self._process.communicate(timeout=60)
        said = json.loads(out.splitlines()[-1])
        return float(said["cpu"] / said["seconds"])

    def kill(self) -> None:
        self._process.kill()
        self._process.communicate()


# -- the demonstration -----------------------------------------------------------------------------------


def demonstrate(args: argparse.Namespace, directory: Path) -> None:
    endpoint = free_endpoint()
    names = [f"arm{number:03}" for number in range(args.robots)]
    if args.pace is None:
        given = names
    else:
        seconds = (args.seconds + TIMEOUT) * args.pace
        recording = record(directory / "source.urlog", seconds)
        given = [f"{name}=replay://{recording}?rate={args.pace}" for name in names]
    print(f"{args.robots} robots in {args.processes} processes, {os.cpu_count()} processors", flush=True)
    parts = [Part("router", endpoint)]
    parts[0].wait_up()
    try:
        with urlink_zenoh.open_session([endpoint]) as session:
            collector = urlink_zenoh.Collector(session, directory / "fleet")
            began, cpu = time.monotonic(), time.process_time()
            speed = f"--speed={args.speed}"
            parts += [Part("robots", endpoint, speed, *given[i :: args.processes]) for i in range(args.processes)]
            for part in parts[1:]:
                part.wait_up()
            wait_for(lambda: sorted(collector.robots) == names, TIMEOUT)
            print(f"all recorded after {time.monotonic() - began:.1f} s", flush=True)
            time.sleep(args.seconds / 2)

            before = collector.robots
            parts[0].kill()
            away = time.monotonic()
            time.sleep(2.0)
            parts[0] = Part("router", endpoint)
            parts[0].wait_up()
            wait_for(lambda: all(collector.robots[each].packets > before[each].packets + 1 for each in names), 30.0)
            print(f"router killed; all recorded again {time.monotonic() - away:.1f} s later", flush=True)
            settled, counted = time.monotonic(), collector.robots
            time.sleep(args.seconds / 2)
            found, seconds = collector.robots, time.monotonic() - settled
            collector.close()
            ended = collector.robots
            own = (time.process_time() - cpu) / (time.monotonic() - began)
        shares = [part.end() for part in reversed(parts)]
        parts.clear()
    finally:
        for part in parts:
            part.kill()
    rates = [(found[each].packets - counted[each].packets) / seconds for each in names]
    lost = [found[each].missed - counted[each].missed for each in names]
    print(f"packets per second of each robot: {min(rates):.1f} to {max(rates):.1f}, in total {sum(rates):.0f}")
    print(f"missed without the router: {sum(each.missed for each in counted.values())}; with the router: {sum(lost)}")
    clock = sum(each.missing for each in ended.values())
    print(f"cycles of the controllers' own clocks that are in no recording: {clock}")
    gaps = {name: longest_gap(ended[name].path) for name in names}
    # The server numbers packets when they arrive from the robot, so missed packets were offered too.
    rows = [(each, ended[each].packets + ended[each].missed, ended[each].packets, gaps[each]) for each in names]
    for name, offered, received, gap in rows if args.each else ():
        print(f"  {name}: offered {offered}, received {received}, lost {offered - received}, longest gap {gap:.2f} s")
    print(f"offered {sum(row[1] for row in rows)}, received {sum(row[2] for row in rows)} in {len(ended)} files")
    print(f"longest gap of each: {min(gaps.values()):.2f} to {max(gaps.values()):.2f} s")
    serving = sum(shares[:-1])
    print(
        f"processor: robots and servers {serving:.2f} ({100 * serving / len(names):.2f} % per robot), "
        f"collector {own:.2f} ({1e6 * own / max(sum(rates), 1):.0f} us per packet), router {shares[-1]:.2f}"
    )
    for file in (ended[names[0]], ended[names[-1]]):
        with urlink.connect(f"replay://{file.path}?rate=0") as robot:
            count = sum(1 for _ in robot.realtime.iterate(urlink.block))
            assert count == file.packets, f"{count} of {file.packets}"


def longest_gap(path: Path) -> float:
    """Return the longest gap, in s, between two packets of a recording, by server time."""
    steps = np.diff(urlink.load(path).realtime.time)
    return float(steps.max()) if len(steps) else 0.0


def record(path: Path, seconds: float) -> Path:
    """Record a simulated arm without waiting: the arm is stepped without a clock."""
    controller = Controller("UR5", FIRMWARE, motion=Demonstration())
    writer = RecordingWriter(path)
    channel = writer.add_channel({"name": "realtime", "firmware": FIRMWARE, "model": "UR5"})
    for number in range(int(seconds * 125)):
        controller.step()
        writer.add(channel, Chunk(controller.realtime_packet(), Stamp(number * 0.008, number * 0.008)))
    writer.close()
    return path


def wait_for(condition: Callable[[], bool], seconds: float) -> None:
    end = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > end:
            raise SystemExit(f"the expected state was not reached within {seconds:g} s")
        time.sleep(0.1)


def free_endpoint() -> str:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{listener.getsockname()[1]}"


if __name__ == "__main__":
    main()

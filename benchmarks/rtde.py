"""RTDE: decoding of a data package to a typed state, and 500 Hz from another process, compared with ur_rtde.

The first part decodes a data package of the 37 variables that ur_rtde requests from every controller, and reads all of
them. It is compared with `struct.unpack` of the same bytes. The second part serves one client at a time with data
packages whose timestamp is the time of sending. The clients take turns, each in a separate process: a urlink stream
with an inline callback, a stream with a `for` loop, and, if it is installed, ur_rtde's `RTDEReceiveInterface` in the
loop of its examples. The age of a sample is measured when the loop has it.

ur_rtde has the port number built in, so the server listens on port 30004 of another loopback address.

    python benchmarks/rtde.py            # 10 s per run
    python benchmarks/rtde.py --quick    # 2 s per run
"""

from __future__ import annotations

import argparse
import contextlib
import json
import logging
import multiprocessing
import socket
import struct
import time
from collections.abc import Callable
from multiprocessing.connection import Connection
from operator import itemgetter
from typing import Any

import numpy as np

from linkcore.net.transport import TcpTransport
from linkcore.streaming.connection_life import Backoff
from linkcore.streaming.packet_queue import drop_oldest
from urlink.protocol.firmware import Firmware
from urlink.protocol.rtde.packets import (
    ControllerVersionReply,
    ControllerVersionRequest,
    OutputsReply,
    OutputsRequest,
    ProtocolReply,
    ProtocolRequest,
    StartReply,
    StartRequest,
    decode_request,
    split_names,
)
from urlink.protocol.rtde.recipes import DATA_HEADER, Recipe
from urlink.protocol.rtde.variables import OUTPUTS
from urlink.rtde import Rtde
from urlink.session.identity import Identity
from urlink.session.source import Source

HOST, PORT = "127.0.7.1", 30004
RATE = 500
#: Number of samples before the measurement starts.
WARM_UP = 250
#: The variables that ur_rtde requests and that every controller has.
NAMES = split_names(
    "timestamp, target_q, target_qd, target_qdd, target_current, target_moment, actual_q, actual_qd, "
    "actual_current, joint_control_output, actual_TCP_pose, actual_TCP_speed, actual_TCP_force, target_TCP_pose, "
    "target_TCP_speed, actual_digital_input_bits, joint_temperatures, actual_execution_time, robot_mode, "
    "joint_mode, safety_mode, actual_tool_accelerometer, speed_scaling, target_speed_fraction, actual_momentum, "
    "actual_main_voltage, actual_robot_voltage, actual_robot_current, actual_joint_voltage, "
    "actual_digital_output_bits, runtime_state, standard_analog_input0, standard_analog_input1, "
    "standard_analog_output0, standard_analog_output1, robot_status_bits, safety_status_bits"
)


# -- one package -----------------------------------------------------------------------------------


def decoding(repeats: int) -> dict[str, float]:
    """Return the processor time of one package, of the best short run, and the ratio."""
    recipe = Recipe(NAMES, [OUTPUTS[name].type for name in NAMES])
    data = recipe.encode({"timestamp": 41.0, "actual_q": [0.1, -1.5, 1.2, -1.3, -1.5, 0.0], "robot_mode": 7})
    decode = recipe.state_class().LAYOUTS.all[0].decode
    assert recipe.layout.struct is not None
    unpack = recipe.layout.struct.unpack_from
    # Each read is a separate line, as in a program.
    text = "def read(data):\n    state = decode(data)\n" + "".join(f"    state.{name}\n" for name in NAMES)
    space: dict[str, Any] = {"decode": decode}
    exec(text, space)
    vectors = recipe.layout.places["target_q"].offset, [slice(6 * number, 6 * number + 6) for number in range(17)]
    ways: dict[str, Callable[[bytes], object]] = {
        "struct": unpack,
        "decode": decode,
        "all read": space["read"],
        "arrays": lambda data: arrays(data, *vectors),
    }
    best = dict.fromkeys(ways, float("inf"))
    for _ in range(repeats):
        for name, way in ways.items():
            began = time.process_time()
            for _ in range(500):
                way(data)
            best[name] = min(best[name], (time.process_time() - began) / 500)
    return {
        "struct.unpack us": best["struct"] * 1e6,
        "decode ratio": best["decode"] / best["struct"],
        "decode, all read ratio": best["all read"] / best["struct"],
        "17 arrays alone ratio": best["arrays"] / best["struct"],
    }


def arrays(data: bytes, offset: int, slices: list[slice]) -> object:
    """Make only the vectors of the package, of six doubles each: the minimum for numpy."""
    return itemgetter(*slices)(np.frombuffer(data, ">f8", 6 * len(slices), offset).astype("=f8"))


# -- 500 Hz ----------------------------------------------------------------------------------------


def serve(ready: Connection, seconds: float) -> None:
    """Serve one client with paced data packages."""
    with socket.create_server((HOST, PORT)) as server:
        ready.send(True)
        connection, _ = server.accept()
        with connection:
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            recipe = answer(connection)
            package = bytearray(recipe.encode({"runtime_state": 1}))
            start = time.monotonic() + 0.2
            sent = 0
            with contextlib.suppress(OSError):
                for number in range(int(seconds * RATE)):
                    pause = start + number / RATE - time.monotonic()
                    if pause > 0:
                        time.sleep(pause)
                    struct.pack_into(">d", package, DATA_HEADER.width, time.monotonic())  # the first field
                    connection.sendall(package)
                    sent += 1
            ready.send(sent)
            with contextlib.suppress(OSError):
                connection.recv(1)  # until the client has finished


def answer(connection: socket.socket) -> Recipe:
    """Answer the requests of a client until the start; return the requested recipe."""
    recipe: Recipe | None = None
    protocol: Any = 1
    while True:
        request: Any = decode_request(connection.recv(4096), protocol)  # the client waits for each answer
        if isinstance(request, ProtocolRequest):
            connection.sendall(bytes(ProtocolReply(accepted=True)))
            protocol = 2
        elif isinstance(request, ControllerVersionRequest):
            connection.sendall(bytes(ControllerVersionReply(major=5, minor=4, bugfix=3)))
        elif isinstance(request, OutputsRequest):
            names = split_names(request.names)
            types = [OUTPUTS[name].type for name in names]
            recipe = Recipe(names, types)
            connection.sendall(bytes(OutputsReply("2.0", recipe=1, types=",".join(types))))
        elif isinstance(request, StartRequest) and recipe is not None:
            connection.sendall(bytes(StartReply(accepted=True)))
            return recipe


class Meter:
    """Ages of samples, and processor time, after the warm-up."""

    def __init__(self) -> None:
        self.ages: list[float] = []
        self.last = 0.0
        self.cpu = self.began = 0.0

    def take(self, stamp: float) -> None:
        if stamp == self.last:  # ur_rtde returns the same sample again if there is no newer one
            return
        self.last = stamp
        self.ages.append(time.monotonic() - stamp)
        if len(self.ages) == WARM_UP:
            self.cpu, self.began = time.process_time(), time.monotonic()

    def report(self) -> dict[str, float]:
        ages = np.array(self.ages[WARM_UP:]) * 1e6
        p50, p99 = np.percentile(ages, (50, 99)).tolist()
        busy = (time.process_time() - self.cpu) / (time.monotonic() - self.began)
        return {"samples": len(self.ages), "p50": p50, "p99": p99, "cpu": busy}


def receive_with_urlink(results: Connection, seconds: float, way: str) -> None:
    logging.getLogger("linkcore").setLevel(logging.ERROR)  # the end of the server is expected
    firmware = Firmware(5, 4)
    source = Source(
        lambda: Identity(firmware, True, None),
        lambda interface: TcpTransport(HOST, PORT, silence=5.0),
        Backoff(tries=0),
        5.0,
        5.0,
        False,
    )
    rtde = Rtde("benchmark", source, lambda: firmware)
    stream = rtde.outputs(*NAMES)
    meter = Meter()
    until = int(seconds * RATE)
    if way == "inline":
        stream.subscribe(lambda state: meter.take(state.timestamp), inline=True)
        while len(meter.ages) < until and not stream.is_over and stream.failure is None:
            time.sleep(0.05)
    else:
        for state in stream.iterate(drop_oldest(256)):
            meter.take(state.timestamp)
            if len(meter.ages) >= until:
                break
    outcome = meter.report()
    rtde.close()
    results.send(outcome)


def receive_with_ur_rtde(results: Connection, seconds: float) -> None:
    """Receive with the loop of ur_rtde's examples: read the newest sample once per period."""
    import rtde_receive  # type: ignore[import-not-found, unused-ignore]

    receive = rtde_receive.RTDEReceiveInterface(HOST, float(RATE), NAMES)
    meter = Meter()
    end = time.monotonic() + 0.2 + seconds
    while time.monotonic() < end:
        begin = receive.initPeriod()
        meter.take(receive.getTimestamp())
        receive.waitPeriod(begin)
    results.send(meter.report())
    receive.disconnect()


def run(way: str, seconds: float) -> dict[str, float]:
    """Run one server process and one client process."""
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    server = context.Process(target=serve, args=(there, seconds))
    server.start()
    here.recv()
    mine, theirs = context.Pipe()
    if way == "ur_rtde":
        client = context.Process(target=receive_with_ur_rtde, args=(theirs, seconds))
    else:
        client = context.Process(target=receive_with_urlink, args=(theirs, seconds, way))
    client.start()
    outcome: dict[str, float] = mine.recv()
    outcome["lost"] = int(seconds * RATE) - outcome["samples"]
    client.join(10)
    server.join(10)
    for process in (client, server):
        if process.is_alive():
            process.kill()
    return outcome


def compare(seconds: float, rounds: int) -> dict[str, float]:
    """Return the medians over the rounds, and the ratios to ur_rtde in the same round."""
    ways = ["inline", "iteration"]
    with contextlib.suppress(ImportError):
        import rtde_receive

        assert rtde_receive
        ways.append("ur_rtde")
    turns = [{way: run(way, seconds) for way in ways} for _ in range(rounds)]
    figures = {f"{way} {name}": [turn[way][name] for turn in turns] for way in ways for name in turns[0][way]}
    if "ur_rtde" in ways:
        for way in ways[:-1]:
            for name in ("p50", "p99", "cpu"):
                figures[f"ur_rtde {name} / {way}"] = [turn["ur_rtde"][name] / turn[way][name] for turn in turns]
    return {name: float(np.median(values)) for name, values in figures.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="2 s per run instead of 10 s, and one round")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    options = parser.parse_args()
    figures = {
        "37 mixed fields": decoding(20 if options.quick else 100),
        "500 Hz": compare(*((2.0, 1) if options.quick else (10.0, 3))),
    }
    if options.json:
        print(json.dumps(figures))
        return
    for title, values in figures.items():
        print(title)
        for name, value in values.items():
            print(f"  {name:28} {value:12.3f}")


if __name__ == "__main__":
    main()

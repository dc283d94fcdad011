"""Decoding, as ratios in one run: compared with `struct`, with construct, and with a hand-written loop.

python benchmarks/decode.py
"""

from __future__ import annotations

import argparse
import json
import statistics
import struct
import time
import timeit
from collections.abc import Callable
from operator import attrgetter
from typing import Any

import urlink
from linkcore.wire.schema import as_struct
from urlink.protocol.firmware import RELEASES
from urlink.protocol.primary.decoder import PackageDecoder
from urlink.protocol.primary.robot_state import SUB_PACKAGES, RobotState, SubPackage
from urlink.protocol.realtime.packets import RealtimeState
from urlink.protocol.realtime.protocol import RealtimeProtocol

#: Code that a person would write who needs only the numbers of one firmware: 5.4 to 5.24.
_HEAD = struct.Struct(">iB")
_BODIES = {
    kind: struct.Struct(form)
    for kind, form in {
        0: ">Q7?BBdddB",
        1: ">" + "3d4fB" * 6,
        2: ">BBddfBffB",
        3: ">IIBBddBBddffffBBBIBBB",
        4: ">12d",
        5: ">6I6d6d6d6dI",
        6: ">12d12d5d6d6d6d6diiii",
        7: ">7d",
        8: ">BBBB",
        9: ">6d",
        10: ">I2B4d",
        11: ">?iiiff",
        12: ">BBB",
    }.items()
}


def walk(data: bytes) -> dict[int, tuple[Any, ...]]:
    """Read a robot state with a hand-written loop around struct."""
    at, end, found = 5, len(data), {}
    while at < end:
        size, kind = _HEAD.unpack_from(data, at)
        found[kind] = _BODIES[kind].unpack_from(data, at + 5)
        at += size
    return found


def first_state() -> bytes:
    """Return a robot state of 1386 bytes, with all packages that 5.4 sends first."""
    (row,) = (row for row in RELEASES if row.since[:2] == (5, 4))
    parts: list[SubPackage] = [SUB_PACKAGES[kind][0](row.since) for kind in row.state]
    return bytes(RobotState(*parts))


def ratios(ours: Callable[[], object], reference: Callable[[], object], rounds: int) -> tuple[float, float, float]:
    """Return the median ratio of interleaved rounds, and the median microseconds of each."""

    def microseconds(call: Callable[[], object]) -> float:
        # Use processor time, and the best of many short runs, because other programs use the machine too.
        timer = timeit.Timer(call, timer=time.process_time)
        number = max(int(2e-3 / max(timer.timeit(20) / 20, 1e-7)), 1)
        return min(timer.repeat(20, number)) / number * 1e6

    pairs = [(microseconds(ours), microseconds(reference)) for _ in range(rounds)]
    return (
        statistics.median(mine / other for mine, other in pairs),
        statistics.median(mine for mine, _ in pairs),
        statistics.median(other for _, other in pairs),
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="3 rounds instead of 15")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    options = parser.parse_args()
    rounds = 3 if options.quick else 15

    packet = bytes(RealtimeState("5.0"))
    assert len(packet) == 1108
    session = RealtimeProtocol()
    session.framer.feed(packet)  # as in a connection, whose first packet determines the layout
    decode = session.decode
    oracle = as_struct(RealtimeState.LAYOUTS.of("5.0"))

    def five_vectors() -> None:
        state = decode(packet)
        state.q_actual  # noqa: B018
        state.qd_actual  # noqa: B018
        state.q_target  # noqa: B018
        state.I_actual  # noqa: B018
        state.tool_vector_actual  # noqa: B018

    data = first_state()
    assert len(data) == 1386
    assert len(walk(data)) == 13
    decoder = PackageDecoder()

    parts: tuple[SubPackage, ...] = decoder.decode(data).packages  # type: ignore[attr-defined]
    read = {type(part): attrgetter(*part.to_dict()) for part in parts}

    def every_field() -> None:
        for part in decoder.decode(data):  # type: ignore[attr-defined]
            read[type(part)](part)

    figures = {
        "urlink.decode of a real-time packet / struct.unpack": ratios(
            lambda: urlink.decode(packet, "realtime"), lambda: struct.unpack(">i138d", packet), rounds
        ),
        "urlink.decode of a robot state / struct walk": ratios(
            lambda: urlink.decode(data, "primary"), lambda: walk(data), rounds
        ),
        "real-time packet and five vectors / struct.unpack('>i138d')": ratios(
            five_vectors, lambda: struct.unpack(">i138d", packet), rounds
        ),
        "construct / real-time packet and five vectors": ratios(lambda: oracle.parse(packet), five_vectors, rounds),
        "robot state of 1386 bytes / struct walk": ratios(lambda: decoder.decode(data), lambda: walk(data), rounds),
        "the same and every field read / struct walk": ratios(every_field, lambda: walk(data), rounds),
    }
    if options.json:
        print(json.dumps(figures))
        return
    print(f"{'':62} {'ratio':>8} {'us':>9} {'of':>9}")
    for title, (ratio, mine, other) in figures.items():
        print(f"{title:62} {ratio:8.2f} {mine:9.2f} {other:9.2f}")


if __name__ == "__main__":
    main()

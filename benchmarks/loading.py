"""Time to load a recording: all fields of the real-time packets as columns, compared with a loop around `struct`.

A recording of packets of firmware 5.10 (1220 bytes, the longest packets) is written once, with one packet in each
record. `urlink.load` finds its records and checks their checksums, and `arrays` makes a column of every field. The loop
reads the same file record by record, unpacks each packet with one precompiled `struct`, and appends the tuple to a
list, without checksums and columns. `checked` is the same loop with checksums. Times are processor times, so that other
programs matter less, and the best of the rounds counts. For `urlink.load`, the elapsed time is shown too, because
several processors share the checksums. The file is in the cache of the operating system.

Checksums are checked for many records at once (`linkcore.recording.index.intact`). The saving is shown, compared with
one call of `zlib.crc32` for each record. Both use the same number of threads, in the same process and in turn, for
records with a real-time packet and for short records.

    python benchmarks/loading.py            # 200 000 packets, 3 rounds
    python benchmarks/loading.py --quick    # 20 000 packets, 2 rounds
"""

from __future__ import annotations

import argparse
import json
import statistics
import struct
import tempfile
import time
import zlib
from collections.abc import Callable
from itertools import chain
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import urlink
from linkcore.recording.file import FRAME, HEAD, MAGIC, Kind, pack
from linkcore.recording.index import intact, side_by_side
from urlink.packets import RealtimeState, Stamp

PACKET = bytes(RealtimeState("5.10", q_actual=[0.1, -1.5, 1.2, -1.3, -1.5, 0.0], joint_modes=[253] * 6))
#: Number of records whose checksums are checked in one run; bytes of a record without its length and checksum.
RECORDS, SIZES = 1 << 16, (HEAD.size + len(PACKET), 60)
DOUBLES = struct.Struct(f">{(len(PACKET) - 4) // 8}d")


def write(path: Path, packets: int) -> None:
    with path.open("wb") as file:
        file.write(MAGIC)
        file.write(pack(Kind.CHANNEL, 0, Stamp(0, 0), json.dumps({"name": "realtime"}).encode()))
        for number in range(packets):
            data = PACKET[:4] + struct.pack(">d", number * 0.002) + PACKET[12:]
            file.write(pack(Kind.BYTES, 0, Stamp(number * 0.002, 1.7e9 + number * 0.002), data))
        file.write(pack(Kind.END, 0, Stamp(0, 0), b""))


def loop(path: Path, *, checked: bool) -> list[tuple[float, ...]]:
    rows = []
    with path.open("rb") as file:
        file.read(len(MAGIC))
        while frame := file.read(FRAME.size):
            length, crc = FRAME.unpack(frame)
            body = file.read(length)
            if checked and zlib.crc32(body) != crc:
                raise ValueError("damaged")
            if body[0] == Kind.BYTES:
                rows.append(DOUBLES.unpack_from(body, HEAD.size + 4))
    return rows


def one_by_one(data: NDArray[np.uint8], stride: int, count: int) -> NDArray[np.bool_]:
    """Return the result of `intact`, with one call of `zlib.crc32` for each record."""
    view, crc32 = memoryview(data), zlib.crc32  # type: ignore[arg-type]  # an array has a buffer

    def checksums(begin: int, end: int) -> list[int]:
        return [crc32(view[at + FRAME.size : at + stride]) for at in range(begin * stride, end * stride, stride)]

    found = np.array(list(chain(*side_by_side(checksums, 0, count, 1 << 12))), np.uint32)
    good: NDArray[np.bool_] = found == np.ndarray((count,), ">u4", data, 4, (stride,))
    return good


def saved(size: int, rounds: int) -> tuple[float, float]:
    """Return the ratios of checking one by one to checking many at once, as medians.

    The first ratio is of processor times, and the second of elapsed times.
    """
    body = bytes(range(256)) * (size // 256 + 1)
    record = FRAME.pack(size, zlib.crc32(body[:size])) + body[:size]
    data, stride = np.frombuffer(record * RECORDS, np.uint8), len(record)
    ratios: list[tuple[float, float]] = []
    for _ in range(5 * rounds):
        times = []
        for check in (lambda: one_by_one(data, stride, RECORDS), lambda: intact(data, 0, stride, RECORDS)):
            begin = time.perf_counter()
            times.append((spent(check), time.perf_counter() - begin))
        (single, single_clock), (joined, joined_clock) = times
        ratios.append((single / joined, single_clock / joined_clock))
    processor, clock = zip(*ratios, strict=True)
    return statistics.median(processor), statistics.median(clock)


def spent(action: Callable[[], object]) -> float:
    begin = time.process_time()
    action()
    return time.process_time() - begin


def measure(path: Path, packets: int, rounds: int) -> dict[str, float]:
    """Return the microseconds per packet."""
    best: dict[str, float] = {}

    def take(name: str, action: Callable[[], object]) -> None:
        begin = time.perf_counter()
        figures = {name: spent(action), f"{name}_clock": time.perf_counter() - begin}
        for each, seconds in figures.items():
            best[each] = min(best.get(each, float("inf")), seconds / packets * 1e6)

    runs: list[urlink.Recording] = []
    for _ in range(rounds):
        runs.clear()
        take("find", lambda: runs.append(urlink.load(path)))
        take("rows", lambda: runs[0].realtime)
        take("columns", lambda: runs[0].realtime.arrays())
        take("one_column", lambda: urlink.load(path).realtime["q_actual"])
        take("struct", lambda: loop(path, checked=False))
        take("struct_checked", lambda: loop(path, checked=True))
    for kind in ("", "_clock"):
        best[f"all{kind}"] = sum(best[f"{name}{kind}"] for name in ("find", "rows", "columns"))
    return best


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="20 000 packets, 2 rounds")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    options = parser.parse_args()
    packets, rounds = (20_000, 2) if options.quick else (200_000, 3)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.urlog"
        write(path, packets)
        figures = measure(path, packets, rounds)
    gained = {size: saved(size, rounds) for size in SIZES}
    for size, (processor, clock) in gained.items():
        figures |= {f"checksums_{size}": processor, f"checksums_{size}_clock": clock}
    if options.json:
        print(json.dumps(figures))
        return
    print(f"{packets} packets of {len(PACKET)} bytes, processor time per packet, best of {rounds}")
    print(f"  records found, checksums checked    {figures['find']:6.2f} us")
    print(f"  packets found                       {figures['rows']:6.2f} us")
    print(f"  all fields as columns               {figures['columns']:6.2f} us")
    print(f"  all of it                           {figures['all']:6.2f} us   (goal: 1.5 us)")
    print(f"  all of it, elapsed time             {figures['all_clock']:6.2f} us")
    print(f"  load and one column of six          {figures['one_column']:6.2f} us")
    print(f"  loop around struct                  {figures['struct']:6.2f} us")
    print(f"  the same with checksums             {figures['struct_checked']:6.2f} us")
    print("checksums one by one / many at once")
    for size, (processor, clock) in gained.items():
        print(
            f"  records of {size:4} bytes               {processor:6.2f} of processor time, {clock:.2f} of elapsed time"
        )


if __name__ == "__main__":
    main()

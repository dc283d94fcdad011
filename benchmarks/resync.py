"""Time to find a lost frame boundary again, with the worst known bytes: milliseconds for 64 KiB.

The bytes are made with knowledge of the code: headers that look valid for as long as possible, and that are as close to
each other as possible. They arrive at once, in chunks of seven bytes, or byte by byte. For comparison, there is a
framer that only waits for more bytes.

python benchmarks/resync.py
"""

from __future__ import annotations

import argparse
import json
import statistics
import struct
import time

from linkcore.wire.framing import Framer
from urlink.packets import RealtimeState, VersionMessage
from urlink.protocol.primary.protocol import PrimaryProtocol
from urlink.protocol.realtime.protocol import RealtimeProtocol

_SIZE = 1 << 16
_CHUNKS = (_SIZE, 7, 1)


def package(size: int, kind: int) -> bytes:
    """Return the header of a package or of a sub-package."""
    return struct.pack(">iB", size, kind)


# A robot state of 20 bytes, with the smallest cost of finding a boundary again.
_STATE = package(20, 16) + package(15, 99) + bytes(10)

#: Repeated elements, after one valid packet and a byte that breaks the sequence of frames.
ELEMENTS: dict[type[RealtimeProtocol | PrimaryProtocol], dict[str, bytes]] = {
    RealtimeProtocol: {
        "the connection's size everywhere": struct.pack(">i", 1220),
        "the largest size everywhere": struct.pack(">i", 4092),
        "packets that follow each other": struct.pack(">id", 1220, 5.5) + bytes(1208),
    },
    PrimaryProtocol: {
        "large states, small sub-packages": package(8192, 16) + package(10, 16),
        "large states everywhere": package(8192, 16),
        "large messages everywhere": package(8192, 20),
        "a state, a byte, and so on": _STATE + b"\xff",
        "zeros": bytes(1),
    },
}
FIRST: dict[type[RealtimeProtocol | PrimaryProtocol], bytes] = {
    RealtimeProtocol: bytes(RealtimeState("5.10", time=5.0)),
    PrimaryProtocol: bytes(VersionMessage("5.8", project_name="URControl", major=5, minor=8, build_date="x" * 20)),
}


def milliseconds(framer: Framer, stream: bytes, chunk: int) -> float:
    """Return the processor time of feeding a stream in chunks."""
    chunks = [stream[at : at + chunk] for at in range(0, len(stream), chunk)]
    began = time.process_time()
    for each in chunks:
        framer.feed(each)
    return (time.process_time() - began) * 1e3


def measure(rounds: int) -> dict[str, list[float]]:
    """Return, by title, the median milliseconds at once, in sevens, and byte by byte."""
    figures = {}
    for kind, elements in ELEMENTS.items():
        for title, element in elements.items():
            stream = b"\xff" + (element * _SIZE)[: _SIZE - 1]
            row = []
            for chunk in _CHUNKS:
                times = []
                for _ in range(rounds):
                    framer = kind().framer
                    framer.feed(FIRST[kind])
                    times.append(milliseconds(framer, stream, chunk))
                row.append(statistics.median(times))
            figures[f"{kind.__name__}: {title}"] = row
    waiting = []
    for chunk in _CHUNKS:
        # A header that declares more bytes than arrive, so there is nothing to search.
        times = []
        for _ in range(rounds):
            framer = PrimaryProtocol().framer
            framer.feed(FIRST[PrimaryProtocol])
            framer.feed(package(_SIZE, 25))
            times.append(milliseconds(framer, bytes(_SIZE - 6), chunk))
        waiting.append(statistics.median(times))
    figures["in step, waiting for one large package"] = waiting
    return figures


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="1 round instead of 7")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    options = parser.parse_args()
    figures = measure(1 if options.quick else 7)
    if options.json:
        print(json.dumps(figures))
        return
    print(f"{'ms for 64 KiB (goal: below 50)':60} {'at once':>9} {'in 7s':>9} {'bytewise':>9}")
    for title, row in figures.items():
        print(f"{title:60} " + " ".join(f"{each:9.1f}" for each in row))


if __name__ == "__main__":
    main()

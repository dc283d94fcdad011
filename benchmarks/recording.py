"""Cost of recording in the receive path: the reader thread, from the end of one read to the next read.

Two streams of real-time packets run in one process, one with a recorder and one without. Both are paced like a
controller and read in turn, so that they run under the same conditions. The measured time is from the moment when
`receive` returns a packet to the reader thread until the thread asks for the next packet. It includes framing, decoding
and passing the packet on, with or without a recorder. It does not include the recorder's own thread, which writes the
file, unless that thread delays the reader.

    python benchmarks/recording.py            # 10 rounds of 1000 packets each
    python benchmarks/recording.py --quick    # 3 rounds of 300
"""

from __future__ import annotations

import argparse
import json
import tempfile
import threading
import time
from pathlib import Path

import numpy as np

from linkcore.clock import Stamp
from linkcore.errors import ConnectionLost
from linkcore.recording.file import Kind, RecordingFile
from linkcore.recording.recorder import Recorder
from linkcore.streaming.connection import Connection
from linkcore.streaming.fanout import FanOut
from linkcore.streaming.stream import Stream
from urlink.packets import RealtimeState
from urlink.protocol.realtime.protocol import RealtimeProtocol

#: Time between two packets, in s: a quarter of the fastest controller's period, but long enough for the thread to
#: sleep.
PERIOD = 0.0005
PACKET = bytes(RealtimeState("5.10", q_actual=[0.1, -1.5, 1.2, -1.3, -1.5, 0.0]))


class PacedTransport:
    """Transport that returns a packet each period, and records the time until the next read."""

    name = "paced"
    round_trip = 1e-4

    def __init__(self) -> None:
        self.costs: list[float] = []
        self._left = 0
        self._given: float | None = None
        self._given_cpu = 0.0
        self._closed = False
        self._go = threading.Condition()

    def run(self, packets: int) -> None:
        """Return `packets` packets, and wait until the reader has finished the last one."""
        with self._go:
            self._left = packets
            self._go.notify_all()
            self._go.wait_for(lambda: self._left == 0 and self._given is None)

    def open(self, timeout: float) -> None:
        pass

    def receive(self, timeout: float | None = None) -> tuple[bytes, Stamp]:
        now = time.perf_counter()
        if self._given is not None:
            self.costs.append(now - self._given)
            self._given = None
            with self._go:
                self._left -= 1
                self._go.notify_all()
        with self._go:
            self._go.wait_for(lambda: self._left or self._closed)
        if self._closed:
            raise ConnectionLost("over")
        time.sleep(PERIOD)
        stamp = Stamp(time.monotonic(), time.time())
        self._given = time.perf_counter()
        return PACKET, stamp

    def send(self, data: bytes, timeout: float) -> None:
        raise NotImplementedError

    def send_some(self, data: bytes | memoryview) -> int:
        raise NotImplementedError

    def wait_for_room(self, timeout: float) -> bool:
        raise NotImplementedError

    def abort(self) -> None:
        with self._go:
            self._closed = True
            self._go.notify_all()

    def close(self) -> None:
        self.abort()


def compare(folder: Path, rounds: int, packets: int) -> dict[str, float]:
    transports = {name: PacedTransport() for name in ("plain", "recorded")}
    streams = {
        name: Stream(Connection(name, transport, RealtimeProtocol, FanOut(RealtimeState), silence=None), RealtimeState)
        for name, transport in transports.items()
    }
    with Recorder(folder / "run.urlog") as recorder:
        recorder.add(streams["recorded"], {"name": "realtime"})
        streams["plain"].start()
        for number in range(rounds + 1):
            for name in sorted(transports, reverse=bool(number % 2)):
                transports[name].run(packets)
            if number == 0:  # warm-up
                for transport in transports.values():
                    transport.costs.clear()
    written = sum(record.kind is Kind.BYTES for record in RecordingFile(folder / "run.urlog"))
    assert written == streams["recorded"].stats.received == (rounds + 1) * packets
    for stream in streams.values():
        stream.close()
    plain, recorded = (np.array(transports[name].costs).reshape(rounds, packets) for name in ("plain", "recorded"))
    # The median packet of each round, and the median round of those differences.
    difference = np.median(recorded, axis=1) - np.median(plain, axis=1)
    return {
        "plain_us": float(np.median(plain)) * 1e6,
        "recorded_us": float(np.median(recorded)) * 1e6,
        "recording_us": float(np.median(difference)) * 1e6,
        "ratio": float(np.median(recorded) / np.median(plain)),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="3 rounds of 300 packets")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    options = parser.parse_args()
    rounds, packets = (3, 300) if options.quick else (10, 1000)
    with tempfile.TemporaryDirectory() as folder:
        figures = compare(Path(folder), rounds, packets)
    if options.json:
        print(json.dumps(figures))
        return
    print("reader thread, per packet of the real-time interface (median)")
    print(f"  without a recorder   {figures['plain_us']:8.2f} us")
    print(f"  with a recorder      {figures['recorded_us']:8.2f} us   {figures['ratio']:.2f} x")
    print(f"  recording            {figures['recording_us']:8.2f} us   (goal: at most 1 us)")


if __name__ == "__main__":
    main()

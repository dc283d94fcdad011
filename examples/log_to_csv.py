"""Write every real-time state to a CSV file, and say at the end whether all of them are in it.

    python examples/log_to_csv.py run.csv
    python examples/log_to_csv.py run.csv 192.168.56.101 --duration 60

To keep everything rather than a few columns, record the bytes: `urlink record`, or `robot.record(path)`.
"""

import argparse
import csv
import time

import urlink
from urlink.packets import RealtimeState


def row(state: RealtimeState) -> list[object]:
    wall = "" if state.received is None else f"{state.received.wall:.6f}"
    return [wall, state.time, *state.q_actual.tolist(), *state.tcp_force.tolist()]


HEAD = ["wall", "time", *(f"q{joint}" for joint in range(6)), "Fx", "Fy", "Fz", "Mx", "My", "Mz"]


def main() -> None:
    parser = argparse.ArgumentParser(description="Log real-time states as CSV.")
    parser.add_argument("file", help="CSV file to write")
    parser.add_argument(
        "address", nargs="?", default="sim://?motion=demo", help="robot, simulator or recording (a simulator)"
    )
    parser.add_argument("--duration", type=float, default=float("inf"), help="seconds (until Ctrl-C)")
    args = parser.parse_args()

    with open(args.file, "w", newline="") as file, urlink.connect(args.address) as robot:
        writer = csv.writer(file)
        writer.writerow(HEAD)

        def write(state: RealtimeState) -> None:
            writer.writerow(row(state))

        # 5000 states are 10 s at 500 Hz: a disk that stops for that long costs nothing.
        subscription = robot.realtime.subscribe(write, policy=urlink.drop_oldest(5000))
        try:
            until = time.monotonic() + args.duration
            # The end of a recording ends the stream by itself.
            while time.monotonic() < until and not subscription.join(0.1):
                pass
        except KeyboardInterrupt:
            pass
        subscription.finish()  # deliver what waits, then stop
        stats = subscription.stats
        print(f"{stats.delivered} states written, {stats.dropped} dropped, {stats.raised} failed")


if __name__ == "__main__":
    main()

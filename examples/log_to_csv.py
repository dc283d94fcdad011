"""Write every real-time state to a CSV file, and report at the end whether any state is missing.

    python examples/log_to_csv.py run.csv
    python examples/log_to_csv.py run.csv 192.168.56.101 --duration 60

To keep all data rather than a few columns, record the bytes: `urlink record`, or `robot.record(path)`.
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
        "address", nargs="?", default="sim://?motion=demo", help="robot, simulator or recording (default: a simulator)"
    )
    parser.add_argument("--duration", type=float, default=float("inf"), help="duration, s (default: until Ctrl-C)")
    args = parser.parse_args()

    with open(args.file, "w", newline="") as file, urlink.connect(args.address) as robot:
        writer = csv.writer(file)
        writer.writerow(HEAD)

        def write(state: RealtimeState) -> None:
            writer.writerow(row(state))

        # 5000 states are 10 s at 500 Hz, so no state is lost even if the disk stops for that long.
        subscription = robot.realtime.subscribe(write, policy=urlink.drop_oldest(5000))
        try:
            until = time.monotonic() + args.duration
            # At the end of a recording, the stream ends on its own.
            while time.monotonic() < until and not subscription.join(0.1):
                pass
        except KeyboardInterrupt:
            pass
        subscription.finish()  # deliver the queued states, then stop
        stats = subscription.stats
        print(f"{stats.delivered} states written, {stats.dropped} dropped, {stats.raised} failed")


if __name__ == "__main__":
    main()

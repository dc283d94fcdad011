"""Print joint positions and the robot mode five times per second, until Ctrl-C or for --duration seconds.

python examples/print_state.py
python examples/print_state.py 192.168.56.101 --duration 10
"""

import argparse
import contextlib
import time

import urlink


def main() -> None:
    parser = argparse.ArgumentParser(description="Print joint positions and modes.")
    parser.add_argument(
        "address", nargs="?", default="sim://?motion=demo", help="robot, simulator or recording (default: a simulator)"
    )
    parser.add_argument("--duration", type=float, default=float("inf"), help="duration, s (default: until Ctrl-C)")
    args = parser.parse_args()

    with urlink.connect(args.address) as robot:
        until = time.monotonic() + args.duration
        print(f"{robot.model}, firmware {robot.firmware}")
        shown = 0.0
        # The loop receives the newest state each time, so a slow loop never lags behind the robot.
        for state in robot.realtime:
            now = time.monotonic()
            if now >= until:
                break
            if now - shown >= 0.2:
                shown = now
                joints = " ".join(f"{angle:7.3f}" for angle in state.q_actual)
                # A field that the firmware does not send is None.
                mode = "?" if state.robot_mode is None else state.robot_mode.name
                print(f"{state.time:9.3f} s  {joints} rad  {mode}")
        print(f"{robot.realtime.stats.received} states received")


if __name__ == "__main__":
    with contextlib.suppress(KeyboardInterrupt):
        main()

"""Check each state against limits, within a deadline: what a supervisor beside a control loop does.

The first state out of limits, and the first silence longer than the deadline, end the program with exit status 1.
It only watches. It is no safety function: what has to be safe belongs into the robot's own safety configuration.

    python examples/closed_loop_monitor.py 192.168.56.101 --speed 1.0 --deadline 0.05
"""

import argparse
import sys
import threading
import time

import numpy as np

import urlink
from urlink.packets import RealtimeState, SafetyMode


class Supervisor:
    """Decides on each state; what it finds ends the program."""

    def __init__(self, speed: float) -> None:
        self.speed = speed
        self.checked = 0
        self.reason: str | None = None
        self.alarm = threading.Event()

    def check(self, state: RealtimeState) -> None:
        self.checked += 1
        fastest = float(np.abs(state.qd_actual).max())
        if fastest > self.speed:
            self.stop(f"a joint moves at {fastest:.3f} rad/s")
        elif state.safety_mode not in (None, SafetyMode.NORMAL, SafetyMode.REDUCED):
            self.stop(f"safety mode {state.safety_mode.name}")

    def late(self, silence: float) -> None:
        self.stop(f"no state for {silence * 1e3:.0f} ms")

    def stop(self, reason: str) -> None:
        if self.reason is None:
            self.reason = reason
        self.alarm.set()


def main() -> int:
    parser = argparse.ArgumentParser(description="Watch limits and a deadline.")
    parser.add_argument(
        "address", nargs="?", default="sim://?motion=demo", help="robot, simulator or recording (a simulator)"
    )
    parser.add_argument("--speed", type=float, default=1.0, help="largest joint speed, rad/s (1.0)")
    parser.add_argument("--deadline", type=float, default=0.1, help="longest silence, s (0.1)")
    parser.add_argument("--duration", type=float, default=float("inf"), help="seconds (until Ctrl-C)")
    args = parser.parse_args()

    supervisor = Supervisor(args.speed)
    with urlink.connect(args.address) as robot:
        until = time.monotonic() + args.duration
        # Only the newest state counts: one that waited is no basis for a decision.
        robot.realtime.subscribe(
            supervisor.check, policy=urlink.latest, deadline=args.deadline, on_deadline=supervisor.late
        )
        while time.monotonic() < until:
            if supervisor.alarm.wait(min(0.1, max(until - time.monotonic(), 0.0))):
                break
    print(f"{supervisor.checked} states checked: {supervisor.reason or 'all within limits'}")
    return 0 if supervisor.reason is None else 1


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(130)

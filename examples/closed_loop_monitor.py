"""Check each state against limits and a deadline, as a supervisor next to a control loop does.

The program ends with exit status 1 at the first state that exceeds a limit, or the first silence that exceeds the
deadline. It only watches. It is not a safety function: configure safety in the robot's own safety configuration.

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
    """Check of each state; the first violation ends the program."""

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
        "address", nargs="?", default="sim://?motion=demo", help="robot, simulator or recording (default: a simulator)"
    )
    parser.add_argument("--speed", type=float, default=1.0, help="maximum joint speed, rad/s (default: 1.0)")
    parser.add_argument("--deadline", type=float, default=0.1, help="maximum silence, s (default: 0.1)")
    parser.add_argument("--duration", type=float, default=float("inf"), help="duration, s (default: until Ctrl-C)")
    args = parser.parse_args()

    supervisor = Supervisor(args.speed)
    with urlink.connect(args.address) as robot:
        until = time.monotonic() + args.duration
        # Only the newest state counts: a decision must not use an older, queued state.
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

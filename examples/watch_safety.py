"""Print every change of the safety mode, every message of the controller, and lost connections.

python examples/watch_safety.py 192.168.56.101
python examples/watch_safety.py --demonstrate    # the simulator makes a protective stop
"""

import argparse
import contextlib
import time
from datetime import datetime

import urlink
from urlink import ConnectionEvent, ConnectionState
from urlink.packets import MasterboardData, RobotMessage, SafetyMode, Stamp
from urlink.simulator import Controller


class Watch:
    """Callbacks that print changes."""

    def __init__(self) -> None:
        self.mode: object = None

    def on_masterboard(self, data: MasterboardData) -> None:
        # CB2 has its own safety state instead of the safety mode.
        mode = data.safety_mode if data.safety_mode is not None else data.master_safety_state
        if mode is not None and mode != self.mode:
            self.mode = mode
            tell(data.received, f"safety mode: {mode.name}")

    def on_message(self, message: RobotMessage) -> None:
        tell(message.received, str(message))

    def on_connection(self, event: ConnectionEvent) -> None:
        if event.state is ConnectionState.LOST:
            self.mode = None  # the previous mode may no longer be true
            tell(event.received, f"connection lost: {event.error}")
        elif event.state is ConnectionState.CONNECTED:
            tell(event.received, "connected")


def demonstrate(controller: Controller, watch: Watch, until: float) -> None:
    """Cause a protective stop and clear it, each after the previous mode was printed."""
    for mode, fault in ((SafetyMode.NORMAL, "protective_stop"), (SafetyMode.PROTECTIVE_STOP, "clear")):
        while watch.mode is not mode and time.monotonic() < until:
            time.sleep(0.02)
        controller.schedule(f"{fault}@{controller.time}")


def tell(when: Stamp | None, text: str) -> None:
    moment = datetime.now() if when is None else datetime.fromtimestamp(when.wall)
    # One write for the whole line: every subscription prints from its own thread.
    print(f"{moment:%H:%M:%S.%f}"[:-3] + f" {text}\n", end="", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description="Watch the safety of a robot.")
    parser.add_argument("address", nargs="?", default="sim://", help="robot, simulator or recording (default: sim://)")
    parser.add_argument("--duration", type=float, default=float("inf"), help="duration, s (default: until Ctrl-C)")
    parser.add_argument("--demonstrate", action="store_true", help="make a protective stop in the simulator")
    args = parser.parse_args()

    watch = Watch()
    with urlink.connect(args.address) as robot:
        until = time.monotonic() + args.duration
        # Each subscription has its own thread. The first subscription opens the connection.
        robot.primary.subscribe(watch.on_connection, ConnectionEvent)
        robot.primary.subscribe(watch.on_message, RobotMessage)
        robot.primary.subscribe(watch.on_masterboard, MasterboardData)
        if args.demonstrate and robot.controller is not None:
            demonstrate(robot.controller, watch, until)
        while time.monotonic() < until:
            time.sleep(min(0.1, max(until - time.monotonic(), 0.0)))


if __name__ == "__main__":
    with contextlib.suppress(KeyboardInterrupt):
        main()

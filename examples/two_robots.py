"""Read several robots in one process, and print how regularly the states of each robot arrive.

python examples/two_robots.py 192.168.56.101 192.168.56.102
"""

import argparse
import contextlib
import time

import urlink


def main() -> None:
    parser = argparse.ArgumentParser(description="Read several robots at once.")
    parser.add_argument("addresses", nargs="*", default=["sim://ur5e", "sim://ur10?firmware=3.4"], metavar="ADDRESS")
    parser.add_argument("--duration", type=float, default=float("inf"), help="duration, s (default: until Ctrl-C)")
    args = parser.parse_args()

    with contextlib.ExitStack() as stack:
        robots = [stack.enter_context(urlink.connect(address)) for address in args.addresses]
        for robot in robots:
            robot.realtime.start()
        until = time.monotonic() + args.duration
        while time.monotonic() < until:
            time.sleep(min(0.5, max(until - time.monotonic(), 0.0)))
            for robot in robots:
                state, stats = robot.realtime.latest, robot.realtime.stats
                where = "not connected" if state is None else f"tool at {state.tool_vector_actual[:3].round(3)} m"
                print(f"{robot.address}: {where}, {stats.rate:.0f} Hz, {stats.reconnects} reconnects")


if __name__ == "__main__":
    with contextlib.suppress(KeyboardInterrupt):
        main()

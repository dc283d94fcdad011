"""Benchmark: latency and losses at 500 Hz, from the arrival of a state to the callback in another process.

    python benchmark.py [SECONDS]

The latency is measured with the clock of this computer, which both processes share. A state counts as lost if it
arrived here, between the first and the last state that the node received, but did not arrive at the node.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path

os.environ["ROS_DOMAIN_ID"] = "99"
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"

import urlink
from urlink.simulator import Controller
from urlink_ros2 import serve


def main(seconds: str) -> None:
    with Controller("UR5e", "5.11") as controller, urlink.connect(controller.address) as robot:
        arrived: list[float] = []
        robot.realtime.subscribe(lambda state: arrived.append(state.received.wall if state.received else 0.0))
        before, began = time.process_time(), time.monotonic()
        with serve({"arm": robot}):
            for only in ("joints", ""):
                command = [sys.executable, str(Path(__file__).parent / "driver.py"), "listen", seconds, only]
                done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
                heard = json.loads(done.stdout)
                there = sum(heard["first"] - 1e-6 <= wall <= heard["newest"] + 1e-6 for wall in arrived)
                print(
                    f"{only or 'all topics'}: {heard['count']} of {there} joint states, "
                    f"p50 {1e3 * heard['late_p50']:.2f} ms, p99 {1e3 * heard['late_p99']:.1f} ms"
                )
        share = (time.process_time() - before) / (time.monotonic() - began)
        print(f"processor of this process, simulator and reading included: {share:.2f}")


if __name__ == "__main__":
    main(*sys.argv[1:] or ["10"])

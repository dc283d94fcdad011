"""What does it cost that a program asks before it moves the arm?

A simulated controller in a process of its own is sent short programs by `robot.script.run`, one after the other: from
the call until the controller says that the program is over. In turn with the question (the default) and without it
(`start_register=None, start_flags=()`), in one run; the difference of the medians is the price, which is also given in
cycles of the controller. The reply has to come by way of this process, so a busy machine shows in it.

    python benchmarks/start_latency.py                 # 1.8, 3.4, 5.11 and 5.25; 100 programs each way
"""

from __future__ import annotations

import argparse
import statistics
import time

from _simulated import simulated

import urlink

CONTROLLERS = (("UR5", "1.8"), ("UR5", "3.4"), ("UR5e", "5.11"), ("UR5e", "5.25"))


def took(robot: urlink.Robot) -> float:
    began = time.perf_counter()
    robot.script.run("sync()", wait=True)
    return time.perf_counter() - began


def main() -> None:
    parser = argparse.ArgumentParser(description="The price of asking before a program moves the arm.")
    parser.add_argument("--count", type=int, default=100, help="programs each way (100)")
    count = parser.parse_args().count
    print("firmware   asking p50   without p50   difference   cycles   ratio")
    for model, firmware in CONTROLLERS:
        with (
            simulated(model, firmware) as address,
            urlink.connect(address) as asking,
            urlink.connect(address, start_register=None, start_flags=()) as bare,
        ):
            for robot in (asking, bare):
                took(robot)
            pairs = [(took(asking), took(bare)) for _ in range(count)]
            with_question, without = (statistics.median(times) for times in zip(*pairs, strict=True))
            difference = with_question - without
            print(
                f"{firmware:8} {with_question * 1e3:9.1f} ms {without * 1e3:10.1f} ms {difference * 1e3:9.1f} ms"
                f" {difference * asking.firmware.rate:8.1f} {with_question / without:7.2f}"
            )


if __name__ == "__main__":
    main()

"""Delay that is caused because a program asks for its start permission before it moves the arm.

A simulated controller in a separate process receives short programs by `robot.script.run`, one after the other. The
time is from the call until the controller reports that the program has ended. Programs run in turn with the question
(the default) and without it (`start_register=None, start_flags=()`), in one run. The difference of the medians is the
delay, which is also shown in cycles of the controller. The reply comes from this process, so a busy machine affects it.

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
    parser = argparse.ArgumentParser(description="Measure the delay of asking before a program moves the arm.")
    parser.add_argument(
        "--count", type=int, default=100, help="number of programs with and without the question (default: 100)"
    )
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

"""Delay until the arm follows a stream, age of the followed points, and cost of a cycle on this computer.

A simulated e-Series controller runs in a separate process, at 500 Hz.

- *applied*: from the call of `append`, with the arm at rest, to the arrival of the first state whose target joint
  positions have moved; and the same for `servo.send`, which has no buffer.
- *fresh*: every 50 ms the tail is replaced from `stream.time` on, as by a policy that needs no time to compute. The
  figure is the time from the requested time until the replacement takes effect.
- *cost*: processor time of this process for each state, while the arm moves: of a subscription alone, and in addition
to
  it, of a servo, of streams and of an impedance.

    python benchmarks/streams.py                     # 100 points, 200 replacements, 20 s of each
    python benchmarks/streams.py --output FILE       # writes the figures
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
from _simulated import simulated

import urlink
from urlink import TrajectoryPoint

READY = np.array([0.0, -1.6, 1.6, -1.6, -1.6, 0.0])
WAY = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
STILL = [0.0] * 6
#: The first firmware with direct torque and the registers.
FIRMWARE = "5.25"
PERIOD = 0.05
Link = Literal["reverse", "rtde"]
LINKS: tuple[Link, ...] = "reverse", "rtde"
#: Smallest movement of a target, in rad, that is more than rounding.
MOVED = 1e-6


def meant(t: float) -> TrajectoryPoint:
    """Return a point of a regular wave of the last joint."""
    c, s = math.cos(t), math.sin(t)
    return TrajectoryPoint(READY + 0.2 * (1 - c) * WAY, t, 0.2 * s * WAY, 0.2 * c * WAY)


def shown(robot: urlink.Robot, command: Callable[[], object]) -> float:
    """Return the time, in s, from a command to the first state whose targets have moved."""
    here = robot.realtime.wait().q_target
    moved = Future[float]()

    def look(state: urlink.RealtimeState) -> None:
        if not moved.done() and np.abs(state.q_target - here).max() > MOVED:
            moved.set_result(time.monotonic())

    with robot.realtime.subscribe(look, inline=True):
        begin = time.monotonic()
        command()
        return moved.result(5.0) - begin


def applied(robot: urlink.Robot, link: Link, count: int) -> list[float]:
    found = []
    with robot.motion.stream(link=link) as stream:
        for number in range(count):
            turn = 0.01 * (1 - 2 * (number % 2)) * WAY
            goal = robot.realtime.wait().q_target + turn
            found.append(shown(robot, partial(stream.append, TrajectoryPoint(goal, stream.end + 0.3, STILL, STILL))))
            stream.wait_until_dry()
            time.sleep(0.5)  # until the arm is at the commanded position
    return found


def sent(robot: urlink.Robot, count: int) -> list[float]:
    found = []
    with robot.motion.servo(watchdog=0.5) as servo:
        for number in range(count):
            turn = 0.0005 * (1 - 2 * (number % 2)) * WAY
            found.append(shown(robot, partial(servo.send, robot.realtime.wait().q_target + turn)))
            goal = robot.realtime.wait().q_target
            for _ in range(100):  # until it is at rest there
                robot.realtime.wait()
                servo.send(goal)
    return found


def fresh(robot: urlink.Robot, link: Link, count: int) -> list[float]:
    found = []
    with robot.motion.stream(link=link) as stream:
        stream.append([meant(PERIOD * step) for step in range(1, 21)], wait=False)
        while stream.time < 0.2:
            time.sleep(0.01)
        for _ in range(count):
            looked = stream.time
            points = [meant(looked + PERIOD * step) for step in range(1, 21)]
            found.append(stream.replace(looked, points) - looked)
            time.sleep(PERIOD)
        stream.clear()
        stream.wait_until_dry()
    return found


def cost(robot: urlink.Robot, what: str, seconds: float) -> float:
    """Return the processor time for each state, in s."""
    motion = robot.motion
    blocks: dict[str, Callable[[], Any]] = {
        "subscription": nullcontext,
        "servo": partial(motion.servo, watchdog=0.5),
        "stream": motion.stream,
        "stream, rtde": partial(motion.stream, link="rtde"),
        "impedance": motion.impedance,
    }
    with blocks[what]() as led:
        if what.startswith("stream"):
            led.append([meant(PERIOD * step) for step in range(1, round((seconds + 3.0) / PERIOD))], wait=False)
        begin = robot.realtime.wait().q_target
        count, used, begun = 0, 0.0, 0.0
        for state in robot.realtime:
            t = 0.002 * count
            if what == "servo" or (what == "impedance" and count % 50 == 0):
                led.send(begin + 0.05 * (1 - math.cos(t)) * WAY)
            if count == 500:  # everything that is loaded only once is loaded now
                used, begun = time.process_time(), state.time
            count += 1
            if count > 500 and state.time - begun > seconds:
                break
        return (time.process_time() - used) / (count - 500)


def figures(values: list[float]) -> dict[str, float]:
    return {"median": float(np.median(values)), "99 %": float(np.percentile(values, 99)), "count": len(values)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="run a tenth of it")
    parser.add_argument("--output", type=Path, help="write the figures as JSON")
    options = parser.parse_args()
    part = 0.1 if options.quick else 1.0
    found: dict[str, Any] = {}
    with (
        simulated("UR5e", FIRMWARE) as address,
        urlink.connect(address, stale_after=20.0, silence=30.0, reverse_peer="127.0.0.1") as robot,
    ):

        def ready() -> urlink.Robot:
            robot.motion.move_joints(READY, 2.0, 10.0).wait()
            return robot

        for link in LINKS:
            found[f"append, {link}"] = figures(applied(ready(), link, round(100 * part)))
        found["servo.send"] = figures(sent(ready(), round(100 * part)))
        for link in LINKS:
            found[f"replace, {link}"] = figures(fresh(ready(), link, round(200 * part)))
        for name, row in found.items():
            kind = "holds" if name.startswith("replace") else "applied"
            print(f"{name:16} {kind} after {1e3 * row['median']:5.1f} ms, 99 %: {1e3 * row['99 %']:5.1f} ms")
        alone = cost(ready(), "subscription", 20.0 * part)
        print(f"a subscription costs {1e6 * alone:.0f} us per cycle; in addition to that:")
        for what in ("servo", "stream", "stream, rtde", "impedance"):
            found[f"cost of {what}"] = more = cost(ready(), what, 20.0 * part) - alone
            print(f"{what:16} {1e6 * more:5.0f} us per cycle, {100 * more * 500:.0f} % of a processor")
        found["cost of a subscription"] = alone
    if options.output:
        options.output.write_text(json.dumps(found) + "\n")


if __name__ == "__main__":
    main()

"""Delay from a state to its set-point: the reverse link, input registers, and ur_rtde's servoJ loop.

A simulated e-Series controller runs in a separate process, on the standard ports of a loopback address, because ur_rtde
has these ports built in. A loop receives each state, and moves wrist 3 along a ramp that depends on the time of the
state. So the target position that the controller reports shows to which state it is the answer. The delay is from the
time of that state to the time of the state that shows the answer. `servoj` itself lags by the same time in all three
loops, because look-ahead time and gain are equal; all three figures include this lag.

    python benchmarks/links.py                         # 10 s each; ur_rtde only if it is installed
"""

from __future__ import annotations

import argparse
import importlib.util
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import urlink
from urlink.simulator.rtde_variables import UPTIME

HOST, FIRMWARE, RATE = "127.0.7.2", "5.11", 500
HOME = (0.0, -1.6, 1.6, -1.6, -1.6, 0.0)
#: Speed of the ramp, in rad/s; look-ahead time, in s, and gain of `servoj`.
SPEED, LOOKAHEAD, GAIN = 0.05, 0.03, 300.0

#: Time, in s, and target of wrist 3, in rad, as the controller reports them.
Targets = list[tuple[float, float]]


@contextmanager
def simulated() -> Iterator[None]:
    command = [sys.executable, "-m", "urlink.cli", "sim", "--model", "UR5e", "--firmware", FIRMWARE]
    process = subprocess.Popen([*command, "--host", HOST, "--ports", "standard"], stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        if not process.stdout.readline():
            raise SystemExit(f"the simulator ended with {process.wait(10)}")
        yield
    finally:
        process.terminate()
        process.communicate(timeout=10)


def with_urlink(robot: urlink.Robot, link: urlink.motion.motions.LinkName, seconds: float) -> float:
    """Command the ramp, and return the time of the state at which it started."""
    with robot.motion.servo(link=link, watchdog=0.5, lookahead_time=LOOKAHEAD, gain=GAIN) as servo:
        begun = robot.realtime.wait()
        for state in robot.realtime:
            servo.send([*HOME[:5], HOME[5] + SPEED * (state.time - begun.time)])
            if state.time - begun.time > seconds:
                break
    return begun.time


#: The loop of ur_rtde's servoJ example, with the ramp.
UR_RTDE = """
import sys
from rtde_control import RTDEControlInterface
from rtde_receive import RTDEReceiveInterface
host, rate, seconds, speed, lookahead, gain = sys.argv[1], *map(float, sys.argv[2:7])
home = [float(each) for each in sys.argv[7:]]
control, receive = RTDEControlInterface(host, rate), RTDEReceiveInterface(host, rate)
begun = receive.getTimestamp()
while True:
    cycle = control.initPeriod()
    passed = receive.getTimestamp() - begun
    control.servoJ([*home[:5], home[5] + speed * passed], 0.0, 0.0, 1.0 / rate, lookahead, gain)
    control.waitPeriod(cycle)
    if passed > seconds:
        break
control.servoStop()
control.stopScript()
print(begun)
"""


def with_ur_rtde(robot: urlink.Robot, seconds: float) -> float:
    numbers = map(str, (RATE, seconds, SPEED, LOOKAHEAD, GAIN, *HOME))
    done = subprocess.run(
        [sys.executable, "-c", UR_RTDE, HOST, *numbers], stdout=subprocess.PIPE, text=True, check=True
    )
    # In RTDE, `timestamp` counts from the start of the simulated computer rather than of the controller.
    return float(done.stdout.split()[-1]) - UPTIME


def delays(targets: Targets, begun: float, seconds: float) -> list[float]:
    """Return the delay, in s, of each state in the middle of the ramp."""
    middle = [(t, q) for t, q in targets if begun + 0.2 * seconds < t < begun + 0.8 * seconds]
    return [t - begun - (q - HOME[5]) / SPEED for t, q in middle]


def main() -> None:
    parser = argparse.ArgumentParser(description="Measure the delay from a state to its set-point.")
    parser.add_argument("--seconds", type=float, default=10.0, help="duration of each ramp, s (default: 10)")
    seconds = parser.parse_args().seconds
    ways: dict[str, Callable[[urlink.Robot], float]] = {
        "reverse link": lambda robot: with_urlink(robot, "reverse", seconds),
        "registers": lambda robot: with_urlink(robot, "rtde", seconds),
    }
    if importlib.util.find_spec("rtde_control"):
        ways["ur_rtde servoJ"] = lambda robot: with_ur_rtde(robot, seconds)
    with simulated(), urlink.connect(HOST, reverse_peer="127.0.0.1", stale_after=10) as robot:
        print("way                 p50        p99        max")
        for name, lead in ways.items():
            robot.motion.move_joints(HOME).wait()
            targets: Targets = []
            with robot.realtime.subscribe(lambda state: targets.append((state.time, float(state.q_target[5])))):  # noqa: B023
                begun = lead(robot)
            found = sorted(delays(targets, begun, seconds))
            p50, p99, most = statistics.median(found), found[round(0.99 * (len(found) - 1))], found[-1]
            print(f"{name:14} {p50 * 1e3:7.1f} ms {p99 * 1e3:7.1f} ms {most * 1e3:7.1f} ms")
            time.sleep(0.5)  # time until its connections are closed


if __name__ == "__main__":
    main()

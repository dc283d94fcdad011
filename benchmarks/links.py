"""From a state to the set-point that it brings about: the reverse link, input registers, and ur_rtde's servoJ loop.

A simulated e-Series controller in a process of its own, on the standard ports of a loopback address, because they are
built into ur_rtde. A loop takes each state and leads wrist 3 along a ramp that goes by the state's own time; so the
position that the controller reports as its target tells which state it is the answer to. The delay is from that state's
time to the time of the state that shows it. What `servoj` itself trails behind with the same look-ahead time and gain
is the same in all three, and is in all three figures.

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
#: rad/s of the ramp, and of `servoj`: s and its gain.
SPEED, LOOKAHEAD, GAIN = 0.05, 0.03, 300.0

#: (s, rad): time and target of wrist 3, as the controller tells them.
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
    """Lead the ramp; the time of the state at which it began."""
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
    # What RTDE calls `timestamp` counts from when the simulated computer was started, not the controller.
    return float(done.stdout.split()[-1]) - UPTIME


def delays(targets: Targets, begun: float, seconds: float) -> list[float]:
    """s, for each state in the middle of the ramp."""
    middle = [(t, q) for t, q in targets if begun + 0.2 * seconds < t < begun + 0.8 * seconds]
    return [t - begun - (q - HOME[5]) / SPEED for t, q in middle]


def main() -> None:
    parser = argparse.ArgumentParser(description="From a state to the set-point that it brings about.")
    parser.add_argument("--seconds", type=float, default=10.0, help="of each ramp (10)")
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
            time.sleep(0.5)  # its connections are gone


if __name__ == "__main__":
    main()

"""Real Ctrl-C at random moments after a motion was started; the arm stops and the robot stays open, as in a notebook.

    python -m tests.urlink.afterwards.interrupts --each 75

runs this for every kind of motion and block, 0 to 100 ms after its call was entered, and prints how often the arm
continued. It takes about 1.2 s for each interrupt. `--within 1` also interrupts later, while the program waits for the
motion.

On Linux and macOS, the interrupt is the signal of a timer. On Windows, it is the Ctrl-C of a console: the program
starts itself again with its own hidden console, so that no other process receives the Ctrl-C. Under pytest, there is no
such console. Another thread then raises SIGINT, which is how Windows itself calls the handler of Ctrl-C.
"""

from __future__ import annotations

import argparse
import contextlib
import ctypes
import os
import random
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import urlink
from tests.urlink.afterwards import client, controller
from urlink import Linear, Taught, TrajectoryPoint
from urlink.motion import TaughtPoint
from urlink.motion.moves.trajectory import Trajectory
from urlink.robot import Robot

__all__ = ["KINDS", "interrupted"]

_ROOT = Path(__file__).resolve().parents[3]
#: Latest interrupt after the start of the call, in s.
WITHIN = 0.1
#: Time limit for a braking arm to come to rest, and time for which it has to stay there, in s.
_BRAKES, _STAYS = 3.0, 0.3
#: Joint speed below which an arm counts as at rest, in rad/s.
_RESTS = 1e-3
#: Variable of the environment of a process that has a console of its own (Windows).
_OWN_CONSOLE = "URLINK_OWN_CONSOLE"
#: Flag for a process that must not receive the Ctrl-C of the console (Windows).
_NEW_GROUP: int = getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0)
#: Maximum duration of a kind without an interrupt, in s.
_LASTS = 10.0

Kind = Callable[[Sequence[Robot]], object]


def _pose(robot: Robot) -> Any:
    return robot.realtime.wait(5).tool_vector_actual.copy()


def _trajectory() -> Trajectory:
    return Trajectory.from_arrays([0, 4, 8], [client.READY, (client.READY + client.GOAL) / 2, client.GOAL])


def _until_interrupted() -> None:
    time.sleep(_LASTS)


def _move_circular(robots: Sequence[Robot]) -> None:
    here, aside = _pose(robots[0]), np.array([0.05, 0.05, 0, 0, 0, 0])
    robots[0].motion.move_circular(here + aside, here + aside * (0, 2, 0, 0, 0, 0), speed=0.02, wait=True)


def _path(robots: Sequence[Robot]) -> None:
    way = [Linear(_pose(robots[0]) + client.ASIDE * each) for each in (0.1, 0.2)]
    robots[0].motion.path(way, speed=0.025, wait=True)


def _play(robots: Sequence[Robot]) -> None:
    taught = Taught([TaughtPoint(client.GOAL, np.zeros(6))], robots[0].model)
    taught.play(robots[0], speed=client.SLOW, wait=True)


def _short_speeds(robots: Sequence[Robot]) -> None:
    while True:
        robots[0].motion.speed_joints(client.TURN, duration=0.5)
        time.sleep(0.02)


def _servo(robots: Sequence[Robot]) -> None:
    with robots[0].motion.servo() as servo:
        begun = robots[0].realtime.wait(5)
        for state in robots[0].realtime:
            servo.send(begun.q_target + client.SLOW * (state.time - begun.time) * np.eye(6)[0])


def _filtered_servo(robots: Sequence[Robot]) -> None:
    with robots[0].motion.servo(target_filter="jerk_limited") as servo:
        servo.send(client.GOAL)
        _until_interrupted()


def _stream(robots: Sequence[Robot], **how: Any) -> None:
    with robots[0].motion.stream(**how) as stream:
        stream.append(_trajectory(), wait=False)
        stream.wait_until_dry()


def _jog(robots: Sequence[Robot]) -> None:
    with robots[0].motion.jog("tool", timeout=60.0) as jog:
        jog.move(client.ALONG)
        _until_interrupted()


def _force_mode(robots: Sequence[Robot]) -> None:
    with robots[0].motion.force_mode("base", *client.DOWN):
        _until_interrupted()


def _freedrive(robots: Sequence[Robot]) -> None:
    with robots[0].freedrive():
        _until_interrupted()


def _teach(robots: Sequence[Robot]) -> None:
    with robots[0].teach():
        _until_interrupted()


def _torque(robots: Sequence[Robot]) -> None:
    with robots[0].motion.torque() as torque:
        client.twist(robots[0], torque)
        _until_interrupted()


def _impedance(robots: Sequence[Robot]) -> None:
    with robots[0].motion.impedance() as impedance:
        client.drawn(robots[0], impedance)
        _until_interrupted()


def _interpreter(robots: Sequence[Robot]) -> None:
    with robots[0].interpreter() as mode:
        mode.execute(client.TEXT, wait=True)


def _group_stream(robots: Sequence[Robot]) -> None:
    with urlink.Group(*robots).stream() as stream:
        points = [TrajectoryPoint(client.READY + np.eye(6)[0] * 0.05 * t, t) for t in np.arange(1.0, 8.0)]
        stream.append([points, points], wait=False)
        _until_interrupted()


#: Function for each kind of motion or block that starts it and stays in it; the interrupt comes at any moment.
KINDS: dict[str, Kind] = {
    "move_joints": lambda robots: robots[0].motion.move_joints(client.GOAL, client.SLOW, 4.0, wait=True),
    "move_linear": lambda robots: robots[0].motion.move_linear(_pose(robots[0]) + client.ASIDE * 0.2, 0.03, wait=True),
    "move_circular": _move_circular,
    "path": _path,
    "Taught.play": _play,
    "until_contact": lambda robots: robots[0].motion.until_contact([0, 1, 0], 0.025, distance=0.2, wait=True),
    "speed_joints, short": _short_speeds,
    "speed_joints": lambda robots: robots[0].motion.speed_joints(client.TURN, duration=8.0, wait=True),
    "speed_linear": lambda robots: robots[0].motion.speed_linear(client.ALONG, duration=8.0, wait=True),
    "speed_joints over RTDE": lambda robots: robots[0].motion.speed_joints(
        client.TURN, duration=8.0, link="rtde", wait=True
    ),
    "follow": lambda robots: robots[0].motion.follow(_trajectory(), wait=True),
    "follow over RTDE": lambda robots: robots[0].motion.follow(_trajectory(), link="rtde", wait=True),
    "follow, low bandwidth": lambda robots: robots[0].motion.follow(_trajectory(), low_bandwidth=True, wait=True),
    "servo": _servo,
    "servo with a target filter": _filtered_servo,
    "stream": _stream,
    "stream over RTDE": lambda robots: _stream(robots, link="rtde"),
    "jog": _jog,
    "force_mode": _force_mode,
    "freedrive": _freedrive,
    "teach": _teach,
    "torque": _torque,
    "impedance": _impedance,
    "script.run": lambda robots: robots[0].script.run(client.TEXT, wait=True),
    "interpreter": _interpreter,
    "Group.move_joints": lambda robots: urlink.Group(*robots).move_joints(
        [client.GOAL, client.GOAL], client.SLOW, wait=True
    ),
    "Group.stream": _group_stream,
}


@contextlib.contextmanager
def arms() -> Iterator[list[Robot]]:
    """Start two simulated arms in separate processes, and yield robots that are connected to them."""
    with contextlib.ExitStack() as opened:
        robots = []
        for _ in range(2):
            command = [sys.executable, "-u", "-m", "tests.urlink.afterwards.controller", "ur5e", "10.12"]
            process = opened.enter_context(
                subprocess.Popen(
                    command,
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    text=True,
                    cwd=_ROOT,
                    creationflags=_NEW_GROUP,
                )
            )
            opened.callback(process.kill)
            assert process.stdout is not None
            address = process.stdout.readline().strip()
            # Allow long silences and delays, because they are caused only by a busy computer here.
            robot = urlink.connect(address, silence=20.0, stale_after=20.0, start_timeout=20.0)
            robots.append(opened.enter_context(robot))
        yield robots


def interrupted(robots: Sequence[Robot], kind: str, after: float) -> str:
    """Start one kind and interrupt it; return a description of the failure, or "" if the arms stop and stay at rest."""
    for robot in robots:
        robot.motion.move_joints(controller.READY, speed=1.0, wait=20)
        robot.realtime.wait_until(_rests, timeout=_BRAKES)
    try:
        with _interrupt(after):
            KINDS[kind](robots)
        return "was not interrupted"
    except KeyboardInterrupt:
        pass
    for robot in robots:
        try:
            _wait_for_lasting_rest(robot)
        except urlink.LinkTimeout:
            return f"the arm still moved after {_BRAKES:g} s"
        current = robot.motion.current
        if current is not None:
            with contextlib.suppress(urlink.LinkError):
                current.wait(_BRAKES)  # a short speed motion ends on its own
            if not current.done:
                return f"{current!r} is still running"
    there = [robot.realtime.wait().q_target for robot in robots]
    time.sleep(_STAYS)
    for robot, q in zip(robots, there, strict=True):
        if np.abs(robot.realtime.wait().q_target - q).max() > _RESTS:
            return "the arm moved again"
    return ""


if sys.platform == "win32":

    @contextlib.contextmanager
    def _interrupt(after: float) -> Iterator[None]:
        """Interrupt the block in this thread after so many seconds."""
        is_over = threading.Event()

        def interrupt() -> None:
            if is_over.wait(after):
                return
            if _OWN_CONSOLE in os.environ:
                ctypes.windll.kernel32.GenerateConsoleCtrlEvent(0, 0)
            else:
                signal.raise_signal(signal.SIGINT)

        thread = threading.Thread(target=interrupt)
        thread.start()
        try:
            yield
        finally:
            is_over.set()
            thread.join()

else:

    @contextlib.contextmanager
    def _interrupt(after: float) -> Iterator[None]:
        """Interrupt the block in this thread after so many seconds."""
        previous = signal.signal(signal.SIGALRM, signal.default_int_handler)  # raises KeyboardInterrupt, as Ctrl-C does
        try:
            signal.setitimer(signal.ITIMER_REAL, after)
            yield
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            signal.signal(signal.SIGALRM, previous)


def _rests(state: Any) -> bool:
    return bool(np.abs(state.qd_target).max() < _RESTS)


def _wait_for_lasting_rest(robot: Robot) -> None:
    """Wait until an arm has been at rest for `_STAYS` on the clock of its controller.

    On a busy computer, the newest state can be older than the permission of the program, which the controller reads
    before the stop. The arm may move between the two.
    """
    since: float | None = None

    def has_rested(state: Any) -> bool:
        nonlocal since
        since = None if not _rests(state) else state.time if since is None else since
        return since is not None and state.time - since >= _STAYS

    robot.realtime.wait_until(has_rested, timeout=_BRAKES)


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--each", type=int, default=75, help="interrupts of each kind (default: 75)")
    parser.add_argument("--seed", type=int, default=1, help="seed of the moments (default: 1)")
    parser.add_argument("--kinds", nargs="*", choices=KINDS, default=list(KINDS), help="kinds to try (default: all)")
    parser.add_argument("--within", type=float, default=WITHIN, help="latest interrupt, in s (default: 0.1)")
    options = parser.parse_args(argv)
    if sys.platform == "win32" and _OWN_CONSOLE not in os.environ:
        command = [
            sys.executable,
            "-u",
            "-m",
            "tests.urlink.afterwards.interrupts",
            *(sys.argv[1:] if argv is None else argv),
        ]
        environment = {**os.environ, _OWN_CONSOLE: "1"}
        # A process with its own console gets only the output that it is given.
        done = subprocess.run(
            command,
            env=environment,
            creationflags=subprocess.CREATE_NO_WINDOW,
            check=False,
            stdin=subprocess.DEVNULL,
            stdout=sys.stdout,
            stderr=sys.stderr,
        )
        return done.returncode
    chance = random.Random(options.seed)
    wrong = 0
    with arms() as robots:
        for kind in options.kinds:
            found: dict[str, int] = {}
            for _ in range(options.each):
                after = chance.uniform(0.0, options.within)
                what = interrupted(robots, kind, after)
                if what:
                    print(f"  {kind}, interrupted after {after * 1e3:.2f} ms: {what}", flush=True)
                    found[what] = found.get(what, 0) + 1
            wrong += sum(found.values())
            print(f"{kind}: {options.each} interrupts, {sum(found.values())} arms continued", flush=True)
    print(f"{options.each * len(options.kinds)} interrupts of {len(options.kinds)} kinds, {wrong} arms continued")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())

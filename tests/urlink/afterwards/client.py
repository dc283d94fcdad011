"""Client program that moves an arm or makes a call, in its own computer or process: `python -m ... ROW ADDRESS`.

It writes "ready", and makes the call when a line arrives. If the line is "wait", it waits for the end of the motion.
Then it writes the result of the call, and waits until it is ended.
"""

from __future__ import annotations

import contextlib
import sys
import threading
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

import urlink
from linkcore import process
from tests.urlink.afterwards import controller
from urlink import Linear, Taught
from urlink.motion import TaughtPoint
from urlink.motion.moves.trajectory import Trajectory
from urlink.robot import Robot
from urlink_compat import rtde_control, urx

#: Start position and goal of motions, in rad. A motion between them takes about 8 s.
READY = np.array(controller.READY)
GOAL = READY + np.array([0.8, 0, 0, 0, 0, 0])
SLOW = 0.1
#: Direction of tool motions: along y of the base.
ASIDE = np.array([0, 1, 0, 0, 0, 0])
TEXT = f"movej({GOAL.tolist()}, a=4, v={SLOW})"
#: Duration of speed motions and trajectories, in s.
LONG = 8.0
#: Time limit for answers and for the start of a motion, in s.
ANSWER = 1.0

#: Function that prepares a call and returns a function that makes it; surrounding blocks are entered on the stack.
Begin = Callable[[Robot, contextlib.ExitStack], Callable[[], object]]


def pose(robot: Robot) -> np.ndarray[Any, np.dtype[np.float64]]:
    return robot.realtime.wait(5).tool_vector_actual.copy()


def moved(name: str, *arguments: Any, **options: Any) -> Begin:
    """Prepare a call of a method of `robot.motion`."""
    return lambda robot, block: lambda: getattr(robot.motion, name)(*arguments, **options)


def entered(make: Callable[[Robot], Any], use: Callable[[Robot, Any], object]) -> Begin:
    """Prepare a block, and an action within it."""

    def begin(robot: Robot, block: contextlib.ExitStack) -> Callable[[], object]:
        return lambda: use(robot, block.enter_context(make(robot)))

    return begin


def move_linear(robot: Robot, block: contextlib.ExitStack) -> Callable[[], object]:
    return lambda: robot.motion.move_linear(pose(robot) + ASIDE * 0.25, speed=0.03)


def move_circular(robot: Robot, block: contextlib.ExitStack) -> Callable[[], object]:
    here = pose(robot)
    aside = np.array([0.05, 0.05, 0, 0, 0, 0])
    return lambda: robot.motion.move_circular(here + aside, here + aside * (0, 2, 0, 0, 0, 0), speed=0.02)


def path(robot: Robot, block: contextlib.ExitStack) -> Callable[[], object]:
    way = [Linear(pose(robot) + ASIDE * each, blend=0.02) for each in (0.1, 0.2)]
    way[-1].blend = 0.0
    return lambda: robot.motion.path(way, speed=0.025)


def play(robot: Robot, block: contextlib.ExitStack) -> Callable[[], object]:
    taught = Taught([TaughtPoint(q, np.zeros(6)) for q in (READY + 0.3 * (GOAL - READY), GOAL)], robot.model)
    return lambda: taught.play(robot, speed=SLOW, blend=0.01)


def follow(robot: Robot, block: contextlib.ExitStack, **how: Any) -> Callable[[], object]:
    trajectory = Trajectory.from_arrays([0, LONG / 2, LONG], [READY, (READY + GOAL) / 2, GOAL])
    return lambda: robot.motion.follow(trajectory, **how)


def lead(robot: Robot, servo: Any) -> None:
    """Send a set-point slightly further for each state."""
    begun = robot.realtime.wait(5).time

    def send(state: Any) -> None:
        with contextlib.suppress(urlink.LinkError):
            servo.send(READY + min(SLOW * (state.time - begun), 0.8) * np.array([1, 0, 0, 0, 0, 0]))

    robot.realtime.subscribe(send)


def streamed(robot: Robot, stream: Any) -> None:
    """Append all points of a motion with constant speed at once; most of them are buffered in memory."""
    way = np.array(TURN)
    times = np.arange(0.1, LONG, 0.1)
    ramp = [SLOW * (max(time - 0.5, 0.0) + 0.5 * min(time, 0.5) ** 2 / 0.5) for time in times]
    speeds = [min(time / 0.5, 1.0) for time in times]
    points = [
        urlink.TrajectoryPoint(READY + angle / SLOW * way, time, speed * way)
        for angle, time, speed in zip(ramp, times, speeds, strict=True)
    ]
    stream.append(points, wait=False)


def drawn(robot: Robot, impedance: Any) -> None:
    """Move the target of the last joint by one radian; the joint follows slowly, at 0.7 rad/s."""
    q = robot.realtime.wait().q_actual
    impedance.send([*q[:5], q[5] + 1.0])


def twist(robot: Robot, torque: Any) -> None:
    """Send a small torque on the last joint for each state."""

    def send(state: Any) -> None:
        with contextlib.suppress(urlink.LinkError):
            torque.send([0, 0, 0, 0, 0, 0.15 - 0.5 * float(state.qd_actual[5])])

    robot.realtime.subscribe(send)


def speed_short(robot: Robot, block: contextlib.ExitStack) -> Callable[[], object]:
    """Prepare a short speed motion that is repeated, as in a loop, until one fails."""
    is_over = threading.Event()
    block.callback(is_over.set)

    def call() -> urlink.Motion:
        return robot.motion.speed_joints(TURN, duration=0.5)

    def go_on(motion: urlink.Motion) -> None:
        with contextlib.suppress(urlink.LinkError):
            while not is_over.wait(0.1) and not isinstance(motion.error, urlink.RemoteError):
                motion = call()

    def begin() -> urlink.Motion:
        motion = call()
        threading.Thread(target=go_on, args=(motion,), daemon=True).start()
        return motion

    return begin


def interpreter(robot: Robot, block: contextlib.ExitStack) -> Callable[[], object]:
    mode = block.enter_context(robot.interpreter())
    return lambda: mode.execute(TEXT)


def dashboard_play(robot: Robot, block: contextlib.ExitStack) -> Callable[[], object]:
    robot.dashboard.load("/p.urp")
    return robot.dashboard.play


def gripper(robot: Robot, block: contextlib.ExitStack) -> Callable[[], object]:
    robot.gripper.activate()
    return lambda: robot.gripper.set(POS=255, SPE=0, GTO=1)  # the same command as `move`, which first sends a query


def off(robot: Robot) -> None:
    """Switch the arm off, and wait until it is off."""
    robot.dashboard.power_off()
    until = time.monotonic() + 10.0
    while robot.realtime.wait(5).robot_mode != urlink.packets.RobotMode.POWER_OFF and time.monotonic() < until:
        time.sleep(0.02)


def power_on(robot: Robot, block: contextlib.ExitStack) -> Callable[[], object]:
    off(robot)
    return robot.dashboard.power_on


def brake_release(robot: Robot, block: contextlib.ExitStack) -> Callable[[], object]:
    off(robot)
    return robot.dashboard.brake_release


def by_urx(robot: Robot, block: contextlib.ExitStack) -> Callable[[], object]:
    other = block.enter_context(urx.Robot(robot.address))
    return lambda: other.movej(GOAL.tolist(), acc=4.0, vel=SLOW, wait=False)


def by_ur_rtde(robot: Robot, block: contextlib.ExitStack, *, is_speed: bool) -> Callable[[], object]:
    other = rtde_control.RTDEControlInterface(robot.address)
    if is_speed:
        return lambda: other.speedJ([SLOW, 0, 0, 0, 0, 0], 1.0)
    return lambda: other.moveJ(GOAL.tolist(), SLOW, 4.0, True)


DOWN = [0, 0, 1, 0, 0, 0], [0, 0, -20, 0, 0, 0], [0.02] * 6
ALONG = [0.03, 0, 0, 0, 0, 0]
TURN = [SLOW, 0, 0, 0, 0, 0]
ROWS: dict[str, Begin] = {
    "move_joints": moved("move_joints", GOAL, SLOW, 4.0),
    "move_linear": move_linear,
    "move_circular": move_circular,
    "path": path,
    "play": play,
    "until_contact": moved("until_contact", [0, 1, 0], 0.025, distance=0.2, retract=False),
    "speed_short": speed_short,
    "speed_joints": moved("speed_joints", TURN, duration=LONG),
    "speed_linear": moved("speed_linear", ALONG, duration=LONG),
    "speed_rtde": moved("speed_joints", TURN, duration=LONG, link="rtde"),
    "follow": follow,
    "follow_rtde": partial(follow, link="rtde"),
    "follow_low_bandwidth": partial(follow, low_bandwidth=True),
    "servo": entered(lambda robot: robot.motion.servo(), lead),
    "stream": entered(lambda robot: robot.motion.stream(), streamed),
    "stream_rtde": entered(lambda robot: robot.motion.stream(link="rtde"), streamed),
    "jog": entered(lambda robot: robot.motion.jog("base", timeout=60.0), lambda robot, jog: jog.move(ALONG)),
    "force_mode": entered(lambda robot: robot.motion.force_mode("base", *DOWN), lambda robot, mode: mode),
    "freedrive": entered(lambda robot: robot.freedrive(), lambda robot, mode: mode),
    "teach": entered(lambda robot: robot.teach(), lambda robot, mode: mode),
    "torque": entered(lambda robot: robot.motion.torque(), twist),
    "impedance": entered(lambda robot: robot.motion.impedance(), drawn),
    "script": lambda robot, block: lambda: robot.script.run(TEXT),
    "script_detached": lambda robot, block: lambda: robot.script.run(TEXT, detached=True),
    "interpreter": interpreter,
    "dashboard_play": dashboard_play,
    "gripper": gripper,
    "urx": by_urx,
    "ur_rtde": partial(by_ur_rtde, is_speed=False),
    "ur_rtde_speed": partial(by_ur_rtde, is_speed=True),
    "send_line": lambda robot, block: lambda: robot.script.send_line(TEXT),
    "secondary": lambda robot, block: lambda: robot.script.run("sec on():\n  set_digital_out(1, True)\nend", wait=True),
    "power_on": power_on,
    "brake_release": brake_release,
}


def program(name: str, address: str, read: Callable[[], str], write: Callable[[str], object]) -> None:
    """Run the client program.

    Args:
        name: Name of the row.
        address: Address of the controller.
        read: Function that waits for a line, or for the end.
        write: Function that writes a line.
    """
    with urlink.connect(address, timeout=ANSWER) as robot, contextlib.ExitStack() as block:
        robot.motion.stop(wait=10)
        call = ROWS[name](robot, block)
        robot.realtime.wait(5)
        write("ready")
        waits, result = read() == "wait", None
        try:
            result = call()
            if waits and isinstance(result, urlink.Handle):
                result.wait(10)
            write("made")
        except urlink.LinkError as error:
            write(f"{type(error).__name__}: {' '.join(str(error).split())}")
        end(read(), robot, block, result)
        read()


def end(how: str, robot: Robot, block: contextlib.ExitStack, result: object) -> None:
    """End the motion or call in one of the ways of `table.ENDS_HERE`; do nothing for any other line."""
    if how == "block left":
        if isinstance(result, urlink.Handle):
            with result:
                pass
        # Leave the blocks in a thread, because leaving an interpreter mode waits for its statements.
        threading.Thread(target=block.close, daemon=True).start()
    elif how == "close":
        robot.close()
    elif how == "exit":
        process._abandon_all("the interpreter exits", True)


def main(name: str, address: str) -> None:
    program(name, address, lambda: sys.stdin.readline().strip(), partial(print, flush=True))


if __name__ == "__main__":
    main(*sys.argv[1:])

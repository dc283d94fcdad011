"""End every motion and mode midway in every way, on the simulated controller of each generation.

The table is modes x firmware x ends. By default, each mode meets each end once, and each firmware gets its share of
both; `nox -f nightly.py -s fuzz` runs all combinations.
"""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import pytest

import urlink
from linkcore.errors import Cancelled, ConnectionLost, LinkError
from linkcore.handle import Motion, Phase
from linkcore.wire.fields import Since
from tests.matrix import IS_WHOLE
from tests.waiting import until
from urlink import Joint, Linear, Taught
from urlink.errors import NotRunning, SafetyStop
from urlink.motion import TaughtPoint
from urlink.motion.moves.trajectory import Trajectory, TrajectoryPoint
from urlink.protocol.enums import ProgramState
from urlink.protocol.firmware import Firmware
from urlink.robot import Robot
from urlink.simulator import Controller, Still

pytestmark = pytest.mark.simulated_time

#: firmware -> arm: each generation, and for the e-Series several versions over the known range
GENERATIONS = {"1.8": "ur5", "3.15": "ur5", "5.11": "ur5e", "5.25": "ur5e", "10.12": "ur5e"}
#: Watchdog, and limit for a stopped arm to come to rest, both in s of the robot's time. If nothing stops it, each
#: motion takes longer than that.
WATCHDOG, SOON = 1.5, 1.0
#: Speed in rad/s above which an arm counts as moving.
MOVES = 0.02
UP = np.array([0, 0, 0.1, 0, 0, 0])

TIMEOUT = 60.0
#: Joint positions in rad: elbow up, tool down.
READY = np.array([0.0, -1.6, 1.6, -1.6, -1.6, 0.0])


class Desk:
    """A controller, a robot connected to it, and the actual motion of the simulated arm."""

    def __init__(self, arm: str, firmware: str, opened: contextlib.ExitStack) -> None:
        self.controller = opened.enter_context(Controller(arm, firmware, motion=Still(READY.tolist())))
        self.robot: Robot = opened.enter_context(urlink.connect(self.controller.address))

    @property
    def speed(self) -> float:
        """Speed of the fastest joint in rad/s, read from the arm itself rather than from a stream."""
        return max(map(abs, self.controller.arm.setpoint.qd))

    @property
    def q(self) -> list[float]:
        """Commanded joint positions, in rad."""
        return list(self.controller.arm.setpoint.q)

    @property
    def is_over(self) -> bool:
        """Whether the arm is at rest and no program commands it: none runs, or a stop has paused it."""
        is_paused = self.controller.modes.program_state is ProgramState.PAUSED
        return self.speed == 0.0 and (is_paused or not self.controller.is_running_program)

    def after(self, seconds: float) -> None:
        """Wait for this much of the robot's time, in s."""
        end = self.controller.time + seconds
        until(lambda: self.controller.time >= end, TIMEOUT)

    def stands_still(self, seconds: float = 0.05) -> bool:
        """Whether the arm does not move for this much of the robot's time, in s."""
        q = self.q
        self.after(seconds)
        return self.q == q and self.speed == 0.0

    def is_rigid(self) -> bool:
        """Whether the arm does not yield when it is pushed."""
        self.controller.push([0, 0, 30.0, 0, 0, 0])
        try:
            return self.stands_still()
        finally:
            self.controller.push([0.0] * 6)


# -- modes: each starts a motion and returns its handle; resources to close afterwards go onto the stack -----------


def pose(robot: Robot) -> np.ndarray[Any, np.dtype[np.float64]]:
    return robot.realtime.wait(5).tool_vector_actual.copy()


def move_joints(robot: Robot, block: contextlib.ExitStack) -> Motion:
    return robot.motion.move_joints(READY + 0.2, speed=0.1)


def move_linear(robot: Robot, block: contextlib.ExitStack) -> Motion:
    return robot.motion.move_linear(pose(robot) + UP, speed=0.05)


def move_circular(robot: Robot, block: contextlib.ExitStack) -> Motion:
    aside = np.array([0.05, 0.05, 0, 0, 0, 0])
    return robot.motion.move_circular(pose(robot) + aside, pose(robot) + aside * (0, 2, 0, 0, 0, 0), speed=0.1)


def path(robot: Robot, block: contextlib.ExitStack) -> Motion:
    return robot.motion.path([Linear(pose(robot) + UP, blend=0.02), Joint(READY)], speed=0.05)


def follow(robot: Robot, block: contextlib.ExitStack, **way: Any) -> Motion:
    q = np.array([READY, READY + 0.1, READY + 0.2])
    q[0] = robot.realtime.wait(5).q_target
    return robot.motion.follow(Trajectory.from_arrays([0, 0.8, 1.6], q), watchdog=WATCHDOG, **way)


def servo(robot: Robot, block: contextlib.ExitStack, **way: Any) -> Motion:
    """A loop that answers each state with a set-point a little further along."""
    servo = block.enter_context(robot.motion.servo(watchdog=WATCHDOG, **way))
    begun, goal = robot.realtime.wait(5), READY + 0.5

    def lead(state: Any) -> None:
        way = np.clip(0.2 * (state.time - begun.time) - 0.05, 0, None)
        with contextlib.suppress(LinkError):
            servo.send(begun.q_target + np.clip(goal - begun.q_target, -way, way))

    block.enter_context(robot.realtime.subscribe(lead))
    return servo


def servo_jerk_limited(robot: Robot, block: contextlib.ExitStack) -> Motion:
    servo = block.enter_context(
        robot.motion.servo(target_filter="jerk_limited", speed=0.2, jerk=100.0, watchdog=WATCHDOG)
    )
    servo.send(READY + 0.4)
    return servo


def schedule(robot: Robot, block: contextlib.ExitStack) -> Motion:
    servo = block.enter_context(robot.motion.servo(watchdog=WATCHDOG))
    assert servo.schedule(READY + 0.3, at=robot.realtime.wait(5).time + 2.0) is not None
    return servo


def streamed(robot: Robot, block: contextlib.ExitStack, **way: Any) -> Motion:
    stream = block.enter_context(robot.motion.stream(watchdog=1.0, **way))
    begin = robot.realtime.wait(5).q_target
    stream.append(TrajectoryPoint(begin + 0.5, 2.5, [0.0] * 6, [0.0] * 6), wait=False)
    return stream


def jog(robot: Robot, block: contextlib.ExitStack, **way: Any) -> Motion:
    jog = block.enter_context(robot.motion.jog("base", timeout=60.0, watchdog=WATCHDOG, **way))
    jog.move([0, 0, 0.1, 0, 0, 0])
    return jog


def speed_joints(robot: Robot, block: contextlib.ExitStack) -> Motion:
    return robot.motion.speed_joints([0.2] * 6, duration=0.5)


def speed_linear(robot: Robot, block: contextlib.ExitStack) -> Motion:
    return robot.motion.speed_linear([0, 0, 0.05, 0, 0, 0], duration=0.5)


def speed_joints_held(robot: Robot, block: contextlib.ExitStack, **way: Any) -> Motion:
    return robot.motion.speed_joints([0.2] * 6, duration=5.0, **way)


def speed_linear_held(robot: Robot, block: contextlib.ExitStack) -> Motion:
    return robot.motion.speed_linear([0, 0, 0.05, 0, 0, 0], duration=5.0)


def force_mode(robot: Robot, block: contextlib.ExitStack, **way: Any) -> Motion:
    """Press towards a table that does not exist."""
    down = [0, 0, 1, 0, 0, 0], [0, 0, -20, 0, 0, 0], [0.05] * 6
    return block.enter_context(robot.motion.force_mode("base", *down, watchdog=WATCHDOG, **way))


def freedrive(robot: Robot, block: contextlib.ExitStack, **way: Any) -> Motion:
    return block.enter_context(robot.freedrive(watchdog=WATCHDOG, **way))


def teach(robot: Robot, block: contextlib.ExitStack) -> Motion:
    teaching = block.enter_context(robot.teach(watchdog=WATCHDOG))
    teaching.record()
    assert teaching.freedrive is not None
    return teaching.freedrive


def play(robot: Robot, block: contextlib.ExitStack) -> Motion:
    points = [TaughtPoint(q, np.zeros(6)) for q in (READY + 0.1, READY + 0.2)]
    return Taught(points, robot.model).play(robot, speed=0.1, blend=0.01)


def until_contact(robot: Robot, block: contextlib.ExitStack) -> Motion:
    return robot.motion.until_contact([0, 0, 1], 0.05, distance=0.1)


def torque(robot: Robot, block: contextlib.ExitStack) -> Motion:
    torque = block.enter_context(robot.motion.torque(watchdog=1.0))
    block.enter_context(robot.realtime.subscribe(partial(push_softly, torque)))
    return torque


def push_softly(torque: Any, state: Any) -> None:
    with contextlib.suppress(LinkError):
        torque.send([0, 0, 0, 0, 0, 0.5])


def impedance(robot: Robot, block: contextlib.ExitStack) -> Motion:
    soft = block.enter_context(robot.motion.impedance(watchdog=1.0))
    q = robot.realtime.wait().q_actual
    soft.send([*q[:5], q[5] + 1.0])
    return soft


def interpreter(robot: Robot, block: contextlib.ExitStack) -> Any:
    interpreter = robot.interpreter()
    block.callback(interpreter._close)
    interpreter.execute(f"movej({(READY + 0.2).tolist()}, v=0.1)")
    return interpreter


_ALWAYS = Since("1.6")
_CB3, _REGISTERS = Since("3.0"), Since("3.9/5.3")


@dataclass(frozen=True)
class Mode:
    """A row of the table.

    Attributes:
        begin: Function that makes the arm move and returns the handle.
        since: Firmware versions that have the mode.
        link: Connection that `cut` closes ("own" is the connection of its program, others are controller ports).
        is_pushed: Whether the arm moves only while a hand pushes it.
    """

    begin: Callable[[Robot, contextlib.ExitStack], Any]
    since: Since = _ALWAYS
    link: str = "primary"
    is_pushed: bool = False


MODES = {
    "move_joints": Mode(move_joints),
    "move_linear": Mode(move_linear),
    "move_circular": Mode(move_circular),
    "path": Mode(path),
    "follow": Mode(follow, link="own"),
    "follow_rtde": Mode(partial(follow, link="rtde"), _REGISTERS, link="rtde"),
    "follow_low_bandwidth": Mode(partial(follow, low_bandwidth=True), _CB3, link="own"),
    "servo": Mode(servo, link="own"),
    "servo_rtde": Mode(partial(servo, link="rtde"), _REGISTERS, link="rtde"),
    "servo_jerk_limited": Mode(servo_jerk_limited, link="own"),
    "schedule": Mode(schedule, link="own"),
    "stream": Mode(streamed, Since("3.4"), link="own"),
    "stream_rtde": Mode(partial(streamed, link="rtde"), _REGISTERS, link="rtde"),
    "jog": Mode(jog, link="own"),
    "jog_rtde": Mode(partial(jog, link="rtde"), _REGISTERS, link="rtde"),
    "speed_joints": Mode(speed_joints),
    "speed_linear": Mode(speed_linear),
    "speed_joints_held": Mode(speed_joints_held, link="own"),
    "speed_joints_held_rtde": Mode(partial(speed_joints_held, link="rtde"), _REGISTERS, link="rtde"),
    "speed_linear_held": Mode(speed_linear_held, link="own"),
    "force_mode": Mode(force_mode, _CB3, link="own"),
    "force_mode_rtde": Mode(partial(force_mode, link="rtde"), _REGISTERS, link="rtde"),
    "freedrive": Mode(freedrive, _CB3, link="own", is_pushed=True),
    "freedrive_rtde": Mode(partial(freedrive, link="rtde"), _REGISTERS, link="rtde", is_pushed=True),
    "teach": Mode(teach, _CB3, link="own", is_pushed=True),
    "play": Mode(play),
    "until_contact": Mode(until_contact, Since("3.3")),
    "torque": Mode(torque, Since("5.23/10.11"), link="own"),
    "impedance": Mode(impedance, Since("5.23/10.11"), link="own"),
    "interpreter": Mode(interpreter, Since("5.10")),
}


# -- ends: each returns the error that the handle must report ------------------------------------------------------


def cancel(desk: Desk, mode: Mode, motion: Any, block: contextlib.ExitStack) -> type[LinkError] | None:
    motion.cancel()
    return Cancelled


def leave(desk: Desk, mode: Mode, motion: Any, block: contextlib.ExitStack) -> type[LinkError] | None:
    """Leave the block of the motion, or a block around the handle."""
    if mode.link in ("own", "rtde") and not motion.name.startswith(("follow", "speed")):
        block.close()
        return None
    with contextlib.suppress(ZeroDivisionError), motion:
        raise ZeroDivisionError
    return Cancelled


def protective_stop(desk: Desk, mode: Mode, motion: Any, block: contextlib.ExitStack) -> type[LinkError] | None:
    desk.controller.faults.protective_stop()
    return SafetyStop


def emergency_stop(desk: Desk, mode: Mode, motion: Any, block: contextlib.ExitStack) -> type[LinkError] | None:
    desk.controller.faults.emergency_stop()
    return SafetyStop


def cut(desk: Desk, mode: Mode, motion: Any, block: contextlib.ExitStack) -> type[LinkError] | None:
    if mode.link == "own":
        motion._life.brake.__self__._link.close()
        return ConnectionLost
    desk.controller.faults.cut(mode.link)
    return ConnectionLost if mode.link == "rtde" else NotRunning


#: error that `wait` raises -> phase, if it is not FAILED
ENDED: dict[type[LinkError] | None, Phase] = {None: Phase.DONE, Cancelled: Phase.CANCELLED}
ENDS = {each.__name__: each for each in (cancel, leave, protective_stop, emergency_stop, cut)}


# -- the table ------------------------------------------------------------------------------------------------------


def table() -> Iterator[tuple[str, str, str]]:
    """Generate (firmware, mode, end)."""
    for (row, (name, mode)), (column, end) in itertools.product(enumerate(MODES.items()), enumerate(ENDS)):
        having = [firmware for firmware in GENERATIONS if Firmware.parse(firmware) in mode.since]
        for firmware in having if IS_WHOLE else [having[(row + column) % len(having)]]:
            yield firmware, name, end


@pytest.mark.matrix(6)
@pytest.mark.parametrize(("firmware", "name", "end"), list(table()))
def test_each_mode_can_be_ended_in_each_way(firmware: str, name: str, end: str) -> None:
    """The handle reports the reason, the arm comes to rest and is rigid, and it can move again."""
    mode = MODES[name]
    with contextlib.ExitStack() as opened, contextlib.ExitStack() as block:
        desk = Desk(GENERATIONS[firmware], firmware, opened)
        robot, controller = desk.robot, desk.controller
        motion = mode.begin(robot, block)
        if mode.is_pushed:
            controller.push([0, 0, 20.0, 0, 0, 0])
        until(lambda: motion.done or desk.speed > MOVES, TIMEOUT)
        assert not motion.done, motion.error
        if mode.is_pushed:
            controller.push([0.0] * 6)

        began = controller.time
        expected = ENDS[end](desk, mode, motion, block)
        if expected is None:
            motion.wait(TIMEOUT)
        else:
            with pytest.raises(expected):
                motion.wait(TIMEOUT)
        assert motion.phase is ENDED.get(expected, Phase.FAILED)
        assert robot.motion.current is None
        block.close()

        if expected is NotRunning:  # the program might continue, so stop it first
            robot.safety.wait_enabled(TIMEOUT)
            began = controller.time
            robot.motion.stop(wait=True)
        until(lambda: desk.is_over, TIMEOUT)
        if (end, mode.link) != ("cut", "rtde"):  # the program on the robot waits for messages
            assert controller.time < began + SOON
        assert desk.is_rigid()
        if expected is ConnectionLost:
            assert "brakes on its own" in str(motion.error)
        if expected is SafetyStop:
            said = len(controller.received)
            with pytest.raises(SafetyStop):
                robot.motion.move_joints(READY)
            assert len(controller.received) == said
        controller.faults.clear()
        if end == "emergency_stop":
            controller.faults.power_on()
        robot.safety.wait_enabled(TIMEOUT)
        assert desk.stands_still()
        # The next motion replaces the program that a protective stop has paused, and runs to its end.
        robot.motion.move_joints(READY + 0.02, speed=3.0, acceleration=25.0).wait(TIMEOUT)
        assert desk.q == pytest.approx(READY + 0.02)
        until(lambda: not controller.is_running_program, TIMEOUT)
        assert desk.is_rigid()

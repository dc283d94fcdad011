"""Measure the effect of the speed slider on each motion, and compare it with the declared effect."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterator

import numpy as np
import pytest

import urlink
from linkcore.errors import BadValue
from tests.urlink.motion.test_scaled import READY, Cell
from urlink.motion.moves.path import Joint
from urlink.motion.moves.trajectory import Trajectory
from urlink.motion.slider import EFFECTS

pytestmark = pytest.mark.simulated_time

#: Speed of the moving joint, in rad/s.
SPEED = 0.3
FAR = (*READY[:5], 2.0)


@contextlib.contextmanager
def looped(cell: Cell, send: Callable[[float], object]) -> Iterator[None]:
    """Call `send` for each state with the time in s since the start; a rejected call ends the loop."""
    over = threading.Event()

    def run() -> None:
        began = cell.robot.realtime.wait().time
        with contextlib.suppress(BadValue, urlink.LinkError):
            while not over.is_set():
                send(cell.robot.realtime.wait().time - began)

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


@contextlib.contextmanager
def moved(cell: Cell) -> Iterator[None]:
    with cell.robot.motion.move_joints(FAR, SPEED):
        yield


@contextlib.contextmanager
def moved_along(cell: Cell) -> Iterator[None]:
    with cell.robot.motion.path([Joint(FAR)], joint_speed=SPEED):
        yield


@contextlib.contextmanager
def at_speed(cell: Cell) -> Iterator[None]:
    with cell.robot.motion.speed_joints([0, 0, 0, 0, 0, SPEED], duration=60.0):
        yield


def way() -> Trajectory:
    speeds = [[0.0] * 6, [0.0] * 5 + [SPEED], [0.0] * 5 + [SPEED], [0.0] * 6]
    places = [[*READY[:5], SPEED * t] for t in (0.0, 0.1, 5.0, 5.1)]
    return Trajectory.from_arrays([0.0, 0.2, 5.1, 5.3], places, speeds)


@contextlib.contextmanager
def led(cell: Cell) -> Iterator[None]:
    with cell.robot.motion.follow(way()):
        yield


@contextlib.contextmanager
def streamed(cell: Cell) -> Iterator[None]:
    with cell.robot.motion.stream() as stream:
        stream.append(way(), wait=False)
        yield


@contextlib.contextmanager
def looped_servo(cell: Cell) -> Iterator[None]:
    with cell.robot.motion.servo() as servo, looped(cell, lambda t: servo.send([*READY[:5], SPEED * t])):
        yield


@contextlib.contextmanager
def counted_servo(cell: Cell) -> Iterator[None]:
    angle = [0.0]
    with cell.robot.motion.servo() as servo:

        def send(t: float) -> None:
            angle[0] += SPEED * servo.scaling / 500.0
            servo.send([*READY[:5], angle[0]])

        with looped(cell, send):
            yield


@contextlib.contextmanager
def targeted_servo(cell: Cell) -> Iterator[None]:
    with cell.robot.motion.servo(target_filter="jerk_limited", speed=SPEED) as servo:
        servo.send(FAR)
        yield


@contextlib.contextmanager
def scheduled_servo(cell: Cell) -> Iterator[None]:
    with cell.robot.motion.servo() as servo:
        servo.schedule([*READY[:5], SPEED * 4.0], cell.robot.realtime.wait().time + 4.0)
        yield


@contextlib.contextmanager
def jogged(cell: Cell) -> Iterator[None]:
    with (
        cell.robot.motion.jog() as jog,
        looped(cell, lambda t: jog.move([0, 0, 0, 0, 0, SPEED])),
    ):
        yield


@contextlib.contextmanager
def pressed(cell: Cell) -> Iterator[None]:
    cell.robot.zero_force_sensor()
    with cell.robot.motion.force_mode("base", [0, 0, 1, 0, 0, 0], [0, 0, 10, 0, 0, 0], [0.05] * 6):
        yield


@contextlib.contextmanager
def freed(cell: Cell) -> Iterator[None]:
    with cell.robot.freedrive():
        cell.controller.push([0.0, 0.0, 10.0, 0.0, 0.0, 0.0])
        yield
        cell.controller.push([0.0] * 6)


@contextlib.contextmanager
def torqued(cell: Cell) -> Iterator[None]:
    with (
        cell.robot.motion.torque() as torque,
        looped(cell, lambda t: torque.send([0, 0, 0, 0, 0, 0.1])),
    ):
        yield


@contextlib.contextmanager
def drawn(cell: Cell) -> Iterator[None]:
    with cell.robot.motion.impedance() as soft:
        soft.send(FAR)
        yield


@contextlib.contextmanager
def touched(cell: Cell) -> Iterator[None]:
    with cell.robot.motion.until_contact([0, 0, 1], 0.05, retract=False):
        yield


WAYS: dict[str, Callable[[Cell], contextlib.AbstractContextManager[None]]] = {
    "move_joints": moved,
    "path": moved_along,
    "speed_joints": at_speed,
    "follow": led,
    "stream": streamed,
    "servo, a loop by the controller's clock": looped_servo,
    "servo, a loop by servo.scaling": counted_servo,
    "servo, target filter": targeted_servo,
    "servo, schedule": scheduled_servo,
    "jog": jogged,
    "until_contact": touched,
    "force_mode": pressed,
    "freedrive": freed,
    "torque": torqued,
    "impedance": drawn,
}


def went(way: Callable[[Cell], contextlib.AbstractContextManager[None]], fraction: float) -> float:
    """Return the distance in rad that the arm moves in 0.4 s, with the slider at a fraction, 1 s after the start."""
    one = Cell("UR5e", "5.25")
    try:
        one.controller.speed_fraction = fraction
        with way(one):
            time.sleep(0.8)
            before = np.array(one.controller.arm.setpoint.q)
            time.sleep(0.4)
            return float(np.abs(np.array(one.controller.arm.setpoint.q) - before).max())
    finally:
        one.controller.speed_fraction = 1.0
        one.close()


def test_slider_effect_is_measured_for_each_motion() -> None:
    assert set(EFFECTS) == set(WAYS), f"every motion in EFFECTS needs an entry in WAYS of {__name__}"


@pytest.mark.slow
@pytest.mark.matrix(2)
@pytest.mark.parametrize("name", WAYS)
def test_slider_effect_matches_declaration(name: str) -> None:
    effect = EFFECTS[name][1]
    full = went(WAYS[name], 1.0)
    assert full > 0.05
    assert went(WAYS[name], 0.5) / full == pytest.approx(effect.half, abs=0.06)
    assert went(WAYS[name], 0.0) / full == pytest.approx(effect.zero, abs=0.01)


@pytest.mark.slow
def test_set_points_that_advance_at_slider_0_are_rejected() -> None:
    """The budget counts the time of the program: with the slider at 0, the arm could only jump afterwards."""
    one = Cell("UR5e", "5.11")
    try:
        with one.robot.motion.servo() as servo:
            servo.send(READY)
            assert servo.scaling == 1.0
            one.controller.speed_fraction = 0.0
            one.robot.realtime.wait_until(lambda state: state.speed_scaling == 0.0)
            assert servo.scaling == 0.0
            for n in range(10):
                servo.send([*READY[:5], 0.0001 * n])
                one.robot.realtime.wait()
            with pytest.raises(BadValue, match=r"q\[5\] \(wrist 3\)"):
                servo.send([*READY[:5], 0.05])
    finally:
        one.controller.speed_fraction = 1.0
        one.close()

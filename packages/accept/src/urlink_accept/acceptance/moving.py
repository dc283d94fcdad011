"""Stage 2: one wrist joint moves by a few degrees, while a person holds a switch at a digital input.

Every goal is within `SWING` of the start position of the wrist. A guard checks each state, and stops the arm if a joint
leaves `BOX` or the switch is released. The speed slider is at 10 %, except in steps that measure its effect. At the
end, the slider is restored.
"""

from __future__ import annotations

import math
import os
import subprocess
from collections.abc import Callable
from functools import partial

from linkcore import clock
from urlink import Cancelled, LinkError, LocalError, Motion, Robot, SafetyStop, Trajectory

from ..identification.exercise import SHOWS_SLIDER, Guard, slider_of
from .logbook import Logbook
from .person import Person, is_held_by
from .standing import Told, try_each

#: Joint that moves; its motion and its stopping limit in rad; speed in rad/s, acceleration in rad/s².
WRIST, SWING, BOX, SPEED, _ACCELERATION = 5, 0.05, math.radians(5.5), 0.3, 3.0
#: Time in s of the trajectory at a slider of 100 %, watchdog of a starved stream, and time for which this program is
#: frozen.
FOLLOWED, WATCHDOG, _FROZEN = 1.0, 0.2, 1.0
#: Slow slider, and sliders for following a trajectory.
_SLOW, _SLIDERS = 0.1, (1.0, 0.5, 0.1)
_SOON, _LONG = 5.0, 40.0


def move(robot: Robot, book: Logbook, person: Person, dead_man: int | None, is_simulated_here: bool) -> None:
    """Try all steps that move the arm. Each step notes its result. Only a stop by the guard prevents later steps.

    Args:
        robot: Robot that was connected while the logbook was open, running, and in remote control if it has this mode.
        book: Logbook to write to.
        person: Person who presses buttons on request.
        dead_man: Number of the digital input that is on while the arm may move; None if `person.holds` reports it
            instead.
        is_simulated_here: Whether the controller is simulated in this process, so that it would be frozen together with
            the process.

    Raises:
        Cancelled: If the guard has stopped the arm, or the dead-man switch is not held at the beginning.
        LinkError: If the slider cannot be set, or the wrist cannot be moved back.
    """
    if robot.firmware < SHOWS_SLIDER:
        book.note("moving", skipped="this firmware does not report its slider")
        return
    guard = Guard(robot, BOX, is_held_by(person, dead_man), lambda why: book.note("guard", why=why))
    if not guard.is_held(robot.realtime.wait(_SOON)):
        raise Cancelled("the dead-man switch is not held")
    before = slider_of(robot)
    robot.set_speed_slider(_SLOW, confirm=_SOON)
    wrist = _Wrist(robot, book, guard)
    book.note("moving", start=guard.start.tolist(), slider=_SLOW)
    steps: dict[str, Callable[[], Told]] = {
        "move": wrist.move,
        "cancel": wrist.cancel,
        **{f"follow-{slider * 100:.0f}": partial(wrist.follow, slider) for slider in _SLIDERS},
        "servo-lag": wrist.lag,
        "pause": wrist.pause,
        "slider-zero": wrist.slider_zero,
        "stop": wrist.stop,
        "starved": wrist.starved,
        "frozen": lambda: wrist.frozen(is_simulated_here),
        "protective-stop": lambda: wrist.protective_stop(person),
    }
    try:
        with robot.realtime.subscribe(guard):
            try_each(book, steps, between=wrist.back)
    finally:
        robot.set_speed_slider(before, confirm=_SOON)


class _Wrist:
    """Steps that move the wrist."""

    def __init__(self, robot: Robot, book: Logbook, guard: Guard) -> None:
        self._robot = robot
        self._book = book
        self._guard = guard

    def _goal(self, part: float = 1.0) -> list[float]:
        goal: list[float] = self._guard.start.tolist()
        goal[WRIST] += SWING * part
        return goal

    def back(self) -> None:
        """Move the wrist to its start position, unless the guard has stopped it."""
        self._guard.check()
        self._robot.set_speed_slider(_SLOW, confirm=_SOON)
        self._robot.motion.move_joints(self._goal(0.0), SPEED, _ACCELERATION).wait(_LONG)
        self._guard.check()

    def _moving(self) -> Motion:
        """Start a motion to the other side. The motion takes about one second."""
        motion = self._robot.motion.move_joints(self._goal(), SPEED, _ACCELERATION)
        self._robot.realtime.wait_until(lambda state: abs(state.qd_target[WRIST]) > 0.5 * SPEED * _SLOW, _SOON)
        return motion

    def move(self) -> Told:
        self._robot.motion.move_joints(self._goal(), SPEED, _ACCELERATION).wait(_LONG)
        clock.sleep(0.3)
        return {"goal": self._goal()}

    def cancel(self) -> Told:
        motion = self._moving()
        self._book.note("cancel", event="told")
        motion.cancel()
        clock.sleep(1.0)
        return {}

    def follow(self, slider: float) -> Told:
        self._robot.set_speed_slider(slider, confirm=_SOON)
        goals = [self._goal(0.0), self._goal(0.5), self._goal()]
        there = Trajectory.from_arrays([0.0, 0.5 * FOLLOWED, FOLLOWED], goals)
        self._robot.motion.follow(there, goal_tolerance=0.005).wait(FOLLOWED / slider + _LONG)
        clock.sleep(0.3)
        return {"goal": self._goal(), "slider": slider}

    def lag(self) -> Told:
        self._robot.set_speed_slider(1.0, confirm=_SOON)
        with self._robot.motion.servo() as servo:
            return {"lag": servo.measure_delay(WRIST, SWING), "lookahead": 0.03}

    def pause(self) -> Told:
        motion = self._moving()
        self._book.note("pause", event="told")
        try:
            self._robot.dashboard.pause()
        except LocalError as error:  # this firmware cannot pause a program
            motion.cancel()
            return {"skipped": str(error)}
        clock.sleep(1.5)
        self._book.note("pause", event="undone")
        self._robot.dashboard.play()
        motion.wait(_LONG)
        return {"goal": self._goal()}

    def slider_zero(self) -> Told:
        motion = self._moving()
        self._book.note("slider-zero", event="told")
        self._robot.set_speed_slider(0.0, confirm=_SOON)
        clock.sleep(1.0)
        self._book.note("slider-zero", event="undone")
        self._robot.set_speed_slider(_SLOW, confirm=_SOON)
        motion.wait(_LONG)
        return {"goal": self._goal()}

    def stop(self) -> Told:
        self._moving()
        self._book.note("stop", event="told")
        self._robot.motion.stop().wait(_SOON)
        clock.sleep(0.5)
        return {}

    def starved(self) -> Told:
        return self._streamed("starved", lambda: clock.sleep(1.0))

    def frozen(self, is_simulated_here: bool) -> Told:
        if is_simulated_here:
            return {"skipped": "the simulated controller is in this process, and would be frozen with it"}
        if os.name != "posix":
            return {"skipped": "this system cannot freeze a process"}
        # The readers are frozen too. The kernel buffers the bytes that show the motion of the arm in this time.
        script = f"kill -STOP {os.getpid()}; sleep {_FROZEN}; kill -CONT {os.getpid()}"

        def freeze() -> None:
            subprocess.run(["sh", "-c", script], check=True)
            self._book.note("frozen", event="thawed", seconds=_FROZEN)
            clock.sleep(0.5)

        return self._streamed("frozen", freeze)

    def _streamed(self, step: str, interrupt: Callable[[], object]) -> Told:
        """Stream set-points that move the wrist slowly, and then stop sending them."""
        ended = ""
        # With the slider at 10 %, each set-point takes ten cycles, and the program checks its watchdog only every ten
        # cycles.
        self._robot.set_speed_slider(1.0, confirm=_SOON)
        try:
            with self._robot.motion.servo(watchdog=WATCHDOG) as servo:
                began = 0.0
                for state in self._robot.realtime:
                    began = began or state.time
                    part = (state.time - began) / 2.0
                    servo.send(self._goal(part))
                    if part > 0.5:
                        break
                self._book.note(step, event="told")
                interrupt()
        except LinkError as error:
            ended = f"{type(error).__name__}: {error}"
        return {"ended": ended}

    def protective_stop(self, person: Person) -> Told:
        motion = self._moving()
        self._book.note("protective-stop", event="told")
        if not person.does("protective-stop"):
            motion.cancel()
            return {"skipped": "no person has caused a protective stop"}
        try:
            motion.wait(_SOON)
            ended = ""
        except SafetyStop as error:
            ended = str(error)
        clock.sleep(0.5)
        if not person.does("unlock"):
            raise Cancelled("no person has unlocked the protective stop")
        self._robot.safety.wait_until_clear(_LONG)
        return {"ended": ended}

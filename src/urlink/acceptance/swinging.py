"""Stage 3: one joint at a time swings about where it stands, as `urlink exercise` has it, for identification.

Each joint is asked for by itself, with the box that the arm sweeps meanwhile. A guard stops whatever else moves.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from linkcore.errors import Cancelled, LinkError

from ..firmware import Firmware
from ..identification.exercise import BESIDE, SWING, Exercise, Guard, exercise, plan_from_here, slider_of
from ..interfaces.realtime.packets import RealtimeState
from ..robot import Robot
from ..vectors import JOINTS
from .logbook import Logbook

__all__ = ["step_of", "swing"]

_SHOWS_ARM = Firmware(3, 0)


def step_of(joint: int) -> str:
    """The name of the step in which a joint swings: "swing-wrist-1"."""
    return f"swing-{JOINTS[joint].replace(' ', '-')}"


def swing(robot: Robot, book: Logbook, is_held: Callable[[RealtimeState], bool], consent: Callable[[str], str]) -> None:
    """Let each joint swing that may; none swings after one that was stopped.

    Args:
        robot: connected within the logbook, running, in remote control where there is such a thing.
        book: in which it is written down.
        is_held: whether the arm may move, by a state.
        consent: asked before each joint with what it does; returns why it may not, or "".

    Raises:
        Cancelled: the guard has stopped the arm, the dead man's input is not held at the beginning, or a motion failed.
        LinkError: the arm is not known, or a joint would leave its limits.
    """
    if robot.firmware < _SHOWS_ARM:
        book.note("swinging", skipped="this firmware does not say which arm it has")
        return
    slider = slider_of(robot)
    start = robot.realtime.wait(5.0).q_target
    book.note("swinging", start=start.tolist(), slider=slider)
    for joint in range(6):
        step = step_of(joint)
        planned = plan_from_here(robot, SWING, joint)
        if refused := consent(_does(joint, planned, slider)):
            book.note(step, event="end", skipped=refused)
            continue
        box = np.full(6, BESIDE)
        box[joint] += SWING
        guard = Guard(robot, box, is_held, lambda why: book.note("guard", why=why))
        book.note(step, event="begin")
        try:
            exercise(robot, planned, guard)
        except LinkError as error:
            book.note(step, event="end", error=f"{type(error).__name__}: {error}")
            raise Cancelled(f"the {JOINTS[joint]} did not swing: {guard.tripped or error}") from error
        book.note(step, event="end", error=None)


def _does(joint: int, planned: Exercise, slider: float) -> str:
    pairs = zip("xyz", planned.low.tolist(), planned.high.tolist(), strict=True)
    box = ", ".join(f"{axis} {low:.2f} to {high:.2f} m" for axis, low, high in pairs)
    return (
        f"moves the {JOINTS[joint]} alone, by {math.degrees(planned.swing):.0f} degrees to either side, in "
        f"{planned.seconds / max(slider, 0.01):.0f} s; joints, the lines between them and the TCP stay within {box} of "
        "the base frame, and the arm is thicker than these lines"
    )

"""The programs of an impedance: springs and dampers between the arm and an aim, by torques that the program computes.

Their text is in `springs.script` and `springs_of_joints.script`, for who wants to read what runs on the robot. It is
put into a loop by words (`links.word_loop`). A word holds the target and its number, by which a new one is known, 0
before the first; or, with `GAINS` in the place of what to do, the stiffness of each axis in thousands and its damping
ratio. Lists are computed with as a whole: whatever has ``direct_torque`` does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from string import Template

from ..firmware import Firmware
from .links import InputRegisters, ReverseSocket, missable, word_loop
from .text import number, vector

__all__ = ["GAINS", "LOOSE", "MARGIN", "TOP", "Springs", "impedance"]

#: What to do, beside `STOP`, `FOLLOW` and `WAIT`: take gains.
GAINS = -1
#: The part of its largest speed at which a joint begins to be braked, and that with which the aim moves at most.
TOP, _RAMP = 0.9, 0.7
#: s that the way to a new target takes at most, if its joints may be so fast.
_LONGEST = 0.25
#: 1/s: the aim follows its ramp as a critically damped second order does.
_ROUNDING = 40.0
#: s in which gains have gone two thirds of the way to what was said.
_BLENDING = 0.1
#: rad in all joints together, in one cycle: no arm is as fast, but a person may have moved one while it was paused.
_MOVED = 0.03
#: 1/s: of its distance to the end of its range, a joint may go so much in a second; rad that are left there.
_APPROACH, MARGIN = 5.0, 0.02
#: 1/s with which a joint that is too fast is braked, for its inertia at the beginning. Chosen: a cycle of 2 ms takes
#: away 15 % of what is too much, so that it does not tremble where the inertia has become a sixth.
_GRIP = 75.0
#: 1/s of damping without any stiffness.
LOOSE = 1.0
#: s in which the springs are let go of.
_FADING = 0.2
#: rad/s² with which the arm brakes that stands already.
_DECELERATION = "stopj(4.0)"


@dataclass(frozen=True)
class Springs:
    """What is set once, when an impedance begins.

    Attributes:
        stiffness: (6,) Nm/rad.
        damping: (6,) ratios: 1 is critical.
        speed: (6,) rad/s, the largest of each joint.
        torque: (6,) Nm of springs and dampers.
        braking: (6,) Nm with which a joint is braked that is too fast, or too close to the end of its range.
        error: (6,) rad of each joint that its spring can be stretched.
        lowest, highest: (6,) rad.
        friction_compensation: the controller makes up for friction.
        watchdog: s without a word after which it ends.
    """

    stiffness: Sequence[float]
    damping: Sequence[float]
    speed: Sequence[float]
    torque: Sequence[float]
    braking: Sequence[float]
    error: Sequence[float]
    lowest: Sequence[float]
    highest: Sequence[float]
    friction_compensation: bool
    watchdog: float


def impedance(firmware: Firmware, link: ReverseSocket | InputRegisters, springs: Springs) -> list[str]:
    """Draw the joints to the aim that the words lead; at the end the springs are let go of, and the arm stands."""
    cycle = 1.0 / firmware.rate
    law = _text("springs_of_joints", error=vector(springs.error), loose=number(LOOSE))
    program = _text(
        "springs",
        stiffness=vector(springs.stiffness),
        damping=vector(springs.damping),
        speed=vector([TOP * each for each in springs.speed]),
        ramp_speed=vector([_RAMP * each * cycle for each in springs.speed]),
        torque=vector(springs.torque),
        braking=vector(springs.braking),
        lowest=vector([each + MARGIN for each in springs.lowest]),
        highest=vector([each - MARGIN for each in springs.highest]),
        longest=number(_LONGEST * firmware.rate),
        pull=number(_ROUNDING**2 * cycle),
        drag=number(2.0 * _ROUNDING * cycle),
        cycle=number(cycle),
        blend=number(cycle / _BLENDING),
        blending=str(round(8.0 * _BLENDING * firmware.rate)),
        moved=number(_MOVED),
        approach=number(_APPROACH),
        grip=number(_GRIP),
        law=law,
    )
    call = f"direct_torque(torques(), friction_comp={'True' if springs.friction_compensation else 'False'})"
    told = f"""
        if wanted == {GAINS}:
          take_gains(goal, speed)
        else:
          take_target(goal, speed[0])
        end
        missed = 0
        {call}
    """
    fading = missable(_FADING, firmware.rate)
    end = f"""
        steps_left = 0
        while hold > 0.0:
          hold = bounded(hold - {number(1.0 / fading)}, 0.0, 1.0)
          {call}
        end
        {_DECELERATION}
    """
    most_missed = missable(springs.watchdog, firmware.rate)
    start = "find_dampers()\nstay()\nmissed = 0"
    loop = word_loop(firmware, link, start, told, call, end, watchdog=springs.watchdog, most_missed=most_missed)
    return [*program.splitlines(), *loop]


def _text(name: str, **values: str) -> str:
    """The text of a template, with its values."""
    template = Path(__file__).with_name(f"{name}.script").read_text(encoding="utf-8")
    return "\n".join(line.rstrip() for line in Template(template).substitute(values).splitlines())

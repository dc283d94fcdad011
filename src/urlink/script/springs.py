"""The programs of an impedance: springs and dampers between the arm and an aim, computed in each cycle by the robot.

Their text is in files beside this one, for who wants to read what runs on the robot: `springs.script` with
`springs_of_joints.script` or `springs_of_tool.script`, whose torques are those of ``direct_torque``, and
`admittance.script` for arms that have a force sensor only; in each, `aim.script` follows the targets, and `tool.script`
finds the tool. They are put into a loop by messages (`links.message_loop`). A message holds the target and its number,
by which a new one is known, 0 before the first; with `GAINS` in the place of what to do, the stiffness of each axis in
thousands and its damping ratio; with `POSTURE`, joint positions and the number of their target. Lists are computed with
as a whole: whatever has ``direct_torque`` does, and so do others from 5.10 on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from string import Template

from ..protocol.firmware import Firmware
from .links import BRAKE, InputRegisters, ReverseSocket, message_loop, missable
from .text import indented, number, vector

#: What to do, beside `STOP`, `FOLLOW` and `WAIT`: take gains, or a posture.
GAINS, POSTURE = -1, -2
#: The part of its largest speed at which a joint begins to be braked, and that with which the aim moves at most.
TOP, _RAMP = 0.9, 0.7
#: s that the way to a new target takes at most, if its joints may be so fast.
_LONGEST = 0.25
#: 1/s: the aim follows its ramp as a critically damped second order does.
_ROUNDING = 40.0
#: s in which gains have reached two thirds of the change that was sent.
_BLENDING = 0.1
#: rad in all joints together, in one cycle: no arm is as fast, but a person may have moved one while it was paused.
_MOVED = 0.03
#: 1/s: of its distance to the end of its range, a joint may go so much in a second; rad that are left there.
_APPROACH, MARGIN = 5.0, 0.02
#: 1/s with which a joint that is too fast is braked, for its inertia at the beginning. Chosen: a cycle of 2 ms takes
#: away 15 % of what is too much, so that it does not tremble where the inertia has become a sixth.
_GRIP = 75.0
#: s after which the inertia of the tool is looked at again, by which it is damped.
_WEIGHING = 0.05
#: 1/s of damping without any stiffness.
LOOSE = 1.0
#: s in which the springs are let go of.
_FADING = 0.2
#: The speed slider does not scale torques; so it scales the way to the target.
_SLIDER = 'get_rtde_value("target_speed_fraction")'
#: The branch for messages that have a posture.
_TAKE_POSTURE = f"""
    elif wanted == {POSTURE}:
      take_posture(goal, speed[0])
"""
#: kg and kg m², the mass of the tool of an arm that is led by the force that it measures; 1/s in which its speed dies
#: away without any spring; m/s² and rad/s². Chosen: it rests on things of 20 kN/m, with what a cycle comes late.
MASS, SETTLING, _HARDEST = (10.0, 10.0, 10.0, 0.3, 0.3, 0.3), 20.0, 5.0
#: From the axes of the base to those of the aim.
_TOOL_AXES = """\
  x = pose_trans(aimed, p[1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
  y = pose_trans(aimed, p[0.0, 1.0, 0.0, 0.0, 0.0, 0.0])
  z = pose_trans(aimed, p[0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
  axes = [[x[0], x[1], x[2], 0.0, 0.0, 0.0], [y[0], y[1], y[2], 0.0, 0.0, 0.0], [z[0], z[1], z[2], 0.0, 0.0, 0.0], \
[0.0, 0.0, 0.0, x[0], x[1], x[2]], [0.0, 0.0, 0.0, y[0], y[1], y[2]], [0.0, 0.0, 0.0, z[0], z[1], z[2]]]
  away = axes * away
  aim_rate = axes * aim_rate"""
#: The arm was moved while its program was paused: its posture is where it is.
_STAYS = """\
  posture = get_actual_joint_positions()
  posture_told = posture
  left = target_number"""


@dataclass(frozen=True)
class ToolSprings:
    """What springs of the tool need beside those of the joints.

    Attributes:
        in_tool: the axes are those of the aim, and turn with it; False for those of the base.
        speed: (6,) m/s and rad/s, the largest along and about each axis.
        force: (6,) N and Nm of the springs along and about each axis.
        posture: (6,) Nm/rad with which the joints are drawn to the posture.
    """

    in_tool: bool
    speed: Sequence[float]
    force: Sequence[float]
    posture: Sequence[float]


@dataclass(frozen=True)
class Springs:
    """What is set once, when an impedance begins.

    Attributes:
        stiffness: (6,) Nm/rad of the joints; with `tool`, N/m along and Nm/rad about its axes.
        damping: (6,) ratios, likewise: 1 is critical.
        speed: (6,) rad/s, the largest of each joint.
        torque: (6,) Nm of springs and dampers; with `tool`, of springs, and dampers have `braking` less this at least.
        braking: (6,) Nm with which a joint is braked that is too fast, or too close to the end of its range; at least
            twice the torque.
        error: (6,) that each spring can be stretched: rad of the joints; with `tool`, m and rad.
        lowest, highest: (6,) rad.
        friction_compensation: the controller makes up for friction.
        watchdog: s without a message after which it ends.
        tool: for springs of the tool; None for those of the joints.
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
    tool: ToolSprings | None = None


def impedance(firmware: Firmware, link: ReverseSocket | InputRegisters, springs: Springs) -> list[str]:
    """Draw the arm to the aim that the messages lead; at the end the springs are let go of, and the arm stands."""
    cycle, tool = 1.0 / firmware.rate, springs.tool
    if tool is None:
        law = _text("springs_of_joints", error=vector(springs.error), loose=number(LOOSE))
        most, fastest = springs.torque, springs.speed
    else:
        law, most, fastest = _of_tool(springs, tool, cycle), springs.braking, tool.speed
    program = _text(
        "springs",
        speed=vector([TOP * each for each in springs.speed]),
        most=vector(most),
        braking=vector(springs.braking),
        lowest=vector([each + MARGIN for each in springs.lowest]),
        highest=vector([each - MARGIN for each in springs.highest]),
        moved=number(_MOVED),
        approach=number(_APPROACH),
        grip=number(_GRIP),
        aim=_aim(firmware, springs.stiffness, springs.damping, fastest, _SLIDER, law),
    )
    call = f"direct_torque(torques(), friction_comp={'True' if springs.friction_compensation else 'False'})"
    received = _TAKE_POSTURE if tool is not None else ""
    return _led(firmware, link, program, call, received, BRAKE, springs.watchdog)


def admittance(
    firmware: Firmware,
    link: ReverseSocket | InputRegisters,
    *,
    stiffness: Sequence[float],
    damping: Sequence[float],
    error: Sequence[float],
    tool: ToolSprings,
    watchdog: float,
) -> list[str]:
    """Move the tool as a mass on such springs would move, by the force that the wrist measures.

    Args:
        stiffness, damping, error, watchdog: as of `Springs`.
        tool: without its posture.
    """
    cycle = 1.0 / firmware.rate
    law = _place(tool, "")
    program = _text(
        "admittance",
        mass=vector(MASS),
        error=vector(error),
        force=vector(tool.force),
        tool_speed=vector(tool.speed),
        sooner=vector([each * cycle for each in (_HARDEST,) * 6]),
        settle=number(SETTLING),
        cycle=number(cycle),
        moved=number(_MOVED),
        turned="  felt = axes * felt" if tool.in_tool else "",
        speeds="transpose(axes) * speeds" if tool.in_tool else "speeds",
        aim=_aim(firmware, stiffness, damping, tool.speed, "1.0", law),
    )
    call = f"speedl(tool_speeds(), {number(_HARDEST)}, {number(cycle)})"
    return _led(firmware, link, program, call, "", f"stopl({number(_HARDEST)})", watchdog)


def _led(
    firmware: Firmware,
    link: ReverseSocket | InputRegisters,
    program: str,
    call: str,
    received: str,
    brake: str,
    watchdog: float,
) -> list[str]:
    """A program that does `call` in each cycle, while messages lead its aim; then its springs fade, and it brakes.

    Args:
        received: the branch for messages of another kind.
    """
    take = f"""
        if wanted == {GAINS}:
          take_gains(goal, speed)
{indented(received)}
        else:
          take_target(goal, speed[0])
        end
        missed = 0
        {call}
    """
    end = f"""
        steps_left = 0
        while hold > 0.0:
          hold = bounded(hold - {number(1.0 / missable(_FADING, firmware.rate))}, 0.0, 1.0)
          {call}
        end
        {brake}
    """
    most_missed = missable(watchdog, firmware.rate)
    start = "stay()\nfind_dampers()\nmissed = 0"
    loop = message_loop(firmware, link, start, take, call, end, watchdog=watchdog, most_missed=most_missed)
    return [*program.splitlines(), *loop]


def _aim(
    firmware: Firmware,
    stiffness: Sequence[float],
    damping: Sequence[float],
    speed: Sequence[float],
    pace: str,
    law: str,
) -> str:
    """The part that follows the targets, with the law between arm and aim.

    Args:
        speed: (6,) the largest of the aim.
        pace: cycles by which it goes on in one cycle: less, where the speed slider slows it down.
    """
    cycle = 1.0 / firmware.rate
    return _text(
        "aim",
        stiffness=vector(stiffness),
        damping=vector(damping),
        ramp_speed=vector([_RAMP * each * cycle for each in speed]),
        longest=number(_LONGEST * firmware.rate),
        pull=number(_ROUNDING**2 * cycle),
        drag=number(2.0 * _ROUNDING * cycle),
        cycle=number(cycle),
        blend=number(cycle / _BLENDING),
        blending=str(round(8.0 * _BLENDING * firmware.rate)),
        pace=pace,
        law=law,
    )


def _of_tool(springs: Springs, tool: ToolSprings, cycle: float) -> str:
    return _text(
        "springs_of_tool",
        posture=vector(tool.posture),
        error=vector(springs.error),
        force=vector(tool.force),
        tool_speed=vector(tool.speed),
        torque=vector(springs.torque),
        slowing=vector([most - each for most, each in zip(springs.braking, springs.torque, strict=True)]),
        loose=number(LOOSE),
        top=number(TOP),
        grip=number(_GRIP),
        cycle=number(cycle),
        weighing=str(round(_WEIGHING / cycle)),
        blend=number(cycle / _BLENDING),
        turned="  jacobian = axes * jacobian" if tool.in_tool else "",
        tool=_place(tool, _STAYS),
    )


def _place(tool: ToolSprings, here: str) -> str:
    """The place of the tool.

    Args:
        here: what else is where the arm is when it stays there.
    """
    frame, axes = ("axes = [away, away, away, away, away, away]", _TOOL_AXES) if tool.in_tool else ("", "")
    return _text("tool", here=here, frame=frame, axes=axes)


def _text(name: str, **values: str) -> str:
    """The text of a template, with its values."""
    template = Path(__file__).with_name(f"{name}.script").read_text(encoding="utf-8")
    return "\n".join(line.rstrip() for line in Template(template).substitute(values).splitlines())

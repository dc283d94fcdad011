"""Programs for impedance control: springs and dampers between the arm and an aim, computed by the robot in each cycle.

The text of the programs is in files next to this module, so that you can read what runs on the robot. `springs.script`,
with `springs_of_joints.script` or `springs_of_tool.script`, computes torques for ``direct_torque``. `admittance.script`
is for arms that have only a force sensor. In each, `aim.script` follows the targets, and `tool.script` computes the
place of the tool. The text is inserted into a message loop (`links.message_loop`).

A message contains the target, its number, which identifies a new target and is 0 before the first one, and the shortest
duration of the movement to it, in s. If the command is `GAINS`, the message contains the stiffness of each axis in
thousands, and its damping ratio. If it is `POSTURE`, the message contains joint positions and the number of their
target. The programs compute with whole lists. Every firmware that has ``direct_torque`` can do this, and so can other
firmware since 5.10.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from string import Template

from ..protocol.firmware import Firmware
from .links import BRAKE, InputRegisters, ReverseSocket, message_loop, missable
from .text import indented, number, vector

#: Commands in addition to `STOP`, `FOLLOW` and `WAIT`: set the gains, or the posture.
GAINS, POSTURE = -1, -2
#: Fractions of the largest speed: above the first one, a joint is braked; the second one is the maximum for the aim.
TOP, RAMP = 0.9, 0.7
#: Maximum duration of the movement to a new target, in s, if the joints may be that fast.
LONGEST = 0.25
#: Rate of the critically damped second-order filter that makes the aim follow its ramp, in 1/s.
_ROUNDING = 40.0
#: Time, in s, after which two thirds of a change of the gains have taken effect.
_BLENDING = 0.1
#: Movement in one cycle, in rad, summed over all joints, that no arm can reach on its own. If an arm has moved further,
#: a person has moved it during a pause.
_MOVED = 0.03
#: Maximum speed of a joint towards the end of its range, per distance, in 1/s; distance that is always kept, in rad.
_APPROACH, MARGIN = 5.0, 0.02
#: Rate of braking a joint that is too fast, in 1/s, for its initial inertia. Chosen: a cycle of 2 ms removes
#: 15 % of the excess speed, so that the joint does not oscillate if its inertia has fallen to a sixth.
_GRIP = 75.0
#: Interval, in s, for computing the inertia of the tool, which determines its damping.
_WEIGHING = 0.05
#: Damping without any stiffness, in 1/s.
LOOSE = 1.0
#: Duration of releasing the springs, in s.
_FADING = 0.2
#: The speed slider does not scale torques, so it scales the movement to the target instead.
_SLIDER = 'get_rtde_value("target_speed_fraction")'
#: Branch for messages that contain a posture.
_TAKE_POSTURE = f"""
    elif wanted == {POSTURE}:
      take_posture(goal, speed[0])
"""
#: For an arm that moves according to its measured force: mass of the tool, in kg and kg m². Rate of decay of its speed
#: without any spring, in 1/s. Limits in m/s² and rad/s². Chosen: the tool rests on objects of 20 kN/m, even with
#: a delay of one cycle.
MASS, SETTLING, _HARDEST = (10.0, 10.0, 10.0, 0.3, 0.3, 0.3), 20.0, 5.0
#: Code that converts from the axes of the base to the axes of the aim.
_TOOL_AXES = """\
  x = pose_trans(aimed, p[1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
  y = pose_trans(aimed, p[0.0, 1.0, 0.0, 0.0, 0.0, 0.0])
  z = pose_trans(aimed, p[0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
  axes = [[x[0], x[1], x[2], 0.0, 0.0, 0.0], [y[0], y[1], y[2], 0.0, 0.0, 0.0], [z[0], z[1], z[2], 0.0, 0.0, 0.0], \
[0.0, 0.0, 0.0, x[0], x[1], x[2]], [0.0, 0.0, 0.0, y[0], y[1], y[2]], [0.0, 0.0, 0.0, z[0], z[1], z[2]]]
  away = axes * away
  aim_rate = axes * aim_rate"""
#: Code for an arm that was moved while its program was paused: its current position becomes its posture.
_STAYS = """\
  posture = get_actual_joint_positions()
  posture_told = posture
  left = target_number"""


@dataclass(frozen=True)
class ToolSprings:
    """Parameters of springs of the tool, in addition to the parameters of `Springs`.

    Attributes:
        in_tool: Whether the axes belong to the aim and turn with it; otherwise they belong to the base.
        speed: Largest speed along and about each axis, shape (6,), in m/s and rad/s.
        force: Largest force and torque of the springs along and about each axis, shape (6,), in N and Nm.
        posture: Stiffness of the springs that pull the joints to the posture, shape (6,), in Nm/rad.
    """

    in_tool: bool
    speed: Sequence[float]
    force: Sequence[float]
    posture: Sequence[float]


@dataclass(frozen=True)
class Springs:
    """Parameters that are set once, when an impedance begins.

    Attributes:
        stiffness: Stiffness, shape (6,), of the joints in Nm/rad; with `tool`, along its axes in N/m and about them in
            Nm/rad.
        damping: Damping ratios, shape (6,), of the same axes; 1 is critical.
        speed: Largest speed of each joint, shape (6,), in rad/s.
        torque: Largest torque of springs and dampers, shape (6,), in Nm; with `tool`, of the springs only. The dampers
            then have at least `braking` minus this.
        braking: Torque that brakes a joint that is too fast or too close to the end of its range, shape (6,), in Nm. It
            is at least twice the torque.
        error: Largest extension of each spring, shape (6,), in rad of the joints; with `tool`, in m and rad.
        lowest, highest: Range of the joints, shape (6,), in rad.
        friction_compensation: Whether the controller compensates for friction.
        watchdog: Maximum time without a message, in s; then the program ends.
        tool: Parameters for springs of the tool; None for springs of the joints.
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
    """Pull the arm to the aim given by messages; at the end, the springs are released and the arm stays in place."""
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
    """Move the tool as a mass on such springs would move, according to the force that the wrist measures.

    Args:
        stiffness, damping, error, watchdog: See `Springs`.
        tool: Parameters of the tool; its posture is not used.
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
    """Return a program that executes `call` in each cycle while messages move its aim; then it releases the springs.

    Args:
        received: Branch for messages of another kind.
    """
    take = f"""
        if wanted == {GAINS}:
          take_gains(goal, speed)
{indented(received)}
        else:
          take_target(goal, speed[0], speed[1])
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
    """Return the part that follows the targets, with the law between arm and aim.

    Args:
        speed: Largest speed of the aim, shape (6,).
        pace: Number of cycles that the aim advances in one cycle; less than 1 if the speed slider slows it down.
    """
    cycle = 1.0 / firmware.rate
    return _text(
        "aim",
        stiffness=vector(stiffness),
        damping=vector(damping),
        ramp_speed=vector([RAMP * each * cycle for each in speed]),
        longest=number(LONGEST * firmware.rate),
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
    """Return the code that computes the place of the tool.

    Args:
        here: Code for other values that are reset when the arm stays where it is.
    """
    frame, axes = ("axes = [away, away, away, away, away, away]", _TOOL_AXES) if tool.in_tool else ("", "")
    return _text("tool", here=here, frame=frame, axes=axes)


def _text(name: str, **values: str) -> str:
    """Return the text of a template with its values inserted."""
    template = Path(__file__).with_name(f"{name}.script").read_text(encoding="utf-8")
    return "\n".join(line.rstrip() for line in Template(template).substitute(values).splitlines())

"""Programs for force control: force mode, freedrive, direct torque, and a movement that ends at a contact.

The first three are message loops (`links.message_loop`) and run as long as messages arrive. They end their mode and
brake if no message arrives for the watchdog's time, if the link ends, or if a message requests it. If anything else
stops the program, the controller also ends the mode.

The URScript manual and public drivers document which firmware has each function (docs/protocols/urscript.md).
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

from ..protocol.firmware import Firmware
from .links import BRAKE, InputRegisters, ReverseSocket, message_loop, missable
from .text import each, indented, lines, number, pose, quoted, vector

#: Messages at the end of a movement to a contact. The joint positions follow the first one.
CONTACT = "urlink: contact "
NO_CONTACT = "urlink: no contact"


@dataclass(frozen=True)
class Pressing:
    """Parameters that are set once, when force mode begins.

    Attributes:
        frame: Pose in the base frame, shape (6,).
        selection: Whether each axis is compliant, shape (6,).
        limits: Limits, shape (6,): speed along compliant axes, in m/s and rad/s; deviation along others, in m and rad.
        kind: How the controller turns the frame, 1, 2 or 3; see `Motions.force_mode`.
        damping, gain: Parameters of the mode; None for the controller's values.
    """

    frame: tuple[float, ...]
    selection: tuple[bool, ...]
    limits: tuple[float, ...]
    kind: int
    damping: float | None
    gain: float | None


def force_mode(
    firmware: Firmware, link: ReverseSocket | InputRegisters, pressing: Pressing, *, watchdog: float
) -> list[str]:
    """Return a program in force mode with the wrench of the newest message.

    Args:
        link: Link that carries the messages.
        pressing: All parameters except the wrench.
        watchdog: Maximum time without a message, in s; then the program ends.
    """
    frame, limits = pose(pressing.frame, "frame"), vector(pressing.limits, what="limits")
    start = ["wrench = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]"]
    if pressing.damping is not None:
        start.append(f"force_mode_set_damping({number(pressing.damping)})")
    if pressing.gain is not None:
        start.append(f"force_mode_set_gain_scaling({number(pressing.gain)})")
    axes = ", ".join("1" if is_free else "0" for is_free in pressing.selection)
    is_other = " or ".join(f"goal[{i}] != wrench[{i}]" for i in range(6))
    received = f"""
        if (not begun) or {is_other}:
          wrench = goal
          force_mode({frame}, [{axes}], wrench, {pressing.kind:d}, {limits})
        end
        begun = True
        missed = 0
        sync()
    """
    end = f"end_force_mode()\n{BRAKE}"
    return _mode_loop(firmware, link, "\n".join(start), received, "sync()", end, watchdog=watchdog)


def freedrive(
    firmware: Firmware,
    link: ReverseSocket | InputRegisters,
    axes: Sequence[bool] | None,
    frame: Sequence[float],
    *,
    watchdog: float,
) -> list[str]:
    """Return a program that stays in freedrive as long as messages arrive.

    Args:
        link: Link that carries the messages.
        axes: Whether each axis of the frame is free, shape (6,); None for all, which every firmware supports.
        frame: Pose in the base frame, shape (6,).
        watchdog: Maximum time without a message, in s; then the program ends.
    """
    arguments = ""
    if axes is not None:
        chosen = ", ".join("1" if is_free else "0" for is_free in axes)
        arguments = f"freeAxes=[{chosen}], feature={pose(frame, 'frame')}"
    received = f"""
        if not begun:
          freedrive_mode({arguments})
        end
        begun = True
        missed = 0
        sync()
    """
    end = f"end_freedrive_mode()\n{BRAKE}"
    return _mode_loop(firmware, link, "", received, "sync()", end, watchdog=watchdog)


def torque(
    firmware: Firmware, link: ReverseSocket | InputRegisters, *, friction_compensation: bool, watchdog: float
) -> list[str]:
    """Return a direct torque program that needs a message in each cycle.

    If a message is late, the last torque fades over the watchdog's time.

    Args:
        link: Link that carries the messages.
        friction_compensation: Whether the controller compensates for friction.
        watchdog: Maximum time without a message, in s; then the program ends.
    """
    call = f"direct_torque({{}}, friction_comp={'True' if friction_compensation else 'False'})"
    received = f"""
        torque = goal
        begun = True
        missed = 0
        {call.format("torque")}
    """
    missed = call.format(f"[{each('torque[{i}] * share')}]")
    start = "torque = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]"
    return _mode_loop(firmware, link, start, received, missed, BRAKE, watchdog=watchdog)


def _mode_loop(
    firmware: Firmware,
    link: ReverseSocket | InputRegisters,
    start: str,
    received: str,
    late: str,
    end: str,
    *,
    watchdog: float,
) -> list[str]:
    """Return a `message_loop` whose mode begins with the first message.

    Args:
        link, start, end, watchdog: See `message_loop`.
        received: See `message_loop`; it must set ``begun`` to True.
        late: See `message_loop`; ``share`` is the remaining fraction of the watchdog's time.
    """
    start += "\nmissed = 0\nbegun = False"
    most_missed = missable(watchdog, firmware.rate)
    late = f"share = 1.0 - missed / {number(most_missed)}\n{late}"
    return message_loop(firmware, link, start, received, late, end, watchdog=watchdog, most_missed=most_missed)


def until_contact(
    firmware: Firmware,
    direction: Sequence[float],
    speed: float,
    acceleration: float,
    distance: float,
    *,
    force: float | None,
    retracts: bool,
) -> list[str]:
    """Move straight until the tool touches something, brake, and return to where the contact began.

    The program sends `CONTACT` with the joint positions at the contact, or `NO_CONTACT` after the distance.

    Args:
        direction: Unit vector in the base frame, shape (3,).
        speed, acceleration: Limits in m/s and m/s².
        distance: Maximum distance, in m; then the movement ends without a contact.
        force: Force in N against the direction that counts as a contact, relative to the initial force. With None, the
            controller detects it (``tool_contact``, firmware 5.4 or later), and also determines where it began.
        retracts: Whether the arm returns to where the contact began.
    """
    velocity = vector([each_axis * speed for each_axis in direction] + [0.0] * 3, what="direction")
    cycles = math.ceil((distance / speed + speed / acceleration) * firmware.rate)
    if force is None:
        towards = vector([*direction, 0.0, 0.0, 0.0], what="direction")
        start, feel = "", f"steps = tool_contact(direction={towards})"
        where, found = "get_actual_joint_positions_history(steps)", "steps > 0"
    else:
        x, y, z = (number(each_axis) for each_axis in direction)
        start = "first = get_tcp_force()"
        feel = f"felt = get_tcp_force()\nagainst = (first[0] - felt[0]) * {x}"
        feel += f" + (first[1] - felt[1]) * {y} + (first[2] - felt[2]) * {z}"
        where, found = "get_actual_joint_positions()", f"against >= {number(force)}"
    back = f"movej(q, a=1.4, v={number(min(speed, 1.0))})" if retracts else ""
    a = number(acceleration, "acceleration")
    text = f"""
{indented(start)}
        touched = False
        cycles = 0
        while cycles < {cycles} and not touched:
{indented(feel, 10)}
          if {found}:
            touched = True
          else:
            speedl({velocity}, {a}, {number(1.0 / firmware.rate)})
            cycles = cycles + 1
          end
        end
        if touched:
          q = {where}
          stopl({number(max(acceleration, 2.0))})
{indented(back, 10)}
          textmsg({quoted(CONTACT)}, q)
        else:
          stopl({a})
          textmsg({quoted(NO_CONTACT)})
        end
    """
    return lines(text)


def contact_of(text: str) -> list[float] | None:
    """Return the joint positions, in rad, from the message at a contact; None for any other text."""
    found = re.fullmatch(rf"{CONTACT}\[([^\]]*)\]", text.strip())
    if found is None:
        return None
    try:
        q = [float(part) for part in found[1].split(",")]
    except ValueError:
        return None
    return q if len(q) == 6 and all(map(math.isfinite, q)) else None

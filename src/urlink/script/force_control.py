"""The programs of force control: force mode, freedrive, direct torque, and a movement that ends at a contact.

The first three are loops by messages (`links.message_loop`): they go on as long as messages come, and end their mode
and brake where none has come for the watchdog's time, where the link ends, or by the message that says so. Should the
program be stopped by something else, the controller ends the mode with it.

Since when a controller has each function is documented in the URScript manual and by public drivers
(docs/protocols/urscript.md).
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

from ..protocol.firmware import Firmware
from .links import BRAKE, InputRegisters, ReverseSocket, message_loop, missable
from .text import each, indented, lines, number, pose, quoted, vector

#: The messages of a movement to a contact at its end; the first is followed by the joint positions.
CONTACT = "urlink: contact "
NO_CONTACT = "urlink: no contact"


@dataclass(frozen=True)
class Pressing:
    """The parameters of force mode that are set once, when it begins.

    Attributes:
        frame: (6,) pose in the base frame.
        selection: (6,) the compliant axes.
        limits: (6,) of speed along them, m/s and rad/s; of deviation along the others, m and rad.
        kind: 1, 2 or 3: how the controller turns the frame; see `Motions.force_mode`.
        damping, gain: None for those of the controller.
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
    """Force mode with the wrench that the messages hold, which may change.

    Args:
        link: how the messages come.
        pressing: all but the wrench.
        watchdog: s without a message after which it ends.
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
    """Freedrive as long as messages come.

    Args:
        link: how the messages come.
        axes: (6,) of the frame that are free; None for all, which every firmware can.
        frame: (6,) pose in the base frame.
        watchdog: s without a message after which it ends.
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
    """Direct torque, a message for each cycle. Where one is late, the last torque fades over the watchdog's time.

    Args:
        link: how the messages come.
        friction_compensation: the controller makes up for friction.
        watchdog: s without a message after which it ends.
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
    """A `message_loop` whose mode begins with the first message.

    Args:
        link, start, end, watchdog: as there.
        received: as there; it sets ``begun`` to True.
        late: as there; a part ``share`` of the watchdog's time is left.
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
    """Move straight until the tool touches something, brake, and go back to where the contact began.

    It says `CONTACT` with the joint positions there, or `NO_CONTACT` after the distance.

    Args:
        direction: (3,) unit vector in the base frame.
        speed, acceleration: m/s and m/s².
        distance: m after which it gives up.
        force: N against the direction, on top of what was there at first, that is a contact; None leaves it to the
            controller (``tool_contact``, from 5.4 on), which knows where it began as well.
        retracts: goes back.
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
    """The joint positions in what a movement says at a contact, rad; None of any other text."""
    found = re.fullmatch(rf"{CONTACT}\[([^\]]*)\]", text.strip())
    if found is None:
        return None
    try:
        q = [float(part) for part in found[1].split(",")]
    except ValueError:
        return None
    return q if len(q) == 6 and all(map(math.isfinite, q)) else None

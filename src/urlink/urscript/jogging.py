"""The program that moves the arm at the speeds that it is told, and brakes where nothing comes.

It gets the same words as `urlink.urscript.programs.streaming`, with speeds in the place of positions.
"""

from __future__ import annotations

from ..firmware import Firmware
from .programs import (
    STARVED,
    STOP,
    WAIT,
    InputRegisters,
    ReverseSocket,
    indented,
    lines,
    missable,
    takes_duration,
    way_of,
)
from .text import number, quoted

__all__ = ["jogging"]


def jogging(
    firmware: Firmware,
    link: ReverseSocket | InputRegisters,
    *,
    is_tool: bool,
    acceleration: float,
    watchdog: float,
) -> list[str]:
    """Move at the speeds of the newest word, and brake where none has come for a while.

    ``speedj`` and ``speedl`` are called anew in each cycle, with the time of one cycle, as public drivers do. So the
    arm goes over from one speed to the next with `acceleration`.

    Args:
        link: how the words come.
        is_tool: they are speeds of the tool in the base frame, m/s and rad/s, rather than of the joints, rad/s.
        acceleration: m/s² or rad/s².
        watchdog: seconds without a word after which it brakes.
    """
    way = way_of(link, firmware, watchdog)
    function, brake = ("speedl", "stopl") if is_tool else ("speedj", "stopj")
    hardness = number(acceleration, "acceleration")
    most_missed = missable(watchdog, firmware.rate)
    if takes_duration(firmware):
        go_on = f"{function}(speeds, {hardness}, {number(1.0 / firmware.rate)})"
    else:
        # The call takes a cycle or none, so that two cycles are the longest that a round can take at a steady speed.
        go_on = f"{function}(speeds, {hardness})\nsync()"
        most_missed = max(most_missed // 2, 2)
    text = f"""
{indented(way.shared)}
        starved = False
        {way.kind} servo():
          speeds = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
          missed = 0
          going = True
          while going:
{indented(way.take, 12)}
            if wanted == {STOP}:
              going = False
            elif wanted == {WAIT}:
              sync()
            elif is_new:
              speeds = goal
              missed = 0
{indented(go_on, 14)}
            elif missed < {most_missed}:
              missed = missed + 1
{indented(go_on, 14)}
            else:
              starved = True
              textmsg({quoted(STARVED)})
              going = False
            end
          end
          {brake}({hardness})
        end
{indented(way.follow)}
    """
    return lines(text)

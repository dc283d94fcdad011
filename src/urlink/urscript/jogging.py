"""The program that moves the arm at the speeds of its words, and brakes where none comes.

It gets the same words as `urlink.urscript.streaming`, with speeds in the place of positions.
"""

from __future__ import annotations

from ..firmware import Firmware
from .links import InputRegisters, ReverseSocket, missable, word_loop
from .programs import takes_duration
from .text import number

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
    function, brake = ("speedl", "stopl") if is_tool else ("speedj", "stopj")
    hardness = number(acceleration, "acceleration")
    most_missed = missable(watchdog, firmware.rate)
    if takes_duration(firmware):
        go_on = f"{function}(speeds, {hardness}, {number(1.0 / firmware.rate)})"
    else:
        # The call takes a cycle or none, so that two cycles are the longest that a round can take at a steady speed.
        go_on = f"{function}(speeds, {hardness})\nsync()"
        most_missed = max(most_missed // 2, 2)
    start = "speeds = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]\nmissed = 0"
    told = f"speeds = goal\nmissed = 0\n{go_on}"
    end = f"{brake}({hardness})"
    return word_loop(firmware, link, start, told, go_on, end, watchdog=watchdog, most_missed=most_missed)

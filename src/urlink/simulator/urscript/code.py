"""What the machine runs: for each function a list of instructions, and nothing that calls itself.

A frame is a plain list: the program's globals, the thread that runs, and the function's own variables. An instruction
is a Python function of the frame that returns the number of the next instruction, or one of the three numbers below
that say why there is none.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Literal

from urlink.firmware import Firmware

__all__ = ["ENDED", "FIRST", "GLOBALS", "SWITCHED", "THREAD", "WAITING", "Code", "Frame", "Instruction", "Script"]

Frame = list[Any]
Instruction = Callable[[Frame], int]

#: Where in a frame the globals, the thread and the first variable are.
GLOBALS, THREAD, FIRST = 0, 1, 2
#: Another function goes on; the thread waits for a later cycle; the thread is over.
SWITCHED, WAITING, ENDED = -1, -2, -3


@dataclass(eq=False)
class Code:
    """A function.

    Attributes:
        name: for messages.
        size: of its frame.
        instructions: one after the other.
        places: line and column of each.
    """

    name: str
    size: int = FIRST
    instructions: list[Instruction] = field(default_factory=list)
    places: list[tuple[int, int]] = field(default_factory=list)


@dataclass(eq=False)
class Script:
    """A program that compiles.

    Attributes:
        name: as after `def` or `sec`; "unnamed" (a guess) for statements alone.
        kind: `sec` runs beside the program that moves the arm.
        firmware: for which it was compiled.
        main: where it begins.
        n_globals: how many global variables it has.
    """

    name: str
    kind: Literal["def", "sec"]
    firmware: Firmware
    main: Code
    n_globals: int

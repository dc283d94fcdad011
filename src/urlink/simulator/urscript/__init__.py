"""URScript, as the simulated controller runs it.

`compile_script` makes a `Script` of a text; an `Execution` runs it, one controller cycle at a time, and uses the
controller through the protocols of `world`. There are no sockets, threads or clocks in here: the same program in the
same world gives the same result, cycle by cycle.
"""

from __future__ import annotations

from .compiler import compile_script
from .errors import ScriptError
from .machine import Execution, Script
from .world import MotionCommands, Move, Sockets, World

__all__ = ["Execution", "MotionCommands", "Move", "Script", "ScriptError", "Sockets", "World", "compile_script"]

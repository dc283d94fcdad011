"""URScript, as the simulated controller runs it.

`compile_script` makes a `Script` of a text; an `Execution` runs it, one controller cycle at a time, and asks the
controller for everything else through the protocols of `world`. No sockets, no threads and no clock are in here: the
same program in the same world does the same, cycle by cycle.
"""

from __future__ import annotations

from .compiler import compile_script
from .errors import ScriptError
from .machine import Execution, Script
from .world import MotionCommands, Move, Sockets, World

__all__ = ["Execution", "MotionCommands", "Move", "Script", "ScriptError", "Sockets", "World", "compile_script"]

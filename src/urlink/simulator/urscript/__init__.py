"""URScript for the simulated controller.

`compile_script` compiles a text to a `Script`. An `Execution` runs the script, one controller cycle at a time, and uses
the controller through the protocols of `world`. This package has no sockets, threads or clocks. The same program in the
same world gives the same result in every cycle.
"""

from __future__ import annotations

from .compiler import compile_script
from .errors import ProgramError
from .machine import Execution, Script
from .world import ScriptWorld

__all__ = ["Execution", "ProgramError", "Script", "ScriptWorld", "compile_script"]

"""URScript for the simulated controller.

`compile_script` compiles a text to a `Script`. An `Execution` runs the script, one controller cycle at a time. It uses
the controller through the protocols in `world`. This package has no sockets, threads or clocks. Therefore the same
program always gives the same result if the controller behaves in the same way.
"""

from __future__ import annotations

from .compiler import compile_script
from .errors import ProgramError
from .machine import Execution, Script
from .world import ScriptWorld

__all__ = ["Execution", "ProgramError", "Script", "ScriptWorld", "compile_script"]

"""Expected contents of `src/urlink/rtde/names.pyi`: names and types of the table, for type checkers and editors.

After a change of the table, ``python tests/urlink/rtde/names_stub.py`` writes the file again.
"""

from __future__ import annotations

import textwrap
from pathlib import Path

from urlink.protocol.rtde.variables import INPUTS, OUTPUTS, TYPES, Variable

PATH = Path(__file__).resolve().parents[3] / "src" / "urlink" / "rtde" / "names.pyi"

_HEAD = '''\
"""The names of all variables, and what type each has in a state: for type checkers and editors only.

Made of `urlink.protocol.rtde.variables`, which is the table; a test holds the two equal.
"""

# fmt: off

from __future__ import annotations

from typing import Literal

from linkcore.wire.packet import Vector

from ..protocol.enums import (
    JointMode,
    ProgramState,
    RobotMode,
    SafetyMode,
    TimeScaleSource,
    ToolDigitalOutputMode,
    ToolMode,
    ToolOutputMode,
)
from ..protocol.rtde.recipes import Outputs

__all__ = ["AnyOutputs", "InputName", "OutputName"]

'''

_TYPES = {
    "BOOL": "bool",
    "DOUBLE": "float",
    "VECTOR3D": "Vector",
    "VECTOR6D": "Vector",
    "VECTOR6INT32": "IntVector",
    "VECTOR6UINT32": "IntVector",
}


def annotation(variable: Variable) -> str:
    """Return the Python type of a variable in a state."""
    if variable.meaning is None:
        return _TYPES.get(variable.type, "int")
    name: str = variable.meaning.__name__
    return name if TYPES[variable.type].count is None else f"tuple[{name}, ...]"


def literal(name: str, names: list[str]) -> str:
    listed = ", ".join(f'"{each}"' for each in names)
    wrapped = textwrap.fill(listed, 120, initial_indent="    ", subsequent_indent="    ", break_on_hyphens=False)
    return f"{name} = Literal[\n{wrapped},\n]\n"


def text() -> str:
    lines = [f"    {variable.name}: {annotation(variable)}" for variable in OUTPUTS.values()]
    doc = '    """A state of outputs that were asked for by name: these are their types. It has no others."""'
    return "\n".join(
        [
            _HEAD + literal("OutputName", list(OUTPUTS)),
            literal("InputName", list(INPUTS)),
            f"\nclass AnyOutputs(Outputs):\n{doc}\n",
            *lines,
            "",
        ]
    )


if __name__ == "__main__":
    PATH.write_text(text(), encoding="utf-8")

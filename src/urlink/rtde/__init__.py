"""RTDE for users: variables of the controller by name, read as a stream and written as inputs.

`robot.rtde` is a `Rtde`. A class of one's own says which variables it is about, and what types they have::

    class Cell(urlink.rtde.Outputs):
        actual_q: Vector
        output_int_register_24: int

    for cell in robot.rtde.outputs(Cell, frequency=125): ...
"""

from __future__ import annotations

from ..interfaces.rtde.packets import MessageLevel, RtdeMessage
from ..interfaces.rtde.protocol import InputInUse, NoSuchVariable, RtdeRefused
from ..interfaces.rtde.recipes import Outputs
from ..interfaces.rtde.variables import INPUTS, OUTPUTS, Variable
from .client import Rtde
from .inputs import Inputs
from .outputs import OutputStream
from .shared_registers import Registers

__all__ = [
    "INPUTS",
    "OUTPUTS",
    "InputInUse",
    "Inputs",
    "MessageLevel",
    "NoSuchVariable",
    "OutputStream",
    "Outputs",
    "Registers",
    "Rtde",
    "RtdeMessage",
    "RtdeRefused",
    "Variable",
]

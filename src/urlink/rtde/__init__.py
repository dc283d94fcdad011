"""RTDE client: read variables of the controller by name as a stream, and write them as inputs.

`robot.rtde` is an `Rtde`. Your own class can declare the variables and their types::

    class Cell(urlink.rtde.Outputs):
        actual_q: Vector
        output_int_register_24: int

    for cell in robot.rtde.outputs(Cell, frequency=125): ...
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from linkcore.names import lazy_names

if TYPE_CHECKING:
    from ..protocol.rtde.packets import MessageLevel as MessageLevel
    from ..protocol.rtde.packets import RtdeMessage as RtdeMessage
    from ..protocol.rtde.recipes import Outputs as Outputs
    from ..protocol.rtde.variables import INPUTS as INPUTS
    from ..protocol.rtde.variables import OUTPUTS as OUTPUTS
    from ..protocol.rtde.variables import Variable as Variable
    from .client import Rtde as Rtde
    from .inputs import Inputs as Inputs
    from .outputs import OutputStream as OutputStream
    from .registers import Registers as Registers

else:
    __getattr__, __dir__, __all__ = lazy_names(
        __name__,
        {
            "..protocol.rtde.packets": "MessageLevel RtdeMessage",
            "..protocol.rtde.recipes": "Outputs",
            "..protocol.rtde.variables": "INPUTS OUTPUTS Variable",
            ".client": "Rtde",
            ".inputs": "Inputs",
            ".outputs": "OutputStream",
            ".registers": "Registers",
        },
    )

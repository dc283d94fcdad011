"""RTDE for users: variables of the controller by name, read as a stream and written as inputs.

`robot.rtde` is a `Rtde`. A class of one's own says which variables it is about, and what types they have::

    class Cell(urlink.rtde.Outputs):
        actual_q: Vector
        output_int_register_24: int

    for cell in robot.rtde.outputs(Cell, frequency=125): ...
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from linkcore.lazy import lazy_names

if TYPE_CHECKING:
    from ..interfaces.rtde.packets import MessageLevel as MessageLevel
    from ..interfaces.rtde.packets import RtdeMessage as RtdeMessage
    from ..interfaces.rtde.recipes import Outputs as Outputs
    from ..interfaces.rtde.variables import INPUTS as INPUTS
    from ..interfaces.rtde.variables import OUTPUTS as OUTPUTS
    from ..interfaces.rtde.variables import Variable as Variable
    from .claims import Registers as Registers
    from .client import Rtde as Rtde
    from .inputs import Inputs as Inputs
    from .outputs import OutputStream as OutputStream

else:
    __getattr__, __dir__, __all__ = lazy_names(
        __name__,
        {
            "..interfaces.rtde.packets": "MessageLevel RtdeMessage",
            "..interfaces.rtde.recipes": "Outputs",
            "..interfaces.rtde.variables": "INPUTS OUTPUTS Variable",
            ".client": "Rtde",
            ".inputs": "Inputs",
            ".outputs": "OutputStream",
            ".claims": "Registers",
        },
        moved={"urlink": "InputInUse NoSuchVariable RtdeRefused"},
    )

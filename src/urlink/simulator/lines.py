"""Lines that are commands to the controller and no URScript.

Source: reference ur-script section 1, from a forum and two drivers. What a real controller answers is not known; this
one does what they say and stays silent. `set robotmode freedrive` is taken and does nothing.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from .modes import Stop

if TYPE_CHECKING:
    from .controller import Controller

__all__ = ["obey"]

_SPEED = re.compile(r"set speed (\d*\.?\d+)")


def obey(controller: Controller, line: str) -> bool:
    """Do what a line says, if it is such a command."""
    words = " ".join(line.split())
    speed = _SPEED.fullmatch(words)
    if speed:
        controller.speed_fraction = min(max(float(speed[1]), 0.0), 1.0)
    elif words == "power on":
        controller.modes.power_on(release_brakes=False)
    elif words == "power off":
        controller.modes.power_off()
    elif words == "set robotmode run":
        controller.modes.power_on()
    elif words == "set unlock protective stop":
        if controller.modes.stop is Stop.PROTECTIVE:
            controller.modes.clear()
    else:
        return words == "set robotmode freedrive"
    return True

"""Forward and inverse kinematics of every arm, published or calibrated.

>>> from urlink.arm.kinematics import Arm
>>> Arm("UR10e").forward([0, -1.5, 0.1, -1.57, 0.5, 0]).round(3).tolist()
[-0.106, -0.276, 1.483, -0.318, 1.834, -1.916]
"""

from __future__ import annotations

from .arm import Arm, Unreachable
from .geometry import DenavitHartenberg, DhTable

__all__ = ["Arm", "DenavitHartenberg", "DhTable", "Unreachable"]

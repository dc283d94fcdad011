"""Inertias of the links, of every arm.

From the `physical_parameters.yaml` of the vendor's ROS description (`ur_description`, 2.4.5 and later). Each is about
the link's centre of mass, along the axes of the DH frame at the end of the link. The file has them in the frames of its
joints, which at the shoulder and at wrists 1 and 2 are turned by 90 degrees about x, and turns the full tensors back
again: they come out as they stand there.

For UR3, UR5 and UR3e the file has no tensors but cylinders of each link's mass and size. For UR5e it has cylinders
too, but tensors for UR7e, which has the same lengths and masses: these are used for both. The tensors of UR10 are
those of UR10e and UR12e. The tensors of UR30 are, but for two signs, those of UR16e, whose links weigh 40 % as much;
which is right is not known. UR8 Long has no such file; see `urlink.models`.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

__all__ = ["INERTIAS"]

# The axis of each link's cylinder in the DH frame at its end: the arm links lie along x, the other joints along y, and
# the flange along z.
_AXES = (1, 0, 0, 1, 1, 2)


def _tensors(*links: tuple[float, float, float, float, float, float]) -> NDArray[np.float64]:
    """(6, 3, 3) out of ixx, ixy, ixz, iyy, iyz, izz of each link, kg m²."""
    return np.array([[(xx, xy, xz), (xy, yy, yz), (xz, yz, zz)] for xx, xy, xz, yy, yz, zz in links])


def _cylinders(*links: tuple[float, float]) -> NDArray[np.float64]:
    """The same out of the inertia across the cylinder's axis and about it, kg m²."""
    tensors = np.array([np.eye(3) * across for across, _ in links])
    for tensor, axis, (_, along) in zip(tensors, _AXES, links, strict=True):
        tensor[axis, axis] = along
    return tensors


_UR3 = _cylinders(
    (0.008093167, 0.005625),
    (0.021728492, 0.00961875),
    (0.006546809, 0.00354375),
    (0.001610641, 0.00225),
    (0.001572174, 0.00225),
    (0.000136267, 0.0001792),
)
_UR5 = _cylinders(
    (0.014972358, 0.01040625),
    (0.133885835, 0.0151074),
    (0.031216804, 0.004095),
    (0.00201389, 0.0021942),
    (0.00183104, 0.0021942),
    (8.0625e-05, 0.000132117),
)
_UR3E = _cylinders(
    (0.008093167, 0.005625),
    (0.021728492, 0.00961875),
    (0.00654457, 0.00354375),
    (0.002085, 0.00225),
    (0.002085, 0.00225),
    (0.000136267, 0.0001792),
)
_UR7E = _tensors(
    (0.0070021, 7.3e-07, -1.053e-05, 0.00648091, 0.00049994, 0.00657286),
    (0.01505885, -5.4e-05, 5.63e-06, 0.33388086, -1.81e-06, 0.33247207),
    (0.00399632, -1.365e-05, 0.00137272, 0.07879254, -6.6e-06, 0.0784851),
    (0.00165491, -2.82e-06, -4.38e-06, 0.00135962, 0.00010157, 0.00126279),
    (0.00135617, -2.74e-06, 4.44e-06, 0.00127827, -5.048e-05, 0.00096614),
    (0.00018694, 6e-08, -1.7e-07, 0.00018908, -9.2e-07, 0.00025756),
)
_UR12E = _tensors(
    (0.03408, 2e-05, -0.00425, 0.03529, 8e-05, 0.02156),
    (0.02814, 5e-05, -0.01561, 0.77068, 2e-05, 0.76943),
    (0.01014, 8e-05, 0.00916, 0.30928, 0.0, 0.30646),
    (0.00296, -1e-05, 0.0, 0.00222, -0.00024, 0.00258),
    (0.00296, -1e-05, 0.0, 0.00222, -0.00024, 0.00258),
    (0.0004, 0.0, 0.0, 0.00041, 0.0, 0.00034),
)
_UR16E = _tensors(
    (0.03351, 2e-05, -1e-05, 0.03374, 0.00374, 0.021),
    (0.02796, -0.0001, -0.0072, 0.47558, 3e-05, 0.47635),
    (0.01091, 6e-05, 0.01012, 0.1206, 1e-05, 0.11714),
    (0.00609, -1e-05, 0.0, 0.00245, 0.00083, 0.00579),
    (0.00389, -1e-05, 0.0, 0.00219, -0.00045, 0.00363),
    (0.00117, 0.0, 0.0, 0.00118, 0.0, 0.00084),
)
_UR15 = _tensors(
    (0.051334, 2.5e-05, -1.6e-05, 0.047702, 0.008805, 0.034263),
    (0.048202, 0.000232, -0.032135, 1.188499, -1.7e-05, 1.182771),
    (0.018481, -5e-06, 0.013601, 0.303502, 3e-06, 0.296843),
    (0.004339, 1.9e-05, 1e-06, 0.002548, 0.000706, 0.003912),
    (0.004288, 1.7e-05, -3e-06, 0.002566, -0.000716, 0.003927),
    (0.001406, -3e-06, 1e-05, 0.001404, -2.4e-05, 0.001002),
)
# Shoulder and wrists are those of UR15.
_UR18 = _UR15.copy()
_UR18[1:3] = _tensors(
    (0.045094, 0.000179, -0.024705, 0.630805, -2e-05, 0.625724),
    (0.016891, 0.0, 0.009081, 0.129732, 3e-06, 0.123451),
)
_UR10G_1750 = _UR15.copy()
_UR10G_1750[1:3] = _tensors(
    (0.056709, 0.000292, -0.054852, 2.44012, -1.4e-05, 2.432744),
    (0.022148, 5.2e-05, 0.019779, 0.633274, 3e-06, 0.625889),
)
_UR20 = _tensors(
    (0.08866, -0.00011, -0.00011, 0.07632, 0.0072, 0.08418),
    (0.1467, 0.00019, -0.05163, 4.6659, 4e-05, 4.6348),
    (0.02612, -5e-05, -0.02898, 0.75763, -1e-05, 0.75327),
    (0.00555, -1e-05, -2e-05, 0.00537, 0.00036, 0.00402),
    (0.00586, -1e-05, -2e-05, 0.00578, -0.00037, 0.00427),
    (0.00092, 0.0, 0.0, 0.00091, 0.0, 0.00117),
)
_UR30 = _tensors(
    (0.03351, 2e-05, -1e-05, 0.03374, 0.00374, 0.021),
    (0.02796, -0.0001, -0.0072, 0.47558, 3e-05, 0.47635),
    (0.01091, 6e-05, 0.01012, 0.1206, 1e-05, 0.11714),
    (0.00609, -1e-05, 0.0, 0.00245, 0.00083, 0.00579),
    (0.00389, 1e-05, 0.0, 0.00219, -0.00045, 0.00363),
    (0.00117, 0.0, 0.0, 0.00118, 0.0, 0.00084),
)

#: (6, 3, 3) kg m² by the name of the arm.
INERTIAS: Mapping[str, NDArray[np.float64]] = MappingProxyType(
    {
        "UR3": _UR3,
        "UR5": _UR5,
        "UR10": _UR12E,
        "UR3e": _UR3E,
        "UR5e": _UR7E,
        "UR7e": _UR7E,
        "UR10e": _UR12E,
        "UR12e": _UR12E,
        "UR16e": _UR16E,
        "UR8 Long": _UR10G_1750,
        "UR15": _UR15,
        "UR18": _UR18,
        "UR20": _UR20,
        "UR30": _UR30,
    }
)

"""The velocity of the tool, at a tenth of the cost of a Jacobian: a simulator needs it twice in every cycle.

Joints 2, 3 and 4 of a UR arm turn about parallel axes, and the twists of its links are right angles, so all six axes
and a point on each can be written down. Frames are those of `urlink.simulator.robot.kinematics`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from urlink.models import Model

__all__ = ["Geometry", "tool_velocity"]

#: d1, a2, a3, d4, d5 in m: all the geometry there is before the tool flange
Geometry = tuple[float, float, float, float, float]


def geometry(model: Model) -> Geometry:
    """The lengths of a model that `tool_velocity` needs."""
    d, a = model.dh_d.tolist(), model.dh_a.tolist()
    return d[0], a[1], a[2], d[3], d[4]


def tool_velocity(lengths: Geometry, q: Sequence[float], qd: Sequence[float], tool: Sequence[float]) -> list[float]:
    """The Jacobian of a point times the joint speeds.

    Args:
        lengths: `geometry` of the model.
        q: six joint positions, rad.
        qd: six joint speeds, rad/s.
        tool: where the point is in the base frame, m; further elements are not looked at.

    Returns:
        Six numbers in the base frame: velocity of the point in m/s, angular velocity of the flange in rad/s.
    """
    d1, a2, a3, d4, d5 = lengths
    v1, v2, v3, v4, v5, v6 = qd
    q23 = q[1] + q[2]
    q234 = q23 + q[3]
    s1, c1 = math.sin(q[0]), math.cos(q[0])
    s234, c234 = math.sin(q234), math.cos(q234)
    s5, c5 = math.sin(q[4]), math.cos(q[4])
    # Axes: joint 1 is z; joints 2 to 4 are (s1, -c1, 0); then joint 5 and joint 6.
    ux, uy, uz = c1 * s234, s1 * s234, -c234
    wx, wy, wz = c5 * s1 - s5 * c1 * c234, -c5 * c1 - s5 * s1 * c234, -s5 * s234
    # A point on each axis: the base, the shoulder, the elbow, wrist 1, and from there along the axes.
    out2, up2 = a2 * math.cos(q[1]), d1 + a2 * math.sin(q[1])
    out3, up3 = out2 + a3 * math.cos(q23), up2 + a3 * math.sin(q23)
    p4x, p4y, p4z = out3 * c1 + d4 * s1, out3 * s1 - d4 * c1, up3
    p5x, p5y, p5z = p4x + d5 * ux, p4y + d5 * uy, p4z + d5 * uz
    # The angular velocity about all axes turns the tool about the origin; what each axis is off it comes off again.
    v234 = v2 + v3 + v4
    ox = v234 * s1 + v5 * ux + v6 * wx
    oy = -v234 * c1 + v5 * uy + v6 * wy
    oz = v1 + v5 * uz + v6 * wz
    out, up = v3 * out2 + v4 * out3, v2 * d1 + v3 * up2 + v4 * up3
    x, y, z = tool[0], tool[1], tool[2]
    return [
        oy * z - oz * y + c1 * up - v5 * (uy * p4z - uz * p4y) - v6 * (wy * p5z - wz * p5y),
        oz * x - ox * z + s1 * up - v5 * (uz * p4x - ux * p4z) - v6 * (wz * p5x - wx * p5z),
        ox * y - oy * x - out - v5 * (ux * p4y - uy * p4x) - v6 * (wx * p5y - wy * p5x),
        ox,
        oy,
        oz,
    ]

"""The velocity of the tool, at a tenth of the cost of a Jacobian: the simulator computes it twice in every cycle.

Joints 2, 3 and 4 of a published arm turn about parallel axes, and the twists of its links are right angles, so all six
axes and a point on each have short formulas.
"""

from __future__ import annotations

from ..rigid import Functions, Number, Six
from .geometry import Angles, Geometry, Lengths, chain

__all__ = ["velocity"]


def velocity(
    geometry: Geometry,
    f: Functions[Number],
    q: Angles[Number],
    qd: Angles[Number],
    point: tuple[Number, Number, Number],
) -> Six[Number]:
    """The Jacobian of a point times the joint speeds.

    Args:
        geometry: of the arm.
        f: `FLOATS` for one row of numbers, `ROWS` for arrays.
        q: joint positions, rad.
        qd: joint speeds, rad/s.
        point: a point fixed to the flange, in the base frame, m.

    Returns:
        In the base frame: velocity of the point in m/s, angular velocity of the flange in rad/s.
    """
    if geometry.is_nominal:
        return _published(geometry.lengths, f, q, qd, point)
    x, y, z = point
    ox = oy = 0.0 * qd[0]
    oz = qd[0]
    vx, vy, vz = -oz * y, oz * x, 0.0 * qd[0]
    for speed, (_, _, ax, _, _, ay, _, _, az, px, py, pz) in zip(qd[1:], chain(geometry, f, q)[:5], strict=True):
        ax, ay, az = speed * ax, speed * ay, speed * az
        lx, ly, lz = x - px, y - py, z - pz
        vx, vy, vz = vx + ay * lz - az * ly, vy + az * lx - ax * lz, vz + ax * ly - ay * lx
        ox, oy, oz = ox + ax, oy + ay, oz + az
    return vx, vy, vz, ox, oy, oz


def _published(
    lengths: Lengths,
    f: Functions[Number],
    q: Angles[Number],
    qd: Angles[Number],
    point: tuple[Number, Number, Number],
) -> Six[Number]:
    d1, a2, a3, d4, d5, _ = lengths
    sin, cos = f.sin, f.cos
    v1, v2, v3, v4, v5, v6 = qd
    q23 = q[1] + q[2]
    q234 = q23 + q[3]
    s1, c1 = sin(q[0]), cos(q[0])
    s234, c234 = sin(q234), cos(q234)
    s5, c5 = sin(q[4]), cos(q[4])
    # Axes: joint 1 is z; joints 2 to 4 are (s1, -c1, 0); then joint 5 and joint 6.
    ux, uy, uz = c1 * s234, s1 * s234, -c234
    wx, wy, wz = c5 * s1 - s5 * c1 * c234, -c5 * c1 - s5 * s1 * c234, -s5 * s234
    # A point on each axis: the base, the shoulder, the elbow, wrist 1; from there along the axes.
    out2, up2 = a2 * cos(q[1]), d1 + a2 * sin(q[1])
    out3, up3 = out2 + a3 * cos(q23), up2 + a3 * sin(q23)
    p4x, p4y, p4z = out3 * c1 + d4 * s1, out3 * s1 - d4 * c1, up3
    p5x, p5y, p5z = p4x + d5 * ux, p4y + d5 * uy, p4z + d5 * uz
    # Velocity: angular velocity x point, less the sum over the axes of speed * axis x point on the axis.
    v234 = v2 + v3 + v4
    ox = v234 * s1 + v5 * ux + v6 * wx
    oy = -v234 * c1 + v5 * uy + v6 * wy
    oz = v1 + v5 * uz + v6 * wz
    out, up = v3 * out2 + v4 * out3, v2 * d1 + v3 * up2 + v4 * up3
    x, y, z = point
    return (
        oy * z - oz * y + c1 * up - v5 * (uy * p4z - uz * p4y) - v6 * (wy * p5z - wz * p5y),
        oz * x - ox * z + s1 * up - v5 * (uz * p4x - ux * p4z) - v6 * (wz * p5x - wx * p5z),
        ox * y - oy * x - out - v5 * (ux * p4y - uy * p4x) - v6 * (wx * p5y - wy * p5x),
        ox,
        oy,
        oz,
    )

"""Geometry of one arm, published or calibrated, and the frames of its links.

Frames follow the vendor's Denavit-Hartenberg (DH) table: frame 0 is the base with z up, frame i is at the end of link
i, and frame 6 is the tool flange. Joint i turns about the z axis of frame i - 1.

**A calibrated arm** sends its own DH table in the kinematics sub-package of the primary interface (`KinematicsInfo`).
The numbers are complete parameters rather than deviations from the published parameters. The table of an uncalibrated
controller equals the published table (captures of a CB2 UR5 and a simulated UR5e). Users report a calibrated UR5 with
d1 = 0.08888 m instead of the published 0.08916 m (issue 457 of the vendor's ROS driver).

Joints 2, 3 and 4 turn about axes that are parallel within a few mrad. The DH convention puts the frame at the common
normal of two axes. If the axes are almost parallel, this normal can be anywhere along them. In the same report, d2 to
d4 are 574, -507 and -67 m, a2 is -0.057 m and theta2 is -1.4 rad, although the arm differs by only 1 mm from the
published one. Therefore frames 2 and 3 are moved along their joint axis and turned about it, to their position in the
published table. The parameters of Hayati and Mirmirani ("Improving the absolute positioning accuracy of robot
manipulators", Journal of Robotic Systems 2, 1985) describe the moved frames with one more angle, `beta`. Moving the
frames does not change the positions and orientations of the links, and the arithmetic does not lose digits.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike

from linkcore.errors import BadValue

from ..models import Model
from ..rigid import MathFunctions, Number, Rigid, Six, invert
from ..vectors import six

#: Lengths d1, a2, a3, d4, d5, d6 in m: the complete geometry of a published UR arm.
Lengths = tuple[float, float, float, float, float, float]

#: Six joint positions, in rad.
Angles = tuple[Number, Number, Number, Number, Number, Number]

# Maximum difference of an uncalibrated table from the published table, in m and rad. An uncalibrated controller sends
# the published table with nine decimals.
_UNCALIBRATED = 1e-8
# Maximum difference of a calibration from the published table. Observed calibrations are within 2 mm and 20 mrad.
_FAR = 0.03  # m
_TURNED = 0.1  # rad


def angles(joints: Iterable[Number]) -> Angles[Number]:
    """Return six joint positions as a tuple."""
    q1, q2, q3, q4, q5, q6 = joints
    return q1, q2, q3, q4, q5, q6


class DenavitHartenberg(Protocol):
    """Object with a DH table, six values for each parameter: `KinematicsInfo`, `urlink.models.Model`, `DhTable`."""

    @property
    def dh_theta(self) -> ArrayLike:
        """Joint offsets, in rad."""

    @property
    def dh_a(self) -> ArrayLike:
        """Link lengths, in m."""

    @property
    def dh_d(self) -> ArrayLike:
        """Link offsets, in m."""

    @property
    def dh_alpha(self) -> ArrayLike:
        """Link twists, in rad."""


class DhTable(NamedTuple):
    """DH table with numbers from another source, such as a file; implements `DenavitHartenberg`.

    Attributes:
        dh_theta: Joint offsets, in rad.
        dh_a: Link lengths, in m.
        dh_d: Link offsets, in m.
        dh_alpha: Link twists, in rad.
    """

    dh_theta: Sequence[float]
    dh_a: Sequence[float]
    dh_d: Sequence[float]
    dh_alpha: Sequence[float]


@dataclass(frozen=True)
class ArmLink:
    """Transform from one frame to the next: Rz(q + offset) Tz(d) Tx(a) Rx(alpha) Ry(beta).

    Attributes:
        offset: Angle that is added to the joint position, in rad.
        a: Translation along x, in m.
        d: Translation along z, in m.
        alpha: Rotation about x, in rad.
        beta: Rotation about the resulting y axis, in rad; zero except for joints 2 and 3 of a calibrated arm.
    """

    offset: float
    a: float
    d: float
    alpha: float
    beta: float

    @property
    def turns(self) -> tuple[float, float, float, float]:
        """Cosine and sine of alpha, then of beta; exact if alpha is 0 or ±90 degrees."""
        quarters = self.alpha / (0.5 * math.pi)
        if quarters in (-1.0, 0.0, 1.0):
            ca, sa = 1.0 - abs(quarters), quarters
        else:
            ca, sa = math.cos(self.alpha), math.sin(self.alpha)
        return ca, sa, math.cos(self.beta), math.sin(self.beta)


@dataclass(frozen=True, eq=False)
class Geometry:
    """Links of one arm.

    Attributes:
        links: Six links.
        is_nominal: Whether the geometry is the published one. The closed forms are valid only for the published
            geometry.
        lengths: Lengths in m. For a calibrated arm, they are the lengths of a similar arm with the published link
            twists.
        offsets: Offsets of the six joints, in rad; all zero for a published arm.
        rows: Offset, a, d, cosine and sine of alpha, cosine and sine of beta of each link, for `chain`.
    """

    links: tuple[ArmLink, ...]
    is_nominal: bool
    lengths: Lengths = field(init=False)
    offsets: Angles[float] = field(init=False)
    rows: tuple[tuple[float, float, float, float, float, float, float], ...] = field(init=False)

    def __post_init__(self) -> None:
        one, two, three, four, five, six_ = self.links
        object.__setattr__(self, "lengths", (one.d, two.a, three.a, four.d, five.d, six_.d))
        object.__setattr__(self, "offsets", tuple(link.offset for link in self.links))
        rows = tuple((link.offset, link.a, link.d, *link.turns) for link in self.links)
        object.__setattr__(self, "rows", rows)

    @cached_property
    def to_wrist(self) -> Geometry:
        """Arm up to the origin of frame 5.

        This point is on the axis of joint 6, so joint 6 changes only its orientation.
        """
        *links, last = self.links
        return replace(self, links=(*links, ArmLink(last.offset, 0.0, 0.0, 0.0, 0.0)))

    @cached_property
    def wrist_in_flange(self) -> Rigid[float]:
        """Last frame of `to_wrist`, as a transform in the flange frame."""
        last = self.links[5]
        ca, sa, _, _ = last.turns
        return invert((1.0, 0.0, 0.0, 0.0, ca, -sa, 0.0, sa, ca, last.a, 0.0, last.d))


@lru_cache(maxsize=64)
def nominal(model: Model) -> Geometry:
    """Return the geometry that the vendor publishes."""
    table = zip(model.dh_theta.tolist(), model.dh_a.tolist(), model.dh_d.tolist(), model.dh_alpha.tolist(), strict=True)
    return Geometry(tuple(ArmLink(theta, a, d, alpha, 0.0) for theta, a, d, alpha in table), is_nominal=True)


def calibrated(model: Model, table: DenavitHartenberg) -> Geometry:
    """Return the geometry for the DH table of an individual arm, or `nominal` if the table is the published one.

    Raises:
        BadValue: If the values are not four times six finite numbers, or do not belong to this model. The message names
            the link, its value, and the published value.
    """
    names = ("dh_theta", "dh_a", "dh_d", "dh_alpha")
    given = np.stack([six(getattr(table, name), name) for name in names])
    if np.abs(given - [getattr(model, name) for name in names]).max() < _UNCALIBRATED:
        return nominal(model)
    links: list[ArmLink] = []
    # Translation of the previous frame along its z axis, in m, and rotation about this axis, in rad.
    along, about = 0.0, 0.0
    for i, (theta, a, d, alpha) in enumerate(given.T.tolist()):
        theta, d = theta - about, d - along
        if i not in (1, 2):
            links.append(ArmLink(math.remainder(theta, math.tau), a, d, alpha, 0.0))
            along = about = 0.0
            continue
        # Distance along the next axis to the point that the link reaches with a link offset of 0.
        along = -d / math.cos(alpha)
        x, y = a, -along * math.sin(alpha)
        # The published link points along -x. Turn the frame of the link by Rz(turn), so that this link also points
        # along -x. Undo the rotation at the end.
        turn = math.atan2(-y, -x)
        alpha, beta, about = _hayati(-turn, alpha)
        links.append(ArmLink(math.remainder(theta + turn, math.tau), -math.hypot(x, y), 0.0, alpha, beta))
    found = Geometry(tuple(links), is_nominal=False)
    _check_close(model, nominal(model), found)
    return found


def _hayati(theta: float, alpha: float) -> tuple[float, float, float]:
    """Convert Rz(theta) Rx(alpha) to Rx(alpha') Ry(beta) Rz(-about); return alpha', beta and about."""
    s, c, sa, ca = math.sin(theta), math.cos(theta), math.sin(alpha), math.cos(alpha)
    return math.atan2(c * sa, ca), math.atan2(s * sa, math.hypot(c, s * ca)), -math.atan2(s * ca, c)


def _check_close(model: Model, published: Geometry, found: Geometry) -> None:
    for i, (link, ours) in enumerate(zip(published.links, found.links, strict=True), 1):
        for what, expected, given, most, unit in (
            ("a", link.a, ours.a, _FAR, "m"),
            ("d", link.d, ours.d, _FAR, "m"),
            ("theta", link.offset, ours.offset, _TURNED, "rad"),
            ("alpha", link.alpha, ours.alpha, _TURNED, "rad"),
            ("beta", link.beta, ours.beta, _TURNED, "rad"),
        ):
            if abs(given - expected) > most:
                raise BadValue(
                    f"this is not the DH table of a {model.name}: {what} of link {i} is {given:.4f} {unit}, and "
                    f"{expected:.4f} {unit} for the published arm; expected whole parameters, as a controller sends "
                    "them, not deviations from the published ones"
                )


def flange(lengths: Lengths, f: MathFunctions[Number], q: Angles[Number]) -> Rigid[Number]:
    """Return the frame of the flange of a published arm, in the base frame.

    The product of the six DH matrices has a short form, because joints 2, 3 and 4 turn about parallel axes.
    """
    d1, a2, a3, d4, d5, d6 = lengths
    q1, q2, q3, q4, q5, q6 = q
    sin, cos = f.sin, f.cos
    q23 = q2 + q3
    q234 = q23 + q4
    s1, c1 = sin(q1), cos(q1)
    s234, c234 = sin(q234), cos(q234)
    s5, c5 = sin(q5), cos(q5)
    s6, c6 = sin(q6), cos(q6)
    # The arm moves in a vertical plane through the shoulder: `out` is along the plane, (s1, -c1, 0) is its normal.
    out = a2 * cos(q2) + a3 * cos(q23) + d5 * s234
    up = d1 + a2 * sin(q2) + a3 * sin(q23) - d5 * c234
    # Columns of frame 4 are x4 = (c1 c234, s1 c234, s234), the normal, and z4 = (c1 s234, s1 s234, -c234).
    xx, xy = c1 * c234, s1 * c234
    zx, zy = c1 * s234, s1 * s234
    # Frame 5: x5 = c5 x4 + s5 normal, y5 = -z4, z5 = c5 normal - s5 x4. Joint 6 turns x5 and y5.
    ux, uy, uz = c5 * xx + s5 * s1, c5 * xy - s5 * c1, c5 * s234
    wx, wy, wz = c5 * s1 - s5 * xx, -c5 * c1 - s5 * xy, -s5 * s234
    return (
        c6 * ux - s6 * zx,
        -s6 * ux - c6 * zx,
        wx,
        c6 * uy - s6 * zy,
        -s6 * uy - c6 * zy,
        wy,
        c6 * uz + s6 * c234,
        c6 * c234 - s6 * uz,
        wz,
        out * c1 + d4 * s1 + d6 * wx,
        out * s1 - d4 * c1 + d6 * wy,
        up + d6 * wz,
    )


def chain(geometry: Geometry, f: MathFunctions[Number], q: Angles[Number]) -> list[Rigid[Number]]:
    """Return the frames 1 to 6 in the base frame, from the parameters of each link."""
    sin, cos = f.sin, f.cos
    offset, a, d, ca, sa, _, _ = geometry.rows[0]
    s, c = sin(q[0] + offset), cos(q[0] + offset)
    none = 0.0 * s
    frame: Rigid[Number] = (c, -s * ca, s * sa, s, c * ca, -c * sa, none, none + sa, none + ca, a * c, a * s, none + d)
    frames = [frame]
    for angle, (offset, a, d, ca, sa, cb, sb) in zip(q[1:], geometry.rows[1:], strict=True):
        s, c = sin(angle + offset), cos(angle + offset)
        r00, r01, r02, r10, r11, r12, r20, r21, r22, px, py, pz = frame
        x0, x1, x2 = r00 * c + r01 * s, r10 * c + r11 * s, r20 * c + r21 * s
        y0, y1, y2 = r01 * c - r00 * s, r11 * c - r10 * s, r21 * c - r20 * s
        z0, z1, z2 = r02, r12, r22
        # In each link, one or two of the four parameters are zero. Skip them, because each multiplication with a
        # thousand rows takes time.
        if a:
            px, py, pz = px + a * x0, py + a * x1, pz + a * x2
        if d:
            px, py, pz = px + d * z0, py + d * z1, pz + d * z2
        if sa:
            y0, y1, y2, z0, z1, z2 = (
                y0 * ca + z0 * sa,
                y1 * ca + z1 * sa,
                y2 * ca + z2 * sa,
                z0 * ca - y0 * sa,
                z1 * ca - y1 * sa,
                z2 * ca - y2 * sa,
            )
        if sb:
            x0, x1, x2, z0, z1, z2 = (
                x0 * cb - z0 * sb,
                x1 * cb - z1 * sb,
                x2 * cb - z2 * sb,
                z0 * cb + x0 * sb,
                z1 * cb + x1 * sb,
                z2 * cb + x2 * sb,
            )
        frame = (x0, y0, z0, x1, y1, z1, x2, y2, z2, px, py, pz)
        frames.append(frame)
    return frames


def jacobian(frames: list[Rigid[Number]], tool: tuple[Number, Number, Number]) -> list[tuple[Number, ...]]:
    """Return the six columns of the geometric Jacobian of a point, from frames 1 to 6 and the point in the base frame.

    Each column is the velocity of the point in m/s, and the angular velocity in rad/s, for 1 rad/s of a joint.
    """
    tx, ty, tz = tool
    none = 0.0 * tx
    columns: list[tuple[Number, ...]] = [(-ty, tx, none, none, none, none + 1.0)]
    for _, _, zx, _, _, zy, _, _, zz, ox, oy, oz in frames[:5]:
        lx, ly, lz = tx - ox, ty - oy, tz - oz
        columns.append((zy * lz - zz * ly, zz * lx - zx * lz, zx * ly - zy * lx, zx, zy, zz))
    return columns


def velocity(
    geometry: Geometry,
    f: MathFunctions[Number],
    q: Angles[Number],
    qd: Angles[Number],
    point: tuple[Number, Number, Number],
) -> Six[Number]:
    """Return the Jacobian of a point times the joint speeds, in a tenth of the time that the Jacobian takes.

    The simulator needs this product twice per cycle. Joints 2, 3 and 4 of a published arm turn about parallel axes, and
    all link twists are 0 or ±90 degrees. Therefore there are short formulas for all six axes, and for a point on each
    axis.

    Args:
        geometry: Geometry of the arm.
        f: `FLOATS` for one row of numbers, `ROWS` for arrays.
        q: Joint positions, in rad.
        qd: Joint speeds, in rad/s.
        point: Point that is fixed to the flange, in the base frame, in m.

    Returns:
        Velocity of the point in m/s, and angular velocity of the flange in rad/s, in the base frame.
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
    f: MathFunctions[Number],
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
    # Axes: joint 1 is z, joints 2 to 4 are (s1, -c1, 0), then joint 5 and joint 6.
    ux, uy, uz = c1 * s234, s1 * s234, -c234
    wx, wy, wz = c5 * s1 - s5 * c1 * c234, -c5 * c1 - s5 * s1 * c234, -s5 * s234
    # A point on each axis: the base, the shoulder, the elbow and wrist 1. The other points follow along the axes.
    out2, up2 = a2 * cos(q[1]), d1 + a2 * sin(q[1])
    out3, up3 = out2 + a3 * cos(q23), up2 + a3 * sin(q23)
    p4x, p4y, p4z = out3 * c1 + d4 * s1, out3 * s1 - d4 * c1, up3
    p5x, p5y, p5z = p4x + d5 * ux, p4y + d5 * uy, p4z + d5 * uz
    # Velocity: angular velocity x point, minus the sum over the axes of speed * axis x point on the axis.
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

"""Where the arm is: forward and inverse kinematics, poses, the Jacobian and the torques that hold it up.

Pure functions of a `Model`. Frames follow the vendor's DH table: frame 0 is the base with z up, frame i sits
at the end of link i, frame 6 is the tool flange. A pose is the vendor's: x, y, z in m and a rotation vector
in rad, whose length is the angle. A TCP is a pose in the flange frame.

A simulator asks for the pose of every arm at every tick, so the inner functions work on plain floats: a rigid
transform is a tuple of twelve, the rows of the rotation matrix followed by the position. For a UR arm the
product of the six DH matrices has a short closed form, because joints 2, 3 and 4 turn about parallel axes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from linkcore.errors import BadValue
from urlink.models import Model

__all__ = [
    "GRAVITY",
    "forward",
    "frames",
    "gravity_torque",
    "inverse",
    "jacobian",
    "matrix_to_pose",
    "pose",
    "pose_inv",
    "pose_to_matrix",
    "pose_trans",
]

FloatArray = NDArray[np.float64]
Vector = Sequence[float] | FloatArray

#: m/s². What a controller assumes until a program calls set_gravity.
GRAVITY = 9.82

# Rows of the rotation, then the position: r00 r01 r02 r10 r11 r12 r20 r21 r22 px py pz.
_Rigid = tuple[float, float, float, float, float, float, float, float, float, float, float, float]
_Lengths = tuple[float, float, float, float, float, float]

# How much orientation, rad, may be given up for a better joint 6. At a singular wrist, where joint 6 hardly
# counts, it buys any joint 6.
_SLACK = 1e-10
# How far outside its reach, relative to it, rounding may put a pose that is exactly on the edge.
_EDGE = 1e-12
# Branches closer than this, rad, are one: where two meet, rounding parts them by the root of the precision.
_SAME = 1e-7


def forward(model: Model, q: Vector) -> FloatArray:
    """The flange in the base frame.

    Args:
        q: (6,) joint positions, rad.

    Returns:
        (4, 4) homogeneous matrix, positions in m.

    Raises:
        BadValue: `q` is not six finite numbers.
    """
    return _matrix(_flange(_lengths(model), q))


def frames(model: Model, q: Vector) -> FloatArray:
    """All frames of the DH table in the base frame, from the table itself rather than the closed form.

    Args:
        q: (6,) joint positions, rad.

    Returns:
        (7, 4, 4) homogeneous matrices: the base, then the end of each link; the last is the flange.

    Raises:
        BadValue: `q` is not six finite numbers.
    """
    return np.stack([_matrix(frame) for frame in _chain(_rows(model), q)])


def pose(model: Model, q: Vector, tcp: Vector | None = None) -> FloatArray:
    """The TCP in the base frame, as a pose.

    Args:
        q: (6,) joint positions, rad.
        tcp: (6,) pose of the TCP in the flange frame; None for the flange itself.

    Returns:
        (6,) x, y, z in m and rotation vector in rad, of angle 0 to pi.

    Raises:
        BadValue: `q` or `tcp` is not six finite numbers.
    """
    there = _flange(_lengths(model), q)
    if tcp is not None:
        there = _product(there, _from_pose(tcp))
    return np.array(_to_pose(there))


def jacobian(model: Model, q: Vector, tcp: Vector | None = None) -> FloatArray:
    """The geometric Jacobian of the TCP, in the base frame.

    Args:
        q: (6,) joint positions, rad.
        tcp: (6,) pose of the TCP in the flange frame; None for the flange itself.

    Returns:
        (6, 6): joint speeds in rad/s to velocity of the TCP, m/s, above angular velocity, rad/s.

    Raises:
        BadValue: `q` or `tcp` is not six finite numbers.
    """
    chain = _chain(_rows(model), q)
    there = chain[6] if tcp is None else _product(chain[6], _from_pose(tcp))
    columns = []
    for _, _, zx, _, _, zy, _, _, zz, ox, oy, oz in chain[:6]:
        lx, ly, lz = there[9] - ox, there[10] - oy, there[11] - oz
        columns.append((zy * lz - zz * ly, zz * lx - zx * lz, zx * ly - zy * lx, zx, zy, zz))
    return np.array(columns).T


def gravity_torque(model: Model, q: Vector, payload: float = 0.0, payload_cog: Vector = (0.0, 0.0, 0.0)) -> FloatArray:
    """The torques that hold a resting arm, base upright, against its own weight and that of its payload.

    As good as the published link masses. The currents that simulated UR3e and UR5e controllers report are
    proportional to these torques; a real CB2 UR5 reports an `m_target` that differs by up to 1.4 Nm.

    Args:
        q: (6,) joint positions, rad.
        payload: mass at the flange, kg.
        payload_cog: (3,) its centre of mass in the flange frame, m.

    Returns:
        (6,) Nm, positive in the direction in which the joint angle grows. The first is always zero.

    Raises:
        BadValue: `q` is not six finite numbers, `payload_cog` is not three, or `payload` is not a mass.
    """
    if not 0.0 <= payload < math.inf:
        raise BadValue(f"a payload is zero or more kilograms, not {payload!r}")
    chain = _chain(_rows(model), q)
    cx, cy, cz = _floats(payload_cog, 3, "a centre of mass")
    r00, r01, r02, r10, r11, r12, _, _, _, px, py, _ = chain[6]
    # Of everything from the payload down to the joint at hand: mass, and mass times position. Weight pulls
    # along z, so only x and y of the lever count.
    mass = payload
    moment_x = payload * (r00 * cx + r01 * cy + r02 * cz + px)
    moment_y = payload * (r10 * cx + r11 * cy + r12 * cz + py)
    torques = [0.0] * 6
    for i, (link_mass, (cx, cy, cz)) in reversed(_links(model)):
        r00, r01, r02, r10, r11, r12, _, _, _, px, py, _ = chain[i + 1]
        mass += link_mass
        moment_x += link_mass * (r00 * cx + r01 * cy + r02 * cz + px)
        moment_y += link_mass * (r10 * cx + r11 * cy + r12 * cz + py)
        _, _, zx, _, _, zy, _, _, _, ox, oy, _ = chain[i]
        torques[i] = GRAVITY * (zx * (moment_y - mass * oy) - zy * (moment_x - mass * ox))
    return np.array(torques)


def inverse(model: Model, pose: Vector, tcp: Vector | None = None, near: Vector | None = None) -> FloatArray:
    """All joint positions that put the TCP at a pose; position limits and collisions are not looked at.

    An arm reaches a pose in up to eight ways: shoulder left or right, elbow up or down, wrist flipped or not.
    Ways that meet in a singularity are given once. At a singular wrist, where joints 4 and 6 turn about
    parallel axes, joint 6 is that of `near`, or zero, or the closest to that with which the arm reaches the
    pose.

    Args:
        pose: (6,) pose of the TCP in the base frame, m and rad.
        tcp: (6,) pose of the TCP in the flange frame; None for the flange itself.
        near: (6,) joint positions, rad. Each joint is then given in the turn closest to it, and the rows are
            sorted by their largest joint movement, so that row 0 is the continuation of a path.

    Returns:
        (n, 6) joint positions, rad, n from 0 (out of reach) to 8, in (-pi, pi] unless `near` is given.

    Raises:
        BadValue: `pose`, `tcp` or `near` is not six finite numbers.
    """
    target = _from_pose(pose)
    if tcp is not None:
        target = _product(target, _inverted(_from_pose(tcp)))
    reference = None if near is None else _floats(near, 6, "joint positions")
    free_q6 = 0.0 if reference is None else reference[5]
    found: list[tuple[float, ...]] = []
    for q in _branches(_lengths(model), target, free_q6):
        wrapped = tuple(_wrapped(angle) for angle in q)
        if not any(_same(wrapped, other) for other in found):
            found.append(wrapped)
    if reference is not None:
        found = [
            tuple(r + _wrapped(a - r) for a, r in zip(q, reference, strict=True))
            for q in sorted(found, key=lambda q: _distance(q, reference))
        ]
    return np.array(found, dtype=np.float64).reshape(-1, 6)


def pose_to_matrix(pose: Vector) -> FloatArray:
    """The (4, 4) homogeneous matrix of a (6,) pose, m and rad.

    Raises:
        BadValue: `pose` is not six finite numbers.
    """
    return _matrix(_from_pose(pose))


def matrix_to_pose(matrix: FloatArray) -> FloatArray:
    """The (6,) pose, m and rad, of a (4, 4) homogeneous matrix. Its angle is 0 to pi.

    At exactly pi both directions of the axis are the same rotation; the one whose largest component is
    positive is given.

    Raises:
        BadValue: `matrix` is not 4 by 4, or has numbers that are not finite.
    """
    rows = np.asarray(matrix, dtype=np.float64)
    if rows.shape != (4, 4) or not np.isfinite(rows).all():
        raise BadValue(f"a homogeneous matrix is 4 by 4 finite numbers, not {matrix!r}")
    (r00, r01, r02, px), (r10, r11, r12, py), (r20, r21, r22, pz) = rows[:3].tolist()
    return np.array(_to_pose((r00, r01, r02, r10, r11, r12, r20, r21, r22, px, py, pz)))


def pose_trans(first: Vector, second: Vector) -> FloatArray:
    """The (6,) pose that is `second` seen from the frame that `first` describes, like URScript's pose_trans.

    Raises:
        BadValue: either is not six finite numbers.
    """
    return np.array(_to_pose(_product(_from_pose(first), _from_pose(second))))


def pose_inv(pose: Vector) -> FloatArray:
    """The (6,) pose that undoes `pose`: `pose_trans(pose, pose_inv(pose))` is zero. Like URScript's pose_inv.

    Raises:
        BadValue: `pose` is not six finite numbers.
    """
    return np.array(_to_pose(_inverted(_from_pose(pose))))


@lru_cache(maxsize=64)
def _lengths(model: Model) -> _Lengths:
    """d1, a2, a3, d4, d5, d6: all the geometry that a nominal UR arm has."""
    d, a = model.dh_d.tolist(), model.dh_a.tolist()
    return d[0], a[1], a[2], d[3], d[4], d[5]


@lru_cache(maxsize=64)
def _rows(model: Model) -> list[tuple[float, float, float, float, float]]:
    """For each joint a, d, theta and the cosine and sine of alpha, which are exact, being -1, 0 or 1."""
    turns = [(round(math.cos(alpha)), round(math.sin(alpha))) for alpha in model.dh_alpha.tolist()]
    plain = zip(model.dh_a.tolist(), model.dh_d.tolist(), model.dh_theta.tolist(), turns, strict=True)
    return [(a, d, theta, float(ca), float(sa)) for a, d, theta, (ca, sa) in plain]


@lru_cache(maxsize=64)
def _links(model: Model) -> list[tuple[int, tuple[float, list[float]]]]:
    """Number, mass and centre of mass of each moving link."""
    return list(enumerate(zip(model.link_masses.tolist(), model.link_cogs.tolist(), strict=True)))


def _floats(values: Vector, n: int, what: str) -> list[float]:
    # Arithmetic on numpy scalars costs several times that on floats.
    try:
        plain: list[float] = values.tolist() if isinstance(values, np.ndarray) else list(map(float, values))
        usable = len(plain) == n and all(map(math.isfinite, plain))
    except (TypeError, ValueError):
        usable = False
    if not usable:
        raise BadValue(f"{what} must be {n} finite numbers, not {values!r}")
    return plain


def _flange(lengths: _Lengths, q: Vector) -> _Rigid:
    d1, a2, a3, d4, d5, d6 = lengths
    q1, q2, q3, q4, q5, q6 = _floats(q, 6, "joint positions")
    sin, cos = math.sin, math.cos
    q23 = q2 + q3
    q234 = q23 + q4
    s1, c1 = sin(q1), cos(q1)
    s234, c234 = sin(q234), cos(q234)
    s5, c5 = sin(q5), cos(q5)
    s6, c6 = sin(q6), cos(q6)
    # The arm moves in an upright plane through the shoulder: `out` runs along it, (s1, -c1, 0) is its normal.
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


def _chain(rows: list[tuple[float, float, float, float, float]], q: Vector) -> list[_Rigid]:
    """The seven frames: each is the one before times Rz(q + theta) Tz(d) Tx(a) Rx(alpha)."""
    frame: _Rigid = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
    chain = [frame]
    for angle, (a, d, theta, ca, sa) in zip(_floats(q, 6, "joint positions"), rows, strict=True):
        s, c = math.sin(angle + theta), math.cos(angle + theta)
        r00, r01, r02, r10, r11, r12, r20, r21, r22, px, py, pz = frame
        x0, x1, x2 = r00 * c + r01 * s, r10 * c + r11 * s, r20 * c + r21 * s
        y0, y1, y2 = r01 * c - r00 * s, r11 * c - r10 * s, r21 * c - r20 * s
        frame = (
            x0,
            y0 * ca + r02 * sa,
            r02 * ca - y0 * sa,
            x1,
            y1 * ca + r12 * sa,
            r12 * ca - y1 * sa,
            x2,
            y2 * ca + r22 * sa,
            r22 * ca - y2 * sa,
            px + a * x0 + d * r02,
            py + a * x1 + d * r12,
            pz + a * x2 + d * r22,
        )
        chain.append(frame)
    return chain


def _branches(lengths: _Lengths, target: _Rigid, free_q6: float) -> list[tuple[float, ...]]:
    """Every way to put the flange at `target`, repeated where two meet in a singularity, not wrapped."""
    d1, a2, a3, d4, d5, d6 = lengths
    r00, r01, r02, r10, r11, r12, r20, r21, r22, px, py, pz = target
    found: list[tuple[float, ...]] = []

    # Joint 1. The origin of frame 5 lies d4 off the plane of the arm, on the side of its normal (s1, -c1, 0).
    x05, y05 = px - d6 * r02, py - d6 * r12
    squared = x05 * x05 + y05 * y05 - d4 * d4
    if squared < -_EDGE * d4 * d4:
        return found  # Too close to the axis of the base.
    inward = math.sqrt(max(squared, 0.0))
    for q1 in (
        math.atan2(y05, x05) + math.atan2(d4, inward),
        math.atan2(y05, x05) + math.atan2(d4, -inward),
    ):
        s1, c1 = math.sin(q1), math.cos(q1)

        # The origin of frame 5, seen in the plane of the arm from the shoulder.
        out5, up5 = x05 * c1 + y05 * s1, pz - d6 * r22 - d1

        # Joints 5 and 6. In frame 6 the normal is (c6 s5, -s6 s5, c5). Arc tangents keep their precision
        # where an arc cosine of c5 would lose half its digits.
        nx, ny, nz = r00 * s1 - r10 * c1, r01 * s1 - r11 * c1, r02 * s1 - r12 * c1
        sine = math.hypot(nx, ny)
        for side in (1.0, -1.0):
            q5 = math.atan2(side * sine, nz)
            q6 = math.atan2(-side * ny, side * nx)
            if abs(_wrapped(free_q6 - q6)) * sine < _SLACK:
                q6 = free_q6
            s6, c6 = math.sin(q6), math.cos(q6)

            # z4 = -y5 = -(s6 x6 + c6 y6) lies in the plane of the arm, at this angle.
            zx, zy, zz = -(s6 * r00 + c6 * r01), -(s6 * r10 + c6 * r11), -(s6 * r20 + c6 * r21)
            bearing = math.atan2(zz, zx * c1 + zy * s1)
            # Joint 6 moves the origin of frame 4 too: turn it, as far as the slack goes, to where the arm reaches.
            shift = _into_reach(bearing, out5, up5, d5, abs(a2) + abs(a3), abs(abs(a2) - abs(a3)))
            if abs(shift) * sine < _SLACK:
                bearing += shift
                q6 -= math.copysign(1.0, nz) * shift
            q234 = bearing + 0.5 * math.pi

            # Joints 2 and 3: two links that reach to the origin of frame 4.
            out, up = out5 - d5 * math.cos(bearing), up5 - d5 * math.sin(bearing)
            c3 = (out * out + up * up - a2 * a2 - a3 * a3) / (2.0 * a2 * a3)
            if abs(c3) > 1.0 + _EDGE:
                continue  # Further than the stretched arm reaches, or closer than the folded one.
            s3 = math.sqrt(max((1.0 - c3) * (1.0 + c3), 0.0))
            for elbow in (1.0, -1.0):
                q3 = math.atan2(elbow * s3, c3)
                # a2 and a3 are negative, so the upper arm points away from (a2 + a3 c3, a3 s3).
                q2 = math.atan2(up, out) - math.atan2(a3 * elbow * s3, a2 + a3 * c3)
                found.append((q1, q2, q3, q234 - q2 - q3, q5, q6))
    return found


def _into_reach(bearing: float, out: float, up: float, length: float, furthest: float, closest: float) -> float:
    """How far to turn a link that ends at (out, up) for its other end to come within reach of 0, 0.

    Zero where it is in reach. Where no turn brings it there, it turns as close as it can come.
    """
    distance = math.hypot(out, up)
    lever = 2.0 * length * distance
    if lever == 0.0:
        return 0.0
    # By the law of cosines; the end comes closest to 0, 0 where the link points straight away from it.
    squares = length * length + distance * distance
    widest = math.acos(max(-1.0, min(1.0, (squares - furthest * furthest) / lever)))
    narrowest = math.acos(max(-1.0, min(1.0, (squares - closest * closest) / lever)))
    angle = math.remainder(bearing - math.atan2(up, out), math.tau)
    return math.copysign(max(narrowest, min(widest, abs(angle))), angle) - angle


def _wrapped(angle: float) -> float:
    """The same direction in (-pi, pi]."""
    wrapped = math.remainder(angle, math.tau)
    return math.pi if wrapped <= -math.pi else wrapped


def _same(q: Sequence[float], other: Sequence[float]) -> bool:
    # Most branches differ in joint 1 already, and `all` stops there.
    return all(abs(math.remainder(a - b, math.tau)) < _SAME for a, b in zip(q, other, strict=True))


def _distance(q: Sequence[float], other: Sequence[float]) -> float:
    """The largest joint movement between two joint positions, rad, each joint going the short way round."""
    return max(abs(math.remainder(a - b, math.tau)) for a, b in zip(q, other, strict=True))


def _matrix(rigid: _Rigid) -> FloatArray:
    r00, r01, r02, r10, r11, r12, r20, r21, r22, px, py, pz = rigid
    flat = (r00, r01, r02, px, r10, r11, r12, py, r20, r21, r22, pz, 0.0, 0.0, 0.0, 1.0)
    return np.array(flat).reshape(4, 4)


def _product(first: _Rigid, second: _Rigid) -> _Rigid:
    a00, a01, a02, a10, a11, a12, a20, a21, a22, ax, ay, az = first
    b00, b01, b02, b10, b11, b12, b20, b21, b22, bx, by, bz = second
    return (
        a00 * b00 + a01 * b10 + a02 * b20,
        a00 * b01 + a01 * b11 + a02 * b21,
        a00 * b02 + a01 * b12 + a02 * b22,
        a10 * b00 + a11 * b10 + a12 * b20,
        a10 * b01 + a11 * b11 + a12 * b21,
        a10 * b02 + a11 * b12 + a12 * b22,
        a20 * b00 + a21 * b10 + a22 * b20,
        a20 * b01 + a21 * b11 + a22 * b21,
        a20 * b02 + a21 * b12 + a22 * b22,
        a00 * bx + a01 * by + a02 * bz + ax,
        a10 * bx + a11 * by + a12 * bz + ay,
        a20 * bx + a21 * by + a22 * bz + az,
    )


def _inverted(rigid: _Rigid) -> _Rigid:
    r00, r01, r02, r10, r11, r12, r20, r21, r22, px, py, pz = rigid
    return (
        r00,
        r10,
        r20,
        r01,
        r11,
        r21,
        r02,
        r12,
        r22,
        -(r00 * px + r10 * py + r20 * pz),
        -(r01 * px + r11 * py + r21 * pz),
        -(r02 * px + r12 * py + r22 * pz),
    )


def _from_pose(pose: Vector) -> _Rigid:
    """Rodrigues' formula."""
    px, py, pz, rx, ry, rz = _floats(pose, 6, "a pose")
    angle = math.hypot(rx, ry, rz)
    if angle == 0.0:
        return (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, px, py, pz)
    x, y, z = rx / angle, ry / angle, rz / angle
    s, v = math.sin(angle), 1.0 - math.cos(angle)
    return (
        1.0 - v * (y * y + z * z),
        v * x * y - s * z,
        v * x * z + s * y,
        v * x * y + s * z,
        1.0 - v * (x * x + z * z),
        v * y * z - s * x,
        v * x * z - s * y,
        v * y * z + s * x,
        1.0 - v * (x * x + y * y),
        px,
        py,
        pz,
    )


def _to_pose(rigid: _Rigid) -> tuple[float, float, float, float, float, float]:
    """By way of the quaternion, computed from its largest component: precise at all angles, 0 and pi too."""
    r00, r01, r02, r10, r11, r12, r20, r21, r22, px, py, pz = rigid
    # Four times the products of that largest component with all four of them.
    if r00 + r11 + r22 > 0.0:
        w, x, y, z = 1.0 + r00 + r11 + r22, r21 - r12, r02 - r20, r10 - r01
    elif r00 >= r11 and r00 >= r22:
        w, x, y, z = r21 - r12, 1.0 + r00 - r11 - r22, r10 + r01, r02 + r20
    elif r11 >= r22:
        w, x, y, z = r02 - r20, r10 + r01, 1.0 + r11 - r00 - r22, r21 + r12
    else:
        w, x, y, z = r10 - r01, r02 + r20, r21 + r12, 1.0 + r22 - r00 - r11
    if w < 0.0:  # The other of the two quaternions of this rotation, so that the angle is at most pi.
        w, x, y, z = -w, -x, -y, -z
    sine = math.hypot(x, y, z)
    scale = 2.0 * math.atan2(sine, w) / sine if sine > 0.0 else 0.0
    return px, py, pz, scale * x, scale * y, scale * z

"""Arms, joint positions and poses for tests of kinematics."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray

from urlink.arm.kinematics import Arm
from urlink.arm.models import MODELS, Model

Array = NDArray[np.float64]

# --- joint positions and poses ---

#: Whole quarter turns put the arm into its singularities: stretched, folded, wrists in line.
angles = st.one_of(st.floats(-2.0 * math.pi, 2.0 * math.pi), st.integers(-4, 4).map(lambda n: n * math.pi / 2.0))
joints = st.lists(angles, min_size=6, max_size=6)
models = st.sampled_from(list(MODELS.values()))
lengths = st.floats(-2.0, 2.0)
directions = st.tuples(*[st.floats(-1.0, 1.0)] * 3).map(np.array).filter(lambda v: float(np.linalg.norm(v)) > 0.1)
#: From zero to half a turn, with extra weight on both ends, where rotation vectors are delicate.
turns = st.one_of(
    st.floats(0.0, math.pi),
    st.floats(0.0, 1e-6),
    st.floats(0.0, 1e-6).map(lambda less: math.pi - less),
    st.sampled_from([0.0, 1e-300, 1e-15, 1e-8, math.pi / 2.0, math.pi - 1e-8, math.pi - 1e-15, math.pi]),
)


@st.composite
def rotation_vectors(draw: st.DrawFn) -> Array:
    axis = draw(directions)
    return np.asarray(axis / np.linalg.norm(axis) * draw(turns))


@st.composite
def poses(draw: st.DrawFn) -> Array:
    return np.array([draw(lengths), draw(lengths), draw(lengths), *draw(rotation_vectors())])


tcps = st.none() | poses()


def dh_matrix(a: float, d: float, alpha: float, theta: float) -> Array:
    """Return Rz(theta) Tz(d) Tx(a) Rx(alpha), written out as defined."""
    ct, s, ca, sa = math.cos(theta), math.sin(theta), math.cos(alpha), math.sin(alpha)
    about_z = np.array([[ct, -s, 0, 0], [s, ct, 0, 0], [0, 0, 1, d], [0, 0, 0, 1]])
    about_x = np.array([[1, 0, 0, a], [0, ca, -sa, 0], [0, sa, ca, 0], [0, 0, 0, 1]])
    product: Array = about_z @ about_x
    return product


def rotation_of(vector: Array) -> Array:
    """Return the rotation of a rotation vector as a power series of its cross-product matrix: slow, but right."""
    x, y, z = vector
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    total = np.eye(3)
    term = np.eye(3)
    for n in range(1, 60):
        term = term @ cross / n
        total += term
    return total


# --- calibrated arms ---


@dataclass(frozen=True)
class Table:
    """DH table, as a controller sends it."""

    dh_theta: Sequence[float]
    dh_a: Sequence[float]
    dh_d: Sequence[float]
    dh_alpha: Sequence[float]

    def frames(self, q: Sequence[float]) -> list[Array]:
        """Return the products of the DH matrices: the frames of exactly this table."""
        found = [np.eye(4)]
        for angle, theta, a, d, alpha in zip(q, self.dh_theta, self.dh_a, self.dh_d, self.dh_alpha, strict=True):
            found.append(found[-1] @ dh_matrix(a, d, alpha, angle + theta))
        return found


#: Table of a calibrated UR5, from a report to the maintainers of the vendor's ROS driver (issue 457 there).
REPORTED_UR5 = Table(
    dh_theta=(-9.62699668632896e-06, -1.43707039992005, 2.02543119975016, -0.588254688694989, 4.136e-05, 8.17e-06),
    dh_a=(0.000279332356195598, -0.0566854832098269, -0.32646702272051, 1.49388687216263e-05, 2.2369e-07, 0.0),
    dh_d=(0.0888794492754001, 574.241384579456, -507.363402098168, -66.7676839353205, 0.0949734691141, 0.08256250145),
    dh_alpha=(1.57033858830411, -0.000733893428160216, 0.00325607356326439, 1.57040005185553, -1.571010003, 0.0),
)


def calibration(model: Model, seed: int, off: float = 1e-3, tilt: float = 2e-3) -> Table:
    """Return the DH table of an arm with errors of up to `off` m and `tilt` rad per joint, from its axes."""
    rng = np.random.default_rng(seed)
    frame = np.eye(4)
    axes: list[tuple[Array, Array]] = [(frame[:3, 3], frame[:3, 2])]
    for i in range(6):
        frame = frame @ dh_matrix(model.dh_a[i], model.dh_d[i], model.dh_alpha[i], 0.0)
        if i < 5:
            # The rest of the arm is slightly displaced from the published position.
            moved = np.eye(4)
            moved[:3, :3] = rotation_of(rng.uniform(-tilt, tilt, 3))
            moved[:3, 3] = rng.uniform(-off, off, 3)
            frame = frame @ moved
        axes.append((frame[:3, 3], frame[:3, 2]))
    rows = []
    x = np.array([1.0, 0.0, 0.0])
    origin = np.zeros(3)
    for (_, z), (point, next_z), alpha_published in zip(axes[:5], axes[1:6], model.dh_alpha[:5], strict=True):
        # The common normal of two axes is DH's x, with the sign of the published twist.
        normal = np.cross(z, next_z)
        normal *= (-1.0 if alpha_published < 0.0 else 1.0) / np.linalg.norm(normal)
        across = point - origin
        a = float(across @ normal)
        # origin + d z + a normal = point + s next_z
        (d, _), *_ = np.linalg.lstsq(np.stack([z, -next_z], axis=1), across - a * normal, rcond=None)
        theta = math.atan2(float(np.cross(x, normal) @ z), float(x @ normal))
        alpha = math.atan2(float(np.cross(z, next_z) @ normal), float(z @ next_z))
        rows.append((theta, a, float(d), alpha))
        origin, x = origin + d * z + a * normal, normal
    end, z6 = axes[6]
    flange_x = frame[:3, 0]
    theta = math.atan2(float(np.cross(x, flange_x) @ z6), float(x @ flange_x))
    rows.append((theta, 0.0, float((end - origin) @ z6), 0.0))
    theta_s, a_s, d_s, alpha_s = zip(*rows, strict=True)
    return Table(theta_s, a_s, d_s, alpha_s)


@lru_cache(maxsize=256)
def calibrated(name: str, seed: int) -> Arm:
    """Return an arm of a model; each seed gives another calibration."""
    return Arm.calibrated(name, calibration(MODELS[name], seed))

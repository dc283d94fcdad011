"""Calibration of an arm from joint positions and the poses of its TCP, as a controller computes them.

DH parameters are not good coordinates for joint axes that are parallel within a few mrad, and an arm has three such
axes (see `urlink.arm.kinematics.geometry`). Therefore the links are fitted with the parameters of Hayati and Mirmirani.
With these parameters, a small change of the arm is a small change of the numbers. The DH table that a controller would
send is computed from the joint axes. Properties that cannot be found from the poses, such as the boundary between
flange and tool, keep their published values.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from urlink import BadValue
from urlink.arm.kinematics import DhTable
from urlink.arm.models import Model
from urlink.arm.poses import compose, from_matrix, invert, rotvec_to_matrix, to_matrix
from urlink.tools import FLOATS, ROWS, ArmLink, FloatArray, Geometry, angles, chain, rigid

# Parameters of each link: offset, a, d, alpha, beta. Joints 2 and 3 have an angle beta instead of an offset d, because
# their axes are parallel.
_FREE = np.array(
    [(1, 1, 1, 1, 0), (1, 1, 0, 1, 1), (1, 1, 0, 1, 1), (1, 1, 1, 1, 0), (1, 1, 1, 1, 0), (1, 1, 1, 1, 0)], dtype=bool
)
# Expected difference of a calibration from the published arm, in rad and m. This prior affects only properties that
# cannot be found from the poses.
_PRIOR = np.array([5e-3, 2e-3, 2e-3, 5e-3, 5e-3])
_PRIOR_TOOL = 1.0
# Expected error of a pose in each step of the search, in m and rad. The expected error is larger in the first steps,
# because they begin at the published arm.
_SPREADS = (1e-4, 1e-6, 1e-8, 1e-8, 1e-8)
_STEP = 1e-6
# For measured poses: rounds of the search, start values of the tool's length in steps of 0.1 m, and the lever in m at
# which a rotation is weighted like a distance.
_ROUNDS, _TURNS, _LEVER = 6, 3, 0.2
#: Maximum number of rows; more rows are thinned out.
_MOST_ROWS = 600
#: Minimum motion of each joint in the rows, in rad.
_LEAST_MOVED = 0.2


@dataclass(frozen=True)
class Calibration:
    """Fitted arm.

    Attributes:
        table: DH table in the form that a controller would send.
        tcp: Pose of the TCP in the flange frame, shape (6,): position in m, rotation vector in rad.
        rms: Root mean square of the distances between the given positions and those of the fitted arm, in m.
    """

    table: DhTable
    tcp: FloatArray
    rms: float


def fit_calibration(model: Model, q: FloatArray, poses: FloatArray) -> Calibration:
    """Return the calibration and the TCP that map joint positions to poses.

    Args:
        model: Published arm, at which the search starts.
        q: Joint positions, shape (n, 6), in rad. Use targets, because the actual positions have noise.
        poses: Poses of the TCP in the base frame, shape (n, 6): position in m, rotation vector in rad.

    Raises:
        BadValue: If there are too few rows, or joints hardly move in them. The message names these joints.
    """
    _check_motion(q)
    chosen = np.linspace(0, len(q) - 1, min(len(q), _MOST_ROWS)).astype(int)
    q, poses = q[chosen], poses[chosen]
    turned = rotvec_to_matrix(poses[:, 3:])
    published = np.column_stack((model.dh_theta, model.dh_a, model.dh_d, model.dh_alpha, np.zeros(6)))
    start = published.copy()
    # TCP with which the published arm would reach the pose of the first row.
    tcp = compose(invert(from_matrix(_flanges(start, q[:1])[0])), poses[0])
    free = np.flatnonzero(_FREE)
    spread = np.concatenate((np.tile(_PRIOR, (6, 1)).ravel()[free], np.full(6, _PRIOR_TOOL)))

    def links(x: FloatArray) -> FloatArray:
        flat = published.ravel().copy()
        flat[free] += x[:-6]
        return flat.reshape(6, 5)

    def residuals(x: FloatArray) -> FloatArray:
        found = _flanges(links(x), q) @ to_matrix(x[-6:])
        off = turned @ np.swapaxes(found[:, :3, :3], 1, 2)
        turn = 0.5 * np.stack(
            (off[:, 1, 2] - off[:, 2, 1], off[:, 2, 0] - off[:, 0, 2], off[:, 0, 1] - off[:, 1, 0]), -1
        )
        return np.concatenate(((found[:, :3, 3] - poses[:, :3]).ravel(), turn.ravel()))

    x = np.concatenate((np.zeros(len(free)), tcp))
    before = x.copy()
    steps = np.eye(len(x)) * _STEP
    for sigma in _SPREADS:
        slope = np.column_stack([(residuals(x + h) - residuals(x - h)) / (2.0 * _STEP) for h in steps])
        whole = np.vstack((slope * spread / sigma, np.eye(len(x))))
        gap = np.concatenate((residuals(x) / sigma, (x - before) / spread))
        x = x - spread * np.linalg.lstsq(whole, gap, rcond=None)[0]
    table, shift = _table(links(x))
    distances = residuals(x)[: 3 * len(q)].reshape(-1, 3)
    rms = float(np.sqrt((distances**2).sum(axis=1).mean()))
    return Calibration(table, compose(shift, x[-6:]), rms)


def _check_motion(q: FloatArray) -> None:
    moved = np.ptp(q, axis=0) if len(q) else np.zeros(6)
    if len(q) < 30 or (moved < _LEAST_MOVED).sum() > 1:
        still = [str(joint) for joint in np.flatnonzero(moved < _LEAST_MOVED)]
        raise BadValue(
            f"got {len(q)} rows; joints that move by less than {_LEAST_MOVED} rad: {', '.join(still) or 'none'}; "
            "expected 30 or more rows, and motion of at least five joints"
        )


@dataclass(frozen=True)
class MeasuredFit:
    """Arm that was fitted to measured poses.

    Attributes:
        table: DH table of the arm.
        tcp: Pose of the measured point in the flange frame, shape (6,). Without measured orientations, its rotation is
            zero.
        base: Pose of the base of the arm in the frame of the measuring device, shape (6,).
        rms: Root mean square of the distances in the rows that were not used for the fit, in m.
        published: The same for the published arm, with its base and its TCP fitted to the same rows.
    """

    table: DhTable
    tcp: FloatArray
    base: FloatArray
    rms: float
    published: float


def fit_measured(model: Model, q: FloatArray, poses: FloatArray) -> MeasuredFit:
    """Fit the arm, its base and its TCP to poses that an external device has measured.

    Every fourth row is left out of the fit and tells how well the arm is known. Parameters that the poses do not show
    stay near the published arm.

    Args:
        model: Published arm, where the search starts.
        q: Joint positions, shape (n, 6), in rad.
        poses: Measured positions, shape (n, 3), in m, or poses with rotation vectors, shape (n, 6), in the frame of the
            device.

    Raises:
        BadValue: If there are fewer than 30 rows, joints hardly move, or the positions are not in m.
    """
    _check_motion(q)
    if np.ptp(poses[:, :3], axis=0).max() > 10.0:
        raise BadValue(
            f"the measured positions extend over {np.ptp(poses[:, :3], axis=0).max():.4g}; expected m (in mm?)"
        )
    held = np.arange(len(q)) % 4 == 3
    published = np.column_stack((model.dh_theta, model.dh_a, model.dh_d, model.dh_alpha, np.zeros(6)))
    free = np.flatnonzero(_FREE)
    tool = 6 if poses.shape[1] == 6 else 3

    def arm_of(x: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        links = published.ravel().copy()
        links[free] += x[: len(free)]
        tcp = np.concatenate((x[len(free) + 6 :], np.zeros(6 - tool)))
        return links.reshape(6, 5), x[len(free) : len(free) + 6], tcp

    def residuals(x: FloatArray, rows: NDArray[np.bool_]) -> FloatArray:
        links, base, tcp = arm_of(x)
        found = to_matrix(base) @ _flanges(links, q[rows]) @ to_matrix(tcp)
        away = found[:, :3, 3] - poses[rows, :3]
        if tool == 3:
            return np.asarray(away)
        # A rotation counts like the distance that it causes at this lever.
        off = rotvec_to_matrix(poses[rows, 3:]) @ np.swapaxes(found[:, :3, :3], 1, 2)
        turn = 0.5 * np.stack(
            (off[:, 2, 1] - off[:, 1, 2], off[:, 0, 2] - off[:, 2, 0], off[:, 1, 0] - off[:, 0, 1]), -1
        )
        return np.concatenate((away, _LEVER * turn), axis=1)

    spread = np.concatenate((np.tile(_PRIOR, (6, 1)).ravel()[free], np.full(6 + tool, 10.0)))
    steps = np.eye(len(spread)) * _STEP

    def search(x: FloatArray, known: int, sigma: float) -> FloatArray:
        """Change all parameters from number `known` on, until the rows for the fit agree best."""
        for _ in range(_ROUNDS):
            slope = np.column_stack(
                [(residuals(x + h, ~held) - residuals(x - h, ~held)).ravel() / (2.0 * _STEP) for h in steps[known:]]
            )
            whole = np.vstack((slope * spread[known:] / sigma, np.eye(len(x) - known)))
            gap = np.concatenate((residuals(x, ~held).ravel() / sigma, x[known:] / spread[known:]))
            x = x.copy()
            x[known:] -= spread[known:] * np.linalg.lstsq(whole, gap, rcond=None)[0]
        return x

    def distance(x: FloatArray) -> float:
        return float(np.sqrt((residuals(x, held)[:, :3] ** 2).sum(axis=1).mean()))

    start = min(
        (search(_aligned(published, q, poses, free, tool, turn), len(free), 1e-2) for turn in range(_TURNS)),
        key=lambda x: float((residuals(x, ~held) ** 2).sum()),
    )
    sigma = max(float(residuals(start, ~held).std()), 1e-7)
    best = start
    for _ in range(3):
        best = search(best, 0, sigma)
        sigma = max(float(residuals(best, ~held).std()), 1e-7)
    links, base, tcp = arm_of(best)
    table, shift = _table(links)
    return MeasuredFit(table, compose(shift, tcp), base, distance(best), distance(start))


def _aligned(
    links: FloatArray, q: FloatArray, poses: FloatArray, free: NDArray[np.int_], tool: int, turn: int
) -> FloatArray:
    """Return start values: the base that maps the flanges of the published arm to the measured positions best."""
    tcp = np.zeros(tool)
    tcp[2] = 0.1 * turn
    frames = _flanges(links, q)
    ours = frames[:, :3, 3] + frames[:, :3, 2] * tcp[2]
    theirs = poses[:, :3]
    u, _, vt = np.linalg.svd((ours - ours.mean(axis=0)).T @ (theirs - theirs.mean(axis=0)))
    flip = np.diag((1.0, 1.0, np.sign(np.linalg.det(vt.T @ u.T))))
    whole = np.eye(4)
    whole[:3, :3] = vt.T @ flip @ u.T
    whole[:3, 3] = theirs.mean(axis=0) - whole[:3, :3] @ ours.mean(axis=0)
    if tool == 6:
        first = np.linalg.inv(whole @ frames[0]) @ to_matrix(poses[0])
        tcp = from_matrix(first)
    return np.concatenate((np.zeros(len(free)), from_matrix(whole), tcp))


def _geometry(links: FloatArray) -> Geometry:
    """Return the geometry of an arm from the parameters of its links."""
    return Geometry(tuple(ArmLink(*link) for link in links.tolist()), is_nominal=False)


def _flanges(links: FloatArray, q: FloatArray) -> FloatArray:
    """Return the poses of the flange as matrices, shape (n, 4, 4)."""
    return rigid.to_matrices(chain(_geometry(links), ROWS, angles(q.T))[5])


def _table(links: FloatArray) -> tuple[DhTable, FloatArray]:
    """Return the DH table of an arm with the same joint axes, and the pose of the old flange in the new flange frame.

    In a DH table, the x axis of each frame is along the common normal of two joint axes.
    """
    frames = [rigid.to_matrix(frame) for frame in chain(_geometry(links), FLOATS, (0.0,) * 6)]
    (x, _, z), at = np.eye(3), np.zeros(3)
    rows = []
    for frame in frames:
        axis, place = frame[:3, 2], frame[:3, 3]
        across = np.cross(z, axis)
        sine = float(np.linalg.norm(across))
        way = place - at
        if sine < 1e-12:
            # Parallel axes: use the normal through the origin of the old frame, as in the published table.
            d = float(way @ z)
            normal = way - d * z
            a = float(np.linalg.norm(normal))
            normal = normal / a if a > 1e-12 else x
        else:
            normal = across / sine
            # The common normal meets the two axes at the points `at + d z` and `place + e axis`.
            d = float(np.cross(way, axis) @ across) / sine**2
            a = float(way @ normal)
        # The normal has two possible directions. As in the published table, use the direction with the smaller joint
        # offset.
        if normal @ frame[:3, 0] < 0.0:
            normal, a = -normal, -a
        theta = float(np.arctan2(np.cross(x, normal) @ z, x @ normal))
        alpha = float(np.arctan2(np.cross(z, axis) @ normal, z @ axis))
        rows.append((theta, a, d, alpha, 0.0))
        x, z, at = normal, axis, at + d * z + a * normal
    found = np.array(rows)
    flange = _flanges(found, np.zeros((1, 6)))[0]
    return DhTable(*found.T[:4].tolist()), from_matrix(np.linalg.inv(flange) @ frames[5])

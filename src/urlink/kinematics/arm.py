"""The kinematics of one arm, as users hold it."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from linkcore.errors import LocalError

from .. import rigid
from ..models import Model
from ..models import model as model_called
from ..rigid import FLOATS, ROWS, FloatArray, Functions, Number, Rigid
from .closed_form import BRANCHES, wrapped
from .geometry import Angles, DenavitHartenberg, Geometry, calibrated, chain, flange, jacobian, nominal
from .inverse import around, branches, branches_of_rows, closest, closest_of_rows, distance
from .velocity import velocity

__all__ = ["Arm", "Unreachable"]

# Ways closer than this, rad, are one: where two meet, rounding parts them by the root of the precision.
_SAME = 1e-6


class Unreachable(LocalError, ValueError):
    """No joint positions put the tool there."""


class Arm:
    """The kinematics of one arm: where its tool is, and how to bring it somewhere.

    Joint positions are six numbers, rad, from base to wrist 3. A pose is x, y, z in m and a rotation vector in rad, in
    the base frame, as the controller has it; `urlink.poses` converts them. A TCP is a pose in the frame of the flange.
    Every method takes one row of six, or any number of rows in an array (..., 6), which costs a few microseconds a row.

    The arm is the published one of its model; `Arm.calibrated` makes that of a single robot. Where it collides with
    itself or its surroundings is not looked at.

    Args:
        model: name as the vendor writes it, in upper or lower case, or a `Model`.

    Raises:
        UnknownModel: no arm is called that.

    >>> arm = Arm("UR5e")
    >>> pose = arm.forward([0, -1.57, 1.57, -1.57, -1.57, 0])
    >>> pose.round(3).tolist()
    [-0.492, -0.133, 0.488, 2.221, 2.221, 0.0]
    >>> arm.inverse(pose, near=[0, -1.5, 1.5, -1.5, -1.5, 0]).round(3).tolist()
    [0.0, -1.57, 1.57, -1.57, -1.57, 0.0]
    """

    __slots__ = ("_geometry", "_model", "_table")

    def __init__(self, model: str | Model) -> None:
        self._model = model if isinstance(model, Model) else model_called(model)
        self._table: DenavitHartenberg = self._model
        self._geometry = nominal(self._model)

    @classmethod
    def calibrated(cls, model: str | Model, table: DenavitHartenberg) -> Arm:
        """The arm with the geometry that its controller sends of it, to some 0.1 mm that of the very robot.

        Args:
            model: of the robot.
            table: its DH parameters, `dh_theta`, `dh_a`, `dh_d` and `dh_alpha`: the `KinematicsInfo` of a robot state,
                which is in the first one of each connection.

        Raises:
            UnknownModel: no arm is called that.
            BadValue: the parameters are not those of such an arm; the message says which one is how far off.
        """
        arm = cls(model)
        arm._table = table
        arm._geometry = calibrated(arm._model, table)
        return arm

    def __repr__(self) -> str:
        return f"<Arm {self._model.name}, {'calibrated' if self.is_calibrated else 'as published'}>"

    @property
    def model(self) -> Model:
        """Lengths, limits and masses as published."""
        return self._model

    @property
    def is_calibrated(self) -> bool:
        """Whether the geometry differs from the published one."""
        return not self._geometry.is_nominal

    @property
    def table(self) -> DenavitHartenberg:
        """The DH parameters that it was made from: `dh_theta`, `dh_a`, `dh_d` and `dh_alpha`, six of each."""
        return self._table

    @property
    def geometry(self) -> Geometry:
        """The links as they are computed with."""
        return self._geometry

    @property
    def position_limits(self) -> FloatArray:
        """(6, 2) lowest and highest joint position, rad; infinite where a joint turns without end. Read-only."""
        return self._model.position_limits

    def within_limits(self, q: ArrayLike) -> NDArray[np.bool_]:
        """Whether joint positions are within the position limits.

        Args:
            q: (..., 6) joint positions, rad.

        Returns:
            (...) booleans.

        Raises:
            BadValue: not joint positions.
        """
        given = rigid.rows(q, (6,), "joint positions")
        low, high = self.position_limits.T
        return np.asarray(((low <= given) & (given <= high)).all(axis=-1))

    # --- forward ---

    def forward(self, q: ArrayLike, tcp: ArrayLike | None = None) -> FloatArray:
        """The pose of the tool.

        Args:
            q: (..., 6) joint positions, rad.
            tcp: (6,) pose of the TCP in the frame of the flange; None for the flange.

        Returns:
            (..., 6) poses in the base frame; rotation vectors of an angle of 0 to pi.

        Raises:
            BadValue: not joint positions, or no TCP.
        """
        if rigid.is_single(q):
            return np.array(rigid.to_pose(_with(self._flange(FLOATS, _one(q)), tcp)))
        given = rigid.rows(q, (6,), "joint positions")
        return rigid.to_poses(_with(self._flange(ROWS, _rows(given)), tcp)).reshape(given.shape)

    def frames(self, q: ArrayLike) -> FloatArray:
        """The base and the end of each link, in the base frame.

        Args:
            q: (..., 6) joint positions, rad.

        Returns:
            (..., 7, 4, 4) homogeneous matrices. The joint i + 1 turns about the z axis of frame i; the last is the
            flange.

        Raises:
            BadValue: not joint positions.
        """
        given = rigid.rows(q, (6,), "joint positions")
        links = [rigid.to_matrices(frame) for frame in chain(self._geometry, ROWS, _rows(given))]
        base = np.broadcast_to(np.eye(4), links[0].shape)
        return np.stack([base, *links], axis=1).reshape(*given.shape[:-1], 7, 4, 4)

    # --- inverse ---

    def inverse(
        self, pose: ArrayLike, near: ArrayLike, tcp: ArrayLike | None = None, *, is_limited: bool = True
    ) -> FloatArray:
        """The joint positions for a pose that are closest to others: those with the smallest largest joint movement.

        Where joint 6 is free, since joints 4 and 6 turn about the same direction, it stays as `near` has it.

        Args:
            pose: (..., 6) poses of the tool in the base frame.
            near: (..., 6) joint positions, rad, that broadcast to the poses.
            tcp: (6,) pose of the TCP in the frame of the flange; None for the flange.
            is_limited: each joint is given in the turn closest to `near` that is within its limits. If false, in the
                closest turn, as the continuation of a path has to be.

        Returns:
            (..., 6) rad. Of one pose alone they exist; of several, the rows of those out of reach are NaN.

        Raises:
            Unreachable: no joint positions put the tool at the one pose that was given.
            BadValue: not poses and joint positions, shapes that do not broadcast, or no TCP.
        """
        if rigid.is_single(pose) and rigid.is_single(near):
            target, close = _target(_pose(pose), tcp), _one(near)
            found = closest(self._geometry, target, close)
            if found is None:
                raise self._unreachable(target, pose)
            return np.array(self._in_turn(found, close, is_limited))
        given, close_to = rigid.rows(pose, (6,), "poses"), rigid.rows(near, (6,), "joint positions")
        (poses, nears), shape = rigid.aligned(given, close_to)
        q = closest_of_rows(self._geometry, _target(rigid.from_poses(poses), tcp), nears)
        q = nears + around(q - nears)
        if is_limited:
            low, high = self.position_limits.T
            with np.errstate(invalid="ignore"):
                q = np.where(q > high, q - math.tau, np.where(q < low, q + math.tau, q))
        return q.reshape(*shape, 6)

    def branches(self, pose: ArrayLike, tcp: ArrayLike | None = None) -> FloatArray:
        """All eight ways to reach a pose, the branches of the solution, each at a place of its own.

        The number of the row is 4 times the shoulder (on the side of the wrist or away from it), plus 2 times the wrist
        (joint 5 positive or negative), plus the elbow (joint 3 positive or negative). Along a path each row is
        continuous, up to whole turns, until it ends at the edge of its reach. Of a calibrated arm they are the
        continuations of these.

        Args:
            pose: (..., 6) poses of the tool in the base frame.
            tcp: (6,) pose of the TCP in the frame of the flange; None for the flange.

        Returns:
            (..., 8, 6) rad, in (-pi, pi], NaN where a branch does not reach the pose. Where two branches meet, in a
            singularity, both are there. Joint 6 is 0 where it is free.

        Raises:
            BadValue: not poses, or no TCP.
        """
        if rigid.is_single(pose):
            return _table(branches(self._geometry, _target(_pose(pose), tcp)))
        given = rigid.rows(pose, (6,), "poses")
        targets = _target(rigid.from_poses(given.reshape(-1, 6)), tcp)
        return branches_of_rows(self._geometry, targets)[0].reshape(*given.shape[:-1], BRANCHES, 6)

    def solutions(self, pose: ArrayLike, near: ArrayLike | None = None, tcp: ArrayLike | None = None) -> FloatArray:
        """All joint positions for one pose. Ways that meet in a singularity are given once.

        Args:
            pose: (6,) pose of the tool in the base frame.
            near: (6,) joint positions, rad: each joint is given in the turn closest to it, whatever its limits, and the
                rows are sorted by their largest joint movement.
            tcp: (6,) pose of the TCP in the frame of the flange; None for the flange.

        Returns:
            (n, 6) rad, n from 0 (out of reach) to 8; in (-pi, pi] unless `near` is given.

        Raises:
            BadValue: no pose, joint positions or TCP.
        """
        close = None if near is None else _one(near)
        found: list[Angles[float]] = []
        for q in branches(self._geometry, _target(_pose(pose), tcp), 0.0 if close is None else close[5]):
            if q is not None and not any(distance(q, other) < _SAME for other in found):
                found.append(q)
        if close is not None:
            found = [_turned(q, close) for q in sorted(found, key=lambda q: distance(q, close))]
        else:
            found = [_turned(q, (0.0,) * 6) for q in found]
        return np.array(found, dtype=np.float64).reshape(-1, 6)

    def inverse_path(self, poses: ArrayLike, near: ArrayLike, tcp: ArrayLike | None = None) -> FloatArray:
        """The joint positions along a path of the tool, each closest to the ones before.

        A path that leads through a singularity, or to where one way of reaching ends, may make a joint leap from one
        row to the next: look at the differences of the rows before an arm is made to follow them.

        Args:
            poses: (n, 6) poses of the tool in the base frame.
            near: (6,) joint positions, rad, at the beginning.
            tcp: (6,) pose of the TCP in the frame of the flange; None for the flange.

        Returns:
            (n, 6) rad, each joint in the turn closest to the row before, whatever its limits.

        Raises:
            Unreachable: a pose is out of reach; the message says which.
            BadValue: not poses and joint positions, or no TCP.
        """
        given = rigid.rows(poses, (6,), "poses").reshape(-1, 6)
        before = _one(near)
        targets = _target(rigid.from_poses(given), tcp)
        ways: list[list[list[float]]] = [[] for _ in given]
        if not self.is_calibrated:
            found_ways, singular = branches_of_rows(self._geometry, targets)
            # In a singularity it matters which joint positions were before.
            ways = [[] if at else rows for rows, at in zip(found_ways.tolist(), singular.tolist(), strict=True)]
        path = []
        for i, rows in enumerate(ways):
            # Of a calibrated arm there are none: to search from the joint positions before costs less than all eight.
            candidates = [row for row in rows if row[0] == row[0]]
            found: Sequence[float] | None = min(candidates, key=lambda q: distance(q, before), default=None)
            if found is None:
                target = rigid.row(targets, i)
                found = closest(self._geometry, target, before)
                if found is None:
                    raise self._unreachable(target, given[i], f"row {i}: ")
            before = _turned(found, before)
            path.append(before)
        return np.array(path).reshape(-1, 6)

    # --- velocities ---

    def jacobian(self, q: ArrayLike, tcp: ArrayLike | None = None) -> FloatArray:
        """The geometric Jacobian of the tool, in the base frame.

        Args:
            q: (..., 6) joint positions, rad.
            tcp: (6,) pose of the TCP in the frame of the flange; None for the flange.

        Returns:
            (..., 6, 6): times joint speeds in rad/s it is the velocity of the TCP, m/s, above the angular velocity,
            rad/s. Its transpose times a force, N, and a torque, Nm, at the TCP is the torque of each joint.

        Raises:
            BadValue: not joint positions, or no TCP.
        """
        if rigid.is_single(q):
            frames = chain(self._geometry, FLOATS, _one(q))
            return np.array(jacobian(frames, _with(frames[5], tcp)[9:])).T
        given = rigid.rows(q, (6,), "joint positions")
        links = chain(self._geometry, ROWS, _rows(given))
        columns: FloatArray = np.array(jacobian(links, _with(links[5], tcp)[9:]))
        return np.ascontiguousarray(columns.transpose(2, 1, 0)).reshape(*given.shape, 6)

    def velocity(self, q: ArrayLike, qd: ArrayLike, tcp: ArrayLike | None = None) -> FloatArray:
        """The velocity of the tool: the Jacobian times the joint speeds, for less than the Jacobian costs.

        Args:
            q: (..., 6) joint positions, rad.
            qd: (..., 6) joint speeds, rad/s.
            tcp: (6,) pose of the TCP in the frame of the flange; None for the flange.

        Returns:
            (..., 6) velocity of the TCP, m/s, and angular velocity, rad/s, in the base frame.

        Raises:
            BadValue: not joint positions and speeds, shapes that do not broadcast, or no TCP.
        """
        if rigid.is_single(q) and rigid.is_single(qd):
            at, speed = _one(q), _one(qd, "joint speeds")
            return np.array(velocity(self._geometry, FLOATS, at, speed, _with(self._flange(FLOATS, at), tcp)[9:]))
        given = rigid.rows(q, (6,), "joint positions"), rigid.rows(qd, (6,), "joint speeds")
        (ats, speeds), shape = rigid.aligned(*given)
        points = _with(self._flange(ROWS, _rows(ats)), tcp)[9:]
        found = velocity(self._geometry, ROWS, _rows(ats), _rows(speeds), points)
        return np.stack(found, axis=-1).reshape(*shape, 6)

    def manipulability(self, q: ArrayLike) -> FloatArray:
        """How far from a singularity: the product of the singular values of the Jacobian (Yoshikawa), m³.

        It is 0 in a singularity, and does not depend on the TCP. For a published arm it is
        `abs(a2 * a3 * sin(q3) * sin(q5) * r)`, r being the distance of the wrist's origin, frame 5, from the base's
        axis, measured in the plane of the arm.

        Args:
            q: (..., 6) joint positions, rad.

        Returns:
            (...) m³.

        Raises:
            BadValue: not joint positions.
        """
        with np.errstate(divide="ignore", invalid="ignore"):  # numpy warns of some singular matrices, and gives 0
            found: FloatArray = np.abs(np.linalg.det(self.jacobian(q)))
        return found

    # --- within ---

    def _flange(self, f: Functions[Number], q: Angles[Number]) -> Rigid[Number]:
        geometry = self._geometry
        return flange(geometry.lengths, f, q) if geometry.is_nominal else chain(geometry, f, q)[5]

    def _in_turn(self, q: Angles[float], near: Angles[float], is_limited: bool) -> Sequence[float]:
        turned = _turned(q, near)
        if not is_limited:
            return turned
        return [
            angle - math.tau if angle > high else angle + math.tau if angle < low else angle
            for angle, (low, high) in zip(turned, self.position_limits.tolist(), strict=True)
        ]

    def _unreachable(self, target: Rigid[float], pose: ArrayLike, row: str = "") -> Unreachable:
        d1, a2, a3, d4, d5, d6 = self._geometry.lengths
        wrist = target[9] - d6 * target[2], target[10] - d6 * target[5], target[11] - d6 * target[8]
        distance, furthest = math.dist(wrist, (0.0, 0.0, d1)), math.hypot(abs(a2) + abs(a3) + d5, d4)
        if distance > furthest:
            why = f"its wrist would be {distance:.3f} m from the shoulder, and comes {furthest:.3f} m far at most"
        elif math.hypot(*wrist[:2]) < d4:
            why = (
                f"its wrist would be {math.hypot(*wrist[:2]):.3f} m from the axis of the base, and comes to {d4:.3f} m"
            )
        else:
            why = "in that orientation its elbow cannot be bent or stretched enough"
        numbers = np.asarray(pose, dtype=np.float64).round(4).tolist()
        return Unreachable(f"{row}a {self._model.name} cannot bring its tool to {numbers}: {why}")


# --- arguments ---


def _one(q: ArrayLike, what: str = "joint positions") -> Angles[float]:
    q1, q2, q3, q4, q5, q6 = rigid.floats(q, 6, what)
    return q1, q2, q3, q4, q5, q6


def _rows(q: FloatArray) -> Angles[FloatArray]:
    q1, q2, q3, q4, q5, q6 = np.ascontiguousarray(q.reshape(-1, 6).T)
    return q1, q2, q3, q4, q5, q6


def _pose(pose: ArrayLike) -> Rigid[float]:
    return rigid.from_pose(rigid.floats(pose, 6, "a pose"))


def _tool(tcp: ArrayLike) -> Rigid[float]:
    return rigid.from_pose(rigid.floats(tcp, 6, "a TCP"))


def _with(flange: Rigid[Number], tcp: ArrayLike | None) -> Rigid[Number]:
    """Where the TCP is for where the flange is."""
    return flange if tcp is None else rigid.product(flange, _tool(tcp))  # type: ignore[arg-type]


def _target(tool: Rigid[Number], tcp: ArrayLike | None) -> Rigid[Number]:
    """Where the flange is for where the TCP is."""
    return tool if tcp is None else rigid.product(tool, rigid.invert(_tool(tcp)))  # type: ignore[arg-type]


# --- angles ---


def _turned(q: Sequence[float], near: Sequence[float]) -> Angles[float]:
    """Each joint in the turn closest to that of `near`, in (-pi, pi] from it."""
    q1, q2, q3, q4, q5, q6 = [b + wrapped(a - b) for a, b in zip(q, near, strict=True)]
    return q1, q2, q3, q4, q5, q6


def _table(found: Sequence[Angles[float] | None]) -> FloatArray:
    """(8, 6) in (-pi, pi]; NaN for branches that do not reach."""
    return np.array([[math.nan] * 6 if q is None else [wrapped(angle) for angle in q] for q in found])

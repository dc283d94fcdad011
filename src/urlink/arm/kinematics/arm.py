"""Class `Arm`: forward and inverse kinematics, and velocities, of one arm."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from linkcore.arguments import other_unit
from linkcore.errors import BadValue
from linkcore.names import StrictAttributes

from .. import rigid
from ..bounds import TURN, check_length, check_rotations
from ..models import Model
from ..models import model as model_called
from ..rigid import FLOATS, ROWS, MathFunctions, Number, Rigid
from ..vectors import FloatArray
from .closed_form import BRANCHES, wrapped, wrist_place
from .geometry import Angles, DenavitHartenberg, Geometry, calibrated, chain, flange, jacobian, nominal, velocity
from .inverse import around, branches, branches_of_rows, closest, closest_of_rows, distance

# Two solutions that differ by less than this, in rad, count as one. If two branches meet, rounding errors separate them
# by about the square root of the floating-point precision.
_SAME = 1e-6


class Unreachable(BadValue):
    """Error: a pose is out of reach, because no joint positions move the tool to this pose."""

    __module__ = "urlink"  # users import the class from `urlink`, so tracebacks show this name


class Arm(StrictAttributes):
    """Forward and inverse kinematics of one arm.

    Joint positions are six numbers in rad, from base to wrist 3. A pose is x, y, z in m and a rotation vector in rad,
    in the controller's base frame; `urlink.poses` converts poses. A TCP is a pose in the flange frame. Methods accept
    one row of six numbers, or an array of rows, shape (..., 6). A call with an array takes a few microseconds per row.

    `Arm(model)` has the geometry that the vendor publishes. `Arm.calibrated` has the geometry of one particular robot.
    Collisions of the arm with itself or its surroundings are not checked.

    Args:
        model: Name that the vendor uses, in upper or lower case, or a `Model`.

    Raises:
        UnknownModel: If no arm has this name.

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
        """Create an arm with the DH parameters that its controller sends. The result is accurate to about 0.1 mm.

        Args:
            model: Model of the robot.
            table: DH parameters `dh_theta`, `dh_a`, `dh_d` and `dh_alpha`, shape (6,) each. The `KinematicsInfo` in the
                first robot state of each connection contains them.

        Raises:
            UnknownModel: If no arm has this name.
            BadValue: If the parameters do not belong to this model. The message names the link, its value, and the
                published value.
        """
        arm = cls(model)
        arm._table = table
        arm._geometry = calibrated(arm._model, table)
        return arm

    def __repr__(self) -> str:
        return f"<Arm {self._model.name}, {'calibrated' if self.is_calibrated else 'as published'}>"

    @property
    def model(self) -> Model:
        """Model with the published lengths, limits and masses."""
        return self._model

    @property
    def is_calibrated(self) -> bool:
        """Whether the geometry differs from the published one."""
        return not self._geometry.is_nominal

    @property
    def table(self) -> DenavitHartenberg:
        """DH parameters of this arm: `dh_theta`, `dh_a`, `dh_d` and `dh_alpha`, shape (6,) each."""
        return self._table

    @property
    def geometry(self) -> Geometry:
        """Links of the arm, as the calculations use them."""
        return self._geometry

    @property
    def position_limits(self) -> FloatArray:
        """Lowest and highest joint positions, shape (6, 2), in rad; infinite if unlimited. Read-only."""
        return self._model.position_limits

    def within_limits(self, q: ArrayLike) -> NDArray[np.bool_]:
        """Return whether joint positions are within the position limits.

        Args:
            q: Joint positions, shape (..., 6), in rad.

        Returns:
            Booleans, shape (...).

        Raises:
            BadValue: If `q` does not have this shape, or contains a number that is not finite.
        """
        given = rigid.rows(q, (6,), "joint positions")
        low, high = self.position_limits.T
        return np.asarray(((low <= given) & (given <= high)).all(axis=-1))

    # --- forward ---

    def forward(self, q: ArrayLike, tcp: ArrayLike | None = None) -> FloatArray:
        """Return the pose of the tool.

        Args:
            q: Joint positions, shape (..., 6), in rad.
            tcp: Pose of the TCP in the flange frame, shape (6,); None for the flange.

        Returns:
            Poses in the base frame, shape (..., 6). The angles of the rotation vectors are 0 to pi.

        Raises:
            BadValue: If `q` or `tcp` does not have this shape, or contains a number that is not finite.
        """
        if rigid.is_single(q):
            return np.array(rigid.to_pose(_with(self._flange(FLOATS, _one(q)), tcp)))
        given = rigid.rows(q, (6,), "joint positions")
        return rigid.to_poses(_with(self._flange(ROWS, _rows(given)), tcp)).reshape(given.shape)

    def frames(self, q: ArrayLike) -> FloatArray:
        """Return the frames of the base and of the end of each link, in the base frame.

        Args:
            q: Joint positions, shape (..., 6), in rad.

        Returns:
            Homogeneous matrices, shape (..., 7, 4, 4). Joint i + 1 turns about the z axis of frame i. Frame 6 is the
            flange.

        Raises:
            BadValue: If `q` does not have this shape, or contains a number that is not finite.
        """
        given = rigid.rows(q, (6,), "joint positions")
        links = [rigid.to_matrices(frame) for frame in chain(self._geometry, ROWS, _rows(given))]
        base = np.broadcast_to(np.eye(4), links[0].shape)
        return np.stack([base, *links], axis=1).reshape(*given.shape[:-1], 7, 4, 4)

    # --- inverse ---

    def inverse(
        self, pose: ArrayLike, near: ArrayLike, tcp: ArrayLike | None = None, *, is_limited: bool = True
    ) -> FloatArray:
        """Return the joint positions that reach a pose with the smallest joint motion from `near`.

        If several solutions reach the pose, the result is the one with the smallest maximum joint motion. In the wrist
        singularity, the axes of joints 4 and 6 are parallel, and joint 6 can have any value. Then joint 6 keeps its
        value from `near`.

        Args:
            pose: Poses of the tool in the base frame, shape (..., 6).
            near: Joint positions, shape (..., 6), in rad; broadcast against the poses.
            tcp: Pose of the TCP in the flange frame, shape (6,); None for the flange.
            is_limited: Whether each joint is in the turn closest to `near` that is within its limits. If False, each
                joint is in the closest turn regardless of its limits, so that a path continues without a jump.

        Returns:
            Joint positions, shape (..., 6), in rad. If several poses are given, the rows of poses out of reach are NaN.

        Raises:
            Unreachable: If a single pose was given, and it is out of reach.
            BadValue: If an argument has the wrong shape, contains a number that is not finite, or does not
                broadcast. The error is also raised if a rotation vector is longer than one turn, for example because it
                is in degrees.
        """
        if rigid.is_single(pose) and rigid.is_single(near):
            target, close = _target(_pose(pose), tcp), _one(near)
            found = closest(self._geometry, target, close)
            if found is None:
                raise self._unreachable(target, pose)
            return np.array(self._in_turn(found, close, is_limited))
        given, close_to = _poses(pose), rigid.rows(near, (6,), "joint positions")
        (poses, nears), shape = rigid.aligned(given, close_to)
        q = closest_of_rows(self._geometry, _target(rigid.from_poses(poses), tcp), nears)
        q = nears + around(q - nears)
        if is_limited:
            low, high = self.position_limits.T
            with np.errstate(invalid="ignore"):
                q = np.where(q > high, q - math.tau, np.where(q < low, q + math.tau, q))
        return q.reshape(*shape, 6)

    def branches(self, pose: ArrayLike, tcp: ArrayLike | None = None) -> FloatArray:
        """Return all eight branches of the solution for a pose, one row for each.

        The index of the row is 4 * shoulder + 2 * wrist + elbow. Shoulder is 0 if the x axis of frame 1 points towards
        the wrist, and 1 if it points away from the wrist. Wrist is 0 if joint 5 is positive, and 1 if joint 5 is
        negative. Elbow is 0 if joint 3 is positive, and 1 if joint 3 is negative. Along a path, each row is continuous
        except for whole turns, until the branch ends at the edge of its reach. The branches of a calibrated arm
        continue those of the published arm.

        Args:
            pose: Poses of the tool in the base frame, shape (..., 6).
            tcp: Pose of the TCP in the flange frame, shape (6,); None for the flange.

        Returns:
            Joint positions, shape (..., 8, 6), in rad, in (-pi, pi]; NaN if a branch does not reach the pose. If two
            branches meet in a singularity, both rows are given. Joint 6 is 0 if it can have any value.

        Raises:
            BadValue: If `pose` or `tcp` does not have this shape, or contains a number that is not finite.
        """
        if rigid.is_single(pose):
            return _table(branches(self._geometry, _target(_pose(pose), tcp)))
        given = _poses(pose)
        targets = _target(rigid.from_poses(given.reshape(-1, 6)), tcp)
        return branches_of_rows(self._geometry, targets)[0].reshape(*given.shape[:-1], BRANCHES, 6)

    def solutions(self, pose: ArrayLike, near: ArrayLike | None = None, tcp: ArrayLike | None = None) -> FloatArray:
        """Return all joint positions for one pose. Branches that meet in a singularity are returned once.

        Args:
            pose: Pose of the tool in the base frame, shape (6,).
            near: Joint positions, shape (6,), in rad. Each joint is given in the turn closest to `near`, regardless of
                limits, and the rows are sorted by their largest joint motion from `near`. If None, the order is that of
                `branches`.
            tcp: Pose of the TCP in the flange frame, shape (6,); None for the flange.

        Returns:
            Joint positions, shape (n, 6), in rad, with n from 0 (out of reach) to 8. The positions are in (-pi, pi]
            unless `near` is given.

        Raises:
            BadValue: If an argument does not have this shape, or contains a number that is not finite.
        """
        close = None if near is None else _one(near)
        found: list[Angles[float]] = []
        for q in branches(self._geometry, _target(_pose(pose), tcp), 0.0 if close is None else close[5]):
            if q is not None and not any(distance(q, other) < _SAME for other in found):
                found.append(q)
        if close is not None:
            found.sort(key=lambda q: distance(q, close))
        turned = [_turned(q, close or (0.0,) * 6) for q in found]
        return np.array(turned, dtype=np.float64).reshape(-1, 6)

    def inverse_path(self, poses: ArrayLike, near: ArrayLike, tcp: ArrayLike | None = None) -> FloatArray:
        """Return joint positions along a path of the tool. Each row is the solution closest to the previous row.

        A joint can jump between two rows if the path passes through a singularity, or if a branch ends. Check the
        differences between the rows before an arm follows them.

        Args:
            poses: Poses of the tool in the base frame, shape (n, 6).
            near: Joint positions at the beginning, shape (6,), in rad.
            tcp: Pose of the TCP in the flange frame, shape (6,); None for the flange.

        Returns:
            Joint positions, shape (n, 6), in rad. Each joint is in the turn closest to the previous row, regardless of
            limits.

        Raises:
            Unreachable: If a pose is out of reach. The message names its row.
            BadValue: If an argument does not have this shape, or contains a number that is not finite.
        """
        given = _poses(poses).reshape(-1, 6)
        before = _one(near)
        targets = _target(rigid.from_poses(given), tcp)
        ways: list[list[list[float]]] = [[] for _ in given]
        if not self.is_calibrated:
            found_ways, singular = branches_of_rows(self._geometry, targets)
            # In a singularity, the solution depends on the previous row, so these rows are solved one by one below.
            ways = [[] if at else rows for rows, at in zip(found_ways.tolist(), singular.tolist(), strict=True)]
        path = []
        for i, rows in enumerate(ways):
            # The list is empty for a calibrated arm, because one search from the previous row takes less time than
            # computing all eight branches.
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
        """Return the geometric Jacobian of the tool in the base frame.

        Args:
            q: Joint positions, shape (..., 6), in rad.
            tcp: Pose of the TCP in the flange frame, shape (6,); None for the flange.

        Returns:
            Matrices, shape (..., 6, 6). The product with joint speeds in rad/s is the velocity of the TCP in m/s (first
            three rows) and the angular velocity in rad/s (last three rows). The product of the transpose with a force
            in N and a torque in Nm at the TCP gives the joint torques in Nm.

        Raises:
            BadValue: If `q` or `tcp` does not have this shape, or contains a number that is not finite.
        """
        if rigid.is_single(q):
            frames = chain(self._geometry, FLOATS, _one(q))
            return np.array(jacobian(frames, _with(frames[5], tcp)[9:])).T
        given = rigid.rows(q, (6,), "joint positions")
        links = chain(self._geometry, ROWS, _rows(given))
        columns: FloatArray = np.array(jacobian(links, _with(links[5], tcp)[9:]))
        return np.ascontiguousarray(columns.transpose(2, 1, 0)).reshape(*given.shape, 6)

    def velocity(self, q: ArrayLike, qd: ArrayLike, tcp: ArrayLike | None = None) -> FloatArray:
        """Return the velocity of the tool: the Jacobian times the joint speeds, without computing the Jacobian.

        Args:
            q: Joint positions, shape (..., 6), in rad.
            qd: Joint speeds, shape (..., 6), in rad/s.
            tcp: Pose of the TCP in the flange frame, shape (6,); None for the flange.

        Returns:
            Velocity of the TCP in m/s, and angular velocity in rad/s, in the base frame, shape (..., 6).

        Raises:
            BadValue: If an argument has the wrong shape, contains a number that is not finite, or does not
                broadcast.
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
        """Return the manipulability (Yoshikawa), a measure of the distance from a singularity, in m³.

        The manipulability is the product of the singular values of the Jacobian. It is 0 in a singularity, and does not
        depend on the TCP. For a published arm, it is `abs(a2 * a3 * sin(q3) * sin(q5) * r)`, where r is the distance of
        the origin of frame 5 from the axis of the base, measured in the plane of the arm.

        Args:
            q: Joint positions, shape (..., 6), in rad.

        Returns:
            Manipulabilities, shape (...), in m³.

        Raises:
            BadValue: If `q` does not have this shape, or contains a number that is not finite.
        """
        with np.errstate(divide="ignore", invalid="ignore"):  # numpy warns if a matrix is singular; the result is 0
            found: FloatArray = np.abs(np.linalg.det(self.jacobian(q)))
        return found

    # --- parts ---

    def _flange(self, f: MathFunctions[Number], q: Angles[Number]) -> Rigid[Number]:
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
        d1, a2, a3, d4, d5, _ = self._geometry.lengths
        wrist = wrist_place(self._geometry.lengths, target)
        distance, furthest = math.dist(wrist, (0.0, 0.0, d1)), math.hypot(abs(a2) + abs(a3) + d5, d4)
        aside = math.hypot(wrist[0], wrist[1])
        if distance > furthest:
            # The wrist is never closer to the base than 1 cm. So the message does not suggest that 1.5 m was meant as
            # 1.5 mm.
            asked = other_unit(distance, "m", 0.01, furthest)
            why = f"its wrist would be {distance:.3f} m from the shoulder; it reaches at most {furthest:.3f} m{asked}"
        elif aside < d4:
            why = f"its wrist would be {aside:.3f} m from the axis of the base; it reaches {d4:.3f} m or more"
        else:
            why = "in this orientation, the elbow cannot be bent or stretched enough"
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
    numbers = rigid.floats(pose, 6, "a pose")
    check_length(numbers[3:], "the rotation vector in the pose", TURN)
    return rigid.from_pose(numbers)


def _poses(poses: ArrayLike) -> FloatArray:
    given = rigid.rows(poses, (6,), "poses")
    check_rotations(given.reshape(-1, 6), "the poses")
    return given


def _tool(tcp: ArrayLike) -> Rigid[float]:
    return rigid.from_pose(rigid.floats(tcp, 6, "a TCP"))


def _with(flange: Rigid[Number], tcp: ArrayLike | None) -> Rigid[Number]:
    """Return the pose of the TCP for a pose of the flange."""
    return flange if tcp is None else rigid.product(flange, _tool(tcp))  # type: ignore[arg-type]


def _target(tool: Rigid[Number], tcp: ArrayLike | None) -> Rigid[Number]:
    """Return the pose of the flange for a pose of the TCP."""
    return tool if tcp is None else rigid.product(tool, rigid.invert(_tool(tcp)))  # type: ignore[arg-type]


# --- angles ---


def _turned(q: Sequence[float], near: Sequence[float]) -> Angles[float]:
    """Return each joint in the turn closest to `near`: the difference is in (-pi, pi]."""
    q1, q2, q3, q4, q5, q6 = [b + wrapped(a - b) for a, b in zip(q, near, strict=True)]
    return q1, q2, q3, q4, q5, q6


def _table(found: Sequence[Angles[float] | None]) -> FloatArray:
    """Return the branches as an array, shape (8, 6), in (-pi, pi]; NaN for branches that do not reach the pose."""
    return np.array([[math.nan] * 6 if q is None else [wrapped(angle) for angle in q] for q in found])

"""Payload of an arm and offset of its force sensor, fitted to rests in several postures.

At rest, a force sensor shows its own offset, which turns with the flange, and a weight, which always points down. Rests
with the flange in different directions separate the two. Three errors of real sensors are part of the fit:

- A slow **drift** of the offset, linear in time, from the first rest to the last.
- **Hysteresis**: a reading keeps a share of the load of the previous rest. The weight in the current direction and the
  weight in the previous direction are two unknowns, and their sum is the weight.
- **Wander**, which differs from rest to rest. Noise within a rest is much smaller, so each rest counts as one reading.
  The width of the intervals follows from the deviations between the rests and the fit.

An arm without a sensor shows its load in the currents of its joints. The difference between target and actual current
is the torque of the weight that the controller does not know, plus friction. Friction at rest differs from rest to rest
and from joint to joint, so these intervals are wider.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from linkcore.errors import BadValue

from .arm_file import Estimate
from .dynamics import GRAVITY
from .kinematics import Arm
from .motors import motors_of
from .poses import rotvec_to_matrix
from .rigid import floats
from .vectors import FloatArray

#: Fewest and most postures of a measurement.
POSTURES = (6, 10)
#: Source of the load: wrist sensor, or joint currents.
SourceName = Literal["sensor", "currents"]
#: Gravity as `Robot.set_gravity` takes it: the acceleration that an arm at rest measures, in m/s² in the base frame.
UPRIGHT = (0.0, 0.0, GRAVITY)
# Degrees of freedom, and the quantiles of Student's t distribution that enclose 98.75 %. Four intervals that each hold
# in 98.75 % of the measurements hold together in at least 95 %.
_FREE = np.array([1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 15.0, 20.0, 30.0, 60.0, np.inf])
_STUDENT = np.array([50.923, 8.860, 5.392, 4.315, 3.810, 3.521, 3.206, 3.038, 2.837, 2.744, 2.657, 2.575, 2.498])
# Largest standard error of a mass, in kg for 1 N of wander, and of a first moment, in kg m for 1 Nm. Six rests in very
# different directions have 0.06.
_WEAK = 0.4
# Smallest mean square of the change of the direction of gravity, in the frame of the flange: in all directions, and
# without the direction that changes most. Turns by 20 degrees about one axis, and about two axes, have these values.
_TURNED = 0.06
# Relative uncertainty of the torque constants (Nm/A) of a joint: robots of one model differ by some percent.
_CONSTANTS = 0.04


@dataclass(frozen=True)
class MeasuredPayload:
    """Measured payload, and offset of the force sensor.

    The intervals of mass and centre hold together: in 95 % of the measurements, all four numbers are in their
    intervals. A centre is unknown if the mass might be zero.

    Attributes:
        mass: Mass at the flange, in kg.
        cog: Centre of gravity in the flange frame: x, y, z, in m.
        force_offset: Offset of the force sensor at the end of the measurement, six numbers, in N and Nm, along the axes
            of the flange, and about its origin. The numbers are unknown without a sensor. Zeroing the sensor changes
            the offset.
        source: "sensor" for a wrist sensor, "currents" for the currents of the joints.
        postures: Number of postures.
        wander: Root mean square of the deviations between the rests and the fit, in N and Nm. Both are joint torques in
            Nm if the source is the currents.
        set_payload: Mass in kg and centre in m, four numbers, that were set on the controller during the measurement.
        gravity: Gravity during the measurement, shape (3,), as for `Robot.set_gravity`.
    """

    mass: Estimate
    cog: tuple[Estimate, Estimate, Estimate]
    force_offset: tuple[Estimate, ...]
    source: SourceName
    postures: int
    wander: tuple[float, float]
    set_payload: tuple[float, float, float, float]
    gravity: tuple[float, float, float]

    @property
    def setting(self) -> tuple[float, tuple[float, float, float]]:
        """Mass in kg and centre of gravity in m, for `Robot.set_payload`.

        Raises:
            BadValue: If the centre is unknown, because the mass might be zero.
        """
        unknown = [axis for axis, each in zip("xyz", self.cog, strict=True) if not each.is_known]
        if unknown:
            raise BadValue(
                f"the centre of gravity ({', '.join(unknown)}) is unknown, because the measured mass "
                f"({self.mass.low:.3g} to {self.mass.high:.3g} kg) might be 0; pass mass and cog yourself"
            )
        x, y, z = (each.value for each in self.cog)
        return max(self.mass.value, 0.0), (x, y, z)

    def __str__(self) -> str:
        cog = ", ".join(_shown(each, 1000.0) for each in self.cog)
        return f"{_shown(self.mass)} kg, centre {cog} mm ({self.source}, {self.postures} postures)"


def _shown(estimate: Estimate, scale: float = 1.0) -> str:
    if not estimate.is_known:
        return "unknown"
    half = (estimate.high - estimate.low) / 2.0
    return f"{scale * estimate.value:.3f} ± {scale * half:.3f}"


@dataclass(frozen=True)
class Rest:
    """Mean of the states of one rest.

    Attributes:
        time: Time of the controller in the middle of the rest, in s.
        q: Joint positions, shape (6,), in rad.
        wrench: Wrench at the TCP as the controller reports it, shape (6,), in N and Nm along the axes of the base.
        unset_currents: Target current minus actual current of each joint, shape (6,), in A.
    """

    time: float
    q: FloatArray
    wrench: FloatArray
    unset_currents: FloatArray


def gravity_in(arm: Arm, q: ArrayLike, gravity: ArrayLike = UPRIGHT) -> FloatArray:
    """Return the direction of gravity in the frame of the flange.

    Args:
        arm: Arm.
        q: Joint positions, shape (n, 6), in rad.
        gravity: See `MeasuredPayload`.

    Returns:
        Gravitational acceleration, shape (n, 3), in m/s².
    """
    turns = rotvec_to_matrix(arm.forward(q)[..., 3:])
    found: FloatArray = np.einsum("nij,i->nj", turns, -np.asarray(gravity, dtype=np.float64))
    return found


def information(down: FloatArray) -> float:
    """Return how well postures determine a payload, as the logarithm of a volume. More is better.

    Args:
        down: Gravity in the frame of the flange in each posture, shape (n, 3), in m/s².
    """
    away = down / GRAVITY - (down / GRAVITY).mean(axis=0)
    return float(np.linalg.slogdet(away.T @ away + 1e-3 * np.eye(3))[1])


def check_turned(down: FloatArray) -> None:
    """Check that postures can determine a payload, by the direction of gravity in the frame of the flange.

    Args:
        down: Gravity in the frame of the flange in each posture, shape (n, 3), in m/s².

    Raises:
        BadValue: If they cannot. The message names the quantity, and postures that would help.
    """
    unit = down / np.linalg.norm(down, axis=1, keepdims=True)
    away = unit - unit.mean(axis=0)
    sizes, axes = np.linalg.eigh(away.T @ away / len(away))
    if sizes.sum() < _TURNED:
        raise BadValue(
            "the postures do not determine the mass, because gravity has almost the same direction in the tool; "
            "add postures that tilt the tool by 30 degrees or more with wrist 1 or wrist 2"
        )
    if sizes[0] + sizes[1] < _TURNED / 3.0:
        along = "xyz"[int(np.abs(axes[:, 2]).argmax())]
        other = "wrist 3, with the tool horizontal" if along == "z" else "another wrist, for example wrist 3"
        raise BadValue(
            f"the postures do not determine the centre of gravity along {along} of the flange, because the tool turned "
            f"about only one axis; add postures that turn {other}"
        )


def fit_sensor(
    arm: Arm, rests: Sequence[Rest], tcp: ArrayLike, set_payload: Sequence[float], gravity: Sequence[float] = UPRIGHT
) -> MeasuredPayload:
    """Fit a payload and the offset of the force sensor to rests.

    Args:
        arm: Arm, with its calibration if it is known.
        rests: Rests in the order of time.
        tcp: TCP in the frame of the flange, shape (6,), in m and rad.
        set_payload: Mass in kg and centre in m, four numbers, that are set on the controller.
        gravity: See `MeasuredPayload`.

    Raises:
        BadValue: If the postures do not determine the payload. The message names the quantity, and postures that help.
    """
    poses = arm.forward(np.array([each.q for each in rests]))
    turns = rotvec_to_matrix(poses[:, 3:])
    down = gravity_in(arm, np.array([each.q for each in rests]), gravity)
    check_turned(down)
    wrench = np.array([each.wrench for each in rests])
    force = np.einsum("nij,ni->nj", turns, wrench[:, :3])
    torque = np.einsum("nij,ni->nj", turns, wrench[:, 3:]) + np.cross(np.asarray(tcp)[:3], force)
    # The load of the previous rest. The load before the first rest is unknown, so the sensor counts as settled.
    before = np.concatenate((down[:1], down[:-1]))
    time = np.array([each.time for each in rests])
    late = (time - time[-1]) / max(time[-1] - time[0], 1e-9)
    own = np.tile(np.eye(3), (len(rests), 1, 1))
    drift = own * late[:, np.newaxis, np.newaxis]
    forces = _Fit(np.concatenate((own, drift, down[:, :, np.newaxis], before[:, :, np.newaxis]), axis=2), force)
    moments = _Fit(np.concatenate((own, drift, -cross_matrices(down), -cross_matrices(before)), axis=2), torque)
    of_mass = np.zeros((1, 8))
    of_mass[0, 6:] = 1.0
    of_moment = np.hstack((np.zeros((3, 6)), np.eye(3), np.eye(3)))
    unset = np.concatenate((of_mass @ forces.factors, of_moment @ moments.factors))
    mass_shape = of_mass @ forces.shape @ of_mass.T
    moment_shape = of_moment @ moments.shape @ of_moment.T
    _check_strong(float(mass_shape[0, 0]), np.diag(moment_shape))
    covariance = np.zeros((4, 4))
    covariance[:1, :1] = mass_shape * forces.variance
    covariance[1:, 1:] = moment_shape * moments.variance
    offsets = [
        _within(float(fitted.factors[axis]), float(fitted.shape[axis, axis] * fitted.variance), fitted.free)
        for fitted in (forces, moments)
        for axis in range(3)
    ]
    wander = float(np.sqrt(forces.variance)), float(np.sqrt(moments.variance))
    free = forces.free, moments.free
    return _measured(unset, covariance, free, set_payload, offsets, "sensor", len(rests), wander, gravity)


def fit_currents(
    arm: Arm, rests: Sequence[Rest], set_payload: Sequence[float], gravity: Sequence[float] = UPRIGHT
) -> MeasuredPayload:
    """Fit a payload to the currents of the joints at rest. The arguments are the same as those of `fit_sensor`.

    Raises:
        BadValue: See `fit_sensor`.
    """
    q = np.array([each.q for each in rests])
    check_turned(gravity_in(arm, q, gravity))
    turns, jacobians = rotvec_to_matrix(arm.forward(q)[:, 3:]), arm.jacobian(q)
    motors = motors_of(arm.model)
    constants = np.array(motors.torque_constants)
    friction = constants * np.array(motors.coulomb)
    # Joint torques of a weight at the flange: the force turns the joints, and so does its moment about the flange.
    down = -np.asarray(gravity, dtype=np.float64)
    of_mass = np.einsum("nij,i->nj", jacobians[:, :3], down)
    levers = np.cross(np.moveaxis(turns, 2, 1), down)
    of_moment = np.einsum("nij,nki->njk", jacobians[:, 3:], levers)
    # A joint that stays at its position keeps its friction, so each joint has its own constant error.
    own = np.tile(np.eye(6), (len(rests), 1, 1))
    columns = np.concatenate((own, of_mass[:, :, np.newaxis], of_moment), axis=2)
    torque = constants * np.array([each.unset_currents for each in rests])
    scaled, values = columns / friction[:, np.newaxis], torque / friction
    fitted = _Fit(scaled, values)
    _check_strong(float(fitted.shape[6, 6]) / 100.0, np.diag(fitted.shape)[7:] / 100.0)
    # Joints that move have another friction after each motion. So the group with the larger deviations counts.
    squares = fitted.deviations(scaled, values).reshape(-1, 2, 3).transpose(1, 0, 2).reshape(2, -1) ** 2
    free = max(fitted.free // 2, 1)
    variance = float(squares.sum(axis=1).max()) / free
    covariance = fitted.shape * variance
    for joint in range(6):
        wrong = np.zeros_like(values)
        wrong[:, joint] = _CONSTANTS * values[:, joint]
        change = fitted.shape @ scaled.reshape(-1, 10).T @ wrong.ravel()
        covariance = covariance + np.outer(change, change)
    wander = float(np.sqrt(variance)) * float(friction.mean())
    nothing = [Estimate.unknown("a force sensor in the wrist")] * 6
    unset = fitted.factors[6:]
    return _measured(
        unset,
        covariance[6:, 6:],
        (free, free),
        set_payload,
        nothing,
        "currents",
        len(rests),
        (wander, wander),
        gravity,
    )


class _Fit:
    """Least squares fit of three or six numbers of each rest; columns have the shape (n, numbers, k).

    Attributes:
        factors: Factors of the columns, shape (k,).
        shape: Covariance of the factors for a variance of 1, shape (k, k).
        free: Degrees of freedom.
        variance: Variance of the deviations.
    """

    def __init__(self, columns: FloatArray, measured: FloatArray) -> None:
        rows, values = columns.reshape(-1, columns.shape[2]), measured.ravel()
        self.shape: FloatArray = np.asarray(np.linalg.pinv(rows.T @ rows, rcond=1e-12, hermitian=True), np.float64)
        self.factors: FloatArray = self.shape @ rows.T @ values
        self.free = max(len(values) - int(np.linalg.matrix_rank(rows)), 1)
        self.variance = float((self.deviations(columns, measured) ** 2).sum()) / self.free

    def deviations(self, columns: FloatArray, measured: FloatArray) -> FloatArray:
        """Return the deviations of the measured numbers from the fit, in the shape of `measured`."""
        found: FloatArray = measured - columns @ self.factors
        return found


def _check_strong(mass: float, moments: FloatArray) -> None:
    if mass > _WEAK**2:
        raise BadValue(
            "the postures do not determine the mass, because drift and hysteresis would explain the readings as well; "
            "add postures that tilt the tool by 60 degrees or more, in a changing order"
        )
    axis = int(moments.argmax())
    if moments[axis] > _WEAK**2:
        raise BadValue(
            f"the postures do not determine the centre of gravity along {'xyz'[axis]} of the flange; add postures that "
            "turn wrist 3 by 90 degrees while the tool is horizontal"
        )


def _measured(
    unset: FloatArray,
    covariance: FloatArray,
    free: tuple[int, int],
    set_payload: Sequence[float],
    offsets: Sequence[Estimate],
    source: SourceName,
    postures: int,
    wander: tuple[float, float],
    gravity: Sequence[float],
) -> MeasuredPayload:
    """Add the payload that the controller knows. `unset` is a mass and three first moments, which add up."""
    known, *centre = (float(each) for each in set_payload)
    total = unset + known * np.array((1.0, *centre))
    mass = _within(float(total[0]), float(covariance[0, 0]), free[0])
    if mass.high < 0.0:
        raise BadValue(
            f"the measured mass is {mass.value:.3g} kg; check the payload that is set on the controller, and the "
            "direction of gravity"
        )
    x, y, z = (_ratio(total, covariance, axis, min(free)) for axis in (1, 2, 3))
    cx, cy, cz = centre
    up = tuple(float(each) for each in gravity)
    return MeasuredPayload(
        mass, (x, y, z), tuple(offsets), source, postures, wander, (known, cx, cy, cz), (up[0], up[1], up[2])
    )


def _within(value: float, variance: float, free: int) -> Estimate:
    half = _student(free) * float(np.sqrt(variance))
    return Estimate(value, value - half, value + half)


def _ratio(total: FloatArray, covariance: FloatArray, axis: int, free: int) -> Estimate:
    """Return a first moment divided by the mass, with the interval of Fieller (1954)."""
    mass, moment = float(total[0]), float(total[axis])
    k2 = _student(free) ** 2
    a = mass**2 - k2 * float(covariance[0, 0])
    b = mass * moment - k2 * float(covariance[0, axis])
    c = moment**2 - k2 * float(covariance[axis, axis])
    if mass <= 0.0 or a <= 0.0:
        return Estimate.unknown("a mass that is certainly not 0")
    half = float(np.sqrt(max(b * b - a * c, 0.0)))
    return Estimate(moment / mass, (b - half) / a, (b + half) / a)


def _student(free: int) -> float:
    # The quantiles are nearly linear in the inverse of the degrees of freedom.
    return float(np.interp(1.0 / free, 1.0 / _FREE[::-1], _STUDENT[::-1]))


def cross_matrices(vectors: FloatArray) -> FloatArray:
    """Return the matrices of the cross products with vectors, shape (n, 3, 3)."""
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    return np.moveaxis(np.array(((zero, -z, y), (z, zero, -x), (-y, x, zero))), 2, 0)


def check_set_payload(values: Sequence[float]) -> tuple[float, float, float, float]:
    """Check a mass in kg and a centre in m, four numbers.

    Raises:
        BadValue: If `values` are not four finite numbers, or the mass is negative.
    """
    mass, x, y, z = floats(values, 4, "a set payload (mass and centre)")
    if mass < 0.0:
        raise BadValue(f"the mass of set_payload is {mass:g} kg; expected 0 or more")
    return float(mass), float(x), float(y), float(z)

"""Fit of payload, rotors, torque constants and friction to the moments and currents of a controller.

The moment of a joint is linear in the inertia of its rotor, and in the mass and the first moments of mass of the
payload. The current of a joint is linear in the moment and in the two friction parameters. Therefore moments and
currents are fitted by least squares. The order is that of the controller, which first computes the moments, and then
the currents from the moments.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from urlink.arm.models import Model
from urlink.tools import FULL_SPEED, JOINTS, Dynamics, Estimate, FloatArray, motors_of

from .intervals import Fit, blocks_of, fit, within

#: Minimum acceleration of a joint, in rad/s², with which its rotor inertia can be found.
_ACCELERATION = 0.3
#: Minimum speed of a joint, in rad/s, with which the growth of its friction can be found.
_SPEED = 0.1
#: Minimum variation of the moment of a joint, in Nm, with which its torque constant can be found.
_MOMENT = 0.05
#: Largest uncertainty of the mass of a payload, in kg. If the uncertainty is larger, the payload counts as unknown.
_MASS = 0.5


@dataclass(frozen=True)
class JointFit:
    """Result of the fit to moments and currents.

    Attributes:
        payload: Mass of the payload, in kg.
        payload_cog: Centre of gravity of the payload in the flange frame, shape (3,), in m.
        rotor_inertias: Rotor inertias of the six joints, in kg m².
        torque_constants: Torque constants of the six joints, in Nm/A.
        coulomb: Coulomb friction of the six joints, in A.
        viscous: Viscous friction of the six joints, in A s/rad.
        torque_r2: Fraction of the variance of the torques that the fit explains, in these rows, shape (6,). The fit
            uses the values of the model for unknown numbers.
        current_r2: Fraction of the variance of the currents that the fit explains, shape (6,).
    """

    payload: Estimate
    payload_cog: tuple[Estimate, ...]
    rotor_inertias: tuple[Estimate, ...]
    torque_constants: tuple[Estimate, ...]
    coulomb: tuple[Estimate, ...]
    viscous: tuple[Estimate, ...]
    torque_r2: tuple[float, ...]
    current_r2: tuple[float, ...]


def fit_joints(model: Model, columns: Mapping[str, FloatArray]) -> JointFit:
    """Fit payload, rotors, torque constants and friction to moments and currents.

    Args:
        model: Model of the arm.
        columns: Columns by their RTDE names, shape (n, 6) each: target_q, target_qd, target_qdd, target_moment and
            target_current. Instead of target_current, actual_current can be used. Without target_moment, the moments
            are those of the model with the columns payload and payload_cog, if they exist, and with its rotors.
    """
    blocks = blocks_of(np.asarray(~columns["target_qd"].any(axis=1)))
    q, qd, qdd = (columns[f"target_{name}"] for name in ("q", "qd", "qdd"))
    motors = motors_of(model)
    if "target_moment" in columns:
        moments = columns["target_moment"]
        payload, cog, rotors, modelled = _fit_moments(model, q, qd, qdd, moments, blocks)
        torque_r2 = tuple(_r2(moments[:, i], modelled[:, i]) for i in range(6))
    else:
        needed = Estimate.unknown("target_moment in the recording")
        payload, cog, rotors, torque_r2 = needed, (needed,) * 3, (needed,) * 6, (np.nan,) * 6
        mass = float(np.median(columns["payload"])) if "payload" in columns else 0.0
        at = np.median(columns["payload_cog"], axis=0) if "payload_cog" in columns else np.zeros(3)
        carried = Dynamics(model, payload=mass, payload_cog=at, rotors=motors.rotor_inertias)
        modelled = carried.torque(q, qd, qdd)
    currents = columns.get("target_current", columns.get("actual_current"))
    if currents is None:
        unknown = (Estimate.unknown("target_current or actual_current in the recording"),) * 6
        return JointFit(payload, cog, rotors, unknown, unknown, unknown, torque_r2, (np.nan,) * 6)
    # Use the actual current only in rows with motion, because stiction hides the friction of a joint at rest.
    rows = np.ones(len(q), dtype=bool) if "target_current" in columns else (np.abs(qd) > FULL_SPEED).any(axis=1)
    found = [
        _fit_current(joint, modelled[rows, i], qd[rows, i], currents[rows, i], motors.torque_constants[i], blocks[rows])
        for i, joint in enumerate(JOINTS)
    ]
    constants, coulomb, viscous = (tuple(each[part] for each in found) for part in range(3))
    explained = (
        modelled[rows] / _or(constants, motors.torque_constants)
        + _or(coulomb, motors.coulomb) * _saturated(qd[rows])
        + _or(viscous, motors.viscous) * qd[rows]
    )
    current_r2 = tuple(_r2(currents[rows, i], explained[:, i]) for i in range(6))
    return JointFit(payload, cog, rotors, constants, coulomb, viscous, torque_r2, current_r2)


def _fit_moments(
    model: Model, q: FloatArray, qd: FloatArray, qdd: FloatArray, moments: FloatArray, blocks: NDArray[np.int_]
) -> tuple[Estimate, tuple[Estimate, ...], tuple[Estimate, ...], FloatArray]:
    def with_kg(at: FloatArray) -> FloatArray:
        return Dynamics(model, payload=1.0, payload_cog=at).torque(q, qd, qdd)

    bare = Dynamics(model).torque(q, qd, qdd)
    # Moments per kg at the flange, and per kg m along each axis of the flange. The terms of second order in the
    # distance are not included here. These terms are the inertia of the payload about the flange.
    at_flange = with_kg(np.zeros(3)) - bare
    step = 1e-3
    per_way = [(with_kg(step * axis) - with_kg(-step * axis)) / (2.0 * step) for axis in np.eye(3)]
    moved = np.abs(qdd).max(axis=0) >= _ACCELERATION
    shared = np.stack([at_flange, *per_way], axis=-1)
    rotor_columns = qdd[:, :, np.newaxis] * np.eye(6)
    # A joint that hardly accelerates has the published rotor.
    factors = np.concatenate((np.zeros(4), np.where(moved, 0.0, motors_of(model).rotor_inertias)))
    resting = rotor_columns @ factors[4:]
    modelled = bare
    weight = np.ones(6)
    known = np.concatenate((np.ones(4, dtype=bool), moved))
    last = Fit(factors, factors[np.newaxis], 1, np.ones(10, dtype=bool))
    second = np.zeros_like(bare)
    for _ in range(4):
        whole = np.concatenate((shared, rotor_columns), axis=-1)[:, :, known] * weight[:, np.newaxis]
        wanted = (moments - bare - resting - second) * weight
        last = fit(whole.reshape(-1, int(known.sum())), wanted.ravel(), np.repeat(blocks, 6))
        factors[known] = last.factors
        mass, first = factors[0], factors[1:4]
        cog = first / mass if mass > 1e-3 else np.zeros(3)
        fitted = Dynamics(model, payload=max(mass, 0.0), payload_cog=cog, rotors=np.maximum(factors[4:], 0.0))
        modelled = fitted.torque(q, qd, qdd)
        # Terms of second order in the distance of the mass, from the previous fit.
        linear = bare + shared @ factors[:4] + rotor_columns @ factors[4:]
        second = modelled - linear
        deviation = np.sqrt(np.mean((moments - modelled) ** 2, axis=0))
        weight = 1.0 / np.maximum(deviation, max(deviation.max() * 1e-3, 1e-12))
    payload = last.estimate(0)
    centre: tuple[Estimate, ...]
    if not payload.is_known or payload.high - payload.value > _MASS:
        needs = "postures in which the weight of the tool turns the wrists differently"
        payload, centre = Estimate.unknown(needs), (Estimate.unknown(needs),) * 3
    elif factors[0] < 0.05:
        centre = (Estimate.unknown("a payload"),) * 3
    else:
        masses = np.maximum(last.halves[:, 0], 1e-3)
        centre = tuple(
            within(factors[axis] / factors[0], last.halves[:, axis] / masses, last.blocks) for axis in (1, 2, 3)
        )
    numbers = np.cumsum(known) - 1
    rotors = tuple(
        last.estimate(numbers[4 + i])
        if moved[i]
        else Estimate.unknown(f"{joint} to accelerate by {_ACCELERATION} rad/s² or more")
        for i, joint in enumerate(JOINTS)
    )
    return payload, centre, rotors, modelled


def _fit_current(
    joint: str, torque: FloatArray, qd: FloatArray, current: FloatArray, constant: float, blocks: NDArray[np.int_]
) -> tuple[Estimate, Estimate, Estimate]:
    """Fit the torque constant, Coulomb friction and viscous friction of one joint."""
    rubs, speeds_up, varies = np.abs(qd).max() > 2.0 * FULL_SPEED, np.abs(qd).max() > _SPEED, np.ptp(torque) > _MOMENT
    every = np.column_stack((torque, _saturated(qd), qd))
    known = np.array([varies, rubs, speeds_up])
    estimates = [
        Estimate.unknown(f"{joint} under moments that vary by {_MOMENT} Nm or more"),
        Estimate.unknown(f"{joint} to turn faster than {2.0 * FULL_SPEED} rad/s both ways"),
        Estimate.unknown(f"{joint} to turn faster than {_SPEED} rad/s"),
    ]
    if not known.any():
        return estimates[0], estimates[1], estimates[2]
    # If the moment hardly varies, use the known torque constant.
    found = fit(every[:, known], current if varies else current - torque / constant, blocks)
    for number, place in enumerate(np.flatnonzero(known)):
        estimates[place] = found.estimate(number)
    return of_ratio(estimates[0]), estimates[1], estimates[2]


def _or(known: tuple[Estimate, ...], otherwise: tuple[float, ...]) -> FloatArray:
    return np.array([a.value if a.is_known else b for a, b in zip(known, otherwise, strict=True)])


def _saturated(qd: FloatArray) -> FloatArray:
    return np.clip(qd / FULL_SPEED, -1.0, 1.0)


def _r2(measured: FloatArray, modelled: FloatArray) -> float:
    # Rounding is not a variation.
    if np.ptp(measured) <= 1e-6:
        return float("nan")
    total = float(((measured - measured.mean()) ** 2).sum())
    return 1.0 - float(((measured - modelled) ** 2).sum()) / total


def of_ratio(estimate: Estimate) -> Estimate:
    """Return the estimate of the inverse of a number, with its interval."""
    if not estimate.is_known or estimate.low * estimate.high <= 0.0:
        return Estimate.unknown(estimate.needs or "more motion")
    return Estimate(1.0 / estimate.value, 1.0 / estimate.high, 1.0 / estimate.low)

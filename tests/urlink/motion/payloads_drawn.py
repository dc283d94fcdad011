"""Draw tools and errors of real force sensors, measure their payloads, and count how often the intervals hold.

python -m tests.urlink.motion.payloads_drawn --runs 200 --seed 45

The errors are those of real logs: a sensor that was never zeroed shows up to 78 N, fixed in the tool. Its reading
wanders by 0.5 to 1.5 N rms between rests, with noise of 0.07 to 0.24 N and 0.002 to 0.006 Nm in each state. The wander
of the torque is assumed to be a tenth of that of the force, in Nm. Drift (up to 2 N in a measurement) and hysteresis
(up to 1.5 % of the change of the load) are assumed, because no log shows them alone.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from urlink.arm.arm_file import Estimate
from urlink.arm.kinematics import Arm
from urlink.arm.payload import MeasuredPayload, Rest, fit_sensor, gravity_in
from urlink.arm.poses import rotvec_to_matrix
from urlink.arm.vectors import FloatArray
from urlink.motion.payload_measurement import WristLimits, plan

#: Number of states of one rest, and time from rest to rest, in s.
STATES, PERIOD = 500, 5.0
START = np.array([0.3, -1.3, 1.6, -1.87, -1.57, 0.4])


@dataclass(frozen=True)
class SensorErrors:
    """Errors of a force sensor, in the frame of the flange.

    Attributes:
        offset: Offset, shape (6,), in N and Nm.
        drift: Change of the offset during the measurement, shape (6,).
        wander: Standard deviation between rests, in N and Nm.
        noise: Standard deviation between states, in N and Nm.
        hysteresis: Share of the load of the previous rest that a reading keeps.
    """

    offset: FloatArray
    drift: FloatArray
    wander: tuple[float, float]
    noise: tuple[float, float]
    hysteresis: float


def drawn_errors(rng: np.random.Generator) -> SensorErrors:
    wander = rng.uniform(0.5, 1.5)
    return SensorErrors(
        rng.normal(size=6) * ([30.0] * 3 + [1.0] * 3),
        rng.uniform(-1.0, 1.0, 6) * ([2.0] * 3 + [0.1] * 3),
        (wander, 0.1 * wander),
        (rng.uniform(0.07, 0.24), rng.uniform(0.002, 0.006)),
        rng.uniform(0.0, 0.015),
    )


def planted(
    arm: Arm,
    postures: list[FloatArray],
    tcp: FloatArray,
    unset: tuple[float, FloatArray],
    errors: SensorErrors,
    rng: np.random.Generator,
) -> list[Rest]:
    """Return the rests that a controller shows.

    Args:
        arm: Arm.
        postures: Joint positions, each of shape (6,).
        tcp: TCP in the frame of the flange.
        unset: Mass in kg and first moment in kg m, shape (3,), that the controller does not know.
        errors: Errors of the sensor.
        rng: Source of random numbers.
    """
    mass, moment = unset
    down = gravity_in(arm, np.array(postures))
    load = np.hstack((mass * down, np.cross(moment, down)))
    # The load before the first rest: the arm came from another posture.
    before = np.vstack((load[int(rng.integers(len(load)))], load[:-1]))
    late = np.linspace(0.0, 1.0, len(load))[:, np.newaxis]
    scale = np.repeat(errors.wander, 3) + 0.0
    noise = np.repeat(errors.noise, 3) / np.sqrt(STATES)
    shown = (
        (1.0 - errors.hysteresis) * load
        + errors.hysteresis * before
        + errors.offset
        + late * errors.drift
        + rng.normal(size=load.shape) * np.hypot(scale, noise)
    )
    rests = []
    for i, (q, wrench) in enumerate(zip(postures, shown, strict=True)):
        turn = rotvec_to_matrix(arm.forward(q)[3:])
        force, torque = turn @ wrench[:3], turn @ (wrench[3:] - np.cross(tcp[:3], wrench[:3]))
        rests.append(Rest(PERIOD * i, q, np.concatenate((force, torque)), np.zeros(6)))
    return rests


def measured(seed: int, run: int, postures: int) -> tuple[MeasuredPayload, FloatArray]:
    """Measure one drawn tool; return the result, and its true mass and centre, shape (4,)."""
    rng = np.random.default_rng((seed, run))
    arm = Arm("UR5e")
    mass, centre = rng.uniform(0.5, 5.0), rng.uniform((-0.05, -0.05, 0.0), (0.05, 0.05, 0.15))
    known = (rng.uniform(0.0, 3.0), 0.0, 0.0, 0.05) if rng.random() < 0.5 else (0.0, 0.0, 0.0, 0.0)
    tcp = np.array([0.0, 0.0, rng.uniform(0.0, 0.2), 0.0, 0.0, rng.uniform(-1.0, 1.0)])
    limits = WristLimits(START, np.full(3, rng.uniform(0.8, 1.6)), np.full(3, -np.inf), np.full(3, np.inf), tcp)
    unset = mass - known[0], mass * centre - known[0] * np.array(known[1:])
    rests = planted(arm, plan(arm, limits, postures), tcp, unset, drawn_errors(rng), rng)
    return fit_sensor(arm, rests, tcp, known), np.array([mass, *centre])


def exact_payload(mass: float, centre: Sequence[float], offset: Sequence[float] = (0.0,) * 6) -> MeasuredPayload:
    """Return a payload as if it was measured without errors."""

    def exact(value: float) -> Estimate:
        return Estimate(value, value, value)

    x, y, z = map(exact, centre)
    none = (0.0, 0.0, 0.0, 0.0)
    return MeasuredPayload(
        exact(mass), (x, y, z), tuple(map(exact, offset)), "sensor", 6, (0.0, 0.0), none, (0.0, 0.0, 9.82)
    )


@dataclass(frozen=True)
class Outcome:
    """Result of many measurements.

    Attributes:
        runs: Number of measurements.
        together: Number of measurements in which mass and centre are in their intervals.
        each: The same for mass, x, y and z alone.
        widths: Median half widths of the intervals of the mass in kg, and of the centre in m, four numbers.
        wander: Median of the found wander, in N and Nm.
        unknown: Number of measurements with an unknown centre.
    """

    runs: int
    together: int
    each: tuple[int, ...]
    widths: tuple[float, ...]
    wander: tuple[float, float]
    unknown: int


def draw(runs: int, seed: int, postures: int) -> Outcome:
    held, widths, wander, unknown = [], [], [], 0
    for run in range(runs):
        found, truth = measured(seed, run, postures)
        estimates = (found.mass, *found.cog)
        unknown += not all(each.is_known for each in estimates)
        held.append([not e.is_known or e.low <= t <= e.high for e, t in zip(estimates, truth, strict=True)])
        widths.append([(e.high - e.low) / 2.0 for e in estimates])
        wander.append(found.wander)
    table = np.array(held)
    found_wander = np.median(wander, axis=0)
    return Outcome(
        runs,
        int(table.all(axis=1).sum()),
        tuple(table.sum(axis=0).tolist()),
        tuple(np.nanmedian(widths, axis=0).tolist()),
        (float(found_wander[0]), float(found_wander[1])),
        unknown,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--seed", type=int, default=45)
    options = parser.parse_args()
    for postures in (6, 8, 10):
        found = draw(options.runs, options.seed, postures)
        mass, *centre = found.widths
        print(
            f"{postures} postures: {found.together} of {found.runs} hold together, alone {found.each}; half widths "
            f"{mass:.3f} kg, {', '.join(f'{1000 * each:.1f}' for each in centre)} mm; "
            f"wander {found.wander[0]:.2f} N, {found.wander[1]:.3f} Nm; centre unknown in {found.unknown}"
        )


if __name__ == "__main__":
    main()

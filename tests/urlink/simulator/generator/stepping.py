"""Functions that run a generator until a motion ends, and checks that every motion must pass."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from urlink.arm.kinematics import Arm
from urlink.arm.models import MODELS, Model
from urlink.simulator.robot.generator import Command, MotionGenerator
from urlink.simulator.robot.setpoint_sources import HOME, Setpoint

CYCLE = 0.002
UR5E = MODELS["UR5e"]
REST = [0.0] * 6

Array = NDArray[np.float64]


def standing(q: Sequence[float] = HOME, arm: Model = UR5E) -> MotionGenerator:
    return MotionGenerator(Arm(arm), Setpoint(list(q), REST, REST))


def cycles(generator: MotionGenerator, count: int, cycle: float = CYCLE) -> list[Setpoint]:
    return [generator.advance(cycle) for _ in range(count)]


def finish(generator: MotionGenerator, move: Command, cycle: float = CYCLE, at_most: float = 60.0) -> list[Setpoint]:
    """Return the set-points until the motion ends."""
    setpoints = []
    while not move.is_over:
        setpoints.append(generator.advance(cycle))
        assert len(setpoints) * cycle < at_most, "the motion does not end"
    return setpoints


def to_rest(generator: MotionGenerator, cycle: float = CYCLE, at_most: float = 60.0) -> list[Setpoint]:
    """Return the set-points until the arm is at rest."""
    setpoints = []
    while not generator.is_standing:
        setpoints.append(generator.advance(cycle))
        assert len(setpoints) * cycle < at_most, "the arm does not come to rest"
    return setpoints


def positions(setpoints: Sequence[Setpoint]) -> Array:
    return np.array([setpoint.q for setpoint in setpoints])


def speeds(setpoints: Sequence[Setpoint]) -> Array:
    return np.array([setpoint.qd for setpoint in setpoints])


def check_continuous(before: Setpoint, setpoints: Sequence[Setpoint], hardest: Array, cycle: float = CYCLE) -> None:
    """Check that speeds change by at most `hardest` rad/s² over a cycle, and that positions match the speeds."""
    q, qd = positions([before, *setpoints]), speeds([before, *setpoints])
    assert np.isfinite(q).all()
    assert np.isfinite(qd).all()
    assert (np.abs(np.diff(qd, axis=0)) <= hardest * cycle * (1 + 1e-6) + 1e-9).all()
    drift = np.diff(q, axis=0) - 0.5 * cycle * (qd[1:] + qd[:-1])
    assert (np.abs(drift) <= 0.5 * hardest * cycle**2 * (1 + 1e-6) + 1e-9).all()


def trapezoid(length: float, speed: float, acceleration: float) -> float:
    """Return the duration from rest to rest, in s."""
    if length * acceleration < speed * speed:
        return 2.0 * math.sqrt(length / acceleration)
    return length / speed + speed / acceleration

"""Recordings of arms with known, planted parameters."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path

import numpy as np

from tests.urlink.arm.arms import calibrated
from urlink.arm.arm_file import ArmFile, Estimate
from urlink.arm.dynamics import Dynamics
from urlink.arm.kinematics import DhTable
from urlink.arm.models import MODELS
from urlink.arm.motors import Motors
from urlink.arm.vectors import FloatArray
from urlink.simulator import Controller, Still
from urlink_accept.identification.samples import Samples

MODEL = MODELS["UR5e"]
PAYLOAD, COG = 1.8, (0.01, -0.02, 0.06)
MOTORS = Motors(
    (1.7, 1.9, 1.75, 0.19, 0.22, 0.2),
    (10.4, 9.6, 10.1, 8.1, 7.5, 7.9),
    (0.8, 0.65, 0.7, 0.25, 0.2, 0.22),
    (1.1, 0.9, 1.0, 0.2, 0.25, 0.23),
)


def motion(seconds: float = 10.0, rate: float = 100.0) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return times, positions, speeds and accelerations of two sine waves in each joint."""
    t = np.arange(0.0, seconds, 1.0 / rate)
    q, qd, qdd = (np.zeros((len(t), 6)) for _ in range(3))
    home = (0.3, -1.4, 1.6, -1.2, -1.5, 0.4)
    for joint in range(6):
        q[:, joint] = home[joint]
        for wave, size in ((1 + joint % 3, 0.5), (3 + joint, 0.12)):
            omega = math.tau * wave / seconds
            phase = 0.7 * joint + wave
            q[:, joint] += size * np.sin(omega * t + phase)
            qd[:, joint] += size * omega * np.cos(omega * t + phase)
            qdd[:, joint] -= size * omega**2 * np.sin(omega * t + phase)
    return t, q, qd, qdd


@cache
def clean(rate: float) -> Mapping[str, FloatArray]:
    """Return 10 s of this motion, as the controller calculates it."""
    t, q, qd, qdd = motion(rate=rate)
    torque = Dynamics(MODEL, payload=PAYLOAD, payload_cog=COG, rotors=MOTORS.rotor_inertias).torque(q, qd, qdd)
    current = np.array([MOTORS.current(a, b) for a, b in zip(torque.tolist(), qd.tolist(), strict=True)])
    named = {"target_q": q, "target_qd": qd, "target_qdd": qdd, "target_moment": torque, "target_current": current}
    return {"timestamp": t, **named}


def columns(rng: np.random.Generator, rate: float = 100.0) -> dict[str, FloatArray]:
    """Return the same with noise of 0.1 Nm and 0.1 A."""
    found = dict(clean(rate))
    for name in ("target_moment", "target_current"):
        found[name] = found[name] + 0.1 * rng.standard_normal(found[name].shape)
    return found


#: Postures between which every joint turns by at least 0.5 rad, and the weight of the tool acts in many directions.
POSTURES = (
    (0.0, -1.5, 1.9, -2.0, -1.5, 0.0),
    (0.9, -1.1, 1.2, -1.0, -0.6, 0.9),
    (-0.5, -1.8, 2.1, -2.6, -2.2, -0.8),
    (0.4, -0.9, 0.8, -1.6, -1.1, 0.6),
    (-0.2, -2.0, 1.5, -0.9, -1.9, -0.3),
)
COLUMNS = {
    "target_q": "q_target",
    "target_qd": "qd_target",
    "target_qdd": "qdd_target",
    "target_moment": "M_target",
    "target_current": "I_target",
    "joint_control_output": "I_control",
    "actual_current": "I_actual",
    "actual_q": "q_actual",
    "target_TCP_pose": "pose_target",
    "actual_TCP_force": "force",
}
#: Further differences from the published arm, in addition to motors and payload.
OTHERS = {
    "tracking_lag": 0.004,
    "start_rate": 5.0,
    "position_noise": 4e-5,
    "current_noise": 0.05,
    "force_noise": 0.3,
}


#: All planted parameters, by their names in the file of an arm.
OWN: dict[str, Sequence[float]] = {
    "rotor_inertia": MOTORS.rotor_inertias,
    "torque_constant": MOTORS.torque_constants,
    "coulomb_current": MOTORS.coulomb,
    "viscous_current": MOTORS.viscous,
    "payload": (PAYLOAD,),
    "payload_cog": COG,
    **{name: (value,) for name, value in OTHERS.items()},
}


def exactly(values: Sequence[float]) -> tuple[Estimate, ...]:
    """Return estimates without uncertainty."""
    return tuple(Estimate(value, value, value) for value in values)


def planted(seed: int = 4, **values: Sequence[float]) -> ArmFile:
    """Return an arm that differs from the published arm in every parameter that can be planted.

    Args:
        seed: Seed of its calibration.
        values: Values that replace those of `OWN`, by their names in the file.
    """
    table = calibrated("UR5e", seed).table
    columns = [np.asarray(column).tolist() for column in (table.dh_theta, table.dh_a, table.dh_d, table.dh_alpha)]
    named = {name: exactly(each) for name, each in (OWN | values).items()}
    return ArmFile("UR5e", named, DhTable(*columns), (0.0, 0.01, 0.12, 0.0, 0.0, 0.0))


def recorded(like: ArmFile, seed: int = 0, every: int = 4) -> Samples:
    """Record about 10 s of an arm, with one program for each motion.

    The calculated values of the controller have no noise.

    Args:
        like: File of the arm.
        seed: Seed of the noise of its sensors.
        every: Number of cycles of 2 ms between two rows; 4 cycles are 125 Hz.
    """
    controller = Controller(motion=Still(POSTURES[0]), like=like, seed=seed)
    rows: dict[str, list[list[float]]] = {name: [] for name in COLUMNS}
    times = []
    for posture in (*POSTURES, POSTURES[0]):
        # The first posture is the start position.
        controller.take(f"def p():\n  movej({list(posture)}, a=4.0, v=2.2)\nend\n")
        for cycle in range(850):
            controller.step()
            if cycle % every == 0:
                times.append(controller.time)
                for name, field in COLUMNS.items():
                    rows[name].append(list(getattr(controller.arm.sample, field)))
    columns = {name: np.array(each) for name, each in rows.items()}
    return Samples(Path("planted"), {"timestamp": np.array(times), **columns}, "UR5e")

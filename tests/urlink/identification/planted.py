"""A recording of an arm whose parameters are known, since they were planted."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache

import numpy as np

from urlink.dynamics import Dynamics
from urlink.models import MODELS
from urlink.motors import Motors
from urlink.vectors import FloatArray

MODEL = MODELS["UR5e"]
PAYLOAD, COG = 1.8, (0.01, -0.02, 0.06)
MOTORS = Motors(
    (1.7, 1.9, 1.75, 0.19, 0.22, 0.2),
    (10.4, 9.6, 10.1, 8.1, 7.5, 7.9),
    (0.8, 0.65, 0.7, 0.25, 0.2, 0.22),
    (1.1, 0.9, 1.0, 0.2, 0.25, 0.23),
)


def motion(seconds: float = 10.0, rate: float = 100.0) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Times, positions, speeds and accelerations: two sine waves in each joint."""
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
    """10 s of it, as the controller computes it."""
    t, q, qd, qdd = motion(rate=rate)
    torque = Dynamics(MODEL, payload=PAYLOAD, payload_cog=COG, rotors=MOTORS.rotor_inertias).torque(q, qd, qdd)
    current = np.array([MOTORS.current(a, b) for a, b in zip(torque.tolist(), qd.tolist(), strict=True)])
    named = {"target_q": q, "target_qd": qd, "target_qdd": qdd, "target_moment": torque, "target_current": current}
    return {"timestamp": t, **named}


def columns(rng: np.random.Generator, rate: float = 100.0) -> dict[str, FloatArray]:
    """The same with noise of 0.1 Nm and 0.1 A."""
    found = dict(clean(rate))
    for name in ("target_moment", "target_current"):
        found[name] = found[name] + 0.1 * rng.standard_normal(found[name].shape)
    return found

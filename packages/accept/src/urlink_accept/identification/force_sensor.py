"""Offset of the force sensor, and the payload that the controller does not know.

At rest, a sensor shows its own offset, which turns with the tool, and the weight of what the controller does not know
as payload, which always points down. Rests with the tool in different directions separate the two.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from urlink.arm.poses import rotvec_to_matrix
from urlink.tools import GRAVITY, Estimate, FloatArray

from .intervals import fit, within
from .samples import Samples
from .tracking import rests_of

#: Largest standard error of the mass in kg; with a larger one, the tool did not turn enough.
_MASS = 0.2


def force_offset(samples: Samples) -> dict[str, Sequence[Estimate]]:
    """Return the offset of the force sensor, and the mass that it carries in addition to the payload of the controller.

    The keys are force_offset, six numbers in N and Nm along the axes of the TCP, and unset_payload, in kg.
    """
    needs = ""
    pose = samples.get("actual_TCP_pose", samples.get("target_TCP_pose"))
    if "actual_TCP_force" not in samples or pose is None:
        needs = "actual_TCP_force and actual_TCP_pose in the recording"
    rests = list(rests_of(samples))
    if len(rests) < 4:
        needs = needs or "four rests or more, with the tool in different directions"
    if needs or pose is None:
        return {"force_offset": (Estimate.unknown(needs),) * 6, "unset_payload": (Estimate.unknown(needs),)}
    force = np.array([samples["actual_TCP_force"][rows].mean(axis=0) for rows in rests])
    turns = rotvec_to_matrix(np.array([pose[rows][0, 3:] for rows in rests]))
    down = np.tile((0.0, 0.0, -GRAVITY), (len(rests), 1))
    # Unknown: three forces that turn with the tool, and a mass. The blocks are the rests.
    numbers = np.repeat(np.arange(len(rests)), 3)
    forces = fit(np.concatenate((turns, down[:, :, np.newaxis]), axis=2).reshape(-1, 4), force[:, :3].ravel(), numbers)
    mass = forces.estimate(3)
    # The centre of the unknown mass turns with the tool: its torque is (R s) x g, with s = mass times distance.
    levers = -_cross(down) @ turns
    torques = fit(np.concatenate((turns, levers), axis=2).reshape(-1, 6), force[:, 3:].ravel(), numbers)
    offsets = [forces.estimate(axis) for axis in range(3)] + [
        within(float(torques.factors[axis]), torques.halves[:, axis], torques.blocks) for axis in range(3)
    ]
    if mass.high - mass.low > 4.0 * _MASS:
        needs = "rests with the tool in different directions"
        return {"force_offset": (Estimate.unknown(needs),) * 6, "unset_payload": (Estimate.unknown(needs),)}
    return {"force_offset": tuple(offsets), "unset_payload": (mass,)}


def _cross(vectors: FloatArray) -> FloatArray:
    """Return the matrices of the cross products with vectors, shape (n, 3, 3)."""
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    return np.moveaxis(np.array(((zero, -z, y), (z, zero, -x), (-y, x, zero))), 2, 0)

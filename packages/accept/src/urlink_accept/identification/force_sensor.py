"""Offset of the force sensor, and the payload that the controller does not know.

At rest, a sensor shows its own offset, which turns with the tool. It also shows the weight of the payload that the
controller does not know, which always points down. Rests with the tool in different directions separate the two.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from urlink.arm.poses import rotvec_to_matrix
from urlink.tools import GRAVITY, Estimate, FloatArray, cross_matrices

from .intervals import Fit, fit
from .samples import Samples
from .tracking import rests_of

#: Largest width of the interval of the mass in kg; with a wider one, the tool did not turn enough. Fewest rests.
_MASS, _RESTS = 1.0, 4
#: Number of blocks of equal time for the fit of a force during motions.
_BLOCKS = 24


def force_offset(samples: Samples) -> dict[str, Sequence[Estimate]]:
    """Return the offset of the force sensor, and the mass that it carries in addition to the payload of the controller.

    The keys are force_offset, six numbers in N and Nm along the axes of the TCP, and unset_payload, in kg.
    """
    pose = samples.get("actual_TCP_pose", samples.get("target_TCP_pose"))
    rests = list(rests_of(samples))
    needs = ""
    if "actual_TCP_force" not in samples or pose is None:
        needs = "actual_TCP_force and actual_TCP_pose in the recording"
    elif len(rests) < _RESTS:
        needs = f"{_RESTS} rests or more"
    if needs or pose is None:
        return {"force_offset": (Estimate.unknown(needs),) * 6, "unset_payload": (Estimate.unknown(needs),)}
    wrench = np.array([samples["actual_TCP_force"][rows].mean(axis=0) for rows in rests])
    turns = rotvec_to_matrix(np.array([pose[rows][0, 3:] for rows in rests]))
    down = np.tile((0.0, 0.0, -GRAVITY), (len(rests), 1))
    # Unknown: three forces that turn with the tool, and a mass. The blocks are the rests.
    forces = _fit(np.concatenate((turns, down[:, :, np.newaxis]), axis=2), wrench[:, :3])
    # The centre of the unknown mass turns with the tool: its torque is (R s) x g, with s = mass times distance.
    torques = _fit(np.concatenate((turns, -cross_matrices(down) @ turns), axis=2), wrench[:, 3:])
    mass = forces.estimate(3)
    if not mass.is_known or mass.high - mass.low > _MASS:
        mass = Estimate.unknown("rests with the tool in different directions; the offset assumes that it is 0")
        forces, torques = _fit(turns, wrench[:, :3]), _fit(turns, wrench[:, 3:])
    offsets = [fitted.estimate(axis) for fitted in (forces, torques) for axis in range(3)]
    return {"force_offset": tuple(offsets), "unset_payload": (mass,)}


def fixed_force(pose: FloatArray, wrench: FloatArray) -> tuple[Sequence[Estimate], Sequence[Estimate]]:
    """Separate the force into a part that turns with the tool, and a part that stays in the base frame.

    An offset of the sensor turns with the tool. The weight of a payload that the controller does not know stays in the
    base frame, and so does an offset that the controller reports in the wrong frame.

    Args:
        pose: Poses of the TCP in the base frame, shape (n, 6), in m and as rotation vectors in rad.
        wrench: Forces and torques in the base frame, shape (n, 6), in N and Nm.

    Returns:
        The part that turns, in N along the axes of the TCP, and the part that stays, in N along those of the base.
        A number is unknown if the tool did not turn enough to separate the two.
    """
    turns = rotvec_to_matrix(pose[:, 3:])
    stays = np.tile(np.eye(3), (len(turns), 1, 1))
    blocks = np.arange(len(turns)) * _BLOCKS // len(turns)
    found = fit(np.concatenate((turns, stays), axis=2).reshape(-1, 6), wrench[:, :3].ravel(), np.repeat(blocks, 3))
    estimates = [found.estimate(number) for number in range(6)]
    return estimates[:3], estimates[3:]


def _fit(columns: FloatArray, wrench: FloatArray) -> Fit:
    """Fit three components of each rest; columns have the shape (n, 3, k)."""
    return fit(columns.reshape(-1, columns.shape[2]), wrench.ravel(), np.repeat(np.arange(len(wrench)), 3))

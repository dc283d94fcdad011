"""Direct torque, and the Jacobian and dynamics of the arm with its payload, as the library computes them.

ur_rtde uses them on 5.23 and later, all without arguments. Guesses: their arguments, joint positions and speeds first;
that the actual ones are the default; that a matrix is a list of its rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from urlink.dynamics import Dynamics

from ..machine import ScriptThread, Waiting
from .declaration import Family, boolean, joints, pose, six

__all__ = ["FAMILY"]

FAMILY = Family()

# Work of each, in elements of a list.
_COST = 400
# s, step of the central difference of the Jacobian: the errors of rounding and curvature are about equal.
_MOMENT = 1e-5

_Rows = tuple[tuple[float, ...], ...]


def _rows(matrix: Any) -> _Rows:
    return tuple(map(tuple, matrix.tolist()))


def _positions(thread: ScriptThread, q: Any, what: str) -> Sequence[float]:
    return list(thread.world.q_actual) if q is None else joints(q, f"{what}: q")


def _speeds(thread: ScriptThread, qd: Any, what: str) -> Sequence[float]:
    return list(thread.world.qd_actual) if qd is None else joints(qd, f"{what}: qd")


def _tool(thread: ScriptThread, tcp: Any, what: str) -> Sequence[float]:
    return list(thread.world.tcp) if isinstance(tcp, str) else pose(tcp, f"{what}: tcp")


def _dynamics(thread: ScriptThread) -> Dynamics:
    world = thread.world
    return Dynamics(
        world.kinematics,
        payload=world.payload,
        payload_cog=list(world.payload_cog),
        payload_inertia=list(world.payload_inertia),
    )


@FAMILY.declare(since="5.23/10.11")
def get_jacobian(thread: ScriptThread, q: Any = None, tcp: Any = "active_tcp") -> _Rows:
    """The matrix from joint speeds to the velocity of the TCP in the base frame."""
    thread.machine.spend(_COST)
    at, tool = _positions(thread, q, "get_jacobian"), _tool(thread, tcp, "get_jacobian")
    return _rows(thread.world.kinematics.jacobian(at, tool))


@FAMILY.declare(since="5.23/10.11")
def get_jacobian_time_derivative(thread: ScriptThread, q: Any = None, qd: Any = None, tcp: Any = "active_tcp") -> _Rows:
    """The time derivative of the Jacobian at these joint speeds, per second."""
    thread.machine.spend(2 * _COST)
    what = "get_jacobian_time_derivative"
    at, speeds, tool = _positions(thread, q, what), _speeds(thread, qd, what), _tool(thread, tcp, what)
    before, after = (
        thread.world.kinematics.jacobian([p + t * v for p, v in zip(at, speeds, strict=True)], tool)
        for t in (-_MOMENT, _MOMENT)
    )
    return _rows((after - before) / (2.0 * _MOMENT))


@FAMILY.declare(since="5.23/10.11")
def get_mass_matrix(thread: ScriptThread, q: Any = None) -> _Rows:
    """The matrix from joint accelerations to torques, kg m²."""
    thread.machine.spend(_COST)
    return _rows(_dynamics(thread).mass_matrix(_positions(thread, q, "get_mass_matrix")))


@FAMILY.declare(since="5.23/10.11")
def get_coriolis_and_centrifugal_torques(thread: ScriptThread, q: Any = None, qd: Any = None) -> tuple[float, ...]:
    """Torques at constant joint speeds, without gravity, Nm."""
    thread.machine.spend(_COST)
    what = "get_coriolis_and_centrifugal_torques"
    at, speeds = _positions(thread, q, what), _speeds(thread, qd, what)
    return tuple(_dynamics(thread).coriolis_torque(at, speeds).tolist())


@FAMILY.declare(since="5.23/10.11")
def get_target_joint_torques(thread: ScriptThread) -> tuple[float, ...]:
    """Torques of the target movement, gravity included, Nm. The name of the function is a guess."""
    return tuple(float(each) for each in thread.world.torques)


@FAMILY.declare(takes_time=True, in_secondary=False, since="5.23/10.11")
def direct_torque(
    thread: ScriptThread,
    torque: Any,
    friction_comp: Any = True,
    viscous_scale: Any = (1, 1, 1, 1, 1, 1),
    coulomb_scale: Any = (1, 1, 1, 1, 1, 1),
) -> Waiting:
    """Apply joint torques for one cycle, in addition to gravity compensation.

    The two scales, which later firmware has, are the compensated fractions of friction; here the smaller of both is
    used for each joint.
    """
    thread.machine.spend(_COST)
    wanted = joints(torque, "direct_torque: torque")
    viscous, coulomb = six(viscous_scale, "direct_torque: viscous_scale"), six(coulomb_scale, "direct_torque: coulomb")
    scales = [max(min(pair), 0.0) for pair in zip(viscous, coulomb, strict=True)]
    is_made_up = boolean(friction_comp, "direct_torque: friction_comp")
    left = [1.0 - min(scale, 1.0) if is_made_up else 1.0 for scale in scales]
    turning = np.array(wanted) + np.array(thread.world.external_torques)
    return thread.machine.moving(thread, lambda: thread.world.motion.direct_torque(_dynamics(thread), turning, left))


@FAMILY.declare(since="5.23/10.11")
def set_friction_compensation(thread: ScriptThread, enable: Any) -> None:
    """Without effect: an argument of `direct_torque` turns friction compensation on."""
    boolean(enable, "set_friction_compensation: enable")


@FAMILY.declare(since="5.25/10.12")
def set_friction_scales(thread: ScriptThread, viscous_scale: Any, coulomb_scale: Any) -> None:
    """Without effect, as `set_friction_compensation`."""
    six(viscous_scale, "set_friction_scales: viscous_scale")
    six(coulomb_scale, "set_friction_scales: coulomb_scale")

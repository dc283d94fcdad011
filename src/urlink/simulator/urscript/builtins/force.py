"""Functions of force sensor, force mode, freedrive, direct torque and the arm's dynamics.
For the model of the compliant arm, see `urlink.simulator.robot.generator.compliance`. Tests place the objects that it
touches (`urlink.simulator.robot.surroundings`). Names, order and ranges of the arguments are from the vendor's manual
(cited from memory). Two facts are assumed: the first release with a function, if no driver shows it, and that a number
out of range is an error.

ur_rtde uses the functions of the dynamics on 5.23 and later, all without arguments. The following is assumed: their
arguments, joint positions and speeds first, with the actual values as defaults. A matrix is a list of its rows. The
mass matrix does not include the rotors unless they are requested.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from urlink.simulator.robot.generator import ForceTask

from ..errors import Fault
from ..machine import ScriptThread, Waiting
from .declaration import boolean, declare, integer, joints, joints_or, number, number_within, pose, six, vector
from .poses import tcp_of

_NOWHERE = (0.0, 0.0, 0.0)
_BASE = (0.0,) * 6
# Work of each function that computes with the arm, in elements of a list.
_COST = 400
# Squared manipulability of the posture, in m⁶, below which the arm is near a singularity, and too near.
_CLOSE, _TOO_CLOSE = 1e-4, 1e-5


# -- the sensor and contacts -----------------------------------------------------------------------------


@declare(since="3.0")
def zero_ftsensor(thread: ScriptThread) -> None:
    """Make the current force the zero of the sensor."""
    thread.world.zero_force()


@declare(since="5.4")
def tool_contact(thread: ScriptThread, direction: Any = (0, 0, 0, 0, 0, 0)) -> int:
    """Return the cycles since a contact in that direction of the tool began; 0 without one.

    Zeros mean any direction. Only the first three numbers are used. The result is the argument of
    `get_actual_joint_positions_history`.
    """
    return thread.world.contact_steps(six(direction, "tool_contact: direction")[:3])


# The older of the two names reportedly has a sign error on real controllers, which is not modelled.
@declare(name="enable_external_ft_sensor", since="3.0")
@declare(since="3.14/5.9")
def ft_rtde_input_enable(
    thread: ScriptThread,
    enable: Any,
    sensor_mass: Any = 0.0,
    sensor_measuring_offset: Any = _NOWHERE,
    sensor_cog: Any = _NOWHERE,
) -> None:
    """Use the RTDE input `external_force_torque` as the force at the TCP.

    The mass and the positions have no effect.
    """
    number(sensor_mass, "ft_rtde_input_enable: sensor_mass")
    vector(sensor_measuring_offset, "ft_rtde_input_enable: sensor_measuring_offset", 3)
    vector(sensor_cog, "ft_rtde_input_enable: sensor_cog", 3)
    thread.world.use_external_force(boolean(enable, "ft_rtde_input_enable: enable"))


# -- force mode ------------------------------------------------------------------------------------------


@declare(in_secondary=False)
def force_mode(
    thread: ScriptThread, task_frame: Any, selection_vector: Any, wrench: Any, type: Any, limits: Any
) -> None:
    """Let the arm yield along the selected axes of the frame until `end_force_mode`."""
    thread.machine.spend(_COST)
    most = six(limits, "force_mode: limits")
    if min(most) < 0.0:
        raise Fault(f"force_mode: the smallest limit is {min(most):g}; expected 0 or more")
    task = ForceTask(
        pose(task_frame, "force_mode: task_frame"),
        _axes(selection_vector, "force_mode: selection_vector"),
        six(wrench, "force_mode: wrench"),
        integer(type, "force_mode: type", 1, 3),
        most,
    )
    thread.world.force_mode(task)


@declare(in_secondary=False)
def end_force_mode(thread: ScriptThread) -> None:
    thread.world.end_compliance()


@declare(since="3.5")
def force_mode_set_damping(thread: ScriptThread, damping: Any) -> None:
    thread.world.set_force_damping(number_within(damping, "force_mode_set_damping: damping", 0.0, 1.0))


@declare(since="5.0")
def force_mode_set_gain_scaling(thread: ScriptThread, scaling: Any) -> None:
    thread.world.set_force_gain(number_within(scaling, "force_mode_set_gain_scaling: scaling", 0.0, 2.0))


def _axes(values: Any, what: str) -> list[bool]:
    chosen = six(values, what)
    if any(each not in (0.0, 1.0) for each in chosen):
        raise Fault(f"{what} has a value other than 0 and 1; expected six values of 0 or 1")
    return [each == 1.0 for each in chosen]


# -- freedrive -------------------------------------------------------------------------------------------


@declare(in_secondary=False, since="5.10")
def freedrive_mode(thread: ScriptThread, freeAxes: Any = (1, 1, 1, 1, 1, 1), feature: Any = "base") -> None:
    """Let a person move the arm by hand along and about the axes of a feature.

    A feature is a pose in the base frame, "base" or "tool".
    """
    thread.machine.spend(_COST)
    frames = {"base": _BASE, "tool": thread.world.pose_target}
    known = isinstance(feature, str) and feature in frames
    frame = frames[feature] if known else pose(feature, "freedrive_mode: feature")
    thread.world.freedrive(_axes(freeAxes, "freedrive_mode: freeAxes"), frame)


@declare(name="freedrive_mode", in_secondary=False, since="3.0", until="5.10")
@declare(in_secondary=False, since="1.6")
def teach_mode(thread: ScriptThread) -> None:
    """Begin freedrive in all directions.

    Every firmware has the older name of this function. Before 5.10, the newer name is an alias.
    """
    thread.world.freedrive([True] * 6, _BASE)


@declare("end_teach_mode", in_secondary=False, since="1.6")
def end_freedrive_mode(thread: ScriptThread) -> None:
    thread.world.end_compliance()


@declare(since="5.10")
def get_freedrive_status(thread: ScriptThread) -> int:
    """Return 0 normal, 1 near a singularity, 2 too near for a good motion.

    The distances are assumed.
    """
    thread.machine.spend(_COST)
    left = float(thread.world.kinematics.manipulability(list(thread.world.q_target))) ** 2
    return 2 if left < _TOO_CLOSE else 1 if left < _CLOSE else 0


# -- dynamics --------------------------------------------------------------------------------------------

# Time step of the central difference of the Jacobian, in s. The errors of rounding and curvature are about equal.
_MOMENT = 1e-5

_Rows = tuple[tuple[float, ...], ...]


def _rows(matrix: Any) -> _Rows:
    return tuple(map(tuple, matrix.tolist()))


@declare(since="5.23/10.11")
def get_jacobian(thread: ScriptThread, q: Any = None, tcp: Any = "active_tcp") -> _Rows:
    """Return the matrix from joint speeds to the velocity of the TCP in the base frame."""
    thread.machine.spend(_COST)
    at = joints_or(q, thread.world.q_actual, "get_jacobian: q")
    return _rows(thread.world.kinematics.jacobian(at, tcp_of(thread, tcp, "get_jacobian: tcp")))


@declare(since="5.23/10.11")
def get_jacobian_time_derivative(thread: ScriptThread, q: Any = None, qd: Any = None, tcp: Any = "active_tcp") -> _Rows:
    """Return the time derivative of the Jacobian at these joint speeds, per second."""
    thread.machine.spend(2 * _COST)
    at = joints_or(q, thread.world.q_actual, "get_jacobian_time_derivative: q")
    speeds = joints_or(qd, thread.world.qd_actual, "get_jacobian_time_derivative: qd")
    tool = tcp_of(thread, tcp, "get_jacobian_time_derivative: tcp")
    before, after = (
        thread.world.kinematics.jacobian([p + t * v for p, v in zip(at, speeds, strict=True)], tool)
        for t in (-_MOMENT, _MOMENT)
    )
    return _rows((after - before) / (2.0 * _MOMENT))


@declare(since="5.23/10.11")
def get_mass_matrix(thread: ScriptThread, q: Any = None, include_rotors_inertia: Any = False) -> _Rows:
    """Return the matrix from joint accelerations to torques, in kg m²."""
    thread.machine.spend(_COST)
    matrix = thread.world.dynamics.mass_matrix(joints_or(q, thread.world.q_actual, "get_mass_matrix: q"))
    if not boolean(include_rotors_inertia, "get_mass_matrix: include_rotors_inertia"):
        matrix = matrix - np.diag(thread.world.motors.rotor_inertias)
    return _rows(matrix)


@declare(since="5.23/10.11")
def get_coriolis_and_centrifugal_torques(thread: ScriptThread, q: Any = None, qd: Any = None) -> tuple[float, ...]:
    """Return the torques at constant joint speeds, without gravity, in Nm."""
    thread.machine.spend(_COST)
    at = joints_or(q, thread.world.q_actual, "get_coriolis_and_centrifugal_torques: q")
    speeds = joints_or(qd, thread.world.qd_actual, "get_coriolis_and_centrifugal_torques: qd")
    return tuple(thread.world.dynamics.coriolis_torque(at, speeds).tolist())


@declare(takes_time=True, in_secondary=False, since="5.23/10.11")
def direct_torque(
    thread: ScriptThread,
    torque: Any,
    friction_comp: Any = True,
    viscous_scale: Any = (1, 1, 1, 1, 1, 1),
    coulomb_scale: Any = (1, 1, 1, 1, 1, 1),
) -> Waiting:
    """Apply joint torques for one cycle, in addition to gravity compensation.

    The two scales, which later firmware has, are the compensated fractions of friction. Here, the smaller of both is
    used for each joint.
    """
    thread.machine.spend(_COST)
    wanted = joints(torque, "direct_torque: torque")
    viscous, coulomb = six(viscous_scale, "direct_torque: viscous_scale"), six(coulomb_scale, "direct_torque: coulomb")
    scales = [max(min(pair), 0.0) for pair in zip(viscous, coulomb, strict=True)]
    is_made_up = boolean(friction_comp, "direct_torque: friction_comp")
    left = [1.0 - min(scale, 1.0) if is_made_up else 1.0 for scale in scales]
    turning = np.array(wanted) + np.array(thread.world.external_torques)
    world = thread.world
    return thread.machine.moving(
        thread, lambda: world.motion.direct_torque(world.dynamics, world.motors, turning, left)
    )


@declare(since="5.23/10.11")
def set_friction_compensation(thread: ScriptThread, enable: Any) -> None:
    """Check the argument; the function has no effect.

    An argument of `direct_torque` turns friction compensation on.
    """
    boolean(enable, "set_friction_compensation: enable")


@declare(since="5.25/10.12")
def set_friction_scales(thread: ScriptThread, viscous_scale: Any, coulomb_scale: Any) -> None:
    """Check the arguments; the function has no effect, like `set_friction_compensation`."""
    six(viscous_scale, "set_friction_scales: viscous_scale")
    six(coulomb_scale, "set_friction_scales: coulomb_scale")

"""Functions for the force sensor, force mode, freedrive, direct torque, and the dynamics of the arm.

For the model of the compliant arm, see `urlink.simulator.robot.generator.compliance`. Tests add the objects that the
arm touches (`urlink.simulator.robot.surroundings`). The names, the order and the ranges of the arguments are from the
vendor's manual (cited from memory). Two things are assumed. The first is the release that introduced a function, if no
driver shows it. The second is that a number out of range is an error.

ur_rtde uses the functions for the dynamics on firmware 5.23 and later, always without arguments. Three things are
assumed. The first is the arguments: joint positions and joint speeds come first, and their defaults are the actual
values. The second is that a matrix is a list of rows. The third is that the mass matrix includes the rotors only if
they are requested.
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
# Work that is counted for a function that computes with the model of the arm, in elements of a list.
_COST = 400
# Squared manipulability, in m⁶, below which the arm is near a singularity; the same for too near.
_CLOSE, _TOO_CLOSE = 1e-4, 1e-5


# -- the sensor and contacts -----------------------------------------------------------------------------


@declare(since="3.0")
def zero_ftsensor(thread: ScriptThread) -> None:
    """Make the current force the new zero of the sensor."""
    thread.world.zero_force()


@declare(since="5.4")
def tool_contact(thread: ScriptThread, direction: Any = (0, 0, 0, 0, 0, 0)) -> int:
    """Return the number of cycles since a contact began; 0 if there is no contact.

    Only contacts that oppose a motion of the tool in `direction` are detected. Zeros select any direction. Only the
    first three numbers are used. The result can be passed to `get_actual_joint_positions_history`.
    """
    return thread.world.contact_steps(six(direction, "tool_contact: direction")[:3])


# On real controllers, the function with the older name reportedly has a sign error. This error is not simulated.
@declare(name="enable_external_ft_sensor", since="3.0")
@declare(since="3.14/5.9")
def ft_rtde_input_enable(
    thread: ScriptThread,
    enable: Any,
    sensor_mass: Any = 0.0,
    sensor_measuring_offset: Any = _NOWHERE,
    sensor_cog: Any = _NOWHERE,
) -> None:
    """Enable or disable the RTDE input `external_force_torque` as source of the force at the TCP.

    The mass and the positions are ignored.
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
    """Begin force mode: the arm yields along the selected axes of the frame until `end_force_mode`."""
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
    """Begin freedrive along all axes.

    The function has had this name since 1.6. From 3.0 until before 5.10, `freedrive_mode` is an alias.
    """
    thread.world.freedrive([True] * 6, _BASE)


@declare("end_teach_mode", in_secondary=False, since="1.6")
def end_freedrive_mode(thread: ScriptThread) -> None:
    thread.world.end_compliance()


@declare(since="5.10")
def get_freedrive_status(thread: ScriptThread) -> int:
    """Return 0 if the posture is normal, 1 if it is near a singularity, 2 if it is too near for a good motion.

    The limits between these values are assumed.
    """
    thread.machine.spend(_COST)
    left = float(thread.world.kinematics.manipulability(list(thread.world.q_target))) ** 2
    return 2 if left < _TOO_CLOSE else 1 if left < _CLOSE else 0


# -- dynamics --------------------------------------------------------------------------------------------

# Time step for the central difference of the Jacobian, in s. With this step, the errors because of rounding and because
# of curvature are about equal.
_MOMENT = 1e-5

_Rows = tuple[tuple[float, ...], ...]


def _rows(matrix: Any) -> _Rows:
    return tuple(map(tuple, matrix.tolist()))


@declare(since="5.23/10.11")
def get_jacobian(thread: ScriptThread, q: Any = None, tcp: Any = "active_tcp") -> _Rows:
    """Return the Jacobian, which maps joint speeds to the velocity of the TCP in the base frame."""
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
    """Return the mass matrix, which maps joint accelerations to joint torques, in kg m²."""
    thread.machine.spend(_COST)
    matrix = thread.world.dynamics.mass_matrix(joints_or(q, thread.world.q_actual, "get_mass_matrix: q"))
    if not boolean(include_rotors_inertia, "get_mass_matrix: include_rotors_inertia"):
        matrix = matrix - np.diag(thread.world.motors.rotor_inertias)
    return _rows(matrix)


@declare(since="5.23/10.11")
def get_coriolis_and_centrifugal_torques(thread: ScriptThread, q: Any = None, qd: Any = None) -> tuple[float, ...]:
    """Return the joint torques that constant joint speeds need, without gravity, in Nm."""
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

    Later firmware has the two scales, which are the fractions of viscous and Coulomb friction that are compensated. The
    simulator uses the smaller of the two scales for each joint.
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
    """Check the argument; this function has no effect.

    In the simulator, an argument of `direct_torque` enables the friction compensation.
    """
    boolean(enable, "set_friction_compensation: enable")


@declare(since="5.25/10.12")
def set_friction_scales(thread: ScriptThread, viscous_scale: Any, coulomb_scale: Any) -> None:
    """Check the arguments; this function has no effect. See `set_friction_compensation`."""
    six(viscous_scale, "set_friction_scales: viscous_scale")
    six(coulomb_scale, "set_friction_scales: coulomb_scale")

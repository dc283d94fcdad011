"""Functions that read the state of the arm, and functions that set or read TCP, payload and gravity."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from ..errors import MAX_INTEGER, MIN_INTEGER, Fault
from ..machine import ScriptThread
from ..values import PoseValue, list_of
from ..world import ScriptWorld
from .declaration import declare, integer, number, pose, string, vector

# Work that is counted for computing the state of the arm again, for example with another tool, in elements of a list.
_LOOK = 400

#: Name of a function -> type of its result (list or pose), Python function that reads the result, and first firmware
#: with the function.
_STATE: dict[str, tuple[type[tuple[float, ...]], Callable[[ScriptWorld], Sequence[float]], str]] = {
    "get_actual_joint_positions": (tuple, lambda world: world.q_actual, "1.0"),
    # The name is known from the program of a driver. It is assumed that the result is the actual positions.
    "get_joint_positions": (tuple, lambda world: world.q_actual, "1.0"),
    "get_actual_joint_speeds": (tuple, lambda world: world.qd_actual, "1.0"),
    "get_target_joint_positions": (tuple, lambda world: world.q_target, "1.0"),
    "get_target_joint_speeds": (tuple, lambda world: world.qd_target, "1.0"),
    "get_target_joint_accelerations": (tuple, lambda world: world.qdd_target, "5.23/10.11"),
    "get_joint_torques": (tuple, lambda world: world.torques, "1.0"),
    # The result is the torques of the target motion including gravity, in Nm. The name is assumed.
    "get_target_joint_torques": (tuple, lambda world: world.torques, "5.23/10.11"),
    "get_actual_tcp_pose": (PoseValue, lambda world: world.pose_actual, "1.0"),
    "get_target_tcp_pose": (PoseValue, lambda world: world.pose_target, "1.0"),
    "get_actual_tcp_speed": (tuple, lambda world: world.speed_actual, "1.0"),
    "get_target_tcp_speed": (tuple, lambda world: world.speed_target, "3.0"),
    "get_tcp_force": (tuple, lambda world: world.force, "1.0"),
    "get_tcp_offset": (PoseValue, lambda world: world.tcp, "1.0"),
    "get_target_payload_cog": (tuple, lambda world: world.payload_cog, "1.0"),
    "get_payload_cog": (tuple, lambda world: world.payload_cog, "1.0"),
    "get_target_payload_inertia": (tuple, lambda world: world.payload_inertia, "3.15/5.10"),
}


def _reader(
    kind: type[tuple[float, ...]], read: Callable[[ScriptWorld], Sequence[float]]
) -> Callable[[ScriptThread], tuple[float, ...]]:
    return lambda thread: kind([float(value) for value in read(thread.world)])


for _name, (_kind, _read, _since) in _STATE.items():
    declare(name=_name, since=_since)(_reader(_kind, _read))


@declare(since="3.0")
def get_actual_joint_positions_history(thread: ScriptThread, steps: Any = 0) -> tuple[float, ...]:
    """Return the joint positions of `steps` cycles ago.

    The history begins at the start of the program, and contains at most the last 500 cycles (assumed).
    """
    past = thread.machine.history
    return tuple(past[-1 - min(integer(steps, "get_actual_joint_positions_history: steps", 0), len(past) - 1)].q_actual)


@declare(since="3.0")
def get_target_waypoint(thread: ScriptThread) -> PoseValue:
    """Return the pose at the end of the current path move; if there is none, the target pose of the TCP (assumed)."""
    waypoint = thread.world.motion.waypoint
    return PoseValue(map(float, thread.world.pose_target if waypoint is None else waypoint))


@declare()
def get_actual_tool_flange_pose(thread: ScriptThread) -> PoseValue:
    return PoseValue(thread.world.kinematics.forward(list(thread.world.q_actual)).tolist())


@declare()
def force(thread: ScriptThread) -> float:
    """Return the magnitude of the force at the TCP, in N."""
    x, y, z = map(float, thread.world.force[:3])
    return float((x * x + y * y + z * z) ** 0.5)


@declare()
def set_tcp(thread: ScriptThread, pose: Any) -> None:
    thread.machine.spend(_LOOK)
    thread.world.set_tcp(_pose(pose, "set_tcp: pose"))


_pose = pose


@declare()
def set_payload(thread: ScriptThread, m: Any, cog: Any = None) -> None:
    """Set the payload. If no centre of mass is given, the simulator keeps the current one.

    A real controller then uses the TCP (CB) or the flange.
    """
    thread.world.set_payload(_mass(m, "set_payload: m"), _cog(cog, "set_payload: cog"), None)


@declare(since="3.15/5.10")
def set_target_payload(thread: ScriptThread, m: Any, cog: Any, inertia: Any = None, transition_time: Any = 0) -> None:
    seconds = number(transition_time, "set_target_payload: transition_time")
    moments = None if inertia is None else vector(inertia, "set_target_payload: inertia", 6)
    mass, centre = _mass(m, "set_target_payload: m"), _cog(cog, "set_target_payload: cog")
    thread.world.set_payload(mass, centre, moments, seconds)


@declare()
def set_payload_mass(thread: ScriptThread, m: Any) -> None:
    thread.world.set_payload(_mass(m, "set_payload_mass: m"), list(thread.world.payload_cog), None)


@declare()
def set_payload_cog(thread: ScriptThread, CoG: Any) -> None:
    thread.world.set_payload(thread.world.payload, _cog(CoG, "set_payload_cog: CoG"), None)


@declare("get_payload")
def get_target_payload(thread: ScriptThread) -> float:
    return float(thread.world.payload)


@declare()
def set_gravity(thread: ScriptThread, d: Any) -> None:
    thread.world.set_gravity(vector(d, "set_gravity: d", 3))


@declare()
def get_steptime(thread: ScriptThread) -> float:
    return thread.world.period


# The manuals contain this function since 5.25.1 and 10.14, but the vendor's examples for 5.23 already call it.
@declare(since="5.23/10.11")
def get_rtde_value(thread: ScriptThread, name: Any) -> Any:
    """Return the value of an RTDE output in the previous cycle: a number, a truth value or a list.

    It is assumed that a pose is returned as a list.
    """
    value = thread.world.rtde_value(string(name, "get_rtde_value: name"))
    if isinstance(value, (bool, float)):
        return value
    if isinstance(value, int):
        return int(value) if MIN_INTEGER <= value <= MAX_INTEGER else float(value)
    return list_of([float(item) for item in value], thread.machine.charge)


def _mass(m: Any, what: str) -> float:
    mass = float(number(m, what))
    if mass < 0:
        raise Fault(f"{what} must not be negative")
    return mass


def _cog(cog: Any, what: str) -> list[float] | None:
    return None if cog is None else vector(cog, what, 3)

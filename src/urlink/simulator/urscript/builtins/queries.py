"""The state of the arm, and its payload."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ..errors import MAX_INTEGER, MIN_INTEGER, Fault
from ..machine import ScriptThread
from ..values import PoseValue, list_of
from .declaration import declare, integer, number, pose, string, vector

# Work of recomputing the arm's state, as with another tool, in elements of a list.
_LOOK = 400

_List = tuple[float, ...]


def _floats(values: Sequence[float]) -> _List:
    return tuple([float(value) for value in values])


# The name without "actual" occurs in a driver's program; that it means the actual positions is a guess.
@declare("get_joint_positions")
def get_actual_joint_positions(thread: ScriptThread) -> _List:
    return _floats(thread.world.q_actual)


@declare()
def get_actual_joint_speeds(thread: ScriptThread) -> _List:
    return _floats(thread.world.qd_actual)


@declare()
def get_target_joint_positions(thread: ScriptThread) -> _List:
    return _floats(thread.world.q_target)


@declare()
def get_target_joint_speeds(thread: ScriptThread) -> _List:
    return _floats(thread.world.qd_target)


@declare(since="5.23/10.11")
def get_target_joint_accelerations(thread: ScriptThread) -> _List:
    return _floats(thread.world.qdd_target)


@declare(since="3.0")
def get_actual_joint_positions_history(thread: ScriptThread, steps: Any = 0) -> _List:
    """The joint positions of `steps` cycles ago; at most back to the program's start, and 500 cycles (a guess)."""
    past = thread.machine.history
    return past[-1 - min(integer(steps, "get_actual_joint_positions_history: steps", 0), len(past) - 1)]


# The second name, of the torques of the target movement with gravity, is a guess.
@declare(name="get_target_joint_torques", since="5.23/10.11")
@declare()
def get_joint_torques(thread: ScriptThread) -> _List:
    return _floats(thread.world.torques)


@declare()
def get_actual_tcp_pose(thread: ScriptThread) -> PoseValue:
    return PoseValue(_floats(thread.world.pose_actual))


@declare()
def get_target_tcp_pose(thread: ScriptThread) -> PoseValue:
    return PoseValue(_floats(thread.world.pose_target))


@declare()
def get_actual_tcp_speed(thread: ScriptThread) -> _List:
    return _floats(thread.world.speed_actual)


@declare(since="3.0")
def get_target_tcp_speed(thread: ScriptThread) -> _List:
    return _floats(thread.world.speed_target)


@declare(since="3.0")
def get_target_waypoint(thread: ScriptThread) -> PoseValue:
    """The end of the present path move; without one, the target pose of the TCP (a guess)."""
    waypoint = thread.world.motion.waypoint
    return PoseValue(_floats(thread.world.pose_target if waypoint is None else waypoint))


@declare()
def get_actual_tool_flange_pose(thread: ScriptThread) -> PoseValue:
    return PoseValue(thread.world.kinematics.forward(list(thread.world.q_actual)).tolist())


@declare()
def get_tcp_force(thread: ScriptThread) -> _List:
    return _floats(thread.world.force)


@declare()
def force(thread: ScriptThread) -> float:
    """The magnitude of the force at the TCP, N."""
    x, y, z = _floats(thread.world.force)[:3]
    return float((x * x + y * y + z * z) ** 0.5)


@declare()
def get_tcp_offset(thread: ScriptThread) -> PoseValue:
    return PoseValue(_floats(thread.world.tcp))


@declare()
def set_tcp(thread: ScriptThread, pose: Any) -> None:
    thread.machine.spend(_LOOK)
    thread.world.set_tcp(_pose(pose, "set_tcp: pose"))


_pose = pose


@declare()
def set_payload(thread: ScriptThread, m: Any, cog: Any = None) -> None:
    """Without a centre of mass the controller uses the TCP (CB) or the flange."""
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


@declare("get_payload_cog")
def get_target_payload_cog(thread: ScriptThread) -> _List:
    return _floats(thread.world.payload_cog)


@declare(since="3.15/5.10")
def get_target_payload_inertia(thread: ScriptThread) -> _List:
    return _floats(thread.world.payload_inertia)


@declare()
def set_gravity(thread: ScriptThread, d: Any) -> None:
    thread.world.set_gravity(vector(d, "set_gravity: d", 3))


@declare()
def get_steptime(thread: ScriptThread) -> float:
    return thread.world.period


# In the manuals from 5.25.1 and 10.14 on; the vendor's examples for 5.23 call it.
@declare(since="5.23/10.11")
def get_rtde_value(thread: ScriptThread, name: Any) -> Any:
    """An RTDE output of the cycle before: a number, a truth value or a list. That a pose is a list is a guess."""
    value = thread.world.rtde_value(string(name, "get_rtde_value: name"))
    if isinstance(value, (bool, float)):
        return value
    if isinstance(value, int):
        return int(value) if MIN_INTEGER <= value <= MAX_INTEGER else float(value)
    return list_of([float(item) for item in value], thread.machine.charge)


def _mass(m: Any, what: str) -> float:
    mass = float(number(m, what))
    if mass < 0:
        raise Fault(f"{what} is not negative")
    return mass


def _cog(cog: Any, what: str) -> list[float] | None:
    return None if cog is None else vector(cog, what, 3)

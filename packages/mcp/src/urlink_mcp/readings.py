"""Tools that only read: their arguments, and the values that they return.

Every function returns values that JSON can represent. Angles are given in rad, and for people in degrees too.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from urlink import LimitExceeded, LinkError, Robot
from urlink.arm.kinematics import Unreachable
from urlink.arm.poses import rotvec_to_rpy
from urlink.packets import RealtimeState
from urlink.tools import JOINTS, shown_tcp

from .actions import OfRobot, Six

__all__ = ["READINGS", "CheckPose", "fresh_state"]

#: Maximum time, in s, to wait for a state.
_SOON = 3.0
#: Number of inputs and outputs of each bank, and the first bit of the bank in a state.
_BANKS = {"standard": (8, 0), "configurable": (8, 8), "tool": (2, 16)}


class CheckPose(OfRobot):
    """Arguments of `check_pose`."""

    pose: Annotated[Six, Field(description="position in m, and rotation vector in rad, of the tool in the base frame")]


def fresh_state(robot: Robot) -> RealtimeState:
    """Return the next state of the robot.

    Raises:
        LinkTimeout: If no state arrives.
    """
    return robot.realtime.wait(_SOON)


def _state(robot: Robot, given: OfRobot) -> dict[str, Any]:
    state = fresh_state(robot)
    pose = state.tool_vector_actual
    modes = {name: getattr(state, name) for name in ("robot_mode", "safety_mode", "program_state")}
    said: dict[str, Any] = {
        "age_s": None if state.received is None else round(state.received.age, 4),
        **{name: None if mode is None else mode.name for name, mode in modes.items()},
        "q_rad": _rounded(state.q_actual),
        "q_degrees": _rounded(np.degrees(state.q_actual), 2),
        "joints": list(JOINTS),
        "is_moving": bool(np.abs(state.qd_target).max() > 1e-3),
        "tcp_pose": _rounded(pose),
        "tcp_position_m": _rounded(pose[:3]),
        "tcp_rotation_vector_rad": _rounded(pose[3:]),
        "tcp_roll_pitch_yaw_degrees": _rounded(np.degrees(rotvec_to_rpy(pose[3:])), 2),
        "tcp_force_N_Nm": _rounded(state.tcp_force, 2),
        "speed_scaling": state.speed_scaling,
        "digital_inputs": _bits(state.digital_input_bits),
        "digital_outputs": None if state.digital_output_bits is None else _bits(state.digital_output_bits),
        "connection": robot.realtime.connection.value,
    }
    try:
        refusal = robot.safety.refusal
        said["motion_refused_because"] = None if refusal is None else str(refusal)
    except LinkError as error:
        said["motion_refused_because"] = str(error)
    return said


def _explanation(robot: Robot, given: OfRobot) -> dict[str, Any]:
    explained = robot.safety.explain()
    if explained is None:
        return {"stopped": False, "text": "no stop was seen since this server connected to the robot"}
    return {
        "stopped": True,
        "kind": explained.kind,
        "cause": explained.cause.name,
        "code": explained.code,
        "text": explained.text(picture=False),
    }


def _points(robot: Robot, given: OfRobot) -> dict[str, Any]:
    points = robot.points
    checks = {each.name: each for each in points.check_all()}
    return {
        "points": [
            {
                "name": name,
                "q_rad": _rounded(point.q),
                "pose": _rounded(point.pose),
                "model": point.model,
                "reachable": checks[name].is_reachable if name in checks else None,
                "problem": (checks[name].reason or None) if name in checks else None,
            }
            for name, point in points.items()
        ]
    }


def _checked_pose(robot: Robot, given: OfRobot) -> dict[str, Any]:
    assert isinstance(given, CheckPose)
    state, arm = fresh_state(robot), robot.kinematics
    tcp = shown_tcp(arm, state)
    try:
        q = arm.inverse(given.pose, state.q_actual, tcp)
    except Unreachable as error:
        return {"reachable": False, "reason": str(error)}
    turns = np.abs(q - state.q_actual)
    said = {
        "reachable": True,
        "q_rad": _rounded(q),
        "q_degrees": _rounded(np.degrees(q), 2),
        "solutions": len(arm.solutions(given.pose, state.q_actual, tcp)),
        "largest_turn_degrees": round(float(np.degrees(turns.max())), 2),
        "largest_turn_joint": JOINTS[int(turns.argmax())],
        "distance_m": round(float(np.linalg.norm(np.array(given.pose[:3]) - state.tool_vector_actual[:3])), 4),
        "in_box": None,
    }
    if robot.limits is not None and robot.limits.box is not None:
        try:
            robot.limits.check_places(np.array([given.pose[:3]]))
            said["in_box"] = True
        except LimitExceeded as error:
            said |= {"in_box": False, "reason": str(error)}
    return said


def _program(robot: Robot, given: OfRobot) -> dict[str, Any]:
    """Each value is asked for alone, because older dashboards lack some of them."""
    dashboard = robot.dashboard
    asked: Mapping[str, Callable[[], Any]] = {
        "running": dashboard.running,
        "state": dashboard.program_state,
        "loaded": dashboard.loaded_program,
        "remote_control": dashboard.is_in_remote_control,
    }
    said: dict[str, Any] = {}
    for name, ask in asked.items():
        try:
            value = ask()
            said[name] = value if value is None or isinstance(value, bool) else str(getattr(value, "name", value))
        except LinkError as error:
            said[name] = None
            said[f"{name}_error"] = str(error)
    return said


def _limits(robot: Robot, given: OfRobot) -> dict[str, Any]:
    limits = robot.limits
    if limits is None:
        return {"limits": None, "text": "this session has no limits"}
    return {
        "limits": {
            "tool_speed_m_s": limits.tool_speed,
            "joint_speed_rad_s": limits.joint_speed,
            "box_m": limits.box,
            "speed_slider": limits.speed_slider,
            "allowed": sorted(limits.allowed),
        }
    }


#: Name of a tool, its arguments, its description, and the function that reads the values.
READINGS: dict[str, tuple[type[OfRobot], str, Callable[[Robot, OfRobot], dict[str, Any]]]] = {
    "get_state": (
        OfRobot,
        "State of the robot now: joint positions, pose of the tool, modes, inputs and outputs, and the reason why "
        "motions are refused, if they are.",
        _state,
    ),
    "explain_stop": (
        OfRobot,
        "Why the robot stopped: the kind of the stop, its most likely cause with the evidence, and what to do.",
        _explanation,
    ),
    "list_points": (OfRobot, "Taught points by name, and whether the arm reaches them with its current TCP.", _points),
    "check_pose": (
        CheckPose,
        "Whether the tool can reach a pose, the joint positions there, and whether the pose is in the box of the "
        "session. The path to the pose is not checked, and neither are collisions.",
        _checked_pose,
    ),
    "get_program": (OfRobot, "The program on the controller: its name, its state, and remote control.", _program),
    "get_limits": (OfRobot, "Limits of this session. Requests beyond them are refused.", _limits),
}


def _rounded(values: Any, digits: int = 5) -> list[float]:
    return [round(float(each), digits) for each in values]


def _bits(bits: int) -> dict[str, list[bool]]:
    return {
        name: [bool(bits >> (first + number) & 1) for number in range(count)] for name, (count, first) in _BANKS.items()
    }

"""Description of a robot in JSON: its identity, the layout of its packets, and its current status."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np

from urlink import Robot
from urlink.packets import RealtimeState

__all__ = ["described", "json_of", "status_of"]


def json_of(value: Any) -> bytes:
    """Encode as JSON that every parser accepts: NaN and infinity become null."""
    return json.dumps(_finite(value), allow_nan=False).encode()


def _finite(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: _finite(element) for key, element in value.items()}
    return [_finite(element) for element in value] if isinstance(value, (list, tuple)) else value


def described(robot: Robot) -> dict[str, Any]:
    """Describe the robot, and the offset of each field in a packet of its real-time interface.

    With this description, a client can read the packets without this library. Numbers are big-endian, and `type` is
    a type string of numpy.
    """
    identity = robot.identity
    version = str(identity.firmware)
    dtype = RealtimeState.dtype(version)
    fields = [
        {
            "name": name,
            "offset": offset,
            "type": of.base.str,
            "count": int(np.prod(of.shape, dtype=int)),
            "unit": RealtimeState.FIELDS[name].unit if name in RealtimeState.FIELDS else "",
        }
        for name, (of, offset, *_) in (dtype.fields or {}).items()
    ]
    return {
        "address": robot.address,
        "recording": identity.description(),
        "model": identity.model,
        "firmware": version,
        "rate": identity.firmware.rate,
        "realtime": {"size": dtype.itemsize, "fields": fields},
    }


def status_of(robot: Robot, is_commanded: bool) -> dict[str, Any]:
    """Return the current status of the robot; `age` is in s, since its last state arrived."""
    state: RealtimeState | None = robot.realtime.latest
    said: dict[str, Any] = {"connection": robot.realtime.connection.value, "age": None}
    refusal = robot.safety.refusal if is_commanded else None
    said["refusal"] = None if refusal is None else str(refusal)
    if state is not None and state.received is not None:
        said |= {
            "age": state.received.age,
            "time": state.received.wall,
            "q": state.q_actual,
            "qd": state.qd_actual,
            "pose": state.tool_vector_actual,
            "force": state.tcp_force,
            "robot_mode": _name(state.robot_mode),
            "safety_mode": _name(state.safety_mode),
            "program_state": _name(state.program_state),
            "speed_scaling": state.speed_scaling,
            "digital_inputs": state.digital_input_bits,
            "digital_outputs": state.digital_output_bits,
        }
    return said


def _name(code: Any) -> str | None:
    return None if code is None else str(code.name)

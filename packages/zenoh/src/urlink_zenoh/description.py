"""What is told of a robot in JSON: who it is and how its packets are laid out, and how it is at the moment."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np

from urlink import Robot
from urlink.packets import RealtimeState

__all__ = ["described", "json_of", "status_of"]


def json_of(value: Any) -> bytes:
    """JSON that any parser takes: what is no number is null."""
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
    """Who the robot is, and where in a packet of its real-time interface each field lies.

    With that, the packets can be read without this library: numbers are big-endian, `type` is that of numpy.
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
    """How the robot is; `age` says for how long nothing has been heard of it."""
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

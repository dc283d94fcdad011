"""Functions that a controller has and this one does not act on: a program with them compiles, and stops there.

What is to be modelled moves from here into the family to which it belongs. Since when a controller has each is left
open, save for what CB2 certainly has not.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ..errors import Fault
from ..machine import ScriptThread
from .declaration import Family

__all__ = ["FAMILY"]

FAMILY = Family()

_FORCE = [
    "direct_torque",
    "enable_external_ft_sensor",
    "end_force_mode",
    "end_freedrive_mode",
    "end_teach_mode",
    "force_mode",
    "force_mode_set_damping",
    "force_mode_set_gain_scaling",
    "freedrive_mode",
    "ft_rtde_input_enable",
    "get_freedrive_status",
    "set_friction_compensation",
    "set_friction_scales",
    "teach_mode",
    "tool_contact",
    "zero_ftsensor",
]
_PATHS = ["optimovej", "optimovel"]
_STATE = [
    "get_coriolis_and_centrifugal_torques",
    "get_jacobian",
    "get_jacobian_time_derivative",
    "get_mass_matrix",
    "get_target_joint_accelerations",
    "get_target_payload_inertia",
    "get_target_tcp_speed",
    "get_target_waypoint",
]
_REGISTERS = [
    "rtde_set_watchdog",
    *(
        f"{verb}_{kind}_register"
        for verb in ("read_input", "read_output", "write_output")
        for kind in ("boolean", "integer", "float")
    ),
]


def _unmodelled(name: str, what: str) -> Callable[..., Any]:
    def stop(thread: ScriptThread, *arguments: Any) -> None:
        raise Fault(f"{name}: {what} not modelled by this simulator")

    return stop


for _names, _what in (
    (_FORCE, "force control is"),
    (_PATHS, "optimised paths are"),
    (_REGISTERS, "RTDE registers are"),
    (_STATE, "this is"),
):
    for _name in _names:
        FAMILY.declare(name=_name, since="1.0" if _name in ("force_mode", "end_force_mode") else "3.0")(
            _unmodelled(_name, _what)
        )

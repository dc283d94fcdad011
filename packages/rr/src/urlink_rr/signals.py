"""Inputs and outputs by the names of signals, such as ``digital_out_3``, ``tool_digital_in_0`` or ``analog_out_1``."""

from __future__ import annotations

import re
from collections.abc import Sequence

from urlink import BadValue, Robot

__all__ = ["read_signal", "write_signal"]

_NAME = re.compile(
    r"(digital|configurable_digital|tool_digital|analog|tool_analog)_(in|out)_(\d+)|(tool_voltage|speed_slider)"
)


def read_signal(robot: Robot, name: str) -> list[float]:
    """Read a signal: 0 or 1 of a digital signal, A or V of an analogue one.

    Raises:
        BadValue: If the signal does not exist or cannot be read.
        LinkError: If the robot does not report it.
    """
    kind, direction, number, other = _parts(name)
    if other == "tool_voltage":
        return [float(robot.io.tool_voltage)]
    if other is not None or (kind, direction) == ("tool_analog", "out"):
        raise BadValue(f"{name} cannot be read; it can only be set")
    value = getattr(robot.io, f"{kind}_{direction}")(number)
    return [float(value.value if kind.endswith("analog") else value)]


def write_signal(robot: Robot, name: str, values: Sequence[float]) -> None:
    """Set an output: a digital output to 0 or 1, an analogue one to a fraction of its range.

    Raises:
        BadValue: If the signal does not exist or cannot be set, or if there is not one valid number.
        LinkError: If the robot does not set it.
    """
    kind, direction, number, other = _parts(name)
    if len(values) != 1:
        raise BadValue(f"the value of {name} is {list(values)}; expected one number")
    value = float(values[0])
    if other == "speed_slider":
        robot.set_speed_slider(value)
    elif other == "tool_voltage":
        robot.io.set_tool_voltage(int(value))
    elif direction == "in" or kind == "tool_analog":
        raise BadValue(f"{name} cannot be set; expected an output")
    elif kind == "analog":
        robot.io.set_analog_out(number, value)
    elif value in (0.0, 1.0):
        getattr(robot.io, f"set_{kind}_out")(number, bool(value))
    else:
        raise BadValue(f"the value of {name} is {value}; expected 0 or 1")


def _parts(name: str) -> tuple[str, str, int, str | None]:
    match = _NAME.fullmatch(name)
    if match is None:
        raise BadValue(
            f"unknown signal {name!r}; expected a name such as digital_in_0, configurable_digital_out_0, "
            "tool_digital_in_0, analog_in_0, tool_voltage or speed_slider"
        )
    kind, direction, number, other = match.groups()
    return kind or "", direction or "", int(number or 0), other

"""Inputs, outputs and flags.

Outputs 8 and 9 of the functions without "standard", "configurable" or "tool" in their names are the tool's, as in the
manuals of CB2 and CB3. An analogue output is set as a fraction of its range: 4 to 20 mA or 0 to 10 V.
"""

from __future__ import annotations

from typing import Any

from ...robot.signals import ToolCommunication
from ..errors import Fault
from ..machine import ScriptThread
from .declaration import Family, boolean, integer, number

__all__ = ["FAMILY"]

FAMILY = Family()

_CONFIGURABLE, _TOOL = 8, 16


def _old_number(n: Any, what: str) -> int:
    at = integer(n, what, 0, 9)
    return at if at < 8 else at - 8 + _TOOL


def _output(thread: ScriptThread, at: int, b: Any, what: str) -> None:
    thread.world.signals.set_digital_output(at, boolean(b, what))


def _bit(mask: int, at: int) -> bool:
    return bool(mask >> at & 1)


@FAMILY.declare()
def set_digital_out(thread: ScriptThread, n: Any, b: Any) -> None:
    _output(thread, _old_number(n, "set_digital_out: n"), b, "set_digital_out: b")


@FAMILY.declare()
def get_digital_out(thread: ScriptThread, n: Any) -> bool:
    return _bit(thread.world.signals.digital_outputs, _old_number(n, "get_digital_out: n"))


@FAMILY.declare()
def get_digital_in(thread: ScriptThread, n: Any) -> bool:
    return _bit(thread.world.signals.digital_inputs, _old_number(n, "get_digital_in: n"))


@FAMILY.declare(since="3.0")
def set_standard_digital_out(thread: ScriptThread, n: Any, b: Any) -> None:
    _output(thread, integer(n, "set_standard_digital_out: n", 0, 7), b, "set_standard_digital_out: b")


@FAMILY.declare(since="3.0")
def get_standard_digital_out(thread: ScriptThread, n: Any) -> bool:
    return _bit(thread.world.signals.digital_outputs, integer(n, "get_standard_digital_out: n", 0, 7))


@FAMILY.declare(since="3.0")
def get_standard_digital_in(thread: ScriptThread, n: Any) -> bool:
    return _bit(thread.world.signals.digital_inputs, integer(n, "get_standard_digital_in: n", 0, 7))


@FAMILY.declare(since="3.0")
def set_configurable_digital_out(thread: ScriptThread, n: Any, b: Any) -> None:
    at = integer(n, "set_configurable_digital_out: n", 0, 7) + _CONFIGURABLE
    _output(thread, at, b, "set_configurable_digital_out: b")


@FAMILY.declare(since="3.0")
def get_configurable_digital_out(thread: ScriptThread, n: Any) -> bool:
    at = integer(n, "get_configurable_digital_out: n", 0, 7) + _CONFIGURABLE
    return _bit(thread.world.signals.digital_outputs, at)


@FAMILY.declare(since="3.0")
def get_configurable_digital_in(thread: ScriptThread, n: Any) -> bool:
    at = integer(n, "get_configurable_digital_in: n", 0, 7) + _CONFIGURABLE
    return _bit(thread.world.signals.digital_inputs, at)


@FAMILY.declare(since="3.0")
def set_tool_digital_out(thread: ScriptThread, n: Any, b: Any) -> None:
    _output(thread, integer(n, "set_tool_digital_out: n", 0, 1) + _TOOL, b, "set_tool_digital_out: b")


@FAMILY.declare(since="3.0")
def get_tool_digital_out(thread: ScriptThread, n: Any) -> bool:
    return _bit(thread.world.signals.digital_outputs, integer(n, "get_tool_digital_out: n", 0, 1) + _TOOL)


@FAMILY.declare(since="3.0")
def get_tool_digital_in(thread: ScriptThread, n: Any) -> bool:
    return _bit(thread.world.signals.digital_inputs, integer(n, "get_tool_digital_in: n", 0, 1) + _TOOL)


@FAMILY.declare()
def get_analog_in(thread: ScriptThread, n: Any) -> float:
    """A or V; 0 and 1 are of the control box, 2 and 3 of the tool."""
    return thread.world.signals.analog_inputs[integer(n, "get_analog_in: n", 0, 3)]


@FAMILY.declare(since="3.0")
def get_standard_analog_in(thread: ScriptThread, n: Any) -> float:
    return thread.world.signals.analog_inputs[integer(n, "get_standard_analog_in: n", 0, 1)]


@FAMILY.declare(since="3.0")
def get_tool_analog_in(thread: ScriptThread, n: Any) -> float:
    return thread.world.signals.analog_inputs[integer(n, "get_tool_analog_in: n", 0, 1) + 2]


def _set_analog(thread: ScriptThread, n: Any, f: Any, what: str) -> None:
    at, level = integer(n, f"{what}: n", 0, 1), number(f, f"{what}: f")
    if not 0 <= level <= 1:
        raise Fault(f"{what}: f is from 0 to 1, not {level:g}")
    thread.world.signals.set_analog_fraction(at, level)


def _get_analog(thread: ScriptThread, n: Any, what: str) -> float:
    at, signals = integer(n, f"{what}: n", 0, 1), thread.world.signals
    value = signals.analog_outputs[at]
    return value / 10.0 if signals.analog_output_domains[at] else (value - 0.004) / 0.016


@FAMILY.declare()
def set_analog_out(thread: ScriptThread, n: Any, f: Any) -> None:
    _set_analog(thread, n, f, "set_analog_out")


@FAMILY.declare()
def get_analog_out(thread: ScriptThread, n: Any) -> float:
    return _get_analog(thread, n, "get_analog_out")


@FAMILY.declare(since="3.0")
def set_standard_analog_out(thread: ScriptThread, n: Any, f: Any) -> None:
    _set_analog(thread, n, f, "set_standard_analog_out")


@FAMILY.declare(since="3.0")
def get_standard_analog_out(thread: ScriptThread, n: Any) -> float:
    return _get_analog(thread, n, "get_standard_analog_out")


@FAMILY.declare()
def set_analog_outputdomain(thread: ScriptThread, port: Any, domain: Any) -> None:
    """0 current, 1 voltage; the output keeps its fraction of the range (a guess)."""
    at = integer(port, "set_analog_outputdomain: port", 0, 1)
    level = _get_analog(thread, at, "set_analog_outputdomain")
    thread.world.signals.analog_output_domains[at] = integer(domain, "set_analog_outputdomain: domain", 0, 1)
    _set_analog(thread, at, min(max(level, 0.0), 1.0), "set_analog_outputdomain")


def _set_range(thread: ScriptThread, at: int, domain: Any, what: str) -> None:
    thread.world.signals.analog_input_ranges[at] = integer(domain, what, 0, 1)


@FAMILY.declare(since="3.0")
def set_standard_analog_input_domain(thread: ScriptThread, port: Any, domain: Any) -> None:
    at = integer(port, "set_standard_analog_input_domain: port", 0, 1)
    _set_range(thread, at, domain, "set_standard_analog_input_domain: domain")


@FAMILY.declare(since="3.0")
def set_tool_analog_input_domain(thread: ScriptThread, port: Any, domain: Any) -> None:
    at = integer(port, "set_tool_analog_input_domain: port", 0, 1) + 2
    _set_range(thread, at, domain, "set_tool_analog_input_domain: domain")


@FAMILY.declare()
def set_tool_voltage(thread: ScriptThread, voltage: Any) -> None:
    volts = integer(voltage, "set_tool_voltage: voltage", 0, 24)
    if volts not in (0, 12, 24):
        raise Fault(f"set_tool_voltage: voltage is 0, 12 or 24, not {volts}")
    thread.world.signals.tool_output_voltage = volts


@FAMILY.declare(since="5.2")
def set_tool_output_mode(thread: ScriptThread, mode: Any) -> None:
    """0: digital outputs; 1: both pins are power."""
    thread.world.signals.tool_output_mode = integer(mode, "set_tool_output_mode: mode", 0, 1)


@FAMILY.declare(since="5.2")
def set_tool_digital_output_mode(thread: ScriptThread, n: Any, mode: Any) -> None:
    """1 sinking, 2 sourcing, 3 push-pull."""
    at = integer(n, "set_tool_digital_output_mode: n", 0, 1)
    modes = thread.world.signals.tool_digital_output_modes
    modes[at] = integer(mode, "set_tool_digital_output_mode: mode", 1, 3)


@FAMILY.declare(since="5.0")
def set_tool_communication(
    thread: ScriptThread,
    enabled: Any,
    baud_rate: Any,
    parity: Any,
    stop_bits: Any,
    rx_idle_chars: Any,
    tx_idle_chars: Any,
) -> None:
    """The serial line of the tool connector; the settings are shown, and nothing is connected."""
    what = "set_tool_communication"
    thread.world.signals.tool_communication = ToolCommunication(
        boolean(enabled, f"{what}: enabled"),
        integer(baud_rate, f"{what}: baud_rate", 1),
        integer(parity, f"{what}: parity", 0, 2),
        integer(stop_bits, f"{what}: stop_bits", 1, 2),
        number(rx_idle_chars, f"{what}: rx_idle_chars"),
        number(tx_idle_chars, f"{what}: tx_idle_chars"),
    )


# Actions of inputs, and how fast the arm changes between the limits of two safety modes. Arguments are checked, without
# effect: no input has an action here, and there is one set of limits.


@FAMILY.declare()
def set_analog_inputrange(thread: ScriptThread, port: Any, range: Any) -> None:
    """Of older controllers: 0 and 1 of the control box have four ranges. Without effect: values here are in V."""
    integer(port, "set_analog_inputrange: port", 0, 3)
    integer(range, "set_analog_inputrange: range", 0, 3)


@FAMILY.declare(since="3.0")
def set_input_actions_to_default(thread: ScriptThread) -> None:
    return None


@FAMILY.declare(since="3.0")
def set_safety_mode_transition_hardness(thread: ScriptThread, type: Any) -> None:
    """0: hard, with the largest acceleration; 1: soft."""
    integer(type, "set_safety_mode_transition_hardness: type", 0, 1)


@FAMILY.declare()
def set_flag(thread: ScriptThread, n: Any, b: Any) -> None:
    flags = thread.world.flags
    flags[integer(n, "set_flag: n", 0, len(flags) - 1)] = boolean(b, "set_flag: b")


@FAMILY.declare()
def get_flag(thread: ScriptThread, n: Any) -> bool:
    flags = thread.world.flags
    return flags[integer(n, "get_flag: n", 0, len(flags) - 1)]

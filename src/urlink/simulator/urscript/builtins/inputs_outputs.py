"""Functions for inputs, outputs and flags.

In a function whose name does not contain "standard", "configurable" or "tool", numbers 8 and 9 select the tool, as in
the manuals of CB2 and CB3. An analogue output is set as a fraction of its range, which is 4 to 20 mA or 0 to 10 V.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from ...robot.signals import ToolCommunication
from ..errors import Fault
from ..machine import ScriptThread
from .declaration import boolean, declare, integer, number, number_within

#: Part of the function names -> bits of the signals, and first firmware with these functions.
_DIGITAL: dict[str, tuple[Sequence[int], str]] = {
    "": ((*range(8), 16, 17), "1.0"),
    "standard_": (range(8), "3.0"),
    "configurable_": (range(8, 16), "3.0"),
    "tool_": (range(16, 18), "3.0"),
}


def _digital_setter(name: str, bits: Sequence[int]) -> Callable[..., None]:
    def write(thread: ScriptThread, n: Any, b: Any) -> None:
        at = bits[integer(n, f"{name}: n", 0, len(bits) - 1)]
        thread.world.signals.set_digital_output(at, boolean(b, f"{name}: b"))

    return write


def _digital_getter(name: str, bits: Sequence[int], is_input: bool) -> Callable[..., bool]:
    def read(thread: ScriptThread, n: Any) -> bool:
        signals = thread.world.signals
        mask = signals.digital_inputs if is_input else signals.digital_outputs
        at = bits[integer(n, f"{name}: n", 0, len(bits) - 1)]
        return bool(mask >> at & 1)

    return read


for _kind, (_bits, _since) in _DIGITAL.items():
    _name = f"set_{_kind}digital_out"
    declare(name=_name, since=_since)(_digital_setter(_name, _bits))
    for _direction in ("in", "out"):
        _name = f"get_{_kind}digital_{_direction}"
        declare(name=_name, since=_since)(_digital_getter(_name, _bits, is_input=_direction == "in"))


@declare()
def get_analog_in(thread: ScriptThread, n: Any) -> float:
    """Return an analogue input in A or V. Inputs 0 and 1 are in the control box, 2 and 3 are in the tool."""
    return thread.world.signals.analog_inputs[integer(n, "get_analog_in: n", 0, 3)]


@declare(since="3.0")
def get_standard_analog_in(thread: ScriptThread, n: Any) -> float:
    return thread.world.signals.analog_inputs[integer(n, "get_standard_analog_in: n", 0, 1)]


@declare(since="3.0")
def get_tool_analog_in(thread: ScriptThread, n: Any) -> float:
    return thread.world.signals.analog_inputs[integer(n, "get_tool_analog_in: n", 0, 1) + 2]


def _set_analog(thread: ScriptThread, n: Any, f: Any, what: str) -> None:
    at = integer(n, f"{what}: n", 0, 1)
    thread.world.signals.set_analog_fraction(at, number_within(f, f"{what}: f", 0, 1))


def _get_analog(thread: ScriptThread, n: Any, what: str) -> float:
    at, signals = integer(n, f"{what}: n", 0, 1), thread.world.signals
    value = signals.analog_outputs[at]
    return value / 10.0 if signals.analog_output_domains[at] else (value - 0.004) / 0.016


@declare()
def set_analog_out(thread: ScriptThread, n: Any, f: Any) -> None:
    _set_analog(thread, n, f, "set_analog_out")


@declare()
def get_analog_out(thread: ScriptThread, n: Any) -> float:
    return _get_analog(thread, n, "get_analog_out")


@declare(since="3.0")
def set_standard_analog_out(thread: ScriptThread, n: Any, f: Any) -> None:
    _set_analog(thread, n, f, "set_standard_analog_out")


@declare(since="3.0")
def get_standard_analog_out(thread: ScriptThread, n: Any) -> float:
    return _get_analog(thread, n, "get_standard_analog_out")


@declare()
def set_analog_outputdomain(thread: ScriptThread, port: Any, domain: Any) -> None:
    """Set the domain of an output: 0 current, 1 voltage. The output keeps its fraction of the range (assumed)."""
    at = integer(port, "set_analog_outputdomain: port", 0, 1)
    level = _get_analog(thread, at, "set_analog_outputdomain")
    thread.world.signals.analog_output_domains[at] = integer(domain, "set_analog_outputdomain: domain", 0, 1)
    _set_analog(thread, at, min(max(level, 0.0), 1.0), "set_analog_outputdomain")


@declare(since="3.0")
def set_standard_analog_input_domain(thread: ScriptThread, port: Any, domain: Any) -> None:
    at = integer(port, "set_standard_analog_input_domain: port", 0, 1)
    thread.world.signals.analog_input_ranges[at] = integer(domain, "set_standard_analog_input_domain: domain", 0, 1)


@declare(since="3.0")
def set_tool_analog_input_domain(thread: ScriptThread, port: Any, domain: Any) -> None:
    at = integer(port, "set_tool_analog_input_domain: port", 0, 1) + 2
    thread.world.signals.analog_input_ranges[at] = integer(domain, "set_tool_analog_input_domain: domain", 0, 1)


@declare()
def set_tool_voltage(thread: ScriptThread, voltage: Any) -> None:
    volts = integer(voltage, "set_tool_voltage: voltage", 0, 24)
    if volts not in (0, 12, 24):
        raise Fault(f"set_tool_voltage: voltage is {volts}; expected 0, 12 or 24")
    thread.world.signals.tool_output_voltage = volts


@declare(since="5.2")
def set_tool_output_mode(thread: ScriptThread, mode: Any) -> None:
    """Set the mode of the tool outputs: 0 digital outputs; 1 both pins supply power."""
    thread.world.signals.tool_output_mode = integer(mode, "set_tool_output_mode: mode", 0, 1)


@declare(since="5.2")
def set_tool_digital_output_mode(thread: ScriptThread, n: Any, mode: Any) -> None:
    """Set the mode of a digital tool output: 1 sinking, 2 sourcing, 3 push-pull."""
    at = integer(n, "set_tool_digital_output_mode: n", 0, 1)
    modes = thread.world.signals.tool_digital_output_modes
    modes[at] = integer(mode, "set_tool_digital_output_mode: mode", 1, 3)


@declare(since="5.0")
def set_tool_communication(
    thread: ScriptThread,
    enabled: Any,
    baud_rate: Any,
    parity: Any,
    stop_bits: Any,
    rx_idle_chars: Any,
    tx_idle_chars: Any,
) -> None:
    """Configure the serial line of the tool connector.

    The interfaces report these settings. They have no other effect.
    """
    what = "set_tool_communication"
    thread.world.signals.tool_communication = ToolCommunication(
        boolean(enabled, f"{what}: enabled"),
        integer(baud_rate, f"{what}: baud_rate", 1),
        integer(parity, f"{what}: parity", 0, 2),
        integer(stop_bits, f"{what}: stop_bits", 1, 2),
        number(rx_idle_chars, f"{what}: rx_idle_chars"),
        number(tx_idle_chars, f"{what}: tx_idle_chars"),
    )


# The following functions set the actions of inputs, and the speed of a change between the limits of two safety modes.
# Their arguments are checked, but have no effect: simulated inputs have no actions, and there is only one set of
# limits.


@declare()
def set_analog_inputrange(thread: ScriptThread, port: Any, range: Any) -> None:
    """Check the arguments; this function has no effect, because tests set the inputs directly in A or V.

    On older controllers, inputs 0 and 1 (in the control box) have four ranges.
    """
    integer(port, "set_analog_inputrange: port", 0, 3)
    integer(range, "set_analog_inputrange: range", 0, 3)


@declare(since="3.0")
def set_input_actions_to_default(thread: ScriptThread) -> None:
    return None


@declare(since="3.0")
def set_safety_mode_transition_hardness(thread: ScriptThread, type: Any) -> None:
    """Check the argument: 0 is a hard change with the maximum acceleration, 1 is a soft change."""
    integer(type, "set_safety_mode_transition_hardness: type", 0, 1)


@declare()
def set_flag(thread: ScriptThread, n: Any, b: Any) -> None:
    flags = thread.world.flags
    flags[integer(n, "set_flag: n", 0, len(flags) - 1)] = boolean(b, "set_flag: b")


@declare()
def get_flag(thread: ScriptThread, n: Any) -> bool:
    flags = thread.world.flags
    return flags[integer(n, "get_flag: n", 0, len(flags) - 1)]

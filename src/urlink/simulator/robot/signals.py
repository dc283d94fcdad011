"""The digital and analogue inputs and outputs of control box and tool."""

from __future__ import annotations

import math
from typing import NamedTuple

from linkcore.errors import BadValue

__all__ = ["Signals", "ToolCommunication"]


class ToolCommunication(NamedTuple):
    """The serial line through the tool connector. The initial values are those of the captures: not enabled.

    Attributes:
        is_enabled: whether it is in use.
        baud_rate: Bd.
        parity: 0 none, 1 odd, 2 even.
        stop_bits: 1 or 2.
        rx_idle_chars, tx_idle_chars: characters.
    """

    is_enabled: bool = False
    baud_rate: int = 115200
    parity: int = 0
    stop_bits: int = 1
    rx_idle_chars: float = 1.5
    tx_idle_chars: float = 3.5


class Signals:
    """The inputs and outputs; all can be read and set.

    Attributes:
        digital_inputs: bit mask; see `urlink.interfaces.enums.DigitalBits`.
        digital_outputs: bit mask.
        analog_inputs: four values: 0 and 1 of the control box, 2 and 3 of the tool; A or V, as `analog_input_ranges`.
        analog_outputs: two values, A or V, as `analog_output_domains`.
        analog_input_ranges: four times 0 (current) or 1 (voltage).
        analog_output_domains: twice 0 (current) or 1 (voltage).
        tool_output_voltage: 0, 12 or 24 V.
        tool_output_mode: of an e-Series: 0 digital outputs, 1 both pins are power.
        tool_digital_output_modes: twice 1 sinking, 2 sourcing or 3 push-pull.
        tool_communication: the serial line through the tool connector.
    """

    def __init__(self) -> None:
        # What controllers show with nothing connected: 4 mA, the live zero of a current output, is on the bytes of
        # two simulated e-Series controllers.
        self.digital_inputs = 0
        self.digital_outputs = 0
        self.analog_inputs = [0.0, 0.0, 0.0, 0.0]
        self.analog_outputs = [0.004, 0.004]
        self.analog_input_ranges = [1, 1, 1, 1]
        self.analog_output_domains = [0, 0]
        self.tool_output_voltage = 0
        self.tool_output_mode = 0
        self.tool_digital_output_modes = [1, 1]
        self.tool_communication = ToolCommunication()

    def set_digital_input(self, number: int, on: bool) -> None:
        """Switch input `number`, 0 to 17: 0-7 standard, 8-15 configurable, 16-17 tool.

        Raises:
            BadValue: there is no such input.
        """
        self.digital_inputs = _switched(self.digital_inputs, number, on)

    def set_digital_output(self, number: int, on: bool) -> None:
        """Switch output `number`, 0 to 17: 0-7 standard, 8-15 configurable, 16-17 tool.

        Raises:
            BadValue: there is no such output.
        """
        self.digital_outputs = _switched(self.digital_outputs, number, on)

    def set_analog_input(self, number: int, value: float) -> None:
        """Put `value`, A or V, on analogue input 0 to 3.

        Raises:
            BadValue: there is no such input, or the value is not finite.
        """
        if number not in range(4) or not math.isfinite(value):
            raise BadValue(f"analogue inputs 0 to 3 take a finite value, not {number!r} {value!r}")
        self.analog_inputs[number] = float(value)

    def set_analog_output(self, number: int, value: float) -> None:
        """Set analogue output 0 or 1 to `value`, A or V.

        Raises:
            BadValue: there is no such output, or the value is not finite.
        """
        if number not in range(2) or not math.isfinite(value):
            raise BadValue(f"analogue outputs 0 and 1 take a finite value, not {number!r} {value!r}")
        self.analog_outputs[number] = float(value)

    def set_analog_fraction(self, number: int, fraction: float) -> None:
        """Set analogue output 0 or 1 to a fraction, 0 to 1, of its range: 4 to 20 mA or 0 to 10 V."""
        is_voltage = self.analog_output_domains[number]
        self.set_analog_output(number, fraction * 10.0 if is_voltage else 0.004 + fraction * 0.016)


def _switched(mask: int, number: int, on: bool) -> int:
    if number not in range(18):
        raise BadValue(f"digital signals are numbered 0 to 17, not {number!r}")
    return mask | 1 << number if on else mask & ~(1 << number)

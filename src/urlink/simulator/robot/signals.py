"""Inputs and outputs of a simulated controller: digital, analogue, and Modbus signals.

A program adds a Modbus signal, reads or sets it, and reads its errors. A test sets its value and its errors. There is
no bus behind it. It is assumed that signals persist after the program that added them, and that a signal is valid when
it is added.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from linkcore.errors import BadValue
from linkcore.names import StrictAttributes


class ToolCommunication(NamedTuple):
    """Serial line through the tool connector.

    The initial values are from captures: not enabled.

    Attributes:
        is_enabled: Whether the line is in use.
        baud_rate: Baud rate, in Bd.
        parity: Parity: 0 none, 1 odd, 2 even.
        stop_bits: Number of stop bits, 1 or 2.
        rx_idle_chars, tx_idle_chars: Idle times, in characters.
    """

    is_enabled: bool = False
    baud_rate: int = 115200
    parity: int = 0
    stop_bits: int = 1
    rx_idle_chars: float = 1.5
    tx_idle_chars: float = 3.5


class Signals(StrictAttributes):
    """Inputs and outputs; all can be read and set.

    Attributes:
        digital_inputs: Bit mask of the inputs; see `urlink.protocol.enums.DigitalBits`.
        digital_outputs: Bit mask of the outputs.
        analog_inputs: Four values, 0 and 1 of the control box, 2 and 3 of the tool, in A or V; see
            `analog_input_ranges`.
        analog_outputs: Two values, in A or V; see `analog_output_domains`.
        analog_input_ranges: Four numbers, each 0 (current) or 1 (voltage).
        analog_output_domains: Two numbers, each 0 (current) or 1 (voltage).
        tool_output_voltage: Voltage of the tool, 0, 12 or 24 V.
        tool_output_mode: Mode of the tool outputs of an e-Series: 0 digital outputs, 1 both pins supply power.
        tool_digital_output_modes: Two numbers, each 1 (sinking), 2 (sourcing) or 3 (push-pull).
        tool_communication: Serial line through the tool connector.
    """

    def __init__(self) -> None:
        # Values of controllers with nothing connected. 4 mA is the live zero of a current output; two simulated
        # e-Series controllers send it.
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
            BadValue: If there is no such input.
        """
        self.digital_inputs = _switched(self.digital_inputs, number, on)

    def set_digital_output(self, number: int, on: bool) -> None:
        """Switch output `number`, 0 to 17: 0-7 standard, 8-15 configurable, 16-17 tool.

        Raises:
            BadValue: If there is no such output.
        """
        self.digital_outputs = _switched(self.digital_outputs, number, on)

    def set_analog_input(self, number: int, value: float) -> None:
        """Set analogue input 0 to 3 to `value`, in A or V.

        Raises:
            BadValue: If there is no such input, or the value is not finite.
        """
        if number not in range(4) or not math.isfinite(value):
            raise BadValue(
                f"analogue input {number!r} cannot be set to {value!r}; expected input 0 to 3 and a finite value"
            )
        self.analog_inputs[number] = float(value)

    def set_analog_output(self, number: int, value: float) -> None:
        """Set analogue output 0 or 1 to `value`, in A or V.

        Raises:
            BadValue: If there is no such output, or the value is not finite.
        """
        if number not in range(2) or not math.isfinite(value):
            raise BadValue(
                f"analogue output {number!r} cannot be set to {value!r}; expected output 0 or 1 and a finite value"
            )
        self.analog_outputs[number] = float(value)

    def set_analog_fraction(self, number: int, fraction: float) -> None:
        """Set analogue output 0 or 1 to a fraction, 0 to 1, of its range: 4 to 20 mA or 0 to 10 V."""
        is_voltage = self.analog_output_domains[number]
        self.set_analog_output(number, fraction * 10.0 if is_voltage else 0.004 + fraction * 0.016)


def _switched(mask: int, number: int, on: bool) -> int:
    if number not in range(18):
        raise BadValue(f"there is no digital signal {number!r}; expected 0 to 17")
    return mask | 1 << number if on else mask & ~(1 << number)


#: 0 or 1, 0 to 65535, or several of the latter.
Value = int | tuple[int, ...]

#: Names of the types 0 to 3 of `modbus_add_signal`, and of the registers of `modbus_add_rw_signal` (function code 23).
KINDS = ("digital input", "digital output", "register input", "register output", "list of registers")
READ_AND_WRITE = 4
#: Maximum value of a register.
_HIGHEST = 65535


@dataclass
class ModbusSignal:
    """One signal that a program has added.

    Attributes:
        host: Address of the device.
        slave, address: Address of the signal in the device.
        kind: Type: 0 digital input, 1 digital output, 2 register input, 3 register output, 4 registers to read and
            other registers to write.
        value: Value: 0 or 1, or 0 to 65535. It is a tuple of these for a signal of several bits or registers, which
            kind 4 always is.
        written: Values of the registers that a program has written, for kind 4.
        frequency: Frequency at which a real controller would read it, in Hz.
        watchdog: Whether a failure of the signal stops programs.
        choice: State of an output while no program runs, 0 to 4.
        error: Error number; 0 for none.
        invalid_since: Time of the error on the controller's clock, in s.
    """

    host: str
    slave: int
    address: int
    kind: int
    value: Value = 0
    written: tuple[int, ...] = ()
    frequency: float = 10.0
    watchdog: bool = False
    choice: int = 0
    error: int = 0
    invalid_since: float = 0.0

    @property
    def is_digital(self) -> bool:
        """Whether the signal is on or off rather than a number."""
        return self.kind < 2

    @property
    def is_input(self) -> bool:
        """Whether the device sets the signal, so that programs cannot."""
        return self.kind in (0, 2)


class ModbusSignals(StrictAttributes, Mapping[str, Value]):
    """Signals of one controller: name -> value.

    A value can be set before a program adds the signal.

    Args:
        clock: Time of the controller, in s.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._signals: dict[str, ModbusSignal] = {}
        self._values: dict[str, Value] = {}

    def __getitem__(self, name: str) -> Value:
        signal = self._signals.get(name)
        return self._values[name] if signal is None else signal.value

    def __setitem__(self, name: str, value: int | Sequence[int]) -> None:
        """Set the value of a signal.

        The value is 0 or 1, or 0 to 65535. It is a list of these for registers that are read together.

        Raises:
            BadValue: If the signal cannot have this value.
        """
        signal = self._signals.get(name)
        highest = 1 if signal is not None and signal.is_digital else _HIGHEST
        numbers = (value,) if isinstance(value, int) else tuple(value)
        if not all(isinstance(number, int) and 0 <= number <= highest for number in numbers):
            raise BadValue(
                f"Modbus signal {name!r} cannot have the value {value!r}; expected whole numbers from 0 to {highest}"
            )
        new: Value = int(value) if isinstance(value, int) else tuple(map(int, value))
        if signal is not None and _length(signal.value) != _length(new):
            raise BadValue(f"Modbus signal {name!r} is a {KINDS[signal.kind]} and cannot be set to {value!r}")
        self._values[name] = new
        if signal is not None:
            signal.value = new

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)

    def signal(self, name: str) -> ModbusSignal | None:
        """Return the signal that a program has added under this name; None if there is none."""
        return self._signals.get(name)

    def fail(self, name: str, error: int) -> None:
        """Set the error of a signal; 0 clears it.

        Raises:
            BadValue: If there is no signal of that name.
        """
        signal = self._signals.get(name)
        if signal is None:
            raise BadValue(f"no program has added a Modbus signal {name!r}; expected the name of an added signal")
        signal.error, signal.invalid_since = error, self._clock()

    def add(self, name: str, signal: ModbusSignal) -> None:
        """Add a signal, which replaces a signal with the same name.

        If a value was set before and suits the new signal, it is kept.
        """
        old = self._values.get(name)
        if old is not None and _length(old) == _length(signal.value):
            highest = 1 if signal.is_digital else _HIGHEST
            signal.value = min(old, highest) if isinstance(old, int) else tuple(min(each, highest) for each in old)
        self._signals[name] = signal
        self._values[name] = signal.value

    def delete(self, name: str) -> bool:
        """Delete a signal; return False if there is none."""
        self._values.pop(name, None)
        return self._signals.pop(name, None) is not None

    def seconds_invalid(self, signal: ModbusSignal) -> float:
        """Return how long a signal has had an error, in s; 0 if it has none."""
        return max(self._clock() - signal.invalid_since, 0.0) if signal.error else 0.0


def _length(value: Value) -> int | None:
    """Return the number of values in a list; None for a single value."""
    return None if isinstance(value, int) else len(value)

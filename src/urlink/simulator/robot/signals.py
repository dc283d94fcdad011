"""Inputs and outputs of a simulated controller: digital and analogue signals, and Modbus signals.

A program can add a Modbus signal, read or set its value, and read its error. A test can set the value and the error of
a signal. No bus is simulated. It is assumed that a signal still exists after the program that added it has ended, and
that a signal is valid when it is added.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from linkcore.errors import BadValue
from linkcore.names import StrictAttributes


class ToolCommunication(NamedTuple):
    """Settings of the serial line in the tool connector.

    The initial values are from captures, in which the line is not enabled.

    Attributes:
        is_enabled: Whether the line is enabled.
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
    """Digital and analogue inputs and outputs. All of them can be read and set.

    Attributes:
        digital_inputs: Bit mask of the inputs; see `urlink.protocol.enums.DigitalBits`.
        digital_outputs: Bit mask of the outputs.
        analog_inputs: Four values in A or V: inputs 0 and 1 of the control box, and inputs 2 and 3 of the tool.
            `analog_input_ranges` determines the unit.
        analog_outputs: Two values in A or V. `analog_output_domains` determines the unit.
        analog_input_ranges: Four numbers, each 0 (current) or 1 (voltage).
        analog_output_domains: Two numbers, each 0 (current) or 1 (voltage).
        tool_output_voltage: Voltage of the tool, 0, 12 or 24 V.
        tool_output_mode: Mode of the tool outputs of an e-Series: 0 if they are digital outputs, 1 if both pins supply
            power.
        tool_digital_output_modes: Two numbers, each 1 (sinking), 2 (sourcing) or 3 (push-pull).
        tool_communication: Settings of the serial line in the tool connector.
    """

    def __init__(self) -> None:
        # Initial values are those of controllers without connected devices. A current output of 4 mA is the lower end
        # of its range (live zero), which two simulated e-Series controllers send.
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
        """Switch digital input `number` on or off: 0-7 standard, 8-15 configurable, 16-17 tool.

        Raises:
            BadValue: If there is no such input.
        """
        self.digital_inputs = _switched(self.digital_inputs, number, on)

    def set_digital_output(self, number: int, on: bool) -> None:
        """Switch digital output `number` on or off: 0-7 standard, 8-15 configurable, 16-17 tool.

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
        """Set analogue output 0 or 1 to a fraction (0 to 1) of its range, which is 4 to 20 mA or 0 to 10 V."""
        is_voltage = self.analog_output_domains[number]
        self.set_analog_output(number, fraction * 10.0 if is_voltage else 0.004 + fraction * 0.016)


def _switched(mask: int, number: int, on: bool) -> int:
    if number not in range(18):
        raise BadValue(f"there is no digital signal {number!r}; expected 0 to 17")
    return mask | 1 << number if on else mask & ~(1 << number)


#: Value of a signal: 0 or 1 for a bit, 0 to 65535 for a register, or a tuple of such values.
Value = int | tuple[int, ...]

#: Names of the signal types: the types 0 to 3 of `modbus_add_signal`, and type 4 for `modbus_add_rw_signal` (function
#: code 23).
KINDS = ("digital input", "digital output", "register input", "register output", "list of registers")
READ_AND_WRITE = 4
#: Maximum value of a register.
_HIGHEST = 65535


@dataclass
class ModbusSignal:
    """Modbus signal that a program has added.

    Attributes:
        host: Address of the device.
        slave, address: Address of the signal in the device.
        kind: Type of the signal: 0 digital input, 1 digital output, 2 register input, 3 register output, 4 registers to
            read and other registers to write.
        value: Value: 0 or 1 for a bit, 0 to 65535 for a register. It is a tuple of such values if the signal has
            several bits or registers, and always for kind 4.
        written: Values that a program has written to the registers of kind 4.
        frequency: Frequency at which a real controller would read the signal, in Hz.
        watchdog: Whether a failure of the signal stops programs.
        choice: State of an output while no program runs, 0 to 4.
        error: Error number; 0 for none.
        invalid_since: Time at which the error occurred, on the controller's clock, in s.
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
        """Whether the signal has bits rather than registers."""
        return self.kind < 2

    @property
    def is_input(self) -> bool:
        """Whether the signal is an input, so that programs cannot set it."""
        return self.kind in (0, 2)


class ModbusSignals(StrictAttributes, Mapping[str, Value]):
    """Modbus signals of one controller: name -> value.

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

        The value is 0 or 1 for a bit, and 0 to 65535 for a register. It is a list of such values for bits or registers
        that are read together.

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
        """Set the error number of a signal; 0 clears the error.

        Raises:
            BadValue: If there is no signal of that name.
        """
        signal = self._signals.get(name)
        if signal is None:
            raise BadValue(f"no program has added a Modbus signal {name!r}; expected the name of an added signal")
        signal.error, signal.invalid_since = error, self._clock()

    def add(self, name: str, signal: ModbusSignal) -> None:
        """Add a signal. It replaces an existing signal with the same name.

        If a value was set before under this name, and if it is valid for the new signal, the value is kept.
        """
        old = self._values.get(name)
        if old is not None and _length(old) == _length(signal.value):
            highest = 1 if signal.is_digital else _HIGHEST
            signal.value = min(old, highest) if isinstance(old, int) else tuple(min(each, highest) for each in old)
        self._signals[name] = signal
        self._values[name] = signal.value

    def delete(self, name: str) -> bool:
        """Delete a signal; return False if there is no signal with this name."""
        self._values.pop(name, None)
        return self._signals.pop(name, None) is not None

    def seconds_invalid(self, signal: ModbusSignal) -> float:
        """Return the time for which a signal has had an error, in s; 0 if it has no error."""
        return max(self._clock() - signal.invalid_since, 0.0) if signal.error else 0.0


def _length(value: Value) -> int | None:
    """Return the number of values in a list; None for a single value."""
    return None if isinstance(value, int) else len(value)

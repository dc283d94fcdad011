"""The inputs and outputs of a simulated controller: digital, analogue, and Modbus signals.

A program adds a Modbus signal, reads or sets it, and reads its errors; a test sets its value and its errors. No bus is
behind it. Guesses: that signals outlive the program that added them, and that one is valid from when it is added.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from linkcore.errors import BadValue
from linkcore.names import StrictAttributes


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


class Signals(StrictAttributes):
    """The inputs and outputs; all can be read and set.

    Attributes:
        digital_inputs: bit mask; see `urlink.protocol.enums.DigitalBits`.
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


#: 0 or 1, 0 to 65535, or a list of the latter.
Value = int | tuple[int, ...]

#: What `modbus_add_signal` calls the types 0 to 3; and the registers of `modbus_add_rw_signal`, with function code 23.
KINDS = ("digital input", "digital output", "register input", "register output", "list of registers")
READ_AND_WRITE = 4
#: Values of a register.
_HIGHEST = 65535


@dataclass
class ModbusSignal:
    """One signal, as a program has added it.

    Attributes:
        host: address of the device.
        slave, address: of the signal in it.
        kind: 0 digital input, 1 digital output, 2 register input, 3 register output, 4 registers that are read and
            others that are written.
        value: 0 or 1, or 0 to 65535; a tuple of these for a signal of several bits or registers, as kind 4 always is.
        written: numbers of the registers that a program has written, of kind 4.
        frequency: with which it would be read, Hz.
        watchdog: whether a failure of it stops programs.
        choice: state of an output while no program runs, 0 to 4.
        error: number of the error; 0 for none.
        invalid_since: s on the controller's clock at which the error came.
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
        """Whether it is on or off."""
        return self.kind < 2

    @property
    def is_input(self) -> bool:
        """Whether the device sets it, and programs cannot."""
        return self.kind in (0, 2)


class ModbusSignals(StrictAttributes, Mapping[str, Value]):
    """Name -> value of the signals of one controller. A value may be set before a program adds the signal.

    Args:
        clock: seconds of the controller.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._signals: dict[str, ModbusSignal] = {}
        self._values: dict[str, Value] = {}

    def __getitem__(self, name: str) -> Value:
        signal = self._signals.get(name)
        return self._values[name] if signal is None else signal.value

    def __setitem__(self, name: str, value: int | Sequence[int]) -> None:
        """Set the value of a signal: 0 or 1, or 0 to 65535; a list of these for registers that are read together.

        Raises:
            BadValue: the signal cannot have this value.
        """
        signal = self._signals.get(name)
        highest = 1 if signal is not None and signal.is_digital else _HIGHEST
        numbers = (value,) if isinstance(value, int) else tuple(value)
        if not all(isinstance(number, int) and 0 <= number <= highest for number in numbers):
            raise BadValue(f"Modbus signal {name!r} takes a whole number from 0 to {highest}, not {value!r}")
        new: Value = int(value) if isinstance(value, int) else tuple(map(int, value))
        if signal is not None and _length(signal.value) != _length(new):
            raise BadValue(f"Modbus signal {name!r} is a {KINDS[signal.kind]}, and takes no {value!r}")
        self._values[name] = new
        if signal is not None:
            signal.value = new

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)

    def signal(self, name: str) -> ModbusSignal | None:
        """The signal that a program has added under this name; None if there is none."""
        return self._signals.get(name)

    def fail(self, name: str, error: int) -> None:
        """Set the error of a signal; 0 ends it.

        Raises:
            BadValue: there is none of that name.
        """
        signal = self._signals.get(name)
        if signal is None:
            raise BadValue(f"no program has added a Modbus signal {name!r}")
        signal.error, signal.invalid_since = error, self._clock()

    def add(self, name: str, signal: ModbusSignal) -> None:
        """Add a signal; it replaces one with the same name, and takes over a value that was set before and fits."""
        old = self._values.get(name)
        if old is not None and _length(old) == _length(signal.value):
            highest = 1 if signal.is_digital else _HIGHEST
            signal.value = min(old, highest) if isinstance(old, int) else tuple(min(each, highest) for each in old)
        self._signals[name] = signal
        self._values[name] = signal.value

    def delete(self, name: str) -> bool:
        """Delete one; False if there is none."""
        self._values.pop(name, None)
        return self._signals.pop(name, None) is not None

    def seconds_invalid(self, signal: ModbusSignal) -> float:
        """For how long a signal has had an error, s; 0 if it has none."""
        return max(self._clock() - signal.invalid_since, 0.0) if signal.error else 0.0


def _length(value: Value) -> int | None:
    """Number of values in a list; None for a single one."""
    return None if isinstance(value, int) else len(value)

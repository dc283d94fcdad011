"""`robot.io`: the inputs and outputs of control box and tool.

Outputs are set over RTDE, or by programs that run in addition to the program that moves the arm
(`urlink.command.settings`). They are read back from the robot state, which arrives ten times a second. A new value is
therefore visible after about a tenth of a second, and a setting waits for it.
"""

from __future__ import annotations

from typing import Literal, NamedTuple, TypeVar

from linkcore.arguments import check_number
from linkcore.errors import LinkError, LinkTimeout, LocalError
from linkcore.names import StrictAttributes
from linkcore.streaming.feed import Feed
from linkcore.streaming.stream import Stream

from ..protocol.enums import AnalogDomain
from ..protocol.primary.robot_state import MasterboardData, RobotState, ToolCommunicationInfo, ToolData
from ..protocol.realtime.packets import RealtimeState
from ..script import commands
from ..script.commands import CONFIGURABLE, STANDARD, TOOL, DigitalBank
from ..script.text import boolean, integer
from .settings import Echo, Settings

T = TypeVar("T")

#: Timeout for a first state, in seconds.
_FIRST_STATE = 2.0
#: Tolerance of an analogue output, as a fraction of its range: the reported value might be a measured one.
_ANALOG = 0.02


class Analog(NamedTuple):
    """Value of an analogue signal.

    Attributes:
        value: Value in A or V.
        domain: Whether the value is a current or a voltage.
    """

    value: float
    domain: AnalogDomain


class IO(StrictAttributes):
    """Inputs and outputs by number. The numbers of each kind begin at 0.

    Setting raises these errors:

    - `BadValue` if this robot does not have the output; nothing is sent.
    - `NotRunning` if the robot is not running, or its state is unknown.
    - `NotConfirmed` if the robot does not show the new value within `confirm` seconds, for example an e-Series in local
      control.
    - `RemoteError` if the value could not be sent.

    A safety stop does not prevent setting, as long as the robot is running. ``confirm=None`` sends the value and does
    not wait. In a callback that was subscribed with ``inline=True``, `confirm` must be None; otherwise a `LocalError`
    is raised.

    Digital inputs are read from the newest state of the real-time interface, which sends 125 or 500 states a second.
    Waiting for one checks each of these states, so an input that is read after a wait is at least as new as the state
    that ended the wait. Only the primary interface reports outputs and analogue inputs, ten times a second, so these
    values can be 0.1 s old. Reading raises `LinkTimeout` if no state arrives within two seconds. Waiting raises what
    `Feed.wait_until` does.
    """

    def __init__(self, settings: Settings, primary: Stream[RobotState], realtime: Stream[RealtimeState]) -> None:
        self._settings = settings
        self._primary = primary
        self._realtime = realtime

    # -- outputs -------------------------------------------------------------------------------------

    def set_digital_out(self, number: int, on: bool, *, confirm: float | None = 1.0) -> None:
        """Switch standard digital output 0 to 7."""
        self._set_digital(STANDARD, number, on, confirm)

    def set_configurable_digital_out(self, number: int, on: bool, *, confirm: float | None = 1.0) -> None:
        """Switch configurable digital output 0 to 7; CB2 has none.

        An output that the safety configuration uses does not switch.
        """
        self._set_digital(CONFIGURABLE, number, on, confirm)

    def set_tool_digital_out(self, number: int, on: bool, *, confirm: float | None = 1.0) -> None:
        """Switch tool output 0 or 1. On CB2, it is not confirmed, because its bit in the state is uncertain."""
        self._set_digital(TOOL, number, on, confirm)

    def set_analog_out(self, number: int, fraction: float, *, confirm: float | None = 1.0) -> None:
        """Set analogue output 0 or 1 to a fraction of its range, 0 to 1: 4 to 20 mA, or 0 to 10 V.

        Assumption: the controller expects a fraction, see `urlink.script.commands`. If that is wrong on a real robot,
        the call raises `NotConfirmed`.
        """
        fraction = check_number(fraction, "fraction", 0.0, 1.0)
        text = commands.secondary(commands.analog_out(self._settings.firmware, number, fraction))

        def shown(board: MasterboardData) -> float:
            value, domain = _analog_out(board, number)
            return value / 10.0 if domain == AnalogDomain.VOLTAGE else (value - 0.004) / 0.016

        def inputs() -> dict[str, float] | None:
            board = self._primary.of(MasterboardData).latest
            if board is None:
                return None
            # RTDE sets the domain (current or voltage) along with the value, so the current domain is sent unchanged.
            types = int(board.analog_output_domain_0) | int(board.analog_output_domain_1) << 1
            return {
                "standard_analog_output_mask": 1 << number,
                "standard_analog_output_type": types,
                f"standard_analog_output_{number}": fraction,
            }

        echo = Echo(MasterboardData, shown, lambda value: abs(value - fraction) <= _ANALOG)
        self._settings.apply(text, f"analogue output {number}", echo, confirm, inputs)

    def set_tool_voltage(self, volts: int, *, confirm: float | None = 1.0) -> None:
        """Set the supply voltage of the tool: 0, 12 or 24 V."""
        echo = Echo(ToolData, lambda tool: tool.tool_output_voltage, lambda value: value == volts)
        self._settings.apply(commands.secondary(commands.tool_voltage(volts)), "the voltage of the tool", echo, confirm)

    def set_tool_communication(
        self,
        enabled: bool = True,
        *,
        baud_rate: int = 115200,
        parity: Literal["none", "odd", "even"] = "none",
        stop_bits: int = 1,
        rx_idle_chars: float = 1.5,
        tx_idle_chars: float = 3.5,
        confirm: float | None = 1.0,
    ) -> None:
        """Configure the RS485 line in the tool connector of an e-Series, which replaces the tool's analogue inputs.

        Args:
            enabled: Whether the line is in use.
            baud_rate: Rate in Bd: 9600, 19200, 38400, 57600, 115200, 1, 2 or 5 million.
            parity: Parity of each byte.
            stop_bits: Number of stop bits, 1 or 2.
            rx_idle_chars: Silence before received bytes are delivered, in characters, 1 to 40.
            tx_idle_chars: Silence before bytes are sent, in characters, 0 to 40.
            confirm: Timeout for the confirmation, in seconds; None does not wait.

        Raises:
            BadValue: If the line does not support a value. Nothing is sent.
            LocalError: If the controller does not have such a line.
            NotRunning, NotConfirmed: If the line cannot be configured; see the class.
        """
        firmware = self._settings.firmware
        rx_idle_chars = check_number(rx_idle_chars, "rx_idle_chars", 1.0, 40.0)
        tx_idle_chars = check_number(tx_idle_chars, "tx_idle_chars", 0.0, 40.0)
        if not firmware.is_e_series:
            raise LocalError(f"firmware {firmware} has no serial line in the tool connector; 5.0 or later is required")
        wanted = (enabled, baud_rate, commands.PARITIES.get(parity), stop_bits, rx_idle_chars, tx_idle_chars)
        text = commands.tool_communication(enabled, baud_rate, parity, stop_bits, rx_idle_chars, tx_idle_chars)

        def shown(info: ToolCommunicationInfo) -> tuple[float, ...]:
            line = (info.is_enabled, info.baud_rate, info.parity, info.stop_bits)
            return (*line, round(info.rx_idle_chars, 3), round(info.tx_idle_chars, 3))

        # The robot reports the idle times as 32-bit numbers.
        rounded = tuple(round(value or 0, 3) for value in wanted)
        echo = Echo(ToolCommunicationInfo, shown, lambda values: values == rounded)
        self._settings.apply(commands.secondary(text), "the tool's serial line", echo, confirm)

    def set_flag(self, number: int, on: bool) -> None:
        """Set flag 0 to 31, which programs can read, except the flag for start permissions (31, see `connect`).

        The robot does not report flags, so the value cannot be confirmed.
        """
        self._settings.flag(number, on)

    # -- reading -------------------------------------------------------------------------------------

    def digital_in(self, number: int) -> bool:
        """Standard digital input 0 to 7."""
        return self._digital_in(STANDARD, number)

    def digital_out(self, number: int) -> bool:
        """Standard digital output 0 to 7."""
        return self._digital_out(STANDARD, number)

    def wait_digital_in(self, number: int, on: bool = True, timeout: float = 5.0) -> None:
        """Wait until standard digital input 0 to 7 is on, or off; return immediately if it already is."""
        self._wait_digital_in(STANDARD, number, on, timeout)

    def wait_configurable_digital_in(self, number: int, on: bool = True, timeout: float = 5.0) -> None:
        """Wait until configurable digital input 0 to 7 is on, or off."""
        self._wait_digital_in(CONFIGURABLE, number, on, timeout)

    def wait_tool_digital_in(self, number: int, on: bool = True, timeout: float = 5.0) -> None:
        """Wait until tool input 0 or 1 is on, or off."""
        self._wait_digital_in(TOOL, number, on, timeout)

    def configurable_digital_in(self, number: int) -> bool:
        """Configurable digital input 0 to 7."""
        return self._digital_in(CONFIGURABLE, number)

    def configurable_digital_out(self, number: int) -> bool:
        """Configurable digital output 0 to 7."""
        return self._digital_out(CONFIGURABLE, number)

    def tool_digital_in(self, number: int) -> bool:
        """Tool input 0 or 1. Its bit on CB2 (8 or 9) is inferred, because CB2 has only 16 bits."""
        return self._digital_in(TOOL, number)

    def tool_digital_out(self, number: int) -> bool:
        """Tool output 0 or 1. Its bit on CB2 (8 or 9) is inferred, because CB2 has only 16 bits."""
        return self._digital_out(TOOL, number)

    def analog_in(self, number: int) -> Analog:
        """Analogue input 0 or 1 of the control box."""
        first = integer(number, 0, 1, "analogue input") == "0"
        board = self._masterboard()
        if first:
            return Analog(board.analog_input_0, board.analog_input_range_0)
        return Analog(board.analog_input_1, board.analog_input_range_1)

    def analog_out(self, number: int) -> Analog:
        """Analogue output 0 or 1 of the control box."""
        return Analog(*_analog_out(self._masterboard(), number))

    def tool_analog_in(self, number: int) -> Analog:
        """Analogue input 0 or 1 of the tool; in packets, these inputs have the numbers 2 and 3."""
        first = integer(number, 0, 1, "tool analogue input") == "0"
        tool = _newest(self._primary.of(ToolData))
        if first:
            return Analog(tool.analog_input_2, tool.analog_input_range_2)
        return Analog(tool.analog_input_3, tool.analog_input_range_3)

    @property
    def tool_voltage(self) -> int:
        """Supply voltage of the tool: 0, 12 or 24 V."""
        return _newest(self._primary.of(ToolData)).tool_output_voltage

    # -- implementation ------------------------------------------------------------------------------

    def _set_digital(self, bank: DigitalBank, number: int, on: bool, confirm: float | None) -> None:
        firmware = self._settings.firmware
        text = commands.secondary(commands.digital_out(firmware, bank, number, on))
        bit = bank.bit(firmware, number, "output")
        echo = Echo(MasterboardData, lambda board: _bit(board.digital_output_bits, bit), lambda value: value == on)
        is_sure = not (firmware.is_cb2 and bank is TOOL)
        inputs = {f"{bank.name}_digital_output_mask": 1 << number, f"{bank.name}_digital_output": on << number}
        self._settings.apply(
            text, f"{bank.name} digital output {number}", echo if is_sure else None, confirm, lambda: inputs
        )

    def _digital_in(self, bank: DigitalBank, number: int) -> bool:
        bit = bank.bit(self._settings.firmware, number, "input")
        return _bit(self._digital_input_bits(), bit)

    def _wait_digital_in(self, bank: DigitalBank, number: int, on: bool, timeout: float) -> None:
        bit = bank.bit(self._settings.firmware, number, "input")
        boolean(on, f"{bank.name} digital input {number}")
        try:
            self._realtime.wait_until(lambda state: _bit(state.digital_input_bits, bit) == on, timeout)
        except LinkTimeout as error:
            wanted = "on" if on else "off"
            raise LinkTimeout(f"{bank.name} digital input {number} was not switched {wanted}: {error}") from None

    def _digital_out(self, bank: DigitalBank, number: int) -> bool:
        bit = bank.bit(self._settings.firmware, number, "output")
        return _bit(self._masterboard().digital_output_bits, bit)

    def _digital_input_bits(self) -> int:
        """The digital inputs, from the interface whose states `_wait_digital_in` checks."""
        return _newest(self._realtime).digital_input_bits

    def _masterboard(self) -> MasterboardData:
        return _newest(self._primary.of(MasterboardData))

    def _repr_html_(self) -> str:
        from linkcore.text import html_table  # imported here: importing the library stays cheap

        try:
            board, inputs = self._masterboard(), self._digital_input_bits()
        except LinkError as error:
            return html_table("IO", (), (), [f"unknown: {error}"])

        def on(bits: int) -> str:
            return ", ".join(str(bit) for bit in range(bits.bit_length()) if bits >> bit & 1) or "none"

        rows = [
            ("digital inputs that are on, by their bits", on(inputs)),
            ("digital outputs that are on, by their bits", on(board.digital_output_bits)),
            *((f"analogue input {n}", _shown(self.analog_in(n))) for n in (0, 1)),
            *((f"analogue output {n}", _shown(self.analog_out(n))) for n in (0, 1)),
        ]
        return html_table("IO", (), rows, ["bits 0 to 7 standard, 8 to 15 configurable, 16 and 17 of the tool"])

    def __repr__(self) -> str:
        return "<IO: inputs and outputs by number>"


def _newest(feed: Feed[T]) -> T:
    """The newest state of an interface, or the next one if there is none."""
    newest = feed.latest
    return feed.wait(_FIRST_STATE) if newest is None else newest


def _shown(signal: Analog) -> str:
    return f"{signal.value:.4g} {'A' if signal.domain == AnalogDomain.CURRENT else 'V'}"


def _bit(bits: int, index: int) -> bool:
    return bool(bits >> index & 1)


def _analog_out(board: MasterboardData, number: int) -> tuple[float, AnalogDomain]:
    if integer(number, 0, 1, "analogue output") == "0":
        return board.analog_output_0, board.analog_output_domain_0
    return board.analog_output_1, board.analog_output_domain_1

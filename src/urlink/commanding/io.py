"""`robot.io`: the inputs and outputs of control box and tool.

Outputs are set by programs that run beside the one that moves the arm, and read back from the robot state, which comes
ten times a second: a new value shows after a tenth of a second or so.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, TypeVar

from linkcore.errors import BadValue
from linkcore.streaming.stream import Stream

from ..firmware import Firmware
from ..interfaces.enums import AnalogDomain
from ..interfaces.primary.robot_state import MasterboardData, RobotState, ToolData
from ..urscript import commands
from ..urscript.text import integer
from .channel import Outlet

__all__ = ["IO", "Analog"]

T = TypeVar("T")

#: Seconds to wait for a first state.
_PATIENCE = 2.0


class Analog(NamedTuple):
    """An analogue signal.

    Attributes:
        value: A or V.
        domain: which of the two.
    """

    value: float
    domain: AnalogDomain


class IO:
    """Inputs and outputs by number, each kind from 0.

    Setting raises `BadValue` for an output that this robot has not, before anything is sent; `NotRunning` where the
    robot does not run or nothing is known of it; and `RemoteError` where it could not be sent. A stop does not matter,
    as long as the robot runs. Reading raises `LinkTimeout` where no state came for two seconds.

    Args:
        outlet: by which commands leave.
        primary: makes the primary stream.
        firmware: tells the controller's firmware.
    """

    def __init__(
        self, outlet: Outlet, primary: Callable[[], Stream[RobotState]], firmware: Callable[[], Firmware]
    ) -> None:
        self._outlet = outlet
        self._primary = primary
        self._firmware = firmware

    # -- outputs -------------------------------------------------------------------------------------

    def set_digital_out(self, number: int, on: bool) -> None:
        """Switch standard digital output 0 to 7."""
        self._set_digital(int(integer(number, 0, 7, "standard digital output")), on)

    def set_configurable_digital_out(self, number: int, on: bool) -> None:
        """Switch configurable digital output 0 to 7; CB2 has none."""
        self._set_digital(8 + int(integer(number, 0, 7, "configurable digital output")), on)

    def set_tool_digital_out(self, number: int, on: bool) -> None:
        """Switch tool output 0 or 1."""
        self._set_digital(16 + int(integer(number, 0, 1, "tool digital output")), on)

    def set_analog_out(self, number: int, fraction: float) -> None:
        """Set analogue output 0 or 1 to a fraction of its range, 0 to 1 (a guess: see `urlink.urscript.commands`)."""
        self._send(commands.analog_out(self._firmware(), number, fraction))

    def set_tool_voltage(self, volts: int) -> None:
        """Supply the tool with 0, 12 or 24 V."""
        self._send(commands.tool_voltage(volts))

    def set_flag(self, number: int, on: bool) -> None:
        """Set flag 0 to 31, which programs can read."""
        self._send(commands.flag(number, on))

    # -- what is there -------------------------------------------------------------------------------

    def digital_in(self, number: int) -> bool:
        """Standard digital input 0 to 7."""
        return self._bit(self._masterboard().digital_input_bits, int(integer(number, 0, 7, "standard digital input")))

    def digital_out(self, number: int) -> bool:
        """Standard digital output 0 to 7."""
        return self._bit(self._masterboard().digital_output_bits, int(integer(number, 0, 7, "standard digital output")))

    def configurable_digital_in(self, number: int) -> bool:
        """Configurable digital input 0 to 7."""
        index = self._configurable(number, "input")
        return self._bit(self._masterboard().digital_input_bits, index)

    def configurable_digital_out(self, number: int) -> bool:
        """Configurable digital output 0 to 7."""
        index = self._configurable(number, "output")
        return self._bit(self._masterboard().digital_output_bits, index)

    def tool_digital_in(self, number: int) -> bool:
        """Tool input 0 or 1. Its bit on CB2, 8 or 9, is inferred from there being only 16."""
        index = self._tool(number, "input")
        return self._bit(self._masterboard().digital_input_bits, index)

    def tool_digital_out(self, number: int) -> bool:
        """Tool output 0 or 1. Its bit on CB2, 8 or 9, is inferred from there being only 16."""
        index = self._tool(number, "output")
        return self._bit(self._masterboard().digital_output_bits, index)

    def analog_in(self, number: int) -> Analog:
        """Analogue input 0 or 1 of the control box."""
        first = integer(number, 0, 1, "analogue input") == "0"
        board = self._masterboard()
        if first:
            return Analog(board.analog_input_0, board.analog_input_range_0)
        return Analog(board.analog_input_1, board.analog_input_range_1)

    def analog_out(self, number: int) -> Analog:
        """Analogue output 0 or 1 of the control box."""
        first = integer(number, 0, 1, "analogue output") == "0"
        board = self._masterboard()
        if first:
            return Analog(board.analog_output_0, board.analog_output_domain_0)
        return Analog(board.analog_output_1, board.analog_output_domain_1)

    def tool_analog_in(self, number: int) -> Analog:
        """Analogue input 0 or 1 of the tool, which the packets call 2 and 3."""
        first = integer(number, 0, 1, "tool analogue input") == "0"
        tool = self._newest(ToolData)
        if first:
            return Analog(tool.analog_input_2, tool.analog_input_range_2)
        return Analog(tool.analog_input_3, tool.analog_input_range_3)

    @property
    def tool_voltage(self) -> int:
        """What the tool is supplied with: 0, 12 or 24 V."""
        return self._newest(ToolData).tool_output_voltage

    # -- how -----------------------------------------------------------------------------------------

    def _set_digital(self, number: int, on: bool) -> None:
        self._send(commands.digital_out(self._firmware(), number, on))

    def _send(self, statement: str) -> None:
        self._outlet.command(commands.secondary(statement))

    def _masterboard(self) -> MasterboardData:
        return self._newest(MasterboardData)

    def _newest(self, kind: type[T]) -> T:
        feed = self._primary().of(kind)
        newest = feed.latest
        return feed.wait(_PATIENCE) if newest is None else newest

    def _configurable(self, number: int, what: str) -> int:
        index = 8 + int(integer(number, 0, 7, f"configurable digital {what}"))
        if self._firmware().is_cb2:
            raise BadValue(f"firmware {self._firmware()} has no configurable {what}s")
        return index

    def _tool(self, number: int, what: str) -> int:
        index = int(integer(number, 0, 1, f"tool digital {what}"))
        return index + (8 if self._firmware().is_cb2 else 16)

    @staticmethod
    def _bit(bits: int, index: int) -> bool:
        return bool(bits >> index & 1)

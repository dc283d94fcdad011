"""The I/O interface of ur_rtde, over `robot.rtde.inputs` and `robot.io`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from urlink import InputInUse, SessionLimits
from urlink.rtde import Inputs

from .interface import RtdeInterface, succeeds

__all__ = ["RTDEIOInterface"]

#: Kinds of an analogue output, as in its bit of `standard_analog_output_type`.
_CURRENT, _VOLTAGE = 0, 1


class RTDEIOInterface(RtdeInterface):
    """Outputs, speed slider and input registers. Each method returns whether the value was sent.

    An input is claimed when it is first written, and held until `disconnect`. Only one client can hold it. If another
    client holds the inputs of the digital outputs or of the slider, a script sets them instead. If no script can set
    them, the method returns False and raises no error.

    Args:
        hostname: Address of the robot.
        verbose: No effect.
        use_upper_range_registers: No effect, because registers are given by their own numbers.
        limits: Limits of the session; see `urlink.SessionLimits`. The other client does not have this argument.

    Raises:
        RemoteError: If the robot cannot be reached.
    """

    def __init__(
        self,
        hostname: str,
        verbose: bool = False,
        use_upper_range_registers: bool = False,
        *,
        limits: SessionLimits | None = None,
    ) -> None:
        super().__init__(hostname, limits=limits)
        self._claimed: dict[tuple[str, ...], Inputs | None] = {}
        self._registers = self._robot.rtde.registers(lower=True)
        self._robot.primary.wait(5.0)

    def setStandardDigitalOut(self, output_id: int, signal_level: bool) -> bool:
        """Switch standard digital output 0 to 7."""
        return self._send(
            {"standard_digital_output": {output_id: signal_level}},
            lambda: self._robot.io.set_digital_out(output_id, signal_level, confirm=None),
        )

    def setConfigurableDigitalOut(self, output_id: int, signal_level: bool) -> bool:
        """Switch configurable digital output 0 to 7."""
        return self._send(
            {"configurable_digital_output": {output_id: signal_level}},
            lambda: self._robot.io.set_configurable_digital_out(output_id, signal_level, confirm=None),
        )

    def setToolDigitalOut(self, output_id: int, signal_level: bool) -> bool:
        """Switch tool output 0 or 1."""
        return self._send(
            {"tool_digital_output": {output_id: signal_level}},
            lambda: self._robot.io.set_tool_digital_out(output_id, signal_level, confirm=None),
        )

    def setSpeedSlider(self, speed: float) -> bool:
        """Set the speed slider, 0 to 1."""
        return self._send({"speed_slider_fraction": speed}, lambda: self._robot.set_speed_slider(speed, confirm=None))

    def setAnalogOutputVoltage(self, output_id: int, voltage_ratio: float) -> bool:
        """Set analogue output 0 or 1 to a voltage: a fraction of its range, 0 to 1."""
        return self._set_analog(output_id, voltage_ratio, _VOLTAGE)

    def setAnalogOutputCurrent(self, output_id: int, current_ratio: float) -> bool:
        """Set analogue output 0 or 1 to a current: a fraction of its range, 0 to 1."""
        return self._set_analog(output_id, current_ratio, _CURRENT)

    def setInputIntRegister(self, input_id: int, value: int) -> bool:
        """Write input integer register 0 to 47, given by its own number."""
        return succeeds(lambda: self._registers.write_integer(input_id, value))

    def setInputDoubleRegister(self, input_id: int, value: float) -> bool:
        """Write input float register 0 to 47, given by its own number."""
        return succeeds(lambda: self._registers.write_float(input_id, value))

    def _set_analog(self, output: int, ratio: float, domain: int) -> bool:
        names = ("standard_analog_output_0", "standard_analog_output_1")
        values = {"standard_analog_output_type": domain << output, f"standard_analog_output_{output}": ratio}
        return self._send(values, None, names)

    def _send(
        self, values: dict[str, Any], by_script: Callable[[], object] | None, names: tuple[str, ...] | None = None
    ) -> bool:
        """Write inputs, and claim `names` once. If another client holds one, call `by_script` if it is given."""
        claim = names or tuple(values)

        def write() -> None:
            if claim not in self._claimed:
                try:
                    self._claimed[claim] = self._robot.rtde.inputs(*claim)
                except InputInUse:
                    if by_script is None:
                        raise
                    self._claimed[claim] = None
            inputs = self._claimed[claim]
            if inputs is not None:
                inputs.send(**values)
            elif by_script is not None:
                by_script()

        return succeeds(write)

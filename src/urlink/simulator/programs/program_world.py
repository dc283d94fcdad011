"""The controller for one of its programs: the `World` of `urlink.simulator.urscript`, over the state."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from linkcore.errors import BadValue
from urlink.firmware import Firmware
from urlink.interfaces.rtde.variables import INPUTS, OUTPUTS
from urlink.kinematics import Arm

from ..messages import popup_message, text_message
from ..registers import Action, Registers
from ..robot.generator import Drive, ForceTask, MotionGenerator
from ..robot.modbus import ModbusSignals
from ..robot.signals import Signals
from ..rtde_variables import OUTPUT_VALUES
from ..state import ControllerState
from .program_sockets import ProgramSockets, Route

__all__ = ["ProgramWorld"]


class ProgramWorld:
    """The controller for one of its programs: the `World` of `urlink.simulator.urscript`.

    Args:
        state: of the controller.
        route: where the connections of programs go.
        drive: moves the arm for the program; None for a secondary program, which may only read whether the arm moves.
    """

    def __init__(self, state: ControllerState, route: Route, drive: Drive | None = None) -> None:
        self._state = state
        self._drive = drive
        self.sockets = ProgramSockets(route)
        self.period = state.period

    @property
    def motion(self) -> MotionGenerator:
        if self._drive is None:
            return MotionGenerator(self._state.kinematics, self._state.arm.setpoint)
        return self._drive.generator

    @property
    def firmware(self) -> Firmware:
        return self._state.firmware

    @property
    def kinematics(self) -> Arm:
        return self._state.kinematics

    @property
    def cycle(self) -> int:
        return self._state.cycle

    @property
    def signals(self) -> Signals:
        return self._state.signals

    @property
    def flags(self) -> list[bool]:
        return self._state.flags

    @property
    def registers(self) -> Registers:
        return self._state.registers

    @property
    def modbus(self) -> ModbusSignals:
        return self._state.modbus

    @property
    def q_actual(self) -> Sequence[float]:
        return self._state.arm.q_actual

    @property
    def qd_actual(self) -> Sequence[float]:
        return self._state.arm.sample.qd_actual

    @property
    def q_target(self) -> Sequence[float]:
        return self._state.arm.setpoint.q

    @property
    def qd_target(self) -> Sequence[float]:
        return self._state.arm.setpoint.qd

    @property
    def qdd_target(self) -> Sequence[float]:
        return self._state.arm.setpoint.qdd

    @property
    def pose_actual(self) -> Sequence[float]:
        return self._state.arm.sample.pose_actual

    @property
    def pose_target(self) -> Sequence[float]:
        return self._state.arm.sample.pose_target

    @property
    def speed_actual(self) -> Sequence[float]:
        return self._state.arm.sample.speed_actual

    @property
    def speed_target(self) -> Sequence[float]:
        return self._state.arm.sample.speed_target

    @property
    def force(self) -> Sequence[float]:
        return self._state.arm.sample.force

    @property
    def torques(self) -> Sequence[float]:
        return self._state.arm.sample.M_target

    @property
    def tcp(self) -> Sequence[float]:
        return self._state.arm.tcp

    def set_tcp(self, pose: Sequence[float]) -> None:
        self._state.arm.tcp = list(pose)
        if self._drive is not None:
            # A movement may follow in the same cycle.
            self._drive.generator.tcp = pose

    @property
    def payload(self) -> float:
        return self._state.arm.payload

    @property
    def payload_cog(self) -> Sequence[float]:
        return self._state.arm.payload_cog

    @property
    def payload_inertia(self) -> Sequence[float]:
        return self._state.arm.payload_inertia

    def set_payload(self, mass: float, cog: Sequence[float] | None, inertia: Sequence[float] | None) -> None:
        arm = self._state.arm
        arm.payload = mass
        if cog is not None:
            arm.payload_cog = tuple(cog)
        if inertia is not None:
            arm.payload_inertia = tuple(inertia)

    def set_gravity(self, vector: Sequence[float]) -> None:
        """No effect: the simulated arm stands upright."""

    def rtde_value(self, name: str) -> Any:
        known = OUTPUTS.get(name)
        if known is None or not known.is_in(self._state.firmware):
            raise BadValue(f"get_rtde_value: there is no RTDE output '{name}'")
        return OUTPUT_VALUES[name](self._state)

    def set_watchdog(self, variable: str, frequency: float, action: Action) -> None:
        known = INPUTS.get(variable)
        if known is None or not known.is_in(self._state.firmware):
            raise BadValue(f"rtde_set_watchdog: there is no RTDE input '{variable}'")
        cycles = self._state.firmware.rate / frequency if frequency > 0.0 else math.inf
        self._state.watchdogs.set(variable, cycles, action, self._state.cycle)

    def use_external_force(self, is_used: bool) -> None:
        self._state.arm.uses_external_force = is_used

    def zero_force(self) -> None:
        self._state.arm.zero_force()

    def contact_steps(self, direction: Sequence[float]) -> int:
        return self._state.arm.contact_steps(direction)

    @property
    def external_torques(self) -> Sequence[float]:
        return self._state.arm.external_torques

    def force_mode(self, task: ForceTask) -> None:
        if self._drive is not None:
            self._drive.force_mode(task)

    def set_force_damping(self, damping: float) -> None:
        if self._drive is not None:
            self._drive.set_damping(damping)

    def set_force_gain(self, gain: float) -> None:
        if self._drive is not None:
            self._drive.set_gain(gain)

    def freedrive(self, axes: Sequence[bool], frame: Sequence[float]) -> None:
        if self._drive is not None:
            self._drive.freedrive(axes, frame)

    def end_yielding(self) -> None:
        if self._drive is not None:
            self._drive.end_mode()

    def text_message(self, text: str) -> None:
        self._state.outbox.offer(lambda: text_message(self._state, text))

    def popup(self, text: str, title: str, is_warning: bool, is_error: bool, is_blocking: bool) -> None:
        state = self._state
        state.popup = text
        state.outbox.offer(lambda: popup_message(state, text, title, is_warning, is_error, is_blocking))

    @property
    def has_popup(self) -> bool:
        return self._state.popup is not None

    def protective_stop(self) -> None:
        self._state.stop_protectively("protective_stop() was called by the program", by_program=True)

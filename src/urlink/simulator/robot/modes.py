"""Robot mode, joint mode, safety mode and program state, and the dependencies between them.

The numbers and names of the modes are in `urlink.protocol.enums`. The dependencies are from manuals, from drivers, and
from three captures of robots at rest. The following is assumed:

- The times for powering on and releasing the brakes. These times are short, so that tests are fast. After a reboot, the
  arm is running immediately.
- A protective stop pauses the program, and an emergency stop ends it. Two facts are known. After a protective stop, the
  motors stay on. An emergency stop is a stop of category 1. According to the manual, such a stop leaves the motors "in
  a power off state with brakes engaged" after the arm has come to rest.
- During a protective stop, the joints of a CB2 stay in mode RUNNING. The robot modes of a CB2 during stops and without
  power (security stopped, emergency stopped, no power) are inferred from the names in the vendor's list.
"""

from __future__ import annotations

import enum
from typing import NamedTuple

from linkcore.wire.fields import Since
from urlink.protocol.enums import (
    JointMode,
    MasterOnOffState,
    MasterSafetyState,
    ProgramState,
    RobotMode,
    RobotModeCB2,
    SafetyMode,
    ToolMode,
)
from urlink.protocol.firmware import Firmware


class Power(enum.Enum):
    """Power state of the arm."""

    OFF = "off"
    BOOTING = "booting"
    IDLE = "idle"
    RUNNING = "running"


class StopState(enum.Enum):
    """Cause of the current stop of the arm."""

    NONE = "none"
    PROTECTIVE = "protective"
    SAFEGUARD = "safeguard"
    EMERGENCY = "emergency"


class _Shown(NamedTuple):
    """Modes that the interfaces show for a power state of the arm."""

    robot: RobotMode
    robot_cb2: RobotModeCB2
    joint: JointMode
    tool: ToolMode


_SHOWN = {
    Power.OFF: _Shown(RobotMode.POWER_OFF, RobotModeCB2.NO_POWER, JointMode.POWER_OFF, ToolMode.POWER_OFF),
    Power.BOOTING: _Shown(RobotMode.POWER_ON, RobotModeCB2.INITIALIZING, JointMode.BOOTING, ToolMode.BOOTING),
    Power.IDLE: _Shown(RobotMode.IDLE, RobotModeCB2.READY, JointMode.IDLE, ToolMode.IDLE),
    Power.RUNNING: _Shown(RobotMode.RUNNING, RobotModeCB2.RUNNING, JointMode.RUNNING, ToolMode.RUNNING),
}
_STOPPED_CB2 = {
    StopState.PROTECTIVE: RobotModeCB2.SECURITY_STOPPED,
    StopState.SAFEGUARD: RobotModeCB2.SAFEGUARD_STOP,
    StopState.EMERGENCY: RobotModeCB2.EMERGENCY_STOPPED,
}
_SAFETY_MODE = {
    StopState.PROTECTIVE: SafetyMode.PROTECTIVE_STOP,
    StopState.SAFEGUARD: SafetyMode.SAFEGUARD_STOP,
    StopState.EMERGENCY: SafetyMode.ROBOT_EMERGENCY_STOP,
}

#: Joint mode during an emergency stop on CB2. On later releases, this number has another meaning.
_JOINT_EMERGENCY_STOPPED_CB2 = JointMode.READY_FOR_POWER_OFF

# In captures without a program, firmware 3.3 sends a speed scaling of 1.0, and firmware 3.10 and 5.4 send 0.0. The
# first release that sends 0.0 is unknown.
_SCALES_TO_ZERO = Since("3.10/5.0")


class ShownModes(NamedTuple):
    """All modes that the real-time interface shows; see the properties of `Modes` with the same names."""

    robot_mode: RobotMode | RobotModeCB2
    joint_mode: JointMode
    safety_mode: SafetyMode
    program_state: ProgramState
    speed_scaling: float
    is_powered: bool


class Modes:
    """Robot mode, safety mode and program state, as one state machine.

    Attributes:
        power: Power state of the arm.
        stop: Cause of the current stop.
    """

    #: Times for powering on (from off to idle) and for releasing the brakes (from idle to running), in s.
    BOOT_TIME = 0.4
    BRAKE_RELEASE_TIME = 0.2

    def __init__(self, firmware: Firmware) -> None:
        self._firmware = firmware
        self.power = Power.RUNNING
        self.stop = StopState.NONE
        self._has_program = False
        self._is_paused = False
        self._is_standing = True
        self._is_switching_off = False
        # Whether to power on again after the current switch-off is complete.
        self._powers_on = False
        self._releases_brakes = False
        self._wait = 0.0
        # Latest value of `shown`, and the states that it depends on.
        self._shown: tuple[tuple[object, ...], ShownModes] | None = None

    # -- events ----------------------------------------------------------------------------------

    def protective_stop(self) -> None:
        """Cause a protective stop: the arm brakes and stays at rest, with its motors on.

        No effect during an emergency stop or while the power is off.
        """
        if self.stop is StopState.NONE and self.power is Power.RUNNING:
            self.stop = StopState.PROTECTIVE

    def safeguard_stop(self) -> None:
        """Cause a safeguard stop, as a safety gate or a light curtain does.

        A safeguard stop is like a protective stop, but it ends as soon as its cause has ended.
        """
        if self.stop is StopState.NONE and self.power is Power.RUNNING:
            self.stop = StopState.SAFEGUARD

    def emergency_stop(self) -> None:
        """Cause an emergency stop. The arm brakes, comes to rest, and then loses its power."""
        self.stop = StopState.EMERGENCY
        self.power_off()

    def clear(self) -> None:
        """Unlock a protective stop, end a safeguard stop, or release the emergency stop button.

        After an emergency stop, the power stays off.
        """
        self.stop = StopState.NONE

    def power_off(self) -> None:
        """Switch the arm off. The arm brakes, comes to rest, and then loses its power."""
        self._is_switching_off = True
        self._powers_on = self._releases_brakes = False

    def power_on(self, release_brakes: bool = True) -> None:
        """Power the joints on, up to the power state idle or running.

        If the arm is being switched off, it is powered on afterwards. During an emergency stop, this call has no
        effect, as on a real controller.

        Args:
            release_brakes: Whether to release the brakes, so that the arm reaches the power state running.
        """
        if self.stop is StopState.EMERGENCY:
            return
        releases_now = release_brakes and not self._releases_brakes
        self._releases_brakes |= release_brakes
        if self._is_switching_off:
            self._powers_on = True
        elif self.power is Power.OFF:
            self.power, self._wait = Power.BOOTING, self.BOOT_TIME
        elif self.power is Power.IDLE and releases_now:
            self._wait = self.BRAKE_RELEASE_TIME

    def advance(self, seconds: float, is_standing: bool, has_program: bool, is_paused: bool) -> None:
        """Advance by one cycle.

        Args:
            seconds: Duration of the cycle, in s.
            is_standing: Whether the arm has come to rest.
            has_program: Whether there is a program.
            is_paused: Whether the program is paused.
        """
        self._is_paused = is_paused
        self._is_standing = is_standing
        self._has_program = has_program
        if self._is_switching_off:
            if is_standing:
                self._is_switching_off = False
                self.power, self._wait = Power.OFF, 0.0
        elif self._powers_on:
            self._powers_on = False
            self.power_on(self._releases_brakes)
        elif self._wait > 0.0:
            self._wait -= seconds
            if self._wait <= 0.0:
                self._next_power()

    def _next_power(self) -> None:
        if self.power is Power.BOOTING:
            self.power = Power.IDLE
            self._wait = self.BRAKE_RELEASE_TIME if self._releases_brakes else 0.0
        elif self.power is Power.IDLE and self._releases_brakes:
            self.power = Power.RUNNING

    @property
    def is_unchanging(self) -> bool:
        """Whether no change of the power state is in progress."""
        return not (self._is_switching_off or self._powers_on) and self._wait <= 0.0

    # -- modes -------------------------------------------------------------------------------------

    @property
    def may_move(self) -> bool:
        """Whether the arm may move: it is powered, its brakes are released, and there is no stop."""
        return self.power is Power.RUNNING and self.stop is StopState.NONE and not self._is_switching_off

    @property
    def holds_program(self) -> bool:
        """Whether a protective or safeguard stop blocks the arm, so that the program is paused and not ended."""
        return (
            self.stop in (StopState.PROTECTIVE, StopState.SAFEGUARD)
            and self.power is Power.RUNNING
            and not self._is_switching_off
        )

    @property
    def is_powered(self) -> bool:
        """Whether the joints have power."""
        return self.power is not Power.OFF

    @property
    def shown(self) -> ShownModes:
        """All modes that the real-time interface shows. The same object is returned until one of them changes."""
        depends_on = (
            self.power,
            self.stop,
            self._is_switching_off,
            self._has_program,
            self._is_paused,
            self._is_standing,
        )
        if self._shown is None or self._shown[0] != depends_on:
            modes = ShownModes(
                self.robot_mode,
                self.joint_mode,
                self.safety_mode,
                self.program_state,
                self.speed_scaling,
                self.is_powered,
            )
            self._shown = depends_on, modes
        return self._shown[1]

    @property
    def robot_mode(self) -> RobotMode | RobotModeCB2:
        """Robot mode, as an enum of the controller's generation."""
        shown = _SHOWN[self.power]
        return _STOPPED_CB2.get(self.stop, shown.robot_cb2) if self._firmware.is_cb2 else shown.robot

    @property
    def joint_mode(self) -> JointMode:
        """Mode of all six joints."""
        if self._firmware.is_cb2 and self.stop is StopState.EMERGENCY:
            return _JOINT_EMERGENCY_STOPPED_CB2
        return _SHOWN[self.power].joint

    @property
    def tool_mode(self) -> ToolMode:
        """Mode of the tool board."""
        return _SHOWN[self.power].tool

    @property
    def safety_mode(self) -> SafetyMode:
        """Safety mode. In all cases that the simulator has, the safety status has the same number."""
        # Looking up a member of an enum in a dictionary takes several times as long as this comparison, which nearly
        # always decides.
        return SafetyMode.NORMAL if self.stop is StopState.NONE else _SAFETY_MODE[self.stop]

    @property
    def master_safety_state(self) -> MasterSafetyState:
        """Safety state that a CB2 masterboard reports."""
        if self.stop is StopState.SAFEGUARD:
            return MasterSafetyState.SAFEGUARD_STOP
        return MasterSafetyState.ROBOT_EMERGENCY_STOP if self.stop is StopState.EMERGENCY else MasterSafetyState.OK

    @property
    def master_on_off_state(self) -> MasterOnOffState:
        """Power state that a CB2 masterboard reports."""
        if self._is_switching_off and self.is_powered:
            return MasterOnOffState.TURNING_OFF
        if self.power is Power.OFF:
            return MasterOnOffState.OFF
        return MasterOnOffState.TURNING_ON if self.power is Power.BOOTING else MasterOnOffState.ON

    @property
    def program_state(self) -> ProgramState:
        """State of the program.

        The program plays while the arm may move. It is paused during a protective or safeguard stop, and if a client or
        the pendant has paused it. Otherwise it is stopped.
        """
        if not self._has_program:
            return ProgramState.STOPPED
        if self.may_move and not self._is_paused:
            return ProgramState.PLAYING
        if self.may_move or self.holds_program:
            return ProgramState.PAUSED if self._is_standing else ProgramState.PAUSING
        return ProgramState.STOPPED if self._is_standing else ProgramState.STOPPING

    @property
    def speed_scaling(self) -> float:
        """Speed scaling before the slider is applied.

        It is 1 while a program plays. Otherwise it is 0 on newer firmware, and 1 on older firmware.
        """
        if self.program_state is ProgramState.PLAYING:
            return 1.0
        return 0.0 if self._firmware in _SCALES_TO_ZERO else 1.0

"""Primary and secondary interfaces, ports 30001 and 30002, which send ten robot states per second.

The primary interface also sends messages. For the sizes and the order of the sub-packages, see
docs/protocols/primary.md, Robot state. Comments mark values that were taken from captures.

A robot state remembers what it shows, and makes its bytes when they are read; see `linkcore.deferred`.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from linkcore.deferred import Deferred
from linkcore.wire.state_layouts import StateLayout
from urlink.arm.kinematics import DhTable
from urlink.protocol.enums import SafetyMode
from urlink.protocol.firmware import Firmware, release_of
from urlink.protocol.headers import PACKAGE
from urlink.protocol.primary.robot_state import SUB_PACKAGES, CalibrationData

from ..messages import greeting
from ..robot.sensors import Sample, Samples
from ..rtde_variables import ROBOT_VOLTAGE, current_of
from ..state import ControllerState
from .interface import BatchClient, Fields, Form, Interface, InterfaceClient, ScriptReceiver, package

#: Robot states per second.
STATE_RATE = 10
#: First bytes of each state: its header, the header of its first sub-package, and its time.
_HEAD = struct.Struct(">iBiBQ")


class Measured(NamedTuple):
    """What a robot state shows in addition to modes, signals and settings. Nothing in it changes later.

    Attributes:
        sample: Values of the sensors.
        time: Time since the controller came up, in s.
        state: State of the controller, for properties that never change while the controller is up.
        is_powered: Whether the arm has power.
    """

    sample: Sample
    time: float
    state: ControllerState
    is_powered: bool

    @property
    def timestamp(self) -> int:
        """Time in the unit of the robot state."""
        # The time stamps in CB2 captures are too small to be microseconds, so milliseconds are assumed.
        return round(self.time * (1e3 if self.state.firmware.is_cb2 else 1e6))


class StatePackage(Deferred):
    """Robot state of one cycle. Its bytes are made when they are read.

    Args:
        head: First bytes of the package.
        size: Number of bytes.
        make: Function that makes all bytes.
        is_steady: Whether modes, signals and settings are those of the previous state.
    """

    __slots__ = ("_bytes", "_make", "_size")

    def __init__(self, head: bytes, size: int, make: Callable[[], bytes], is_steady: bool) -> None:
        super().__init__(head, is_steady)
        self._size, self._make = size, make
        self._bytes: bytes | None = None

    def __len__(self) -> int:
        return self._size

    def __bytes__(self) -> bytes:
        if self._bytes is None:
            self._bytes = self._make()
        return self._bytes


class StatePackages:
    """Robot states of one controller. The primary and the secondary interface send the same states.

    Args:
        state: State of the controller.
    """

    def __init__(self, state: ControllerState) -> None:
        self._state = state
        self._firmware: Firmware | None = None
        self._first_only: frozenset[int] = frozenset()
        self._forms: dict[int, Form[StateLayout]] = {}
        self._unchanging: dict[int, bytes] = {}
        self._size = self._first_size = 0
        # Latest cycle with a packet, and the packet that both interfaces send in this cycle.
        self._made: tuple[int, StatePackage | None] = (-1, None)
        # Fields with modes, signals and settings in the latest packet, by sub-package. Empty if some client has got a
        # different packet as its latest one.
        self._shown: Mapping[int, Fields] = {}
        # Safety mode in the latest packet.
        self._safety: SafetyMode | None = None

    def next_cycle(self, cycle: int) -> int:
        """Return the first cycle after this one in which a state is sent."""
        rate = self._state.rate
        return -(-(cycle * STATE_RATE // rate + 1) * rate // STATE_RATE)

    def of_cycle(self, cycle: int) -> StatePackage:
        """Return the robot state of this cycle; both interfaces get the same bytes."""
        made_in, made = self._made
        if made is None or made_in != cycle:
            self._lay_out()
            shown, before = self._look(), self._shown
            self._shown, self._safety = shown, self._state.modes.safety_mode
            made = self._package(shown, self._measured(), is_steady=shown == before)
            self._made = cycle, made
        return made

    def greeting(self) -> StatePackage:
        """Return the robot state for a new connection, which includes kinematics and configuration."""
        self._lay_out()
        shown = self._look()
        if shown != self._shown:
            self._shown = {}
        return self._package(shown, self._measured(), is_steady=False, is_first=True)

    def extra(self, cycle: int) -> StatePackage:
        """Return the robot state of this cycle for only one of the interfaces."""
        made = self.of_cycle(cycle)
        self._shown = {}
        return made

    @property
    def is_outdated(self) -> bool:
        """Whether the safety mode has changed since the latest packet."""
        return self._safety is not self._state.modes.safety_mode

    @property
    def is_steady(self) -> bool:
        """Whether a robot state would now show the same modes, signals and settings as the latest one."""
        return self._firmware is self._state.firmware and self._look() == self._shown

    def package(self, is_first: bool = False) -> bytes:
        """Return the robot state of this cycle without sending it.

        Args:
            is_first: Whether to return the state for a new connection, which includes kinematics and configuration.
        """
        self._lay_out()
        return bytes(self._package(self._look(), self._measured(), is_steady=False, is_first=is_first))

    def later(self, cycle: int, samples: Samples, last: int) -> dict[int, StatePackage]:
        """Return cycle -> robot state, for cycles in which only the time and the targets change.

        Args:
            cycle: Number of the first cycle.
            samples: Sensors of each cycle.
            last: Number of the last cycle, which is the current one.
        """
        state, packages = self._state, {}
        due = self.next_cycle(cycle - 1)
        while due <= last:
            measured = Measured(samples[due - cycle], state.time_of(due), state, state.modes.is_powered)
            packages[due] = self._package(self._shown, measured, is_steady=True)
            due = self.next_cycle(due)
        return packages

    def _measured(self) -> Measured:
        state = self._state
        return Measured(state.arm.sample, state.time, state, state.modes.is_powered)

    def _look(self) -> Mapping[int, Fields]:
        return {kind: look(self._state) for kind, look in _SHOWN.items() if kind in self._forms}

    def _package(
        self, shown: Mapping[int, Fields], measured: Measured, *, is_steady: bool, is_first: bool = False
    ) -> StatePackage:
        forms, unchanging = self._forms, self._unchanging
        kinds = [kind for kind in forms if is_first or kind not in self._first_only]

        def fields(kind: int) -> Fields:
            measure = _MEASURED.get(kind)
            return {**shown.get(kind, {}), **({} if measure is None else measure(measured))}

        def make() -> bytes:
            parts = [unchanging.get(kind) or forms[kind].pack(fields(kind)) for kind in kinds]
            return package(16, b"".join(parts))

        size = self._first_size if is_first else self._size
        head = _HEAD.pack(size, 16, forms[0].layout.size, 0, measured.timestamp)
        return StatePackage(head, size, make, is_steady)

    def _lay_out(self) -> None:
        """Choose the forms of the packages, initially and after a reboot into another firmware."""
        firmware = self._state.firmware
        if self._firmware is firmware:
            return
        release = release_of(firmware)
        self._firmware = firmware
        self._first_only = frozenset(release.first_state_only)
        self._forms = {}
        for kind, size in release.state.items():
            # Some type numbers have had two meanings, which the size distinguishes.
            for cls in SUB_PACKAGES[kind]:
                layouts = [layout for layout in cls.LAYOUTS.all if layout.size == size]
                if layouts:
                    self._forms[kind] = Form(layouts[0] if len(layouts) == 1 else cls.LAYOUTS.of(firmware))
        self._unchanging = {
            kind: self._forms[kind].pack(fill(self._state)) for kind, fill in _UNCHANGING.items() if kind in self._forms
        }
        sizes = {kind: form.layout.size for kind, form in self._forms.items()}
        self._first_size = PACKAGE.width + sum(sizes.values())
        self._size = self._first_size - sum(sizes.get(kind, 0) for kind in self._first_only)


class SecondaryInterface(Interface):
    """Secondary interface of one controller.

    Args:
        state: State of the controller.
        states: Robot states to send.
        receiver: Function that makes the receiver for a client, given the name of the interface and the client.
    """

    _NAME = "secondary"

    def __init__(
        self, state: ControllerState, states: StatePackages, receiver: Callable[[str, InterfaceClient], ScriptReceiver]
    ) -> None:
        self._state = state
        self._states = states
        self._make_receiver = receiver
        # Latest cycle in which all due packets were sent; None while no client is connected.
        self._served: int | None = None

    def greeting(self) -> list[bytes]:
        return [*greeting(self._state, self._NAME), bytes(self._states.greeting())]

    def next_cycle(self, cycle: int) -> int:
        return self._states.next_cycle(cycle)

    def packets(self, cycle: int) -> Sequence[bytes | Deferred]:
        since, self._served = cycle - 1 if self._served is None else self._served, cycle
        return [self._states.of_cycle(cycle)] if self._states.next_cycle(since) <= cycle else []

    def last_steady(self, cycle: int, last: int, clients: Sequence[BatchClient]) -> int:
        before = self.last_ahead(cycle, last, clients)
        if before == last or not self._states.is_steady:
            return before
        return max(before, min([last, *(client.last_quiet_cycle for client in clients)]))

    def send_ahead(self, cycle: int, samples: Samples | None, clients: Sequence[BatchClient]) -> None:
        if samples is None:
            return
        packages = self._states.later(cycle + 1 - len(samples), samples, cycle)
        if packages:
            self._served = max(packages)
            for client in clients:
                client.send_batch(list(packages.values()), list(packages))

    def skip(self) -> None:
        self._served = None

    def receiver(self, client: InterfaceClient) -> ScriptReceiver:
        return self._make_receiver(self._NAME, client)


class PrimaryInterface(SecondaryInterface):
    """Primary interface of one controller, which sends robot messages in addition to robot states."""

    _NAME = "primary"

    def packets(self, cycle: int) -> Sequence[bytes | Deferred]:
        # After a change of the safety mode, send an additional state before the message about the change. When the
        # vendor's primary client receives this message, it expects that the latest state already shows the stop. The
        # order of the state and the message on a real controller is unknown.
        messages, states = self._state.outbox.take(), [*super().packets(cycle)]
        if messages and not states and self._states.is_outdated:
            states = [self._states.extra(cycle)]
        return [*states, *messages]

    def skip(self) -> None:
        super().skip()
        self._state.outbox.take()


# -- modes, signals and settings -----------------------------------------------------------------


def _robot_mode(state: ControllerState) -> Fields:
    modes = state.modes
    playing = modes.program_state.name
    return {
        "is_robot_connected": True,
        "is_robot_enabled": True,
        "is_power_on": modes.is_powered,
        "is_emergency_stopped": modes.safety_mode is SafetyMode.ROBOT_EMERGENCY_STOP,
        "is_protective_stopped": modes.safety_mode is SafetyMode.PROTECTIVE_STOP,
        "is_program_running": playing == "PLAYING",
        "is_program_paused": playing in ("PAUSING", "PAUSED"),
        "robot_mode": modes.robot_mode,
        "control_mode": state.control_mode,
        "target_speed_fraction": state.speed_fraction,
        "speed_scaling": state.speed_scaling,
        "target_speed_fraction_limit": 1.0,
        "reserved": 0,  # a field that only the vendor uses, so zero is assumed
    }


def _tool_data(state: ControllerState) -> Fields:
    signals, modes = state.signals, state.modes
    powered = modes.is_powered
    return {
        "analog_input_range_2": signals.analog_input_ranges[2],
        "analog_input_range_3": signals.analog_input_ranges[3],
        "analog_input_2": signals.analog_inputs[2],
        "analog_input_3": signals.analog_inputs[3],
        "tool_voltage_48V": 45.3 if powered else 0.0,
        "tool_output_voltage": signals.tool_output_voltage if powered else 0,
        "tool_current": 0.006 if powered else 0.0,
        "tool_mode": modes.tool_mode,
    }


def _masterboard(state: ControllerState) -> Fields:
    signals, modes = state.signals, state.modes
    wide = 0xFFFF if state.firmware.is_cb2 else 0xFFFFFFFF
    return {
        "digital_input_bits": signals.digital_inputs & wide,
        "digital_output_bits": signals.digital_outputs & wide,
        "analog_input_range_0": signals.analog_input_ranges[0],
        "analog_input_range_1": signals.analog_input_ranges[1],
        "analog_input_0": signals.analog_inputs[0],
        "analog_input_1": signals.analog_inputs[1],
        "analog_output_domain_0": signals.analog_output_domains[0],
        "analog_output_domain_1": signals.analog_output_domains[1],
        "analog_output_0": signals.analog_outputs[0],
        "analog_output_1": signals.analog_outputs[1],
        "masterboard_temperature": 30.0,
        "robot_voltage_48V": ROBOT_VOLTAGE if modes.is_powered else 0.0,
        "master_io_current": 0.0,
        "is_in_reduced_mode": False,
        "is_euromap_installed": False,
        "master_safety_state": modes.master_safety_state,
        "master_on_off_state": modes.master_on_off_state,
        "safety_mode": modes.safety_mode,
        "reserved_checksum": _CHECKSUM,
        # These values are from captures of simulated e-Series controllers.
        "operational_mode_selector_input": 1,
        "three_position_enabling_device_input": 1,
        "reserved": 1,
    }


def _tool_offset(state: ControllerState) -> Fields:
    return {f"tcp_offset_{axis}": value for axis, value in zip(_AXES, state.arm.tcp, strict=True)}


def _kinematics(state: ControllerState) -> Fields:
    table = np.array([getattr(state.kinematics.table, name) for name in DhTable._fields])
    # Simulated controllers of the vendor send a checksum with all bits set if the arm is not calibrated. For calibrated
    # arms, the real computation of the checksum is unknown. The computation here is assumed.
    is_calibrated = state.kinematics.is_calibrated
    checksum = [zlib.crc32(row.tobytes()) for row in table.T] if is_calibrated else [0xFFFFFFFF] * 6
    return {
        "checksum": checksum,
        **dict(zip(DhTable._fields, table.tolist(), strict=True)),
        "calibration_status": 0,  # assumed value
        # In this field, the oldest firmware sends the pose of a laser pointer. These values are from the only capture.
        "pointer": [1000.0] * 3,
    }


def _configuration(state: ControllerState) -> Fields:
    model = state.model
    # The reported limits are wider than the limits in the manual: the difference is the safety tolerance. The limit of
    # a joint without end stops is assumed.
    margin, faster = (0.0523599, 0.2) if state.firmware.is_e_series else (0.0, 0.0)
    lowest, highest = (side.clip(-1e3, 1e3).tolist() for side in model.position_limits.T)
    return {
        "joint_min_limit": [limit - margin for limit in lowest],
        "joint_max_limit": [limit + margin for limit in highest],
        "joint_max_speed": [speed + faster for speed in model.max_speed.tolist()],
        "joint_max_acceleration": model.max_acceleration.tolist(),
        # The captures of both generations contain the same values.
        "v_joint_default": 1.0471975511965976,
        "a_joint_default": 1.3962634015954636,
        "v_tool_default": 0.25,
        "a_tool_default": 1.2,
        "eq_radius": 0.25,
        **{name: getattr(model, name).tolist() for name in DhTable._fields},
        "masterboard_version": 6 if state.firmware.is_e_series else 5,
        "controller_box_type": 4 if state.firmware.is_e_series else 2,
        "robot_type": model.robot_type,
        "robot_sub_type": 3 if state.firmware.is_e_series else 1,
        "motor_type": [2] * 6,
        "reserved": [0, 0],  # a field that only the vendor uses, so zero is assumed
    }


def _additional(state: ControllerState) -> Fields:
    # These values are from captures.
    return {
        "ctrl_bits": 0x00014007,
        "teach_button": 1,
        "freedrive_button_pressed": False,
        "freedrive_button_enabled": True,
        "io_enabled_freedrive": False,
        "reserved": 1,
    }


def _safety_data(state: ControllerState) -> Fields:
    return {"checksum": _CHECKSUM, "reserved": [1, 1], "elbow_sphere_radius": _elbow_sphere(state)[1]}


def _elbow_sphere(state: ControllerState) -> tuple[float, float]:
    """Return distance and radius of the sphere around the elbow; see `_ELBOW_SPHERE`."""
    return _ELBOW_SPHERE.get(state.model.name, _ELBOW_SPHERE_ELSE[state.model.generation])


def _tool_mode(state: ControllerState) -> Fields:
    first, second = state.signals.tool_digital_output_modes
    return {
        "output_mode": state.signals.tool_output_mode,
        "digital_output_0_mode": first,
        "digital_output_1_mode": second,
    }


# -- measured values -----------------------------------------------------------------------------


def _measured_joints(measured: Measured) -> Fields:
    s = measured.sample
    # In captures, the electronics of CB joints are about 20 K warmer than the motors. The e-Series sends zeros.
    micro = [0.0] * 6 if measured.state.firmware.is_e_series else [t + 22.0 for t in s.T_motor]
    return {
        "q_actual": s.q_actual,
        "q_target": s.q_target,
        "qd_actual": s.qd_actual,
        "I_actual": s.I_actual,
        "V_actual": s.V_actual,
        "T_motor": s.T_motor,
        "T_micro": micro,
    }


def _measured_current(measured: Measured) -> Fields:
    constants = measured.state.arm.motors.torque_constants
    return {"robot_current": current_of(measured.sample, constants, measured.is_powered)}


def _measured_force(measured: Measured) -> Fields:
    axes = ("Fx", "Fy", "Fz", "Frx", "Fry", "Frz")
    dexterity = measured.state.arm.dexterity(measured.sample.q_target)
    return {**dict(zip(axes, measured.sample.force, strict=True)), "robot_dexterity": dexterity}


def _measured_elbow(measured: Measured) -> Fields:
    q1, (x, y, z) = measured.sample.q_actual[0], measured.sample.elbow_position
    shift, _ = _elbow_sphere(measured.state)
    return {"elbow_sphere_centre": [x + shift * math.sin(q1), y - shift * math.cos(q1), z]}


_AXES = ("X", "Y", "Z", "Rx", "Ry", "Rz")
#: Invented checksum of the safety configuration. Two sub-packages contain it, as in captures.
_CHECKSUM = 0x5AFE0001

# Sphere around the elbow in the safety data: distance from the elbow along the axis of the shoulder, and radius, in m.
# The values of UR5e and UR3e were read from simulated controllers. In the only capture of a CB3, both values are zero.
# The values of the larger e-Series arms are assumed.
_ELBOW_SPHERE = {"UR5e": (0.093, 0.13), "UR3e": (0.080, 0.1)}
_ELBOW_SPHERE_ELSE = {"CB": (0.0, 0.0), "e": (0.1, 0.15)}

#: Type of a sub-package -> modes, signals and settings in it, or in addition to them, measured values and the time.
_SHOWN: dict[int, Callable[[ControllerState], Fields]] = {
    0: _robot_mode,
    1: lambda state: {"joint_modes": [state.modes.joint_mode] * 6},
    2: _tool_data,
    3: _masterboard,
    4: _tool_offset,
    10: _safety_data,
    11: lambda state: state.signals.tool_communication._asdict(),
    12: _tool_mode,
}
_MEASURED: dict[int, Callable[[Measured], Fields]] = {
    0: lambda measured: {"timestamp": measured.timestamp},
    1: _measured_joints,
    2: lambda measured: {"tool_temperature": measured.sample.T_motor[5] + 15.0},
    3: _measured_current,
    4: lambda measured: dict(zip(_AXES, measured.sample.pose_actual, strict=True)),
    7: _measured_force,
    10: _measured_elbow,
}
_UNCHANGING: dict[int, Callable[[ControllerState], Fields]] = {
    5: _kinematics,
    6: _configuration,
    8: _additional,
    # The vendor does not publish the meaning of these fields; zeros are assumed.
    9: lambda state: dict.fromkeys(CalibrationData.FIELDS, 0.0),
}

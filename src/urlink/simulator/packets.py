"""What the controller sends in every cycle or ten times a second: real-time packets and robot states.

The layouts are the schemas'; a `Form` is one of them laid out to be filled in again and again, since a controller
packs hundreds of packets a second.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Mapping
from itertools import groupby
from typing import TYPE_CHECKING, Any

from linkcore.wire.layout import Layout
from urlink.firmware import release_of
from urlink.interfaces.enums import SafetyMode
from urlink.interfaces.headers import PACKAGE
from urlink.interfaces.primary.robot_state import SUB_PACKAGES
from urlink.interfaces.realtime.packets import RealtimeState

if TYPE_CHECKING:
    from .controller import Controller

__all__ = ["Form", "Packets", "package"]

Fields = Mapping[str, Any]


class Form:
    """A packet of one layout and of fixed size, filled in and packed many times.

    Gives the bytes that `Layout.encode` gives, in a tenth of the time: the values stay where they were put, and one
    `struct` packs them. Values are plain numbers and lists of them, not checked beyond what `struct` checks.
    """

    def __init__(self, layout: Layout) -> None:
        codes: list[str] = [""] * sum(place.count or 1 for place in layout.places.values())
        self._values: list[Any] = [0] * len(codes)
        self._at: dict[str, int | slice] = {}
        for name, place in layout.places.items():
            assert place.code is not None, f"{layout.packet.__name__} is of no fixed size"
            at = self._at[name] = place.at
            if isinstance(at, slice):
                codes[at] = [place.code] * len(codes[at])
            else:
                codes[at] = place.code
        packed = "".join(f"{len(list(run))}{code}" for code, run in groupby(codes))
        header = layout.header.build({"size": layout.size, **layout.constants})
        self._struct = struct.Struct(f">{len(header)}s{packed}")
        self._header = header
        self.size = layout.size

    def pack(self, fields: Fields) -> bytes:
        """The packet with these fields, the others as they were; what the layout does not send is passed over."""
        values, places = self._values, self._at
        for name, value in fields.items():
            at = places.get(name)
            if at is not None:
                values[at] = value
        return self._struct.pack(self._header, *values)


class Packets:
    """The packets of one controller that runs one firmware."""

    def __init__(self, controller: Controller) -> None:
        self._controller = controller
        firmware = controller.firmware
        release = release_of(firmware)
        self._realtime = Form(RealtimeState.LAYOUTS.of(firmware))
        self._first_only = release.first_state_only
        self._forms: dict[int, Form] = {}
        for kind, size in release.state.items():
            # Where a number had two meanings, the size tells them apart.
            for cls in SUB_PACKAGES[kind]:
                layouts = [layout for layout in cls.LAYOUTS.all if layout.size == size]
                if layouts:
                    self._forms[kind] = Form(layouts[0] if len(layouts) == 1 else cls.LAYOUTS.of(firmware))
        self._unchanging = {
            kind: self._forms[kind].pack(fill(controller)) for kind, fill in _UNCHANGING.items() if kind in self._forms
        }

    def realtime(self) -> bytes:
        """The real-time packet of this cycle."""
        return self._realtime.pack(_realtime(self._controller))

    def state(self, first: bool) -> bytes:
        """The robot state of this cycle; the first one of a connection has kinematics and configuration too."""
        controller = self._controller
        parts = []
        for kind, form in self._forms.items():
            if kind in self._first_only and not first:
                continue
            fixed = self._unchanging.get(kind)
            parts.append(form.pack(_CHANGING[kind](controller)) if fixed is None else fixed)
        body = b"".join(parts)
        return package(16, body)


def package(kind: int, body: bytes) -> bytes:
    """A package or sub-package of the primary and secondary interface."""
    return bytes(PACKAGE.build({"size": 5 + len(body), "type": kind})) + body


# -- real-time packet ----------------------------------------------------------------------------


def _realtime(controller: Controller) -> Fields:
    arm, modes, signals = controller.arm, controller.modes, controller.signals
    s = arm.sample
    powered = modes.is_powered
    return {
        "time": controller.time,
        "q_target": s.q_target,
        "qd_target": s.qd_target,
        "qdd_target": s.qdd_target,
        "I_target": s.I_target,
        "M_target": s.M_target,
        "q_actual": s.q_actual,
        "qd_actual": s.qd_actual,
        "I_actual": s.I_actual,
        "I_control": s.I_control,
        "tool_vector_actual": s.pose_actual,
        "tcp_speed_actual": s.speed_actual,
        "tcp_force": s.force,
        "tool_vector_target": s.pose_target,
        "tcp_speed_target": s.speed_target,
        "digital_input_bits": signals.digital_inputs,
        "motor_temperatures": s.T_motor,
        # The real CB2 packet holds 0.0635.
        "controller_timer": 0.06,
        "robot_mode": modes.robot_mode,
        "joint_modes": [modes.joint_mode] * 6,
        "safety_mode": modes.safety_mode,
        "tool_accelerometer": s.accelerometer,
        "speed_scaling": modes.speed_scaling * controller.speed_fraction,
        "linear_momentum_norm": s.momentum,
        "V_main": 48.0,
        "V_robot": 48.0 if powered else 0.0,
        "I_robot": _robot_current(controller),
        "V_actual": s.V_actual,
        "digital_output_bits": signals.digital_outputs,
        "program_state": modes.program_state,
        "elbow_position": s.elbow_position,
        "elbow_velocity": s.elbow_velocity,
        "safety_status": modes.safety_mode,
        "payload_mass": arm.payload,
        "payload_cog": arm.payload_cog,
        "payload_inertia": arm.payload_inertia,
    }


def _robot_current(controller: Controller) -> float:
    """A, a guess: what the electronics take, and a part of what the motors do."""
    if not controller.modes.is_powered:
        return 0.0
    return 0.3 + 0.1 * sum(map(abs, controller.arm.sample.I_actual))


# -- sub-packages of the robot state -------------------------------------------------------------


def _robot_mode(controller: Controller) -> Fields:
    modes, firmware = controller.modes, controller.firmware
    playing = modes.program_state.name
    # Captured CB2 stamps are too small for microseconds; that they are milliseconds is a guess.
    unit = 1e3 if firmware.is_cb2 else 1e6
    return {
        "timestamp": round(controller.time * unit),
        "is_robot_connected": True,
        "is_robot_enabled": True,
        "is_power_on": modes.is_powered,
        "is_emergency_stopped": modes.safety_mode is SafetyMode.ROBOT_EMERGENCY_STOP,
        "is_protective_stopped": modes.safety_mode is SafetyMode.PROTECTIVE_STOP,
        "is_program_running": playing == "PLAYING",
        "is_program_paused": playing in ("PAUSING", "PAUSED"),
        "robot_mode": modes.robot_mode,
        "target_speed_fraction": controller.speed_fraction,
        "speed_scaling": modes.speed_scaling * controller.speed_fraction,
        "target_speed_fraction_limit": 1.0,
    }


def _joint_data(controller: Controller) -> Fields:
    s = controller.arm.sample
    # Captures: the electronics of CB joints are some 20 K warmer than the motors; the e-Series sends zeros.
    micro = [0.0] * 6 if controller.firmware.is_e_series else [t + 22.0 for t in s.T_motor]
    return {
        "q_actual": s.q_actual,
        "q_target": s.q_target,
        "qd_actual": s.qd_actual,
        "I_actual": s.I_actual,
        "V_actual": s.V_actual,
        "T_motor": s.T_motor,
        "T_micro": micro,
        "joint_modes": [controller.modes.joint_mode] * 6,
    }


def _tool_data(controller: Controller) -> Fields:
    signals, modes = controller.signals, controller.modes
    powered = modes.is_powered
    return {
        "analog_input_range_2": signals.analog_input_ranges[2],
        "analog_input_range_3": signals.analog_input_ranges[3],
        "analog_input_2": signals.analog_inputs[2],
        "analog_input_3": signals.analog_inputs[3],
        "tool_voltage_48V": 45.3 if powered else 0.0,
        "tool_output_voltage": signals.tool_output_voltage if powered else 0,
        "tool_current": 0.006 if powered else 0.0,
        "tool_temperature": controller.arm.sample.T_motor[5] + 15.0,
        "tool_mode": modes.tool_mode,
    }


def _masterboard(controller: Controller) -> Fields:
    signals, modes = controller.signals, controller.modes
    wide = 0xFFFF if controller.firmware.is_cb2 else 0xFFFFFFFF
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
        "robot_voltage_48V": 48.0 if modes.is_powered else 0.0,
        "robot_current": _robot_current(controller),
        "master_io_current": 0.0,
        "master_safety_state": modes.master_safety_state,
        "master_on_off_state": modes.master_on_off_state,
        "safety_mode": modes.safety_mode,
        "reserved_checksum": _CHECKSUM,
        # As in the captures of simulated e-Series controllers.
        "operational_mode_selector_input": 1,
        "three_position_enabling_device_input": 1,
        "reserved": 1,
    }


def _cartesian(controller: Controller) -> Fields:
    pose, tcp = controller.arm.sample.pose_actual, controller.arm.tcp
    axes = ("X", "Y", "Z", "Rx", "Ry", "Rz")
    offsets = (f"tcp_offset_{axis}" for axis in axes)
    return {**dict(zip(axes, pose, strict=True)), **dict(zip(offsets, tcp, strict=True))}


def _kinematics(controller: Controller) -> Fields:
    model = controller.model
    return {
        # All ones: not calibrated, as simulated controllers send it.
        "checksum": [0xFFFFFFFF] * 6,
        "dh_theta": model.dh_theta.tolist(),
        "dh_a": model.dh_a.tolist(),
        "dh_d": model.dh_d.tolist(),
        "dh_alpha": model.dh_alpha.tolist(),
        # The oldest firmware has its laser pointer here; these are the bytes of the one capture.
        "pointer": [1000.0] * 3,
    }


def _configuration(controller: Controller) -> Fields:
    model = controller.model
    # What a controller reports is wider than the manual by its safety tolerance; an endless joint is a guess.
    margin, faster = (0.0523599, 0.2) if controller.firmware.is_e_series else (0.0, 0.0)
    lowest, highest = (side.clip(-1e3, 1e3).tolist() for side in model.position_limits.T)
    return {
        "joint_min_limit": [limit - margin for limit in lowest],
        "joint_max_limit": [limit + margin for limit in highest],
        "joint_max_speed": [speed + faster for speed in model.max_speed.tolist()],
        "joint_max_acceleration": model.max_acceleration.tolist(),
        # The same in the captures of both generations.
        "v_joint_default": 1.0471975511965976,
        "a_joint_default": 1.3962634015954636,
        "v_tool_default": 0.25,
        "a_tool_default": 1.2,
        "eq_radius": 0.25,
        "dh_a": model.dh_a.tolist(),
        "dh_d": model.dh_d.tolist(),
        "dh_alpha": model.dh_alpha.tolist(),
        "dh_theta": model.dh_theta.tolist(),
        "masterboard_version": 6 if controller.firmware.is_e_series else 5,
        "controller_box_type": 4 if controller.firmware.is_e_series else 2,
        "robot_type": model.robot_type,
        "robot_sub_type": 3 if controller.firmware.is_e_series else 1,
        "motor_type": [2] * 6,
    }


def _force_mode(controller: Controller) -> Fields:
    force = controller.arm.sample.force
    axes = ("Fx", "Fy", "Fz", "Frx", "Fry", "Frz")
    return {**dict(zip(axes, force, strict=True)), "robot_dexterity": controller.arm.dexterity}


def _additional(controller: Controller) -> Fields:
    # The bytes of the captures.
    return {
        "ctrl_bits": 0x00014007,
        "teach_button": 1,
        "freedrive_button_pressed": False,
        "freedrive_button_enabled": True,
        "io_enabled_freedrive": False,
        "reserved": 1,
    }


def _safety_data(controller: Controller) -> Fields:
    s, q1 = controller.arm.sample, controller.arm.sample.q_actual[0]
    shift, radius = _ELBOW_SPHERE.get(controller.model.name, _ELBOW_SPHERE_ELSE[controller.model.generation])
    x, y, z = s.elbow_position
    return {
        "checksum": _CHECKSUM,
        "reserved": [1, 1],
        "elbow_sphere_centre": [x + shift * math.sin(q1), y - shift * math.cos(q1), z],
        "elbow_sphere_radius": radius,
    }


def _tool_communication(controller: Controller) -> Fields:
    # The bytes of the captures: a line of 115200 Bd that is not enabled.
    return {"baud_rate": 115200, "stop_bits": 1, "rx_idle_chars": 1.5, "tx_idle_chars": 3.5}


def _tool_mode(controller: Controller) -> Fields:
    return {"output_mode": 0, "digital_output_0_mode": 1, "digital_output_1_mode": 1}


def _nothing(controller: Controller) -> Fields:
    return {}


#: Of the safety configuration: one made-up number in both places where captures show the same one twice.
_CHECKSUM = 0x5AFE0001

# Along the axis of the shoulder, and radius; m. Read off a simulated UR5e and UR3e; on CB3 both are zero in the one
# capture there is. The larger e-Series arms are a guess.
_ELBOW_SPHERE = {"UR5e": (0.093, 0.13), "UR3e": (0.080, 0.1)}
_ELBOW_SPHERE_ELSE = {"CB": (0.0, 0.0), "e": (0.1, 0.15)}

_CHANGING: dict[int, Callable[[Controller], Fields]] = {
    0: _robot_mode,
    1: _joint_data,
    2: _tool_data,
    3: _masterboard,
    4: _cartesian,
    7: _force_mode,
    10: _safety_data,
}
_UNCHANGING: dict[int, Callable[[Controller], Fields]] = {
    5: _kinematics,
    6: _configuration,
    8: _additional,
    9: _nothing,
    11: _tool_communication,
    12: _tool_mode,
}

"""Real-time interface, port 30003. It sends one packet per cycle, and nothing else at the beginning of a connection.

A packet remembers what it shows, and makes its bytes when they are read; see `linkcore.deferred`. See
docs/protocols/realtime.md.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from operator import attrgetter
from typing import Any, NamedTuple

from linkcore.deferred import Deferred
from linkcore.wire.deferred_packet import DeferredPacket
from linkcore.wire.state_layouts import StateLayout
from urlink.protocol.firmware import Firmware
from urlink.protocol.realtime.packets import RealtimeState

from ..robot.modes import ShownModes
from ..robot.sensors import Sample, Samples
from ..rtde_variables import MAIN_VOLTAGE, ROBOT_VOLTAGE, current_of, execution_time_of
from ..state import ControllerState
from .interface import Form, Interface, InterfaceClient, ScriptReceiver

#: First bytes of each packet: its size and its time.
_HEAD = struct.Struct(">id")


class RealtimeInterface(Interface):
    """Real-time interface of one controller.

    Args:
        state: State of the controller.
        receiver: Function that makes the receiver of a client, given the name of the interface.
    """

    def __init__(self, state: ControllerState, receiver: Callable[[str, InterfaceClient], ScriptReceiver]) -> None:
        self._state = state
        self._make_receiver = receiver
        self._form: Form[StateLayout] | None = None
        self._firmware: Firmware | None = None
        # What the latest packet shows.
        self._shown: Shown | None = None

    def next_cycle(self, cycle: int) -> int:
        return cycle + 1

    def packets(self, cycle: int) -> Sequence[bytes | Deferred]:
        return [self.packet()]

    def receiver(self, client: InterfaceClient) -> ScriptReceiver:
        return self._make_receiver("realtime", client)

    def packet(self) -> RealtimePacket:
        """Return the packet of this cycle."""
        state = self._state
        if self._form is None or self._firmware is not state.firmware:
            # Initially, and after a reboot into another firmware.
            self._form, self._firmware = Form(RealtimeState.LAYOUTS.of(state.firmware)), state.firmware
        before, self._shown = self._shown, shown_by(state)
        is_steady = before is not None and self._shown[_STEADY] == before[_STEADY]
        return RealtimePacket(self._form, self._shown, is_steady)

    def later_packets(self, samples: Samples) -> LaterPackets:
        """Return the packets of the cycle of the last packet, and of later cycles; see `ControlLoop.advance_many`.

        Args:
            samples: Sensors of each of these cycles.
        """
        assert self._form is not None, "no packet was made"
        assert self._shown is not None, "no packet was made"
        rate = self._state.rate
        return LaterPackets(self._form, self._shown, round(self._shown.time * rate), rate, samples)

    def steady_packet(self) -> RealtimePacket | None:
        """Return the packet of this cycle if it is steady; None if `packet` must make it when it is sent."""
        before = self._shown
        packet = self.packet()
        if packet.is_steady:
            return packet
        self._shown = before
        return None


class Shown(NamedTuple):
    """What the packet of one cycle shows. Nothing in it changes later.

    Attributes:
        sample: Values of the sensors.
        time: Time since the controller came up, in s.
        digital_inputs, digital_outputs: Bit masks.
        is_e_series: Whether the controller is an e-Series.
        modes: Modes.
        slider: Fraction of the speed slider.
        payload, payload_cog, payload_inertia: Payload, in kg, m and kg m².
        torque_constants: Torque constants of the motors, shape (6,), in Nm/A.
    """

    sample: Sample
    time: float
    digital_inputs: int
    digital_outputs: int
    is_e_series: bool
    modes: ShownModes
    slider: float
    payload: float
    payload_cog: Sequence[float]
    payload_inertia: Sequence[float]
    torque_constants: Sequence[float]


#: Values of `Shown` that are equal in steady packets: all except the sample and the time.
_STEADY = slice(2, None)


def shown_by(state: ControllerState) -> Shown:
    """Return what the packet of this cycle shows."""
    arm, signals = state.arm, state.signals
    return Shown(
        arm.sample,
        state.time,
        signals.digital_inputs,
        signals.digital_outputs,
        state.firmware.is_e_series,
        state.modes.shown,
        state.slider,
        arm.payload,
        arm.payload_cog,
        arm.payload_inertia,
        arm.motors.torque_constants,
    )


class LaterPackets(Sequence["RealtimePacket"]):
    """Packets of cycles in which only the time and the targets change. Each packet is made when it is accessed.

    Args:
        form: Form of the packets.
        shown: What the packet of the first cycle shows.
        uptime: Number of the first cycle since the controller came up.
        rate: Cycles per second.
        samples: Sensors of each cycle.
    """

    def __init__(self, form: Form[StateLayout], shown: Shown, uptime: int, rate: int, samples: Samples) -> None:
        self._form = form
        self._shown = shown
        self._uptime = uptime
        self._rate = rate
        self._samples = samples

    def __len__(self) -> int:
        return len(self._samples)

    def __getitem__(self, at: Any) -> Any:
        if isinstance(at, slice):
            return [self[each] for each in range(len(self))[at]]
        at = range(len(self))[at]
        time = (self._uptime + at) / self._rate
        return RealtimePacket(self._form, self._shown._replace(sample=self._samples[at], time=time), is_steady=True)


class RealtimePacket(DeferredPacket):
    """Real-time packet of one cycle."""

    __slots__ = ("_bytes", "_form", "_shown")

    def __init__(self, form: Form[StateLayout], shown: Shown, is_steady: bool) -> None:
        # The constructors of the base classes only set these attributes, and a call of each would take longer.
        self.layout = form.layout
        self.head = _HEAD.pack(form.layout.size, shown.time)
        self.is_steady = is_steady
        self._form = form
        self._shown = shown
        self._bytes: bytes | None = None

    def __bytes__(self) -> bytes:
        if self._bytes is None:
            shown = self._shown
            self._bytes = self._form.pack({name: read(shown) for name, read in FIELDS.items()})
        return self._bytes

    def field(self, name: str) -> Any:
        return FIELDS[name](self._shown)


def _always(value: Any) -> Callable[[Shown], Any]:
    return lambda shown: value


#: Field -> function that reads its value.
FIELDS: dict[str, Callable[[Shown], Any]] = {
    "time": attrgetter("time"),
    "q_target": attrgetter("sample.q_target"),
    "qd_target": attrgetter("sample.qd_target"),
    "qdd_target": attrgetter("sample.qdd_target"),
    "I_target": attrgetter("sample.I_target"),
    "M_target": attrgetter("sample.M_target"),
    "q_actual": attrgetter("sample.q_actual"),
    "qd_actual": attrgetter("sample.qd_actual"),
    "I_actual": attrgetter("sample.I_actual"),
    "I_control": attrgetter("sample.I_control"),
    "tool_vector_actual": attrgetter("sample.pose_actual"),
    "tcp_speed_actual": attrgetter("sample.speed_actual"),
    "tcp_force": attrgetter("sample.force"),
    "tool_vector_target": attrgetter("sample.pose_target"),
    "tcp_speed_target": attrgetter("sample.speed_target"),
    "digital_input_bits": attrgetter("digital_inputs"),
    "motor_temperatures": attrgetter("sample.T_motor"),
    "controller_timer": lambda shown: execution_time_of(shown.is_e_series, shown.modes.program_state),
    "robot_mode": attrgetter("modes.robot_mode"),
    "joint_modes": lambda shown: [shown.modes.joint_mode] * 6,
    "safety_mode": attrgetter("modes.safety_mode"),
    "tool_accelerometer": attrgetter("sample.accelerometer"),
    "speed_scaling": lambda shown: shown.modes.speed_scaling * shown.slider,
    "linear_momentum_norm": attrgetter("sample.momentum"),
    "V_main": _always(MAIN_VOLTAGE),
    "V_robot": lambda shown: ROBOT_VOLTAGE if shown.modes.is_powered else 0.0,
    "I_robot": lambda shown: current_of(shown.sample, shown.torque_constants, shown.modes.is_powered),
    "V_actual": attrgetter("sample.V_actual"),
    "digital_output_bits": attrgetter("digital_outputs"),
    "program_state": attrgetter("modes.program_state"),
    "elbow_position": attrgetter("sample.elbow_position"),
    "elbow_velocity": attrgetter("sample.elbow_velocity"),
    "safety_status": attrgetter("modes.safety_mode"),
    "payload_mass": attrgetter("payload"),
    "payload_cog": attrgetter("payload_cog"),
    "payload_inertia": attrgetter("payload_inertia"),
    # These fields are unused, or have a meaning that only the vendor knows; zero is assumed.
    "test_value": _always(0.0),
    "unused": _always([0.0] * 15),
    "reserved_a": _always([0.0] * 6),
    "reserved_b": _always([0.0] * 6),
    "reserved_c": _always(0.0),
    "reserved_d": _always(0.0),
    "reserved_e": _always([0.0] * 3),
}

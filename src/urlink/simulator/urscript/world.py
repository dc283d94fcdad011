"""Protocols that define how a program uses the controller.

Programs must not change sequences of the controller. A caller that stores a sequence must copy it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, Protocol

from urlink.arm.dynamics import Dynamics
from urlink.arm.kinematics import Arm
from urlink.arm.motors import Motors
from urlink.arm.vectors import FloatArray
from urlink.protocol.firmware import Firmware

from ..registers import Action, RegisterBanks
from ..robot.generator import ForceTask
from ..robot.signals import ModbusSignals, Signals


class BegunMove(Protocol):
    """Motion that has begun."""

    @property
    def is_over(self) -> bool:
        """Whether the function that began the motion returns now, because the goal or its blend zone is reached."""


class MotionCommands(Protocol):
    """Commands that move the arm. Each method begins a motion and returns immediately."""

    @property
    def is_standing(self) -> bool:
        """Whether no joint moves."""

    @property
    def waypoint(self) -> Sequence[float] | None:
        """Pose of the TCP at the end of the current path move, in m and rad; None if there is none."""

    def movej(self, q: Sequence[float], a: float, v: float, t: float, r: float) -> BegunMove:
        """Move to joint positions, along a straight line in joint space."""

    def movel(self, pose: Sequence[float], a: float, v: float, t: float, r: float) -> BegunMove:
        """Move to a pose, along a straight line."""

    def optimovel(self, pose: Sequence[float], a: float, v: float, r: float) -> BegunMove:
        """Move to a pose along a straight line, with a speed at which no joint exceeds its limits."""

    def movep(self, pose: Sequence[float], a: float, v: float, r: float) -> BegunMove:
        """Move to a pose at constant speed."""

    def movec(self, via: Sequence[float], to: Sequence[float], a: float, v: float, r: float, mode: int) -> BegunMove:
        """Move to a pose along a circle."""

    def servoj(self, q: Sequence[float], t: float, lookahead_time: float, gain: float) -> BegunMove:
        """Move to a set-point of the joints, as one of a sequence of set-points."""

    def servoc(self, pose: Sequence[float], a: float, v: float, r: float) -> BegunMove:
        """Move to a pose."""

    def speedj(self, qd: Sequence[float], a: float, t: float | None) -> BegunMove:
        """Move the joints at a speed."""

    def speedl(self, xd: Sequence[float], a: float, t: float | None, a_rot: float) -> BegunMove:
        """Move the tool at a speed."""

    def stopj(self, a: float) -> BegunMove:
        """Brake the joints."""

    def stopl(self, a: float, a_rot: float) -> BegunMove:
        """Brake the tool."""

    def direct_torque(
        self, dynamics: Dynamics, motors: Motors, torque: FloatArray, friction: Sequence[float]
    ) -> BegunMove:
        """Move the joints by torques for one cycle."""

    def release(self) -> None:
        """End the current command, and let the arm brake."""


class ScriptSockets(Protocol):
    """Named sockets of a program. No method blocks."""

    def open(self, name: str, host: str, port: int) -> None:
        """Begin to connect."""

    def state(self, name: str) -> Literal["connecting", "open", "failed", "closed"]:
        """Return the state of a socket."""

    def send(self, name: str, data: bytes) -> bool:
        """Send data; return False if the socket is not open."""

    def received(self, name: str) -> bytearray:
        """Return the buffer of received bytes.

        The caller deletes the bytes that it has used from this buffer.
        """

    def close(self, name: str) -> None:
        """Close a socket, if it is open."""

    def close_all(self) -> None:
        """Close all sockets."""


class SensorValues(Protocol):
    """Values of the sensors in one cycle. Each value is computed when it is read, even many cycles later."""

    @property
    def q_actual(self) -> Sequence[float]:
        """Joint positions, shape (6,), in rad."""


class ScriptWorld(Protocol):
    """Controller, as a program uses it.

    Attributes:
        period: Duration of a controller cycle, in s.
        sensors: Values of the sensors in this cycle.
        q_actual, qd_actual, q_target, qd_target: Six numbers each, in rad and rad/s.
        qdd_target: Six numbers, in rad/s².
        pose_actual, pose_target: Pose of the TCP in the base frame, in m and rad.
        speed_actual, speed_target: Speed of the TCP, in m/s and rad/s.
        force: Wrench at the TCP, in N and Nm.
        dynamics: Dynamics of the arm with rotors and payload.
        motors: Motors of the arm.
        torques: Joint torques of the target motion, in Nm.
        tcp: TCP in the flange frame, in m and rad.
        payload: Mass of the payload, in kg.
        payload_cog: Centre of mass of the payload in the flange frame, in m.
        payload_inertia: Inertia of the payload, xx, yy, zz, xy, xz, yz, in kg m².
        registers: General-purpose registers.
        flags: Flags that programs set with `set_flag`.
    """

    @property
    def firmware(self) -> Firmware: ...
    @property
    def kinematics(self) -> Arm: ...
    @property
    def period(self) -> float: ...
    @property
    def motion(self) -> MotionCommands: ...
    @property
    def signals(self) -> Signals: ...
    @property
    def sockets(self) -> ScriptSockets: ...
    @property
    def sensors(self) -> SensorValues: ...
    @property
    def q_actual(self) -> Sequence[float]: ...
    @property
    def qd_actual(self) -> Sequence[float]: ...
    @property
    def q_target(self) -> Sequence[float]: ...
    @property
    def qd_target(self) -> Sequence[float]: ...
    @property
    def qdd_target(self) -> Sequence[float]: ...
    @property
    def pose_actual(self) -> Sequence[float]: ...
    @property
    def pose_target(self) -> Sequence[float]: ...
    @property
    def speed_actual(self) -> Sequence[float]: ...
    @property
    def speed_target(self) -> Sequence[float]: ...
    @property
    def force(self) -> Sequence[float]: ...
    @property
    def dynamics(self) -> Dynamics: ...
    @property
    def motors(self) -> Motors: ...
    @property
    def torques(self) -> Sequence[float]: ...
    @property
    def tcp(self) -> Sequence[float]: ...
    @property
    def payload(self) -> float: ...
    @property
    def payload_cog(self) -> Sequence[float]: ...
    @property
    def payload_inertia(self) -> Sequence[float]: ...
    @property
    def flags(self) -> list[bool]: ...
    @property
    def registers(self) -> RegisterBanks: ...
    @property
    def modbus(self) -> ModbusSignals: ...

    def rtde_value(self, name: str) -> Any:
        """Return the RTDE output of this name: a number, a truth value, or a sequence of numbers.

        Raises:
            BadValue: If there is no such output.
        """

    def set_watchdog(self, variable: str, frequency: float, action: Action) -> None:
        """Set a watchdog: this RTDE input must arrive at least `frequency` times per second; 0 removes the watchdog.

        Raises:
            BadValue: If there is no such input.
        """

    def use_external_force(self, is_used: bool) -> None:
        """Select the source of the force at the TCP: the RTDE input `external_force_torque`, or the sensor."""

    def zero_force(self) -> None:
        """Make the current force at the TCP the new zero."""

    def contact_steps(self, direction: Sequence[float]) -> int:
        """Return the number of cycles since a contact that opposes a motion began; 0 if there is no contact.

        Args:
            direction: Direction of the motion in the base frame, shape (3,). Three zeros select contacts from every
                direction.
        """

    @property
    def external_torques(self) -> Sequence[float]:
        """External torques on the joints, in Nm."""

    def force_mode(self, task: ForceTask) -> None:
        """Begin force mode, in which the arm yields along some axes until a force is reached."""

    def set_force_damping(self, damping: float) -> None:
        """Set the damping of force mode, 0 to 1."""

    def set_force_gain(self, gain: float) -> None:
        """Set the gain of force mode, 0 to 2."""

    def freedrive(self, axes: Sequence[bool], frame: Sequence[float]) -> None:
        """Let a person move the arm by hand, along these axes of a frame."""

    def end_compliance(self) -> None:
        """End force mode or freedrive."""

    def set_tcp(self, pose: Sequence[float]) -> None:
        """Set the TCP in the flange frame, in m and rad."""

    def set_payload(
        self, mass: float, cog: Sequence[float] | None, inertia: Sequence[float] | None, seconds: float = 0.0
    ) -> None:
        """Set mass, centre of mass and inertia of the payload, in kg, m and kg m². The change takes `seconds`.

        If an argument is None, the controller's current value is kept.
        """

    def set_gravity(self, vector: Sequence[float]) -> None:
        """Set the gravity, in the base frame, in m/s². The vector points upwards."""

    def text_message(self, text: str) -> None:
        """Send a text message to all clients of the primary interface."""

    def popup(self, text: str, title: str, is_warning: bool, is_error: bool, is_blocking: bool) -> None:
        """Show a popup on the pendant."""

    @property
    def has_popup(self) -> bool:
        """Whether the pendant shows a popup."""

    def protective_stop(self) -> None:
        """Make a protective stop. The program is paused until the stop is unlocked."""

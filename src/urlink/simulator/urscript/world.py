"""The controller, as its programs use it.

Sequences are read-only; a caller that keeps one copies it.
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
    """A movement that was begun."""

    @property
    def is_over(self) -> bool:
        """Whether the function that began it returns: the goal, or the blend zone about it, is reached."""


class MotionCommands(Protocol):
    """The commands that move the arm; each begins a motion and returns at once."""

    @property
    def is_standing(self) -> bool:
        """Whether no joint moves."""

    @property
    def waypoint(self) -> Sequence[float] | None:
        """The pose of the TCP at the end of the present path move, m and rad; None if there is none."""

    def movej(self, q: Sequence[float], a: float, v: float, t: float, r: float) -> BegunMove:
        """To joint positions, along a straight line in joint space."""

    def movel(self, pose: Sequence[float], a: float, v: float, t: float, r: float) -> BegunMove:
        """To a pose, along a straight line."""

    def optimovel(self, pose: Sequence[float], a: float, v: float, r: float) -> BegunMove:
        """To a pose, along a straight line, within the limits of the joints."""

    def movep(self, pose: Sequence[float], a: float, v: float, r: float) -> BegunMove:
        """To a pose at constant speed."""

    def movec(self, via: Sequence[float], to: Sequence[float], a: float, v: float, r: float, mode: int) -> BegunMove:
        """To a pose along a circle."""

    def servoj(self, q: Sequence[float], t: float, lookahead_time: float, gain: float) -> BegunMove:
        """Follow a set-point of the joints."""

    def servoc(self, pose: Sequence[float], a: float, v: float, r: float) -> BegunMove:
        """Follow a pose."""

    def speedj(self, qd: Sequence[float], a: float, t: float | None) -> BegunMove:
        """Turn the joints at a speed."""

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
        """End the commands: the arm brakes."""


class ScriptSockets(Protocol):
    """The named sockets of a program. Nothing here waits."""

    def open(self, name: str, host: str, port: int) -> None:
        """Begin to connect."""

    def state(self, name: str) -> Literal["connecting", "open", "failed", "closed"]:
        """The state of a socket."""

    def send(self, name: str, data: bytes) -> bool:
        """Send data; False if the socket is not open."""

    def received(self, name: str) -> bytearray:
        """Bytes that were received and not taken; the caller deletes those that it takes."""

    def close(self, name: str) -> None:
        """Close it, if it is open."""

    def close_all(self) -> None:
        """Close every one."""


class ScriptWorld(Protocol):
    """The controller, as its programs use it.

    Attributes:
        period: s per controller cycle.
        q_actual, qd_actual, q_target, qd_target: six numbers, rad and rad/s.
        qdd_target: six numbers, rad/s².
        pose_actual, pose_target: the TCP in the base frame, m and rad.
        speed_actual, speed_target: of the TCP, m/s and rad/s.
        force: at the TCP, N and Nm.
        dynamics: of the arm with its rotors and its payload.
        motors: of the arm.
        torques: of the joints, Nm.
        tcp: the TCP in the flange frame.
        payload: kg.
        payload_cog: its centre of mass in the flange frame, m.
        payload_inertia: xx, yy, zz, xy, xz, yz in kg m².
        registers: general-purpose registers.
        flags: of `set_flag`.
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
        """The RTDE output of this name: a number, a truth value, or a sequence of numbers.

        Raises:
            BadValue: there is no such output.
        """

    def set_watchdog(self, variable: str, frequency: float, action: Action) -> None:
        """Require this RTDE input so many times a second from now on; 0 ends that.

        Raises:
            BadValue: there is no such input.
        """

    def use_external_force(self, is_used: bool) -> None:
        """Take the force at the TCP from the RTDE input `external_force_torque`, or from the sensor."""

    def zero_force(self) -> None:
        """Make the present force at the TCP the new zero."""

    def contact_steps(self, direction: Sequence[float]) -> int:
        """Cycles since a contact began that opposes a movement in a direction, (3,) in the base frame; 0 without one.
        Zeros ask for contacts of every direction."""

    @property
    def external_torques(self) -> Sequence[float]:
        """External torques on the joints, Nm."""

    def force_mode(self, task: ForceTask) -> None:
        """Begin force mode: yield along some axes until a force is there."""

    def set_force_damping(self, damping: float) -> None:
        """Set the damping of force mode, 0 to 1."""

    def set_force_gain(self, gain: float) -> None:
        """Set the gain of force mode, 0 to 2."""

    def freedrive(self, axes: Sequence[bool], frame: Sequence[float]) -> None:
        """Let the arm be moved by hand along these axes of a frame."""

    def end_compliance(self) -> None:
        """End force mode or freedrive."""

    def set_tcp(self, pose: Sequence[float]) -> None:
        """Set the TCP in the flange frame, m and rad."""

    def set_payload(
        self, mass: float, cog: Sequence[float] | None, inertia: Sequence[float] | None, seconds: float = 0.0
    ) -> None:
        """Set the payload in kg, m and kg m², over so many s; None leaves a value to the controller."""

    def set_gravity(self, vector: Sequence[float]) -> None:
        """Set the acceleration of an arm at rest, in the base frame, m/s²."""

    def text_message(self, text: str) -> None:
        """Send a text to the log and to all clients of the primary interface."""

    def popup(self, text: str, title: str, is_warning: bool, is_error: bool, is_blocking: bool) -> None:
        """Show a popup on the pendant."""

    @property
    def has_popup(self) -> bool:
        """Whether a popup is on the pendant and was not closed."""

    def protective_stop(self) -> None:
        """Stop the arm; the program is not advanced until the stop is unlocked."""

"""Interface between a running program and the controller, and the sockets of a program.

`ProgramWorld` implements the protocol `ScriptWorld` of `urlink.simulator.urscript`.

Programs can connect to this computer and to the computers of connected clients. They can connect to other computers
only if the controller allows these addresses. For a program, 127.0.0.1 is the controller, and its ports have the
numbers of a real controller, even if other port numbers are served. Host names are not resolved, because this could
take seconds. No function of this module blocks; see `linkcore.net.polled`.
"""

from __future__ import annotations

import ipaddress
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeVar, cast

from linkcore.errors import BadValue
from linkcore.net.polled import PolledConnection, State
from urlink.arm.parameters import number
from urlink.protocol.rtde.variables import INPUTS, OUTPUTS

from ..messages import popup_message, text_message
from ..registers import Action
from ..robot.generator import ArmDrive, ForceTask, MotionGenerator
from ..rtde_variables import OUTPUT_VALUES
from ..state import ControllerState


class Target(NamedTuple):
    """Address and port to which a connection of a program is made.

    Attributes:
        host: Numeric address.
        port: TCP port.
        source: Numeric address of this computer from which to connect. None lets the system choose.
    """

    host: str
    port: int
    source: str | None = None


#: Function that returns the target for a numeric address and a port; None if a program may not connect to them.
Route = Callable[[str, int], Target | None]

T = TypeVar("T")

#: Force of an unknown weight on the tool, in N, at which freedrive does not begin; the code that the controller then
#: reports, according to the vendor's list.
_UNKNOWN_FORCE, _WRONG_LOAD = number("unknown_force_limit"), (156, 0)
#: Maximum number of sockets of a program. A socket counts until the program closes it.
MOST = 16
#: Maximum number of received bytes that are buffered for one socket. If the buffer is full, the peer has to wait.
MOST_WAITING = 1 << 16


class ProgramSockets:
    """The named sockets of one program.

    Args:
        route: Function that returns the target of each connection.
    """

    def __init__(self, route: Route) -> None:
        self._route = route
        self._connections: dict[str, PolledConnection] = {}

    def open(self, name: str, host: str, port: int) -> None:
        """Begin to connect. An existing socket with the same name is closed."""
        self.close(name)
        try:
            address = str(ipaddress.ip_address("127.0.0.1" if host == "localhost" else host))
        except ValueError:
            return
        target = self._route(address, port)
        if target is not None and 0 < target.port < 65536 and len(self._connections) < MOST:
            self._connections[name] = PolledConnection(
                target.host, target.port, most_waiting=MOST_WAITING, source=target.source
            )

    def state(self, name: str) -> State:
        """Return the state of a socket.

        The state is also "closed" if the route did not allow the connection, or if the program has too many sockets.
        """
        connection = self._connections.get(name)
        return "closed" if connection is None else connection.state

    def send(self, name: str, data: bytes) -> bool:
        """Send all bytes immediately.

        Return False if the socket is not open, or if the peer does not accept all bytes. In the second case, the socket
        is closed.
        """
        connection = self._connections.get(name)
        return connection is not None and connection.send(data)

    def received(self, name: str) -> bytearray:
        """Return the buffer of received bytes. The caller deletes the bytes that it has used from this buffer."""
        connection = self._connections.get(name)
        return bytearray() if connection is None else connection.receive()

    def close(self, name: str) -> None:
        """Close a socket, if it exists, and discard its bytes."""
        connection = self._connections.pop(name, None)
        if connection is not None:
            connection.close()

    def close_all(self) -> None:
        """Close all sockets."""
        for name in list(self._connections):
            self.close(name)


def _reads(read: Callable[[ProgramWorld], T]) -> T:
    """Return a read-only property whose value is calculated by this function."""
    return cast(T, property(read))


class ProgramWorld:
    """Access of one program to the controller; implements `ScriptWorld` of `urlink.simulator.urscript`.

    Args:
        state: State of the controller.
        route: Function that returns the targets of the program's connections.
        drive: Drive that moves the arm for the program. None for a secondary program, which cannot command the arm, but
            can read whether it moves.
    """

    def __init__(self, state: ControllerState, route: Route, drive: ArmDrive | None = None) -> None:
        self._state = state
        self._drive = drive
        self.sockets = ProgramSockets(route)
        self.period = state.period

    @property
    def motion(self) -> MotionGenerator:
        if self._drive is None:
            return MotionGenerator(self._state.kinematics, self._state.arm.setpoint)
        return self._drive.generator

    firmware = _reads(lambda world: world._state.firmware)
    kinematics = _reads(lambda world: world._state.kinematics)
    dynamics = _reads(lambda world: world._state.arm.dynamics)
    motors = _reads(lambda world: world._state.arm.motors)
    signals = _reads(lambda world: world._state.signals)
    flags = _reads(lambda world: world._state.flags)
    registers = _reads(lambda world: world._state.registers)
    modbus = _reads(lambda world: world._state.modbus)
    sensors = _reads(lambda world: world._state.arm.sample)
    q_actual = _reads(lambda world: world._state.arm.q_actual)
    qd_actual = _reads(lambda world: world._state.arm.qd_actual)
    q_target = _reads(lambda world: world._state.arm.setpoint.q)
    qd_target = _reads(lambda world: world._state.arm.setpoint.qd)
    qdd_target = _reads(lambda world: world._state.arm.setpoint.qdd)
    pose_actual = _reads(lambda world: world._state.arm.sample.pose_actual)
    pose_target = _reads(lambda world: world._state.arm.sample.pose_target)
    speed_actual = _reads(lambda world: world._state.arm.sample.speed_actual)
    speed_target = _reads(lambda world: world._state.arm.sample.speed_target)
    force = _reads(lambda world: world._state.arm.sample.force)
    torques = _reads(lambda world: world._state.arm.sample.M_target)
    tcp = _reads(lambda world: world._state.arm.tcp)

    def set_tcp(self, pose: Sequence[float]) -> None:
        self._state.arm.tcp = list(pose)
        if self._drive is not None:
            # Set the TCP of the generator now, because a motion might follow in the same cycle.
            self._drive.generator.tcp = pose

    payload = _reads(lambda world: world._state.arm.payload)
    payload_cog = _reads(lambda world: world._state.arm.payload_cog)
    payload_inertia = _reads(lambda world: world._state.arm.payload_inertia)

    def set_payload(
        self, mass: float, cog: Sequence[float] | None, inertia: Sequence[float] | None, seconds: float = 0.0
    ) -> None:
        arm = self._state.arm
        cog, inertia = arm.payload_cog if cog is None else cog, arm.payload_inertia if inertia is None else inertia
        arm.carry((mass, *cog, *inertia), seconds)

    def set_gravity(self, vector: Sequence[float]) -> None:
        self._state.arm.gravity = tuple(vector)

    def rtde_value(self, name: str) -> Any:
        known = OUTPUTS.get(name)
        if known is None or not known.is_in(self._state.firmware):
            raise BadValue(f"get_rtde_value: there is no RTDE output '{name}'")
        return OUTPUT_VALUES[name](self._state)

    def set_watchdog(self, variable: str, frequency: float, action: Action) -> None:
        known = INPUTS.get(variable)
        if known is None or not known.is_in(self._state.firmware):
            raise BadValue(f"rtde_set_watchdog: there is no RTDE input '{variable}'")
        cycles = self._state.rate / frequency if frequency > 0.0 else math.inf
        self._state.watchdogs.set(variable, cycles, action, self._state.cycle)

    def use_external_force(self, is_used: bool) -> None:
        self._state.arm.uses_external_force = is_used

    def zero_force(self) -> None:
        self._state.arm.zero_force()

    def contact_steps(self, direction: Sequence[float]) -> int:
        return self._state.arm.force_sensor.contact_steps(direction)

    external_torques = _reads(lambda world: world._state.arm.external_torques)

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
        if self._drive is None:
            return
        state = self._state
        if not self._drive.yields and state.arm.force_sensor.weight > _UNKNOWN_FORCE:
            state.stop_protectively(
                "freedrive cannot begin with a load that differs from the payload", code=_WRONG_LOAD
            )
            return
        self._drive.freedrive(axes, frame)

    def end_compliance(self) -> None:
        if self._drive is not None:
            self._drive.end_mode()

    def text_message(self, text: str) -> None:
        self._state.outbox.offer(lambda: text_message(self._state, text))

    def popup(self, text: str, title: str, is_warning: bool, is_error: bool, is_blocking: bool) -> None:
        state = self._state
        state.popup = text
        state.outbox.offer(lambda: popup_message(state, text, title, is_warning, is_error, is_blocking))

    has_popup = _reads(lambda world: world._state.popup is not None)

    def protective_stop(self) -> None:
        self._state.stop_protectively("protective_stop() was called by the program", by_program=True)

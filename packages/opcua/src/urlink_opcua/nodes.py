"""Nodes of one robot: its state, its registers, and its methods.

Each node has a fixed id, such as ``ns=2;s=arm.JointPositions``. A client can store it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from datetime import datetime, timezone
from operator import attrgetter
from typing import Any, NamedTuple

from asyncua import Server as AsyncuaServer
from asyncua import ua

from urlink import LinkError, Robot
from urlink.rtde import OutputStream

from .commands import PROGRAMS, Outcome

__all__ = ["INPUTS", "RobotNodes"]

_STATE: dict[str, tuple[ua.VariantType, Callable[[Any], Any]]] = {
    "RobotMode": (ua.VariantType.Int32, lambda state: _number(state.robot_mode)),
    "RobotModeName": (ua.VariantType.String, lambda state: _name(state.robot_mode)),
    "SafetyMode": (ua.VariantType.Int32, lambda state: _number(state.safety_mode)),
    "SafetyModeName": (ua.VariantType.String, lambda state: _name(state.safety_mode)),
    "ProgramState": (ua.VariantType.Int32, lambda state: _number(state.program_state)),
    "ProgramStateName": (ua.VariantType.String, lambda state: _name(state.program_state)),
    "JointPositions": (ua.VariantType.Double, lambda state: _list(state.q_actual)),
    "JointSpeeds": (ua.VariantType.Double, lambda state: _list(state.qd_actual)),
    "JointCurrents": (ua.VariantType.Double, lambda state: _list(state.I_actual)),
    "JointTemperatures": (ua.VariantType.Double, lambda state: _list(state.motor_temperatures)),
    "ToolPose": (ua.VariantType.Double, lambda state: _list(state.tool_vector_actual)),
    "ToolForce": (ua.VariantType.Double, lambda state: _list(state.tcp_force)),
    "SpeedScaling": (ua.VariantType.Double, lambda state: state.speed_scaling),
    "DigitalInputs": (ua.VariantType.UInt64, lambda state: _whole(state.digital_input_bits)),
    "DigitalOutputs": (ua.VariantType.UInt64, lambda state: _whole(state.digital_output_bits)),
}
_ARRAYS = {"JointPositions", "JointSpeeds", "JointCurrents", "JointTemperatures", "ToolPose", "ToolForce"}


class _Kind(NamedTuple):
    """Kind of register: type of its nodes, numbers, and names in RTDE and of the method that writes it."""

    variant: ua.VariantType
    numbers: range
    rtde: str
    write: str


_REGISTERS = {
    "Bit": _Kind(ua.VariantType.Boolean, range(64, 128), "bit", "write_bit"),
    "Integer": _Kind(ua.VariantType.Int32, range(24, 48), "int", "write_integer"),
    "Float": _Kind(ua.VariantType.Double, range(24, 48), "double", "write_float"),
}
#: Name of an input register -> type of its values, name of the method that writes it, and its number.
INPUTS = {
    f"Input{name}{number}": (kind.variant, kind.write, number)
    for name, kind in _REGISTERS.items()
    for number in kind.numbers
}
_EMPTY: dict[ua.VariantType, Any] = {
    ua.VariantType.Boolean: False,
    ua.VariantType.Int32: 0,
    ua.VariantType.UInt64: 0,
    ua.VariantType.Double: 0.0,
    ua.VariantType.String: "",
}


class RobotNodes:
    """Nodes of one robot in the address space of a server.

    Args:
        server: Server of asyncua.
        index: Index of the namespace.
        name: Name of the robot.
        robot: Robot to read.

    Attributes:
        robot: Robot to read.
        id: Id of the object of the robot.
        methods: Id of each method -> its name.
        inputs: Id of each input register -> its name.
    """

    def __init__(self, server: AsyncuaServer, index: int, name: str, robot: Robot) -> None:
        self.robot = robot
        self.id = ua.NodeId(name, index)
        self.methods: dict[ua.NodeId, str] = {}
        self.inputs: dict[ua.NodeId, str] = {}
        self._server = server
        self._index = index
        self._name = name
        self._streams: dict[str, OutputStream[Any]] = {}
        self._written: dict[ua.NodeId, ua.DataValue] = {}
        self._count = 0

    def connect_registers(self, timeout: float) -> dict[str, LinkError]:
        """Connect to the output registers; return the kinds that this controller does not serve.

        Args:
            timeout: Maximum time for each kind, in s.
        """
        failed: dict[str, LinkError] = {}
        for name, kind in _REGISTERS.items():
            try:
                names = [f"output_{kind.rtde}_register_{number}" for number in kind.numbers]
                stream = self.robot.rtde.outputs(*names, frequency=10.0)
                stream.wait(timeout)
                self._streams[name] = stream
            except LinkError as error:
                failed[name] = error
        return failed

    async def add(self, *, inputs: bool) -> None:
        """Add the nodes to the server.

        Args:
            inputs: Whether to add input registers, too.
        """
        objects = self._server.get_objects_node()
        parent = await objects.add_object(self.id, ua.QualifiedName(self._name, self._index))
        identity = self.robot.identity
        fixed = {"Model": identity.model or "", "Firmware": str(identity.firmware), "Address": str(self.robot.address)}
        for name, text in fixed.items():
            await self._add(parent, name, ua.VariantType.String, text)
        await self._add(parent, "Connected", ua.VariantType.Boolean, False)
        await self._add(parent, "PlayRefusal", ua.VariantType.String, "")
        for name, (variant, _) in _STATE.items():
            await self._add(parent, name, variant, [0.0] * 6 if name in _ARRAYS else _EMPTY[variant])
        last = await self._folder(parent, "LastCommand")
        for name in ("Name", "Client", "Error"):
            await self._add(last, f"LastCommand.{name}", ua.VariantType.String, "")
        await self._add(last, "LastCommand.Status", ua.VariantType.UInt32, 0)
        await self._add(last, "LastCommand.Count", ua.VariantType.UInt32, 0)
        registers = await self._folder(parent, "Registers")
        for name in self._streams:
            kind = _REGISTERS[name]
            for number in kind.numbers:
                await self._add(registers, f"Output{name}{number}", kind.variant, _EMPTY[kind.variant])
        for name, (variant, _, _) in INPUTS.items() if inputs else ():
            node = await self._add(registers, name, variant, _EMPTY[variant])
            await node.set_writable()
            self.inputs[node.nodeid] = name
        path = ua.Argument(Name="Path", DataType=ua.NodeId(ua.ObjectIds.String), ValueRank=-1)
        for name in ("LoadProgram", *PROGRAMS):
            method = await parent.add_method(
                self._node(name),
                ua.QualifiedName(name, self._index),
                _unreachable,
                [path] if name == "LoadProgram" else [],
                [],
            )
            self.methods[method.nodeid] = name

    async def _folder(self, parent: Any, name: str) -> Any:
        return await parent.add_object(self._node(name), ua.QualifiedName(name, self._index))

    async def _add(self, parent: Any, name: str, variant: ua.VariantType, value: Any) -> Any:
        shown = ua.QualifiedName(name.rpartition(".")[2], self._index)
        return await parent.add_variable(self._node(name), shown, value, variant)

    def _node(self, name: str) -> ua.NodeId:
        return ua.NodeId(f"{self._name}.{name}", self._index)

    def values(self) -> list[tuple[ua.NodeId, ua.DataValue]]:
        """Read the robot, and return the values of all changing nodes. It can wait for a lock of the robot."""
        robot = self.robot
        state = robot.realtime.latest
        if state is not None and state.received is not None:
            read, when = state, datetime.fromtimestamp(state.received.wall, timezone.utc)
        else:
            read, when = None, None
        found = [("Connected", _value(ua.VariantType.Boolean, read is not None))]
        found += [(name, _of(read, variant, get, when)) for name, (variant, get) in _STATE.items()]
        try:
            refusal = robot.safety.refusal
        except LinkError as error:
            refusal = error
        found.append(("PlayRefusal", _value(ua.VariantType.String, "" if refusal is None else str(refusal))))
        found += self._outputs()
        return [(self._node(name), value) for name, value in found]

    def _outputs(self) -> Iterator[tuple[str, ua.DataValue]]:
        for name, stream in self._streams.items():
            kind, state = _REGISTERS[name], stream.latest
            received = None if state is None else state.received
            when = None if received is None else datetime.fromtimestamp(received.wall, timezone.utc)
            for number in kind.numbers:
                get = attrgetter(f"output_{kind.rtde}_register_{number}")
                yield f"Output{name}{number}", _of(state, kind.variant, get, when)

    async def show(self, values: list[tuple[ua.NodeId, ua.DataValue]]) -> None:
        """Write the values that have changed to the nodes."""
        for node, value in values:
            if self._written.get(node) != value:
                await self._server.write_attribute_value(node, value)
                self._written[node] = value

    async def report(self, outcome: Outcome) -> None:
        """Show the outcome of a command."""
        self._count += 1
        text, number = ua.VariantType.String, ua.VariantType.UInt32
        # The count is written last, so that a client which sees a new count reads the values that belong to it.
        for name, value in (
            ("Name", _value(text, outcome.name)),
            ("Client", _value(text, outcome.client)),
            ("Error", _value(text, outcome.message)),
            ("Status", _value(number, outcome.status)),
            ("Count", _value(number, self._count)),
        ):
            await self._server.write_attribute_value(self._node(f"LastCommand.{name}"), value)


def _unreachable(parent: ua.NodeId, *arguments: Any) -> ua.StatusCode:
    """Refuse a method that did not pass through a session, which executes the methods."""
    return ua.StatusCode(ua.StatusCodes.BadUserAccessDenied)


def _value(variant: ua.VariantType, value: Any) -> ua.DataValue:
    return ua.DataValue(ua.Variant(value, variant))


def _of(state: Any, variant: ua.VariantType, get: Callable[[Any], Any], when: datetime | None) -> ua.DataValue:
    """Return the value of a node, or a bad status if the robot is lost or does not send the value."""
    if state is None:
        return ua.DataValue(ua.Variant(None), StatusCode=ua.StatusCode(ua.StatusCodes.BadNoCommunication))
    value = get(state)
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return ua.DataValue(ua.Variant(None), StatusCode=ua.StatusCode(ua.StatusCodes.BadNotSupported))
    return ua.DataValue(ua.Variant(value, variant), SourceTimestamp=when)


def _number(mode: Any) -> int | None:
    return None if mode is None else int(mode)


def _name(mode: Any) -> str | None:
    return None if mode is None else str(mode.name)


def _whole(bits: Any) -> int | None:
    return None if bits is None else int(bits)


def _list(values: Any) -> list[float] | None:
    return None if values is None else [float(each) for each in values]

"""Parts of an `AsyncRobot`. Each method is the awaitable version of the blocking method with the same name.

The module is imported when the first part is used, so a program that only reads states never imports command modules.
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Iterator
from typing import TYPE_CHECKING, Any, Literal, TypeVar, overload

from linkcore.aio.async_stream import AsyncFeed, AsyncStream

from ..command.interpreter import Interpreter, InterpreterState
from ..command.io import IO
from ..command.safety import Safety
from ..command.scripts import Scripts
from ..motion import Motions, Points, PointStream, Teaching, Wrench, WrenchStream
from ..motion.points.point import Point
from ..protocol.dashboard.client import Dashboard
from ..protocol.gripper.client import Gripper
from ..protocol.gripper.onrobot import RGGripper, RGModel
from ..protocol.gripper.vacuum import VacuumGripper
from ..protocol.ports import PORTS
from ..protocol.realtime.packets import RealtimeState
from ..protocol.rtde.recipes import Outputs
from ..protocol.tool_serial import ToolSerial
from ..rtde import Inputs, OutputStream, Registers, Rtde
from ..session.connect_options import Policy
from .awaited import AwaitedHandle, AwaitedPart, Block, attribute, awaited, block, motion, stopping

if TYPE_CHECKING:
    from ..rtde.client import Missing
    from ..rtde.names import AnyOutputs, OutputName

__all__ = [
    "AsyncDashboard",
    "AsyncFeed",
    "AsyncGripper",
    "AsyncIO",
    "AsyncInputs",
    "AsyncInterpreter",
    "AsyncMotions",
    "AsyncOutputStream",
    "AsyncPointStream",
    "AsyncPoints",
    "AsyncRGGripper",
    "AsyncRegisters",
    "AsyncRtde",
    "AsyncSafety",
    "AsyncScripts",
    "AsyncStream",
    "AsyncTeaching",
    "AsyncToolSerial",
    "AsyncVacuumGripper",
    "AsyncWrenchStream",
]

T = TypeVar("T", bound=Outputs)


class AsyncPointStream(AwaitedHandle[PointStream]):
    """Awaitable version of `PointStream`; ``await stream`` waits for the end of the stream, as for any handle.

    If a task is cancelled while it awaits `append`, the points that are not sent yet are dropped.
    """

    __slots__ = ()

    append = awaited(PointStream.append)
    clear = stopping(PointStream.clear)
    replace = awaited(PointStream.replace)
    wait = awaited(PointStream.wait)
    wait_until_dry = awaited(PointStream.wait_until_dry)

    buffer = attribute(PointStream, lambda part: part.buffer)
    time = attribute(PointStream, lambda part: part.time)
    end = attribute(PointStream, lambda part: part.end)
    buffered = attribute(PointStream, lambda part: part.buffered)
    room = attribute(PointStream, lambda part: part.room)
    is_dry = attribute(PointStream, lambda part: part.is_dry)
    starved = attribute(PointStream, lambda part: part.starved)
    progress = attribute(PointStream, lambda part: part.progress)


class AsyncMotions(AwaitedPart[Motions]):
    """Awaitable version of `Motions`.

    Calls that start a motion require the argument `wait`. The call `stop` does not require it, and is never delayed.
    """

    __slots__ = ()

    move_joints = motion(Motions.move_joints)
    move_linear = motion(Motions.move_linear)
    move_circular = motion(Motions.move_circular)
    path = motion(Motions.path)
    speed_joints = motion(Motions.speed_joints)
    speed_linear = motion(Motions.speed_linear)
    follow = motion(Motions.follow)
    until_contact = motion(Motions.until_contact)
    stop = stopping(Motions.stop)
    servo = block(Motions.servo)
    stream = block(Motions.stream, AsyncPointStream)
    jog = block(Motions.jog)
    force_mode = block(Motions.force_mode)
    torque = block(Motions.torque)
    impedance = block(Motions.impedance)

    current = attribute(Motions, lambda part: part.current)


class AsyncPoints(AwaitedPart[Points]):
    """Awaitable version of `Points`. Lookups such as ``robot.points["bin"]`` read the small file immediately."""

    __slots__ = ()

    add = awaited(Points.add)
    check = awaited(Points.check)
    check_all = awaited(Points.check_all)
    get = awaited(Points.get)
    import_program = awaited(Points.import_program)
    items = awaited(Points.items)
    keys = awaited(Points.keys)
    remove = awaited(Points.remove)
    teach = awaited(Points.teach)
    values = awaited(Points.values)

    def __getitem__(self, name: str) -> Point:
        return self._part[name]

    def __contains__(self, name: object) -> bool:
        return name in self._part

    def __iter__(self) -> Iterator[str]:
        return iter(self._part)

    def __len__(self) -> int:
        return len(self._part)


class AsyncSafety(AwaitedPart[Safety]):
    """Awaitable version of `Safety`."""

    __slots__ = ()

    enable = awaited(Safety.enable)
    explain = awaited(Safety.explain)
    on_stop = awaited(Safety.on_stop)
    wait_enabled = awaited(Safety.wait_enabled)
    wait_for_stop = awaited(Safety.wait_for_stop)
    wait_until_clear = awaited(Safety.wait_until_clear)

    cause = attribute(Safety, lambda part: part.cause)
    is_enabled = attribute(Safety, lambda part: part.is_enabled)
    mode = attribute(Safety, lambda part: part.mode)

    @property
    def policy(self) -> Policy:
        return self._part.policy

    @policy.setter
    def policy(self, policy: Policy) -> None:
        self._part.policy = policy

    refusal = attribute(Safety, lambda part: part.refusal)
    robot_mode = attribute(Safety, lambda part: part.robot_mode)


class AsyncScripts(AwaitedPart[Scripts]):
    """Awaitable version of `Scripts`. `run` requires the argument `wait`."""

    __slots__ = ()

    run = motion(Scripts.run)
    send_line = awaited(Scripts.send_line)


class AsyncIO(AwaitedPart[IO]):
    """Awaitable version of `IO`."""

    __slots__ = ()

    analog_in = awaited(IO.analog_in)
    analog_out = awaited(IO.analog_out)
    configurable_digital_in = awaited(IO.configurable_digital_in)
    configurable_digital_out = awaited(IO.configurable_digital_out)
    digital_in = awaited(IO.digital_in)
    digital_out = awaited(IO.digital_out)
    set_analog_out = awaited(IO.set_analog_out)
    set_configurable_digital_out = awaited(IO.set_configurable_digital_out)
    set_digital_out = awaited(IO.set_digital_out)
    set_flag = awaited(IO.set_flag)
    set_tool_digital_out = awaited(IO.set_tool_digital_out)
    set_tool_communication = awaited(IO.set_tool_communication)
    set_tool_voltage = awaited(IO.set_tool_voltage)
    tool_analog_in = awaited(IO.tool_analog_in)
    tool_digital_in = awaited(IO.tool_digital_in)
    tool_digital_out = awaited(IO.tool_digital_out)
    wait_configurable_digital_in = awaited(IO.wait_configurable_digital_in)
    wait_digital_in = awaited(IO.wait_digital_in)
    wait_tool_digital_in = awaited(IO.wait_tool_digital_in)

    tool_voltage = attribute(IO, lambda part: part.tool_voltage)


class AsyncDashboard(AwaitedPart[Dashboard]):
    """Awaitable version of `Dashboard`."""

    __slots__ = ()

    add_to_log = awaited(Dashboard.add_to_log)
    brake_release = awaited(Dashboard.brake_release)
    clear_operational_mode = awaited(Dashboard.clear_operational_mode)
    close = stopping(Dashboard.close)
    close_popup = awaited(Dashboard.close_popup)
    close_safety_popup = awaited(Dashboard.close_safety_popup)
    download_program = awaited(Dashboard.download_program)
    generate_flight_report = awaited(Dashboard.generate_flight_report)
    generate_support_file = awaited(Dashboard.generate_support_file)
    is_in_remote_control = awaited(Dashboard.is_in_remote_control)
    is_program_saved = awaited(Dashboard.is_program_saved)
    load = awaited(Dashboard.load)
    load_installation = awaited(Dashboard.load_installation)
    loaded_program = awaited(Dashboard.loaded_program)
    operational_mode = awaited(Dashboard.operational_mode)
    pause = stopping(Dashboard.pause)
    play = awaited(Dashboard.play)
    polyscope_version = awaited(Dashboard.polyscope_version)
    popup = awaited(Dashboard.popup)
    power_off = stopping(Dashboard.power_off)
    power_on = awaited(Dashboard.power_on)
    program_state = awaited(Dashboard.program_state)
    programs = awaited(Dashboard.programs)
    quit = stopping(Dashboard.quit)
    restart_safety = awaited(Dashboard.restart_safety)
    robot_mode = awaited(Dashboard.robot_mode)
    robot_model = awaited(Dashboard.robot_model)
    running = awaited(Dashboard.running)
    safety_mode = awaited(Dashboard.safety_mode)
    safety_status = awaited(Dashboard.safety_status)
    save_log = awaited(Dashboard.save_log)
    send = awaited(Dashboard.send)
    serial_number = awaited(Dashboard.serial_number)
    set_operational_mode = awaited(Dashboard.set_operational_mode)
    set_user_role = awaited(Dashboard.set_user_role)
    shutdown = stopping(Dashboard.shutdown)
    start = awaited(Dashboard.start)
    stop = stopping(Dashboard.stop)
    unlock_protective_stop = awaited(Dashboard.unlock_protective_stop)
    upload_program = awaited(Dashboard.upload_program)
    user_role = awaited(Dashboard.user_role)
    version = awaited(Dashboard.version)


class AsyncGripper(AwaitedPart[Gripper]):
    """Awaitable version of `Gripper`."""

    __slots__ = ()

    @overload
    def __call__(self, kind: Literal["vacuum"]) -> AsyncVacuumGripper: ...
    @overload
    def __call__(
        self, kind: RGModel, *, host: str | None = None, port: int = PORTS["onrobot"], unit: int = 65
    ) -> AsyncRGGripper: ...
    def __call__(
        self, kind: Any, *, host: str | None = None, port: int = PORTS["onrobot"], unit: int = 65
    ) -> AsyncRGGripper | AsyncVacuumGripper:
        """Return a gripper of another kind immediately; see `Gripper.__call__`. Its methods are awaitable."""
        part: RGGripper | VacuumGripper = self._part(kind, host=host, port=port, unit=unit)
        if isinstance(part, VacuumGripper):
            return AsyncVacuumGripper(part, self._workers)
        return AsyncRGGripper(part, self._workers)

    activate = awaited(Gripper.activate)
    close = awaited(Gripper.close)
    deactivate = awaited(Gripper.deactivate)
    get = awaited(Gripper.get)
    move = awaited(Gripper.move)
    object_detected = awaited(Gripper.object_detected)
    open = awaited(Gripper.open)
    position = awaited(Gripper.position)
    position_of = staticmethod(Gripper.position_of)
    set = awaited(Gripper.set)
    status = awaited(Gripper.status)
    stop = stopping(Gripper.stop)
    wait = awaited(Gripper.wait)


class AsyncRGGripper(AwaitedPart[RGGripper]):
    """Awaitable version of `RGGripper`."""

    __slots__ = ()

    close = awaited(RGGripper.close)
    move = awaited(RGGripper.move)
    object_detected = awaited(RGGripper.object_detected)
    open = awaited(RGGripper.open)
    status = awaited(RGGripper.status)
    stop = stopping(RGGripper.stop)
    wait = awaited(RGGripper.wait)
    width = awaited(RGGripper.width)


class AsyncVacuumGripper(AwaitedPart[VacuumGripper]):
    """Awaitable version of `VacuumGripper`."""

    __slots__ = ()

    activate = awaited(VacuumGripper.activate)
    deactivate = awaited(VacuumGripper.deactivate)
    get = awaited(VacuumGripper.get)
    grip = awaited(VacuumGripper.grip)
    object_detected = awaited(VacuumGripper.object_detected)
    release = awaited(VacuumGripper.release)
    set = awaited(VacuumGripper.set)
    status = awaited(VacuumGripper.status)
    stop = stopping(VacuumGripper.stop)
    vacuum = awaited(VacuumGripper.vacuum)
    wait = awaited(VacuumGripper.wait)


class AsyncToolSerial(AwaitedPart[ToolSerial]):
    """Awaitable version of `ToolSerial`."""

    __slots__ = ()

    ask = awaited(ToolSerial.ask)
    close = stopping(ToolSerial.close)
    discard = awaited(ToolSerial.discard)
    read = awaited(ToolSerial.read)
    write = awaited(ToolSerial.write)


class AsyncInterpreter(AwaitedHandle[Interpreter]):
    """Awaitable version of `Interpreter`; ``await interpreter`` waits for the end of the interpreter program."""

    __slots__ = ()

    abort = stopping(Interpreter.abort)
    clear = awaited(Interpreter.clear)
    end = awaited(Interpreter.end)
    execute = awaited(Interpreter.execute)
    skip = stopping(Interpreter.skip)
    wait = awaited(Interpreter.wait)
    wait_executed = awaited(Interpreter.wait_executed)

    async def state(self) -> InterpreterState:
        """Return `Interpreter.state`. The call waits for the controller, so it is not a property here."""
        return await self._workers.make(lambda: self._part.state)

    texts = attribute(Interpreter, lambda part: part.texts)


class AsyncTeaching(AwaitedPart[Teaching]):
    """Awaitable version of `Teaching`."""

    __slots__ = ()

    record = awaited(Teaching.record)

    taught = attribute(Teaching, lambda part: part.taught)
    freedrive = attribute(Teaching, lambda part: part.freedrive)


class AsyncWrenchStream(AwaitedPart[WrenchStream]):
    """Awaitable version of `WrenchStream`; iterate with ``async for``."""

    __slots__ = ()

    wait = awaited(WrenchStream.wait)
    wait_until = awaited(WrenchStream.wait_until)
    zero = awaited(WrenchStream.zero)

    payload = attribute(WrenchStream, lambda part: part.payload)
    frame = attribute(WrenchStream, lambda part: part.frame)
    latest = attribute(WrenchStream, lambda part: part.latest)

    def compensate(self, state: RealtimeState) -> Wrench:
        """Return the wrench of a state, like `WrenchStream.compensate`."""
        return self._part.compensate(state)

    async def __aiter__(self) -> AsyncIterator[Wrench]:
        async for state in AsyncStream(self._part._realtime):
            yield self._part.compensate(state)


class AsyncRegisters(AwaitedPart[Registers]):
    """Awaitable version of `Registers`."""

    __slots__ = ()

    read_bit = awaited(Registers.read_bit)
    read_float = awaited(Registers.read_float)
    read_integer = awaited(Registers.read_integer)
    write_bit = awaited(Registers.write_bit)
    write_float = awaited(Registers.write_float)
    write_integer = awaited(Registers.write_integer)


class AsyncInputs(AwaitedPart[Inputs]):
    """Awaitable version of `Inputs`."""

    __slots__ = ()

    close = stopping(Inputs.close)
    send = awaited(Inputs.send)

    names = attribute(Inputs, lambda part: part.names)
    connection = attribute(Inputs, lambda part: part.connection)
    is_over = attribute(Inputs, lambda part: part.is_over)


class AsyncOutputStream(AsyncStream[T]):
    """Version of `OutputStream` for programs that use asyncio."""

    __slots__ = ("_part",)

    def __init__(self, outputs: OutputStream[T]) -> None:
        super().__init__(outputs)
        self._part = outputs

    async def description(self) -> dict[str, Any]:
        """Return `OutputStream.description`. Connect first if the stream is not connected."""
        await self.start()
        return await super().description()

    names = attribute(OutputStream, lambda part: part.names)
    frequency = attribute(OutputStream, lambda part: part.frequency)
    recipe = attribute(OutputStream, lambda part: part.recipe)
    left_out = attribute(OutputStream, lambda part: part.left_out)
    controller = attribute(OutputStream, lambda part: part.controller)
    is_over = attribute(OutputStream, lambda part: part.is_over)


class AsyncRtde(AwaitedPart[Rtde]):
    """Awaitable version of `Rtde`."""

    __slots__ = ()

    close = stopping(Rtde.close)
    inputs = block(Rtde.inputs, AsyncInputs)
    missing = awaited(Rtde.missing)
    who_holds = awaited(Rtde.who_holds)

    @overload
    def outputs(
        self, kind: type[T], /, *, frequency: float | None = None, missing: Missing = "error"
    ) -> Block[AsyncOutputStream[T]]: ...
    @overload
    def outputs(
        self, *names: OutputName | str, frequency: float | None = None, missing: Missing = "error"
    ) -> Block[AsyncOutputStream[AnyOutputs]]: ...
    def outputs(
        self, *names: Any, frequency: float | None = None, missing: Missing = "error"
    ) -> Block[AsyncOutputStream[Any]]:
        """Return a stream like `Rtde.outputs`: ``async with robot.rtde.outputs("actual_q") as stream``.

        The result can be awaited instead.
        """
        rtde = self._part

        def made() -> OutputStream[Any]:
            return rtde.outputs(*names, frequency=frequency, missing=missing)

        return Block(self._workers, made, lambda stream, workers: AsyncOutputStream(stream))

    async def registers(self, *, lower: bool = False) -> AsyncRegisters:
        """Return the general-purpose registers, like `Rtde.registers`."""
        return AsyncRegisters(self._part.registers(lower=lower), self._workers)

    is_recorded = attribute(Rtde, lambda part: part.is_recorded)

"""`connect_async` and `AsyncRobot`: connection to a robot, for programs that use asyncio."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

from linkcore.aio.async_stream import AsyncStream
from linkcore.aio.loop_connection import LoopConnection
from linkcore.errors import ConnectFailed, ConnectionLost, LinkTimeout, LocalError, unraised
from linkcore.event_loop import Opening, Workers, finished, running_loop
from linkcore.net.awaited import AwaitedTcp

from .. import robot as threaded
from ..protocol.firmware import Firmware
from ..protocol.ports import refusal_hint
from ..protocol.primary.robot_state import RobotState
from ..protocol.realtime.packets import RealtimeState
from ..session.address import RecordingAddress, RobotAddress, SimulatorAddress
from ..session.connect_options import ConnectOptions, takes_connect_options
from ..session.identity import Identity, Introduction
from ..session.robot_clock import RobotClock
from ..session.source import networked
from .awaited import AwaitedPart, AwaitedRtde, Block, awaited, block

if TYPE_CHECKING:
    from typing_extensions import Self

    from linkcore.recording.recorder import Recorder

    from ..arm.kinematics import Arm
    from ..arm.payload import MeasuredPayload
    from ..arm.vectors import Numbers
    from ..command.interpreter import Interpreter
    from ..motion.teaching import Teaching
    from ..session.session_limits import SessionLimits
    from ..simulator import Controller
    from .parts import (
        AsyncDashboard,
        AsyncGripper,
        AsyncInterpreter,
        AsyncIO,
        AsyncMotions,
        AsyncPoints,
        AsyncRegisters,
        AsyncRtde,
        AsyncSafety,
        AsyncScripts,
        AsyncTeaching,
        AsyncToolSerial,
        AsyncWrenchStream,
    )

P = ParamSpec("P")
T = TypeVar("T")

#: Maximum number of concurrent calls for one robot.
_CALLS = 16
#: Number of threads that stop the robot. These threads are started together with the connection. Two threads are
#: needed, because leaving a block can occupy one of them until the arm is at rest.
_STOPS = 2


def _teaching(teaching: Teaching, workers: Workers) -> AsyncTeaching:
    from .parts import AsyncTeaching

    return AsyncTeaching(teaching, workers)


def _interpreter(interpreter: Interpreter, workers: Workers) -> AsyncInterpreter:
    from .parts import AsyncInterpreter

    return AsyncInterpreter(interpreter, workers)


class AsyncRobot(AwaitedPart[threaded.Robot]):
    """Connection to one robot, for programs that use asyncio. Made by `connect_async`.

    The class has the same members as `Robot`, with the same behaviour. Await calls that might wait for the robot, enter
    blocks with ``async with``, and read properties directly. The event loop reads the streams. Calls that wait run in
    threads that belong to the robot. A thread is started when it is needed. The robot is an asynchronous context
    manager: leaving its ``async with`` block closes the robot.

    If a task is cancelled or times out while it awaits a call, the call is abandoned: pending data is not sent, and a
    motion or program that the call started is cancelled, so a moving arm brakes. `asyncio.shield` prevents this.

    Attributes:
        address: Address that was passed to `connect_async`.
    """

    __slots__ = ("_ending", "_streams", "address")

    def __init__(self, robot: threaded.Robot, workers: Workers) -> None:
        super().__init__(robot, workers)
        self.address = robot.address
        self._streams: dict[str, AsyncStream[Any]] = {}
        self._ending: asyncio.Task[None] | None = None

    # -- streams and identity ----------------------------------------------------------------------

    @property
    def realtime(self) -> AsyncStream[RealtimeState]:
        """Stream of `RealtimeState`, 125 or 500 Hz (port 30003)."""
        return self._stream("realtime")

    @property
    def primary(self) -> AsyncStream[RobotState]:
        """Stream of `RobotState` at 10 Hz (port 30001). Select its parts and messages by class with `of`."""
        return self._stream("primary")

    @property
    def secondary(self) -> AsyncStream[RobotState]:
        """Stream of `RobotState` like `primary`, but with the version message as its only message (port 30002)."""
        return self._stream("secondary")

    def _stream(self, name: str) -> AsyncStream[Any]:
        known = self._streams.get(name)
        if known is None:
            known = self._streams[name] = AsyncStream(getattr(self._part, name))
        return known

    @property
    def clock(self) -> RobotClock:
        """Relation of the controller's clock to this computer's clock; see `Robot.clock`.

        This property cannot wait for a state, so use it after the first state has arrived.
        """
        return self._part.clock

    @property
    def identity(self) -> Identity:
        """Last known identity of the controller. Call `identify` to update it after a reconnection."""
        return self._part._who.last

    async def identify(self) -> Identity:
        """Return the identity of the controller, and read it again after a reconnection.

        Raises:
            RemoteError: If the controller does not answer.
        """
        return await self.call(lambda: self._part.identity)

    @property
    def firmware(self) -> Firmware:
        """Firmware of the controller; see `identity`."""
        return self.identity.firmware

    @property
    def model(self) -> str | None:
        """Name of the arm, such as "UR5e"; None if the controller does not report it. See `identity`."""
        return self.identity.model

    @property
    def limits(self) -> SessionLimits | None:
        """Limits of this session; see `Robot.limits`."""
        return self._part.limits

    @property
    def kinematics(self) -> Arm:
        """Forward and inverse kinematics of this individual arm; see `Robot.kinematics` and `identity`."""
        return self.identity.kinematics

    @property
    def controller(self) -> Controller:
        """Simulator behind a ``sim://`` address; see `Robot.controller`."""
        return self._part.controller

    def record(
        self, path: str | os.PathLike[str], interfaces: Sequence[str | AsyncStream[Any]] = ("realtime", "primary")
    ) -> Block[Recorder]:
        """Record streams into a new file: ``async with robot.record("run.urlog"):``.

        A dedicated thread writes the file. See `Robot.record`.
        """
        streams: Any = [each.stream if isinstance(each, AsyncStream) else each for each in interfaces]
        return Block(self._workers, lambda: self._part.record(path, streams), lambda recorder, workers: recorder)

    # -- commands ------------------------------------------------------------------------------------

    @property
    def motion(self) -> AsyncMotions:
        """Commands that move the arm; see `Robot.motion`. Calls that start a motion require the argument `wait`."""
        from .parts import AsyncMotions

        return AsyncMotions(self._part.motion, self._workers)

    @property
    def points(self) -> AsyncPoints:
        """Taught points by name; see `Robot.points`."""
        from .parts import AsyncPoints

        return AsyncPoints(self._part.points, self._workers)

    @property
    def io(self) -> AsyncIO:
        """Digital and analogue inputs and outputs; see `Robot.io`."""
        from .parts import AsyncIO

        return AsyncIO(self._part.io, self._workers)

    @property
    def safety(self) -> AsyncSafety:
        """Interlock between motions and the arm; see `Robot.safety`."""
        from .parts import AsyncSafety

        return AsyncSafety(self._part.safety, self._workers)

    @property
    def script(self) -> AsyncScripts:
        """Commands that send URScript programs and lines; see `Robot.script`."""
        from .parts import AsyncScripts

        return AsyncScripts(self._part.script, self._workers)

    @property
    def dashboard(self) -> AsyncDashboard:
        """Dashboard commands (power, brakes, installed programs, protective stops); see `Robot.dashboard`."""
        from .parts import AsyncDashboard

        return AsyncDashboard(self._part.dashboard, self._workers)

    @property
    def gripper(self) -> AsyncGripper:
        """Robotiq gripper; see `Robot.gripper`. Gripper commands are not interlocked."""
        from .parts import AsyncGripper

        return AsyncGripper(self._part.gripper, self._workers)

    @property
    def tool_serial(self) -> AsyncToolSerial:
        """RS485 line in the tool connector; see `Robot.tool_serial`. Its commands are not interlocked."""
        from .parts import AsyncToolSerial

        return AsyncToolSerial(self._part.tool_serial, self._workers)

    @property
    def rtde(self) -> AsyncRtde:
        """Access to RTDE; `outputs` returns an `AsyncStream`. See `Robot.rtde`."""
        from .parts import AsyncRtde

        return AsyncRtde(self._part.rtde, self._workers)

    @property
    def registers(self) -> AsyncRegisters:
        """General-purpose registers by number; see `Robot.registers`."""
        from .parts import AsyncRegisters

        return AsyncRegisters(self._part.registers, self._workers)

    set_payload = awaited(threaded.Robot.set_payload)
    measure_payload = awaited(threaded.Robot.measure_payload)
    measure_payload_by_hand = awaited(threaded.Robot.measure_payload_by_hand)
    set_gravity = awaited(threaded.Robot.set_gravity)
    set_tcp = awaited(threaded.Robot.set_tcp)
    set_speed_slider = awaited(threaded.Robot.set_speed_slider)
    zero_force_sensor = awaited(threaded.Robot.zero_force_sensor)
    popup = awaited(threaded.Robot.popup)
    freedrive = block(threaded.Robot.freedrive)
    teach = block(threaded.Robot.teach, _teaching)
    interpreter = block(threaded.Robot.interpreter, _interpreter)
    view = block(threaded.Robot.view)

    async def wrench(self, payload: MeasuredPayload, frame: Numbers | str = "tcp") -> AsyncWrenchStream:
        """Return a stream like `Robot.wrench`. Iterate over it with ``async for``."""
        from .parts import AsyncWrenchStream

        return AsyncWrenchStream(await self.call(self._part.wrench, payload, frame), self._workers)

    async def call(self, function: Callable[P, T], *arguments: P.args, **options: P.kwargs) -> T:
        """Call a blocking function in a thread of the robot.

        Raises:
            Closed: If the robot was closed.
            LocalError: If the operating system cannot start another thread.
        """
        return await self._workers.make(lambda: function(*arguments, **options), is_ordered=False)

    # -- closing -------------------------------------------------------------------------------------

    async def close(self, timeout: float = 2.0) -> None:
        """End motions, and close all streams and the simulator, within `timeout` seconds. Idempotent.

        If the calling task is cancelled during this call, the task ends only after closing has finished.
        """
        if self._ending is None:
            self._ending = asyncio.create_task(self._close(timeout))
        await finished(self._ending)

    async def _close(self, timeout: float) -> None:
        robot, workers = self._part, self._workers
        try:
            if workers.is_used or robot._controller is not None:
                await workers.make_stop(lambda: robot.close(timeout))
            else:
                await asyncio.gather(*(stream.close() for stream in self._streams.values()))
                robot.close(0.0)
        finally:
            workers.close()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *exc: object) -> None:
        await self.close()

    def __repr__(self) -> str:
        return f"<AsyncRobot{repr(self._part).removeprefix('<Robot')}"


async def _connected(options: ConnectOptions) -> AsyncRobot:
    place = options.place
    if options.isolate:
        raise LocalError("isolate=True is not supported by connect_async; use urlink.connect")
    if isinstance(place, RecordingAddress):
        raise LocalError(f"{options.name} is a recording, which connect_async cannot play; use urlink.connect")
    loop = running_loop("connect_async")
    workers = Workers(options.name, _CALLS, stopping=0 if options.read_only else _STOPS)
    controller = robot = None
    try:
        if isinstance(place, SimulatorAddress):
            simulated = partial(threaded.simulated, place)
            made: tuple[Controller, RobotAddress] = await workers.make(simulated, lambda made: made[0].close())
            controller, place = made
        known = await _identified(place, options)
        source = networked(place, options, tcp=AwaitedTcp, known=known)._replace(
            connection=partial(LoopConnection, loop=loop), rtde=AwaitedRtde
        )
        robot = threaded.assemble(options, place, source, controller, known)
        if threaded.owes(robot, place):
            await workers.make(partial(threaded.undo_abandoned, robot, options.timeout))
        return AsyncRobot(robot, workers)
    except BaseException:
        if robot is not None:
            workers.stop(robot.close)
        elif controller is not None:
            workers.stop(controller.close)
        workers.close()
        raise


@takes_connect_options
def connect_async(options: ConnectOptions) -> Opening[AsyncRobot]:
    """Connect to a robot or to the simulator. Enter the result with ``async with``, or await it.

    ``async with urlink.connect_async(...) as robot``, or ``robot = await urlink.connect_async(...)``.

    Args:
        address: Address of the robot, as for `urlink.connect`. Recordings are not supported.
        options: Other arguments of `urlink.connect`.

    Raises:
        BadAddress, BadValue, TypeError: If an argument is invalid, as for `urlink.connect`. Raised immediately.
        LocalError: If the address is a recording, or no asyncio event loop runs. Raised when the result is awaited or
            entered.
        ConnectFailed, ConnectionLost, LinkTimeout, WrongPeer: If no controller is at the address. Raised when the
            result is awaited or entered.
    """
    return Opening(partial(_connected, options))


async def _identified(place: RobotAddress, options: ConnectOptions) -> Identity:
    """Read the identity of the controller at an address, on the event loop. The blocking version is `networked`."""
    suffix = "_readonly" if options.read_only else ""
    try:
        return await _identify(place, "primary" + suffix, options.timeout)
    except ConnectFailed as error:
        first = unraised(error)
    try:
        return await _identify(place, "secondary" + suffix, options.timeout)
    except ConnectFailed:
        raise first from None
    finally:
        del first  # breaks the reference cycle between the error and this frame


async def _identify(place: RobotAddress, name: str, timeout: float) -> Identity:
    """Read the identity of the controller from one port, like `urlink.session.identity.identify`."""
    host, port = place.host, place.ports[name]
    introduction = Introduction(f"{host}:{port}", timeout, place.frequency)
    transport = AwaitedTcp(host, port, silence=timeout, refused=lambda: refusal_hint(None))
    await transport.connect(timeout)
    try:
        while not introduction.is_over:
            try:
                introduction.receive((await transport.receive_awaited(introduction.left))[0])
            except LinkTimeout:
                continue
            except ConnectionLost as error:
                introduction.lose(error)
    finally:
        transport.abort()  # no sent data can be lost, because nothing was sent
    return introduction.identity

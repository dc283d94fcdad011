"""`connect_async` and `AsyncRobot`: a robot for programs that use asyncio."""

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
    from ..command.interpreter import Interpreter
    from ..motion.teaching import Teaching
    from ..simulator import Controller
    from .parts import (
        AsyncDashboard,
        AsyncGripper,
        AsyncInterpreter,
        AsyncIO,
        AsyncMotions,
        AsyncRegisters,
        AsyncRtde,
        AsyncSafety,
        AsyncScripts,
        AsyncTeaching,
        AsyncToolSerial,
    )

P = ParamSpec("P")
T = TypeVar("T")

#: Calls of one robot that can run at the same time.
_CALLS = 16
#: Threads that stop the robot, which are started with it. Two: leaving a block may wait for the arm to come to rest.
_STOPS = 2


def _teaching(teaching: Teaching, workers: Workers) -> AsyncTeaching:
    from .parts import AsyncTeaching

    return AsyncTeaching(teaching, workers)


def _interpreter(interpreter: Interpreter, workers: Workers) -> AsyncInterpreter:
    from .parts import AsyncInterpreter

    return AsyncInterpreter(interpreter, workers)


class AsyncRobot(AwaitedPart[threaded.Robot]):
    """A robot: its streams, and what it is. Made by `connect_async`; an asynchronous context manager, which closes it.

    It has the names of `Robot`, and they do the same. What may wait for the robot is awaited, a block is entered with
    ``async with``, and properties are read as they are. The event loop reads the streams; calls that wait are made in
    threads of the robot, which are started when they are needed.

    A task that is cancelled, or times out, while it awaits a call gives it up: what has not been sent is not sent, and
    what it has begun is cancelled, so a moving arm brakes. `asyncio.shield` prevents this.

    Attributes:
        address: the address that was connected to.
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
        """Stream of `RobotState` at 10 Hz; with `of` or a class, of its parts and of messages (port 30001)."""
        return self._stream("primary")

    @property
    def secondary(self) -> AsyncStream[RobotState]:
        """As `primary`, but of the messages only the version message (port 30002)."""
        return self._stream("secondary")

    def _stream(self, name: str) -> AsyncStream[Any]:
        known = self._streams.get(name)
        if known is None:
            known = self._streams[name] = AsyncStream(getattr(self._part, name))
        return known

    @property
    def clock(self) -> RobotClock:
        """The controller's clock beside this computer's; see `Robot.clock`. It awaits nothing: it has to be asked after
        the first state.
        """
        return self._part.clock

    @property
    def identity(self) -> Identity:
        """The last known identity of the controller; `identify` reads it again."""
        return self._part._who.last

    async def identify(self) -> Identity:
        """The identity of the controller, read again after a reconnect.

        Raises:
            RemoteError: the controller did not answer.
        """
        return await self.call(lambda: self._part.identity)

    @property
    def firmware(self) -> Firmware:
        """The controller's firmware; see `identity`."""
        return self.identity.firmware

    @property
    def model(self) -> str | None:
        """Name of the arm, such as "UR5e"; None if the controller does not say. See `identity`."""
        return self.identity.model

    @property
    def kinematics(self) -> Arm:
        """Forward and inverse kinematics of this arm, calibrated; see `Robot.kinematics` and `identity`."""
        return self.identity.kinematics

    @property
    def controller(self) -> Controller:
        """The simulator behind ``sim://``; see `Robot.controller`."""
        return self._part.controller

    def record(
        self, path: str | os.PathLike[str], interfaces: Sequence[str | AsyncStream[Any]] = ("realtime", "primary")
    ) -> Block[Recorder]:
        """Record streams into a new file: ``async with robot.record("run.urlog"):``. A thread of its own writes it.

        See `Robot.record`.
        """
        streams: Any = [each.stream if isinstance(each, AsyncStream) else each for each in interfaces]
        return Block(self._workers, lambda: self._part.record(path, streams), lambda recorder, workers: recorder)

    # -- commands ------------------------------------------------------------------------------------

    @property
    def motion(self) -> AsyncMotions:
        """Moves the arm; see `Robot.motion`. What begins a motion has to be given `wait`."""
        from .parts import AsyncMotions

        return AsyncMotions(self._part.motion, self._workers)

    @property
    def io(self) -> AsyncIO:
        """Inputs and outputs; see `Robot.io`."""
        from .parts import AsyncIO

        return AsyncIO(self._part.io, self._workers)

    @property
    def safety(self) -> AsyncSafety:
        """The interlock between motions and the arm; see `Robot.safety`."""
        from .parts import AsyncSafety

        return AsyncSafety(self._part.safety, self._workers)

    @property
    def script(self) -> AsyncScripts:
        """Sends programs and lines of URScript; see `Robot.script`."""
        from .parts import AsyncScripts

        return AsyncScripts(self._part.script, self._workers)

    @property
    def dashboard(self) -> AsyncDashboard:
        """Power, brakes, installed programs, and unlocking after a protective stop; see `Robot.dashboard`."""
        from .parts import AsyncDashboard

        return AsyncDashboard(self._part.dashboard, self._workers)

    @property
    def gripper(self) -> AsyncGripper:
        """A Robotiq gripper; see `Robot.gripper`. Nothing of it is interlocked."""
        from .parts import AsyncGripper

        return AsyncGripper(self._part.gripper, self._workers)

    @property
    def tool_serial(self) -> AsyncToolSerial:
        """The RS485 line in the tool connector; see `Robot.tool_serial`. Nothing of it is interlocked."""
        from .parts import AsyncToolSerial

        return AsyncToolSerial(self._part.tool_serial, self._workers)

    @property
    def rtde(self) -> AsyncRtde:
        """Variables of the controller by name; `outputs` gives an `AsyncStream`. See `Robot.rtde`."""
        from .parts import AsyncRtde

        return AsyncRtde(self._part.rtde, self._workers)

    @property
    def registers(self) -> AsyncRegisters:
        """General-purpose registers by number; see `Robot.registers`."""
        from .parts import AsyncRegisters

        return AsyncRegisters(self._part.registers, self._workers)

    set_payload = awaited(threaded.Robot.set_payload)
    set_gravity = awaited(threaded.Robot.set_gravity)
    set_tcp = awaited(threaded.Robot.set_tcp)
    set_speed_slider = awaited(threaded.Robot.set_speed_slider)
    zero_force_sensor = awaited(threaded.Robot.zero_force_sensor)
    popup = awaited(threaded.Robot.popup)
    freedrive = block(threaded.Robot.freedrive)
    teach = block(threaded.Robot.teach, _teaching)
    interpreter = block(threaded.Robot.interpreter, _interpreter)
    view = block(threaded.Robot.view)

    async def call(self, function: Callable[P, T], *arguments: P.args, **options: P.kwargs) -> T:
        """Call a function that blocks, in a thread of the robot.

        Raises:
            Closed: the robot was closed.
            LocalError: the system has no thread left.
        """
        return await self._workers.make(lambda: function(*arguments, **options), is_ordered=False)

    # -- its end -------------------------------------------------------------------------------------

    async def close(self, timeout: float = 2.0) -> None:
        """End motions, close every stream, and the simulator if there is one; in `timeout` seconds. Idempotent.

        A task that is cancelled meanwhile ends when this is done.
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
        raise LocalError("isolate=True is for urlink.connect: the event loop reads by itself")
    if isinstance(place, RecordingAddress):
        raise LocalError(f"{options.name} is a recording, which urlink.connect plays, and no event loop")
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
    """Connect to a robot or to the simulator; the result is entered or awaited.

    ``async with urlink.connect_async(...) as robot``, or ``robot = await urlink.connect_async(...)``.

    Args:
        address: as for `urlink.connect`, but for recordings.
        options: the other arguments of `urlink.connect`.

    Raises:
        BadAddress, BadValue, TypeError: at once, as `urlink.connect`.
        LocalError: the address is a recording, or no event loop of asyncio runs; raised when it is awaited or entered.
        ConnectFailed, ConnectionLost, LinkTimeout, WrongPeer: there is no controller at the address; raised when it is
            awaited or entered.
    """
    return Opening(partial(_connected, options))


async def _identified(place: RobotAddress, options: ConnectOptions) -> Identity:
    """The identity of the controller at an address, read on the event loop; otherwise as `networked`."""
    suffix = "_readonly" if options.read_only else ""
    try:
        return await _identify(place.host, place.ports["primary" + suffix], options.timeout)
    except ConnectFailed as error:
        first = unraised(error)
    try:
        return await _identify(place.host, place.ports["secondary" + suffix], options.timeout)
    except ConnectFailed:
        raise first from None
    finally:
        del first  # it refers to this frame


async def _identify(host: str, port: int, timeout: float) -> Identity:
    """As `urlink.session.identity.identify`."""
    introduction = Introduction(f"{host}:{port}", timeout)
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
        transport.abort()  # nothing was sent
    return introduction.identity

"""`connect_async` and `AsyncRobot`: a robot for programs that use asyncio."""

from __future__ import annotations

import asyncio
import inspect
import os
from collections.abc import Callable, Generator, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, TypeVar

from linkcore.aio.async_stream import AsyncStream
from linkcore.aio.loop_connection import LoopConnection
from linkcore.aio.workers import Workers
from linkcore.errors import ConnectFailed, ConnectionLost, LinkTimeout, LocalError, unraised
from linkcore.event_loop import finished, running_loop
from linkcore.net.awaited import AwaitedTcp
from linkcore.recording.recorder import Recorder

from .. import robot as threaded
from ..address import RecordingAddress, RobotAddress, SimulatorAddress
from ..firmware import Firmware
from ..identity import Identity, Introduction
from ..interfaces.primary.robot_state import RobotState
from ..interfaces.realtime.packets import RealtimeState
from ..services import refusal_hint
from ..source import networked
from .awaited_rtde import AwaitedRtde
from .calls import Awaited, Call, given, taken

if TYPE_CHECKING:
    from typing_extensions import Self

    from ..kinematics import Arm
    from ..simulator import Controller

__all__ = ["AsyncRobot", "connect_async"]

T = TypeVar("T")

#: Calls of one robot that can run at the same time.
_CALLS = 16


class AsyncRobot:
    """A robot: its streams, and what it is. Made by `connect_async`; an asynchronous context manager, which closes it.

    The event loop reads the streams. `motion`, `io`, `safety`, `script`, `dashboard`, `rtde` and `registers` are those
    of `Robot`, with methods that are awaited; see `Call`. Their calls run in threads of the robot, which are started
    when they are needed.

    Attributes:
        address: the address that was connected to.
    """

    def __init__(self, robot: threaded.Robot, workers: Workers) -> None:
        self.address = robot.address
        self._robot = robot
        self._workers = workers
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
            known = self._streams[name] = AsyncStream(getattr(self._robot, name))
        return known

    @property
    def identity(self) -> Identity:
        """The last known identity of the controller; `identify` reads it again."""
        return self._robot._who.last

    async def identify(self) -> Identity:
        """The identity of the controller, read again after a reconnect.

        Raises:
            RemoteError: the controller did not answer.
        """
        return await self.call(lambda: self._robot.identity)

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
        return self._robot.controller

    def record(
        self, path: str | os.PathLike[str], interfaces: Sequence[str | AsyncStream[Any]] = ("realtime", "primary")
    ) -> Call[Recorder]:
        """Record streams into a new file: ``async with robot.record("run.urlog"):``. A thread of its own writes it.

        See `Robot.record`.
        """
        return self.call(self._robot.record, path, [taken(each) for each in interfaces])

    # -- commands ------------------------------------------------------------------------------------

    @property
    def motion(self) -> Awaited:
        """Moves the arm; see `Robot.motion`."""
        return self._awaited("motion")

    @property
    def io(self) -> Awaited:
        """Inputs and outputs; see `Robot.io`."""
        return self._awaited("io")

    @property
    def safety(self) -> Awaited:
        """The interlock between motions and the arm; see `Robot.safety`."""
        return self._awaited("safety")

    @property
    def script(self) -> Awaited:
        """Sends programs and lines of URScript; see `Robot.script`."""
        return self._awaited("script")

    @property
    def dashboard(self) -> Awaited:
        """Power, brakes, installed programs, and unlocking after a protective stop; see `Robot.dashboard`."""
        return self._awaited("dashboard")

    @property
    def rtde(self) -> Awaited:
        """Variables of the controller by name; `outputs` gives an `AsyncStream`. See `Robot.rtde`."""
        return self._awaited("rtde")

    @property
    def registers(self) -> Awaited:
        """General-purpose registers by number; see `Robot.registers`."""
        return self._awaited("registers")

    def _awaited(self, name: str) -> Awaited:
        return Awaited(lambda: getattr(self._robot, name), self._workers)

    def set_payload(self, *arguments: Any, **options: Any) -> Call[None]:
        """As `Robot.set_payload`."""
        return self.call(self._robot.set_payload, *arguments, **options)

    def set_tcp(self, *arguments: Any, **options: Any) -> Call[None]:
        """As `Robot.set_tcp`."""
        return self.call(self._robot.set_tcp, *arguments, **options)

    def set_speed_slider(self, *arguments: Any, **options: Any) -> Call[None]:
        """As `Robot.set_speed_slider`."""
        return self.call(self._robot.set_speed_slider, *arguments, **options)

    def freedrive(self, *arguments: Any, **options: Any) -> Call[Any]:
        """As `Robot.freedrive`: ``async with robot.freedrive():``."""
        return self.call(self._robot.freedrive, *arguments, **options)

    def teach(self, *arguments: Any, **options: Any) -> Call[Any]:
        """As `Robot.teach`: ``async with robot.teach() as teaching:``."""
        return self.call(self._robot.teach, *arguments, **options)

    def zero_force_sensor(self) -> Call[None]:
        """As `Robot.zero_force_sensor`."""
        return self.call(self._robot.zero_force_sensor)

    def popup(self, *arguments: Any, **options: Any) -> Call[None]:
        """As `Robot.popup`."""
        return self.call(self._robot.popup, *arguments, **options)

    def call(self, function: Callable[..., T], *arguments: Any, **options: Any) -> Call[T]:
        """Call a function that blocks, in a thread of the robot.

        Raises:
            Closed: the robot was closed.
            LocalError: the system has no thread left.
        """
        return Call(self._workers, lambda: given(function(*arguments, **options)))

    # -- its end -------------------------------------------------------------------------------------

    async def close(self) -> None:
        """End motions, close every stream, and the simulator if there is one, in two seconds. Idempotent.

        A task that is cancelled meanwhile ends when this is done.
        """
        if self._ending is None:
            self._ending = asyncio.create_task(self._close())
        await finished(self._ending)

    async def _close(self) -> None:
        robot, workers = self._robot, self._workers
        try:
            if workers.is_used or robot._controller is not None:
                await asyncio.wrap_future(workers.submit(robot.close))
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
        return f"<AsyncRobot{repr(self._robot).removeprefix('<Robot')}"


class _Connecting:
    """The result of `connect_async`: to be awaited, or entered with ``async with``."""

    def __init__(self, address: str | os.PathLike[str], options: dict[str, Any]) -> None:
        arguments = inspect.signature(threaded.connect).bind(address, **options)
        arguments.apply_defaults()
        self._wanted = threaded.check(**arguments.arguments)
        self._robot: AsyncRobot | None = None

    async def _connect(self) -> AsyncRobot:
        wanted, place = self._wanted, self._wanted.place
        if wanted.isolate:
            raise LocalError("isolate=True is for urlink.connect: the event loop reads by itself")
        if isinstance(place, RecordingAddress):
            raise LocalError(f"{wanted.address} is a recording, which urlink.connect plays, and no event loop")
        loop = running_loop("connect_async")
        workers = Workers(wanted.address, _CALLS)
        controller = robot = None
        try:
            if isinstance(place, SimulatorAddress):
                simulated = partial(threaded.simulated, place)
                made: tuple[Controller, RobotAddress] = await workers.make(simulated, lambda made: made[0].close())
                controller, place = made
            known = await _identified(place, wanted)
            source = networked(
                place,
                timeout=wanted.timeout,
                read_only=wanted.read_only,
                backoff=wanted.backoff,
                silence=wanted.silence,
                tcp=AwaitedTcp,
                known=known,
            )._replace(connection=partial(LoopConnection, loop=loop), rtde=AwaitedRtde)
            robot = threaded.assemble(wanted, place, source, controller, known)
            if threaded.owes(robot, place):
                await workers.make(partial(threaded.take_back, robot, wanted.timeout))
            return AsyncRobot(robot, workers)
        except BaseException:
            if robot is not None:
                workers.submit(robot.close)
            elif controller is not None:
                workers.submit(controller.close)
            workers.close()
            raise

    def __await__(self) -> Generator[Any, None, AsyncRobot]:
        return self._connect().__await__()

    async def __aenter__(self) -> AsyncRobot:
        self._robot = await self._connect()
        return self._robot

    async def __aexit__(self, *exc: object) -> None:
        if self._robot is not None:
            await self._robot.close()


def connect_async(address: str | os.PathLike[str], **options: Any) -> _Connecting:
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
    return _Connecting(address, options)


async def _identified(place: RobotAddress, wanted: threaded.Wanted) -> Identity:
    """The identity of the controller at an address, read on the event loop; otherwise as `networked`."""
    suffix = "_readonly" if wanted.read_only else ""
    try:
        return await _identify(place.host, place.ports["primary" + suffix], wanted.timeout)
    except ConnectFailed as error:
        first = unraised(error)
    try:
        return await _identify(place.host, place.ports["secondary" + suffix], wanted.timeout)
    except ConnectFailed:
        raise first from None
    finally:
        del first  # it refers to this frame


async def _identify(host: str, port: int, timeout: float) -> Identity:
    """As `urlink.identity.identify`."""
    introduction = Introduction(f"{host}:{port}", timeout)
    transport = AwaitedTcp(host, port, silence=timeout, refused=lambda: refusal_hint(None))
    await transport.connect(timeout)
    try:
        while not introduction.is_over:
            try:
                introduction.hear((await transport.receive_awaited(introduction.left))[0])
            except LinkTimeout:
                continue
            except ConnectionLost as error:
                introduction.lose(error)
    finally:
        transport.abort()  # nothing was sent
    return introduction.identity

"""The public awaitables of the asyncio API, found by introspection, and sample arguments.

A name is the class and the method: ``AsyncIO.wait_digital_in``. A method without required arguments is called without
arguments, unless `SAMPLES` has a row for it. A method with required arguments needs a row.
"""

from __future__ import annotations

import asyncio
import contextlib
import functools
import gzip
import importlib
import inspect
import pkgutil
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator, Mapping, Sequence
from contextlib import AbstractAsyncContextManager
from pathlib import Path
from types import ModuleType
from typing import Any

import linkcore.aio
import rhdlink
import rhdlink.aio
import urlink
import urlink.aio
from linkcore.errors import Cancelled
from linkcore.event_loop import Workers
from rhdlink.robots import VelocityOmega
from tests.urlink.motion.payloads_drawn import exact_payload
from urlink.aio.async_group import AsyncGroup
from urlink.aio.awaited import AwaitedHandle

__all__ = ["AT_ONCE", "CHANGES", "OPEN", "SAMPLES", "Cell", "awaitables", "lacking", "use_of"]

#: Start configuration of the arm, in rad.
READY = [0.3, -1.57, 1.57, -1.57, -1.57, 0.0]
#: Configuration that a motion reaches after several seconds.
FAR = [0.9, *READY[1:]]
MOVEJ = f"movej({FAR}, a=1, v=0.1)"
PROGRAM = "pick.urp"
PAYLOAD = exact_payload(1.0, (0.0, 0.0, 0.05))

#: Names that return at once, and are not awaited.
AT_ONCE = {
    *("AsyncFeed.iterate", "AsyncFeed.__aiter__", "AsyncStream.of", "AsyncGripper.position_of"),
    *("AsyncWrenchStream.__aiter__", "AsyncWrenchStream.compensate"),
    *("AwaitedHandle.cancel", "AwaitedHandle.add_done_callback"),
}
#: Names that change the robot or its connection: the next trial gets another robot.
CHANGES = {
    *("AsyncRobot.close", "AsyncStream.close", "AsyncRtde.close", "AsyncToolSerial.close", "AsyncInputs.close"),
    *("AsyncDashboard.close", "AsyncDashboard.quit", "AsyncDashboard.shutdown", "AsyncDashboard.power_off"),
    *("AsyncDashboard.restart_safety", "AsyncDashboard.set_operational_mode", "AsyncMobileRobot.close"),
}


class Cell:
    """Robots, host and files that are needed to create the objects whose methods are called.

    Attributes:
        robots: Asyncio robots, each with its own controller: two for a group, otherwise one.
        host: Address of a host of rhdlink.
        files: Folder for files.
    """

    def __init__(self, robots: Sequence[urlink.AsyncRobot], host: str, files: Path) -> None:
        self.robots = robots
        self.host = host
        self.files = files
        self._numbers = iter(range(1_000_000))

    @property
    def robot(self) -> urlink.AsyncRobot:
        return self.robots[0]

    @property
    def other(self) -> urlink.AsyncRobot:
        return self.robots[1]

    def new_file(self, suffix: str) -> Path:
        return self.files / f"{next(self._numbers)}{suffix}"


# -- the surface -------------------------------------------------------------------------------------


def _modules() -> Iterator[ModuleType]:
    for package in (urlink.aio, linkcore.aio):
        for found in pkgutil.iter_modules(package.__path__):
            yield importlib.import_module(f"{package.__name__}.{found.name}")
    yield rhdlink.aio


@functools.cache
def _classes() -> Mapping[str, type]:
    """Return the asyncio classes by name; the class of rhdlink gets another name than the class of urlink."""
    found: dict[str, type] = {}
    for module in _modules():
        for name, kind in vars(module).items():
            is_ours = inspect.isclass(kind) and kind.__module__.partition(".")[0] in ("urlink", "linkcore", "rhdlink")
            if is_ours and (name.startswith("Async") or kind is AwaitedHandle):
                found["AsyncMobileRobot" if kind is rhdlink.aio.AsyncRobot else name] = kind
    return found


@functools.cache
def _functions() -> Mapping[str, tuple[type, Callable[..., Any]]]:
    """Return the public functions by name, each with the first class that has it."""
    names = {kind: name for name, kind in _classes().items()}
    found: dict[str, tuple[type, Callable[..., Any]]] = {}
    for kind in names:
        for name in dir(kind):
            if name.startswith("_") and name not in ("__await__", "__aiter__"):
                continue
            owner = next(each for each in kind.__mro__ if name in vars(each))
            function = inspect.getattr_static(kind, name)
            if isinstance(function, staticmethod):
                function = function.__func__
            if inspect.isfunction(function) and owner in names:
                found.setdefault(f"{names[owner]}.{name}", (kind, function))
    return found


def awaitables() -> list[str]:
    """Return all awaitables, class by class."""
    return sorted(set(_functions()) - AT_ONCE)


def _required(function: Callable[..., Any]) -> list[str]:
    several = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
    parameters = list(inspect.signature(function).parameters.values())[1:]
    return [each.name for each in parameters if each.default is each.empty and each.kind not in several]


def lacking() -> list[str]:
    """Return a message for each name that cannot be tested."""
    messages = []
    for name in awaitables():
        _, function = _functions()[name]
        kind = name.partition(".")[0]
        if kind not in OPEN:
            messages.append(f"{kind} cannot be opened; add a row to OPEN in {__name__}")
        if name not in SAMPLES and (missing := _required(function)):
            messages.append(f"{name}() has no sample for {', '.join(missing)}; add a row to SAMPLES in {__name__}")
        is_awaited = inspect.iscoroutinefunction(function) or inspect.isasyncgenfunction(function)
        if not is_awaited and name not in SAMPLES and name.partition(".")[2] != "__await__":
            messages.append(f"{name}() is not a coroutine; add a row to SAMPLES in {__name__}, or to AT_ONCE")
    known = set(_functions())
    messages += [f"{name} no longer exists; remove it from {__name__}" for name in {*SAMPLES, *CHANGES} - known]
    return messages


def use_of(name: str, part: Any, cell: Cell) -> Callable[[], Awaitable[object]]:
    """Return a function that awaits this name once."""
    sample = SAMPLES.get(name)
    if sample is not None:
        return functools.partial(_called, sample, part, cell)
    method = name.partition(".")[2]
    if method == "__await__":
        return functools.partial(_awaited, part)
    return getattr(part, method)  # type: ignore[no-any-return]


async def _awaited(part: Any) -> None:
    await part


async def _called(sample: Sample, part: Any, cell: Cell) -> None:
    made = sample(part) if len(inspect.signature(sample).parameters) == 1 else sample(part, cell)
    if hasattr(made, "__aenter__"):
        async with made:
            await asyncio.sleep(0.1)
    elif hasattr(made, "__anext__"):
        async with contextlib.aclosing(made):
            async for _ in made:
                break
    else:
        await made


# -- parts -------------------------------------------------------------------------------------------


@contextlib.asynccontextmanager
async def _is(part: Any) -> AsyncIterator[Any]:
    yield part


@contextlib.asynccontextmanager
async def _points(cell: Cell) -> AsyncIterator[Any]:
    async with cell.robot.motion.stream(buffer=0.3) as stream:
        here = cell.robot.realtime.latest.q_target  # type: ignore[union-attr]
        await stream.append(urlink.Trajectory.from_arrays([0.0, 0.5], [here, here + 0.02]), wait=False)
        yield stream


@contextlib.asynccontextmanager
async def _named_points(cell: Cell) -> AsyncIterator[Any]:
    await cell.robot.points.teach("bin", replace=True)
    yield cell.robot.points


@contextlib.asynccontextmanager
async def _points_of_all(cell: Cell) -> AsyncIterator[Any]:
    async with AsyncGroup(cell.robot, cell.other).stream(buffer=0.3) as stream:
        await stream.append([_away(cell.robot, 0.02, 0.5), _away(cell.other, 0.02, 0.5)], wait=False)
        yield stream


@contextlib.asynccontextmanager
async def _interpreter(cell: Cell) -> AsyncIterator[Any]:
    with contextlib.suppress(Cancelled):  # otherwise, leaving the block waits for the statements
        async with cell.robot.interpreter() as interpreter:
            yield interpreter
            interpreter.cancel()


@contextlib.asynccontextmanager
async def _rg(cell: Cell) -> AsyncIterator[Any]:
    async with urlink.connect_async("sim://ur5e?gripper=rg2") as robot:
        yield robot.gripper("rg2")


@contextlib.asynccontextmanager
async def _vacuum(cell: Cell) -> AsyncIterator[Any]:
    async with urlink.connect_async("sim://ur5e?gripper=vacuum") as robot:
        gripper = robot.gripper("vacuum")
        await gripper.activate()
        yield gripper


@contextlib.asynccontextmanager
async def _mobile(cell: Cell) -> AsyncIterator[Any]:
    async with rhdlink.aio.connect(cell.host, VelocityOmega, access="w") as robot:
        yield robot


@contextlib.asynccontextmanager
async def _wrench(cell: Cell) -> AsyncIterator[Any]:
    yield await cell.robot.wrench(PAYLOAD)


#: Class -> function that opens an object of it. Some parts are opened while the arm moves: a cancel has to stop it.
OPEN: Mapping[str, Callable[[Cell], AbstractAsyncContextManager[Any]]] = {
    "AsyncRobot": lambda cell: _is(cell.robot),
    "AsyncMotions": lambda cell: _is(cell.robot.motion),
    "AsyncIO": lambda cell: _is(cell.robot.io),
    "AsyncSafety": lambda cell: _is(cell.robot.safety),
    "AsyncScripts": lambda cell: _is(cell.robot.script),
    "AsyncDashboard": lambda cell: _is(cell.robot.dashboard),
    "AsyncGripper": lambda cell: _is(cell.robot.gripper),
    "AsyncRGGripper": _rg,
    "AsyncVacuumGripper": _vacuum,
    "AsyncToolSerial": lambda cell: _is(cell.robot.tool_serial),
    "AsyncRtde": lambda cell: _is(cell.robot.rtde),
    "AsyncRegisters": lambda cell: _is(cell.robot.registers),
    "AsyncFeed": lambda cell: _is(cell.robot.primary.of(urlink.packets.RobotModeData)),
    "AsyncStream": lambda cell: _is(cell.robot.secondary),
    "AsyncOutputStream": lambda cell: cell.robot.rtde.outputs("actual_q", frequency=125),
    "AsyncInputs": lambda cell: cell.robot.rtde.inputs("input_int_register_24"),
    "AsyncTeaching": lambda cell: cell.robot.teach(),
    "AsyncWrenchStream": _wrench,
    "AsyncInterpreter": _interpreter,
    "AsyncPointStream": _points,
    "AsyncPoints": _named_points,
    "AwaitedHandle": _interpreter,
    "AsyncGroup": lambda cell: _is(AsyncGroup(cell.robot, cell.other)),
    "AsyncGroupStream": _points_of_all,
    "AsyncMobileRobot": _mobile,
}


# -- arguments ---------------------------------------------------------------------------------------


def _here(robot: Any) -> Any:
    return robot.realtime.latest.q_target


def _away(robot: Any, by: float, seconds: float, since: float = 0.0) -> urlink.Trajectory:
    q = _here(robot)
    return urlink.Trajectory.from_arrays([since, seconds], [q, q + by])


def _pose(robot: Any, by: float = 0.1) -> list[float]:
    pose: list[float] = robot.realtime.latest.tool_vector_actual.tolist()
    return [*pose[:2], pose[2] + by, *pose[3:]]


Sample = Callable[..., Any]


def _numbered(name: str, **options: Any) -> Sample:
    return lambda io: getattr(io, name)(0, **options)


_DOWN = "base", [0, 0, 1, 0, 0, 0], [0, 0, -10.0, 0, 0, 0], [0.1] * 6

SAMPLES: Mapping[str, Sample] = {
    "AsyncRobot.call": lambda robot: robot.call(lambda: robot._part.motion.move_joints(FAR, speed=0.1, wait=True)),
    "AsyncRobot.freedrive": lambda robot: robot.freedrive(),
    "AsyncRobot.interpreter": lambda robot: robot.interpreter(),
    "AsyncRobot.measure_payload": lambda robot: robot.measure_payload(1.2, may_move=True),
    "AsyncRobot.measure_payload_by_hand": lambda robot: robot.measure_payload_by_hand(),
    "AsyncRobot.popup": lambda robot: robot.popup("Hello"),
    "AsyncRobot.record": lambda robot, cell: robot.record(cell.new_file(".urlog")),
    "AsyncRobot.set_gravity": lambda robot: robot.set_gravity([0, 0, 9.82]),
    "AsyncRobot.set_payload": lambda robot: robot.set_payload(0.1),
    "AsyncRobot.set_speed_slider": lambda robot: robot.set_speed_slider(1.0),
    "AsyncRobot.set_tcp": lambda robot: robot.set_tcp([0, 0, 0.1, 0, 0, 0]),
    "AsyncRobot.teach": lambda robot: robot.teach(),
    "AsyncRobot.view": lambda robot: robot.view(),
    "AsyncRobot.wrench": lambda robot: robot.wrench(PAYLOAD),
    "AsyncWrenchStream.wait_until": lambda stream: stream.wait_until(lambda wrench: False, 15.0),
    "AsyncMotions.follow": lambda motion, cell: motion.follow(_away(cell.robot, 0.5, 5.0), wait=True),
    "AsyncMotions.force_mode": lambda motion: motion.force_mode(*_DOWN),
    "AsyncMotions.impedance": lambda motion: motion.impedance(),
    "AsyncMotions.jog": lambda motion: motion.jog(),
    "AsyncMotions.move_circular": lambda motion, cell: motion.move_circular(
        [_pose(cell.robot, 0.05)[0] + 0.02, *_pose(cell.robot, 0.05)[1:]], _pose(cell.robot), speed=0.02, wait=True
    ),
    "AsyncMotions.move_joints": lambda motion: motion.move_joints(FAR, speed=0.1, wait=True),
    "AsyncMotions.move_linear": lambda motion, cell: motion.move_linear(_pose(cell.robot), speed=0.02, wait=True),
    "AsyncMotions.path": lambda motion: motion.path([urlink.Joint(FAR)], speed=0.1, wait=True),
    "AsyncMotions.servo": lambda motion: motion.servo(),
    "AsyncMotions.speed_joints": lambda motion: motion.speed_joints([0.1, 0, 0, 0, 0, 0], duration=5.0, wait=True),
    "AsyncMotions.speed_linear": lambda motion: motion.speed_linear([0, 0, 0.01, 0, 0, 0], duration=5.0, wait=True),
    "AsyncMotions.stream": lambda motion: motion.stream(),
    "AsyncMotions.torque": lambda motion: motion.torque(),
    "AsyncMotions.until_contact": lambda motion: motion.until_contact([0, 0, 1], 0.01, distance=0.05, wait=True),
    "AsyncIO.set_analog_out": lambda io: io.set_analog_out(0, 0.1),
    "AsyncIO.set_tool_voltage": lambda io: io.set_tool_voltage(0),
    **{
        f"AsyncIO.{name}": _numbered(name)
        for name in (
            *("analog_in", "analog_out", "configurable_digital_in", "configurable_digital_out", "digital_in"),
            *("digital_out", "tool_analog_in", "tool_digital_in", "tool_digital_out"),
        )
    },
    **{
        f"AsyncIO.{name}": _numbered(name, timeout=15.0)
        for name in ("wait_digital_in", "wait_configurable_digital_in", "wait_tool_digital_in")
    },
    **{
        f"AsyncIO.set_{name}": _numbered(f"set_{name}", on=True)
        for name in ("digital_out", "configurable_digital_out", "tool_digital_out", "flag")
    },
    "AsyncSafety.on_stop": lambda safety: safety.on_stop(print),
    "AsyncSafety.wait_for_stop": lambda safety: safety.wait_for_stop(15.0),
    "AsyncScripts.run": lambda script: script.run(MOVEJ, wait=True),
    "AsyncScripts.send_line": lambda script: script.send_line("set_analog_out(0, 0.1)"),
    "AsyncDashboard.add_to_log": lambda dashboard: dashboard.add_to_log("Hello"),
    "AsyncDashboard.download_program": lambda dashboard: dashboard.download_program(PROGRAM),
    "AsyncDashboard.generate_support_file": lambda dashboard: dashboard.generate_support_file("/programs"),
    "AsyncDashboard.load": lambda dashboard: dashboard.load(PROGRAM),
    "AsyncDashboard.load_installation": lambda dashboard: dashboard.load_installation("default.installation"),
    "AsyncDashboard.play": lambda dashboard: _played(dashboard),
    "AsyncDashboard.popup": lambda dashboard: dashboard.popup("Hello"),
    "AsyncDashboard.send": lambda dashboard: dashboard.send("robotmode"),
    "AsyncDashboard.set_operational_mode": lambda dashboard: dashboard.set_operational_mode("automatic"),
    "AsyncDashboard.set_user_role": lambda dashboard: dashboard.set_user_role("none"),
    "AsyncDashboard.upload_program": lambda dashboard, cell: dashboard.upload_program(cell.new_file(".urpx")),
    "AsyncGripper.get": lambda gripper: gripper.get("POS"),
    "AsyncRGGripper.move": lambda gripper: gripper.move(0.05),
    "AsyncVacuumGripper.get": lambda gripper: gripper.get("MOD"),
    "AsyncGripper.move": lambda gripper: gripper.move(200, speed=1),
    "AsyncToolSerial.ask": lambda tool: tool.ask(b"hello", 5),
    "AsyncToolSerial.read": lambda tool: tool.read(5),
    "AsyncToolSerial.write": lambda tool: tool.write(b"hello"),
    "AsyncRtde.inputs": lambda rtde: rtde.inputs("input_int_register_25"),
    "AsyncRtde.outputs": lambda rtde: rtde.outputs("actual_qd"),
    "AsyncRegisters.read_bit": lambda registers: registers.read_bit(64),
    "AsyncRegisters.read_float": lambda registers: registers.read_float(24),
    "AsyncRegisters.read_integer": lambda registers: registers.read_integer(24),
    "AsyncRegisters.write_bit": lambda registers: registers.write_bit(64, True),
    "AsyncRegisters.write_float": lambda registers: registers.write_float(24, 0.5),
    "AsyncRegisters.write_integer": lambda registers: registers.write_integer(24, 1),
    "AsyncInputs.send": lambda inputs: inputs.send(input_int_register_24=1),
    "AsyncFeed.history": lambda feed: feed.history(1.0),
    "AsyncFeed.subscribe": lambda feed: feed.subscribe(id),
    "AsyncFeed.wait_until": lambda feed: feed.wait_until(lambda packet: False, timeout=15.0),
    "AsyncFeed.plot": lambda feed: feed.plot("robot_mode", seconds=0.3),
    "AsyncStream.subscribe": lambda stream: stream.subscribe(id),
    "AsyncStream.join": lambda stream: stream.join(5.0),
    "AsyncInterpreter.execute": lambda interpreter: interpreter.execute(MOVEJ, wait=True),
    "AsyncPointStream.append": lambda points, cell: points.append(_away(cell.robot, 0.5, 5.0, since=0.6)),
    "AsyncPointStream.replace": lambda points, cell: points.replace(0.3, _away(cell.robot, 0.3, 5.0)),
    "AsyncPoints.add": lambda points: points.add("new", points["bin"], replace=True),
    "AsyncPoints.check": lambda points: points.check("bin"),
    "AsyncPoints.get": lambda points: points.get("bin"),
    "AsyncPoints.import_program": lambda points, cell: points.import_program(_program(cell), replace=True),
    "AsyncPoints.remove": lambda points: points.remove("bin"),
    "AsyncPoints.teach": lambda points: points.teach("bin", replace=True),
    "AsyncGroup.follow": lambda group, cell: group.follow(
        [_away(cell.robot, 0.5, 5.0), _away(cell.other, 0.5, 5.0)], wait=True
    ),
    "AsyncGroup.move_joints": lambda group: group.move_joints([FAR, FAR], speed=0.1, wait=True),
    "AsyncGroup.states": lambda group: group.states(),
    "AsyncGroup.stream": lambda group: group.stream(),
    "AsyncGroupStream.append": lambda points, cell: points.append(
        [_away(cell.robot, 0.5, 5.0, since=0.6), _away(cell.other, 0.5, 5.0, since=0.6)]
    ),
    "AsyncGroupStream.replace": lambda points, cell: points.replace(
        0.3, [_away(cell.robot, 0.3, 5.0), _away(cell.other, 0.3, 5.0)]
    ),
    "AsyncMobileRobot.updates": lambda robot: robot.updates(),
}


def _program(cell: Cell) -> Path:
    """Write a program with a waypoint, and return its path."""
    joints = '<JointAngles angles="0, -1.5, 1.5, 0, 1, 0"/><TCPOffset pose="0, 0, 0, 0, 0, 0"/>'
    waypoint = f'<Waypoint type="Fixed" name="home"><position>{joints}</position></Waypoint>'
    path = cell.new_file(".urp")
    path.write_bytes(gzip.compress(f"<URProgram>{waypoint}</URProgram>".encode()))
    return path


async def _played(dashboard: Any) -> None:
    await dashboard.load(PROGRAM)
    await dashboard.play()


def is_busy(workers: Workers) -> bool:
    """Whether a call is running, or is waiting for a thread."""
    threads = workers._threads
    return bool(threads._calls) or threads._idle < len(threads._threads)

"""The asyncio face beside the blocking one: the same names, arguments and types, and nothing that is not there."""

from __future__ import annotations

import inspect
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import urlink
from linkcore.aio.async_stream import AsyncFeed
from tests.listed import assert_listed
from urlink.aio import parts
from urlink.aio.async_group import AsyncGroup, AsyncGroupStream
from urlink.aio.awaited import AwaitedPart
from urlink.motion.stream.group_motion import GroupStream
from urlink.protocol.gripper.client import Gripper
from urlink.protocol.tool_serial import ToolSerial

ROOT = Path(__file__).parents[3]

#: An expression for what users hold -> its class there, and with asyncio.
PAIRS: dict[str, tuple[type, type]] = {
    "robot": (urlink.Robot, urlink.AsyncRobot),
    "robot.realtime": (urlink.Stream, urlink.aio.parts.AsyncStream),
    "robot.realtime.of(urlink.packets.RealtimeState)": (urlink.Feed, AsyncFeed),
    "robot.motion": (urlink.motion.Motions, parts.AsyncMotions),
    "robot.io": (urlink.IO, parts.AsyncIO),
    "robot.safety": (urlink.Safety, parts.AsyncSafety),
    "robot.script": (urlink.Scripts, parts.AsyncScripts),
    "robot.dashboard": (urlink.Dashboard, parts.AsyncDashboard),
    "robot.gripper": (Gripper, parts.AsyncGripper),
    "robot.tool_serial": (ToolSerial, parts.AsyncToolSerial),
    "robot.rtde": (urlink.rtde.Rtde, parts.AsyncRtde),
    "robot.registers": (urlink.rtde.Registers, parts.AsyncRegisters),
    "interpreter": (urlink.Interpreter, parts.AsyncInterpreter),
    "points": (urlink.motion.PointStream, parts.AsyncPointStream),
    "group": (urlink.Group, AsyncGroup),
    "points_of_all": (GroupStream, AsyncGroupStream),
    "teaching": (urlink.motion.Teaching, parts.AsyncTeaching),
    "inputs": (urlink.rtde.Inputs, parts.AsyncInputs),
    "outputs": (urlink.rtde.OutputStream, parts.AsyncOutputStream),
}

#: What there is with asyncio alone.
MORE = {
    "robot": {"identify", "call"},  # what a property of the other asks, and calls that block
    "robot.realtime": {"stream"},  # the same for threads
    "outputs": {"stream"},
}

#: Arguments that are missing with asyncio: the loop calls back, so nothing is queued, and closing waits for the task.
LESS = {
    "subscribe": {"policy", "lifespan", "inline"},
    "close": {"timeout"},
}
#: Where they are missing.
STREAMS = {"robot.realtime", "robot.realtime.of(urlink.packets.RealtimeState)", "outputs"}

#: What is read there and asked for here.
ASKED = {"interpreter.state"}
#: What is entered with ``async with``.
BLOCKS = {
    *("robot.motion.servo", "robot.motion.jog", "robot.motion.force_mode", "robot.motion.torque"),
    "robot.motion.stream",
    "group.stream",
    "robot.motion.impedance",
    *("robot.freedrive", "robot.teach", "robot.interpreter", "robot.record", "robot.rtde.inputs", "robot.rtde.outputs"),
    "robot.view",
}
#: What returns at once in both.
AT_ONCE = {"of", "iterate", "states", "position_of", "cancel", "add_done_callback"}


def surface(kind: type, attributes: tuple[str, ...] = ()) -> set[str]:
    return {name for name in (*dir(kind), *attributes) if not name.startswith("_")}


#: Attributes that are set in __init__ and documented.
ATTRIBUTES = {
    "robot": ("address",),
    "teaching": ("taught",),
    "points": ("buffer",),
    "group": ("robots",),
    "points_of_all": ("motions",),
    "inputs": ("names",),
    "outputs": ("names", "frequency"),
}


@pytest.mark.parametrize("path", PAIRS)
def test_both_have_the_same_names(path: str) -> None:
    blocking, awaited = PAIRS[path]
    where = f"{awaited.__qualname__} in src/{awaited.__module__.replace('.', '/')}.py"
    assert_listed(surface(blocking, ATTRIBUTES.get(path, ())), surface(awaited) - MORE.get(path, set()), where)


def methods(path: str) -> list[str]:
    kind = PAIRS[path][0]
    return sorted(name for name in surface(kind) if callable(inspect.getattr_static(kind, name)) or name in AT_ONCE)


@pytest.mark.parametrize("path", PAIRS)
def test_the_same_names_take_the_same_arguments(path: str) -> None:
    blocking, awaited = PAIRS[path]
    for name in methods(path):
        wanted, found = (
            {
                each.name: (each.kind, each.default)
                for each in inspect.signature(getattr(kind, name)).parameters.values()
                if each.name != "self"
            }
            for kind in (blocking, awaited)
        )
        less = LESS.get(name, set()) if path in STREAMS else set()
        assert found == {key: value for key, value in wanted.items() if key not in less}, name


@pytest.mark.parametrize("path", [path for path, (_, kind) in PAIRS.items() if issubclass(kind, AwaitedPart)])
def test_every_method_is_awaited_and_what_is_unknown_is_an_error(path: str) -> None:
    kind = PAIRS[path][1]
    for name in methods(path):
        is_other = name in AT_ONCE or f"{path}.{name}" in BLOCKS
        assert inspect.iscoroutinefunction(getattr(kind, name)) != is_other, name
    part: Any = object.__new__(kind)
    with pytest.raises(AttributeError, match=r"has no attribute 'curent'"):
        part.curent = 3
    with pytest.raises(AttributeError, match=r"has no attribute 'curent'"):
        part.curent  # noqa: B018


# -- types ---------------------------------------------------------------------------------------

#: Types of results there -> here.
GIVEN = {
    "urlink.command.interpreter.Interpreter": "urlink.aio.parts.AsyncInterpreter",
    "urlink.motion.stream.point_stream.PointStream": "urlink.aio.parts.AsyncPointStream",
    "urlink.motion.stream.group_motion.GroupStream": "urlink.aio.async_group.AsyncGroupStream",
    "urlink.robot.Robot": "urlink.aio.async_robot.AsyncRobot",
    "typing.Iterator[tuple": "typing.AsyncIterator[tuple",
    "urlink.motion.teaching.Teaching": "urlink.aio.parts.AsyncTeaching",
    "urlink.rtde.inputs.Inputs": "urlink.aio.parts.AsyncInputs",
    "urlink.rtde.registers.Registers": "urlink.aio.parts.AsyncRegisters",
    "linkcore.streaming.feed.Feed": "linkcore.aio.async_stream.AsyncFeed",
    "typing.Iterator": "linkcore.aio.packets.Packets",
}

HEAD = """
from collections.abc import Awaitable, Callable
from typing import Any, TypeVar

import urlink
from urlink.aio import parts
from urlink.aio.async_group import AsyncGroup, AsyncGroupStream
from urlink.motion.stream.group_motion import GroupStream

T = TypeVar("T")


def awaited(method: Callable[..., Awaitable[T]]) -> T: raise NotImplementedError
def at_once(method: Callable[..., T]) -> T: raise NotImplementedError


class Cell(urlink.rtde.Outputs):
    tick: int


"""

#: What mypy has to find, and pyright too: five mistakes in each function, and nothing else.
MISTAKES = """
import urlink


async def awaited() -> None:
    urlink.connect_async("sim://", tiemout=3)  # by itself: after it, pyright takes the result for Unknown
    async with urlink.connect_async("sim://") as robot:
        await robot.motion.mvoe_joints([0.0] * 6)
        await robot.motion.move_joints([0.0] * 6, sped=1)
        await robot.safety.enabel()
        robot.motion.curent = 3
        on: bool = await robot.io.digital_in(0)


async def awaited_elsewhere() -> None:
    async with urlink.connect_async("sim://") as robot:
        robot.motion.stop()
        on: str = await robot.io.digital_in(0)
        async with robot.motion.servo() as servo:
            servo.sned([0.0] * 6)
        async with robot.io.digital_in(0):
            pass
        await robot.gripper.move("open")
"""


def typed(tmp_path: Path, source: str) -> list[str]:
    """What mypy prints about a file."""
    pytest.importorskip("mypy")
    file = tmp_path / "looked_at.py"
    file.write_text(source)
    command = [sys.executable, "-m", "mypy", "--strict", "--no-error-summary", "--hide-error-context"]
    ran = subprocess.run(
        [*command, "--cache-dir", str(ROOT / ".mypy_cache"), str(file)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=280,
        check=False,
    )
    assert not ran.stderr, ran.stderr
    return ran.stdout.splitlines()


def revealed(lines: list[str]) -> list[str]:
    found = [re.search(r'Revealed type is "(.*)"$', line) for line in lines]
    assert all(found), "\n".join(lines)
    return [match[1] for match in found if match is not None]


@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.real_time
def test_the_types_of_all_results_are_those_of_the_blocking_face(tmp_path: Path) -> None:
    names = ["robot", "interpreter", "points", "group", "points_of_all", "teaching", "inputs", "outputs"]
    blocking_types = (
        "urlink.Robot, urlink.Interpreter, urlink.motion.PointStream, urlink.Group, GroupStream, "
        "urlink.motion.Teaching, urlink.rtde.Inputs, urlink.rtde.OutputStream[Cell]"
    )
    awaited_types = (
        "urlink.AsyncRobot, parts.AsyncInterpreter, parts.AsyncPointStream, AsyncGroup, AsyncGroupStream, "
        "parts.AsyncTeaching, parts.AsyncInputs, parts.AsyncOutputStream[Cell]"
    )
    lines = {True: [], False: []}  # type: dict[bool, list[str]]
    whats = []
    for path in PAIRS:
        for name in sorted(surface(PAIRS[path][0])):
            if f"{path}.{name}" in PAIRS or f"{path}.{name}" == "robot.rtde.outputs":
                continue
            attribute = f"{path}.{name}"
            whats.append(attribute)
            is_method = name in methods(path)
            lines[False].append(f"at_once({attribute})" if is_method else attribute)
            how = "at_once" if name in AT_ONCE else "awaited"
            lines[True].append(f"{how}({attribute})" if is_method or attribute in ASKED else attribute)
    for outputs in ('robot.rtde.outputs("actual_q")', "robot.rtde.outputs(Cell, frequency=125)"):
        whats.append(outputs)
        lines[False].append(outputs)
        lines[True].append(f"await {outputs}")
    source = HEAD
    for is_awaited, types in ((False, blocking_types), (True, awaited_types)):
        arguments = ", ".join(f"{name}: {type}" for name, type in zip(names, types.split(", "), strict=True))
        source += f"async def look_{is_awaited}({arguments}) -> None:\n"
        source += "".join(f"    reveal_type({each})\n" for each in lines[is_awaited])
    found = revealed(typed(tmp_path, source))
    assert len(found) == 2 * len(whats) > 300
    for what, wanted, got in zip(whats, found[: len(whats)], found[len(whats) :], strict=True):
        for there, here in GIVEN.items():
            wanted = re.sub(rf"\b{re.escape(there)}\b", here, wanted)
        wanted = re.sub(r"\blinkcore\.streaming\.stream\.Stream\b", "linkcore.aio.async_stream.AsyncStream", wanted)
        wanted = re.sub(r"\burlink\.rtde\.outputs\.OutputStream\b", "urlink.aio.parts.AsyncOutputStream", wanted)
        assert got == wanted, what
        assert "Never" not in got, what
        assert got != "Any" or what.endswith("send_line"), what


@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.real_time
def test_mypy_finds_mistakes(tmp_path: Path) -> None:
    found = typed(tmp_path, MISTAKES)
    errors = [int(line.split(":")[1]) for line in found if ": error: " in line]
    assert sorted(set(errors)) == _wrong_lines(), "\n".join(found)


@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.real_time
def test_pyright_finds_mistakes(tmp_path: Path) -> None:
    pyright = shutil.which("pyright", path=os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]]))
    if pyright is None:
        pytest.skip("pyright is not installed")
    file = tmp_path / "looked_at.py"
    file.write_text(MISTAKES)
    ran = subprocess.run(
        [pyright, "--pythonpath", sys.executable, str(file)], capture_output=True, text=True, timeout=280, check=False
    )
    found = re.findall(r":(\d+):\d+ - error", ran.stdout)
    assert sorted({int(number) for number in found}) == _wrong_lines(), ran.stdout


def _wrong_lines() -> list[int]:
    marks = ("tiemout", "mvoe", "sped", "enabel", "curent", "motion.stop()", "on: str", "sned", "async with robot.io")
    lines: list[Any] = MISTAKES.splitlines()
    return [number for number, line in enumerate(lines, 1) if any(mark in line for mark in (*marks, '"open"'))]

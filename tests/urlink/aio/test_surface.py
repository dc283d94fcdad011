"""Compare the asyncio API with the blocking API: names, arguments and types."""

from __future__ import annotations

import inspect
import itertools
import os
import re
import shutil
import subprocess
import sys
import typing
from pathlib import Path
from typing import Any

import pytest

import urlink
from linkcore.aio.async_stream import AsyncFeed, AsyncStream
from urlink.aio import async_group, async_robot, parts
from urlink.aio.awaited import AwaitedPart, Block

ROOT = Path(__file__).parents[3]


def _pairs() -> dict[type, type]:
    """Return blocking class -> asyncio class, which names it: ``class AsyncIO(AwaitedPart[IO])``."""
    pairs: dict[type, type] = {
        urlink.Stream: AsyncStream,
        urlink.Feed: AsyncFeed,
        urlink.rtde.OutputStream: parts.AsyncOutputStream,
    }
    for module in (async_robot, parts, async_group):
        for kind in vars(module).values():
            if inspect.isclass(kind) and issubclass(kind, AwaitedPart) and kind.__module__ == module.__name__:
                ((blocking,),) = (typing.get_args(base) for base in kind.__orig_bases__)  # type: ignore[attr-defined]
                pairs[blocking] = kind
    return pairs


PAIRS = _pairs()
each_pair = pytest.mark.parametrize(("blocking", "awaited"), PAIRS.items(), ids=[kind.__name__ for kind in PAIRS])

#: names that only the asyncio classes have
MORE: dict[type, set[str]] = {
    urlink.AsyncRobot: {"identify", "call"},  # replaces properties that make requests, and runs calls that block
    AsyncStream: {"stream"},  # the blocking stream
    parts.AsyncOutputStream: {"stream"},
}
#: Arguments that are missing in asyncio: the loop calls callbacks without a queue, and closing waits for the task.
LESS = {
    "subscribe": {"policy", "lifespan", "inline"},
    "close": {"timeout"},
}
#: classes without these arguments
STREAMS = (AsyncStream, AsyncFeed)

#: names that are attributes in the blocking API, and methods in asyncio
ASKED = {(parts.AsyncInterpreter, "state")}
#: names that return immediately in both APIs
AT_ONCE = {"of", "iterate", "states", "position_of", "cancel", "add_done_callback", "compensate"}


def surface(kind: type) -> set[str]:
    """Return the public names of a class, including documented attributes that are set in __init__."""
    _, _, attributes = (inspect.getdoc(kind) or "").partition("\nAttributes:\n")
    lines = itertools.takewhile(lambda line: line.startswith(" ") or not line, attributes.splitlines())
    documented = [re.match(r" {4}([a-z_, ]+):", line) for line in lines]
    names = {name for found in documented if found for name in found[1].split(", ")}
    return names | {name for name in dir(kind) if not name.startswith("_")}


def is_method(kind: type, name: str) -> bool:
    return name in AT_ONCE or callable(inspect.getattr_static(kind, name, None))


def methods(kind: type) -> list[str]:
    return sorted(name for name in surface(kind) if is_method(kind, name))


def line_for(blocking: type, name: str) -> str:
    """Return the line that adds this name to the asyncio class."""
    owner = blocking.__name__
    if not is_method(blocking, name):
        return f"    {name} = attribute({owner}, lambda part: part.{name})"
    return f"    {name} = awaited({owner}.{name})"


@each_pair
def test_async_and_blocking_class_have_the_same_names(blocking: type, awaited: type) -> None:
    here, there = surface(awaited) - MORE.get(awaited, set()), surface(blocking)
    place = f"class {awaited.__name__} in src/{awaited.__module__.replace('.', '/')}.py"
    missing = "".join(f"\n{line_for(blocking, name)}" for name in sorted(there - here))
    kinds = "`stopping`, `motion` or `block` instead of `awaited` if the docstring of that function fits better"
    assert not missing, f"add to {place} ({kinds}):{missing}"
    assert not here - there, (
        f"remove from {place}, since {blocking.__name__} does not have them: {sorted(here - there)}"
    )


@each_pair
def test_async_and_blocking_methods_have_the_same_arguments(blocking: type, awaited: type) -> None:
    for name in methods(blocking):
        wanted, found = (
            {
                each.name: (each.kind, each.default)
                for each in inspect.signature(getattr(kind, name)).parameters.values()
                if each.name != "self"
            }
            for kind in (blocking, awaited)
        )
        less = LESS.get(name, set()) if issubclass(awaited, STREAMS) else set()
        assert found == {key: value for key, value in wanted.items() if key not in less}, name


@pytest.mark.parametrize("kind", [kind for kind in PAIRS.values() if issubclass(kind, AwaitedPart)])
def test_async_methods_are_coroutines_or_blocks_and_typos_raise(kind: type[AwaitedPart[Any]]) -> None:
    part: Any = object.__new__(kind)
    part._part = part._workers = None
    for name in methods(kind):
        function = getattr(kind, name)
        if name in AT_ONCE:
            assert not inspect.iscoroutinefunction(function), name
        elif not inspect.iscoroutinefunction(function):
            # A block calls nothing before it is entered, so any arguments are accepted.
            required = [each for each in inspect.signature(function).parameters.values() if each.default is each.empty]
            positional = [each for each in required[1:] if each.kind is each.POSITIONAL_OR_KEYWORD]
            assert isinstance(function(part, *[None for _ in positional]), Block), name
    with pytest.raises(AttributeError, match=r"has no attribute 'curent'"):
        part.curent = 3
    with pytest.raises(AttributeError, match=r"has no attribute 'curent'"):
        part.curent  # noqa: B018


# -- types ---------------------------------------------------------------------------------------


def full_name(kind: type) -> str:
    return f"{kind.__module__}.{kind.__name__}"


#: types of results: blocking -> asyncio
GIVEN = {
    **{full_name(blocking): full_name(awaited) for blocking, awaited in PAIRS.items()},
    "typing.Iterator[tuple": "typing.AsyncIterator[tuple",
    "typing.Iterator": "linkcore.aio.packets.Packets",
}
#: results with the same type in both: handles of single arms, which are awaited like any handle
SAME = {"GroupStream.motions"}
#: type arguments for the generic classes
ARGUMENTS: dict[type, str] = {
    urlink.Stream: "urlink.packets.RealtimeState",
    urlink.Feed: "urlink.packets.RealtimeState",
    urlink.rtde.OutputStream: "Cell",
}

HEAD = """
from collections.abc import Awaitable, Callable
from typing import Any, TypeVar

import urlink
"""

FUNCTIONS = """
T = TypeVar("T")


def awaited(method: Callable[..., Awaitable[T]]) -> T: raise NotImplementedError
def at_once(method: Callable[..., T]) -> T: raise NotImplementedError


class Cell(urlink.rtde.Outputs):
    tick: int


"""

#: mypy and pyright must find five mistakes in each function, and no others
MISTAKES = """
import urlink


async def awaited() -> None:
    urlink.connect_async("sim://", tiemout=3)  # on its own line: pyright treats the result as Unknown
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
    """Return the lines that mypy prints about a file."""
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
def test_types_of_all_results_match_the_blocking_api(tmp_path: Path) -> None:
    modules = sorted({kind.__module__ for pair in PAIRS.items() for kind in pair})
    source = HEAD + "".join(f"import {module}\n" for module in modules) + FUNCTIONS
    looks: dict[bool, list[str]] = {False: [], True: []}
    whats = []
    for number, (blocking, awaited) in enumerate(PAIRS.items()):
        for name in sorted(surface(blocking)):
            if (blocking, name) == (urlink.rtde.Rtde, "outputs"):
                continue  # overloaded, so it is tested below
            whats.append(f"{blocking.__name__}.{name}")
            value = f"part{number}.{name}"
            is_called = is_method(blocking, name)
            how = "at_once" if name in AT_ONCE else "awaited"
            looks[False].append(f"at_once({value})" if is_called else value)
            looks[True].append(f"{how}({value})" if is_called or (awaited, name) in ASKED else value)
    rtde = f"part{list(PAIRS).index(urlink.rtde.Rtde)}"
    for outputs in ('outputs("actual_q")', "outputs(Cell, frequency=125)"):
        whats.append(f"Rtde.{outputs}")
        looks[False].append(f"{rtde}.{outputs}")
        looks[True].append(f"await {rtde}.{outputs}")
    for is_awaited, kinds in ((False, PAIRS.keys()), (True, PAIRS.values())):
        source += f"async def look_{is_awaited}(\n"
        for number, (blocking, kind) in enumerate(zip(PAIRS, kinds, strict=True)):
            of = f"[{ARGUMENTS[blocking]}]" if blocking in ARGUMENTS else ""
            source += f"    part{number}: {full_name(kind)}{of},\n"
        source += ") -> None:\n" + "".join(f"    reveal_type({each})\n" for each in looks[is_awaited])
    found = revealed(typed(tmp_path, source))
    assert len(found) == 2 * len(whats) > 300
    for what, wanted, got in zip(whats, found[: len(whats)], found[len(whats) :], strict=True):
        for there, here in () if what in SAME else GIVEN.items():
            wanted = re.sub(rf"\b{re.escape(there)}\b", here, wanted)
        assert got == wanted, what
        assert "Never" not in got, what
        assert got != "Any" or what.endswith("send_line"), what


@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.real_time
def test_mypy_reports_every_planted_mistake(tmp_path: Path) -> None:
    found = typed(tmp_path, MISTAKES)
    errors = [int(line.split(":")[1]) for line in found if ": error: " in line]
    assert sorted(set(errors)) == _wrong_lines(), "\n".join(found)


@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.real_time
def test_pyright_reports_every_planted_mistake(tmp_path: Path) -> None:
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

"""Which modules may use sockets, asyncio, threads and clocks. pyproject.toml has the contracts of who imports whom."""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from pathlib import Path

import pytest

from tests.listed import assert_listed

SRC = Path(__file__).resolve().parents[1] / "src"

#: The only modules that may import `socket`.
SOCKETS = {
    "linkcore.net.transport",
    "linkcore.net.listener",
    "linkcore.net.loop",
    "linkcore.net.polled",
    "linkcore.net.awaited",
    # Puts others in the place of the standard library's.
    "linkcore.simulated.sockets",
    "linkcore.simulated.takeover",
}

#: The only modules that may import `asyncio`.
AWAITED = {
    "linkcore.event_loop",
    "linkcore.net.awaited",
    "linkcore.aio.async_stream",
    "linkcore.aio.loop_connection",
    "linkcore.aio.packets",
    "urlink.aio.awaited",
    "urlink.aio.async_robot",
    "rhdlink.aio",
}

#: The only modules that may start threads.
THREADS = {
    "linkcore.net.undo",  # undoes what was given up, for as long as there is anything
    "linkcore.threads",  # one for the callbacks of each robot, one for each host or server not run in its caller's
    "linkcore.streaming.connection",  # the reader of each stream
    "linkcore.streaming.subscription",  # one for each callback that is not inline, or has a deadline
    "urlink.simulator.server",  # one for each simulated controller
    "urlink.simulator.control_loop",  # lets time pass within a block, for a controller that is stepped
    "urlink.simulator.programs.loader",  # one at a time, for a long program
    "rhdlink.sync_thread",  # keeps a robot in sync
    "linkcore.recording.index",  # some, for as long as a long recording is checked
    "linkcore.simulated.primitives",  # what a program starts while time is simulated
    "linkcore.event_loop",  # makes the calls that wait, for one robot of a program that uses asyncio
    "rhdlink.drive",  # drives a robot between the motions that are asked for
    "rhdlink.smrcl.mission",  # for a mission that is started rather than run
    "linkcore.cli.progress",  # draws the progress of a command
    "urlink.cli.monitor",  # asks who the robot is while the picture is drawn
}


def name_of(path: Path) -> str:
    return ".".join(path.relative_to(SRC).with_suffix("").parts).removesuffix(".__init__")


MODULES = {name_of(path): path for path in sorted(SRC.rglob("*.py"))}


@cache
def imports(module: str) -> frozenset[str]:
    """The full name of everything that a module imports, wherever in it, also for its types only."""
    return frozenset(_imported(_statements(parsed(module)), package_of(module)))


def parsed(module: str) -> ast.Module:
    """Not kept: that would be a million objects more for each later collection of garbage to look through."""
    return ast.parse(source(module))


@cache
def source(module: str) -> str:
    return MODULES[module].read_text(encoding="utf-8")


def package_of(module: str) -> str:
    return module if MODULES[module].name == "__init__.py" else module.rpartition(".")[0]


def _statements(tree: ast.AST) -> Iterator[ast.stmt]:
    """Every statement in it, wherever."""
    for name in ("body", "orelse", "handlers", "finalbody", "cases"):
        for each in getattr(tree, name, ()):
            if isinstance(each, ast.stmt):
                yield each
            yield from _statements(each)


def _imported(nodes: Iterable[ast.stmt], package: str) -> Iterator[str]:
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            parts = package.split(".")
            base = parts[: len(parts) - node.level + 1] if node.level else []
            origin = ".".join([*base, *([node.module] if node.module else [])])
            for alias in node.names:
                # `from . import models` imports a module, `from .models import Model` a name in one.
                whole = f"{origin}.{alias.name}"
                yield whole if whole in MODULES else origin


def part(module: str) -> str:
    """What of its package a module belongs to: `urlink.protocol.enums` to `interfaces`."""
    return [*module.split("."), ""][1]


def within(module: str, package: str) -> bool:
    return module == package or module.startswith(f"{package}.")


def test_the_imports_are_read() -> None:
    """Of one module of each way to import, so that the rules below are not true of nothing."""
    assert {"linkcore", "urlink"} <= {module.partition(".")[0] for module in MODULES}
    assert {"functools", "linkcore.errors", "linkcore.streaming.stream"} <= imports("linkcore.recording.recorder")
    simulator = imports("urlink.simulator.controller")
    assert {"urlink.arm.models", "urlink.protocol.firmware", "urlink.simulator.server"} <= simulator
    decoder = imports("urlink.protocol.primary.decoder")
    assert {"urlink.protocol.headers", "urlink.protocol.enums"} <= decoder
    assert "urlink.protocol.decoding" in imports("urlink")


def offenders(is_wrong: Callable[[str, str], bool]) -> list[str]:
    """ "module imports name", for each such pair that is wrong."""
    return [f"{module} imports {name}" for module in MODULES for name in imports(module) if is_wrong(module, name)]


#: Names that several modules of one package have, which then play the same role, each in its folder.
ROLES = {
    "arm": "one arm: how its joints and its tool are related, and how it moves in the simulator",
    "client": "what users hold of one interface",
    "commands": "the table of what can be said to a controller in one language",
    "errors": "the exceptions of its folder",
    "framing": "the frame boundaries of one interface",
    "gripper": "the simulated gripper, and the interface that serves it",
    "interface": "what the interfaces of one folder have in common",
    "messages": "the messages to a program on the robot, and those that a simulated controller sends",
    "interpreter": "interpreter mode: what users hold, and the interface that serves it",
    "packets": "the declared packets of one interface",
    "protocol": "the protocol of one interface",
    "registers": "the general-purpose registers: what users hold, and the simulated ones",
    "robot_api": "the Robot API of PolyScope X: its requests, and the interface that answers them",
    "server": "what is served to TCP clients",
    "tool_serial": "the serial line of the tool: what users hold, and the interface that serves it",
    "waypoints": "a motion that is given point by point, and the text of its program",
    "force_control": "the motions that control forces, and the texts of their programs",
}


def test_a_module_name_means_one_thing_in_a_package() -> None:
    found: dict[tuple[str, str], list[str]] = {}
    for module, path in MODULES.items():
        package, _, name = module.rpartition(".")
        # A command of the command line is called as the user calls it, and the functions of URScript by their topic.
        if path.name != "__init__.py" and part(module) != "cli" and not package.endswith(".builtins"):
            found.setdefault((module.partition(".")[0], name), []).append(module)
    assert [modules for (_, name), modules in found.items() if len(modules) > 1 and name not in ROLES] == []


def test_sockets_are_where_it_is_declared() -> None:
    networks = {"socket", "socketserver"}
    assert offenders(lambda module, name: name in networks and module not in SOCKETS) == []


def test_asyncio_is_where_something_can_be_awaited() -> None:
    found = {module for module in MODULES if "asyncio" in imports(module)}
    assert_listed(found, AWAITED, "AWAITED in tests/test_house.py")


_OF_THREADS = {"Thread", "Timer", "ThreadPoolExecutor", "start_new_thread"}


def starts_threads(text: str) -> bool:
    """It calls what makes a thread, or derives a class from it, under whichever name it was imported."""
    if not any(name in text for name in _OF_THREADS):
        return False
    tree, names = ast.parse(text), set(_OF_THREADS)
    names |= {
        alias.asname
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
        if alias.name in names and alias.asname
    }
    for node in ast.walk(tree):
        used = [node.func] if isinstance(node, ast.Call) else node.bases if isinstance(node, ast.ClassDef) else []
        for each in used:
            if (isinstance(each, ast.Attribute) and each.attr in names) or (
                isinstance(each, ast.Name) and each.id in names
            ):
                return True
    return False


@pytest.mark.parametrize(
    ("text", "starts"),
    [
        ("threading.Thread(target=run).start()", True),
        ("Timer(1.0, run).start()", True),
        ("from threading import Thread as Worker\nWorker(target=run).start()", True),
        ("class Compilation(threading.Thread):\n    pass", True),
        ("class Compilation(Base, Thread):\n    pass", True),
        ("def f():\n    class Inner(threading.Timer):\n        pass", True),
        ("from threading import Thread as Worker\nclass Compilation(Worker):\n    pass", True),
        ("def f(thread: threading.Thread) -> None:\n    thread.join()", False),
        ("class Compilation(Base):\n    pass", False),
    ],
)
def test_whatever_way_a_thread_is_made_is_seen(text: str, starts: bool) -> None:
    assert starts_threads(text) == starts


def test_threads_are_started_where_it_is_declared() -> None:
    found = {module for module in MODULES if starts_threads(source(module))}
    assert_listed(found, THREADS, "THREADS in tests/test_house.py")


def test_what_is_declared_is_there() -> None:
    """A rule about a module that is gone protects nothing."""
    assert MODULES.keys() >= SOCKETS | THREADS
    found = {module for module in MODULES if "socket" in imports(module)}
    assert_listed(found, SOCKETS, "SOCKETS in tests/test_house.py")


#: What to use instead of each function of the standard library that reads a monotonic clock, or sleeps.
ONE_CLOCK = {
    "monotonic": "clock.now()",
    "monotonic_ns": "clock.now()",
    "perf_counter": "clock.now()",
    "perf_counter_ns": "clock.now()",
    "clock_gettime": "clock.now()",
    "clock_gettime_ns": "clock.now()",
    "sleep": "clock.sleep(seconds)",
}


def other_clocks(text: str) -> list[tuple[int, str]]:
    """Lines that use such a function of `time`, or import it by name, and what to use there instead."""
    found = []
    for node in ast.walk(ast.parse(text)) if "time" in text else ():
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "time":
            names = [node.attr]
        elif isinstance(node, ast.ImportFrom) and node.module == "time":
            names = [alias.name for alias in node.names]
        else:
            continue
        found += [(node.lineno, ONE_CLOCK[name]) for name in names if name in ONE_CLOCK]
    return sorted(found)


def test_time_is_read_and_waited_for_by_one_clock() -> None:
    """Only `linkcore.clock` counts the time of a suspend, and can be simulated even where it is a default value."""
    assert other_clocks("def f(c=time.monotonic):\n    time.sleep(1)") == [
        (1, "clock.now()"),
        (2, "clock.sleep(seconds)"),
    ]
    assert other_clocks("from time import monotonic, time") == [(1, "clock.now()")]
    packages = {str(path): path.read_text() for path in (SRC.parent / "packages").glob("*/src/**/*.py")}
    texts = packages | {module: source(module) for module in MODULES}
    wrong = [
        f"{name}, line {line}: use linkcore's {instead} instead (from linkcore import clock)"
        for name, text in texts.items()
        if name != "linkcore.clock" and not name.startswith("linkcore.simulated.")
        for line, instead in other_clocks(text)
    ]
    assert not wrong, "\n".join(wrong)

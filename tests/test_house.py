"""Rules for modules that use sockets, asyncio, threads and clocks. pyproject.toml has the rules for imports."""

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
    "linkcore.net.watching",
    # These modules replace the sockets of the standard library in simulated time.
    "linkcore.simulated.sockets",
    "linkcore.simulated.takeover",
}

#: The only modules that may import `asyncio`.
AWAITED = {
    "linkcore.event_loop",
    "linkcore.net.awaited",
    "linkcore.net.watching",
    "linkcore.aio.async_stream",
    "linkcore.aio.loop_connection",
    "linkcore.aio.packets",
    "urlink.aio.awaited",
    "urlink.aio.async_robot",
    "rhdlink.aio",
}

#: The only modules that may start threads.
THREADS = {
    "linkcore.net.watching",  # waits for the sockets of an event loop that cannot, such as the default loop of Windows
    "linkcore.net.undo",  # undoes abandoned commands, as long as any are pending
    "rhdlink.mqtt.session",  # keeps the robot's master alive, from the first command until the end of the session
    "linkcore.threads",  # one for the callbacks of each robot, one for each host or server with its own thread
    "linkcore.streaming.connection",  # the reader of each stream
    "linkcore.streaming.subscription",  # one for each callback that is not inline, or has a deadline
    "urlink.simulator.server",  # one for each simulated controller
    "urlink.simulator.control_loop",  # advances the time of a stepped controller within a block
    "urlink.simulator.programs.loader",  # one at a time, for a long program
    "rhdlink.sync.sync_thread",  # keeps a robot in sync
    "linkcore.recording.index",  # several, while a long recording is checked
    "linkcore.simulated.primitives",  # threads that a program starts while time is simulated
    "linkcore.simulated.takeover",  # one for each function that is called at a simulated time
    "linkcore.event_loop",  # makes blocking calls for one robot of a program that uses asyncio
    "rhdlink.drive",  # drives a robot between requested motions
    "rhdlink.smrcl.mission",  # runs a mission that was started with `start`
    "linkcore.cli.console",  # on Windows, reads the lines of stdin
    "linkcore.cli.progress",  # draws the progress of a command
    "urlink.cli.monitor",  # identifies the robot while the screen is drawn
}


def name_of(path: Path) -> str:
    return ".".join(path.relative_to(SRC).with_suffix("").parts).removesuffix(".__init__")


MODULES = {name_of(path): path for path in sorted(SRC.rglob("*.py"))}


@cache
def imports(module: str) -> frozenset[str]:
    """Return the full names of all imports of a module, including imports in functions and for type checkers."""
    return frozenset(_imported(_statements(parsed(module)), package_of(module)))


def parsed(module: str) -> ast.Module:
    """Parse a module. The tree is not cached, because a million more objects would slow down garbage collections."""
    return ast.parse(source(module))


@cache
def source(module: str) -> str:
    return MODULES[module].read_text(encoding="utf-8")


def package_of(module: str) -> str:
    return module if MODULES[module].name == "__init__.py" else module.rpartition(".")[0]


def _statements(tree: ast.AST) -> Iterator[ast.stmt]:
    """Yield every statement of a tree, including nested ones."""
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
                # `from . import models` imports a module; `from .models import Model` imports a name of a module.
                whole = f"{origin}.{alias.name}"
                yield whole if whole in MODULES else origin


def part(module: str) -> str:
    """Return the part of its package that a module belongs to: `protocol` for `urlink.protocol.enums`."""
    return [*module.split("."), ""][1]


def within(module: str, package: str) -> bool:
    return module == package or module.startswith(f"{package}.")


def test_imports_finds_each_kind_of_import() -> None:
    """Check one module for each form of import, so that the rules below cannot pass without finding imports."""
    assert {"linkcore", "urlink"} <= {module.partition(".")[0] for module in MODULES}
    assert {"functools", "linkcore.errors", "linkcore.streaming.stream"} <= imports("linkcore.recording.recorder")
    simulator = imports("urlink.simulator.controller")
    assert {"urlink.arm.models", "urlink.protocol.firmware", "urlink.simulator.server"} <= simulator
    decoder = imports("urlink.protocol.primary.decoder")
    assert {"urlink.protocol.headers", "urlink.protocol.enums"} <= decoder
    assert "urlink.protocol.decoding" in imports("urlink")


def offenders(is_wrong: Callable[[str, str], bool]) -> list[str]:
    """Return "module imports name" for each import that violates a rule."""
    return [f"{module} imports {name}" for module in MODULES for name in imports(module) if is_wrong(module, name)]


#: Names that several modules of one package may share, because each plays the same role in its folder.
ROLES = {
    "arm": "one arm: its kinematics, and its motion in the simulator",
    "client": "the object that users get for one interface",
    "commands": "the table of the commands to a controller in one language",
    "errors": "the exceptions of its folder",
    "framing": "the frame boundaries of one interface",
    "gripper": "the simulated gripper, and the interface that serves it",
    "interface": "the common part of the interfaces of one folder",
    "messages": "the messages to a program on the robot, and the messages that a simulated controller sends",
    "interpreter": "interpreter mode: the object that users get, and the interface that serves it",
    "packets": "the declared packets of one interface",
    "protocol": "the protocol of one interface",
    "registers": "the general-purpose registers: the object that users get, and the simulated registers",
    "robot_api": "the Robot API of PolyScope X: its requests, and the interface that answers them",
    "server": "the server for TCP clients",
    "tool_serial": "the serial line of the tool: the object that users get, and the interface that serves it",
    "waypoints": "a motion that is given point by point, and the text of its program",
    "force_control": "the motions that control forces, and the texts of their programs",
}


def test_module_names_are_unique_within_a_package() -> None:
    found: dict[tuple[str, str], list[str]] = {}
    for module, path in MODULES.items():
        package, _, name = module.rpartition(".")
        # Modules of the command line have the names of commands; modules of URScript functions have topics as names.
        if path.name != "__init__.py" and part(module) != "cli" and not package.endswith(".builtins"):
            found.setdefault((module.partition(".")[0], name), []).append(module)
    assert [modules for (_, name), modules in found.items() if len(modules) > 1 and name not in ROLES] == []


def test_sockets_are_imported_by_listed_modules_only() -> None:
    networks = {"socket", "socketserver"}
    assert offenders(lambda module, name: name in networks and module not in SOCKETS) == []


def test_asyncio_is_imported_by_listed_modules_only() -> None:
    found = {module for module in MODULES if "asyncio" in imports(module)}
    assert_listed(found, AWAITED, "AWAITED in tests/test_house.py")


_OF_THREADS = {"Thread", "Timer", "ThreadPoolExecutor", "start_new_thread"}


def starts_threads(text: str) -> bool:
    """Whether the code makes a thread or derives a class from one, even if it was imported under another name."""
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
def test_starts_threads_finds_each_way_to_make_a_thread(text: str, starts: bool) -> None:
    assert starts_threads(text) == starts


def test_threads_are_started_by_listed_modules_only() -> None:
    found = {module for module in MODULES if starts_threads(source(module))}
    assert_listed(found, THREADS, "THREADS in tests/test_house.py")


def test_listed_modules_exist() -> None:
    """A rule about a module that no longer exists has no effect."""
    assert MODULES.keys() >= SOCKETS | THREADS
    found = {module for module in MODULES if "socket" in imports(module)}
    assert_listed(found, SOCKETS, "SOCKETS in tests/test_house.py")


#: Replacement for each function of the standard library that reads a monotonic clock, or sleeps.
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
    """Return the lines that use or import such a function of `time`, each with its replacement."""
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


def test_modules_use_the_clock_of_linkcore_only() -> None:
    """Only `linkcore.clock` includes the time of a suspend, and can be simulated even as a default value."""
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

"""The rules of the house, read from the imports of every module in src/."""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cache
from pathlib import Path

import pytest

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
    "linkcore.net.recall",  # takes back what was given up, for as long as there is anything
    "linkcore.threads",  # one for the callbacks of each robot, one for each host or server not run in its caller's
    "linkcore.streaming.thread_connection",  # the reader of each stream
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
    "urlink.view.arm_view",  # draws an arm for as long as a notebook shows it
    "linkcore.cli.progress",  # draws the progress of a command
    "urlink.cli.monitor",  # asks who the robot is while the picture is drawn
}

#: Part of a package -> the parts of it that it may import; the parts that are not named may import all but the cli.
BELOW: dict[str, dict[str, set[str]]] = {
    "urlink": {
        "interfaces": {"interfaces", "firmware", "foreign_names", "ports"},
        "foreign_names": {"foreign_names"},
        "ports": {"ports", "firmware"},
        "firmware": {"firmware"},
        "bounds": {"bounds", "parameters", "vectors"},
        "models": {"models", "interfaces", "vectors"},
        "vectors": {"vectors"},
        "rigid": {"rigid", "vectors"},
        "poses": {"poses", "rigid", "vectors"},
        "kinematics": {"kinematics", "bounds", "models", "rigid", "vectors"},
        "parameters": {"parameters"},
        "motors": {"motors", "models", "parameters", "vectors"},
        "dynamics": {"dynamics", "kinematics", "models", "motors", "rigid", "vectors"},
        "urdf": {"urdf", "kinematics", "models", "poses", "rigid"},
        "mjcf": {"mjcf", "dynamics", "kinematics", "models", "motors", "poses", "rigid", "urdf"},
        "errors": {"errors"},
        "urscript": {"urscript", "firmware", "interfaces"},
    },
    "rhdlink": {
        "wire": {"wire"},
        "errors": {"errors"},
        "variables": {"variables", "wire", "errors"},
        "connection": {"wire", "errors"},
        "recording": {"recording", "connection", "variables", "wire"},
        "replica": {"variables", "wire", "errors"},
        "host": {"host", "variables", "wire", "errors", "address"},
        "plugins": {"plugins", "host", "variables", "wire", "recording", "world", "errors"},
        "scene": {"scene", "host"},
        "world": {"world", "scene"},
        "smrcl": {"smrcl", "client", "variables", "host", "world", "errors"},
        "drive": {"drive", "smrcl", "world"},
    },
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


def _statements(tree: ast.AST, *, for_types: bool = True) -> Iterator[ast.stmt]:
    """Every statement in it, wherever; without those after `if TYPE_CHECKING` if not `for_types`."""
    for name in ("body", "orelse", "handlers", "finalbody", "cases"):
        if name == "body" and not for_types and _is_for_types(tree):
            continue
        for each in getattr(tree, name, ()):
            if isinstance(each, ast.stmt):
                yield each
            yield from _statements(each, for_types=for_types)


def _is_for_types(node: ast.AST) -> bool:
    return isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"


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
    """What of its package a module belongs to: `urlink.interfaces.enums` to `interfaces`."""
    return [*module.split("."), ""][1]


def within(module: str, package: str) -> bool:
    return module == package or module.startswith(f"{package}.")


def test_the_imports_are_read() -> None:
    """Of one module of each way to import, so that the rules below are not true of nothing."""
    assert {"linkcore", "urlink"} <= {module.partition(".")[0] for module in MODULES}
    assert {"functools", "linkcore.errors", "linkcore.streaming.stream"} <= imports("linkcore.recording.recorder")
    simulator = imports("urlink.simulator.controller")
    assert {"urlink.models", "urlink.firmware", "urlink.simulator.server"} <= simulator
    decoder = imports("urlink.interfaces.primary.decoder")
    assert {"urlink.interfaces.headers", "urlink.interfaces.enums"} <= decoder
    assert "urlink.decoding" in imports("urlink")


def offenders(is_wrong: Callable[[str, str], bool]) -> list[str]:
    """ "module imports name", for each such pair that is wrong."""
    return [f"{module} imports {name}" for module in MODULES for name in imports(module) if is_wrong(module, name)]


def test_linkcore_knows_no_robot() -> None:
    robots = ("urlink", "rhdlink")
    assert offenders(lambda module, name: within(module, "linkcore") and name.partition(".")[0] in robots) == []


def test_the_two_packages_do_not_know_each_other() -> None:
    others = {"urlink": "rhdlink", "rhdlink": "urlink"}
    assert offenders(lambda module, name: others.get(module.partition(".")[0]) == name.partition(".")[0]) == []


def test_imports_point_downward() -> None:
    def is_wrong(module: str, name: str) -> bool:
        package = module.partition(".")[0]
        allowed = BELOW.get(package, {}).get(part(module))
        return allowed is not None and within(name, package) and part(name) not in allowed

    assert offenders(is_wrong) == []


def test_only_the_command_line_imports_the_command_line() -> None:
    assert offenders(lambda module, name: part(module) != "cli" and name in MODULES and part(name) == "cli") == []


@cache
def runtime_imports(module: str) -> frozenset[str]:
    """The modules that are imported when `module` is, or when something in it is called: not for its types only."""
    if "TYPE_CHECKING" not in source(module):
        return imports(module) & MODULES.keys()
    found = _imported(_statements(parsed(module), for_types=False), package_of(module))
    return frozenset(found) & MODULES.keys()


def circle(graph: Mapping[str, set[str]]) -> list[str]:
    """The names along a circle; nothing if there is none."""
    done: set[str] = set()

    def search(path: list[str]) -> list[str]:
        for name in sorted(graph[path[-1]] - done):
            found = path[path.index(name) :] if name in path else search([*path, name])
            if found:
                return found
        done.add(path[-1])
        return []

    return next((found for name in graph if (found := search([name]))), [])


@pytest.mark.parametrize(
    ("graph", "expected"),
    [
        ({"a": {"b", "c"}, "b": {"c"}, "c": set()}, []),
        ({"a": {"b"}, "b": {"c"}, "c": {"b"}}, ["b", "c"]),
        ({"a": {"b"}, "b": set(), "c": {"d"}, "d": {"e"}, "e": {"c"}}, ["c", "d", "e"]),
    ],
)
def test_a_circle_is_found(graph: dict[str, set[str]], expected: list[str]) -> None:
    assert circle(graph) == expected


@pytest.mark.slow
def test_no_module_imports_itself_by_way_of_others() -> None:
    assert circle({module: set(runtime_imports(module) - {module}) for module in MODULES}) == []


@pytest.mark.parametrize("package", [name for name, path in MODULES.items() if path.name == "__init__.py"])
def test_the_parts_of_a_package_are_in_layers(package: str) -> None:
    """Its folders and modules, of which none needs one above it: not for types either, but between two modules."""
    part_of = {module: module.removeprefix(f"{package}.").partition(".")[0] for module in MODULES}
    inside = [module for module in MODULES if module.startswith(f"{package}.")]
    graph: dict[str, set[str]] = {part_of[module]: set() for module in inside}
    for module in inside:
        is_folder = part_of[module] != module.removeprefix(f"{package}.")
        for name in imports(module) & set(inside):
            if is_folder or part_of[name] != name.removeprefix(f"{package}.") or name in runtime_imports(module):
                graph[part_of[module]].add(part_of[name])
    for name in graph:
        graph[name].discard(name)
    assert circle(graph) == []


#: Names that several modules of one package have, which then play the same role, each in its folder.
ROLES = {
    "arm": "one arm: how its joints and its tool are related, and how it moves in the simulator",
    "client": "what users hold of one interface",
    "commands": "the table of what can be said to a controller in one language",
    "errors": "the exceptions of its folder",
    "framing": "the frame boundaries of one interface",
    "gripper": "the simulated gripper, and the port that serves it",
    "interpreter": "interpreter mode: what users hold, and the port that serves it",
    "packets": "the declared packets of one interface",
    "protocol": "the protocol of one interface",
    "robot_api": "the Robot API of PolyScope X: its requests, and the port that answers them",
    "server": "what is served to TCP clients",
    "waypoints": "a motion that is given point by point, and the text of its program",
    "yielding": "the motions in which the arm yields, and the texts of their programs",
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
    assert {module for module in MODULES if "asyncio" in imports(module)} == AWAITED


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
    assert found == THREADS


def test_what_is_declared_is_there() -> None:
    """A rule about a module that is gone protects nothing."""
    assert MODULES.keys() >= SOCKETS | THREADS
    for package, parts in BELOW.items():
        assert parts.keys() <= {part(module) for module in MODULES if within(module, package)}
    assert {module for module in MODULES if "socket" in imports(module)} == SOCKETS


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
    adapters = {str(path): path.read_text() for path in (SRC.parent / "adapters").glob("*/src/**/*.py")}
    texts = adapters | {module: source(module) for module in MODULES}
    wrong = [
        f"{name}, line {line}: use linkcore's {instead} instead (from linkcore import clock)"
        for name, text in texts.items()
        if name != "linkcore.clock" and not name.startswith("linkcore.simulated.")
        for line, instead in other_clocks(text)
    ]
    assert not wrong, "\n".join(wrong)

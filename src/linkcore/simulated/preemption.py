"""Simulated thread switches between two lines of a program, where no lock, queue, socket or clock is used.

CPython checks whether another thread should run at the beginning of a function, after calls, and when a loop jumps
back. In the simulation, a thread can yield before a line, in functions that the seed selects. Only a few functions are
selected, but threads yield in them often. So a thread that reads a value and then sets it is interrupted in between by
another thread that does the same. Occasionally, the interrupted thread does not run for some milliseconds, as on a busy
computer. In this time, a robot can answer the other thread.

Lines are counted separately for each function. Only statements that every version of Python traces in the same way
count, and only their first lines. Code that runs only once in a process is not counted: imports, and functions whose
results a cache keeps. So a run does not depend on what the process has done before.
"""

from __future__ import annotations

import _thread
import ast
import functools
import math
import random
import sys
from collections.abc import Iterator
from types import CodeType, FrameType, ModuleType

from .scheduler import Scheduler, Tracer

#: Minimum and maximum of the fraction of functions in which threads yield. The seed selects the fraction.
_SHARE = (0.02, 0.5)
#: Minimum and maximum of the mean number of lines between two yields in one function. The mean is selected for each
#: function.
_LINES = (1.0, 50.0)
#: Probability that a yielding thread pauses; minimum and maximum of the pause, in s; maximum sum of all pauses, in s.
_HELD, _HOLD, _ALL_HOLDS = 0.3, (1e-5, 2e-2), 0.3
#: Threads do not yield in functions of these modules or in functions that they call. These modules hold a lock of the
#: interpreter, or run between two steps of the scheduler. Threads do not yield in modules that have a lock since their
#: import either, because this lock is not simulated.
_WHOLE = ("linkcore.simulated", "importlib", "logging", "functools", "weakref", "_pytest")
_LOCKS = (_thread.LockType, _thread.RLock)
#: Functions of these modules read bytes, versions and the clock. Threads share nothing there except results of earlier
#: calls.
_KEEPING = ("linkcore.wire", "linkcore.clock")
#: Locks of the modules that any thread is importing now, by name.
_MODULE_LOCKS: dict[str, object] = vars(sys.modules["_frozen_importlib"])["_module_locks"]
#: First function of each simulated thread; it belongs to `linkcore.simulated`.
_FIRST = "_take_part"
#: Statements whose first line is traced once per execution.
_TRACED = (ast.Assign, ast.AugAssign, ast.AnnAssign, ast.Expr, ast.Return, ast.Raise, ast.Delete, ast.If)


class Preemption:
    """Selector of the lines before which threads yield.

    Args:
        scheduler: Scheduler of the tasks.
        packages: Names of the packages, or modules, whose functions can be selected.
        modules: Modules by name, as in `sys.modules`.
    """

    def __init__(self, scheduler: Scheduler, packages: tuple[str, ...], modules: dict[str, ModuleType]) -> None:
        self._scheduler = scheduler
        self._packages = packages
        self._modules = modules
        self._key = scheduler.random.random()
        low, high = _SHARE
        self._share = low * (high / low) ** scheduler.random.random()
        self._left = _ALL_HOLDS
        # Id of a code object -> the code object, and its trace function; None if no thread yields in it. The code
        # object is stored so that its id stays valid.
        self._known: dict[int, tuple[CodeType, Tracer | None]] = {}
        self._by_name: dict[str, Tracer | None] = {}

    def trace(self, frame: FrameType, event: str, arg: object) -> Tracer | None:
        """Return the trace function for the lines of a function that begins; for `sys.settrace`."""
        known = self._known.get(id(frame.f_code))
        if known is None:
            known = self._known[id(frame.f_code)] = (frame.f_code, self._draw(frame))
        if known[1] is None or is_importing() or any(map(_is_kept, _callers(frame))):
            return None
        return known[1]

    def _draw(self, frame: FrameType) -> Tracer | None:
        module, name = frame.f_globals.get("__name__", ""), frame.f_code.co_name
        # Skip comprehensions, which are functions only in some versions, and `__del__`, which can run at any place.
        is_drawn = _is_of(module, self._packages) and not _is_of(module, _KEEPING)
        if not is_drawn or name.startswith("<") or name == "__del__":
            return None
        key = f"{self._key} {module} {name}"
        if key not in self._by_name:
            chance = random.Random(key)
            self._by_name[key] = self._lines(chance) if chance.random() < self._share else None
        return self._by_name[key]

    def _lines(self, chance: random.Random) -> Tracer:
        """Return a trace function that occasionally switches to another thread, for one name in one module."""
        low, high = _LINES
        mean = low * (high / low) ** chance.random()
        left = [1 + int(chance.expovariate(1.0 / mean))]
        last = [0]

        def trace(frame: FrameType, event: str, arg: object) -> Tracer:
            line = frame.f_lineno
            if event == "return":
                last[0] = 0
            elif event == "exception" and not last[0]:  # resumed by `throw`: since 3.13, its line is traced again
                last[0] = line
            if event != "line" or line == last[0] or line not in _parsed(frame.f_code.co_filename)[0]:
                return trace
            last[0] = line
            left[0] -= 1
            if left[0] <= 0:
                left[0] = 1 + int(chance.expovariate(1.0 / mean))
                self._yield(frame, chance)
            return trace

        return trace

    def _yield(self, frame: FrameType, chance: random.Random) -> None:
        scheduler = self._scheduler
        hold, low, high = chance.random(), *map(math.log, _HOLD)
        seconds = math.exp(low + (high - low) * chance.random())
        if not scheduler.is_between_lines or any(self._is_whole(each) for each in _callers(frame)):
            return
        if hold < _HELD and seconds < self._left:
            self._left -= seconds
            scheduler.wait(scheduler.now + seconds)
        else:
            scheduler.yield_()

    def _is_whole(self, frame: FrameType) -> bool:
        module = frame.f_globals.get("__name__", "")
        if _is_of(module, _WHOLE):
            return frame.f_code.co_name != _FIRST
        return _is_of(module, self._packages) and _has_lock(self._modules.get(module))


def is_importing() -> bool:
    """Whether a module is being imported.

    A run must not depend on whether a module was imported before.
    """
    if not _MODULE_LOCKS:  # the usual case; this runs for each new lock
        return False
    return any(frame.f_code.co_filename.startswith("<frozen importlib") for frame in _callers(sys._getframe()))


def _callers(frame: FrameType | None) -> Iterator[FrameType]:
    while frame is not None:
        yield frame
        frame = frame.f_back


def _is_of(module: str, packages: tuple[str, ...]) -> bool:
    return any(module == each or module.startswith(f"{each}.") for each in packages)


@functools.cache
def _has_lock(module: ModuleType | None) -> bool:
    return module is not None and any(isinstance(value, _LOCKS) for value in list(vars(module).values()))


def _is_kept(frame: FrameType) -> bool:
    """Whether a cache keeps the result of a function, so that it runs only once per process."""
    return frame.f_code.co_firstlineno in _parsed(frame.f_code.co_filename)[1]


@functools.cache
def _parsed(path: str) -> tuple[frozenset[int], frozenset[int]]:
    """Return the first lines of a file's counted statements, and of its functions with a `functools` cache."""
    try:
        with open(path, "rb") as file:
            tree = ast.parse(file.read())
    except (OSError, SyntaxError):
        return frozenset(), frozenset()
    nodes = list(ast.walk(tree))
    counted = frozenset(node.lineno for node in nodes if isinstance(node, _TRACED))
    decorated = (node.decorator_list for node in nodes if isinstance(node, ast.FunctionDef))
    kept = (each for each in decorated if any("cache" in ast.unparse(decorator) for decorator in each))
    return counted, frozenset(each[0].lineno for each in kept)

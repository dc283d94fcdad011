"""Signals between two lines of the library: the handler runs in the thread that executes the lines."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Iterator
from types import FrameType
from typing import Any

from linkcore.simulated.preemption import _callers, _has_lock, _is_kept, _is_of, _parsed, is_importing
from linkcore.simulated.scheduler import current

__all__ = ["signalled"]

#: Modules whose functions run as one step: the simulation itself, and modules that hold a lock of the interpreter.
_WHOLE = ("linkcore.simulated", "importlib", "logging", "functools", "weakref")
_FIRST = "_take_part"


@contextlib.contextmanager
def signalled(packages: tuple[str, ...], lines: int, handler: Callable[[], object]) -> Iterator[None]:
    """Run `handler` in this thread, before the n-th line of these packages that the block executes.

    Lines are counted from the start of the block. The handler may raise, as the handler of SIGINT does, and may wait.
    """
    left = [lines]

    def trace_line(frame: FrameType, event: str, arg: object) -> Any:
        if event != "line" or frame.f_lineno not in _parsed(frame.f_code.co_filename)[0]:
            return trace_line
        left[0] -= 1
        if left[0] <= 0 and _is_between_lines(frame, packages):
            sys.settrace(None)
            for each in _callers(frame):
                each.f_trace = None
            handler()
            return None
        return trace_line

    def trace(frame: FrameType, event: str, arg: object) -> Any:
        module, name = frame.f_globals.get("__name__", ""), frame.f_code.co_name
        is_counted = _is_of(module, packages) and not _is_of(module, _WHOLE) and not name.startswith("<")
        return trace_line if is_counted and name != "__del__" and not is_importing() else None

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        yield
    finally:
        sys.settrace(before)


def _is_between_lines(frame: FrameType, packages: tuple[str, ...]) -> bool:
    """Whether a handler may run here: not in a step of the simulation, an import or a function with a cache."""
    scheduler = current()
    if scheduler is None or not scheduler.is_between_lines or is_importing():
        return False
    for each in _callers(frame):
        module = each.f_globals.get("__name__", "")
        if _is_of(module, _WHOLE) and each.f_code.co_name != _FIRST:
            return False
        if _is_kept(each) or (_is_of(module, packages) and _has_lock(sys.modules.get(module))):
            return False
    return True

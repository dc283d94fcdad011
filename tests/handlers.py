"""Signal handlers between any two lines of a call, without signals: a trace function calls the handler.

CPython runs the handler of a signal in the main thread, between any two of its instructions. The handler must not wait
for something that the interrupted thread has to do first.
"""

from __future__ import annotations

import contextlib
import faulthandler
import io
import os
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType
from typing import Any

import linkcore
from linkcore.simulated.scheduler import installed

#: Folder that the packages are imported from: src, or the folder of the installed packages.
SRC = str(Path(linkcore.__file__).parents[1])
_OURS = tuple(os.path.join(SRC, package, "") for package in ("linkcore", "urlink", "rhdlink"))
#: Modules that run in the process of a simulated robot, and never in the thread of a user.
_ELSEWHERE = tuple(os.path.join(SRC, *part, "") for part in (("linkcore", "simulated"), ("urlink", "simulator")))
#: Time limit for one round, in seconds; a round takes milliseconds.
_DEADLINE = 20.0


class Interruption:
    """Handler that is called once, before the `at`-th line of a call.

    Args:
        at: Number of the line, from 1.

    Attributes:
        where: File and number of the line; None while the handler has not been called.
    """

    def __init__(self, at: int) -> None:
        self.where: str | None = None
        self._left = at
        self._handler: Callable[[], object]
        self._within: str | None

    @contextlib.contextmanager
    def by(self, handler: Callable[[], object], within: str | None = None) -> Iterator[None]:
        """Call the handler in the block, in this thread; lines before the function `within` is called do not count."""
        self._handler, self._within = handler, within
        before = sys.gettrace()
        sys.settrace(self._trace)
        try:
            yield
        finally:
            sys.settrace(before)

    def _trace(self, frame: FrameType, event: str, argument: object) -> Any:
        scheduler = installed[0]
        if scheduler is not None and not scheduler.is_between_lines:
            return None  # this thread does the work of another thread, in which no handler can be called
        file = frame.f_code.co_filename
        # Lines of `threading` count as well, because this library uses its locks. Lines that start a thread do not
        # count, because they wait for the new thread.
        is_ours = file.startswith(_OURS) and not file.startswith(_ELSEWHERE)
        if not is_ours and not (file == threading.__file__ and not isinstance(_self(frame), threading.Thread)):
            return None
        if self._within == frame.f_code.co_name:
            self._within = None
        if event == "line" and self._within is None:
            self._left -= 1
            if not self._left:
                self.where = f"{file.removeprefix(SRC)}:{frame.f_lineno}"
                sys.settrace(None)
                frame.f_trace = None
                self._handler()
                return None
        return self._trace


def _self(frame: FrameType) -> object:
    return frame.f_locals.get("self") if frame.f_code.co_varnames[:1] == ("self",) else None


def at_every_line(
    scenario: Callable[[Interruption], object], *, step: int = 1, first: int = 1, is_threaded: bool = True
) -> int:
    """Run a scenario once for each line where its handler can be called, until no line is left.

    Args:
        scenario: Function that prepares a call, makes it in a block of `Interruption.by`, and checks the result.
        step: Interval between the lines at which the handler is called.
        first: Number of the first line.
        is_threaded: Whether to run each round in a thread with a deadline. Simulated time detects hangs itself.

    Returns:
        Number of rounds in which the handler was called.

    Raises:
        AssertionError: If a round hangs or the scenario raises. The message names the line of the handler.
    """
    count = 0
    while True:
        interruption = Interruption(first + count * step)
        if is_threaded:
            _finish(scenario, interruption)
        else:
            scenario(interruption)
        if interruption.where is None:
            return count
        count += 1


def _finish(scenario: Callable[[Interruption], object], interruption: Interruption) -> None:
    failures: list[BaseException] = []

    def run() -> None:
        try:
            scenario(interruption)
        except BaseException as error:
            failures.append(error)

    thread = threading.Thread(target=run, name="interrupted", daemon=True)
    thread.start()
    thread.join(_DEADLINE)
    if thread.is_alive():
        raise AssertionError(f"a handler at {interruption.where} hangs:\n{_stacks()}")
    for failure in failures:
        raise AssertionError(f"with a handler at {interruption.where}: {failure!r}") from failure


def _stacks() -> str:
    with tempfile.TemporaryFile("w+") as file:
        faulthandler.dump_traceback(file, all_threads=True)
        file.seek(0, io.SEEK_SET)
        return file.read()

"""The end of this process: what it has started on robots is stopped if it ends without closing them.

Three ends can be noticed: the interpreter exits, also because of an exception such as `KeyboardInterrupt`; the process
receives SIGTERM; and a cell of a notebook is interrupted, after which the process continues. SIGKILL, `os._exit` and a
crash of the interpreter cannot be noticed.

The handler of SIGTERM is installed only if nobody else has installed one, and only from the main thread, as Python
requires. After the robots were stopped, the process ends by SIGTERM as it would have without the handler.
"""

from __future__ import annotations

import atexit
import logging
import os
import signal
import sys
import threading
import weakref
from types import FrameType
from typing import Any, Protocol

_log = logging.getLogger(__name__)


class Abandonable(Protocol):
    """Something that has started programs on a robot."""

    def abandon(self, why: str) -> object:
        """Stop what was started; `why` says what has happened to this process. Must not raise `LinkError`."""


_open: weakref.WeakSet[Abandonable] = weakref.WeakSet()
_watched: set[str] = set()


def abandon_at_end(part: Abandonable) -> None:
    """Call `part.abandon` when this process ends, unless `forget` was called or `part` was collected before."""
    _open.add(part)
    if "exit" not in _watched:
        _watched.add("exit")
        atexit.register(_abandon_all, "the interpreter exits")
        if hasattr(os, "register_at_fork"):
            # What the parent has started is not the child's to stop.
            os.register_at_fork(after_in_child=_open.clear)
    if "SIGTERM" not in _watched and threading.current_thread() is threading.main_thread():
        _watched.add("SIGTERM")
        _watch_sigterm()
    if "notebook" not in _watched and "IPython" in sys.modules:
        _watched.add("notebook")
        _watch_notebook()


def forget(part: Abandonable) -> None:
    """Do nothing for `part` when this process ends: it was closed."""
    _open.discard(part)


def _abandon_all(why: str) -> None:
    for part in tuple(_open):
        part.abandon(why)


def _watch_sigterm() -> None:
    if signal.getsignal(signal.SIGTERM) is signal.SIG_DFL:
        try:
            signal.signal(signal.SIGTERM, _on_sigterm)
        except ValueError:  # in a subinterpreter
            _log.info("SIGTERM is not handled: robots that were not closed keep executing their programs")


def _on_sigterm(number: int, frame: FrameType | None) -> None:
    try:
        _abandon_all("the process received SIGTERM")
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        os.kill(os.getpid(), signal.SIGTERM)


def _watch_notebook() -> None:
    shell = sys.modules["IPython"].get_ipython()
    if shell is not None:
        shell.events.register("post_run_cell", _after_cell)


def _after_cell(result: Any) -> None:
    if isinstance(result.error_in_exec, KeyboardInterrupt):
        _abandon_all("the notebook cell was interrupted")

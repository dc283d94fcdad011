"""This process: a forked child of it must not use its connections, and what it has started on robots ends with it.

Three ends of a process can be noticed: the interpreter exits, also because of an exception such as `KeyboardInterrupt`;
the process receives SIGTERM; and a cell of a notebook is interrupted, after which the process continues. SIGKILL,
`os._exit` and a crash of the interpreter cannot be noticed.

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

from .errors import LocalError


class HomeProcess:
    """The process that made something.

    Args:
        name: What it made, for the error message.
    """

    __slots__ = ("_name", "_number")

    def __init__(self, name: str) -> None:
        self._name = name
        self._number = os.getpid()

    @property
    def is_here(self) -> bool:
        """Whether this is that process, and not a forked child."""
        return os.getpid() == self._number

    def check(self) -> None:
        """Reject a use by a forked child.

        Raises:
            LocalError: If this is another process.
        """
        if not self.is_here:
            raise LocalError(f"{self._name} was connected to by the parent process; connect again in this one")


_log = logging.getLogger(__name__)


#: Locks that a forked child finds free, although a thread of the parent might have held them.
_freed: weakref.WeakSet[Any] = weakref.WeakSet()


def free_in_child(lock: Any) -> None:
    """Let a forked child find `lock` free.

    The child has a copy of the lock, but not the thread of the parent that holds it, so nothing would ever release it.

    Args:
        lock: A lock of `threading`. It can be collected.
    """
    _freed.add(lock)


def _free_all() -> None:
    for lock in list(_freed):
        # Python does the same for its own locks. The locks of simulated time have no such method, and no child.
        getattr(lock, "_at_fork_reinit", lambda: None)()


if hasattr(os, "register_at_fork"):  # not on Windows, which cannot fork
    os.register_at_fork(after_in_child=_free_all)


class Abandonable(Protocol):
    """Something that has started programs on a robot."""

    def abandon(self, why: str, is_end: bool) -> object:
        """Stop what was started, and if this is the end of the process, start nothing more. Must not raise `LinkError`.

        Args:
            why: What has happened to this process.
            is_end: Whether this process ends now.
        """


_open: weakref.WeakSet[Abandonable] = weakref.WeakSet()
_watched: set[str] = set()


def abandon_at_end(part: Abandonable) -> None:
    """Call `part.abandon` when this process ends, unless `forget` was called or `part` was collected before."""
    _open.add(part)
    if "exit" not in _watched:
        _watched.add("exit")
        atexit.register(_abandon_all, "the interpreter exits", True)
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


def _abandon_all(why: str, is_end: bool) -> None:
    for part in tuple(_open):
        part.abandon(why, is_end)


def _watch_sigterm() -> None:
    if signal.getsignal(signal.SIGTERM) is signal.SIG_DFL:
        try:
            signal.signal(signal.SIGTERM, _on_sigterm)
        except ValueError:  # in a subinterpreter
            _log.info("SIGTERM is not handled: robots that were not closed keep executing their programs")


def _on_sigterm(number: int, frame: FrameType | None) -> None:
    try:
        _abandon_all("the process received SIGTERM", True)
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        os.kill(os.getpid(), signal.SIGTERM)


def _watch_notebook() -> None:
    shell = sys.modules["IPython"].get_ipython()
    if shell is not None:
        shell.events.register("post_run_cell", _after_cell)


def _after_cell(result: Any) -> None:
    if isinstance(result.error_in_exec, KeyboardInterrupt):
        _abandon_all("the notebook cell was interrupted", False)

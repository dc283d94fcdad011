"""Rules for the end of this process and for its forked children.

A forked child must not use the connections of its parent. When this process ends, the programs that it has started on
robots are stopped. This module detects three events:

- The interpreter exits, even because of an exception such as `KeyboardInterrupt`.
- The process receives SIGTERM.
- A cell of a notebook is interrupted. The process continues in this case.

SIGKILL, `os._exit` and a crash of the interpreter cannot be detected.

The handler of SIGTERM is installed only if the program has no other handler, and only from the main thread, as Python
requires. After the robots were stopped, SIGTERM ends the process as it would have without the handler.
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
    """Process in which an object was created.

    Args:
        name: Name of the object, used in the error message.
    """

    __slots__ = ("_name", "_number")

    def __init__(self, name: str) -> None:
        self._name = name
        self._number = os.getpid()

    @property
    def is_here(self) -> bool:
        """Whether the current process has created the object; False in a forked child of that process."""
        return os.getpid() == self._number

    def check(self) -> None:
        """Reject the use of the object by a forked child.

        Raises:
            LocalError: If the current process did not create the object.
        """
        if not self.is_here:
            raise LocalError(f"{self._name} was connected by the parent process; connect again in this process")


_log = logging.getLogger(__name__)


#: Locks that are released in a forked child, although a thread of the parent might have held them.
_freed: weakref.WeakSet[Any] = weakref.WeakSet()


def free_in_child(lock: Any) -> None:
    """Release `lock` in each forked child.

    The child has a copy of the lock, but not the thread of the parent that holds it, so nothing would ever release it.

    Args:
        lock: Lock from `threading`. Only a weak reference to it is kept.
    """
    _freed.add(lock)


def _free_all() -> None:
    for lock in list(_freed):
        # Python does the same for its own locks. The locks of simulated time have no such method, but a process in
        # simulated time has no children either.
        getattr(lock, "_at_fork_reinit", lambda: None)()


if hasattr(os, "register_at_fork"):  # not on Windows, which cannot fork
    os.register_at_fork(after_in_child=_free_all)


class Abandonable(Protocol):
    """Object that has started programs on a robot."""

    def abandon(self, why: str, is_end: bool) -> object:
        """Stop the started programs, and if the process ends, start nothing more.

        Must not raise `LinkError`.

        Args:
            why: Event that has happened to this process, for messages.
            is_end: Whether this process ends now.
        """


#: `id` -> object to abandon. A dictionary is used because a WeakSet cannot be copied while another thread changes it.
_open: weakref.WeakValueDictionary[int, Abandonable] = weakref.WeakValueDictionary()
#: Name of each ending that is watched -> mark of the call that began to watch it.
_watched: dict[str, object] = {}


def _is_first(what: str) -> bool:
    """Whether this is the first call for `what`, in one step for threads and signal handlers."""
    mark = object()
    return _watched.setdefault(what, mark) is mark


def abandon_at_end(part: Abandonable) -> None:
    """Call `part.abandon` when this process ends, unless `forget` was called or `part` was collected before."""
    _open[id(part)] = part
    if _is_first("exit"):
        atexit.register(_abandon_all, "the interpreter exits", True)
        if hasattr(os, "register_at_fork"):
            # A child must not stop the programs that its parent has started.
            os.register_at_fork(after_in_child=_open.clear)
    if threading.current_thread() is threading.main_thread() and _is_first("SIGTERM"):
        _watch_sigterm()
    if "IPython" in sys.modules and _is_first("notebook"):
        _watch_notebook()


def forget(part: Abandonable) -> None:
    """Do not call `part.abandon` when this process ends, because `part` was closed."""
    _open.pop(id(part), None)


def _abandon_all(why: str, is_end: bool) -> None:
    # `valuerefs` copies the references in one step. `values` would fail if another thread adds a part meanwhile.
    for reference in _open.valuerefs():
        part = reference()
        if part is not None:
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

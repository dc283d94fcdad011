"""Commands that were given up before they were answered, and may still be carried out: they are taken back.

A peer that hangs has the bytes of a command already, and carries it out when it goes on, long after the call has
failed. What has an opposite, as `play` has `stop`, can be taken back then: at the first contact, and before a newer
command is sent. A thread tries that for as long as something is pending, always on a connection of its own. It sends
the opposite only after the peer has answered a question, so that nothing of this waits at a peer that hangs.
"""

from __future__ import annotations

import contextlib
import logging
import threading
import time
from collections.abc import Callable, Iterator

from ..errors import Closed, LinkError, LinkTimeout, LocalError
from ..threads import started

__all__ = ["MAY_STILL", "Recall", "TakeBack"]

#: How the error of a command ends that was sent and not answered.
MAY_STILL = "it may still be carried out"
#: Seconds between two attempts, where one fails at once: at first, and at most.
_PAUSE, _LONGEST = 0.1, 2.0
#: Seconds between two looks whether it has been taken back.
_POLL = 0.02

#: Makes contact with the peer, and takes the command back if the argument, called then, says that it still is to be.
#: Raises `LinkError` if that cannot be done now.
TakeBack = Callable[[Callable[[], bool]], object]

_log = logging.getLogger(__name__)


class Recall:
    """The commands to one peer that were given up and are to be taken back.

    Args:
        name: of the peer, for messages.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._pending: dict[str, TakeBack] = {}
        self._thread: threading.Thread | None = None
        self._lock = threading.RLock()  # a signal handler may give up another one
        self._closed = threading.Event()

    @property
    def pending(self) -> tuple[str, ...]:
        """The names of the commands that may still be carried out, and have not been taken back."""
        return tuple(self._pending)

    @contextlib.contextmanager
    def command(self, name: str, timeout: float, take_back: TakeBack | None = None) -> Iterator[Callable[[], None]]:
        """Around a command: those of this peer that were given up are taken back before it is sent.

        Args:
            name: of the command; one that is answered supersedes an earlier one of its name.
            timeout: seconds for that.
            take_back: takes it back if it is given up; None where it cannot be taken back.

        Yields:
            what to call if it was sent, and given up.

        Raises:
            LinkTimeout: an earlier command could not be taken back; nothing was sent.
        """
        if not self.settle(timeout):
            before = ", ".join(map(repr, self.pending))
            raise LinkTimeout(
                f"{self._name}: {name!r} was not sent: {before} was given up before, {MAY_STILL}, and could not be "
                f"taken back within {timeout:g} s"
            )
        yield lambda: None if take_back is None else self._add(name, take_back)
        self._pending.pop(name, None)

    def settle(self, timeout: float) -> bool:
        """Wait until nothing is pending; False if that takes longer."""
        until = time.monotonic() + timeout
        while self._pending and not self._closed.is_set():
            thread = self._thread
            if thread is None or thread is threading.current_thread() or time.monotonic() >= until:
                return False
            thread.join(_POLL)
        return True

    def drop(self) -> None:
        """Something newer has been sent that supersedes all of it."""
        self._pending.clear()

    def close(self) -> None:
        """Take back nothing more; an attempt under way ends by its own time-out. Idempotent."""
        self._closed.set()
        self._pending.clear()

    def _add(self, name: str, take_back: TakeBack) -> None:
        with self._lock:
            if self._closed.is_set():
                return
            self._pending[name] = take_back
            _log.warning("%s: %r was given up; %s, and is taken back at the next contact", self._name, name, MAY_STILL)
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name=f"{self._name} take back", daemon=True)
                try:
                    started(self._thread)
                except LocalError:
                    self._thread = None
                    _log.exception("%s: %r is not taken back", self._name, name)

    def _run(self) -> None:
        pause = _PAUSE
        while True:
            with self._lock:
                if not self._pending:
                    self._thread = None
                    return
            for name, take_back in tuple(self._pending.items()):
                self._try(name, take_back)
            if self._pending:
                self._closed.wait(pause)
                pause = min(2.0 * pause, _LONGEST)

    def _try(self, name: str, take_back: TakeBack) -> None:
        def is_wanted() -> bool:
            return self._pending.get(name) is take_back

        try:
            take_back(is_wanted)
        except Closed:
            return
        except LinkError as error:
            _log.info("%s: %r cannot be taken back yet: %s", self._name, name, error)
            return
        if is_wanted():
            self._pending.pop(name, None)
            _log.warning("%s: %r, which was given up, was taken back", self._name, name)

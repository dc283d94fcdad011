"""Undoing commands that were abandoned before they were answered, and might still be executed.

A peer that hangs has the bytes of a command already, and carries it out when it goes on, long after the call has
failed. What has an opposite, as `play` has `stop`, can be undone then: at the first contact, and before a newer
command is sent. A thread tries that for as long as something is pending, always on a connection of its own. It sends
the opposite only after the peer has answered a question, so that nothing of this waits at a peer that hangs.

What is pending belongs to the peer, and not to the object that gave it up: it is kept for the life of the process. No
thread is left once the last who uses the peer has closed. Who uses it next begins with undoing it.
"""

from __future__ import annotations

import contextlib
import logging
import os
import threading
import weakref
from collections.abc import Callable, Hashable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any, Generic, Protocol, TypeVar

from .. import clock
from ..errors import Closed, LinkError, LinkTimeout, LocalError
from ..pending_call import on_give_up
from ..threads import ReentrantEvent, started

#: How the error of a command ends that was sent and not answered.
MAY_STILL = "it may still be carried out"
#: Seconds between two attempts: at first, and at most. It grows where they fail at once. One that lasts longer has met
#: a peer that hangs; when that goes on, the next attempt is to be under way.
_PAUSE, _LONGEST = 0.1, 2.0
#: Seconds between two looks whether it has been undone.
_POLL = 0.02

_log = logging.getLogger(__name__)


class _Closeable(Protocol):
    def close(self) -> None: ...


C = TypeVar("C", bound=_Closeable)


@dataclass(frozen=True, eq=False)
class Undo(Generic[C]):
    """How a command is undone. It outlives who gave the command, and should refer to nothing of theirs.

    Attributes:
        client: makes what talks to the peer, which connects when it is used; closed after each attempt.
        execute: makes contact by it, and undoes the command if the second argument, called then, is still True.
            Raises `LinkError` if that cannot be done now.
    """

    client: Callable[[], C]
    execute: Callable[[C, Callable[[], bool]], object]


class PendingUndos:
    """The commands to one peer that were given up and are to be undone.

    Args:
        name: of the peer, for messages.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._pending: dict[str, Undo[Any]] = {}
        #: the last command of each name that was answered and can be undone
        self._answered: weakref.WeakValueDictionary[str, Undo[Any]] = weakref.WeakValueDictionary()
        self._thread: threading.Thread | None = None
        self._client: _Closeable | None = None
        self._lock = threading.RLock()  # a signal handler may give up another one
        self._closed = ReentrantEvent()
        #: who uses it; None for one that belongs to whoever made it, and is forgotten when it is closed
        self._users: weakref.WeakSet[object] | None = None

    @classmethod
    def of(cls, peer: Hashable, name: str, user: object, *parts: Hashable) -> PendingUndos:
        """That of a peer, the same one for as long as this process lives; what is pending is undone from now on.

        Args:
            peer: what identifies it.
            name: of the peer, for messages.
            user: who uses it, and closes it.
            parts: what identifies each of its services. Who uses one alone gives that as the peer.
        """
        keys = [(os.getpid(), each) for each in (peer, *parts)]
        with _registry:
            known = [undos for undos in map(_known.get, keys) if undos is not None]
            undos = known[0] if known else cls(name)
            if undos._users is None:
                undos._users = weakref.WeakSet()
            for key in keys:
                _known.setdefault(key, undos)
        for other in known[1:]:
            if other is not undos:
                undos._take_over(other)
        # Without the lock of the module, which is a real one in simulated time too: others must not wait for it.
        with undos._lock:
            assert undos._users is not None
            undos._users.add(user)
            undos._closed.clear()
            undos._start()
        return undos

    @staticmethod
    def is_owed(*peers: Hashable) -> bool:
        """Whether something is to be undone at one of the peers."""
        known = (_known.get((os.getpid(), peer)) for peer in peers)
        return any(undos is not None and bool(undos._pending) for undos in known)

    @property
    def pending(self) -> tuple[str, ...]:
        """The names of the commands that may still be carried out, and have not been undone."""
        return tuple(self._pending)

    @contextlib.contextmanager
    def command(self, name: str, timeout: float, undo: Undo[Any] | None = None) -> Iterator[Callable[[], None]]:
        """Around a command: those of this peer that were given up are undone before it is sent.

        Args:
            name: of the command; one that is answered supersedes an earlier one of its name.
            timeout: seconds for that.
            undo: undoes it if it is given up; None where it cannot be undone.

        Yields:
            what to call if it was sent, and given up.

        Raises:
            LinkTimeout: an earlier command could not be undone; nothing was sent.
        """
        if not self.settle(timeout):
            before = ", ".join(map(repr, self.pending))
            raise LinkTimeout(
                f"{self._name}: {name!r} was not sent: {before} was given up before, {MAY_STILL}, and could not be "
                f"undone within {timeout:g} s"
            )
        yield lambda: None if undo is None else self._add(name, undo)
        self._remove(name)
        if undo is not None:
            # The task that awaits this call might have been cancelled in the moment in which the answer came.
            self._answered[name] = undo
            on_give_up(partial(self._add_answered, name, undo))

    def settle(self, timeout: float) -> bool:
        """Wait until nothing is pending; False if that takes longer."""
        until = clock.now() + timeout
        while self._pending and not self._closed.is_set():
            thread = self._thread
            if thread is None or thread is threading.current_thread() or clock.now() >= until:
                return False
            clock.join(thread, _POLL)
        return True

    def drop(self) -> None:
        """Something newer has been sent that supersedes all of it."""
        self._answered.clear()
        self._remove(*self._pending)

    def close(self, user: object = None) -> None:
        """Undo nothing more; an attempt under way is broken off. Idempotent.

        Args:
            user: who closes it. What is pending is kept for the next user, and the others go on.
        """
        with self._lock:
            if self._users is None:
                self.drop()
            else:
                self._users.discard(user)
                if self._users:
                    return
            self._closed.set()
            client = self._client
        if client is not None:
            client.close()

    def _take_over(self, other: PendingUndos) -> None:
        """Have what is pending there, unless somebody uses it, who goes on with it."""
        with other._lock:
            if other._users:
                return
            pending = dict(other._pending)
            other.drop()
        with self._lock:
            self._pending = {**pending, **self._pending}
            if self._pending:
                _owed.add(self)

    def _add(self, name: str, undo: Undo[Any]) -> None:
        with self._lock:
            if self._users is None and self._closed.is_set():
                return
            self._pending[name] = undo
            if self._users is not None:
                _owed.add(self)
            _log.warning("%s: %r was given up; %s, and is undone at the next contact", self._name, name, MAY_STILL)
            self._start()

    def _add_answered(self, name: str, undo: Undo[Any]) -> None:
        """Add a command that was answered, unless a newer one has superseded it."""
        if self._answered.get(name) is undo:
            self._add(name, undo)
            if self._thread is None and name in self._pending:  # no thread could be started, and this one may wait
                self._try(name, undo)

    def _remove(self, *names: str) -> None:
        with self._lock:
            for name in names:
                self._pending.pop(name, None)
            if not self._pending:
                _owed.discard(self)

    def _start(self) -> None:
        """Start the thread if there is something for it. With the lock."""
        if self._thread is not None or not self._pending or self._closed.is_set():
            return
        self._thread = threading.Thread(target=self._run, name=f"{self._name} undo", daemon=True)
        try:
            started(self._thread)
        except LocalError:
            self._thread = None
            _log.exception("%s: %s is not undone", self._name, ", ".join(map(repr, self._pending)))

    def _run(self) -> None:
        pause = _PAUSE
        while True:
            with self._lock:
                if not self._pending or self._closed.is_set():
                    self._thread = None
                    return
            began = clock.now()
            for name, undo in tuple(self._pending.items()):
                self._try(name, undo)
            if self._pending:
                if clock.now() - began > _PAUSE:
                    pause = _PAUSE
                clock.wait(self._closed.wait, pause)
                pause = min(2.0 * pause, _LONGEST)

    def _try(self, name: str, undo: Undo[Any]) -> None:
        def is_wanted() -> bool:
            return self._pending.get(name) is undo

        client = undo.client()
        with self._lock:
            if self._closed.is_set():
                return
            self._client = client
        try:
            undo.execute(client, is_wanted)
        except Closed:
            return
        except LinkError as error:
            _log.info("%s: %r cannot be undone yet: %s", self._name, name, error)
            return
        finally:
            self._client = None
            client.close()
        if is_wanted():
            self._remove(name)
            _log.warning("%s: %r, which was given up, was undone", self._name, name)


#: Held while `PendingUndos.of` looks a peer up.
_registry = threading.RLock()
#: The peers that are used or owe something, by the process, since a forked one owes nothing; those that owe something.
_known: weakref.WeakValueDictionary[tuple[int, Hashable], PendingUndos] = weakref.WeakValueDictionary()
_owed: set[PendingUndos] = set()

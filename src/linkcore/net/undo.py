"""Undoing of commands that were abandoned before the peer answered. The peer might still execute such a command.

If a peer hangs, it might already have received the bytes of a command. It then executes the command when it resumes,
long after the call has failed. If the command has an opposite, such as `stop` for `play`, the command can be undone at
the first contact, before a newer command is sent. A thread tries this for as long as an undo is pending, with a new
connection for each attempt. The thread sends the opposite command only after the peer has answered a question, so that
no bytes of the undo are queued at a hung peer.

Pending undos belong to the peer, not to the object that has abandoned the command. They are kept until the process
ends. When the last object that uses the peer is closed, the thread ends. The next object that uses the peer first
undoes the pending commands.
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

#: End of the error of a command that was sent and not answered.
MAY_STILL = "it might still be executed"
#: Initial and longest time between two attempts, in s. The time grows if attempts fail at once. An attempt that lasts
#: longer shows that the peer hangs. In this case the next attempt starts soon, so that it is already running when the
#: peer resumes.
_PAUSE, _LONGEST = 0.1, 2.0
#: Interval in s at which to check whether the commands were undone.
_POLL = 0.02

_log = logging.getLogger(__name__)


class _Closeable(Protocol):
    def close(self) -> None: ...


C = TypeVar("C", bound=_Closeable)


@dataclass(frozen=True, eq=False)
class Undo(Generic[C]):
    """Functions that undo a command.

    The functions exist longer than the object that has sent the command, so they should not refer to this object.

    Attributes:
        client: Function that returns a new client of the peer. The client connects when it is used, and is closed after
            each attempt.
        execute: Function that contacts the peer through the client, and undoes the command if its second argument,
            called after the contact, still returns True. Raises `LinkError` if the command cannot be undone now.
    """

    client: Callable[[], C]
    execute: Callable[[C, Callable[[], bool]], object]


class PendingUndos:
    """Pending undos of one peer: abandoned commands that must be undone.

    Args:
        name: Name of the peer, used in messages.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._pending: dict[str, Undo[Any]] = {}
        #: Name -> the last command of this name that was answered and can be undone.
        self._answered: weakref.WeakValueDictionary[str, Undo[Any]] = weakref.WeakValueDictionary()
        self._thread: threading.Thread | None = None
        self._client: _Closeable | None = None
        self._lock = threading.RLock()  # re-entrant, because a signal handler may abandon another command
        self._closed = ReentrantEvent()
        #: Objects that use the peer. None if this object was not made by `of`; its undos are then forgotten when it is
        #: closed.
        self._users: weakref.WeakSet[object] | None = None

    @classmethod
    def of(cls, peer: Hashable, name: str, user: object, *parts: Hashable) -> PendingUndos:
        """Return the object for a peer, and start to undo pending commands.

        There is only one such object for each peer until this process ends.

        Args:
            peer: Key of the peer.
            name: Name of the peer, used in messages.
            user: Object that uses the peer, and that calls `close` later.
            parts: Keys of the services of the peer. A user of a single service passes its key as `peer`.
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
        # The lock of the module is released first. It is a real lock even in simulated time, so no simulated thread may
        # wait for it.
        with undos._lock:
            assert undos._users is not None
            undos._users.add(user)
            undos._closed.clear()
            undos._start()
        return undos

    @staticmethod
    def is_owed(*peers: Hashable) -> bool:
        """Whether a command to one of the peers must be undone."""
        known = (_known.get((os.getpid(), peer)) for peer in peers)
        return any(undos is not None and bool(undos._pending) for undos in known)

    @property
    def pending(self) -> tuple[str, ...]:
        """Names of the commands that might still be executed, and have not been undone."""
        return (*self._pending,)

    @contextlib.contextmanager
    def command(self, name: str, timeout: float, undo: Undo[Any] | None = None) -> Iterator[Callable[[], None]]:
        """Context for sending a command. Before the block begins, the abandoned commands to this peer are undone.

        Args:
            name: Name of the command. An answered command replaces earlier ones of the same name.
            timeout: Maximum time for undoing the earlier commands, in s.
            undo: Undo of the command if it is abandoned; None if it cannot be undone.

        Yields:
            Function to call if the command was sent, and then abandoned.

        Raises:
            LinkTimeout: If an earlier command cannot be undone. Nothing is sent.
        """
        if not self.settle(timeout):
            before = ", ".join(map(repr, self.pending))
            raise LinkTimeout(
                f"{self._name}: {name!r} was not sent, because the abandoned command {before} might still be executed "
                f"and could not be undone within {timeout:g} s"
            )
        yield lambda: None if undo is None else self._add(name, undo)
        self._remove(name)
        if undo is not None:
            # The task that awaits this call might have been cancelled at the moment when the answer arrived.
            self._answered[name] = undo
            on_give_up(partial(self._add_answered, name, undo))

    def settle(self, timeout: float) -> bool:
        """Wait until no undo is pending; return False if this takes longer than `timeout` seconds."""
        until = clock.now() + timeout
        while self._pending and not self._closed.is_set():
            thread = self._thread
            if thread is None or thread is threading.current_thread() or clock.now() >= until:
                return False
            clock.join(thread, _POLL)
        return True

    def drop(self) -> None:
        """Forget all pending undos, because a newer command has replaced the abandoned ones."""
        self._answered.clear()
        self._remove(*self.pending)  # a copy: another thread might add a command

    def close(self, user: object = None) -> None:
        """Stop undoing, and abort a running attempt. Idempotent.

        Args:
            user: Object that no longer uses the peer. If other objects use it, the attempts continue. Pending undos are
                kept for the next object.
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
        """Take the pending undos of another object, unless it still has users, which undo them themselves."""
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
            message = "%s: %r was abandoned; %s, and will be undone at the next contact"
            _log.warning(message, self._name, name, MAY_STILL)
            self._start()

    def _add_answered(self, name: str, undo: Undo[Any]) -> None:
        """Add a command that was answered, unless a newer one has replaced it."""
        if self._answered.get(name) is undo:
            self._add(name, undo)
            if self._thread is None and name in self._pending:  # no other thread could be started; this one may wait
                self._try(name, undo)

    def _remove(self, *names: str) -> None:
        with self._lock:
            for name in names:
                self._pending.pop(name, None)
            if not self._pending:
                _owed.discard(self)

    def _start(self) -> None:
        """Start the thread if an undo is pending. The caller holds the lock."""
        if self._thread is not None or not self._pending or self._closed.is_set():
            return
        self._thread = threading.Thread(target=self._run, name=f"{self._name} undo", daemon=True)
        try:
            started(self._thread)
        except LocalError:
            self._thread = None
            _log.exception("%s: cannot undo %s", self._name, ", ".join(map(repr, self._pending)))

    def _run(self) -> None:
        pause = _PAUSE
        while True:
            with self._lock:
                if not self._pending or self._closed.is_set():
                    self._thread = None
                    return
            began = clock.now()
            for name, undo in list(self._pending.items()):
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
            _log.warning("%s: the abandoned command %r was undone", self._name, name)


#: Lock that is held while `PendingUndos.of` searches for a peer.
_registry = threading.RLock()
#: (process, peer) -> its object, for peers with users or pending undos. A forked process has no pending undos.
_known: weakref.WeakValueDictionary[tuple[int, Hashable], PendingUndos] = weakref.WeakValueDictionary()
#: Objects with pending undos, which must not be garbage-collected.
_owed: set[PendingUndos] = set()

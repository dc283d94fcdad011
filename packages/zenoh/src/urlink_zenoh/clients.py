"""Clients that are connected, and their motions: a motion ends when the client that started it is lost."""

from __future__ import annotations

import threading
from collections.abc import Callable

import zenoh

from linkcore import clock
from urlink import LocalError, Motion

from .keys import check_name

__all__ = ["Clients"]

#: Maximum delay, in s, of the token of a new client after its first command.
_ANNOUNCED = 1.0


class Clients:
    """Clients of one robot, detected by their liveliness tokens.

    A token disappears when the client undeclares it or closes its session, when its process ends, or when a router
    between it and this server ends. In a silent network, it disappears when Zenoh's lease expires (default 10 s).

    Args:
        session: Session that observes the tokens.
        key: First part of the keys of the tokens.
        on_lost: Callback for a lost client with an unfinished motion, called with both.
    """

    def __init__(self, session: zenoh.Session, key: str, on_lost: Callable[[str, Motion], object]) -> None:
        self._key = key
        self._on_lost = on_lost
        self._changed = threading.Condition()
        self._alive: set[str] = set()
        #: the unfinished motion, and the id of its client
        self._motion: tuple[str, Motion] | None = None
        self._subscriber = session.liveliness().declare_subscriber(f"{key}/*", self._heard, history=True)

    def begin(self, client: str | None, command: Callable[[], Motion]) -> Motion:
        """Execute a command of a client, and remember that the motion belongs to this client.

        Raises:
            LocalError: If the client does not exist, or a motion of another client has not ended.
            BadValue: If `client` is not a valid name.
            LinkError: If the command raises it.
        """
        if client is None:
            raise LocalError("a motion needs a client with a liveliness token; pass its id as the parameter `client`")
        check_name(client)
        self._await(client)
        with self._changed:
            held = self._motion
        if held is not None and held[0] != client and not held[1].done:
            raise LocalError(f"client {held[0]} is moving the arm ({held[1].name}); another client cannot preempt it")
        motion = command()
        with self._changed:
            self._motion = (client, motion)
            is_alive = client in self._alive
        if not is_alive:
            self._lose(client)
        return motion

    @property
    def current(self) -> tuple[str, Motion] | None:
        """The unfinished motion and the id of its client; None if there is none."""
        with self._changed:
            return None if self._motion is None or self._motion[1].done else self._motion

    def close(self) -> None:
        """Cancel the current motion, and stop watching the tokens."""
        self._subscriber.undeclare()
        held = self.current
        if held is not None:
            held[1].cancel()

    def _await(self, client: str) -> None:
        until = clock.now() + _ANNOUNCED
        with self._changed:
            while client not in self._alive:
                if not clock.wait(self._changed.wait, until - clock.now()) and client not in self._alive:
                    raise LocalError(f"client {client} is not alive; expected a token {self._key}/{client}")

    def _heard(self, sample: zenoh.Sample) -> None:
        client = str(sample.key_expr).rpartition("/")[2]
        with self._changed:
            if sample.kind == zenoh.SampleKind.PUT:
                self._alive.add(client)
                self._changed.notify_all()
                return
            self._alive.discard(client)
        self._lose(client)

    def _lose(self, client: str) -> None:
        held = self.current
        if held is not None and held[0] == client:
            self._on_lost(client, held[1])

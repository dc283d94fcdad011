"""Which clients are there, and what each of them has begun: a motion ends with the client that asked for it."""

from __future__ import annotations

import threading
from collections.abc import Callable

import zenoh

from linkcore import clock
from urlink import LocalError, Motion

from .keys import check_name

__all__ = ["Clients"]

#: Seconds that the token of a new client may take longer than its first command.
_ANNOUNCED = 1.0


class Clients:
    """The clients of one robot, by their liveliness tokens.

    A token goes when the client undeclares it or closes its session, when its process dies, when a router between it
    and this server dies, and, where a network falls silent, when Zenoh's lease is over (10 s, if not configured).

    Args:
        session: by which they are seen.
        key: what their tokens begin with.
        on_lost: called with the motion that a lost client leaves behind.
    """

    def __init__(self, session: zenoh.Session, key: str, on_lost: Callable[[str, Motion], object]) -> None:
        self._key = key
        self._on_lost = on_lost
        self._changed = threading.Condition()
        self._alive: set[str] = set()
        #: the motion that is not over, and whose it is
        self._motion: tuple[str, Motion] | None = None
        self._subscriber = session.liveliness().declare_subscriber(f"{key}/*", self._heard, history=True)

    def begin(self, client: str | None, command: Callable[[], Motion]) -> Motion:
        """Carry out a command of a client, whose the motion is from then on.

        Raises:
            LocalError: there is no such client, or a motion of another one is not over.
            BadValue: `client` is no name.
            LinkError: whatever the command raises.
        """
        if client is None:
            raise LocalError("a motion needs a client that is seen to be alive: its id as the parameter `client`")
        check_name(client)
        self._await(client)
        with self._changed:
            held = self._motion
        if held is not None and held[0] != client and not held[1].done:
            raise LocalError(f"client {held[0]} moves the arm ({held[1].name}); it is not preempted by another")
        motion = command()
        with self._changed:
            self._motion = (client, motion)
            is_alive = client in self._alive
        if not is_alive:
            self._lose(client)
        return motion

    @property
    def current(self) -> tuple[str, Motion] | None:
        """The motion that is not over, and the client whose it is."""
        with self._changed:
            return None if self._motion is None or self._motion[1].done else self._motion

    def close(self) -> None:
        """End all motions, and look no more."""
        self._subscriber.undeclare()
        held = self.current
        if held is not None:
            held[1].cancel()

    def _await(self, client: str) -> None:
        until = clock.now() + _ANNOUNCED
        with self._changed:
            while client not in self._alive:
                if not clock.wait(self._changed.wait, until - clock.now()) and client not in self._alive:
                    raise LocalError(
                        f"no client is alive that is called {client}; expected a token {self._key}/{client}"
                    )

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

"""Question and answer over TCP, a line or so each, on a connection that is made when it is needed.

An answer does not say which question it belongs to: only the order tells. So threads take turns, and a
connection on which an exchange failed is closed, since a late answer on it would be taken for the answer to the next
question. The next one begins on a new connection. A question that may have reached the peer is never asked again.

A signal handler that asks while its own thread waits for an answer uses a connection of its own.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Protocol

from .. import clock
from ..errors import Cancelled, Closed, ConnectionLost, LinkTimeout, WrongPeer
from ..pending_call import interruptible
from ..threads import held
from .transport import TcpTransport
from .undo import MAY_STILL


class DialogueProtocol(Protocol):
    """One connection, sans-IO; a new one for each connection."""

    @property
    def is_greeted(self) -> bool:
        """The greeting of the peer has been received, so that something can be asked."""

    @property
    def is_in_step(self) -> bool:
        """Greeted, nothing asked that was not answered, and nothing received that was not asked for."""

    @property
    def settling(self) -> float | None:
        """Seconds without more after which what has come is the answer; None where its end can be seen."""

    def ask(self, text: str) -> bytes:
        """The bytes that ask."""

    def feed(self, data: bytes) -> str | None:
        """The answer, once it is whole. No bytes are fed where nothing more has come for `settling`."""


class Dialogue:
    """Asks one peer, which threads may share.

    Args:
        transport: of the connection.
        protocol: makes the protocol of one connection.
        name: of the peer, for messages.
        timeout: seconds for a connection to be made.

    Attributes:
        is_closed: `close` was called.
    """

    def __init__(
        self, transport: TcpTransport, protocol: Callable[[], DialogueProtocol], name: str, timeout: float
    ) -> None:
        self.is_closed = False
        self._transport = transport
        self._make = protocol
        self._name = name
        self._timeout = timeout
        self._lock = threading.RLock()
        self._asker: int | None = None  # the thread that waits for an answer
        self._protocol: DialogueProtocol | None = None

    def ask(
        self,
        text: str,
        timeout: float,
        stays: Callable[[str], bool] = lambda answer: True,
        gate: Callable[[Callable[[], object]], object] = lambda send: send(),
        given_up: Callable[[], object] | None = None,
    ) -> str:
        """Ask, and wait for the answer.

        Args:
            text: the question.
            timeout: seconds for all of it.
            stays: says by the answer whether the connection is kept.
            gate: calls what sends, which does not wait, or raises what keeps the question from being sent.
            given_up: called where it was sent, and its answer did not come; the error then says that it may still be
                carried out. None for a question that changes nothing.

        Raises:
            LinkTimeout: no answer came in time, or other threads had their turn for so long.
            ConnectFailed, ConnectionLost: the peer is not there, or went away.
            Closed: `close` was called.
            Cancelled: the task that awaits this call was cancelled.
            LinkError: whatever the protocol or the gate raises.
        """
        if self._asker == threading.get_ident():
            # A signal handler, and the thread that it keeps waits for an answer on the connection.
            return self._ask_beside(text, timeout, gate, given_up)
        until = clock.now() + timeout
        busy = f"{self._name}: {text!r} was not sent, since for {timeout:g} s another thread waited for its own reply"
        is_sent, answer = False, None

        def send() -> None:
            nonlocal is_sent
            data = protocol.ask(text)
            # All of it at once: a peer that has answered every question has room for the next.
            if self._transport.send_some(data) < len(data):
                raise LinkTimeout(f"{self._name} does not take {text[:80]!r}")
            is_sent = True

        with held(self._lock, timeout, busy):
            try:
                self._asker = threading.get_ident()
                with interruptible(self._transport.abort):
                    protocol = self._connected(min(until, clock.now() + self._timeout))
                    gate(send)
                    while answer is None:
                        answer = protocol.feed(
                            self._received(protocol, until, f"no reply to {text!r} within {timeout:g} s")
                        )
                if not stays(answer):
                    self._disconnect()
            except BaseException as error:
                self._disconnect()
                hint = ""
                if given_up is not None and is_sent and (answer is None or isinstance(error, Cancelled)):
                    given_up()
                    hint = f"; {MAY_STILL}"
                if self.is_closed and isinstance(error, ConnectionLost):
                    raise Closed(f"{self._name} was closed while {text!r} waited{hint}") from error
                if isinstance(error, (ConnectionLost, LinkTimeout, WrongPeer)):
                    error.args = (f"{error}{hint}",)
                raise
            finally:
                self._asker = None
        return answer

    @property
    def is_busy(self) -> bool:
        """Whether a thread waits for an answer."""
        return self._asker is not None

    def _ask_beside(
        self,
        text: str,
        timeout: float,
        gate: Callable[[Callable[[], object]], object],
        given_up: Callable[[], object] | None,
    ) -> str:
        """Ask on a new connection, which is closed afterwards."""
        if self.is_closed:
            raise Closed(f"{self._name} was closed")
        beside = Dialogue(self._transport.another(), self._make, self._name, self._timeout)
        try:
            return beside.ask(text, timeout, gate=gate, given_up=given_up)
        finally:
            beside.close()

    def close(self) -> None:
        """Disconnect for good; what waits in another thread ends with `Closed`. Idempotent."""
        self.is_closed = True
        self._transport.close()

    def _connected(self, until: float) -> DialogueProtocol:
        """The protocol of a connection on which nothing is under way; a new one if need be."""
        if self._protocol is not None and not self._is_in_step(self._protocol):
            self._disconnect()
        if self._protocol is None:
            if self.is_closed:
                raise Closed(f"{self._name} was closed")
            protocol = self._make()
            self._transport.open(clock.left(until))
            if self.is_closed:
                raise ConnectionLost(f"{self._name} was closed here")
            while not protocol.is_greeted:
                protocol.feed(self._received(protocol, until, "no greeting came"))
            self._protocol = protocol
        return self._protocol

    def _is_in_step(self, protocol: DialogueProtocol) -> bool:
        """Nothing has been sent yet, so a connection that was lost, or on which something came unasked, can be left."""
        try:
            return self._transport.receive_waiting() is None and protocol.is_in_step
        except ConnectionLost:
            return False

    def _received(self, protocol: DialogueProtocol, until: float, otherwise: str) -> bytes:
        left, settling = until - clock.now(), protocol.settling
        try:
            if left > 0:
                return self._transport.receive(left if settling is None else min(left, settling))[0]
        except LinkTimeout:
            if settling is not None:
                return b""
        raise LinkTimeout(f"{self._name}: {otherwise}")

    def _disconnect(self) -> None:
        self._protocol = None
        self._transport.close()

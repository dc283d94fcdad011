"""Short questions and answers over TCP, such as single lines. The connection is made when it is needed.

An answer does not name its question, so only the order shows which answer belongs to which question. Therefore threads
take turns. After a failed
exchange the connection is closed, because a late answer would be mistaken for the answer to the next question. The next
question uses a new connection. A question that might have reached the peer is never asked again.

If a signal handler asks while the interrupted thread waits for an answer, the handler uses a separate connection.
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
    """Protocol of one connection, without sockets (sans-IO). Each connection has a new protocol object."""

    @property
    def is_greeted(self) -> bool:
        """Whether the greeting of the peer was received, so that a question can be asked."""

    @property
    def is_in_step(self) -> bool:
        """Whether the greeting was received, every question was answered, and nothing else was received."""

    @property
    def settling(self) -> float | None:
        """Seconds without further bytes after which an answer is complete.

        It is None if the answer itself shows where it ends.
        """

    def ask(self, text: str) -> bytes:
        """Return the bytes of a question."""

    def feed(self, data: bytes) -> str | None:
        """Return the answer when it is complete.

        `data` is empty if nothing has arrived for `settling` seconds.
        """


class Dialogue:
    """Dialogue with one peer. Several threads may use the same object.

    Args:
        transport: Transport of the connection.
        protocol: Function that returns a new protocol for each connection.
        name: Name of the peer, used in messages.
        timeout: Maximum time for connecting, in s.

    Attributes:
        is_closed: Whether `close` was called.
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
        self._asker: int | None = None  # the thread that is waiting for an answer
        self._protocol: DialogueProtocol | None = None

    def ask(
        self,
        text: str,
        timeout: float,
        stays: Callable[[str], bool] = lambda answer: True,
        gate: Callable[[Callable[[], object]], object] = lambda send: send(),
        given_up: Callable[[], object] | None = None,
    ) -> str:
        """Send a question, and wait for the answer.

        Args:
            text: Question.
            timeout: Maximum time for the whole exchange, in s.
            stays: Function that gets the answer, and returns whether the connection stays open.
            gate: Function that gets a function and calls it; this call sends the question, and does not wait. The gate
                can raise an error instead, so that the question is not sent.
            given_up: Function that is called if the question was sent, but no answer was received. The error then
                states that the question might still be executed. None for a question that changes nothing.

        Raises:
            LinkTimeout: If no answer arrives in time, or other threads use the connection for longer than `timeout`.
            ConnectFailed, ConnectionLost: If the peer cannot be reached, or disconnects.
            Closed: If `close` was called.
            Cancelled: If the task that awaits this call was cancelled.
            LinkError: If the protocol or the gate raises it.
        """
        if self._asker == threading.get_ident():
            # This is a signal handler, and the interrupted thread is waiting for an answer on the connection.
            return self._ask_beside(text, timeout, gate, given_up)
        until = clock.now() + timeout
        busy = f"{self._name}: {text!r} was not sent, because another thread was waiting for a reply for {timeout:g} s"
        is_sent, answer = False, None

        def send() -> None:
            nonlocal is_sent
            data = protocol.ask(text)
            # The whole question can be sent at once: a peer that has answered every question has room for the next.
            if self._transport.send_some(data) < len(data):
                raise LinkTimeout(f"{self._name} did not accept {text[:80]!r}")
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
                    raise Closed(f"{self._name} was closed while {text!r} was waiting for a reply{hint}") from error
                if isinstance(error, (ConnectionLost, LinkTimeout, WrongPeer)):
                    error.args = (f"{error}{hint}",)
                raise
            finally:
                self._asker = None
        return answer

    @property
    def is_busy(self) -> bool:
        """Whether a thread is waiting for an answer."""
        return self._asker is not None

    def _ask_beside(
        self,
        text: str,
        timeout: float,
        gate: Callable[[Callable[[], object]], object],
        given_up: Callable[[], object] | None,
    ) -> str:
        """Send a question over a separate new connection, and close this connection afterwards."""
        if self.is_closed:
            raise Closed(f"{self._name} was closed")
        beside = Dialogue(self._transport.another(), self._make, self._name, self._timeout)
        try:
            return beside.ask(text, timeout, gate=gate, given_up=given_up)
        finally:
            beside.close()

    def close(self) -> None:
        """Disconnect permanently. If another thread is waiting for an answer, its call raises `Closed`.

        Idempotent.
        """
        self.is_closed = True
        self._transport.close()

    def _connected(self, until: float) -> DialogueProtocol:
        """Return the protocol of an idle connection; make a new connection if necessary."""
        if self._protocol is not None and not self._is_in_step(self._protocol):
            self._disconnect()
        if self._protocol is None:
            if self.is_closed:
                raise Closed(f"{self._name} was closed")
            protocol = self._make()
            self._transport.open(clock.left(until))
            if self.is_closed:
                raise ConnectionLost(f"{self._name} was closed by this program")
            while not protocol.is_greeted:
                protocol.feed(self._received(protocol, until, "no greeting was received"))
            self._protocol = protocol
        return self._protocol

    def _is_in_step(self, protocol: DialogueProtocol) -> bool:
        """Whether the connection is open and idle, so that a question can be sent on it.

        If the connection was lost, or if the peer has sent something without a question, a new connection can replace
        it, because no part of the next question has been sent yet.
        """
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

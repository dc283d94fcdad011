"""Claims of RTDE inputs on demand, for the registers of `robot.registers` and for the settings of a robot.

An input belongs to one client at a time, and most other clients fail if an input is in use. A register stays claimed.
Inputs for settings are released after a burst of settings, so that another client can claim them.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from typing import Any

from linkcore import clock
from linkcore.deferred import LONGEST_BATCH
from linkcore.errors import Closed, ConnectionLost, LinkTimeout
from linkcore.streaming.connection import Connection
from linkcore.streaming.connection_life import ConnectionState
from linkcore.streaming.packet_queue import block
from linkcore.threads import acquired, alone, is_mine

from ..protocol.rtde.packets import InputsReply, InputsRequest, PauseRequest, StartRequest, join_names
from ..protocol.rtde.protocol import Requests, claim_of
from ..protocol.rtde.recipes import Outputs, Recipe
from ..protocol.rtde.transport import RtdeTransport
from .inputs import checked, dialogue_of, put_whole

#: Maximum time for connecting and claiming, in seconds. In a local network, it takes a few cycles of the controller.
CLAIM_TIMEOUT = 0.25
#: Time from the last setting until all inputs are released, in seconds.
HOLD = 2.0
#: Packages per second while inputs are claimed. The first one completes the connection; each one checks `HOLD`.
_HEARTBEAT = 50.0


class Claims:
    """Connection for claiming sets of inputs when they are needed.

    Args:
        connection: Connection that sends the requests of `plan`.
        transport: Transport of the connection.
        plan: Requests that are repeated after a reconnect.
        timeout: Maximum time until the controller answers a claim, in seconds.

    Attributes:
        connection: See the argument `connection`.
    """

    def __init__(self, connection: Connection, transport: RtdeTransport, plan: Requests, timeout: float) -> None:
        self.connection = connection
        self._transport = transport
        self._plan = plan
        self._timeout = timeout
        self._lock = threading.RLock()  # one claim at a time, because a reply does not identify its request

    @property
    def is_over(self) -> bool:
        """Whether these claims were closed."""
        return self.connection.is_over

    def write(self, values: Mapping[str, Any]) -> None:
        """Write a set of inputs in one package, and claim the set first if necessary.

        Raises:
            BadValue: If a variable cannot have this value. Nothing is sent.
            InputInUse: If another client holds an input.
            NoSuchVariable: If the controller does not have a variable.
            RemoteError, Closed: If there is no connection, or no answer arrives in time.
        """
        self.claim(tuple(values))
        self.connection.send(self._package(values), self._timeout)

    def put(self, values: Mapping[str, Any]) -> None:
        """Write a claimed set of inputs, without waiting.

        Raises:
            BadValue: If a variable cannot have this value. Nothing is sent.
            ConnectionLost: If there is no connection, or the controller does not read. In the second case, the
                connection is aborted.
            Closed: If these claims were closed.
        """
        put_whole(self.connection, self._package(values))

    def has(self, names: tuple[str, ...]) -> bool:
        """Whether this set is claimed on the current connection."""
        return self.connection.state is ConnectionState.CONNECTED and names in self._plan.inputs

    def claim(self, names: tuple[str, ...]) -> None:
        """Claim a set of inputs, unless it is claimed already.

        Raises:
            InputInUse, NoSuchVariable, RemoteError, Closed: See `write`.
        """
        self.connection.start()
        # `alone`, because a signal handler can run this while the interrupted main thread is waiting for a reply.
        otherwise = f"{self.connection.name}: another claim was not answered within {self._timeout:g} s"
        with alone(self._lock, self._timeout, otherwise):
            dialogue = dialogue_of(self.connection, self._transport)
            if names in self._plan.inputs:
                return
            recipe = self._claim(names)
            if self._transport.dialogue is not dialogue:
                raise ConnectionLost(f"{self.connection.name}: the connection was lost while claiming {names}")
            dialogue.claims.append(recipe)
            self._plan.inputs.append(names)

    def _package(self, values: Mapping[str, Any]) -> bytes:
        claims = dialogue_of(self.connection, self._transport).claims
        recipe = claims[self._plan.inputs.index(tuple(values))]
        return recipe.encode(
            {name: checked(name, type, values[name]) for name, type in zip(recipe.names, recipe.types, strict=True)}
        )

    def _claim(self, names: tuple[str, ...]) -> Recipe:
        until = clock.now() + self._timeout
        connection = self.connection
        queue = connection.open_queue(InputsReply, block)
        reply = None
        try:
            # Pause the data, because the vendor requires this before a recipe is changed.
            requests = (PauseRequest(), InputsRequest(names=join_names(names)), StartRequest())
            connection.send(b"".join(map(bytes, requests)), self._timeout)
            reply = queue.next(clock.left(until))
        finally:
            connection.close_queue(queue)
            if reply is None:
                connection.abort()  # otherwise a late reply would be taken as the reply to the next claim
        if reply is None:
            raise LinkTimeout(
                f"{connection.name}: the claim of {', '.join(names)} was not answered within {self._timeout:g} s"
            )
        return claim_of(names, reply)

    def close(self, timeout: float) -> None:
        """Disconnect, which releases the inputs. Idempotent."""
        self.connection.close(timeout)


class BriefClaims:
    """Short claims of one robot, on one connection that exists only as long as the claims.

    Args:
        connect: Function that makes the connection and the claims of a plan. A lost connection does not reconnect.
    """

    def __init__(self, connect: Callable[[Requests], Claims]) -> None:
        self._connect = connect
        self._lock = threading.RLock()  # one claim at a time
        # Replaced as a whole, so that releasing needs no lock.
        self._standing: Claims | None = None
        self._used = 0.0
        self._is_closed = False

    def claim(self, names: tuple[str, ...], *, wait: bool) -> Callable[[Mapping[str, Any]], None] | None:
        """Return a function that writes these inputs without waiting, masks included; None if a wait is necessary.

        Args:
            names: Names of the inputs.
            wait: Whether to wait until the inputs are claimed, for at most `CLAIM_TIMEOUT`. If False, the result is
                None unless they are claimed already.

        Raises:
            InputInUse, NoSuchVariable: If the inputs cannot be claimed.
            LinkError: If RTDE is not available.
        """
        self._used = clock.now()
        # In a signal handler, the interrupted thread might hold the lock, so waiting for the lock would never end.
        if is_mine(self._lock):
            return None
        with acquired(self._lock, CLAIM_TIMEOUT if wait else 0.0) as is_held:
            if not is_held:
                return None
            claims = self._standing
            if claims is not None and (claims.is_over or claims.connection.failure is not None):
                claims = self._standing = None
            if wait:
                if claims is None:
                    claims = self._open(names)
                claims.claim(names)
            elif claims is None or not claims.has(names):
                return None
        return claims.put

    def _open(self, names: tuple[str, ...]) -> Claims:
        """Open a new connection, whose first claim has these names."""
        claims = self._connect(Requests(("timestamp",), _HEARTBEAT, inputs=[names]))
        connection = claims.connection

        def is_held(longer: float = 0.0) -> bool:
            return clock.now() + longer - self._used <= HOLD

        def look(state: Outputs) -> None:
            if not is_held():
                self.give_back()

        self._standing = claims  # before connecting, so that closing the robot also ends the attempt
        try:
            if self._is_closed:
                raise Closed(f"{connection.name} was closed")
            connection.subscribe_inline(Outputs, look, only_changes=lambda: is_held(LONGEST_BATCH))
        except BaseException:
            self.abort()  # in a delayed process, the connection might still be established
            raise
        return claims

    def give_back(self, timeout: float = 1.0) -> None:
        """Disconnect in an orderly way, so that written values arrive. Callable from any thread; idempotent."""
        standing, self._standing = self._standing, None
        if standing is not None:
            standing.close(timeout)

    def abort(self) -> None:
        """Disconnect, and discard values that have not arrived."""
        standing, self._standing = self._standing, None
        if standing is not None:
            standing.connection.abandon()

    def close(self, timeout: float) -> None:
        """Release all inputs permanently. Idempotent."""
        self._is_closed = True
        self.give_back(timeout)

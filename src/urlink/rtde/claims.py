"""Inputs that are claimed when they are needed: for the registers of `robot.registers`, and for a robot's settings.

An input belongs to one client at a time, and most other clients fail where one is taken. A register stays claimed; for
settings, nothing is held for longer than a burst of them: whoever asks later gets it.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from typing import Any

from linkcore import clock
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

#: Seconds that connecting and claiming may take. In a local network it is a few cycles of the controller.
CLAIM_TIMEOUT = 0.25
#: Seconds after the last setting at which everything is given back.
HOLD = 2.0
#: Packages a second meanwhile. The first of them ends connecting, and each is an occasion to give back.
_HEARTBEAT = 50.0


class Claims:
    """A connection on which sets of inputs are claimed as they are needed.

    Args:
        connection: of the plan, which it gives whoever reads it.
        transport: of the connection.
        plan: what is asked for again when the connection has to be made again.
        timeout: seconds for a claim to be answered.
    """

    def __init__(self, connection: Connection, transport: RtdeTransport, plan: Requests, timeout: float) -> None:
        self._connection = connection
        self._transport = transport
        self._plan = plan
        self._timeout = timeout
        self._lock = threading.RLock()  # one claim at a time, since a reply does not say what it answers

    @property
    def is_over(self) -> bool:
        """It was closed."""
        return self._connection.is_over

    def write(self, values: Mapping[str, Any]) -> None:
        """Write a set of inputs in one package, and claim it first where that has not been done.

        Raises:
            BadValue: a variable cannot have this value; nothing was sent.
            InputInUse, NoSuchVariable: another client has one, or the controller lacks it.
            RemoteError, Closed: there is no connection, or nothing was answered in time.
        """
        self.claim(tuple(values))
        self._connection.send(self._package(values), self._timeout)

    def put(self, values: Mapping[str, Any]) -> None:
        """Write a set that has been claimed, without waiting.

        Raises:
            BadValue: a variable cannot have this value; nothing was sent.
            ConnectionLost: there is no connection, or the controller does not read; it is given up then.
            Closed: it was closed.
        """
        put_whole(self._connection, self._package(values))

    def has(self, names: tuple[str, ...]) -> bool:
        """This set is claimed on the present connection."""
        return self._connection.state is ConnectionState.CONNECTED and names in self._plan.inputs

    def claim(self, names: tuple[str, ...]) -> None:
        """Claim a set of inputs where that has not been done.

        Raises:
            InputInUse, NoSuchVariable, RemoteError, Closed: as `write`.
        """
        self._connection.start()
        # Alone: a signal handler may come here while the main thread, which it keeps, waits for a reply.
        otherwise = f"{self._connection.name}: another claim is not answered yet, after {self._timeout:g} s"
        with alone(self._lock, self._timeout, otherwise):
            dialogue = dialogue_of(self._connection, self._transport)
            if names in self._plan.inputs:
                return
            recipe = self._claim(names)
            if self._transport.dialogue is not dialogue:
                raise ConnectionLost(f"{self._connection.name}: the connection was lost while {names} were claimed")
            dialogue.claims.append(recipe)
            self._plan.inputs.append(names)

    def _package(self, values: Mapping[str, Any]) -> bytes:
        claims = dialogue_of(self._connection, self._transport).claims
        recipe = claims[self._plan.inputs.index(tuple(values))]
        return recipe.encode(
            {name: checked(name, type, values[name]) for name, type in zip(recipe.names, recipe.types, strict=True)}
        )

    def _claim(self, names: tuple[str, ...]) -> Recipe:
        until = clock.now() + self._timeout
        connection = self._connection
        queue = connection.open_queue(InputsReply, block)
        reply = None
        try:
            # Data is paused meanwhile, as the vendor asks for before a recipe is changed.
            requests = (PauseRequest(), InputsRequest(names=join_names(names)), StartRequest())
            connection.send(b"".join(map(bytes, requests)), self._timeout)
            reply = queue.next(clock.left(until))
        finally:
            connection.close_queue(queue)
            if reply is None:
                connection.abort()  # a reply that comes late would be taken for that to the next claim
        if reply is None:
            raise LinkTimeout(
                f"{connection.name}: the claim of {', '.join(names)} was not answered within {self._timeout:g} s"
            )
        return claim_of(names, reply)

    def close(self, timeout: float) -> None:
        """Disconnect, which releases the inputs. Idempotent."""
        self._connection.close(timeout)


class BriefClaims:
    """Claims of one robot, on one connection that is there as long as they are.

    Args:
        connect: makes the connection and the claims of a plan; the connection is not kept up when it is lost.
    """

    def __init__(self, connect: Callable[[Requests], Claims]) -> None:
        self._connect = connect
        self._lock = threading.RLock()  # one claim at a time
        #: replaced as a whole, so that whoever gives back needs no lock
        self._standing: Claims | None = None
        self._used = 0.0
        self._is_closed = False

    def claim(self, names: tuple[str, ...], *, wait: bool) -> Callable[[Mapping[str, Any]], None] | None:
        """What writes these inputs, masks included, without waiting; None where that would have to be waited for.

        Args:
            names: of the inputs.
            wait: until they are claimed, `CLAIM_TIMEOUT` at most; otherwise they have to be.

        Raises:
            InputInUse, NoSuchVariable: they cannot be had.
            LinkError: RTDE cannot be had.
        """
        self._used = clock.now()
        # In a signal handler, who has the lock waits for this very call to end.
        if is_mine(self._lock):
            return None
        with acquired(self._lock, CLAIM_TIMEOUT if wait else 0.0) as is_held:
            if not is_held:
                return None
            claims = self._standing
            if claims is not None and (claims.is_over or claims._connection.failure is not None):
                claims = self._standing = None
            if wait:
                if claims is None:
                    claims = self._open(names)
                claims.claim(names)
            elif claims is None or not claims.has(names):
                return None
        return claims.put

    def _open(self, names: tuple[str, ...]) -> Claims:
        """Claims on a new connection, which begins with these."""
        claims = self._connect(Requests(("timestamp",), _HEARTBEAT, inputs=[names]))
        connection = claims._connection

        def look(state: Outputs) -> None:
            if clock.now() - self._used > HOLD:
                self.give_back()

        self._standing = claims  # before it connects: whoever closes the robot meanwhile ends that too
        try:
            if self._is_closed:
                raise Closed(f"{connection.name} was closed")
            connection.subscribe_inline(Outputs, look)
        except BaseException:
            self.abort()  # in a process that was held up, it may come up yet
            raise
        return claims

    def give_back(self, timeout: float = 1.0) -> None:
        """Disconnect, in good order: what was written arrives. From any thread; idempotent."""
        standing, self._standing = self._standing, None
        if standing is not None:
            standing.close(timeout)

    def abort(self) -> None:
        """Disconnect, and discard what has not arrived."""
        standing, self._standing = self._standing, None
        if standing is not None:
            standing._connection.abandon()

    def close(self, timeout: float) -> None:
        """Give everything back, for good. Idempotent."""
        self._is_closed = True
        self.give_back(timeout)

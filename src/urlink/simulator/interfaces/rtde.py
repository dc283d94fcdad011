"""RTDE interface, port 30004. Many clients can read and write variables by name, each with its own recipes.

See docs/protocols/rtde.md. The following is known from the vendor's documents, and from clients that run against real
controllers:

- Spaces around names are ignored, and so is a trailing comma. The reply contains NOT_FOUND instead of a type for an
  unknown name, and IN_USE for an input that another client has claimed. A recipe with such a name is rejected: its
  number in the reply is 0. With protocol 1, the reply has no number, so only the words show the rejection.
- There are floor(rate / frequency) cycles from one output package to the next. A second output recipe replaces the
  first.
- Input recipes are numbered from 1 in the order of the requests, and rejected requests count too. A public client
  relies on this numbering. The maximum number is 255.
- Data packages from clients are accepted even before a start, and without an output recipe. If a package is longer than
  its recipe, the additional bytes are ignored. Other invalid packages are ignored.
- If a client does not read, the controller drops data packages instead of queuing them, and finally closes the
  connection.

Assumptions:

- Requests with a wrong size or an unknown type get no reply. Text messages get no reply either.
- If the size field of a package is smaller than the size of a header, the connection is closed.
- A change of the protocol version deletes the output recipe.
- A recipe is rejected if it has no names, too many bytes of names, or a frequency of zero or less.
- A client that does not read for `UNREAD` seconds is disconnected.
"""

from __future__ import annotations

import logging
import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from linkcore.deferred import SteadyBytes
from linkcore.errors import PacketError
from linkcore.wire.fields import Since
from linkcore.wire.packet import State
from urlink.protocol.rtde.packets import (
    HEADER,
    ControllerVersionReply,
    ControllerVersionRequest,
    DataPackage,
    InputsReply,
    InputsRequest,
    MessageLevel,
    OutputsReply,
    OutputsRequest,
    PauseReply,
    PauseRequest,
    Protocol,
    ProtocolReply,
    ProtocolRequest,
    RtdeMessage,
    StartReply,
    StartRequest,
    decode_request,
    join_names,
    split_names,
)
from urlink.protocol.rtde.recipes import MOST_RECIPES, Recipe
from urlink.protocol.rtde.variables import IN_USE, INPUTS, NOT_FOUND, OUTPUTS, Variable

from ..registers import FIELDBUSES
from ..robot.sensors import Samples
from ..rtde_variables import OUTPUT_VALUES, timestamp_at, write_inputs
from ..state import ControllerState
from .interface import BatchClient, Form, Interface, InterfaceClient, InterfaceReceiver

_log = logging.getLogger("urlink.simulator")

#: First firmware with RTDE. Different sources name 3.2, 3.3 or 3.4; the oldest variables are from 3.3.
SINCE = Since("3.3/5.0")
#: Data packages per second with protocol 1.
RATE_1 = 125
#: Lowest frequency that is used, in Hz: one data package per year. Lower requested frequencies are raised to this
#: value.
LEAST_FREQUENCY = 3e-8
#: Sender that the simulator's text messages show.
SOURCE = "simulator"
#: Maximum number of bytes that the names in one request have (vendor's documents).
MOST_NAMES = 2048
#: Time in seconds after which a client is disconnected if all of its data packages are dropped.
UNREAD = 2.0


@dataclass
class Disturbance:
    """Current faults of the RTDE interface; see `urlink.simulator.Faults`.

    Attributes:
        hello: Text message that is sent at the beginning of each connection; "" for no message.
        protocols: Accepted protocol versions.
        text_before: Type of a request -> text message that is sent before each reply to such a request.
        data_before_start: Whether a data package is sent before each reply to a start request.
        instead: Type of a request -> function that is called once, instead of replying to the next request of this
            type.
        refuses_start: Whether start requests are rejected.
        sends_no_data: Whether data packages are suppressed, although a start request was accepted.
        late: Delay of data packages, in cycles.
        stale: Number of cycles for which the inputs of an ended connection stay claimed.
    """

    hello: str = ""
    protocols: tuple[int, ...] = (1, 2)
    text_before: dict[int, str] = field(default_factory=dict)
    data_before_start: bool = False
    instead: dict[int, Callable[[RtdeSession], object]] = field(default_factory=dict)
    refuses_start: bool = False
    sends_no_data: bool = False
    late: int = 0
    stale: int = 0


class RtdeInterface(Interface):
    """RTDE interface of one controller.

    Args:
        state: State of the controller.
        on_text: Function that is called with each text message of a client.

    Attributes:
        disturbance: Current faults.
        sessions: Current connections.
    """

    def __init__(self, state: ControllerState, on_text: Callable[[str], object]) -> None:
        self._state = state
        self.disturbance = Disturbance()
        self.sessions: list[RtdeSession] = []
        self._on_text = on_text

    def is_offered(self) -> bool:
        return self._state.firmware in SINCE

    def greeting(self) -> list[bytes]:
        hello = self.disturbance.hello
        return [_text(1, hello, level=MessageLevel.WARNING)] if hello else []

    def next_cycle(self, cycle: int) -> int | None:
        wanted = [session.next_cycle(cycle) for session in self.sessions if session.is_started]
        return min(wanted, default=None)

    def packets(self, cycle: int) -> list[bytes]:
        """Send each client the outputs of its own recipe. Return no packets, because none is for all clients."""
        for session in list(self.sessions):
            session.advance(cycle)
        return []

    def last_ahead(self, cycle: int, last: int, clients: Sequence[BatchClient]) -> int:
        for client in clients:
            if isinstance(client.receiver, RtdeSession):
                last = min(last, client.receiver.last_ahead(cycle, client))
        return last

    def send_ahead(self, cycle: int, samples: Samples | None, clients: Sequence[BatchClient]) -> None:
        for client in clients:
            if isinstance(client.receiver, RtdeSession):
                client.receiver.send_ahead(cycle, client)

    def receiver(self, client: InterfaceClient) -> RtdeSession:
        session = RtdeSession(self, client)
        self.sessions.append(session)
        return session

    def send_text(self, text: str, source: str, level: MessageLevel) -> None:
        """Send a text message to all clients."""
        for session in self.sessions:
            session.send_text(text, source, level)


class _Outputs:
    """Output recipe of a client, and the period of its packages.

    Attributes:
        step: Number of cycles from one package to the next.
        is_steady: Whether the packages contain only the time, so that nothing else can change.
    """

    def __init__(self, recipe: Recipe, step: int) -> None:
        self.step = step
        self._form = Form(recipe.layout)
        self.is_steady = tuple(recipe.names) == ("timestamp",)
        self._values = [(key, OUTPUT_VALUES[name]) for key, name in zip(recipe.fields, recipe.names, strict=True)]

    def package(self, state: ControllerState) -> bytes:
        package = self._form.pack({key: value(state) for key, value in self._values})
        return SteadyBytes(package) if self.is_steady else package

    def steady_package(self, time: float) -> SteadyBytes:
        """Return the package at a time of the controller, in s, if `is_steady` is true."""
        ((key, _),) = self._values
        return SteadyBytes(self._form.pack({key: timestamp_at(time)}))


class RtdeSession(InterfaceReceiver):
    """Connection of one RTDE client, with its protocol version and its recipes.

    The session has no socket (sans-IO): it processes bytes and cycles.

    Attributes:
        protocol: Protocol version. It is 1 until the client requests 2.
        is_started: Whether the client has started the data packages.
    """

    def __init__(self, interface: RtdeInterface, client: InterfaceClient) -> None:
        self.protocol: Protocol = 1
        self.is_started = False
        self._interface = interface
        self._state = interface._state
        self._client = client
        self._buffer = bytearray()
        self._outputs: _Outputs | None = None
        self._inputs: dict[int, Recipe] = {}
        self._requests = 0
        self._due = 0  # cycle of the next data package
        self._unread_since: int | None = None
        self._late: deque[tuple[int, bytes]] = deque()

    # -- input ---------------------------------------------------------------------------------------

    def feed(self, data: bytes) -> None:
        """Process received bytes, in chunks of any size."""
        self._buffer += data
        while len(self._buffer) >= HEADER.width and self._client.is_open:
            size = int.from_bytes(self._buffer[:2], "big")
            if size < HEADER.width:
                _log.info("RTDE client: closed: received a package with a size of %d bytes", size)
                self._client.drop()
                return
            if len(self._buffer) < size:
                return
            package = bytes(self._buffer[:size])
            del self._buffer[:size]
            self._take(package)

    def end(self) -> None:
        """Process the end of the connection: release its inputs, immediately or after the delay of a fault."""
        self._interface.sessions.remove(self)
        claims, stale = self._state.claims, self._interface.disturbance.stale
        if stale:
            claims.go_stale(self, self._state.cycle + stale)
        else:
            claims.release(self)

    def _take(self, package: bytes) -> None:
        kind = package[2]
        instead = self._interface.disturbance.instead.pop(kind, None)
        if instead is not None:
            instead(self)
            return
        try:
            request = decode_request(package, self.protocol)
        except PacketError as error:
            self._ignore(str(error))
            return
        reply = _ANSWERS[type(request)](self, request)
        if reply is None:
            return
        before = self._interface.disturbance.text_before.get(kind)
        if before is not None:
            self.send_text(before)
        self._client.send(reply)

    def _ignore(self, why: str) -> None:
        self._state.counters.ignored_packages += 1
        _log.info("RTDE package: ignored: %s", why)

    # -- handshake -----------------------------------------------------------------------------------

    def _protocol(self, request: ProtocolRequest) -> bytes:
        is_accepted = request.wanted in self._interface.disturbance.protocols
        if is_accepted and request.wanted != self.protocol:
            self.protocol = 1 if request.wanted == 1 else 2
            self._outputs, self.is_started = None, False
        return self._reply(ProtocolReply, accepted=is_accepted)

    def _version(self, request: ControllerVersionRequest) -> bytes:
        return self._reply(ControllerVersionReply, **self._state.firmware._asdict())

    def _set_up_outputs(self, request: OutputsRequest) -> bytes:
        self._outputs, self.is_started = None, False
        names, types = self._looked_up(request.names, OUTPUTS)
        step = self._step(request.frequency)
        if names and step is not None and NOT_FOUND not in types:
            self._outputs = _Outputs(Recipe(names, types, None if self.protocol == 1 else 1), step)
        return self._reply(OutputsReply, recipe=int(self._outputs is not None), types=join_names(types))

    def _step(self, frequency: float | None) -> int | None:
        """Return the number of cycles from one package to the next; None if the frequency is invalid."""
        rate = self._state.rate
        if frequency is None:
            return max(1, rate // RATE_1)
        if not 0.0 < frequency < math.inf:
            return None
        # Without the minimum, the quotient would be infinite for a frequency such as 5e-324.
        return max(1, math.floor(rate / max(frequency, LEAST_FREQUENCY)))

    def _set_up_inputs(self, request: InputsRequest) -> bytes:
        self._requests += 1
        names, types = self._looked_up(request.names, INPUTS)
        is_good = bool(names) and self._requests <= MOST_RECIPES and not {NOT_FOUND, IN_USE}.intersection(types)
        if is_good:
            self._state.claims.claim(names, self)
            self._inputs[self._requests] = Recipe(names, types, self._requests, INPUTS)
        return self._reply(InputsReply, recipe=self._requests if is_good else 0, types=join_names(types))

    def _is_in_use(self, name: str) -> bool:
        state = self._state
        if state.fieldbus is not None and name in FIELDBUSES[state.fieldbus]:
            return True
        return state.claims.holder(name, state.cycle) not in (None, self)

    def _looked_up(self, text: str, table: Mapping[str, Variable]) -> tuple[Sequence[str], Sequence[str]]:
        """Return the names, and for each name its type, or NOT_FOUND or IN_USE."""
        if len(text.encode()) > MOST_NAMES:
            return (), ()
        names = split_names(text)
        firmware = self._state.firmware
        types = []
        for name in names:
            variable = table.get(name)
            if variable is None or not variable.is_in(firmware):
                types.append(NOT_FOUND)
            else:
                types.append(IN_USE if table is INPUTS and self._is_in_use(name) else variable.type)
        return names, types

    def _start(self, request: StartRequest) -> bytes:
        outputs, disturbance = self._outputs, self._interface.disturbance
        self.is_started = outputs is not None and not disturbance.refuses_start
        self._due = self._state.cycle + (1 if outputs is None else outputs.step)
        if self.is_started and disturbance.data_before_start:
            self._send_data()
        return self._reply(StartReply, accepted=self.is_started)

    def _pause(self, request: PauseRequest) -> bytes:
        self.is_started = False
        self._late.clear()
        return self._reply(PauseReply, accepted=True)

    def _listen(self, message: RtdeMessage) -> None:
        source = f"{message.source}: " if message.source else ""
        self._interface._on_text(f"{source}{message.message}")

    def _write(self, package: DataPackage) -> None:
        recipe = self._inputs.get(package.recipe or 0)
        if recipe is None:
            self._ignore(f"data package for the unknown recipe {package.recipe}")
            return
        try:
            # Ignore additional bytes: ur_rtde sends 104 bytes for a recipe of 56 bytes, and waits for the result of its
            # command.
            values = recipe.decode(bytes(package)[: recipe.size])
        except PacketError as error:
            self._ignore(str(error))
            return
        state = self._state
        write_inputs(state, values)
        state.watchdogs.feed(recipe.names, state.cycle)

    # -- output --------------------------------------------------------------------------------------

    def _reply(self, kind: type[State], **values: Any) -> bytes:
        return _packed(kind, self.protocol, values)

    def send_text(self, text: str, source: str = SOURCE, level: MessageLevel = MessageLevel.INFO) -> None:
        """Send a text message."""
        self._client.send(_text(self.protocol, text, source, level))

    def next_cycle(self, cycle: int) -> int:
        """Return the first cycle after this one in which a package is due."""
        return cycle + 1 if self._late else max(self._due, cycle + 1)

    def advance(self, cycle: int) -> None:
        """Send the packages that are due in this cycle, or that became due earlier."""
        while self._late and self._late[0][0] <= cycle:
            self._client.send(self._late.popleft()[1])
        outputs = self._outputs
        if not self.is_started or outputs is None or cycle < self._due:
            return
        self._due = cycle + outputs.step - (cycle - self._due) % outputs.step
        if self._interface.disturbance.sends_no_data:
            return
        if self._client.pending:
            self._drop(cycle)
        else:
            self._unread_since = None
            self._send_data()

    def last_ahead(self, cycle: int, client: BatchClient) -> int:
        """See `Interface.last_ahead`."""
        outputs, disturbance = self._outputs, self._interface.disturbance
        before = self.next_cycle(cycle) - 1
        is_steady = self.is_started and outputs is not None and outputs.is_steady and self._due > cycle
        if not is_steady or self._late or disturbance.late or disturbance.sends_no_data:
            return before
        return max(before, client.last_quiet_cycle)

    def send_ahead(self, cycle: int, client: BatchClient) -> None:
        """See `Interface.send_ahead`."""
        outputs, state = self._outputs, self._state
        if not self.is_started or outputs is None or self._due > cycle:
            return
        due = range(self._due, cycle + 1, outputs.step)
        client.send_batch([outputs.steady_package(state.time_of(each)) for each in due], due)
        self._due = due[-1] + outputs.step

    def _send_data(self) -> None:
        assert self._outputs is not None, "started without an output recipe"
        package = self._outputs.package(self._state)
        late = self._interface.disturbance.late
        if late:
            self._late.append((self._state.cycle + late, package))
        else:
            self._client.send(package)

    def _drop(self, cycle: int) -> None:
        """Drop a package that cannot be sent, because older packages are still queued.

        Close the connection if this has lasted for `UNREAD` seconds.
        """
        self._state.counters.unread += 1
        if self._unread_since is None:
            self._unread_since = cycle
        elif cycle - self._unread_since > UNREAD * self._state.rate:
            self._state.counters.dropped += 1
            self._client.drop()


def _text(protocol: Protocol, text: str, source: str = SOURCE, level: MessageLevel = MessageLevel.INFO) -> bytes:
    """Return a text message. With protocol 2, the text is cut after 255 bytes, because its length field is one byte."""
    message = text if protocol == 1 else text.encode()[:255].decode("utf-8", "ignore")
    return _packed(RtdeMessage, protocol, {"message": message, "source": source, "level": level})


def _packed(kind: type[State], protocol: Protocol, values: Mapping[str, Any]) -> bytes:
    layout = kind.LAYOUTS.of((protocol, 0))
    layout.check_complete(values)
    return layout.encode(values)


#: Kind of request -> method that returns the reply; None for no reply.
_ANSWERS: dict[type[State], Callable[[RtdeSession, Any], bytes | None]] = {
    ProtocolRequest: RtdeSession._protocol,
    ControllerVersionRequest: RtdeSession._version,
    OutputsRequest: RtdeSession._set_up_outputs,
    InputsRequest: RtdeSession._set_up_inputs,
    StartRequest: RtdeSession._start,
    PauseRequest: RtdeSession._pause,
    RtdeMessage: RtdeSession._listen,
    DataPackage: RtdeSession._write,
}

"""Client behind `robot.rtde`: outputs as streams, inputs, registers, and the claims of inputs."""

from __future__ import annotations

import threading
import weakref
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Literal, TypeVar, get_args, overload

from linkcore import clock
from linkcore.arguments import check_choice, check_number
from linkcore.errors import BadValue, Closed, LinkTimeout, LocalError
from linkcore.names import StrictAttributes
from linkcore.streaming.connection import Connection
from linkcore.streaming.connection_life import Backoff
from linkcore.streaming.receiver import Receiver
from linkcore.streaming.statistics import StreamCounters
from linkcore.threads import MadeOnce

from ..protocol.firmware import Firmware
from ..protocol.rtde.packets import (
    LONGEST_NAMES,
    InputsReply,
    InputsRequest,
    OutputsReply,
    OutputsRequest,
    join_names,
    split_names,
)
from ..protocol.rtde.protocol import Requests, RtdeProtocol, RtdeRefused, check_names
from ..protocol.rtde.recipes import Outputs
from ..protocol.rtde.transport import RtdeTransport
from ..protocol.rtde.variables import IN_USE, INPUTS, NOT_FOUND, OUTPUTS
from ..session.session_limits import SessionLimits
from ..session.source import Source
from .claims import CLAIM_TIMEOUT, BriefClaims, Claims
from .inputs import Inputs, with_masks
from .outputs import OutputStream, connection_of, declared, recorded_plan
from .registers import FREQUENCY, Registers

if TYPE_CHECKING:
    from .names import AnyOutputs, InputName, OutputName

#: Behaviour if the controller does not have a variable.
Missing = Literal["error", "leave_out"]

T = TypeVar("T", bound=Outputs)
K = TypeVar("K", bound=OutputStream[Any] | Inputs | Claims)

#: First firmware with RTDE. The vendor documents 3.4 and a test program 3.3. The vendor's Python client requires a late
#: 3.2.
_FIRST = Firmware(3, 2)

#: Packages per second on a connection for inputs. They show that the controller is alive.
_HEARTBEAT = 10.0

#: The lowest frequency that a controller accepts (vendor's guide).
_LEAST_FREQUENCY = 1.0


class Rtde(StrictAttributes):
    """RTDE interface of a controller (port 30004). A connection is made when it is first used.

    Each recipe of outputs and each set of inputs has its own connection.

    Args:
        name: Name of the robot, used in messages and thread names.
        source: Source of the received bytes.
        firmware: Function that returns the firmware of the controller.
        refusal: Reason why inputs cannot be written; empty if they can be written.
        limits: Limits of the session; None if it has none.
    """

    def __init__(
        self,
        name: str,
        source: Source,
        firmware: Callable[[], Firmware],
        *,
        refusal: str = "",
        limits: SessionLimits | None = None,
    ) -> None:
        self._name = name
        self._limits = limits
        self._source = source
        self._firmware = firmware
        self._refusal = refusal
        self._lock = threading.RLock()  # re-entrant, because a signal handler might close the robot
        self._open: list[OutputStream[Any] | Inputs | Claims] = []
        self._claims: MadeOnce[Claims] = MadeOnce()
        rtde = weakref.proxy(self)  # weak, because this object holds the claims
        self._brief = BriefClaims(lambda plan: rtde._connect_briefly(plan))
        self._is_closed = False

    @property
    def is_recorded(self) -> bool:
        """Whether this is a recording, which contains only the recorded variables."""
        return self._source.channel is not None

    # -- reading -----------------------------------------------------------------------------------------

    @overload
    def outputs(
        self, kind: type[T], /, *, frequency: float | None = None, missing: Missing = "error"
    ) -> OutputStream[T]: ...
    @overload
    def outputs(
        self, *names: OutputName | str, frequency: float | None = None, missing: Missing = "error"
    ) -> OutputStream[AnyOutputs]: ...
    def outputs(self, *names: Any, frequency: float | None = None, missing: Missing = "error") -> OutputStream[Any]:
        """Return a stream of variables, selected by names or by a class that declares them.

        ``robot.rtde.outputs("actual_q", "actual_TCP_pose", frequency=125)`` has both variables in each state. A class
        derived from `Outputs` declares variables by annotations. A variable whose type allows None is skipped if the
        controller does not have it.

        Args:
            names: Names of the variables (`urlink.rtde.OUTPUTS` lists all known ones), or one class.
            frequency: Packages per second, 1 to 125 on CB3 and 1 to 500 on later controllers; None for the maximum. The
                maximum of a simulated controller with a lower frequency is its frequency. The controller sends a
                package every n-th cycle, so the actual rate is at least `frequency`, and at most twice as high.
            missing: Behaviour for a variable that the controller does not have: "error", or "leave_out". With
                "leave_out", the variable reads as None and is listed in `OutputStream.left_out`.

        Returns:
            The stream, which connects when it is first used. As a context manager, it is closed at the end of the
            block. Otherwise it stays connected until the robot is closed.

        Raises:
            BadValue: If a name is invalid or given twice, the names exceed 2048 bytes, the controller does not support
                the frequency, or the recording does not contain a variable.
            LocalError: If the firmware has no RTDE.
            BadRecording: If the recording contains no RTDE stream.
            Closed: If the robot was closed.
        """
        check_choice(missing, "missing", get_args(Missing))
        kind: type[Outputs] = Outputs
        optional: frozenset[str] = frozenset()
        if len(names) == 1 and isinstance(names[0], type):
            if not issubclass(names[0], Outputs) or names[0] is Outputs:
                raise BadValue(f"{names[0]!r} declares no variables; expected a class derived from urlink.rtde.Outputs")
            kind = names[0]
            wanted, optional = declared(kind)
        elif not names and self.is_recorded:
            wanted = ()
        else:
            wanted = check_names(names)
        if missing == "leave_out":
            optional = frozenset(wanted)
        if self.is_recorded:
            return self._recorded(wanted, optional, kind)
        most = self._check_there().rate
        if frequency is not None and not _LEAST_FREQUENCY <= check_number(frequency, "frequency") <= most:
            raise BadValue(f"frequency={frequency!r}; expected 1 to {most} packages per second on this controller")
        plan = Requests(wanted, frequency, optional, kind=kind)
        connection, transport = self._connection(plan, "rtde")
        return self._keep(OutputStream(connection, plan, transport))

    def _recorded(self, wanted: tuple[str, ...], optional: frozenset[str], kind: type[Outputs]) -> OutputStream[Any]:
        assert self._source.channel is not None, "of a recording"
        plan = recorded_plan(self._source.channel("rtde"), kind)
        lacking = [name for name in wanted if name not in plan.outputs and name not in optional]
        if lacking:
            raise BadValue(
                f"{self._name} was recorded without {', '.join(lacking)}; it contains {', '.join(plan.outputs)}"
            )
        connection = connection_of(f"{self._name} rtde", self._source.transport("rtde"), plan, self._source)
        return self._keep(OutputStream(connection, plan, None, lossless=self._source.is_lossless))

    def _check_there(self) -> Firmware:
        """Return the firmware, if it has RTDE.

        Raises:
            LocalError: If the firmware has no RTDE.
            Closed: If the robot was closed.
        """
        if self._is_closed:
            raise Closed(f"{self._name} was closed")
        firmware = self._firmware()
        if firmware < _FIRST:
            raise LocalError(f"firmware {firmware} has no RTDE; use robot.realtime, or firmware 3.3 or later")
        return firmware

    # -- writing -----------------------------------------------------------------------------------------

    def inputs(self, *names: InputName | str) -> Inputs:
        """Connect immediately, and claim variables in order to write them.

        Args:
            names: Names of the variables (`urlink.rtde.INPUTS` lists all known ones). Masks are added automatically.

        Raises:
            BadValue: If a name is invalid or given twice, or the names exceed 2048 bytes.
            InputInUse: If another client or a fieldbus holds an input. The message names the input.
            NoSuchVariable: If the controller does not have a variable.
            RemoteError: If the controller cannot be reached, or does not answer.
            LocalError: If this is a recording, or the connection was made with ``read_only=True``.
            Closed: If the robot was closed.
        """
        self._check_writable()
        wanted = with_masks(names)
        self._brief.give_back()  # a setting of the same robot might hold one of them
        plan = Requests(("timestamp",), _HEARTBEAT, inputs=[wanted])
        connection, transport = self._connection(plan, "rtde inputs")
        # Stored before connecting, so that closing the robot also ends the attempt.
        inputs = self._keep(Inputs(connection, transport, wanted, self._source.timeout, self._limits))
        inputs._claim()
        return inputs

    def registers(self, *, lower: bool = False) -> Registers:
        """Return the general-purpose registers by number.

        Args:
            lower: Whether to include the lower registers, which are meant for fieldbuses and PLCs. `robot.registers`
                does not include them.
        """
        frequency = min(FREQUENCY, self._source.frequency or FREQUENCY)
        return Registers(self._claimed, self.outputs, self._source.timeout, frequency=frequency, lower=lower)

    def _claimed(self) -> Claims:
        """Return the connection for claiming registers."""
        self._check_writable()
        claims = self._claims.made
        if claims is None:
            plan = Requests(("timestamp",), _HEARTBEAT)
            connection, transport = self._connection(plan, "rtde registers")
            made = Claims(connection, transport, plan, self._source.timeout)
            claims = self._claims.keep(made)
            if claims is made:
                self._keep(made)
        return claims

    def _brief_claims(self) -> BriefClaims:
        """Return the claims for the settings of this robot.

        Raises:
            LocalError: If inputs cannot be written, or the firmware has no RTDE.
        """
        self._check_writable()
        return self._brief

    def _connect_briefly(self, plan: Requests) -> Claims:
        brief = self._source._replace(timeout=CLAIM_TIMEOUT, backoff=Backoff(tries=0))
        connection, transport = self._connection(plan, "rtde settings", brief)
        return Claims(connection, transport, plan, CLAIM_TIMEOUT)

    def who_holds(self) -> dict[str, str]:
        """Try to claim each input, and report why inputs are not available.

        Each free input is claimed during this call, which takes a few milliseconds. Other clients that claim it in this
        time are refused. Inputs that this robot object holds are reported as in use, too.

        Returns:
            Name of each unavailable input -> "in use" (by another client or a fieldbus) or "not there" (this controller
            does not have it).

        Raises:
            RemoteError: If the controller cannot be reached, or does not answer.
            LocalError: If this is a recording, or the connection was made with ``read_only=True``.
            Closed: If the robot was closed.
        """
        self._check_writable()
        self._brief.give_back()
        said = {IN_USE: "in use", NOT_FOUND: "not there"}
        types = self._types([InputsRequest(names=name) for name in INPUTS])
        return {name: said[type] for name, type in zip(INPUTS, types, strict=True) if type in said}

    def missing(self) -> tuple[str, ...]:
        """Return the outputs of `OUTPUTS` that this controller does not have. The call requests all of them.

        Raises:
            RemoteError: If the controller cannot be reached, or does not answer.
            BadValue: If this is a recording, because there is no controller to ask.
            Closed: If the robot was closed.
        """
        if self.is_recorded:
            raise BadValue(f"{self._name} is a recording; it contains only {', '.join(self.outputs().names)}")
        self._check_there()
        parts: list[list[str]] = [[]]
        for name in OUTPUTS:
            if len(join_names([*parts[-1], name])) > LONGEST_NAMES:
                parts.append([])
            parts[-1].append(name)
        frequency = _LEAST_FREQUENCY
        types = self._types([OutputsRequest(frequency=frequency, names=join_names(part)) for part in parts])
        return tuple(name for name, type in zip(OUTPUTS, types, strict=True) if type == NOT_FOUND)

    def _types(self, requests: Sequence[OutputsRequest | InputsRequest]) -> list[str]:
        """Return the types that the controller sends in reply to requests. No data is started on the connection.

        Raises:
            RemoteError: If the controller cannot be reached, does not answer, or sends a wrong number of types.
        """
        until = clock.now() + self._source.timeout
        transport = RtdeTransport(self._source.transport("rtde"), Requests())
        transport.open(self._source.timeout)
        try:
            assert transport.dialogue is not None, "the connection was made"
            if transport.dialogue.protocol == 1:
                requests = [type(request)("1.0", names=request.names) for request in requests]
            transport.send(b"".join(map(bytes, requests)), clock.left(until))
            replies = self._replies(transport, len(requests), until)
        finally:
            transport.abort()
        types: list[str] = []
        for request, reply in zip(requests, replies, strict=True):
            names, answered = split_names(request.names), split_names(reply.types)
            if len(answered) != len(names):
                raise RtdeRefused(f"{transport.name}: received {len(answered)} types for {len(names)} names", names)
            types += answered
        return types

    @staticmethod
    def _replies(transport: RtdeTransport, count: int, until: float) -> list[OutputsReply | InputsReply]:
        """Return the replies to `count` recipes, and skip all other packets."""
        # Bytes that arrived during the dialogue come first.
        receiver = Receiver(transport.name, RtdeProtocol(Requests()), StreamCounters())
        replies: list[OutputsReply | InputsReply] = []
        while len(replies) < count:
            left = until - clock.now()
            if left <= 0:
                raise LinkTimeout(f"{transport.name}: only {len(replies)} of {count} requests were answered in time")
            data, stamp = transport.receive(left)
            replies += [
                packet for packet in receiver.feed(data, stamp) if isinstance(packet, (OutputsReply, InputsReply))
            ]
        return replies

    def _check_writable(self) -> None:
        if self._refusal:
            raise LocalError(self._refusal)
        self._check_there()

    # -- connections -------------------------------------------------------------------------------------

    def _connection(self, plan: Requests, what: str, source: Source | None = None) -> tuple[Connection, RtdeTransport]:
        source = source or self._source
        plan.rate = source.frequency
        transport = (source.rtde or RtdeTransport)(source.transport("rtde"), plan)
        return connection_of(f"{self._name} {what}", transport, plan, source), transport

    def _keep(self, opened: K) -> K:
        """Register an object that must be closed together with the robot.

        Raises:
            Closed: If the robot was closed already.
        """
        with self._lock:
            is_closed = self._is_closed
            self._open = [*(each for each in self._open if not each.is_over), opened]
        if is_closed:
            self.close()
            raise Closed(f"{self._name} was closed")
        return opened

    def close(self, timeout: float = 2.0) -> None:
        """Close every stream and release every input, within `timeout` seconds. Idempotent."""
        until = clock.now() + timeout
        with self._lock:
            self._is_closed = True
            opened, self._open = self._open, []
        self._brief.close(timeout)
        for each in opened:
            each.close(clock.left(until))

    def __repr__(self) -> str:
        return f"<Rtde {self._name}>"

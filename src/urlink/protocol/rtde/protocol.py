"""Protocol of an RTDE connection, client side, sans-IO: requests, their replies, and data packages.

    V -> v -> O (repeated without the variables that the controller lacks) -> I for each claim -> S -> data packages

V, v, O, I and S are the types of the requests and their replies. The same object serves live connections and
recordings. On a live connection, the packages of `requests` are sent. With a recording, nothing is sent: the requests
follow from the plan, so the replies alone are sufficient. A text message or a data package can arrive at any time.
Neither is taken for a reply (docs/protocols/rtde.md, section What clients really send).
"""

from __future__ import annotations

import difflib
import logging
import math
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from linkcore.clock import Stamp
from linkcore.errors import BadValue, PacketError, RemoteError
from linkcore.wire.cycles import MissedCycles
from linkcore.wire.framing import Framer
from linkcore.wire.packet import State

from ..firmware import Firmware
from .packets import (
    LONGEST_NAMES,
    REPLIES,
    ControllerVersionReply,
    ControllerVersionRequest,
    InputsReply,
    InputsRequest,
    MessageLevel,
    OutputsReply,
    OutputsRequest,
    Protocol,
    ProtocolReply,
    ProtocolRequest,
    RtdeBoundary,
    RtdeMessage,
    StartReply,
    StartRequest,
    decode_reply,
    join_names,
    split_names,
)
from .recipes import DATA_TYPE, Outputs, Recipe
from .variables import IN_USE, INPUTS, NOT_FOUND, OUTPUTS, TYPES

_log = logging.getLogger(__name__)

#: Output variable with the controller's clock, in s.
CLOCK = "timestamp"
#: Maximum number of cycles between two data packages for which a period is considered, because a frequency can be
#: arbitrarily low.
_SLOWEST = 1e9
#: Data packages per second with protocol 1.
RATE_1 = 125

_LEVELS = {
    MessageLevel.EXCEPTION: logging.ERROR,
    MessageLevel.ERROR: logging.ERROR,
    MessageLevel.WARNING: logging.WARNING,
}


class RtdeRefused(RemoteError):
    """Error if the controller refuses an RTDE request.

    Attributes:
        names: Refused variables; empty if the controller does not name them.
    """

    __module__ = "urlink"  # users import it from this module, and tracebacks show it

    def __init__(self, text: str, names: tuple[str, ...] = ()) -> None:
        super().__init__(text, names)
        self.names = names

    def __str__(self) -> str:
        return str(self.args[0])


class NoSuchVariable(RtdeRefused):
    """Error if the controller does not have a variable: it replied NOT_FOUND, or an unknown type."""

    __module__ = "urlink"  # users import it from this module, and tracebacks show it


class InputInUse(RtdeRefused):
    """Error if another client or a fieldbus holds an input: the controller replied IN_USE."""

    __module__ = "urlink"  # users import it from this module, and tracebacks show it


def check_names(names: Sequence[str]) -> tuple[str, ...]:
    """Check the names of one recipe, and return them as a tuple.

    Raises:
        BadValue: If there is no name, a name occurs twice or is invalid, or the names have more than 2048 bytes.
    """
    if isinstance(names, str) or not names:
        raise BadValue(f"names={names!r}; expected the names of one variable or more, such as 'actual_q'")
    for name in names:
        is_name = isinstance(name, str) and name.isascii() and name.isidentifier()
        if not is_name or hasattr(Outputs, name):
            raise BadValue(f"{name!r} is not a valid name of a variable; expected a name such as 'actual_q'")
    twice = sorted({name for name in names if list(names).count(name) > 1})
    if twice:
        raise BadValue(f"{', '.join(twice)} was given more than once; pass each name once")
    size = len(join_names(names))
    if size > LONGEST_NAMES:
        raise BadValue(
            f"the {len(names)} names have {size} bytes; expected at most {LONGEST_NAMES}; use several recipes"
        )
    return tuple(names)


@dataclass
class Requests:
    """Plan of the requests that are sent again on each connection.

    Attributes:
        outputs: Names of the output variables. If empty, no data packages are started.
        frequency: Rate of the data packages in Hz; None for the maximum rate of the controller.
        optional: Outputs that are skipped if the controller does not have them.
        inputs: Names of the input variables to claim, recipe by recipe. May grow during a connection.
        kind: Base class of the states.
        recorded: Recipe that was in use when a recording began.
        rate: Cycles per second of a simulated controller, in Hz; None if they follow from the firmware.
    """

    outputs: tuple[str, ...] = ()
    frequency: float | None = None
    optional: frozenset[str] = frozenset()
    inputs: list[tuple[str, ...]] = field(default_factory=list)
    kind: type[Outputs] = Outputs
    recorded: Recipe | None = None
    rate: int | None = None


class RtdeProtocol:
    """Decoder of the bytes of one connection to typed states. Each connection needs a new object.

    Args:
        plan: Variables to request.

    Attributes:
        protocol: Version of the protocol that is in use.
        controller: Firmware that the controller reported; None before its report.
        recipe: Recipe of the data packages; None before the reply.
        claims: Recipes of the inputs, in the order of the plan.
        is_ready: Whether all requests have been answered.
    """

    def __init__(self, plan: Requests) -> None:
        self.framer = Framer(RtdeBoundary())
        self.unknown = 0
        self.tails = 0
        self.cycles: MissedCycles | None = None  # known after the recipe
        self.protocol: Protocol = 1
        self.controller: Firmware | None = None
        self.recipe: Recipe | None = None
        self.claims: list[Recipe] = []
        self.is_ready = False
        self._plan = plan
        self._outputs = plan.outputs  # without the variables that the controller does not have
        self._requests: list[State] = []
        self._awaited: type[State] | None = None
        self._decode: Callable[..., Any] | None = None
        self._size = 0
        if plan.recorded is not None:
            self._use(plan.recorded)
            self.protocol = 1 if plan.recorded.number is None else 2
        self._ask(ProtocolRequest(wanted=2), ProtocolReply)

    @property
    def _rate(self) -> int | None:
        """Cycles of the controller per second; None before the controller has reported its firmware."""
        if self._plan.rate is not None:
            return self._plan.rate
        return None if self.controller is None else self.controller.rate

    # -- requests ---------------------------------------------------------------------------------

    def requests(self) -> bytes:
        """Return the bytes to send now. Each request is returned once."""
        requests, self._requests = self._requests, []
        return b"".join(map(bytes, requests))

    @property
    def awaits(self) -> str:
        """Name of the awaited package, used in messages."""
        return "data packages" if self._awaited is None else self._awaited.__name__

    def _ask(self, request: State, reply: type[State]) -> None:
        self._requests.append(request)
        self._awaited = reply

    def _ask_next(self) -> None:
        """Prepare the next request of the plan that has no reply yet."""
        if self._outputs and self.recipe is None:
            rate = self._rate
            assert rate is not None, "the version was requested before"
            frequency = float(rate) if self._plan.frequency is None else self._plan.frequency
            names = join_names(self._outputs)
            self._ask(OutputsRequest(f"{self.protocol}.0", frequency=frequency, names=names), OutputsReply)
        elif len(self.claims) < len(self._plan.inputs):
            self._ask(InputsRequest(names=join_names(self._plan.inputs[len(self.claims)])), InputsReply)
        elif self._outputs:
            self._ask(StartRequest(), StartReply)
        else:
            self._finish()

    def _finish(self) -> None:
        self._awaited = None
        self.is_ready = True

    # -- replies ----------------------------------------------------------------------------------

    def take(self, frame: bytes, stamp: Stamp | None = None) -> Any:
        """Process one whole package, and update the attributes.

        Raises:
            RtdeRefused: If the controller refuses a request of the plan.
            PacketError: If the type is unknown, or the package is too short for its type.
        """
        state = self._reply(frame, stamp)
        if type(state) is self._awaited:
            self._answered(state)
        return state

    def _reply(self, frame: bytes, stamp: Stamp | None) -> State:
        try:
            return decode_reply(frame, self.protocol, stamp)
        except PacketError:
            # A text message that was sent just before protocol 2 was accepted has the form of protocol 1.
            if self.protocol == 2 and frame[2:3] == b"M":
                return decode_reply(frame, 1, stamp)
            raise

    def _answered(self, reply: Any) -> None:
        if isinstance(reply, ProtocolReply):
            self.protocol = 2 if reply.accepted else 1
            most = RATE_1 if self._plan.rate is None else min(RATE_1, self._plan.rate)
            if not reply.accepted and self._plan.frequency not in (None, most):
                _log.warning(
                    "RTDE protocol 2 was refused: data arrives at %d Hz, not %g Hz", most, self._plan.frequency
                )
            self._ask(ControllerVersionRequest(), ControllerVersionReply)
        elif isinstance(reply, ControllerVersionReply):
            self.controller = Firmware(reply.major, reply.minor, reply.bugfix, reply.build)
            # The recording contains the dialogue itself, so the recipe that was stored with it is not needed.
            self.recipe = self._decode = None
            self._ask_next()
        elif isinstance(reply, OutputsReply):
            self._take_outputs(reply)
            self._ask_next()
        elif isinstance(reply, InputsReply):
            self.claims.append(claim_of(self._plan.inputs[len(self.claims)], reply))
            self._ask_next()
        elif isinstance(reply, StartReply):
            if not reply.accepted:
                raise RtdeRefused("the controller refused to start sending data packages")
            self._finish()

    def _take_outputs(self, reply: OutputsReply) -> None:
        names = self._outputs
        types = _types(names, reply.types)
        missing = _check(names, types, self._plan.optional)
        if missing:
            self._outputs = tuple(name for name in names if name not in missing)
            _log.info("RTDE: the controller does not have %s", ", ".join(missing))
            if not self._outputs:
                lacking = self._plan.outputs
                raise NoSuchVariable(f"this controller has none of {', '.join(lacking)}", lacking)
            return
        if reply.recipe == 0:
            raise RtdeRefused(f"the controller refused the outputs {', '.join(names)}", names)
        self._use(Recipe(names, types, reply.recipe))

    def _use(self, recipe: Recipe) -> None:
        self.recipe = recipe
        self._size = recipe.size
        left_out = tuple(name for name in self._plan.outputs if name not in recipe.names)
        layout = recipe.state_class(self._plan.kind, left_out).LAYOUTS.all[0]
        self._decode = layout.decode
        self.cycles = None
        if CLOCK in layout.places:
            periods = package_periods(self._plan.frequency, self._rate, recipe.number)
            time = struct.Struct(f">{layout.places[CLOCK].offset}xd").unpack_from
            self.cycles = MissedCycles(_moment_of(time, recipe.size), periods, time=time, size=recipe.size)

    # -- packages of a stream ---------------------------------------------------------------------

    def decode(self, frame: bytes, stamp: Stamp | None = None) -> Any:
        """Return the state in a data package, or the reply or text in another package.

        Raises:
            PacketError: If a data package does not fit the recipe, or the package is unknown.
            RtdeRefused: See `take`.
        """
        if frame[2] == DATA_TYPE:
            recipe = self.recipe
            if self._decode is None or recipe is None:
                raise PacketError("it arrived before its recipe", packet="data package")
            if len(frame) != self._size or (recipe.number is not None and frame[3] != recipe.number):
                recipe.check(frame)
            return self._decode(frame, stamp)
        try:
            packet = self.take(frame, stamp)
        except PacketError:
            self.unknown += frame[2] not in REPLIES
            raise
        if isinstance(packet, RtdeMessage):
            level = _LEVELS.get(packet.level, logging.INFO)
            _log.log(level, "message from the controller: %r (%s)", packet.message, packet.source or "no source")
        return packet


def package_periods(frequency: float | None, rate: int | None, number: int | None) -> tuple[float, ...]:
    """Return the possible periods of data packages, in s. There are several if the rate of the controller is unknown.

    With protocol 2, the controller sends in every floor(rate / frequency)-th cycle (docs/protocols/rtde.md, section
    Rules).

    Args:
        frequency: Requested rate in Hz; None for the maximum.
        rate: Cycles of the controller per second; None if unknown, as in a recording that began later.
        number: Number of the recipe; None under protocol 1, which sends at 125 Hz, or at the rate of a slower
            controller.
    """
    if number is None:
        return (1 / min(RATE_1, rate or RATE_1),)
    rates = (125, 500) if rate is None else (rate,)
    return tuple({max(math.floor(min(rate / (frequency or rate), _SLOWEST)), 1) / rate for rate in rates})


def _moment_of(time: Callable[[bytes], Sequence[Any]], size: int) -> Callable[[bytes], float | None]:
    """Return a function that reads the time of data packages, and returns None for all other packages."""

    def moment(frame: bytes) -> float | None:
        return time(frame)[0] if frame[2] == DATA_TYPE and len(frame) == size else None

    return moment


def claim_of(names: Sequence[str], reply: InputsReply) -> Recipe:
    """Return the recipe of claimed inputs.

    Raises:
        InputInUse: If another client or a fieldbus holds an input.
        NoSuchVariable: If the controller does not have an input.
        RtdeRefused: If the controller refuses the inputs for another reason.
    """
    types = _types(names, reply.types)
    _check(names, types, frozenset())
    if not reply.recipe:
        raise RtdeRefused(f"the controller refused the inputs {', '.join(names)}", tuple(names))
    return Recipe(names, types, reply.recipe, INPUTS)


def _types(names: Sequence[str], text: str) -> tuple[str, ...]:
    """Return the types in the reply of the controller, one for each name."""
    types = split_names(text)
    if len(types) != len(names):
        raise RtdeRefused(f"the controller replied with {len(types)} types ({text!r}) for {len(names)} names")
    return types


def _check(names: Sequence[str], types: Sequence[str], optional: frozenset[str]) -> tuple[str, ...]:
    """Return the optional names that the controller lacks. Raise an error for all other unavailable names."""
    there = list(zip(names, types, strict=True))
    held = tuple(name for name, type in there if type == IN_USE)
    missing = tuple(name for name, type in there if type != IN_USE and type not in TYPES)
    lacking = tuple(name for name in missing if name not in optional)
    if lacking:
        hints = [_hint(name, dict(there)[name]) for name in lacking]
        raise NoSuchVariable(f"this controller does not have {', '.join(hints)}", lacking)
    if held:
        raise InputInUse(
            f"another client or a fieldbus holds {', '.join(held)}; disconnect that client to release them",
            held,
        )
    return missing


def _hint(name: str, type: str) -> str:
    """Return a name with a hint about the possible error in it."""
    if type != NOT_FOUND:
        return f"{name} (unknown type {type})"
    if name in OUTPUTS or name in INPUTS:
        return name
    close = difflib.get_close_matches(name, [*OUTPUTS, *INPUTS], n=1)
    return f"{name} (did you mean {close[0]}?)" if close else name

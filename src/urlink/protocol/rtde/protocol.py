"""The client's side of an RTDE connection, sans-IO: requests, their replies, and data packages.

    V -> v -> O (again without what the controller lacks) -> I for each claim -> S -> data packages

The same object serves a live connection, on which the packages of `requests` are sent, and a recorded one, on which
nothing is sent: the requests follow from the plan, so the replies alone suffice. Text may come at any time, and a data
package in place of a reply; neither is taken for one (docs/protocols/rtde.md, section What clients really send).
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

#: The output that is the controller's clock, s.
CLOCK = "timestamp"
#: Cycles between two data packages that are distinguished: a frequency may be as low as the user likes.
_SLOWEST = 1e9

_LEVELS = {
    MessageLevel.EXCEPTION: logging.ERROR,
    MessageLevel.ERROR: logging.ERROR,
    MessageLevel.WARNING: logging.WARNING,
}


class RtdeRefused(RemoteError):
    """The controller refuses a request of RTDE.

    Attributes:
        names: the variables that it refuses; empty where it does not say.
    """

    __module__ = "urlink"  # where users import it from, and what a traceback shows

    def __init__(self, text: str, names: tuple[str, ...] = ()) -> None:
        super().__init__(text, names)
        self.names = names

    def __str__(self) -> str:
        return str(self.args[0])


class NoSuchVariable(RtdeRefused):
    """The controller does not have a variable: it answered NOT_FOUND, or an unknown type."""

    __module__ = "urlink"  # where users import it from, and what a traceback shows


class InputInUse(RtdeRefused):
    """Another client, or a fieldbus, holds an input: the controller answered IN_USE."""

    __module__ = "urlink"  # where users import it from, and what a traceback shows


def check_names(names: Sequence[str]) -> tuple[str, ...]:
    """The names of one recipe, as they can be asked for.

    Raises:
        BadValue: none, one twice, one that cannot be a name, or more than 2048 bytes of them.
    """
    if isinstance(names, str) or not names:
        raise BadValue(f"names={names!r}; expected the names of one variable or more, such as 'actual_q'")
    for name in names:
        is_name = isinstance(name, str) and name.isascii() and name.isidentifier()
        if not is_name or hasattr(Outputs, name):
            raise BadValue(f"{name!r} cannot be the name of a variable")
    twice = sorted({name for name in names if list(names).count(name) > 1})
    if twice:
        raise BadValue(f"asked for more than once: {', '.join(twice)}")
    size = len(join_names(names))
    if size > LONGEST_NAMES:
        raise BadValue(
            f"{len(names)} names have {size} bytes, and one recipe may have {LONGEST_NAMES}; use several connections"
        )
    return tuple(names)


@dataclass
class Requests:
    """What is asked for on each connection anew.

    Attributes:
        outputs: names of the variables to get; none: nothing is started.
        frequency: packages a second; None for the most that the controller sends.
        optional: outputs that are left out where the controller lacks them.
        inputs: names of the variables to claim, recipe by recipe. May grow while a connection is up.
        kind: class from which the states are derived.
        recorded: the recipe that held when a recording began.
    """

    outputs: tuple[str, ...] = ()
    frequency: float | None = None
    optional: frozenset[str] = frozenset()
    inputs: list[tuple[str, ...]] = field(default_factory=list)
    kind: type[Outputs] = Outputs
    recorded: Recipe | None = None


class RtdeProtocol:
    """Bytes in, typed states out; a new one for each connection.

    Args:
        plan: what is asked for.

    Attributes:
        protocol: the version that holds.
        controller: what the controller reported of itself, or None so far.
        recipe: of the data packages, or None so far.
        claims: the recipes of the inputs, in the order of the plan.
        is_ready: everything was asked and answered.
    """

    def __init__(self, plan: Requests) -> None:
        self.framer = Framer(RtdeBoundary())
        self.unknown = 0
        self.tails = 0
        self.cycles: MissedCycles | None = None  # known with the recipe
        self.protocol: Protocol = 1
        self.controller: Firmware | None = None
        self.recipe: Recipe | None = None
        self.claims: list[Recipe] = []
        self.is_ready = False
        self._plan = plan
        self._outputs = plan.outputs  # those that are still asked for
        self._requests: list[State] = []
        self._awaited: type[State] | None = None
        self._decode: Callable[..., Any] | None = None
        self._size = 0
        if plan.recorded is not None:
            self._use(plan.recorded)
            self.protocol = 1 if plan.recorded.number is None else 2
        self._ask(ProtocolRequest(wanted=2), ProtocolReply)

    # -- asking -----------------------------------------------------------------------------------

    def requests(self) -> bytes:
        """What is to be sent now; each request is handed out once."""
        requests, self._requests = self._requests, []
        return b"".join(map(bytes, requests))

    @property
    def awaits(self) -> str:
        """What the controller still has to say, for messages."""
        return "data packages" if self._awaited is None else self._awaited.__name__

    def _ask(self, request: State, reply: type[State]) -> None:
        self._requests.append(request)
        self._awaited = reply

    def _ask_next(self) -> None:
        """The next request of the plan that has no answer yet."""
        if self._outputs and self.recipe is None:
            assert self.controller is not None, "it was asked for before"
            frequency = float(self.controller.rate) if self._plan.frequency is None else self._plan.frequency
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

    # -- answers ----------------------------------------------------------------------------------

    def take(self, frame: bytes, stamp: Stamp | None = None) -> Any:
        """One whole package; what it means is in the attributes afterwards.

        Raises:
            RtdeRefused: the controller does not do what the plan asks for.
            PacketError: of a type that nobody knows, or too short for it.
        """
        state = self._reply(frame, stamp)
        if type(state) is self._awaited:
            self._answered(state)
        return state

    def _reply(self, frame: bytes, stamp: Stamp | None) -> State:
        try:
            return decode_reply(frame, self.protocol, stamp)
        except PacketError:
            # Text from just before protocol 2 was accepted has the form of protocol 1.
            if self.protocol == 2 and frame[2:3] == b"M":
                return decode_reply(frame, 1, stamp)
            raise

    def _answered(self, reply: Any) -> None:
        if isinstance(reply, ProtocolReply):
            self.protocol = 2 if reply.accepted else 1
            if not reply.accepted and self._plan.frequency not in (None, 125):
                _log.warning("RTDE protocol 2 was refused: data comes at 125 Hz, not %g Hz", self._plan.frequency)
            self._ask(ControllerVersionRequest(), ControllerVersionReply)
        elif isinstance(reply, ControllerVersionReply):
            self.controller = Firmware(reply.major, reply.minor, reply.bugfix, reply.build)
            # What was known of a recording: this one begins with a dialogue of its own.
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
            _log.info("RTDE: this controller does not have %s", ", ".join(missing))
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
            periods = package_periods(self._plan.frequency, self.controller, recipe.number)
            time = struct.Struct(f">{layout.places[CLOCK].offset}xd").unpack_from
            self.cycles = MissedCycles(_moment_of(time, recipe.size), periods, time=time, size=recipe.size)

    # -- packages of a stream ---------------------------------------------------------------------

    def decode(self, frame: bytes, stamp: Stamp | None = None) -> Any:
        """The state in a data package, or the reply or the text in another package.

        Raises:
            PacketError: a data package that does not fit the recipe, or a package that nobody knows.
            RtdeRefused: as `take`.
        """
        if frame[2] == DATA_TYPE:
            recipe = self.recipe
            if self._decode is None or recipe is None:
                raise PacketError("came before its recipe", packet="data package")
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
            _log.log(level, "the controller says: %r (%s)", packet.message, packet.source or "no source")
        return packet


def package_periods(frequency: float | None, controller: Firmware | None, number: int | None) -> tuple[float, ...]:
    """Seconds between two data packages: each possibility, where the controller is not known.

    With protocol 2 it sends in every floor(rate / frequency)-th cycle (docs/protocols/rtde.md, section Rules).

    Args:
        frequency: that was asked for; None for the most.
        controller: its firmware; None where it is not known, as in a recording that began later.
        number: of the recipe; None under protocol 1, which sends at 125 Hz.
    """
    if number is None:
        return (1 / 125,)
    rates = (125, 500) if controller is None else (controller.rate,)
    return tuple({max(math.floor(min(rate / (frequency or rate), _SLOWEST)), 1) / rate for rate in rates})


def _moment_of(time: Callable[[bytes], Sequence[Any]], size: int) -> Callable[[bytes], float | None]:
    """What reads the time out of data packages, and out of nothing else."""

    def moment(frame: bytes) -> float | None:
        return time(frame)[0] if frame[2] == DATA_TYPE and len(frame) == size else None

    return moment


def claim_of(names: Sequence[str], reply: InputsReply) -> Recipe:
    """The recipe of inputs that were claimed.

    Raises:
        InputInUse, NoSuchVariable, RtdeRefused: they cannot be had.
    """
    types = _types(names, reply.types)
    _check(names, types, frozenset())
    if not reply.recipe:
        raise RtdeRefused(f"the controller refused the inputs {', '.join(names)}", tuple(names))
    return Recipe(names, types, reply.recipe, INPUTS)


def _types(names: Sequence[str], text: str) -> tuple[str, ...]:
    """The types that the controller answered, one for each name."""
    types = split_names(text)
    if len(types) != len(names):
        raise RtdeRefused(f"the controller answered {len(types)} types ({text!r}) for {len(names)} names")
    return types


def _check(names: Sequence[str], types: Sequence[str], optional: frozenset[str]) -> tuple[str, ...]:
    """The optional names that the controller lacks; an error for every other one that it does not give."""
    there = list(zip(names, types, strict=True))
    held = tuple(name for name, type in there if type == IN_USE)
    missing = tuple(name for name, type in there if type != IN_USE and type not in TYPES)
    lacking = tuple(name for name in missing if name not in optional)
    if lacking:
        hints = [_hint(name, dict(there)[name]) for name in lacking]
        raise NoSuchVariable(f"this controller does not have {', '.join(hints)}", lacking)
    if held:
        raise InputInUse(
            f"in use by another client or a fieldbus: {', '.join(held)}; it is released when that one disconnects", held
        )
    return missing


def _hint(name: str, type: str) -> str:
    """A name, and what may be wrong with it."""
    if type != NOT_FOUND:
        return f"{name} (of the type {type}, which is unknown)"
    if name in OUTPUTS or name in INPUTS:
        return name
    close = difflib.get_close_matches(name, [*OUTPUTS, *INPUTS], n=1)
    return f"{name} (did you mean {close[0]}?)" if close else name

"""Stream of one recipe of outputs, which can be iterated, subscribed to, and recorded."""

from __future__ import annotations

import inspect
import re
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TypeVar, get_args

from linkcore.errors import BadRecording, BadValue
from linkcore.net.transport import Transport
from linkcore.streaming.connection import Connection
from linkcore.streaming.fanout import FanOut
from linkcore.streaming.stream import Stream
from linkcore.threads import Closing

from ..protocol.field_names import name_on
from ..protocol.firmware import Firmware
from ..protocol.rtde.packets import REPLIES
from ..protocol.rtde.protocol import Requests, RtdeProtocol, check_names
from ..protocol.rtde.recipes import Outputs, Recipe
from ..protocol.rtde.transport import RtdeTransport
from ..session.identity import described_frequency

if TYPE_CHECKING:
    from ..session.source import Source

T = TypeVar("T", bound=Outputs)

#: Number of packets that can be late or missing before a connection counts as lost.
_LATE = 5


def declared(kind: type[Outputs]) -> tuple[tuple[str, ...], frozenset[str]]:
    """Return the variables that a class declares as annotations, and the subset whose type allows None.

    Raises:
        BadValue: If the class declares no variable, or an invalid name.
    """
    names: dict[str, Any] = {}
    for base in reversed(kind.__mro__):
        if issubclass(base, Outputs) and base is not Outputs:
            names |= inspect.get_annotations(base)
    if not names:
        raise BadValue(f"{kind.__name__} declares no variable; expected an annotation such as 'actual_q: Vector'")
    return check_names(tuple(names)), frozenset(name for name, hint in names.items() if _may_be_none(hint))


def _may_be_none(hint: Any) -> bool:
    if isinstance(hint, str):  # from __future__ import annotations
        return re.search(r"\b(None|Optional)\b", hint) is not None
    return type(None) in get_args(hint)


def connection_of(name: str, transport: Transport, plan: Requests, source: Source) -> Connection:
    """Return a connection that sends the requests of the plan each time it connects.

    The connection reconnects according to the settings of the source.
    """
    silence = source.silence
    if silence is not None and plan.frequency is not None:
        silence = max(silence, _LATE / plan.frequency)
    fan_out = FanOut(plan.kind, parts=lambda packet: (), others=tuple(REPLIES.values()))
    backoff, timeout = source.backoff, source.timeout
    return source.connection(
        name,
        transport,
        lambda: RtdeProtocol(plan),
        fan_out,
        backoff=backoff,
        timeout=timeout,
        silence=silence,
        flight=source.flight("rtde"),
    )


def recorded_plan(info: Mapping[str, Any], kind: type[Outputs]) -> Requests:
    """Return the plan of a recorded stream, from the description of its channel.

    Raises:
        BadRecording: If the description is incomplete or invalid.
    """
    try:
        recipe = Recipe(info["names"], info["types"], info["number"])
        asked, rate = tuple(info["asked"]), described_frequency(info)
        return Requests(asked, info["frequency"], frozenset(asked), kind=kind, recorded=recipe, rate=rate)
    except (KeyError, TypeError, BadValue) as error:
        raise BadRecording(f"the recording does not describe its RTDE variables: {error}") from None


class OutputStream(Stream[T], Closing):
    """Stream of the data packages of one recipe, on its own connection. Made by `Rtde.outputs`.

    The stream also carries text messages and replies of the controller: ``stream.of(RtdeMessage)``.

    Attributes:
        names: Names of the requested variables.
        frequency: Requested packages per second; None for the maximum of the controller.
    """

    def __init__(
        self, connection: Connection, plan: Requests, transport: RtdeTransport | None, *, lossless: bool = False
    ) -> None:
        kind: Any = plan.kind
        super().__init__(connection, kind, lossless=lossless)
        self.names = plan.outputs
        self.frequency = plan.frequency
        self._plan = plan
        self._transport = transport

    def _hint(self, name: str) -> str | None:
        own = name if name in self._plan.outputs else name_on("rtde", name)
        if own is None:
            return super()._hint(name)
        return self._field_hint(own) if own in self._plan.outputs else f"; request it with robot.rtde.outputs({own!r})"

    @property
    def _dialogue(self) -> RtdeProtocol | None:
        return None if self._transport is None else self._transport.dialogue

    @property
    def recipe(self) -> Recipe | None:
        """Names and types of the received variables, in order; None before the first connection."""
        dialogue = self._dialogue
        return self._plan.recorded if dialogue is None else dialogue.recipe

    @property
    def left_out(self) -> tuple[str, ...]:
        """Requested variables that the controller does not have; they read as None."""
        recipe = self.recipe
        return () if recipe is None else tuple(name for name in self.names if name not in recipe.names)

    @property
    def controller(self) -> Firmware | None:
        """Firmware that the controller reported on this connection; None before the first, and for a recording."""
        dialogue = self._dialogue
        return None if dialogue is None else dialogue.controller

    @property
    def is_over(self) -> bool:
        """Whether no more states will arrive, because the stream was closed or the recording has ended."""
        return self._connection.is_over

    def description(self) -> dict[str, Any]:
        """Connect if necessary, and return the recipe for the description of a recording.

        The recipe is stored with a recording, because a recording can start after the controller has sent the recipe.

        Raises:
            RemoteError, LocalError, Closed: See `start`.
        """
        self.start()
        recipe = self.recipe
        assert recipe is not None, "a connected stream has its recipe"
        return {
            "asked": list(self.names),
            "frequency": self.frequency,
            "names": list(recipe.names),
            "types": list(recipe.types),
            "number": recipe.number,
        }

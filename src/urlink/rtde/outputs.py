"""The stream of one recipe of outputs: what users iterate, subscribe to, and record."""

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

from ..foreign_names import name_on
from ..protocol.firmware import Firmware
from ..protocol.rtde.packets import REPLIES
from ..protocol.rtde.protocol import Requests, RtdeProtocol, check_names
from ..protocol.rtde.recipes import Outputs, Recipe
from ..protocol.rtde.transport import RtdeTransport

if TYPE_CHECKING:
    from ..session.source import Source

T = TypeVar("T", bound=Outputs)

#: Packets that a controller may send late or not at all, before a connection counts as lost.
_LATE = 5


def declared(kind: type[Outputs]) -> tuple[tuple[str, ...], frozenset[str]]:
    """The variables that a class declares as annotations, and those among them that may be None.

    Raises:
        BadValue: it declares none, or one that cannot be asked for.
    """
    names: dict[str, Any] = {}
    for base in reversed(kind.__mro__):
        if issubclass(base, Outputs) and base is not Outputs:
            names |= inspect.get_annotations(base)
    if not names:
        raise BadValue(f"{kind.__name__} declares no variable; expected something like 'actual_q: Vector'")
    return check_names(tuple(names)), frozenset(name for name, hint in names.items() if _may_be_none(hint))


def _may_be_none(hint: Any) -> bool:
    if isinstance(hint, str):  # from __future__ import annotations
        return re.search(r"\b(None|Optional)\b", hint) is not None
    return type(None) in get_args(hint)


def connection_of(name: str, transport: Transport, plan: Requests, source: Source) -> Connection:
    """A connection that asks for what the plan says, each time it is made; it is kept up as the source says."""
    silence = source.silence
    if silence is not None and plan.frequency is not None:
        silence = max(silence, _LATE / plan.frequency)
    fan_out = FanOut(plan.kind, parts=lambda packet: (), others=tuple(REPLIES.values()))
    backoff, timeout = source.backoff, source.timeout
    return source.connection(
        name, transport, lambda: RtdeProtocol(plan), fan_out, backoff=backoff, timeout=timeout, silence=silence
    )


def recorded_plan(info: Mapping[str, Any], kind: type[Outputs]) -> Requests:
    """The plan of a recorded stream, from the description of its channel.

    Raises:
        BadRecording: it does not say what it should.
    """
    try:
        recipe = Recipe(info["names"], info["types"], info["number"])
        return Requests(tuple(info["asked"]), info["frequency"], frozenset(info["asked"]), kind=kind, recorded=recipe)
    except (KeyError, TypeError, BadValue) as error:
        raise BadRecording(f"the recording does not say which RTDE variables it holds ({error})") from None


class OutputStream(Stream[T], Closing):
    """The data packages of one recipe, on a connection of its own. Made by `Rtde.outputs`.

    Text from the controller and its replies come on it too: ``stream.of(RtdeMessage)``.

    Attributes:
        names: of the variables that were asked for.
        frequency: packages a second that were asked for; None for the most that the controller sends.
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
        return self._field_hint(own) if own in self._plan.outputs else f"; ask for it: robot.rtde.outputs({own!r})"

    @property
    def _dialogue(self) -> RtdeProtocol | None:
        return None if self._transport is None else self._transport.dialogue

    @property
    def recipe(self) -> Recipe | None:
        """Names and types of what comes, in order; None before the first connection."""
        dialogue = self._dialogue
        return self._plan.recorded if dialogue is None else dialogue.recipe

    @property
    def left_out(self) -> tuple[str, ...]:
        """Variables that were asked for and that the controller does not have; they read as None."""
        recipe = self.recipe
        return () if recipe is None else tuple(name for name in self.names if name not in recipe.names)

    @property
    def controller(self) -> Firmware | None:
        """The controller's version, from this connection; None before the first, and of a recording."""
        dialogue = self._dialogue
        return None if dialogue is None else dialogue.controller

    @property
    def is_over(self) -> bool:
        """No state will ever come again: it was closed, or a recording has ended."""
        return self._connection.is_over

    def description(self) -> dict[str, Any]:
        """The recipe, which a recording needs, since it may begin after the controller has sent it; connects for that.

        Raises:
            RemoteError, LocalError, Closed: as `start`.
        """
        self.start()
        recipe = self.recipe
        assert recipe is not None, "a connection that has been made has its recipe"
        return {
            "asked": list(self.names),
            "frequency": self.frequency,
            "names": list(recipe.names),
            "types": list(recipe.types),
            "number": recipe.number,
        }

"""Transport that answers RTDE requests like a controller, or with the answers of a test."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

from linkcore.wire.framing import Framer
from linkcore.wire.packet import State
from tests.fakes.link import ScriptedTransport
from urlink.protocol.rtde.packets import (
    ControllerVersionReply,
    ControllerVersionRequest,
    DataPackage,
    InputsReply,
    InputsRequest,
    OutputsReply,
    OutputsRequest,
    PauseReply,
    PauseRequest,
    Protocol,
    ProtocolReply,
    ProtocolRequest,
    RtdeBoundary,
    StartReply,
    StartRequest,
    decode_request,
    split_names,
)
from urlink.protocol.rtde.recipes import Recipe
from urlink.protocol.rtde.variables import IN_USE, INPUTS, NOT_FOUND, OUTPUTS

#: Function that replaces an answer: it gets the decoded request and returns the packages to send.
Answer = Callable[[Any], list[State]]


class RequestBoundary(RtdeBoundary):
    """Frame boundaries of the packages of a client."""

    sizes: Mapping[int, range] = MappingProxyType(
        {
            ord("V"): range(5, 6),
            ord("v"): range(3, 4),
            ord("O"): range(3, 1 << 14),
            ord("I"): range(3, 1 << 14),
            ord("S"): range(3, 4),
            ord("P"): range(3, 4),
            ord("M"): range(6, 517),
            ord("U"): range(4, 1 << 14),
        }
    )


class ScriptedRtde(ScriptedTransport):
    """Controller that has all variables except those in `lacks`; inputs in `held` are in use.

    `answers` replaces the answers to some classes of requests. `asked` lists the received requests. `written` maps the
    names of inputs that data packages wrote to their values.
    """

    def __init__(self, *openings: Exception | None) -> None:
        super().__init__(*openings)
        self.protocol: Protocol = 1
        self.protocols: set[Protocol] = {1, 2}
        self.firmware = (5, 11, 0, 0)
        self.lacks: set[str] = set()
        self.held: set[str] = set()
        self.answers: dict[type[State], Answer] = {}
        self.asked: list[Any] = []
        self.written: dict[str, Any] = {}
        self.outputs: Recipe | None = None
        self.claims: dict[int, Recipe] = {}
        self._framer = Framer(RequestBoundary())

    def open(self, timeout: float) -> None:
        super().open(timeout)
        self.protocol, self.outputs, self.claims = 1, None, {}
        self._framer = Framer(RequestBoundary())

    def send(self, data: bytes, timeout: float) -> None:
        super().send(data, timeout)
        self._take(data)

    def send_some(self, data: bytes | memoryview) -> int:
        count = super().send_some(data)
        self._take(bytes(data[:count]))
        return count

    def _take(self, data: bytes) -> None:
        for frame in self._framer.feed(data):
            request: Any = decode_request(frame, self.protocol)
            self.asked.append(request)
            answers = self.answers.get(type(request), self.usual)(request)
            if answers:
                self.put(b"".join(map(bytes, answers)))
            if isinstance(request, ProtocolRequest) and request.wanted in self.protocols:
                self.protocol = 2 if request.wanted == 2 else 1

    def usual(self, request: Any) -> list[State]:
        """Return the answers that a controller would send."""
        version = f"{self.protocol}.0"
        if isinstance(request, ProtocolRequest):
            return [ProtocolReply(accepted=request.wanted in self.protocols)]
        if isinstance(request, ControllerVersionRequest):
            return [ControllerVersionReply(**dict(zip(("major", "minor", "bugfix"), self.firmware, strict=False)))]
        if isinstance(request, OutputsRequest):
            names = split_names(request.names)
            types = [OUTPUTS[name].type if name in OUTPUTS.keys() - self.lacks else NOT_FOUND for name in names]
            is_valid = NOT_FOUND not in types
            if is_valid:
                self.outputs = Recipe(names, types, 1 if self.protocol == 2 else None)
            return [OutputsReply(version, recipe=int(is_valid), types=",".join(types))]
        if isinstance(request, InputsRequest):
            names = split_names(request.names)
            types = [self.input_type(name) for name in names]
            number = len(self.claims) + 1
            if {NOT_FOUND, IN_USE} & set(types):
                return [InputsReply(recipe=0, types=",".join(types))]
            self.claims[number] = Recipe(names, types, number, INPUTS)
            return [InputsReply(recipe=number, types=",".join(types))]
        if isinstance(request, StartRequest):
            return [StartReply(accepted=True), *([] if self.outputs is None else [self.data()])]
        if isinstance(request, PauseRequest):
            return [PauseReply(accepted=True)]
        if isinstance(request, DataPackage) and request.recipe in self.claims:
            self.written |= self.claims[request.recipe].decode(bytes(request))
        return []

    def input_type(self, name: str) -> str:
        return (
            NOT_FOUND if name not in INPUTS.keys() - self.lacks else IN_USE if name in self.held else INPUTS[name].type
        )

    def data(self, **values: Any) -> State:
        """Return a data package of the current output recipe."""
        assert self.outputs is not None
        version = f"{self.protocol}.0"
        return DataPackage.LAYOUTS.of(version).decode(self.outputs.encode(values))  # type: ignore[no-any-return]

    def send_values(self, **values: Any) -> None:
        """Send a data package."""
        self.put(bytes(self.data(**values)))

"""An RTDE client made of plain bytes, at a controller that is stepped: no thread, no socket, no code of the client."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Any

from urlink.protocol.rtde.recipes import Recipe
from urlink.protocol.rtde.variables import INPUTS, OUTPUTS
from urlink.simulator import Controller

__all__ = ["Peer", "package", "packages", "step"]


def package(kind: str, payload: bytes = b"") -> bytes:
    """A whole package."""
    return struct.pack(">HB", 3 + len(payload), ord(kind)) + payload


def packages(data: bytes) -> list[tuple[str, bytes]]:
    """(type, payload) of each package in a stream of whole ones."""
    found = []
    while data:
        size, kind = struct.unpack_from(">HB", data)
        assert 3 <= size <= len(data), f"{size} of {len(data)} bytes"
        found.append((chr(kind), data[3:size]))
        data = data[size:]
    return found


def step(controller: Controller, cycles: int = 1) -> None:
    """Let cycles pass, as the server does."""
    for _ in range(cycles):
        controller.step()
        controller.rtde.packets(controller.cycle)


class Peer:
    """One connection.

    Attributes:
        is_open: the controller has not closed it.
        pending: bytes that the peer has not read, for the controller to see.
        sent: what the controller has sent and was not taken.
    """

    def __init__(self, controller: Controller, protocol: int = 2) -> None:
        self.is_open = True
        self.pending = 0
        self.sent = bytearray()
        self.recipe: Recipe | None = None
        self.session = controller.rtde.receiver(self)
        self.protocol = 1
        for greeting in controller.rtde.greeting():
            self.send(greeting)
        if protocol == 2:
            assert self.ask("V", b"\0\2") == b"\1"
            self.protocol = 2

    # -- as the controller sees it ---------------------------------------------------------------------

    def send(self, packet: bytes) -> None:
        assert self.is_open
        self.sent += packet

    def finish(self) -> None:
        self.is_open = False

    def drop(self) -> None:
        if self.is_open:
            self.close()

    # -- as its user does ------------------------------------------------------------------------------

    def close(self) -> None:
        """The connection is over."""
        self.is_open = False
        self.session.end()

    def put(self, kind: str, payload: bytes = b"") -> None:
        self.session.feed(package(kind, payload))

    def take(self) -> list[tuple[str, bytes]]:
        """What has come since this was last asked."""
        found = packages(bytes(self.sent))
        self.sent.clear()
        return found

    def ask(self, kind: str, payload: bytes = b"") -> bytes:
        """Payload of the reply, which is the only package that came."""
        self.put(kind, payload)
        (reply,) = self.take()
        assert reply[0] == kind, reply
        return reply[1]

    def outputs(self, *names: str, frequency: float = 500.0) -> tuple[int, list[str]]:
        """Set up outputs: number of the recipe (of protocol 1: 1 if it is good) and types."""
        head = struct.pack(">d", frequency) if self.protocol == 2 else b""
        reply = self.ask("O", head + ",".join(names).encode())
        number, text = (reply[0], reply[1:]) if self.protocol == 2 else (int(b"NOT_FOUND" not in reply), reply)
        types = text.decode().split(",")
        if number:
            known = [name.strip() for name in names if name.strip()]
            self.recipe = Recipe(known, types, number if self.protocol == 2 else None)
        return number, types

    def inputs(self, *names: str) -> tuple[int, list[str]]:
        """Set up inputs: number of the recipe, and types."""
        reply = self.ask("I", ",".join(names).encode())
        return reply[0], reply[1:].decode().split(",")

    def write(self, number: int, **values: Any) -> None:
        """A data package with a value for each name of the recipe, in its order."""
        recipe = Recipe(list(values), [INPUTS[name].type for name in values], number, INPUTS)
        self.session.feed(recipe.encode(values))

    def start(self) -> bool:
        return self.ask("S") == b"\1"

    def data(self) -> list[dict[str, Any]]:
        """The data packages that have come."""
        assert self.recipe is not None
        found = self.take()
        assert {kind for kind, _ in found} <= {"U"}, found
        return [self.recipe.decode(package(kind, payload)) for kind, payload in found]


def types_of(names: Sequence[str]) -> list[str]:
    """As the table has them."""
    return [OUTPUTS[name].type for name in names]

"""Byte-level RTDE client for a stepped controller, without threads, sockets or client code of the library."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Any

from urlink.protocol.rtde.recipes import Recipe
from urlink.protocol.rtde.variables import INPUTS, OUTPUTS
from urlink.simulator import Controller

__all__ = ["Peer", "package", "packages", "step"]


def package(kind: str, payload: bytes = b"") -> bytes:
    """Return a complete package of this type."""
    return struct.pack(">HB", 3 + len(payload), ord(kind)) + payload


def packages(data: bytes) -> list[tuple[str, bytes]]:
    """Return the type and payload of each package in a stream of complete packages."""
    found = []
    while data:
        size, kind = struct.unpack_from(">HB", data)
        assert 3 <= size <= len(data), f"{size} of {len(data)} bytes"
        found.append((chr(kind), data[3:size]))
        data = data[size:]
    return found


def step(controller: Controller, cycles: int = 1) -> None:
    """Run control cycles in the same way as the server."""
    for _ in range(cycles):
        controller.step()
        controller.rtde.packets(controller.cycle)


class Peer:
    """Connection of one client to the RTDE interface of a controller.

    Attributes:
        is_open: Whether the controller has not closed the connection.
        pending: Number of bytes that the peer has not read, as the controller sees it.
        sent: Bytes that the controller has sent and that the test has not taken yet.
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

    # -- calls by the controller ---------------------------------------------------------------------

    def send(self, packet: bytes) -> None:
        assert self.is_open
        self.sent += packet

    def finish(self) -> None:
        self.is_open = False

    def drop(self) -> None:
        if self.is_open:
            self.close()

    # -- calls by a test -----------------------------------------------------------------------------

    def close(self) -> None:
        """End the connection."""
        self.is_open = False
        self.session.end()

    def put(self, kind: str, payload: bytes = b"") -> None:
        self.session.feed(package(kind, payload))

    def take(self) -> list[tuple[str, bytes]]:
        """Return and remove the packages that arrived since the last call."""
        found = packages(bytes(self.sent))
        self.sent.clear()
        return found

    def ask(self, kind: str, payload: bytes = b"") -> bytes:
        """Send a request and return the payload of the reply, which must be the only package."""
        self.put(kind, payload)
        (reply,) = self.take()
        assert reply[0] == kind, reply
        return reply[1]

    def outputs(self, *names: str, frequency: float = 500.0) -> tuple[int, list[str]]:
        """Set up outputs and return the recipe number (protocol 1: 1 if accepted, else 0) and the types."""
        head = struct.pack(">d", frequency) if self.protocol == 2 else b""
        reply = self.ask("O", head + ",".join(names).encode())
        number, text = (reply[0], reply[1:]) if self.protocol == 2 else (int(b"NOT_FOUND" not in reply), reply)
        types = text.decode().split(",")
        if number:
            known = [name.strip() for name in names if name.strip()]
            self.recipe = Recipe(known, types, number if self.protocol == 2 else None)
        return number, types

    def inputs(self, *names: str) -> tuple[int, list[str]]:
        """Set up inputs and return the recipe number and the types."""
        reply = self.ask("I", ",".join(names).encode())
        return reply[0], reply[1:].decode().split(",")

    def write(self, number: int, **values: Any) -> None:
        """Send a data package with a value for each name of the recipe, in the order of the recipe."""
        recipe = Recipe(list(values), [INPUTS[name].type for name in values], number, INPUTS)
        self.session.feed(recipe.encode(values))

    def start(self) -> bool:
        return self.ask("S") == b"\1"

    def data(self) -> list[dict[str, Any]]:
        """Return the values of the data packages that arrived since the last call."""
        assert self.recipe is not None
        found = self.take()
        assert {kind for kind, _ in found} <= {"U"}, found
        return [self.recipe.decode(package(kind, payload)) for kind, payload in found]


def types_of(names: Sequence[str]) -> list[str]:
    """Return the types of these outputs according to the table."""
    return [OUTPUTS[name].type for name in names]

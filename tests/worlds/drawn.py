"""Worlds as a seed draws them: a controller, its clients and what they do, and what happens to cables and computers.

A world is data, so that one in which something went wrong can be made smaller, and printed.
"""

from __future__ import annotations

import random
from dataclasses import dataclass, replace

from urlink.firmware import RELEASES

#: What a client asks for; `asked.BEGIN` has a function for each.
ASKED = (
    "move_joints",
    "move_linear",
    "path",
    "speed_joints",
    "speed_linear",
    "follow",
    "follow_rtde",
    "servo",
    "servo_rtde",
    "jog",
    "force_mode",
    "script",
    "output",
)
#: How it goes on after that.
THEN = ("wait", "wait_briefly", "cancel", "leave", "interrupt", "forget")
#: What happens beside the clients: at the pendant, to the network, to computers.
HAPPENS = (
    "protective_stop",
    "emergency_stop",
    "pendant_stop",
    "pendant_pause",
    "slider",
    "cut",
    "deaf",
    "mute",
    "reset",
    "suspend_client",
    "suspend_robot",
    "kill_client",
    "hold_client",
)


@dataclass(frozen=True)
class Ask:
    """One thing that a client asks for.

    Attributes:
        what: of `ASKED`.
        then: of `THEN`.
        after: seconds before it is asked for.
        size: 0 to 1: how far, how fast.
        patience: seconds until `then` is done, where it is not done at once.
    """

    what: str
    then: str
    after: float
    size: float
    patience: float


@dataclass(frozen=True)
class Client:
    """A program on a computer of its own, which asks for one thing after the other."""

    asks: tuple[Ask, ...]
    drift: float


@dataclass(frozen=True)
class Event:
    """Something that happens.

    Attributes:
        what: of `HAPPENS`.
        at: seconds after the clients have begun.
        lasts: seconds until it is undone, where it can be.
        client: number of the client that it concerns.
        size: 0 to 1.
    """

    what: str
    at: float
    lasts: float
    client: int
    size: float


@dataclass(frozen=True)
class World:
    """Everything that a run depends on, beside the order of its threads, which `seed` decides."""

    seed: int
    firmware: str
    latency: float
    jitter: float
    clients: tuple[Client, ...]
    events: tuple[Event, ...]

    def smaller(self) -> list[World]:
        """The same with one client, one event or one thing asked for less."""
        found = []
        if len(self.clients) > 1:
            for number in range(len(self.clients)):
                events = tuple(
                    replace(event, client=event.client - (event.client > number))
                    for event in self.events
                    if event.client != number
                )
                rest = self.clients[:number] + self.clients[number + 1 :]
                found.append(replace(self, clients=rest, events=events))
        found += [
            replace(self, events=self.events[:number] + self.events[number + 1 :]) for number in range(len(self.events))
        ]
        for number, client in enumerate(self.clients):
            for place in range(len(client.asks)):
                fewer = replace(client, asks=client.asks[:place] + client.asks[place + 1 :])
                found.append(replace(self, clients=(*self.clients[:number], fewer, *self.clients[number + 1 :])))
        return found


def draw(seed: int) -> World:
    """The world of a seed."""
    chance = random.Random(seed)

    def ask() -> Ask:
        return Ask(
            chance.choice(ASKED),
            chance.choice(THEN),
            chance.choice((0.0, 0.0, 0.01, 0.3)) * chance.random(),
            chance.random(),
            chance.choice((0.002, 0.05, 0.5)) * chance.random(),
        )

    clients = tuple(
        Client(tuple(ask() for _ in range(chance.randint(1, 5))), chance.uniform(-1e-4, 1e-4))
        for _ in range(chance.choice((1, 1, 2, 3)))
    )
    events = tuple(
        Event(
            chance.choice(HAPPENS),
            chance.choice((0.2, 0.5, 2.0)) * chance.random(),
            chance.choice((0.02, 0.3, 1.5, 6.0)) * chance.random(),
            chance.randrange(len(clients)),
            chance.random(),
        )
        for _ in range(chance.choice((0, 1, 1, 2, 4)))
    )
    firmware = chance.choice([str(row.since) for row in RELEASES])
    return World(seed, firmware, chance.choice((5e-5, 5e-4, 5e-3)), chance.choice((0.0, 2e-4, 2e-3)), clients, events)

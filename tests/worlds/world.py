"""Worlds: a controller, clients with their requests, and events of cables and computers.

A world is data, so that a world with a fault can be made smaller, printed, and pasted into a test.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, TypeVar

T = TypeVar("T", "World", "Client", "Ask", "Event")

#: Motions that end on their own, motions that last as long as a block, and calls that do not move the arm.
MOTIONS = (
    "move_joints",
    "move_linear",
    "move_circular",
    "path",
    "taught",
    "speed_joints",
    "speed_linear",
    "speed_held",
    "speed_held_rtde",
    "stop",
    "until_contact",
    "follow",
    "follow_rtde",
    "follow_low_bandwidth",
    "script",
    "misspelt_script",
    "failing_script",
    "statements",
)
BLOCKS = (
    "servo",
    "servo_rtde",
    "servo_filtered",
    "stream",
    "jog",
    "jog_rtde",
    "force_mode",
    "force_mode_rtde",
    "torque",
    "torque_rtde",
    "freedrive",
    "freedrive_rtde",
    "teach",
    "interpreter",
)
CALLS = (
    "output",
    "analog_output",
    "slider",
    "payload",
    "tcp",
    "zero_force_sensor",
    "popup",
    "secondary_script",
    "line",
    "gripper",
    "registers",
    "inputs",
    "outputs",
    "who_holds",
    "subscribe",
    "iterate",
    "wait_state",
    "enable",
    "wait_until_clear",
    "cancel_current",
    "close",
    "load",
    "play",
    "pause",
    "stop_program",
    "power_off",
    "start",
    "unlock",
    "dashboard_popup",
    "program_state",
)
#: Requests of a client of each kind; `asked` has a function for each request.
ASKED = {
    "threads": MOTIONS + BLOCKS + CALLS,
    "asyncio": MOTIONS + BLOCKS + CALLS,
    "rtde": ("registers", "inputs", "outputs", "outputs", "who_holds"),
    "dashboard": (
        "load",
        "play",
        "play",
        "pause",
        "stop_program",
        "power_off",
        "start",
        "unlock",
        "dashboard_popup",
        "program_state",
    ),
    "ur_rtde": ("moveJ", "moveL", "servoJ", "speedJ", "jogStart", "forceMode", "freedriveMode", "stopJ", "sendScript"),
    "urx": ("movej", "movel", "movejs", "speedj", "translate", "stopj", "getj"),
    "foreign": (
        "script",
        "line",
        "partial",
        "garbage",
        "silence",
        "many",
        "rtde_frame",
        "rtde_partial",
        "rtde_claim",
        "dashboard_line",
        "dashboard_flood",
    ),
}
#: Actions of a client after its request.
THEN = ("wait", "wait_briefly", "cancel", "leave", "interrupt", "forget")
#: The same actions, and a signal that comes meanwhile.
THEN_OR_SIGNAL = (*THEN, "signal", "signal")
#: Events that clients do not cause: at the pendant and to the arm, to the network and to computers.
AT_THE_ROBOT = (
    "protective_stop",
    "safeguard_stop",
    "emergency_stop",
    "power_off",
    "reboot",
    "pendant_stop",
    "pendant_pause",
    "pendant_play",
    "pendant_jog",
    "slider",
    "local_control",
    "teach_button",
    "push",
    "stall",
    "cut_port",
    "split",
    "garbage",
    "rtde_late",
    "rtde_stale",
)
HAPPENS = (
    *AT_THE_ROBOT,
    "cut",
    "deaf",
    "mute",
    "reset",
    "refused",
    "slow",
    "suspend_client",
    "suspend_robot",
    "kill_client",
    "power_client",
    "hold_client",
)

#: Events in worlds whose actions come from `surface`, in addition to `HAPPENS`.
LACKS = ("no_threads", "clock_jumps")

#: Stops, and events of the connection between two computers.
STOPS = ("protective_stop", "safeguard_stop", "emergency_stop", "pendant_stop", "pendant_pause")
CABLES = ("cut", "deaf", "mute", "reset", "suspend_client", "suspend_robot", "hold_client")


@dataclass(frozen=True)
class Ask:
    """Request of a client.

    Attributes:
        what: Request, one of `ASKED`.
        then: Action afterwards, one of `THEN`.
        after: Delay before the request, in s.
        size: Distance, speed or choice, from 0 to 1.
        patience: Delay before `then`, unless it follows immediately, in s.
        thread: Number of the client's thread or task that makes the request.
        at: Earliest time of the request after the start of the clients, in s.
    """

    what: str
    then: str
    after: float
    size: float
    patience: float
    thread: int = 0
    at: float = 0.0


@dataclass(frozen=True)
class Client:
    """Client program with its own computer. Each of its threads makes one request after another.

    Attributes:
        asks: Requests of all threads.
        drift: Drift of its clock, in seconds per second; positive if it is fast.
        kind: Kind of the client, one of `ASKED`.
        policy: Argument `require_enable` of `urlink.connect`.
        start: Place of the start permission of its programs: "register" or "flags".
    """

    asks: tuple[Ask, ...]
    drift: float
    kind: str = "threads"
    policy: str = "never"
    start: str = "register"


@dataclass(frozen=True)
class Event:
    """Event of a world.

    Attributes:
        what: Kind of the event, one of `HAPPENS`.
        at: Delay after the request `ask` of the client, or after the start of the clients, in s.
        lasts: Time until the event is undone, if it can be undone, in s.
        client: Number of the affected client.
        size: Size of the event, from 0 to 1.
        ask: Number of a request of the client; None for the start.
    """

    what: str
    at: float
    lasts: float
    client: int
    size: float
    ask: int | None = None


@dataclass(frozen=True)
class World:
    """Everything that a run depends on; `seed` decides the order of its threads.

    Attributes:
        lines: Time after the start of the clients in which threads also yield between lines of the library, in s.
    """

    seed: int
    firmware: str
    latency: float
    jitter: float
    clients: tuple[Client, ...]
    events: tuple[Event, ...]
    lines: float = 0.0

    def smaller(self) -> Iterator[World]:
        """Yield worlds with one client, event or request less, and then worlds with simpler and shorter ones."""
        for number in range(len(self.clients) if len(self.clients) > 1 else 0):
            events = tuple(
                replace(event, client=event.client - (event.client > number))
                for event in self.events
                if event.client != number
            )
            yield replace(self, clients=self.clients[:number] + self.clients[number + 1 :], events=events)
        for number in range(len(self.events)):
            yield replace(self, events=self.events[:number] + self.events[number + 1 :])
        for number, client in enumerate(self.clients):
            for place in range(len(client.asks)):
                fewer = replace(client, asks=client.asks[:place] + client.asks[place + 1 :])
                events = tuple(_without(event, number, place) for event in self.events)
                yield replace(self._with(number, fewer), events=events)
        for number, client in enumerate(self.clients):
            yield from (self._with(number, simpler) for simpler in _simpler(client, _SIMPLE_CLIENT))
            for place, ask in enumerate(client.asks):
                for simpler in _simpler(ask, _SIMPLE_ASK):
                    asks = (*client.asks[:place], simpler, *client.asks[place + 1 :])
                    yield self._with(number, replace(client, asks=asks))
        for number, event in enumerate(self.events):
            for shorter in _simpler(event, _SIMPLE_EVENT):
                yield replace(self, events=(*self.events[:number], shorter, *self.events[number + 1 :]))
        yield from _simpler(self, _SIMPLE_WORLD)

    def _with(self, number: int, client: Client) -> World:
        return replace(self, clients=(*self.clients[:number], client, *self.clients[number + 1 :]))


#: Simplest values of the fields.
_SIMPLE_CLIENT: Mapping[str, object] = {"drift": 0.0, "kind": "threads", "policy": "never", "start": "register"}
_SIMPLE_ASK: Mapping[str, object] = {"after": 0.0, "at": 0.0, "patience": 0.0, "size": 1.0, "thread": 0, "then": "wait"}
_SIMPLE_EVENT: Mapping[str, object] = {"at": 0.0, "lasts": 0.0, "size": 1.0}
_SIMPLE_WORLD: Mapping[str, object] = {"lines": 0.0, "latency": 1e-4, "jitter": 0.0, "firmware": "5.10"}


def _simpler(thing: T, simple: Mapping[str, object]) -> Iterator[T]:
    """Yield copies with one field at its simplest value, or rounded."""
    for name, simplest in simple.items():
        value = getattr(thing, name)
        is_kept = name == "kind" and not {ask.what for ask in getattr(thing, "asks", ())} <= set(ASKED["threads"])
        if value == simplest or is_kept:
            continue
        yield _changed(thing, name, simplest)
        if isinstance(value, float) and value != round(value, 2):
            yield _changed(thing, name, round(value, 2))


def _changed(thing: T, name: str, value: object) -> T:
    change: dict[str, Any] = {name: value}
    return replace(thing, **change)


def _without(event: Event, client: int, place: int) -> Event:
    """Return an event after the removal of a request of a client."""
    if event.client != client or event.ask is None or event.ask < place:
        return event
    return replace(event, ask=None if event.ask == place else event.ask - 1)

"""Random worlds, drawn from a seed."""

from __future__ import annotations

import random
from collections.abc import Sequence
from dataclasses import replace

from urlink.protocol.firmware import RELEASES

from .mobile import MOBILE
from .scenes import SCENES
from .surface import ACTIONS
from .trials import AWAITED, TRIALS
from .trials import MOBILE as MOBILE_TRIALS
from .world import (
    ASKED,
    BLOCKS,
    CABLES,
    CALLS,
    HAPPENS,
    LACKS,
    MOTIONS,
    STOPS,
    THEN,
    THEN_OR_SIGNAL,
    Ask,
    Client,
    Event,
    World,
)

_KINDS = ("threads",) * 8 + ("asyncio",) * 4 + ("rtde", "dashboard", "ur_rtde", "urx", "foreign", "foreign")
_FIRMWARES = [str(row.since) for row in RELEASES for _ in range(1 if row.since.is_cb2 else 3)]
#: Share of the worlds of `public` with a mobile robot.
_MOBILE = 0.12
#: Number of consecutive worlds of which one is a varied scene.
_SCENES = 4


#: Actions of `surface` by kind, and the frequency of each kind.
_ACTIONS = {kind: [name for name, each in ACTIONS.items() if each.kind == kind] for kind in ("motion", "block", "call")}
_ACTIONS["block"] += ["motion.jog"] * 2
_ACTION_KINDS = ("motion",) * 4 + ("block",) * 4 + ("call",) * 3
_SITUATIONS = ("race",) * 3 + ("signal",) * 2 + ("lacks", "busy") + ("any", "held") * 2 + ("sweep",) * 3
#: Actions that move the arm with messages over a link, repeated according to their frequency.
_LED = (*(name for name in _ACTIONS["block"] if name.startswith("motion")), "motion.jog", "motion.speed_joints")
#: Actions that end a client: no further request is possible after them.
_ENDS = ("robot.close", "realtime.close", "primary.close", "dashboard.power_off", "dashboard.quit", "rtde.close")
#: Actions that race with a call of another thread.
_ENDING = ("motion.stop", "motion.stop", "close", "cancel_current", "cancel_current", "dashboard.stop", "robot.close")


def draw(seed: int) -> World:
    """Return the world of a seed: every other world has trials, one in four is a scene, and the others have actions."""
    if seed % 2 == 0:
        return tried(seed)
    is_written = seed % _SCENES == 1 or seed // _SCENES % 3 == 0
    return written(seed) if is_written else public(seed)


def tried(seed: int) -> World:
    """Return a world with one or two trials, without other clients or events."""
    chance = random.Random(f"tried {seed}")
    kind = chance.choice(("trials",) * 5 + ("trials in tasks",) * 2 + ("mobile trials",) * 2)
    menus = {"trials": [*TRIALS], "trials in tasks": [*AWAITED], "mobile trials": [*MOBILE_TRIALS]}
    names = chance.sample(sorted(menus[kind]), chance.choice((1, 2)))
    asks = tuple(Ask(name, "wait", 0.0, chance.random(), 0.0) for name in names)
    start = chance.choice(("register",) * 6 + ("flags",))
    client = Client(asks, chance.uniform(-1e-4, 1e-4), kind, "never", start)
    latency, lines = chance.choice((5e-5, 5e-4)), chance.choice((0.0,) * 5 + (0.3, 0.3, 1.0))
    # Fewer states per second make a world faster.
    firmware = chance.choice(("3.15",) * 4 + ("3.10", "5.9", "5.11", "10.12"))
    return World(seed, firmware, latency, 0.0, (client,), (), lines)


def public(seed: int) -> World:
    """Return a world with a few actions of `surface` in a drawn situation."""
    chance = random.Random(f"public {seed}")
    if chance.random() < _MOBILE:
        return _mobile(chance, seed)
    situation = chance.choice(
        ("race",) * 3 + ("signal",) * 2 + ("lacks", "busy") + ("any", "held") * 2 + ("sweep",) * 3
    )
    kind = {"signal": "threads", "busy": "asyncio"}.get(situation, chance.choice(("threads", "asyncio")))
    at = chance.uniform(0.05, 0.2)
    thens = THEN_OR_SIGNAL if situation == "signal" else THEN
    menu = [_action(chance) for _ in range(3)]
    asks = [_public_ask(chance, chance.choice(menu), thens, at) for _ in range(chance.choice((1, 1, 1, 2, 3)))]
    events: list[Event] = []
    if situation == "sweep":
        wanted = [*(_action(chance) for _ in range(3)), *(chance.choice(_ACTIONS["call"]) for _ in range(8))]
        chance.shuffle(wanted)
        asks = [_public_ask(chance, what, ("wait",), at) for what in wanted if what not in _ENDS]
    elif situation == "signal":
        asks[0] = replace(asks[0], then="signal")
    elif situation == "busy":
        busy = Ask("busy", "wait", 0.0, chance.random(), 0.05 * chance.random())
        asks = [busy, *asks, *(_public_ask(chance, chance.choice(("motion.stop", menu[0])), thens, at) for _ in "1")]
    elif situation == "race":
        after = chance.choice((0.0, 0.001, 0.01, 0.1)) * chance.random()
        other = chance.choice(_ENDING) if chance.random() < 0.7 else _action(chance)
        asks = [asks[0], replace(_public_ask(chance, other, thens, at), thread=1, after=after)]
    elif situation == "held":
        # The event comes during a motion that needs messages of this process.
        asks = [replace(asks[0], what=chance.choice(_LED), then=chance.choice(("leave", "wait")))]
        what = chance.choice(("hold_client", "suspend_client", "cut", "kill_client", "protective_stop"))
        events.append(Event(what, 0.1 + 0.5 * chance.random(), 2.0 + chance.random(), 0, chance.random(), 0))
    elif situation == "lacks":
        # Start with a stop, so that everything is connected before threads are lacking.
        asks = [_public_ask(chance, "motion.stop", ("wait",), at), *asks]
        what, after = chance.choice((*LACKS, "no_threads")), chance.choice((0.0, 0.0, 0.01)) * chance.random()
        events.append(Event(what, after, 2.0 * chance.random(), 0, chance.random(), 1))
    if chance.random() < 0.25:
        events.append(_event(chance, at, HAPPENS, (Client(tuple(asks), 0.0),)))
    start = chance.choice(("register",) * 6 + ("flags",))
    clients = [Client(tuple(asks), chance.uniform(-1e-4, 1e-4), kind, "never", start)]
    if chance.random() < 0.15:
        clients.append(_client(chance, at, _menu(chance)))
    latency, jitter = chance.choice((5e-5, 5e-4, 5e-3)), chance.choice((0.0, 2e-4))
    lines = chance.choice((0.0, at + 0.1 * chance.random())) if situation == "race" else 0.0
    # Waiting threads check each state, and this firmware sends fewer states.
    firmware = "3.15" if situation == "busy" else chance.choice(_FIRMWARES)
    return World(seed, firmware, latency, jitter, tuple(clients), tuple(events), lines)


def _mobile(chance: random.Random, seed: int) -> World:
    """Return a world with a client of a mobile robot; the arm stays at rest."""
    menu = [name for name in MOBILE if name.startswith("drive.")] if chance.random() < 0.5 else list(MOBILE)
    menu += ["variables.background", "variables.sync"] * 4
    asks = []
    for _ in range(chance.choice((1, 2, 4))):
        patience = chance.choice((0.05, 0.3)) * chance.random()
        asks.append(Ask(chance.choice(menu), chance.choice(THEN), 0.0, chance.random(), patience))
    events = []
    if chance.random() < 0.3:
        what = chance.choice(("hold_client", "suspend_client", "cut", "reset"))
        events.append(Event(what, 0.3 * chance.random(), 0.3 * chance.random(), 0, 1.0, None))
    lines = chance.choice((0.0, 0.0, 0.3))
    return World(seed, "3.15", 5e-4, 0.0, (Client(tuple(asks), 0.0, "mobile"),), tuple(events), lines)


def _action(chance: random.Random) -> str:
    return chance.choice(_ACTIONS[chance.choice(_ACTION_KINDS)])


def _public_ask(chance: random.Random, what: str, thens: Sequence[str], at: float) -> Ask:
    patience = chance.choice((0.002, 0.05, 0.5, 1.5)) * chance.random()
    return Ask(what, chance.choice(thens), 0.0, chance.random(), patience, 0, at)


def written(seed: int) -> World:
    """Return the world of a seed with actions of `asked`: a few kinds of requests and events, which repeat.

    In every other world they coincide: threads and clients start the same few actions at the same moment, and the
    events come then, too. One in four is a scene instead, with other numbers and other motions.
    """
    chance = random.Random(seed)
    if seed % _SCENES == 1:
        return _varied(chance, seed, chance.choice(list(SCENES.values())))
    meeting = chance.choice((0.0, chance.uniform(0.05, 0.4)))
    shared = _menu(chance) if meeting else ()
    numbers = (1, 1, 2, 2) if meeting else (1, 1, 2, 2, 3)
    clients = tuple(_client(chance, meeting, shared) for _ in range(chance.choice(numbers)))
    menu: Sequence[str] = chance.choice((STOPS, CABLES, HAPPENS, HAPPENS, chance.sample(HAPPENS, 3)))
    events = tuple(_event(chance, meeting, menu, clients) for _ in range(chance.choice((0, 0, 1, 1, 2, 3))))
    latency, jitter = chance.choice((5e-5, 5e-4, 5e-3)), chance.choice((0.0, 2e-4, 2e-3))
    lines = chance.choice((0.0, 0.0, 0.0, meeting + 0.1 * chance.random()))
    return World(seed, chance.choice(_FIRMWARES), latency, jitter, clients, events, lines)


def _menu(chance: random.Random) -> tuple[str, ...]:
    """Draw the requests of a program. Calls are less frequent, because they do not move the arm."""
    return tuple(chance.choice(chance.choice((MOTIONS, MOTIONS, BLOCKS, CALLS))) for _ in range(3))


def _client(chance: random.Random, meeting: float, shared: tuple[str, ...]) -> Client:
    kind = chance.choice(_KINDS)
    menu, threads = ASKED[kind], 1
    if kind in ("threads", "asyncio"):
        menu = shared or _menu(chance)
        threads = chance.choice((1, 2, 2) if meeting else (1, 1, 2, 3))
    number = chance.choice((1, 1, 1, 2)) if meeting else chance.randint(1, 4)
    asks = [_ask(chance, menu, threads) for _ in range(number + threads - 1)]
    if meeting:
        for number, ask in enumerate(asks):
            after = chance.choice((0.0, 0.001, 0.01, 0.05)) * chance.random()
            asks[number] = replace(ask, thread=number % threads, at=meeting, after=after)
    policy = chance.choice(("never",) * 6 + ("on_startup", "always"))
    start = chance.choice(("register",) * 6 + ("flags",))
    return Client(tuple(asks), chance.uniform(-1e-4, 1e-4), kind, policy, start)


def _ask(chance: random.Random, menu: tuple[str, ...], threads: int) -> Ask:
    return Ask(
        chance.choice(menu),
        chance.choice(THEN),
        chance.choice((0.0, 0.0, 0.01, 0.3)) * chance.random(),
        chance.random(),
        chance.choice((0.002, 0.05, 0.5)) * chance.random(),
        chance.randrange(threads),
    )


def _event(chance: random.Random, meeting: float, menu: Sequence[str], clients: tuple[Client, ...]) -> Event:
    client = chance.randrange(len(clients))
    ask = chance.choice((None, *range(len(clients[client].asks))))
    return Event(
        chance.choice(menu),
        chance.choice((0.005, 0.05, 0.3, 1.0)) * chance.random() + (0.0 if ask is not None else meeting),
        chance.choice((0.02, 0.3, 1.0, 2.0)) * chance.random(),
        client,
        chance.random(),
        ask,
    )


def _varied(chance: random.Random, seed: int, scene: World) -> World:
    """Return a scene with some new numbers, and with some requests and events replaced by similar ones."""
    clients = tuple(
        replace(
            client,
            asks=tuple(_varied_ask(chance, ask, client.kind) for ask in client.asks),
            kind=chance.choice((client.kind,) * 3 + ("asyncio",)) if client.kind == "threads" else client.kind,
            drift=chance.uniform(-1e-4, 1e-4),
        )
        for client in scene.clients
    )
    events = [_varied_event(chance, event) for event in scene.events]
    if chance.random() < 0.2:
        events.append(_event(chance, 0.0, HAPPENS, clients))
    firmware = chance.choice((scene.firmware, chance.choice(_FIRMWARES)))
    latency, jitter = chance.choice((scene.latency, scene.latency, 5e-4)), chance.choice((0.0, 0.0, 2e-4))
    lines = chance.choice((scene.lines, scene.lines, scene.lines, 0.1))
    return World(seed, firmware, latency, jitter, clients, tuple(events), lines)


def _varied_ask(chance: random.Random, ask: Ask, kind: str) -> Ask:
    what = ask.what
    if chance.random() < 0.4:
        what = chance.choice(next((each for each in (MOTIONS, BLOCKS, CALLS) if what in each), ASKED[kind]))
    return replace(
        ask,
        what=what,
        then=chance.choice((ask.then,) * 4 + (chance.choice(THEN),)),
        size=chance.choice((ask.size, chance.random())),
        after=_near(chance, ask.after),
        at=_near(chance, ask.at),
        patience=_near(chance, ask.patience),
    )


def _varied_event(chance: random.Random, event: Event) -> Event:
    what = event.what
    if chance.random() < 0.25:
        what = chance.choice(next((each for each in (STOPS, CABLES) if what in each), (what,)))
    return replace(event, what=what, at=_near(chance, event.at), lasts=_near(chance, event.lasts))


def _near(chance: random.Random, seconds: float) -> float:
    """Return these seconds, or a similar number. Two threads that start together mostly still start together."""
    return seconds * chance.choice((1.0, 1.0, chance.uniform(0.5, 1.5)))

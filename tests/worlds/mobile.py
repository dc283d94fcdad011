"""Client of a mobile robot that uses the public methods of variables, the sync thread, `Drive` and the host.

Oracles: the robot moves only while a motion wants it to. A delayed sync thread does not catch up on missed syncs. Each
received update is delivered or counted. Calls end in time. Nothing is sent after `close`.
"""

from __future__ import annotations

import contextlib
import inspect
import itertools
import random
import time
from collections.abc import Callable, Iterator, Mapping
from types import MappingProxyType
from typing import Any

import rhdlink
from linkcore.errors import LinkError
from linkcore.simulated import Computer, Simulation
from rhdlink.client import Variables
from rhdlink.drive import Drive
from rhdlink.host.plugins.turtle import SmrTurtle, Turtle
from rhdlink.sync.sync_thread import SyncThread

from .surface import Drawing, public_methods
from .world import Ask

__all__ = ["MOBILE", "Base", "lacking"]

ADDRESS, PORT = "192.168.0.200", 24902
_TIMEOUT = 1.0
#: Time limit for a call of the client, and for the robot to come to rest after the end of a motion, in s.
_ENDS, _STANDS = 6.0, 1.5
#: Speed above which the robot counts as moving, in m/s.
_MOVES = 0.02

_DRAWERS: Mapping[str, Callable[[Drawing], Any]] = MappingProxyType(
    {
        "distance": lambda d: d.between(0.05, 0.4),
        "speed": lambda d: d.chosen(None, d.between(0.1, 0.4)),
        "angle": lambda d: d.between(-120.0, 120.0),
        "radius": lambda d: d.between(0.2, 0.5),
        "x": lambda d: d.between(-0.3, 0.3),
        "y": lambda d: d.between(-0.3, 0.3),
        "heading": lambda d: d.between(-180.0, 180.0),
        "direction": lambda d: d.between(-180.0, 180.0),
        "kind": lambda d: "bm",
        "side": lambda d: d.chosen("left", "right"),
        "left": lambda d: d.between(-0.2, 0.2),
        "right": lambda d: d.between(-0.2, 0.2),
        "name": lambda d: "tick",
        "timeout": lambda d: d.between(0.05, 2.0),
        "period": lambda d: d.chosen(0.02, 0.05, 0.1),
        "backoff": lambda d: None,
        "callback": lambda d: d.callback(),
        "names": lambda d: (),
        "policy": lambda d: d.chosen(None, rhdlink.latest, rhdlink.drop_oldest(2)),
        "lifespan": lambda d: d.chosen(None, 0.5),
        "deadline": lambda d: d.chosen(None, 0.05),
        "on_deadline": lambda d: None,
    }
)
_LEFT_OUT = {
    "variables.declared": "it reads the class",
    "drive.close": "leaving the block covers it",
}
_OF = {"drive": Drive, "variables": Variables}


def _methods() -> Iterator[tuple[str, Callable[..., Any]]]:
    for part, cls in _OF.items():
        for name, method in public_methods(cls).items():
            if f"{part}.{name}" not in _LEFT_OUT:
                yield f"{part}.{name}", method


#: Public methods of a drive and of a robot's variables, by name.
MOBILE: Mapping[str, Callable[..., Any]] = MappingProxyType(dict(_methods()))


def lacking() -> list[str]:
    """Return the parameters without a drawer."""
    parameters = ((name, list(inspect.signature(method).parameters)[1:]) for name, method in MOBILE.items())
    return [f"{name}.{each}" for name, every in parameters for each in every if each not in _DRAWERS]


class Base:
    """Mobile robot of a world.

    Args:
        sim: Simulation of the world.
        fault: Function that reports a fault.
        is_wheeled: Whether the robot is an SMR; otherwise it accepts velocities.
    """

    def __init__(self, sim: Simulation, fault: Callable[[str], object], *, is_wheeled: bool) -> None:
        self._sim = sim
        self._fault = fault
        self.computer: Computer = sim.computer("base", ADDRESS)
        self.turtle = SmrTurtle() if is_wheeled else Turtle()
        with sim.on(self.computer):
            self._host = rhdlink.Host([self.turtle], port=PORT, address=ADDRESS).start()

    def close(self) -> None:
        """End the host."""
        with self._sim.on(self.computer):
            self._host.close()

    def use(self, asks: tuple[Ask, ...], held: float) -> None:
        """Connect as a client, and make its requests.

        Args:
            asks: Requests of the client.
            held: Time for which the computer of the client may be suspended or its cable cut, in s.
        """
        begun = time.monotonic()
        kind = rhdlink.robots.Smr if isinstance(self.turtle, SmrTurtle) else rhdlink.robots.VelocityOmega
        with rhdlink.connect(f"{ADDRESS}:{PORT}", kind, access="w", timeout=_TIMEOUT) as robot:
            events: list[rhdlink.ConnectionState] = []
            watching = robot.subscribe_connection(lambda event: events.append(event.state))
            if not held:
                self._check_values(robot)
            if any(ask.what.startswith("drive.") for ask in asks):
                with rhdlink.Drive(robot) as drive:
                    self._each(asks, {"drive": drive, "variables": robot}, held)
            else:
                self._each(asks, {"variables": robot}, held)
            self._check_events(robot, events)
            watching.close()
            closing = time.monotonic()
        if time.monotonic() - closing > 2.0 + 1.0 + held:
            self._fault(f"closing a mobile robot took {time.monotonic() - closing:.2f} s")
        if time.monotonic() - begun > 0.5 and not held:
            time.sleep(_STANDS)
            self._check_stands("its client was closed")

    def _check_values(self, robot: Variables) -> None:
        """Check that set values arrive at the plugin, and that values of the plugin are read, one sync later."""
        name = "speedl" if isinstance(self.turtle, SmrTurtle) else "cmdrotvel"
        robot[name] = 7
        for _ in range(3):
            robot.sync()
        if getattr(self.turtle, name) != 7:
            self._fault(f"{name} was set to 7 and synced, but the robot has {getattr(self.turtle, name)}")
        robot[name] = 0
        robot.sync()
        if not robot.fresh("tick") or robot["tick"] <= 0:
            self._fault("the synced tick is not fresh")

    def _check_events(self, robot: Variables, events: list[rhdlink.ConnectionState]) -> None:
        """Check that reconnections are counted, and that each was reported to the subscriber."""
        time.sleep(0.1)
        made = sum(state is rhdlink.ConnectionState.CONNECTED for state in events)
        if robot.reconnects != made:
            self._fault(f"{robot.reconnects} reconnects are counted, but {made} were reported: {events}")
        if any(one is other for one, other in itertools.pairwise(events)):
            self._fault(f"a state of the connection was reported twice: {events}")

    def _each(self, asks: tuple[Ask, ...], parts: Mapping[str, Any], held: float) -> None:
        for ask in asks:
            time.sleep(ask.after)
            begun = time.monotonic()
            with contextlib.suppress(LinkError):
                self._ask(ask, parts)
            took = time.monotonic() - begun
            if took > _ENDS + held + 30.0 * ask.what.startswith("drive."):
                self._fault(f"{ask.what} took {took:.2f} s")

    def _ask(self, ask: Ask, parts: Mapping[str, Any]) -> None:
        part, _, name = ask.what.partition(".")
        drawn = Drawing(random.Random(f"{ask.what} {ask.size}"))
        positional: list[Any] = []
        named: dict[str, Any] = {}
        for each in list(inspect.signature(MOBILE[ask.what]).parameters.values())[1:]:
            if each.kind is each.VAR_POSITIONAL:
                positional += _DRAWERS[each.name](drawn)
            elif each.default is each.empty or drawn.chance.random() < 0.5:
                named[each.name] = _DRAWERS[each.name](drawn)
        made = getattr(parts[part], name)(*positional, **named)
        if isinstance(made, SyncThread):
            self._synced(made, named.get("period"), parts[part], ask)
        elif isinstance(made, rhdlink.variables.Subscription):
            for _ in range(3):
                parts[part].sync()
            made.close()
        elif hasattr(made, "wait") and hasattr(made, "cancel"):
            self._moved(made, ask, drawn)

    def _moved(self, motion: Any, ask: Ask, drawn: Drawing) -> None:
        """Wait for a motion of `Drive`, or end it earlier, and check that the robot comes to rest."""
        if ask.then in ("wait", "leave"):
            with contextlib.suppress(LinkError):
                motion.wait(3.0)
        elif ask.then == "forget":
            return
        else:
            time.sleep(ask.patience)
        motion.cancel()
        time.sleep(_STANDS)
        if ask.what != "drive.wheels":
            self._check_stands(f"{ask.what} ended")

    def _check_stands(self, why: str) -> None:
        speed = abs(self._speed())
        if speed > _MOVES:
            self._fault(f"the mobile robot moves at {speed:.3f} m/s, {_STANDS:g} s after {why}")

    def _speed(self) -> float:
        odometry = self.turtle.world.odometry
        before, at = (odometry.x, odometry.y), self._sim.now
        time.sleep(0.1)
        moved = ((odometry.x - before[0]) ** 2 + (odometry.y - before[1]) ** 2) ** 0.5
        return float(moved / (self._sim.now - at))

    def _synced(self, syncing: SyncThread, period: float | None, robot: Variables, ask: Ask) -> None:
        """Check the times at which a thread syncs, while its host is suspended once."""
        seen: list[float] = []
        until = self._sim.now + 0.6 + ask.patience
        held_at = self._sim.now + 0.2
        self._sim.at(held_at, self.computer.suspend)
        self._sim.at(held_at + 0.05 + 0.3 * ask.size, self.computer.resume)
        syncs = syncing.syncs
        while self._sim.now < until:
            time.sleep(0.001)
            seen += [self._sim.now] * (syncing.syncs - syncs)
            syncs = syncing.syncs
        syncing.close()
        count = syncing.syncs
        time.sleep(0.3)
        if syncing.syncs != count:
            self._fault("a sync thread syncs after it was closed")
        # A late sync may be followed immediately by the next one. Then a whole period must pass.
        for first, third in zip(seen, itertools.islice(seen, 2, None), strict=False):
            if period is not None and third - first < 0.8 * period - 0.012:
                self._fault(f"a sync thread of {period:g} s synced three times in {third - first:.4f} s")
                break

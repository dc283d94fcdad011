"""The link of a mission to its robot, over the network or in this process, and the configuration of that robot.

A link exchanges values once per tick. What a mission does with them is the same for all links.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Protocol

import numpy as np

from linkcore import clock
from linkcore.errors import BadValue, Closed

from ..client import Variables, connect
from ..errors import AccessDenied, WrongVariables
from ..host.config import Element
from ..host.plugin import Plugin, check_methods
from ..variables.database import Database, TimeStamp
from ..variables.declarations import bind, create_variables
from ..variables.value_types import wrapped
from .robot_conf import SMR, VELOMEGA, RobotConf, read_robot_conf

#: The words of read variables, by name.
Words = Mapping[str, Sequence[int]]


class RobotLink(Protocol):
    """A robot, as the loop of a mission needs it."""

    @property
    def name(self) -> str:
        """For messages."""

    @property
    def read(self) -> Mapping[str, int]:
        """Length of each read variable, by name."""

    @property
    def write(self) -> Words:
        """Words of each write variable, by name, as they were at first."""

    @property
    def is_lockstep(self) -> bool:
        """The robot's time stands still between two exchanges."""

    def exchange(self, written: Words, timeout: float | None = None) -> Words:
        """Write, and wait for the answer of the robot's next tick.

        Raises:
            LinkTimeout, ConnectionLost: there was none.
        """

    def close(self) -> None:
        """Give the robot up; it is left as it is. Idempotent."""


class ClientLink:
    """A robot on the network, held by a client of it. For the attributes see `RobotLink`.

    Args:
        robot: connected, with write access.
        is_lockstep: the host waits for each request; nothing tells so.
        owns: `close` closes it.

    Raises:
        AccessDenied: it may not write.
    """

    def __init__(self, robot: Variables, *, is_lockstep: bool = False, owns: bool = False) -> None:
        if robot.access != "w":
            raise AccessDenied(f"{robot.address}: a mission has to write; connect with access='w'")
        self.name = robot.address
        self.is_lockstep = is_lockstep
        self._robot = robot
        self._owns = owns
        self.read: dict[str, int] = {}
        self.write: dict[str, Sequence[int]] = {}
        for variable in robot.variables:
            if variable.direction == "r":
                self.read[variable.name] = variable.length
            else:
                self.write[variable.name] = _listed(robot[variable.name])

    def exchange(self, written: Words, timeout: float | None = None) -> Words:
        """Write, and wait for the answer of the robot's next tick."""
        robot = self._robot
        for name, words in written.items():
            robot[name] = words[0] if len(words) == 1 else words
        robot.sync(timeout)
        return _Fetched(lambda name: _listed(robot[name]))

    def close(self) -> None:
        """Close the connection, if it is this link's own."""
        if self._owns:
            self._robot.close()


class _Fetched(dict[str, Sequence[int]]):
    """The read variables of a tick. A robot may have thousands, of which a mission looks at a few."""

    def __init__(self, fetch: Callable[[str], Sequence[int]]) -> None:
        super().__init__()
        self._fetch = fetch

    def __missing__(self, name: str) -> Sequence[int]:
        words = self[name] = self._fetch(name)
        return words


def _listed(words: Any) -> list[int]:
    return [words] if isinstance(words, int) else words.tolist()


class PluginLink:
    """A robot in this process: its plugins, without a host, a port or a thread. For the attributes see `RobotLink`.

    The plugins are called as a host calls them; this is their `plugin.host`.

    Args:
        plugins: in the order in which they are initialised; they run in the reverse order.
        period: of a tick, s.
        is_realtime: a tick takes that time; otherwise it takes none, and the robot waits in between.

    Attributes:
        period: of a tick, s.
        writers: how many clients may write, for plugins: 1 until the link is closed.
        database: the variables.
        tick: exchanges so far.
    """

    def __init__(self, plugins: Iterable[Plugin], *, period: float = 0.01, is_realtime: bool = False) -> None:
        self._plugins = list(plugins)
        for plugin in self._plugins:
            check_methods(plugin)
        self.period = period
        self.writers = 1
        self.tick = 0
        self.is_lockstep = not is_realtime
        self.name = ", ".join(type(plugin).__name__ for plugin in self._plugins)
        self.database = Database()
        self.database.read.add("tick")
        # Values carry the time of the ticks, and reading a clock for each of them would take longer than the plugins.
        self._now = TimeStamp(0, 0)
        self.database.read.clock = self.database.write.clock = lambda: self._now
        for plugin in self._plugins:
            plugin.name = plugin.name or type(plugin).__name__.lower()
            plugin.host = self
            create_variables(type(plugin), self.database)
            bind(plugin, self.database)
            plugin.init(Element(plugin.name))
        self._running = list(reversed(self._plugins))
        table = self.database.read
        self.read = {row.name: row.length for row in table}
        starts = {row.name: table.start(place) for place, row in enumerate(table)}
        self._places = {name: slice(start, start + self.read[name]) for name, start in starts.items()}
        self.write: dict[str, Sequence[int]] = {
            row.name: self.database.write.value(place).tolist() for place, row in enumerate(self.database.write)
        }
        self._due = clock.now()
        self._is_closed = self._is_stopped = False
        self._call_plugins()

    def exchange(self, written: Words, timeout: float | None = None) -> Words:
        """Write, and let a tick go by. The answer is what was known before the writing had its effect, as of a host.

        Raises:
            BadValue: the link was closed.
            Closed: a plugin has stopped the robot.
        """
        if self._is_closed:
            raise BadValue(f"{self.name}: the link was closed")
        if self._is_stopped:
            raise Closed(f"{self.name}: a plugin has stopped the robot")
        if not self.is_lockstep:
            self._due = max(self._due + self.period, clock.now() - self.period)
            clock.sleep(self._due - clock.now())
        self.tick += 1
        micros = round(self.tick * self.period * 1e6)
        self._now = TimeStamp(micros // 1_000_000, micros % 1_000_000)
        read, write = self.database.read, self.database.write
        read.set(0, wrapped(self.tick))
        write.updated[:] = False
        for name, words in written.items():
            identity = write.find(name)
            if identity is not None:
                write.set(identity, words[0] if len(words) == 1 else np.asarray(words))
                write.updated[identity] = True
        values = read.values.copy()
        self._call_plugins()
        return _Fetched(lambda name: _listed(values[self._places[name]]))

    @property
    def plugins(self) -> tuple[Plugin, ...]:
        """The plugins, in the order in which they were given."""
        return tuple(self._plugins)

    def stop(self) -> None:
        """End after the tick that is running, for plugins: the next `exchange` raises `Closed`."""
        self._is_stopped = True

    def _call_plugins(self) -> None:
        for plugin in self._running:
            plugin.periodic(self.tick)

    def close(self) -> None:
        """Call the plugins once more with no writer left, so that they stop the robot, and terminate them."""
        if self._is_closed:
            return
        self._is_closed = True
        self.writers = 0
        self.database.write.updated[:] = False
        self._call_plugins()
        for plugin in reversed(self._plugins):
            plugin.terminate()


#: The robots that a mission can run on: a connected robot, an address, a plugin such as `Turtle()`, or a link.
AnyRobot = Variables | Plugin | RobotLink | str


def open_link(robot: AnyRobot) -> RobotLink:
    """A link to a robot; whoever asked for it closes it, unless it is `robot` itself.

    Args:
        robot: one that is connected; a plugin such as `Turtle()`, which is run here, in lockstep; an address, which is
            connected to; or a link.

    Raises:
        AccessDenied: it may not be written.
        BadValue: it is nothing of that.
        BadAddress, ConnectFailed, ...: as `rhdlink.connect`.
    """
    if isinstance(robot, Variables):
        return ClientLink(robot)
    if isinstance(robot, Plugin):
        return PluginLink([robot])
    if isinstance(robot, str):
        return ClientLink(connect(robot, access="w"), owns=True)
    if not hasattr(robot, "exchange"):
        raise BadValue(f"robot is {robot!r}; expected a connected robot, an address, or a plugin such as Turtle()")
    return robot


def suitable_conf(conf: RobotConf | str | os.PathLike[str] | None, link: RobotLink) -> RobotConf:
    """The configuration of a robot: as given, or the usual one for the variables that it has.

    Raises:
        BadConfiguration: the file cannot be read.
        WrongVariables: the robot lacks what the configuration needs; all of it is listed.
    """
    if conf is None:
        conf = VELOMEGA if "cmdtransvel" in link.write else SMR
        period = getattr(link, "period", conf.period)
        conf = replace(conf, period=period, motion=replace(conf.motion, period=period))
    elif not isinstance(conf, RobotConf):
        conf = read_robot_conf(conf, robot=link.name.rpartition(":")[0])
    lacking = [f"there is no read variable {name}" for name in conf.reads if name not in link.read]
    lacking += [f"there is no write variable {name}" for name in conf.writes if name not in link.write]
    if lacking:
        raise WrongVariables([f"a {conf.drive.value} robot is driven by others", *lacking])
    return conf

"""Link of a mission to its robot, over the network or in this process.

A link exchanges values once per tick. A mission uses all kinds of links in the same way. The module also finds the
configuration of the robot.
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
from ..host.plugin import Plugin, check_methods, initialise
from ..variables.database import Database, TimeStamp
from ..variables.value_types import wrapped
from .robot_conf import ROBOBOT, SMR, VELOMEGA, RobotConf, read_robot_conf

#: Words of variables, by name.
Words = Mapping[str, Sequence[int]]


class RobotLink(Protocol):
    """Interface of a robot that the loop of a mission uses."""

    @property
    def name(self) -> str:
        """Name of the robot, used in error messages and thread names."""

    @property
    def read(self) -> Mapping[str, int]:
        """Length of each read variable, by name."""

    @property
    def write(self) -> Words:
        """Initial words of each write variable, by name."""

    @property
    def is_lockstep(self) -> bool:
        """Whether the robot's time stops between two exchanges."""

    def exchange(self, written: Words, timeout: float | None = None) -> Words:
        """Write values, and wait for the answer of the robot's next tick.

        Raises:
            LinkTimeout, ConnectionLost: If there is no answer.
        """

    def close(self) -> None:
        """Release the robot without changing its state. Idempotent."""


class ClientLink:
    """Link to a robot on the network, over a client. For the attributes, see `RobotLink`.

    Args:
        robot: Robot that is connected with write access.
        is_lockstep: Whether the host waits for each request. The protocol does not show this.
        owns: Whether `close` closes the robot object.

    Raises:
        AccessDenied: If the robot was connected without write access.
    """

    def __init__(self, robot: Variables, *, is_lockstep: bool = False, owns: bool = False) -> None:
        if robot.access != "w":
            raise AccessDenied(f"{robot.address}: a mission needs write access; connect with access='w'")
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
        """Write values, and wait for the answer of the robot's next tick."""
        robot = self._robot
        for name, words in written.items():
            robot[name] = words[0] if len(words) == 1 else words
        robot.sync(timeout)
        return _Fetched(lambda name: _listed(robot[name]))

    def close(self) -> None:
        """Close the connection, if it belongs to this link."""
        if self._owns:
            self._robot.close()


class _Fetched(dict[str, Sequence[int]]):
    """Read variables of a tick, fetched on demand.

    A robot can have thousands of variables, but a mission needs only a few of them.
    """

    def __init__(self, fetch: Callable[[str], Sequence[int]]) -> None:
        super().__init__()
        self._fetch = fetch

    def __missing__(self, name: str) -> Sequence[int]:
        words = self[name] = self._fetch(name)
        return words


def _listed(words: Any) -> list[int]:
    return [words] if isinstance(words, int) else words.tolist()


class PluginLink:
    """Link to a robot in this process: its plugins run without a host, a port or a thread.

    The link calls the plugins in the same way as a host, and is their `plugin.host`. For the attributes, see
    `RobotLink`.

    Args:
        plugins: Plugins, in the order of their initialisation. They run in the reverse order.
        period: Duration of a tick, in s.
        is_realtime: Whether a tick takes this duration. Otherwise a tick takes no time, and the robot waits between
            ticks.

    Attributes:
        period: Duration of a tick, in s.
        writers: Number of clients that may write, for plugins: 1 until the link is closed, then 0.
        database: Variables of the robot.
        tick: Number of exchanges so far.
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
        # Values carry the time of the ticks. Reading a clock for each value would take longer than the plugins
        # themselves.
        self._now = TimeStamp(0, 0)
        self.database.read.clock = self.database.write.clock = lambda: self._now
        for plugin in self._plugins:
            initialise(plugin, self)
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
        """Write values, and execute one tick.

        As with a host, the answer does not yet show the effect of these values.

        Raises:
            BadValue: If the link was closed.
            Closed: If a plugin has stopped the robot.
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
        """Plugins, in the given order."""
        return tuple(self._plugins)

    def stop(self) -> None:
        """End after the current tick; called by plugins. The next `exchange` raises `Closed`."""
        self._is_stopped = True

    def _call_plugins(self) -> None:
        for plugin in self._running:
            plugin.periodic(self.tick)

    def close(self) -> None:
        """Call the plugins with no writer, so that they stop the robot, and terminate them."""
        if self._is_closed:
            return
        self._is_closed = True
        self.writers = 0
        self.database.write.updated[:] = False
        self._call_plugins()
        for plugin in reversed(self._plugins):
            plugin.terminate()


#: Robot on which a mission can run: a connected robot, an address, a plugin such as `Turtle()`, or a link.
AnyRobot = Variables | Plugin | RobotLink | str


def open_link(robot: AnyRobot) -> RobotLink:
    """Open a link to a robot. The caller closes it, unless it is `robot` itself.

    Args:
        robot: Connected robot; or a plugin such as `Turtle()`, which runs in this process in lockstep; or an address to
            connect to; or a link.

    Raises:
        AccessDenied: If write access is refused.
        BadValue: If `robot` is none of these.
        BadAddress, ConnectFailed: If `robot` is an address and connecting fails. Other errors are possible; see
            `rhdlink.connect`.
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
    """Return the given configuration, or a typical one for the variables of the robot.

    Raises:
        BadConfiguration: If the file cannot be read.
        WrongVariables: If the robot lacks variables that the configuration needs. The error lists all of them.
    """
    if conf is None:
        if "cmdtransvel" not in link.write:
            conf = SMR
        elif "livn" in link.read:
            conf = ROBOBOT
        else:
            conf = VELOMEGA
        period = getattr(link, "period", conf.period)
        conf = replace(conf, period=period, motion=replace(conf.motion, period=period))
    elif not isinstance(conf, RobotConf):
        conf = read_robot_conf(conf, robot=link.name.removeprefix("mqtt://").rpartition(":")[0])
    lacking = [f"there is no read variable {name}" for name in conf.reads if name not in link.read]
    lacking += [f"there is no write variable {name}" for name in conf.writes if name not in link.write]
    if lacking:
        raise WrongVariables([f"a {conf.drive.value} robot needs other variables", *lacking])
    return conf

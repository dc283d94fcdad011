"""`Host`: runs the plugins of a robot at each tick, and serves their variables to programs.

One round, as in the original (docs/protocols/rhd.md, Server tick)::

    periodic(tick) of every plugin -> wait, serving sockets -> tick += 1 -> take requests, answer them

One thread does all of it and never waits for a client.
"""

from __future__ import annotations

import functools
import logging
import os
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from linkcore import clock
from linkcore.arguments import check_choice, check_seconds, check_whole
from linkcore.errors import BadValue, Closed, LocalError
from linkcore.names import StrictAttributes
from linkcore.threads import Runnable

from ..address import Address
from ..variables.database import Database, TimeStamp
from ..variables.declarations import bind, create_variables
from ..variables.value_types import wrapped
from ..wire.decoder import Limits
from .config import Configuration, Element, read_config
from .plugin import Plugin, check_methods
from .server import Server, TickSchedule
from .service import Resend, Service

if TYPE_CHECKING:
    from typing_extensions import Self

_log = logging.getLogger(__name__)

#: When the next tick comes: after a period, at once, or with the master's request.
Pacing = Literal["period", "free", "lockstep"]

#: Seconds that `Host.close` waits for the host's thread.
_CLOSE_TIMEOUT = 10.0


class HostFailed(LocalError):
    """A host has ended by an unexpected exception, which is its `__cause__`.

    Its plugins have been terminated in order.
    """


class PluginFailed(HostFailed):
    """A critical plugin raised, and the host has ended in order; `__cause__` says what was raised.

    Attributes:
        plugin: its name.
    """

    def __init__(self, plugin: str, doing: str, error: BaseException) -> None:
        super().__init__(f"plugin {plugin} failed in {doing}: {type(error).__name__}: {error}")
        self.plugin = plugin
        self.__cause__ = error


@dataclass(frozen=True)
class HostStatistics:
    """A host's counters at one moment.

    Attributes:
        ticks: rounds so far.
        overruns: ticks that came more than a period late.
        skipped: periods without a tick, because of those.
        late_median: s by which a tick came after it was due; of the last 4096, without lockstep and free running.
        late_p99: likewise, exceeded by one in a hundred.
        late_worst: of all.
        clients: connected, and granted access.
        writers: those of them that may write.
        refused_clients: connections for which there was no slot.
        evicted_clients: idle readers whose slot was given to a newcomer.
        refused_writes: values from clients that may not write.
        bad_clients: connections closed for what they sent.
        failed_plugins: names of the plugins that were disabled.
    """

    ticks: int
    overruns: int
    skipped: int
    late_median: float
    late_p99: float
    late_worst: float
    clients: int
    writers: int
    refused_clients: int
    evicted_clients: int
    refused_writes: int
    bad_clients: int
    failed_plugins: tuple[str, ...]


class Host(StrictAttributes, Runnable):
    """Runs plugins, and serves their variables to programs that know RHD, those of the original among them.

    ::

        with Host([Turtle()], period=0.01, port=24902) as host:
            ...

    It runs once: in the thread that calls `run`, or, with `start` or as a context manager, in one of its own.

    Args:
        plugins: are initialised in this order, and run in the reverse order, as in the original.
        period: of the tick, s.
        port: TCP port, 0 for a free one.
        address: to listen on; "" for every IPv4 address of this computer. Every client that can connect can drive
            the robot, so by default only this machine can.
        clients: how many may be connected.
        allwriters: whether every client may write, rather than the first that asks.
        synchronized: whether each tick waits for the request of the one writer, at most one period more.
        pacing: "period"; "free" for one tick after the other; "lockstep" for one with each request of the one writer,
            or of any client while there is none: deterministic, and as fast as the client.
        resend: "changed" sends a client what was set since its last reply; "original" all that was ever set.
        width: words of a time stamp, 2 or 4, as the clients have it.
        limits: what a client may ask for.
        client_timeout: seconds that a client may leave a request half sent, or a reply unread, before it is closed.
        inactivity_timeout: seconds without a request after which a reader may lose its slot, when all slots are taken
            and somebody else connects. The master keeps its slot.

    Attributes:
        database: the variables; more can be made until the host runs.
        period: as given.
        tick: the number of the round, as clients receive it.
        failure: why it ended by itself, or None.

    Raises:
        BadValue: an argument that cannot be, such as a plugin without `periodic`. When it is run: PluginFailed, a
            critical plugin raised; BadAddress, the port cannot be listened on; LocalError, plugins declare what cannot
            be together; HostFailed, it ended because of an unexpected exception.
    """

    def __init__(
        self,
        plugins: Iterable[Plugin] = (),
        period: float = 0.01,
        port: int = 24902,
        *,
        address: str = "127.0.0.1",
        clients: int = 10,
        allwriters: bool = False,
        synchronized: bool = False,
        pacing: Pacing = "period",
        resend: Resend = "changed",
        width: int = 2,
        limits: Limits | None = None,
        client_timeout: float = 5.0,
        inactivity_timeout: float = 10.0,
    ) -> None:
        super().__init__("host", _CLOSE_TIMEOUT, "a plugin")
        period = check_seconds(period, "period", positive=True, finite=True)
        client_timeout = check_seconds(client_timeout, "client_timeout", positive=True)
        inactivity_timeout = check_seconds(inactivity_timeout, "inactivity_timeout")
        check_choice(pacing, "pacing", ("period", "free", "lockstep"))
        check_whole(port, "port", 0, 65535)
        if not isinstance(address, str):
            raise BadValue(f"address={address!r}; expected an address of this computer, or '' for all of them")
        self.period = period
        self.database = Database()
        self.tick = 0
        self._serving = functools.partial(
            Service, clients=clients, allwriters=allwriters, resend=resend, width=width, limits=limits
        )
        # What cannot be served fails here; later a service can fail only because of what plugins declare. Until the
        # host runs, this one says that there are no clients.
        self._service = self._serving(Database())
        self._place = (address, port)
        self._client_timeout, self._inactivity_timeout = client_timeout, inactivity_timeout
        self._pacing = pacing
        self._synchronized = synchronized
        self._plugins = _checked(plugins)
        self._configs: dict[int, Element] = {}
        self._running: list[Plugin] = []
        self._begun: list[Plugin] = []
        self._failed: list[str] = []
        self._server: Server | None = None
        self._schedule = TickSchedule(period, clock.now())

    @classmethod
    def from_config(cls, config: Configuration | str | os.PathLike[str], **options: object) -> Self:
        """A host as an `rhdconfig.xml` describes it.

        Args:
            config: the file, or what was read from one.
            options: arguments of `Host` that are to have the last word over the file.

        Raises:
            BadConfiguration: the file, or a plugin in it, cannot be used.
        """
        if not isinstance(config, Configuration):
            config = read_config(config)
        plugins, elements = [], {}
        for entry in config.plugins:
            if not entry.is_enabled:
                continue
            plugin = entry.load()
            if not isinstance(plugin, Plugin):
                entry.config.reject(f"{entry.lib} is no rhdlink.Plugin")
            try:
                check_methods(plugin)
            except BadValue as error:
                entry.config.reject(str(error))
            plugin.name, plugin.is_critical, plugin.safety = entry.name, entry.is_critical, entry.safety
            plugins.append(plugin)
            elements[id(plugin)] = entry.config
        if config.realtime_priority:
            _log.warning("real-time priority is asked for; this host runs without it")
        from_file: dict[str, object] = {
            "period": config.period,
            "port": config.port,
            "address": config.address,
            "clients": config.clients,
            "allwriters": config.allwriters,
            "synchronized": config.synchronized and config.pacing == "period",
            "pacing": config.pacing,
            "width": config.width,
            "resend": config.resend,
            "limits": config.limits,
            "client_timeout": config.client_timeout,
            "inactivity_timeout": config.inactivity_timeout,
        }
        host = cls(plugins, **{**from_file, **options})  # type: ignore[arg-type]
        host._configs = elements
        return host

    # -- what it is -----------------------------------------------------------------------------------

    @property
    def plugins(self) -> tuple[Plugin, ...]:
        """The plugins, in the order in which they were given."""
        return tuple(self._plugins)

    @property
    def port(self) -> int:
        """The port that it listens on.

        Raises:
            Closed: it does not run.
        """
        if self._server is None:
            raise Closed("the host does not run")
        return self._server.port

    @property
    def address(self) -> str:
        """Where a program on this computer reaches it, as `rhdlink.connect` takes it; raises `Closed` if it does not
        run.
        """
        return str(Address(self._place[0] or "127.0.0.1", self.port))

    @property
    def writers(self) -> int:
        """How many clients may write: 0 when the robot has lost its master."""
        return self._service.writers

    @property
    def stats(self) -> HostStatistics:
        """The counters at this moment."""
        service, schedule = self._service, self._schedule
        median, p99 = schedule.lateness()
        return HostStatistics(
            ticks=self.tick,
            overruns=schedule.overruns,
            skipped=schedule.skipped,
            late_median=median,
            late_p99=p99,
            late_worst=schedule.worst,
            clients=len(service.clients),
            writers=self.writers,
            refused_clients=service.refused_clients,
            evicted_clients=0 if self._server is None else self._server.evicted,
            refused_writes=service.refused_writes,
            bad_clients=service.bad_clients,
            failed_plugins=tuple(self._failed),
        )

    def __repr__(self) -> str:
        names = ", ".join(plugin.name or type(plugin).__name__ for plugin in self._plugins) or "no plugin"
        if not self._is_used:
            state = "not started"
        elif self._ended.is_set():
            state = "ended" if self.failure is None else f"ended: {self.failure}"
        else:
            clients = len(self._service.clients)
            state = f"at {self.address}, tick {self.tick}, {clients} client{'' if clients == 1 else 's'}"
        return f"<{type(self).__name__} of {names}, {state}>"

    # -- life ------------------------------------------------------------------------------------------

    def _wake(self) -> None:
        server = self._server
        if server is not None:
            server.wake()

    def _begin(self) -> None:
        # Id 0, as clients of the original expect (docs/protocols/rhd.md, Handshake).
        self.database.read.add("tick")
        if self._pacing == "lockstep":
            self.database.read.clock = self._simulated_time
        ranked = sorted((plugin for plugin in self._plugins if plugin.safety > 0), key=lambda plugin: -plugin.safety)
        others = [plugin for plugin in self._plugins if plugin.safety <= 0]
        for plugin in [*others, *ranked]:
            self._init(plugin)
        # In the reverse of the list that begins with the highest rank: the ranked come last
        # (docs/protocols/rhd.md, Plugins).
        self._running = [plugin for plugin in reversed([*ranked, *others]) if plugin in self._begun]
        self._service = self._serving(self.database)
        self._server = Server(
            self._service,
            *self._place,
            client_timeout=self._client_timeout,
            inactivity_timeout=self._inactivity_timeout,
        )
        self._schedule = TickSchedule(self.period, clock.now())

    def _init(self, plugin: Plugin) -> None:
        plugin.name = plugin.name or type(plugin).__name__.lower()
        plugin.host = self
        try:
            create_variables(type(plugin), self.database)
            bind(plugin, self.database)
            plugin.init(self._configs.get(id(plugin), Element(plugin.name)))
        except Exception as error:
            # Not begun, so it is not terminated either: what it has opened so far, only itself can know.
            if plugin.is_critical:
                raise PluginFailed(plugin.name, "init", error) from error
            _log.exception("plugin %s failed in init; the host goes on without it", plugin.name)
            self._failed.append(plugin.name)
        else:
            self._begun.append(plugin)

    def _give_up(self) -> None:
        # First the motors, then the news that we are gone. Whatever one plugin raises, a SystemExit among it, the
        # others are terminated too.
        interrupted: BaseException | None = None
        for plugin in reversed(self._begun):
            try:
                plugin.terminate()
            except BaseException as error:
                _log.exception("plugin %s failed in terminate", plugin.name)
                if not isinstance(error, Exception):
                    interrupted = error
        if self._server is not None:
            self._server.close()
        if interrupted is not None and self._thread is None:
            raise interrupted  # in the caller's thread it may be the user's Ctrl-C

    # -- rounds ----------------------------------------------------------------------------------------

    def _serve(self) -> None:
        service, server = self._service, self._server
        assert server is not None
        try:
            while True:
                # First, also at the end: what was written last may be the command to stop.
                self._call_plugins()
                if not self._stops():
                    self._wait_for_tick(service, server)
                if self._stops():
                    break
                self.tick += 1
                self.database.read.set(0, wrapped(self.tick))  # wraps after 248 days at 10 ms
                for client, reply in service.sync():
                    server.send(client, reply)
                server.resume()
        except BaseException as error:
            self.failure = HostFailed(f"the host ended by {type(error).__name__}: {error}")
            self.failure.__cause__ = error
            raise
        finally:
            self._give_up()

    def _call_plugins(self) -> None:
        for plugin in self._running:
            try:
                plugin.periodic(self.tick)
            except BaseException as error:
                # In the caller's thread a KeyboardInterrupt or SystemExit may come from a signal handler.
                if self._thread is None and not isinstance(error, Exception):
                    raise
                self._fail(plugin, error)
                if self._stops():
                    return

    def _fail(self, plugin: Plugin, error: BaseException) -> None:
        self._failed.append(plugin.name)
        # A new list, since the old one is just being gone through.
        self._running = [other for other in self._running if other is not plugin]
        if plugin.is_critical:
            _log.exception("critical plugin %s failed in periodic; the host ends", plugin.name)
            self.failure = PluginFailed(plugin.name, "periodic", error)
            self._is_stopping = True
        else:
            _log.exception("plugin %s failed in periodic; the host goes on without it", plugin.name)

    def _wait_for_tick(self, service: Service, server: Server) -> None:
        if self._pacing == "lockstep":
            # No deadline: in lockstep time stands still until a request comes; `stop` wakes it.
            server.serve(None, lambda: self._is_stopping or service.is_asked)
            return
        if self._pacing == "free":
            server.serve(clock.now(), self._stops)
            return
        schedule = self._schedule
        due = schedule.advance()
        server.serve(due, self._stops)
        if self._synchronized and not self._stops():
            began = clock.now()
            # The one writer is waited for one period at most; the original waits a thousand (docs/protocols/rhd.md,
            # Defects, 9).
            server.serve(due + self.period, lambda: self._is_stopping or service.writers != 1 or service.is_asked)
            schedule.postpone(clock.now() - began)
        schedule.came(clock.now())

    def _stops(self) -> bool:
        return self._is_stopping

    def _simulated_time(self) -> TimeStamp:
        """The time in lockstep: that of the ticks."""
        return TimeStamp(*divmod(round(self.tick * self.period * 1e6), 1_000_000))


def _checked(plugins: Iterable[Plugin]) -> list[Plugin]:
    """The plugins as a list, each of them one, and none twice."""
    if isinstance(plugins, Plugin):
        raise BadValue(f"plugins={plugins!r}; expected a list of them: [{type(plugins).__name__}(...)]")
    try:
        checked = list(plugins)
    except TypeError:
        raise BadValue(f"plugins={plugins!r}; expected a list of plugins") from None
    for plugin in checked:
        if not isinstance(plugin, Plugin):
            raise BadValue(f"{plugin!r} is no plugin; expected instances of classes that derive from rhdlink.Plugin")
        check_methods(plugin)
    if len(set(map(id, checked))) != len(checked):
        raise BadValue("a plugin is given twice")
    return checked

"""Class `Host`, which runs the plugins of a robot at each tick, and serves their variables to clients.

One tick, as in the original (docs/protocols/rhd.md, Server tick)::

    periodic(tick) of every plugin -> wait, serve sockets -> tick += 1 -> take requests, answer them

One thread does all of this and never waits for a client.
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
from ..variables.value_types import wrapped
from ..wire.decoder import Limits
from .config import Configuration, Element, read_config
from .plugin import Plugin, check_methods, initialise
from .server import Server, TickSchedule
from .service import Resend, Service

if TYPE_CHECKING:
    from typing_extensions import Self

_log = logging.getLogger(__name__)

#: Time of the next tick: after a period, immediately, or with the master's request.
Pacing = Literal["period", "free", "lockstep"]

#: Timeout, in seconds, of `Host.close` for the end of the host's thread.
_CLOSE_TIMEOUT = 10.0


class HostFailed(LocalError):
    """A host has ended because of an unexpected exception, which is its `__cause__`.

    Its plugins have been terminated properly.
    """


class PluginFailed(HostFailed):
    """A critical plugin raised an exception, and the host has ended properly; `__cause__` is the exception.

    Attributes:
        plugin: Name of the plugin.
    """

    def __init__(self, plugin: str, doing: str, error: BaseException) -> None:
        super().__init__(f"plugin {plugin} failed in {doing}: {type(error).__name__}: {error}")
        self.plugin = plugin
        self.__cause__ = error


@dataclass(frozen=True)
class HostStatistics:
    """Counters of a host at one moment.

    Attributes:
        ticks: Number of ticks so far.
        overruns: Number of ticks that were more than a period late.
        skipped: Number of periods without a tick, because of overruns.
        late_median: Median delay of the last 4096 ticks, in s; lockstep and free-running ticks do not count.
        late_p99: Delay, in s, that one in a hundred of these ticks exceeds.
        late_worst: Longest delay of all ticks, in s.
        clients: Number of connected clients that were granted access.
        writers: Number of these clients that may write.
        refused_clients: Number of connections without a free slot.
        evicted_clients: Number of idle readers whose slot was given to a new client.
        refused_writes: Number of values from clients that may not write.
        bad_clients: Number of connections that were closed because of invalid data.
        failed_plugins: Names of the plugins that were disabled.
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
    """Host that runs plugins, and serves their variables to RHD clients, including programs made for the original.

    ::

        with Host([Turtle()], period=0.01, port=24902) as host:
            ...

    A host runs only once. With `run`, it runs in the calling thread; with `start` or as a context manager, in its own
    thread.

    Args:
        plugins: Plugins. They are initialised in this order, and run in the reverse order, as in the original.
        period: Period of the tick, in s.
        port: TCP port; 0 for a free one.
        address: Address to listen on; "" for every IPv4 address of this computer. Every client that can connect can
            drive the robot, so by default only clients on this computer can connect.
        clients: Maximum number of connected clients.
        allwriters: Whether every client may write. If False, only the first client that requests write access may
            write.
        synchronized: Whether each tick waits for the request of the only writer, for at most one additional period.
        pacing: Time of each tick. With "period", ticks occur at a fixed period; with "free", one after the other. With
            "lockstep", one tick occurs with each request of the only writer, or of any client while there is no writer.
            Lockstep is deterministic, and as fast as the client.
        resend: Variables that are sent to a client: "changed" for variables that were set since the last reply to this
            client, "original" for all variables that were ever set.
        width: Number of words of a time stamp, 2 or 4, which must be the same as in the clients.
        limits: Limits of the requests of clients.
        client_timeout: Time, in seconds, for which a client may leave a request incomplete or a reply unread. After
            this time, its connection is closed.
        inactivity_timeout: Time without a request, in seconds, after which a reader may lose its slot. The reader loses
            its slot if all slots are taken and another client connects. The master keeps its slot.

    Attributes:
        database: Variables; more can be created until the host runs.
        period: See the argument `period`.
        tick: Number of the tick, as clients receive it.
        failure: Error that ended the host, or None.

    Raises:
        BadValue: If an argument is invalid, such as a plugin without `periodic`.
        PluginFailed: If a critical plugin raises an exception while the host runs.
        BadAddress: If the host cannot listen on the port when it starts.
        LocalError: If the declarations of plugins conflict when the host starts.
        HostFailed: If the running host ends because of an unexpected exception.
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
        # If the service cannot be provided, fail here. Later, it can fail only because of the declarations of plugins.
        # Until the host runs, this service reports that there are no clients.
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
        """Return a host as described by an `rhdconfig.xml`.

        Args:
            config: Path of the file, or the configuration read from it.
            options: Arguments of `Host` that override the file.

        Raises:
            BadConfiguration: If the file, or a plugin in it, is not valid.
        """
        if not isinstance(config, Configuration):
            config = read_config(config)
        plugins, elements = [], {}
        for entry in config.plugins:
            if not entry.is_enabled:
                continue
            plugin = entry.load()
            if not isinstance(plugin, Plugin):
                entry.config.reject(f"{entry.lib} is not an rhdlink.Plugin")
            try:
                check_methods(plugin)
            except BadValue as error:
                entry.config.reject(str(error))
            plugin.name, plugin.is_critical, plugin.safety = entry.name, entry.is_critical, entry.safety
            plugins.append(plugin)
            elements[id(plugin)] = entry.config
        if config.realtime_priority:
            _log.warning("real-time priority is requested, but not supported by this host")
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

    # -- state ------------------------------------------------------------------------------------------

    @property
    def plugins(self) -> tuple[Plugin, ...]:
        """Plugins, in the order in which they were given."""
        return tuple(self._plugins)

    @property
    def port(self) -> int:
        """Port on which the host listens.

        Raises:
            Closed: If the host is not running.
        """
        if self._server is None:
            raise Closed("the host is not running")
        return self._server.port

    @property
    def address(self) -> str:
        """Address of the host for programs on this computer, in the form for `rhdlink.connect`.

        Raises:
            Closed: If the host is not running.
        """
        return str(Address(self._place[0] or "127.0.0.1", self.port))

    @property
    def writers(self) -> int:
        """Number of clients that may write; 0 if the robot has lost its master."""
        return self._service.writers

    @property
    def stats(self) -> HostStatistics:
        """Current counters."""
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

    # -- beginning and end -----------------------------------------------------------------------------

    def _wake(self) -> None:
        server = self._server
        if server is not None:
            server.wake()

    def _begin(self) -> None:
        # The variable needs id 0, as clients of the original expect (docs/protocols/rhd.md, Handshake).
        self.database.read.add("tick")
        if self._pacing == "lockstep":
            self.database.read.clock = self._simulated_time
        ranked = sorted((plugin for plugin in self._plugins if plugin.safety > 0), key=lambda plugin: -plugin.safety)
        others = [plugin for plugin in self._plugins if plugin.safety <= 0]
        for plugin in [*others, *ranked]:
            self._init(plugin)
        # Plugins run in the reverse order of a list that begins with the highest rank, so ranked plugins run last
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
        try:
            initialise(plugin, self, self._configs.get(id(plugin)))
        except Exception as error:
            # The plugin has not begun, so it is not terminated either: only the plugin itself knows what it opened.
            if plugin.is_critical:
                raise PluginFailed(plugin.name, "init", error) from error
            _log.exception("plugin %s failed in init; the host continues without it", plugin.name)
            self._failed.append(plugin.name)
        else:
            self._begun.append(plugin)

    def _give_up(self) -> None:
        # First the motors stop, then clients are disconnected. If a plugin raises any exception, even a SystemExit, the
        # other plugins are still terminated.
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
            raise interrupted  # in the caller's thread, this may be the user's Ctrl-C

    # -- ticks -----------------------------------------------------------------------------------------

    def _serve(self) -> None:
        service, server = self._service, self._server
        assert server is not None
        try:
            while True:
                # Call the plugins first, even at the end, because the last written values may be the command to stop.
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
            self.failure = HostFailed(f"the host ended because of {type(error).__name__}: {error}")
            self.failure.__cause__ = error
            raise
        finally:
            self._give_up()

    def _call_plugins(self) -> None:
        for plugin in self._running:
            try:
                plugin.periodic(self.tick)
            except BaseException as error:
                # In the caller's thread, a KeyboardInterrupt or SystemExit may come from a signal handler.
                if self._thread is None and not isinstance(error, Exception):
                    raise
                self._fail(plugin, error)
                if self._stops():
                    return

    def _fail(self, plugin: Plugin, error: BaseException) -> None:
        self._failed.append(plugin.name)
        # Make a new list, because the caller iterates over the old list.
        self._running = [other for other in self._running if other is not plugin]
        if plugin.is_critical:
            _log.exception("critical plugin %s failed in periodic; the host ends", plugin.name)
            self.failure = PluginFailed(plugin.name, "periodic", error)
            self._is_stopping = True
        else:
            _log.exception("plugin %s failed in periodic; the host continues without it", plugin.name)

    def _wait_for_tick(self, service: Service, server: Server) -> None:
        if self._pacing == "lockstep":
            # Wait without a deadline: in lockstep, time does not advance until a request arrives, and `stop` wakes the
            # host.
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
            # Wait for the only writer for at most one period. The original waits for a thousand periods
            # (docs/protocols/rhd.md, Defects, 9).
            server.serve(due + self.period, lambda: self._is_stopping or service.writers != 1 or service.is_asked)
            schedule.postpone(clock.now() - began)
        schedule.came(clock.now())

    def _stops(self) -> bool:
        return self._is_stopping

    def _simulated_time(self) -> TimeStamp:
        """Return the simulated time in lockstep, which is derived from the number of ticks."""
        return TimeStamp(*divmod(round(self.tick * self.period * 1e6), 1_000_000))


def _checked(plugins: Iterable[Plugin]) -> list[Plugin]:
    """Check that each item is a plugin and that none is given twice; return the plugins as a list."""
    if isinstance(plugins, Plugin):
        raise BadValue(f"plugins={plugins!r}; expected a list of plugins: [{type(plugins).__name__}(...)]")
    try:
        checked = list(plugins)
    except TypeError:
        raise BadValue(f"plugins={plugins!r}; expected a list of plugins") from None
    for plugin in checked:
        if not isinstance(plugin, Plugin):
            raise BadValue(f"{plugin!r} is not a plugin; expected instances of classes derived from rhdlink.Plugin")
        check_methods(plugin)
    if len(set(map(id, checked))) != len(checked):
        raise BadValue("plugins contains a plugin twice; expected each plugin once")
    return checked

"""A robot: plugins, the tick that drives them, and the server that programs connect to.

One round, as in the original (section 7 of the protocol reference)::

    periodic(tick) of every plugin -> wait, serving sockets -> tick += 1 -> take what came, answer who asked

One thread does all of it and never waits for a client. A tick is due at its own time, however late the one before it
was; one that comes more than a period late is skipped and counted, not made up for.
"""

from __future__ import annotations

import contextlib
import logging
import math
import os
import threading
import time
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from linkcore.errors import BadValue, Closed, LinkTimeout, LocalError

from .config import Configuration, Element, read_config
from .database import Database, TimeStamp
from .limits import Limits
from .plugin import Plugin
from .server import Server
from .service import Resend, Service

if TYPE_CHECKING:
    from typing_extensions import Self

__all__ = ["Host", "HostStatistics", "Pacing", "PluginFailed"]

_log = logging.getLogger(__name__)

#: When the next tick comes: after a period, at once, or with the master's request.
Pacing = Literal["period", "free", "lockstep"]

#: Ticks whose lateness is remembered.
_REMEMBERED = 4096
#: Seconds that other threads wait for the host's.
_PATIENCE = 10.0


class PluginFailed(LocalError):
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
        refused_clients: connections for which there was no seat.
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
    refused_writes: int
    bad_clients: int
    failed_plugins: tuple[str, ...]


class Host:
    """Runs plugins, and serves their variables.

    ``run()`` does it here until `stop`; ``start()``, or a ``with`` block, in a thread of its own. A host runs once.

    Args:
        plugins: in the order in which they are initialised; they run in the reverse order, as in the original.
        period: of the tick, s.
        port: TCP port, 0 for a free one.
        address: to listen on. Whoever can connect can drive the robot, so by default only this machine can.
        clients: how many may be connected.
        allwriters: whether every client may write, rather than the first that asks.
        synchronized: whether each tick waits for the request of the one writer, at most one period more.
        pacing: "period"; "free" for one tick after the other; "lockstep" for one with each request of the one writer,
            or of any client while there is none: deterministic, and as fast as the client.
        resend: "changed" tells a client what was set since it was last told; "original" all that ever was.
        width: words of a time stamp, 2 or 4, as the clients have it.
        limits: what a client may ask for.
        patience: seconds that a client may leave a request half sent, or a reply unread.

    Attributes:
        database: the variables; more can be made until the host runs.
        tick: the number of the round, as clients are told.
        failure: why it ended by itself, or None.

    Raises:
        BadValue: an argument that cannot be.
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
        patience: float = 5.0,
    ) -> None:
        if not 0.0 < period < math.inf:
            raise BadValue(f"period is {period}; expected a positive number of seconds")
        if not 0.0 < patience < math.inf:
            raise BadValue(f"patience is {patience}; expected a positive number of seconds")
        if pacing not in ("period", "free", "lockstep"):
            raise BadValue(f"pacing is {pacing!r}; expected 'period', 'free' or 'lockstep'")
        if not 0 <= port <= 65535:
            raise BadValue(f"port is {port}; expected 0 to 65535")
        self.period = period
        self.database = Database()
        self.tick = 0
        self.failure: PluginFailed | None = None
        # Plugins may make a service fail only by what they declare; everything else is to fail here.
        Service(Database(), clients=clients, resend=resend, width=width, limits=limits)
        self._service_options = {
            "clients": clients,
            "allwriters": allwriters,
            "resend": resend,
            "width": width,
            "limits": limits,
        }
        self._place = (address, port)
        self._patience = patience
        self._pacing = pacing
        self._synchronized = synchronized
        self._plugins = list(plugins)
        if len(set(map(id, self._plugins))) != len(self._plugins):
            raise BadValue("a plugin is given twice")
        self._configs: dict[int, Element] = {}
        self._running: list[Plugin] = []
        self._begun: list[Plugin] = []
        self._failed: list[str] = []
        self._service: Service | None = None
        self._server: Server | None = None
        self._thread: threading.Thread | None = None
        self._is_stopping = False
        self._is_used = False
        self._ended = threading.Event()
        self._due = 0.0
        self._overruns = self._skipped = 0
        self._worst = 0.0
        self._late: deque[float] = deque(maxlen=_REMEMBERED)

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
        plugins, elements = [], []
        for entry in config.plugins:
            if not entry.is_enabled:
                continue
            plugin = entry.load()
            if not isinstance(plugin, Plugin):
                entry.config.reject(f"{entry.lib} is no rhdlink.Plugin")
            plugin.name, plugin.is_critical, plugin.safety = entry.name, entry.is_critical, entry.safety
            plugins.append(plugin)
            elements.append(entry.config)
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
        }
        host = cls(plugins, **{**from_file, **options})  # type: ignore[arg-type]
        host._configs = {id(plugin): element for plugin, element in zip(plugins, elements, strict=True)}
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
    def writers(self) -> int:
        """How many clients may write: 0 when the robot has lost its master."""
        return 0 if self._service is None else self._service.writers

    @property
    def stats(self) -> HostStatistics:
        """The counters at this moment."""
        service = self._service
        # Another thread may be adding to it; a copy that fails is taken again.
        late: list[float] = []
        for _ in range(10):
            with contextlib.suppress(RuntimeError):
                late = list(self._late)
                break
        median, p99 = np.percentile(late, (50, 99)).tolist() if late else (0.0, 0.0)
        return HostStatistics(
            ticks=self.tick,
            overruns=self._overruns,
            skipped=self._skipped,
            late_median=median,
            late_p99=p99,
            late_worst=self._worst,
            clients=0 if service is None else len(service.guests),
            writers=self.writers,
            refused_clients=0 if service is None else service.refused_clients,
            refused_writes=0 if service is None else service.refused_writes,
            bad_clients=0 if service is None else service.bad_clients,
            failed_plugins=tuple(self._failed),
        )

    # -- life ------------------------------------------------------------------------------------------

    def run(self) -> None:
        """Run in this thread until `stop`; then end in order.

        Raises:
            PluginFailed: a critical plugin raised.
            BadAddress: the port cannot be listened on.
            LocalError: plugins declare what cannot be together.
            Closed: it has run already.
        """
        self._begin()
        self._go_round()
        if self.failure is not None:
            raise self.failure

    def start(self) -> Self:
        """Run in a thread; plugins are initialised, and the port is open, when this returns.

        Raises:
            as `run`, for what goes wrong until then; later, `failure` says what did.
        """
        self._begin()
        self._thread = threading.Thread(target=self._go_round, name="rhdlink host", daemon=True)
        self._thread.start()
        return self

    def stop(self) -> None:
        """Have it end after this round; from any thread, from a plugin, from a signal handler."""
        self._is_stopping = True
        server = self._server
        if server is not None:
            server.wake()

    def wait(self, timeout: float | None = None) -> bool:
        """Wait until a started host has ended; False when time is up.

        Raises:
            PluginFailed: it ended because a critical plugin raised.
        """
        if not self._ended.wait(timeout):
            return False
        if self.failure is not None:
            raise self.failure
        return True

    def close(self) -> None:
        """Stop, and wait until all has ended in order; idempotent.

        Raises:
            LinkTimeout: a plugin does not return.
        """
        self.stop()
        thread = self._thread
        if thread is not None and thread is not threading.current_thread():
            thread.join(_PATIENCE)
            if thread.is_alive():
                raise LinkTimeout(f"the host has not ended within {_PATIENCE:g} s: a plugin does not return")

    def __enter__(self) -> Self:
        return self.start()

    def __exit__(self, *exc: object) -> None:
        self.close()

    # -- begin and end ---------------------------------------------------------------------------------

    def _begin(self) -> None:
        if self._is_used:
            raise Closed("a host runs once; make another")
        self._is_used = True
        try:
            # Id 0, as clients of the original expect (section 3).
            self.database.read.add("tick")
            if self._pacing == "lockstep":
                self.database.read.clock = self._simulated
            by_rank = sorted(self._plugins, key=lambda plugin: -plugin.safety)
            ranked = [plugin for plugin in by_rank if plugin.safety > 0]
            others = [plugin for plugin in self._plugins if plugin.safety <= 0]
            for plugin in [*others, *ranked]:
                self._init(plugin)
            # In the reverse of the list that begins with the highest rank: the ranked come last (section 10).
            self._running = [plugin for plugin in reversed([*ranked, *others]) if plugin in self._begun]
            self._service = Service(self.database, **self._service_options)  # type: ignore[arg-type]
            self._server = Server(self._service, *self._place, patience=self._patience)
        except BaseException:
            self._end()
            raise
        self._due = time.monotonic()

    def _init(self, plugin: Plugin) -> None:
        plugin.name = plugin.name or type(plugin).__name__.lower()
        plugin.host = self
        try:
            plugin.create(self.database)
            plugin.bind(self.database)
            plugin.init(self._configs.get(id(plugin), Element(plugin.name)))
        except Exception as error:
            if plugin.is_critical:
                raise PluginFailed(plugin.name, "init", error) from error
            _log.exception("plugin %s failed in init; the host goes on without it", plugin.name)
            self._failed.append(plugin.name)
        else:
            self._begun.append(plugin)

    def _end(self) -> None:
        # First the motors, then the news that we are gone.
        for plugin in reversed(self._begun):
            try:
                plugin.terminate()
            except Exception:
                _log.exception("plugin %s failed in terminate", plugin.name)
        self._begun.clear()
        if self._server is not None:
            self._server.close()
        self._ended.set()

    # -- rounds ----------------------------------------------------------------------------------------

    def _go_round(self) -> None:
        service, server = self._service, self._server
        assert service is not None
        assert server is not None
        read = self.database.read
        try:
            while True:
                # First, also at the end: what was written last may be the command to stop.
                self._call_plugins()
                if not self._stops():
                    self._wait_for_tick(service, server)
                if self._stops():
                    break
                self.tick += 1
                # A 32-bit counter, which wraps after 248 days.
                read.set(0, (self.tick + (1 << 31)) % (1 << 32) - (1 << 31))
                for guest, reply in service.sync():
                    server.send(guest, reply)
                server.resume()
        finally:
            self._end()

    def _call_plugins(self) -> None:
        for plugin in self._running:
            try:
                plugin.periodic(self.tick)
            except Exception as error:
                self._fail(plugin, error)
                if self._stops():
                    return

    def _fail(self, plugin: Plugin, error: Exception) -> None:
        self._failed.append(plugin.name)
        self._running = [other for other in self._running if other is not plugin]
        if plugin.is_critical:
            _log.exception("critical plugin %s failed in periodic; the host ends", plugin.name)
            self.failure = PluginFailed(plugin.name, "periodic", error)
            self._is_stopping = True
        else:
            _log.exception("plugin %s failed in periodic; the host goes on without it", plugin.name)

    def _wait_for_tick(self, service: Service, server: Server) -> None:
        if self._pacing == "lockstep":
            server.serve(None, lambda: self._is_stopping or service.is_asked)
            return
        if self._pacing == "free":
            server.serve(time.monotonic(), self._stops)
            return
        self._due += self.period
        server.serve(self._due, self._stops)
        if self._synchronized and not self._stops():
            began = time.monotonic()
            server.serve(self._due + self.period, lambda: self._is_stopping or not _is_awaited(service))
            # Who waits for its master takes its time from it.
            self._due += max(time.monotonic() - began, 0.0)
        self._note_lateness(time.monotonic() - self._due)

    def _stops(self) -> bool:
        return self._is_stopping

    def _note_lateness(self, late: float) -> None:
        self._late.append(late)
        self._worst = max(self._worst, late)
        if late > self.period:
            periods = int(late / self.period)
            self._overruns += 1
            self._skipped += periods
            self._due += periods * self.period

    def _simulated(self) -> TimeStamp:
        """The time in lockstep: that of the ticks."""
        micros = round(self.tick * self.period * 1e6)
        return TimeStamp(micros // 1_000_000, micros % 1_000_000)


def _is_awaited(service: Service) -> bool:
    """Whether there is one writer, and it has not asked."""
    return service.writers == 1 and not service.is_asked

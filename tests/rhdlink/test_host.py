"""The host: the life cycle of plugins, the times of ticks, and the end of the host."""

from __future__ import annotations

import inspect
import os
import signal
import sys
import threading
import time
import warnings
from collections.abc import Callable
from contextlib import ExitStack
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from linkcore.errors import BadAddress, BadValue, Closed, LinkTimeout, LocalError
from rhdlink.address import PORT, parse_address
from rhdlink.host import host as host_module
from rhdlink.host.config import BadConfiguration, Element, parse_config
from rhdlink.host.host import Host, HostFailed, HostStatistics, PluginFailed
from rhdlink.host.plugin import Plugin
from rhdlink.host.server import TickSchedule
from rhdlink.host.service import Service
from rhdlink.smrcl.robot_link import PluginLink
from rhdlink.variables.declarations import Read, Write
from rhdlink.variables.value_types import Int32
from tests import platforms
from tests.fakes.clock import Clock
from tests.rhdlink.raw_client import RawClient
from tests.waiting import until

pytestmark = pytest.mark.simulated_time


class Noted(Plugin):
    """Plugin that notes the calls of its methods."""

    def __init__(
        self, name: str, notes: list[str], *, fails_in: str = "", critical: bool = True, safety: int = 0
    ) -> None:
        self.name, self.notes, self.fails_in = name, notes, fails_in
        self.is_critical, self.safety = critical, safety

    def _note(self, what: str) -> None:
        self.notes.append(f"{what} {self.name}")
        if what == self.fails_in:
            raise RuntimeError(f"{self.name} is out of order")

    def init(self, config: Element) -> None:
        self._note("init")

    def periodic(self, tick: int) -> None:
        self._note(f"periodic({tick})")
        if self.fails_in == "periodic":
            raise RuntimeError(f"{self.name} is out of order")

    def terminate(self) -> None:
        self._note("terminate")


class Stops(Plugin):
    """Plugin that stops the host in its n-th round, after all other plugins."""

    safety = 127

    def __init__(self, rounds: int = 1) -> None:
        self.rounds = rounds

    def periodic(self, tick: int) -> None:
        if tick + 1 >= self.rounds:
            self.host.stop()


def test_plugins_run_in_the_original_order_and_end_in_reverse() -> None:
    notes: list[str] = []
    plugins = [Noted("a", notes), Noted("safe", notes, safety=1), Noted("b", notes), Noted("safest", notes, safety=9)]
    Host([*plugins, Stops()], port=0, period=0.001).run()
    assert notes == [
        *("init a", "init b", "init safest", "init safe"),
        *("periodic(0) b", "periodic(0) a", "periodic(0) safe", "periodic(0) safest"),
        *("terminate safe", "terminate safest", "terminate b", "terminate a"),
    ]


def test_critical_plugin_failing_in_init_prevents_the_start() -> None:
    notes: list[str] = []
    host = Host([Noted("a", notes), Noted("bad", notes, fails_in="init"), Noted("c", notes)], port=0)
    with pytest.raises(PluginFailed, match="bad failed in init: RuntimeError: bad is out of order") as caught:
        host.start()
    assert caught.value.plugin == "bad"
    assert isinstance(caught.value.__cause__, RuntimeError)
    assert notes == ["init a", "init bad", "terminate a"]
    with pytest.raises(Closed):
        _ = host.port


def test_noncritical_plugin_may_fail_in_init(caplog: pytest.LogCaptureFixture) -> None:
    notes: list[str] = []
    host = Host(
        [Noted("a", notes), Noted("bad", notes, fails_in="init", critical=False), Stops()], port=0, period=0.001
    )
    host.run()
    assert notes == ["init a", "init bad", "periodic(0) a", "terminate a"]
    assert host.stats.failed_plugins == ("bad",)
    assert "bad failed in init" in caplog.text


def test_critical_plugin_that_fails_ends_the_host_in_order(caplog: pytest.LogCaptureFixture) -> None:
    notes: list[str] = []
    host = Host([Noted("a", notes), Noted("bad", notes, fails_in="periodic"), Noted("c", notes)], port=0, period=0.001)
    with pytest.raises(PluginFailed, match="bad failed in periodic"):
        host.run()
    assert notes == [
        *("init a", "init bad", "init c"),
        *("periodic(0) c", "periodic(0) bad"),
        *("terminate c", "terminate bad", "terminate a"),
    ]
    assert "critical plugin bad failed" in caplog.text


def test_failure_in_a_thread_is_raised_by_wait() -> None:
    notes: list[str] = []
    with Host([Noted("bad", notes, fails_in="periodic")], port=0, period=0.001) as host:
        with pytest.raises(PluginFailed):
            host.wait(10.0)
        assert isinstance(host.failure, PluginFailed)
        assert isinstance(host.failure.__cause__, RuntimeError)


class Boom(BaseException):
    """Exception that no code expects."""


@pytest.mark.parametrize("error", [ValueError("boom"), SystemExit(3), Boom()])
def test_unexpected_exception_is_raised_by_wait(
    error: BaseException, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    notes: list[str] = []
    with Host([Noted("a", notes)], port=0, pacing="lockstep") as host, RawClient(host.port) as client:
        client.greeting()

        def boom(service: Service) -> list[Any]:
            raise error

        monkeypatch.setattr(Service, "sync", boom)
        client.send(b"rree")
        with pytest.raises(HostFailed, match=f"the host ended because of {type(error).__name__}") as caught:
            host.wait(10.0)
        assert caught.value.__cause__ is error
        assert host.failure is caught.value
        assert f"ended: {host.failure}" in repr(host)
    assert notes[-1] == "terminate a"
    assert "the host has ended" in caplog.text


class Exits(Plugin):
    """Plugin that calls sys.exit in the given method."""

    def __init__(self, where: str) -> None:
        self.where = where

    def periodic(self, tick: int) -> None:
        if self.where == "periodic":
            sys.exit("enough")

    def terminate(self) -> None:
        if self.where == "terminate":
            sys.exit("enough")


def test_sys_exit_in_a_plugin_raises_plugin_failed() -> None:
    notes: list[str] = []
    with Host([Noted("a", notes), Exits("periodic")], port=0, period=0.001) as host:
        with pytest.raises(PluginFailed, match="exits failed in periodic: SystemExit: enough"):
            host.wait(10.0)
        assert notes[-1] == "terminate a"
    exits = Exits("periodic")
    exits.is_critical = False
    with Host([exits], port=0, period=0.001) as host:
        until(lambda: host.stats.failed_plugins == ("exits",))
        assert not host.wait(0.0)


@pytest.mark.parametrize("timeout", [True, -1.0, float("nan"), "1"])
def test_wait_rejects_invalid_timeouts(timeout: Any) -> None:
    with Host([Noted("a", [])], port=0, period=0.01) as host, pytest.raises(BadValue, match="number of seconds"):
        host.wait(timeout)


def test_exit_in_terminate_does_not_stop_the_shutdown() -> None:
    notes: list[str] = []
    with Host([Noted("a", notes), Exits("terminate")], port=0, period=0.001):
        pass
    assert notes[-1] == "terminate a"
    notes.clear()
    # In the caller's thread, SystemExit might come from a signal handler, so it is raised again after the shutdown.
    with pytest.raises(SystemExit):
        Host([Noted("a", notes), Exits("terminate"), Stops()], port=0, period=0.001).run()
    assert notes[-1] == "terminate a"


def test_ctrl_c_in_a_plugin_ends_a_foreground_host_in_order() -> None:
    class Interrupted(Plugin):
        def periodic(self, tick: int) -> None:
            signal.raise_signal(signal.SIGINT)

    notes: list[str] = []
    host = Host([Noted("a", notes), Interrupted()], port=0, period=0.001)
    with pytest.raises(KeyboardInterrupt):
        host.run()
    assert notes[-1] == "terminate a"
    assert host.stats.failed_plugins == ()
    with pytest.raises(HostFailed, match="ended because of KeyboardInterrupt"):
        host.wait(0.0)


def test_close_reports_a_plugin_that_does_not_return(monkeypatch: pytest.MonkeyPatch) -> None:
    class Hangs(Plugin):
        released = threading.Event()

        def periodic(self, tick: int) -> None:
            self.released.wait(60.0)

    host = Host([Hangs()], port=0).start()
    waited: list[float | None] = []
    with monkeypatch.context() as patch:
        patch.setattr(threading.Thread, "join", lambda thread, timeout=None: waited.append(timeout))
        with pytest.raises(LinkTimeout, match="the host has not ended within 10 s: a plugin does not respond"):
            host.close()
    assert waited == [10.0]
    Hangs.released.set()
    assert host.wait(10.0)


def test_unstarted_host_has_zero_statistics_and_can_be_stopped() -> None:
    host = Host([Echo()])
    assert host.stats == HostStatistics(0, 0, 0, 0.0, 0.0, 0.0, 0, 0, 0, 0, 0, 0, ())
    assert host.writers == 0
    host.stop()
    host.close()


def test_host_is_reachable_at_its_address() -> None:
    """A host that listens on all addresses must report an address that clients can connect to."""
    for listening, reached in (("127.0.0.1", "127.0.0.1"), ("", "127.0.0.1"), ("localhost", "localhost")):
        with Host([Echo()], port=0, address=listening) as host:
            assert parse_address(host.address) == (reached, host.port)


def test_start_without_a_free_thread_raises_and_terminates(monkeypatch: pytest.MonkeyPatch) -> None:
    def no_thread(self: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    notes: list[str] = []
    host = Host([Noted("a", notes)], port=0)
    with monkeypatch.context() as patched:
        patched.setattr(threading.Thread, "start", no_thread)
        with pytest.raises(LocalError, match="no thread could be started"):
            host.start()
    assert notes == ["init a", "terminate a"]
    host.close()


def test_failed_noncritical_plugin_is_disabled(caplog: pytest.LogCaptureFixture) -> None:
    notes: list[str] = []
    bad = Noted("bad", notes, fails_in="periodic", critical=False)
    host = Host([Noted("a", notes), bad, Stops(2)], port=0, period=0.001)
    host.run()
    assert [note for note in notes if note.startswith("periodic")] == [
        "periodic(0) bad",
        "periodic(0) a",
        "periodic(1) a",
    ]
    assert "terminate bad" in notes
    assert host.stats.failed_plugins == ("bad",)
    assert "bad failed in periodic" in caplog.text


def test_failure_in_terminate_does_not_stop_the_shutdown(caplog: pytest.LogCaptureFixture) -> None:
    notes: list[str] = []
    Host([Noted("a", notes), Noted("bad", notes, fails_in="terminate"), Stops()], port=0, period=0.001).run()
    assert notes[-2:] == ["terminate bad", "terminate a"]
    assert "bad failed in terminate" in caplog.text


def test_plugins_share_variables_of_the_same_name() -> None:
    class Drive(Plugin):
        speed = Write(Int32)
        moved = Read(Int32)

        def periodic(self, tick: int) -> None:
            self.moved = self.moved + self.speed

    class Guard(Plugin):
        speed = Write(Int32)
        safety = 1

        def periodic(self, tick: int) -> None:
            self.speed = min(self.speed, 10)

    with Host([Drive(), Guard()], port=0, pacing="lockstep") as host, RawClient(host.port, b"aw") as master:
        assert [row.name for row in master.greeting().write] == ["speed"]
        master.sync({"speed": 100})
        master.sync({})
        master.sync({})
        # The guard runs after the drive, so only the first round uses the excessive speed.
        assert master.value("moved") == 110


def test_conflicting_variables_fail_the_second_plugin() -> None:
    class One(Plugin):
        speed = Write(Int32)

        def periodic(self, tick: int) -> None: ...

    class Other(Plugin):
        speed = Write(Int32, 2)

        def periodic(self, tick: int) -> None: ...

    with pytest.raises(PluginFailed, match="plugin other failed in init: WrongVariables"):
        Host([One(), Other()], port=0).start()


class Echo(Plugin):
    order = Write(Int32)
    echo = Read(Int32)
    orders = Read(Int32)

    def __init__(self) -> None:
        self.seen: list[int] = []

    def periodic(self, tick: int) -> None:
        self.echo = self.order
        if self.is_updated(Echo.order):
            self.seen.append(self.order)
            self.orders = self.orders + 1


def test_lockstep_makes_one_tick_per_request_reproducibly() -> None:
    def run() -> tuple[bytes, list[int]]:
        echo = Echo()
        with Host([echo], port=0, period=0.01, pacing="lockstep") as host, RawClient(host.port, b"aw") as master:
            master.greeting()
            received = bytearray()
            for number in range(50):
                master.send(master.request({"order": number} if number % 3 else {}))
                received += master.raw()
                assert master.value("tick") == number + 1
                assert host.tick == number + 1
            stamp = master.tables.read.stamp(0)
            assert stamp == (0, 500_000)
            for _ in range(60):
                master.sync({})
            assert master.tables.read.stamp(0) == (1, 100_000)
        return bytes(received), echo.seen

    first = run()
    assert first == run()
    assert first[1] == [number for number in range(50) if number % 3]


def test_lockstep_makes_a_tick_for_each_queued_request() -> None:
    with Host([Echo()], port=0, pacing="lockstep") as host, RawClient(host.port, b"aw") as master:
        master.greeting()
        master.send(master.request({"order": 1}) * 3)
        for tick in (1, 2, 3):
            master.batch()
            assert master.value("tick") == tick


def test_lockstep_replies_before_it_rejects_later_invalid_bytes() -> None:
    with Host([Echo()], port=0, pacing="lockstep") as host, RawClient(host.port) as reader:
        reader.greeting()
        reader.send(b"rreexx")
        assert reader.is_closed()
        assert host.tick == 1


def test_tick_variable_wraps_at_32_bits() -> None:
    host = Host([Echo()], port=0, period=0.25, pacing="lockstep")
    host.tick = 2**31 - 2
    with host, RawClient(host.port) as reader:
        reader.greeting()
        ticks = []
        for _ in range(3):
            reader.sync()
            ticks.append(reader.value("tick"))
        assert ticks == [2**31 - 1, -(2**31), -(2**31) + 1]
        # The tick of the host does not wrap, and the time continues.
        assert host.tick == 2**31 + 1
        assert reader.tables.read.stamp(0) == (2**29, 250_000)


def test_lockstep_readers_continue_after_the_master_leaves() -> None:
    """The host notices the closed connection only when it replies to a request of the master."""
    with Host([Echo()], port=0, pacing="lockstep") as host, RawClient(host.port) as reader:
        reader.greeting()
        for _ in range(20):
            with RawClient(host.port, b"aw") as master:
                master.greeting()
                reader.send(b"rree")
                master.send(master.request({"order": 1}) * 5)
            # No other event could wake the host now.
            reader.batch()
            until(lambda: host.writers == 0)


def test_lockstep_readers_wait_for_ticks_of_the_master() -> None:
    with Host([Echo()], port=0, pacing="lockstep") as host, ExitStack() as stack:
        reader = stack.enter_context(RawClient(host.port))
        reader.greeting()
        reader.sync()
        assert reader.value("tick") == 1
        master = stack.enter_context(RawClient(host.port, b"aw"))
        master.greeting()
        # The master now causes the ticks: the reader waits for the next one.
        reader.send(b"rree")
        for _ in range(20):
            master.sync({"order": 7})
        assert master.value("tick") == 21
        reader.batch()
        assert 1 < reader.value("tick") <= 21


def test_value_of_the_master_takes_effect_in_the_next_tick() -> None:
    with Host([Echo()], port=0, pacing="lockstep") as host, RawClient(host.port, b"aw") as master:
        master.greeting()
        master.sync({"order": 5})
        assert (master.value("echo"), master.value("orders")) == (0, 0)
        master.sync({})
        assert (master.value("echo"), master.value("orders")) == (5, 1)
        # Setting the same value again is also an update.
        master.sync({"order": 5})
        master.sync({})
        master.sync({})
        assert (master.value("echo"), master.value("orders")) == (5, 2)


def test_last_values_of_a_leaving_master_are_applied() -> None:
    echo = Echo()
    with Host([echo], port=0, period=0.002) as host:
        with RawClient(host.port, b"aw") as master:
            master.greeting()
            master.sync({"order": 8})
            # The last command and the end of the connection reach the host together.
            master.send(master.request({"order": 1}) + master.request({"order": 0}))
        until(lambda: host.writers == 0)
        until(lambda: 0 in echo.seen)
    assert echo.seen[0] == 8
    assert echo.seen[-1] == 0


def test_last_values_of_a_leaving_master_using_rr_are_applied() -> None:
    """A writer may send requests with `rr`. Its values are applied in the same way, even when it leaves."""
    echo = Echo()
    with Host([echo], port=0, pacing="lockstep") as host, RawClient(host.port) as reader:
        reader.greeting()
        with RawClient(host.port, b"aw") as master:
            master.greeting()
            request = master.request({"order": 5})
            master.send(request.replace(b"rw", b"rr", 1))
            master.batch()
            # Two requests that are complete when the master leaves.
            master.send(master.request({"order": 6}).replace(b"rw", b"rr", 1) * 2)
            master.send(master.request({"order": 7}).replace(b"rw", b"rr", 1))
        until(lambda: host.writers == 0)
        reader.sync()
        reader.sync()
        assert reader.value("order") == 7
    assert echo.seen[-1] == 7


def test_queued_requests_are_answered_one_per_tick() -> None:
    with Host([Echo()], port=0, period=0.002) as host, RawClient(host.port) as reader:
        reader.greeting()
        reader.send(b"rree" * 3)
        ticks = []
        for _ in range(3):
            reader.batch()
            ticks.append(reader.value("tick"))
        assert ticks == [ticks[0], ticks[0] + 1, ticks[0] + 2]


def test_requests_may_be_empty_reordered_or_end_without_reply() -> None:
    echo = Echo()
    with Host([echo], port=0, period=0.002) as host, RawClient(host.port, b"aw") as master:
        master.greeting()
        master.send(b"rwee")
        master.batch()
        written = master.request({"order": 3})
        master.send(written[2:-2] + written[:2] + written[-2:])
        master.batch()
        master.send(b"ee" + b"rwex")
        master.batch()
        master.socket.setblocking(False)
        with pytest.raises(BlockingIOError):
            master.socket.recv(1)
    assert echo.seen == [3]


def test_client_slots_are_limited_and_reused() -> None:
    with Host([Echo()], port=0, period=0.002, clients=2) as host, ExitStack() as stack:
        first, second = (stack.enter_context(RawClient(host.port)) for _ in range(2))
        first.greeting()
        second.greeting()
        third = stack.enter_context(RawClient(host.port, b""))
        assert third.is_closed()
        first.close()
        until(lambda: host.stats.clients == 1)
        fourth = stack.enter_context(RawClient(host.port))
        fourth.greeting()
        assert host.stats.refused_clients == 1


def test_idle_readers_are_evicted_for_new_clients() -> None:
    with Host([Echo()], port=0, period=0.002, clients=10, inactivity_timeout=0.2) as host, ExitStack() as stack:
        with RawClient(host.port, b"aw") as master:
            master.greeting()
            idle = [stack.enter_context(RawClient(host.port)) for _ in range(9)]
            for client in idle:
                client.greeting()
            busy = idle.pop()
            time.sleep(0.25)
            busy.sync()
            for number in range(8):
                newcomer = stack.enter_context(RawClient(host.port))
                newcomer.greeting()
                newcomer.sync()
                busy.sync()
                # The reader that has been idle the longest is evicted: the host closes its connection.
                assert idle[number].is_closed()
                assert host.stats.evicted_clients == number + 1
            busy.sync()
            # The master has sent nothing during this time and keeps its slot.
            assert host.writers == 1
            master.sync({"order": 1})
        assert host.stats.refused_clients == 0


def test_idle_reader_keeps_its_slot_unless_needed_and_old() -> None:
    with Host([Echo()], port=0, period=0.002, clients=2, inactivity_timeout=0.05) as host, ExitStack() as stack:
        first = stack.enter_context(RawClient(host.port))
        first.greeting()
        time.sleep(0.1)
        second = stack.enter_context(RawClient(host.port))
        second.greeting()
        first.sync()
    with Host([Echo()], port=0, period=0.002, clients=2, inactivity_timeout=60.0) as host, ExitStack() as stack:
        for client in [stack.enter_context(RawClient(host.port)) for _ in range(2)]:
            client.greeting()
        assert stack.enter_context(RawClient(host.port, b"")).is_closed()
        assert host.stats.evicted_clients == 0


def test_slot_of_the_master_is_free_after_its_disconnection() -> None:
    with Host([Echo()], port=0, period=0.002) as host, ExitStack() as stack:
        with RawClient(host.port, b"aw") as master:
            assert master.greeting().granted == "w"
            reader = stack.enter_context(RawClient(host.port))
            reader.greeting()
        until(lambda: host.writers == 0)
        with RawClient(host.port, b"aw") as other:
            assert other.greeting().granted == "w"
            assert host.writers == 1


def test_allwriters_lets_all_clients_write() -> None:
    echo = Echo()
    with Host([echo], port=0, period=0.002, allwriters=True) as host, ExitStack() as stack:
        clients = [stack.enter_context(RawClient(host.port, b"aw")) for _ in range(3)]
        assert [client.greeting().granted for client in clients] == ["w"] * 3
        for number, client in enumerate(clients):
            client.sync({"order": 10 + number})
            until(lambda number=number: 10 + number in echo.seen)  # type: ignore[misc]
            # Each client also receives its own values (section 4).
            clients[0].sync({})
            assert clients[0].value("order") == 10 + number


class Waits:
    """Server with a fake clock: notes the end of each wait, and lets time pass until the condition is true."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.clock = Clock()
        self.until: list[float | None] = []
        #: called at the start of a wait, to simulate events during the wait
        self.happens: Callable[[], None] = lambda: None
        self.clock.replace(host_module, monkeypatch)

    def serve(self, until: float | None, is_enough: Callable[[], bool]) -> None:
        self.until.append(until)
        self.happens()
        if not is_enough() and until is not None:
            self.clock.now = max(self.clock.now, until)


@pytest.mark.parametrize(
    ("writers", "is_asked", "synchronized", "until"),
    [
        (1, False, True, [101.0, 102.0, 103.0, 104.0]),  # a single writer gets an additional period
        (1, True, True, [101.0, 102.0, 102.0, 103.0]),
        (0, False, True, [101.0, 102.0, 102.0, 103.0]),
        (2, False, True, [101.0, 102.0, 102.0, 103.0]),
        (1, False, False, [101.0, 102.0]),
    ],
)
def test_synchronized_host_waits_only_for_a_single_writer(
    monkeypatch: pytest.MonkeyPatch, writers: int, is_asked: bool, synchronized: bool, until: list[float]
) -> None:
    waits = Waits(monkeypatch)
    host = Host(period=1.0, synchronized=synchronized)
    service: Any = SimpleNamespace(writers=writers, is_asked=is_asked)
    for _ in range(2):
        host._wait_for_tick(service, waits)  # type: ignore[arg-type]
    assert waits.until == until
    # Waiting for the writer does not count as being late.
    assert (host.stats.late_worst, host.stats.overruns) == (0.0, 0)


def test_stopped_host_does_not_wait_for_a_writer(monkeypatch: pytest.MonkeyPatch) -> None:
    waits = Waits(monkeypatch)
    host = Host(period=1.0, synchronized=True)
    service: Any = SimpleNamespace(writers=1, is_asked=False)
    waits.happens = host.stop
    host._wait_for_tick(service, waits)  # type: ignore[arg-type]
    assert (waits.until, waits.clock.now) == ([101.0], 100.0)
    # The host also stops waiting if it is stopped while it waits for a writer.
    host = Host(period=1.0, synchronized=True)
    waits.happens = lambda: host.stop() if len(waits.until) == 3 else None
    host._wait_for_tick(service, waits)  # type: ignore[arg-type]
    assert (waits.until, waits.clock.now) == ([101.0, 101.0, 102.0], 101.0)


def test_synchronized_host_waits_for_a_slow_master() -> None:
    with Host([Echo()], port=0, period=0.2, synchronized=True) as host, RawClient(host.port, b"aw") as master:
        master.greeting()
        master.sync({})
        first = master.value("tick")
        for number in range(1, 4):
            time.sleep(0.25)  # slightly more than one period; the master may take two
            master.sync({})
            assert master.value("tick") == first + number
        assert host.stats.overruns == 0


def test_synchronized_ticks_wait_for_the_master() -> None:
    echo = Echo()
    # The period is so long that the test ends within a single wait if the host waits at all.
    with Host([echo], port=0, period=0.1, synchronized=True) as host, RawClient(host.port, b"aw") as master:
        master.greeting()
        master.sync({"order": 1})
        first = master.value("tick")
        for number in range(5):
            master.sync({"order": number})
        assert master.value("tick") == first + 5
    assert echo.seen[-5:] == list(range(5))


def test_free_running_host_serves_its_clients() -> None:
    with Host([Echo()], port=0, pacing="free") as host, RawClient(host.port) as client:
        client.greeting()
        for _ in range(5):
            client.sync()
        assert host.stats.late_worst == 0.0  # no tick has a due time


def test_first_tick_is_due_a_period_after_the_start() -> None:
    host = Host([Stops(3)], port=0, period=0.05)
    began = time.monotonic()
    host.run()
    assert time.monotonic() - began >= 0.1
    assert host.stats.skipped < 1000  # the schedule does not begin at time zero


def test_free_running_ticks_follow_without_a_gap() -> None:
    host = Host([Stops(1000)], port=0, pacing="free")
    host.run()
    assert host.tick == 999


def test_missed_ticks_are_not_caught_up() -> None:
    """After a plugin has taken 50 periods, the next ticks come no closer together than before.

    A loaded machine only makes the ticks fewer, so the bound holds on any machine.
    """

    class Slow(Plugin):
        def __init__(self) -> None:
            self.ticks: list[float] = []

        def periodic(self, tick: int) -> None:
            self.ticks.append(time.monotonic())
            if tick == 3:
                time.sleep(0.5)

    slow = Slow()
    host = Host([slow, Stops(25)], port=0, period=0.01)
    host.run()
    # From the end of the slow round to the last tick there are 20 ticks. They take 20 periods, except for the part of a
    # period that had passed at the end of the slow round. Ticks that were caught up would take no time.
    assert slow.ticks[-1] - slow.ticks[4] >= 0.17
    assert host.stats.skipped >= 49
    assert host.tick == 24


@pytest.mark.property
@given(
    st.floats(0.001, 1.0),
    # Whole periods and a fraction of a period, so that rounding does not decide the result.
    st.lists(st.builds(float.__add__, st.integers(0, 20).map(float), st.floats(0.05, 0.95)), min_size=1, max_size=40),
)
def test_ticks_are_due_at_whole_periods_despite_delays(period: float, lateness: list[float]) -> None:
    schedule = TickSchedule(period, 100.0)
    now = 100.0
    for number, periods in enumerate(lateness, 1):
        due = schedule.advance()
        # The tick is not due before the period of the previous tick.
        assert due > now - period * 1e-6
        now = due + periods * period
        schedule.came(now)
        whole = (schedule.due - 100.0) / period
        assert whole == pytest.approx(number + schedule.skipped)
        assert 0.0 <= now - schedule.due < period * (1 + 1e-6)
    late = [periods for periods in lateness if periods > 1]
    assert (schedule.overruns, schedule.skipped) == (len(late), sum(map(int, late)))
    median, p99 = schedule.lateness()
    assert 0.0 <= median <= p99 <= schedule.worst == pytest.approx(max(lateness) * period)


def test_late_tick_is_counted_but_not_caught_up() -> None:
    class Slow(Plugin):
        late = threading.Event()

        def periodic(self, tick: int) -> None:
            if tick == 3:
                self.late.wait(0.05)

    host = Host([Slow(), Stops(10)], port=0, period=0.01)
    host.run()
    assert host.tick == 9
    assert host.stats.overruns >= 1
    assert host.stats.skipped >= 4
    assert host.stats.late_worst >= 0.03
    assert host.stats.late_median <= host.stats.late_p99 <= host.stats.late_worst


@pytest.mark.slow
def test_thousands_of_queued_requests_are_all_answered() -> None:
    """The requests exceed the buffer of the host, which reads again after it has replied to some of them."""
    with Host([Echo()], port=0, pacing="lockstep") as host, RawClient(host.port) as reader:
        reader.greeting()
        reader.send(b"rree" * 3000)
        for tick in range(1, 3001):
            reader.batch()
            assert reader.value("tick") == tick


def test_host_defaults_suit_the_original_clients() -> None:
    parameters = inspect.signature(Host).parameters
    assert parameters["port"].default == PORT == 24902
    assert parameters["address"].default == "127.0.0.1"
    assert not parameters["allwriters"].default
    assert not parameters["synchronized"].default
    assert (parameters["pacing"].default, parameters["resend"].default) == ("period", "changed")


@pytest.mark.parametrize(
    ("kind", "mode", "pacing", "synchronized"),
    [
        ("usleep", "", "period", False),
        ("itimer", '<mode value="synchronized"/>', "period", True),
        ("freerunning", '<mode value="synchronized"/>', "free", False),
        ("synchronized", '<mode value="synchronized"/>', "lockstep", False),
    ],
)
def test_scheduler_and_server_mode_in_a_file_set_the_pacing(
    kind: str, mode: str, pacing: str, synchronized: bool
) -> None:
    text = f'<rhd><scheduler><type value="{kind}"/></scheduler><server>{mode}</server></rhd>'
    host = Host.from_config(parse_config(text))
    assert (host._pacing, host._synchronized) == (pacing, synchronized)


CONFIG = """<rhd>
  <scheduler><period value="2000"/><type value="usleep"/></scheduler>
  <server><port value="0"/><clients number="3" allwriters="1"/></server>
  <plugins>
    <off enable="false" lib="libgone.so.1"/>
    <robot enable="true" lib="tests.rhdlink.test_host:Configured" critical="true" safety="3" gain="7">
      <x value="2"/>
    </robot>
  </plugins>
</rhd>"""


class Configured(Plugin):
    gain = Read(Int32)

    def init(self, config: Element) -> None:
        self.gain = config.integer("gain", 1) * config.integer("x", 1)

    def periodic(self, tick: int) -> None: ...


class Stepped(Plugin):
    def step(self, tick: int) -> None: ...


class Bare(Plugin): ...


class Misspelt(Noted):
    def termniate(self) -> None: ...


@pytest.mark.parametrize(
    ("plugin", "says"),
    [
        (Stepped(), r"Stepped has no method 'periodic', .*; no host calls its 'step'; define periodic\(self, tick\)"),
        (Bare(), r"Bare has no method 'periodic', which the host calls at each tick; define periodic\(self, tick\)"),
        (Misspelt("one", []), r"Misspelt has a method 'termniate', which no host calls; did you mean 'terminate'\?"),
    ],
)
def test_host_rejects_plugins_whose_methods_are_never_called(plugin: Plugin, says: str) -> None:
    with pytest.raises(BadValue, match=says):
        Host([plugin], port=0)
    with pytest.raises(BadValue, match=says):
        PluginLink([plugin])


def test_host_from_a_file_rejects_plugins_without_periodic() -> None:
    config = parse_config(CONFIG.replace(":Configured", ":Bare"))
    with pytest.raises(BadConfiguration, match="Bare has no method 'periodic'"):
        Host.from_config(config)


def test_host_is_created_from_a_file() -> None:
    with Host.from_config(parse_config(CONFIG)) as host, RawClient(host.port) as client:
        (plugin,) = host.plugins
        assert (plugin.name, plugin.is_critical, plugin.safety) == ("robot", True, 3)
        assert host.period == 0.002
        client.greeting()
        assert client.value("gain") == 14


def test_real_time_priority_logs_that_it_is_not_supported(caplog: pytest.LogCaptureFixture) -> None:
    Host.from_config(parse_config("<rhd/>"))
    assert caplog.text == ""
    Host.from_config(parse_config("<rhd><scheduler><realtimepriority enable='true'/></scheduler></rhd>"))
    assert "real-time priority is requested, but not supported by this host" in caplog.text


def test_arguments_override_the_file() -> None:
    host = Host.from_config(parse_config(CONFIG), period=0.5, clients=1)
    assert host.period == 0.5


def test_file_with_a_class_that_is_not_a_plugin_is_rejected() -> None:
    text = CONFIG.replace("tests.rhdlink.test_host:Configured", "collections:OrderedDict")
    with pytest.raises(BadConfiguration, match="is not an rhdlink"):
        Host.from_config(parse_config(text))
    with pytest.raises(BadConfiguration, match="in C"):
        Host.from_config(parse_config(CONFIG.replace('"false"', '"true"')))


@pytest.mark.parametrize(
    "wrong",
    [
        {"period": 0.0},
        {"period": float("nan")},
        {"period": float("inf")},
        {"port": 65536},
        {"port": -1},
        {"clients": 0},
        {"pacing": "cron"},
        {"resend": "never"},
        {"width": 3},
        {"client_timeout": 0.0},
        {"client_timeout": "5"},
        {"inactivity_timeout": -1.0},
        {"limits": 3},
        {"address": None},
    ],
)
def test_host_rejects_invalid_arguments(wrong: dict[str, Any]) -> None:
    with pytest.raises(BadValue):
        Host(**wrong)


def test_host_rejects_duplicate_plugins_and_a_second_run() -> None:
    plugin = Echo()
    with pytest.raises(BadValue):
        Host([plugin, plugin])
    host = Host([Stops()], port=0, period=0.001)
    host.run()
    with pytest.raises(Closed):
        host.run()
    host.close()
    host.close()


def test_start_raises_when_the_address_cannot_be_used() -> None:
    notes: list[str] = []
    with Host([Echo()], port=0) as host, pytest.raises(BadAddress, match="cannot listen"):
        Host([Noted("a", notes)], port=host.port).start()
    assert notes == ["init a", "terminate a"]
    with pytest.raises(BadAddress):
        Host(port=0, address="no.such.host.invalid").start()


@pytest.mark.real_time
@platforms.needs_fork
def test_forked_child_does_not_end_the_host_of_its_parent() -> None:
    with Host([Echo()], port=0, period=0.002) as host, RawClient(host.port) as client:
        client.greeting()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # forking with threads is intended here
            child = os.fork()
        if not child:  # pragma: no cover
            host.close()
            assert host._server is not None
            host._server.close()
            time.sleep(60)
            os._exit(0)
        try:
            for _ in range(3):
                client.sync()
            # The child is still running, but has no copy of the connection that would keep it open.
            client.send(b"nonsense")
            assert client.is_closed()
            with RawClient(host.port) as other:
                other.greeting()
                other.sync()
        finally:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)


@pytest.mark.parametrize(
    ("plugins", "text"),
    [
        (Echo(), r"expected a list of plugins: \[Echo\(...\)\]"),
        ([Echo], "is not a plugin; expected instances"),
        ([3], "3 is not a plugin"),
        (3, "plugins=3; expected a list of plugins"),
    ],
)
def test_host_rejects_objects_that_are_not_plugins(plugins: Any, text: str) -> None:
    with pytest.raises(BadValue, match=text):
        Host(plugins)

"""The host: how plugins live, when ticks come, and how it ends."""

from __future__ import annotations

import threading
from contextlib import ExitStack
from typing import Any

import pytest

from linkcore.errors import BadAddress, BadValue, Closed
from rhdlink.host.config import BadConfiguration, Element, parse_config
from rhdlink.host.host import Host, PluginFailed
from rhdlink.host.plugin import Plugin
from rhdlink.variables.declarations import Read, Write
from rhdlink.variables.value_types import Int32
from tests.rhdlink.raw_client import RawClient
from tests.waiting import until


class Noted(Plugin):
    """Notes what is done with it."""

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
    """Ends the host in its n-th round, after all others."""

    safety = 127

    def __init__(self, rounds: int = 1) -> None:
        self.rounds = rounds

    def periodic(self, tick: int) -> None:
        if tick + 1 >= self.rounds:
            self.host.stop()


def test_order_is_the_original_s_and_the_end_is_the_reverse_of_the_beginning() -> None:
    notes: list[str] = []
    plugins = [Noted("a", notes), Noted("safe", notes, safety=1), Noted("b", notes), Noted("safest", notes, safety=9)]
    Host([*plugins, Stops()], port=0, period=0.001).run()
    assert notes == [
        *("init a", "init b", "init safest", "init safe"),
        *("periodic(0) b", "periodic(0) a", "periodic(0) safe", "periodic(0) safest"),
        *("terminate safe", "terminate safest", "terminate b", "terminate a"),
    ]


def test_a_critical_plugin_that_fails_in_init_ends_the_host_before_it_begins() -> None:
    notes: list[str] = []
    host = Host([Noted("a", notes), Noted("bad", notes, fails_in="init"), Noted("c", notes)], port=0)
    with pytest.raises(PluginFailed, match="bad failed in init: RuntimeError: bad is out of order") as caught:
        host.start()
    assert caught.value.plugin == "bad"
    assert isinstance(caught.value.__cause__, RuntimeError)
    assert notes == ["init a", "init bad", "terminate a"]
    with pytest.raises(Closed):
        _ = host.port


def test_a_plugin_that_is_not_critical_may_fail_in_init(caplog: pytest.LogCaptureFixture) -> None:
    notes: list[str] = []
    host = Host(
        [Noted("a", notes), Noted("bad", notes, fails_in="init", critical=False), Stops()], port=0, period=0.001
    )
    host.run()
    assert notes == ["init a", "init bad", "periodic(0) a", "terminate a"]
    assert host.stats.failed_plugins == ("bad",)
    assert "bad failed in init" in caplog.text


def test_a_critical_plugin_that_fails_ends_the_host_in_order(caplog: pytest.LogCaptureFixture) -> None:
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


def test_in_a_thread_the_failure_is_kept_for_who_asks() -> None:
    notes: list[str] = []
    with Host([Noted("bad", notes, fails_in="periodic")], port=0, period=0.001) as host:
        with pytest.raises(PluginFailed):
            host.wait(10.0)
        assert isinstance(host.failure, PluginFailed)


def test_a_plugin_that_is_not_critical_is_disabled_and_the_host_goes_on(caplog: pytest.LogCaptureFixture) -> None:
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


def test_one_that_fails_at_the_end_keeps_nobody_from_ending(caplog: pytest.LogCaptureFixture) -> None:
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
        # The guard runs after the drive: the first round went too far, the others did not.
        assert master.value("moved") == 110


def test_variables_that_cannot_be_together_are_the_second_plugin_s_failure() -> None:
    class One(Plugin):
        speed = Write(Int32)

    class Other(Plugin):
        speed = Write(Int32, 2)

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


def test_in_lockstep_each_request_is_one_tick_and_the_bytes_are_the_same_each_time() -> None:
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
        return bytes(received), echo.seen

    first = run()
    assert first == run()
    assert first[1] == [number for number in range(50) if number % 3]


def test_in_lockstep_readers_go_along_with_the_master() -> None:
    with Host([Echo()], port=0, pacing="lockstep") as host, ExitStack() as stack:
        reader = stack.enter_context(RawClient(host.port))
        reader.greeting()
        reader.sync()
        assert reader.value("tick") == 1
        master = stack.enter_context(RawClient(host.port, b"aw"))
        master.greeting()
        # Now it is the master who makes the ticks: the reader waits for one.
        reader.send(b"rree")
        for _ in range(20):
            master.sync({"order": 7})
        assert master.value("tick") == 21
        reader.batch()
        assert 1 < reader.value("tick") <= 21


def test_an_update_is_seen_in_one_round_and_what_it_causes_goes_out_in_the_next() -> None:
    with Host([Echo()], port=0, pacing="lockstep") as host, RawClient(host.port, b"aw") as master:
        master.greeting()
        master.sync({"order": 5})
        assert (master.value("echo"), master.value("orders")) == (0, 0)
        master.sync({})
        assert (master.value("echo"), master.value("orders")) == (5, 1)
        # The same value again is an update too.
        master.sync({"order": 5})
        master.sync({})
        master.sync({})
        assert (master.value("echo"), master.value("orders")) == (5, 2)


def test_what_a_master_says_last_still_counts() -> None:
    echo = Echo()
    with Host([echo], port=0, period=0.002) as host:
        with RawClient(host.port, b"aw") as master:
            master.greeting()
            master.sync({"order": 8})
            # The last command, and the end, reach the host together.
            master.send(master.request({"order": 1}) + master.request({"order": 0}))
        until(lambda: host.writers == 0)
        until(lambda: 0 in echo.seen)
    assert echo.seen[0] == 8
    assert echo.seen[-1] == 0


def test_requests_sent_ahead_are_answered_one_a_tick() -> None:
    with Host([Echo()], port=0, period=0.002) as host, RawClient(host.port) as reader:
        reader.greeting()
        reader.send(b"rree" * 3)
        ticks = []
        for _ in range(3):
            reader.batch()
            ticks.append(reader.value("tick"))
        assert ticks == [ticks[0], ticks[0] + 1, ticks[0] + 2]


def test_a_request_may_have_no_values_and_any_order_and_an_end_needs_no_reply() -> None:
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


def test_seats_are_limited_and_free_again() -> None:
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


def test_the_master_s_seat_is_free_when_it_has_left() -> None:
    with Host([Echo()], port=0, period=0.002) as host, ExitStack() as stack:
        with RawClient(host.port, b"aw") as master:
            assert master.greeting().granted == "w"
            reader = stack.enter_context(RawClient(host.port))
            reader.greeting()
        until(lambda: host.writers == 0)
        with RawClient(host.port, b"aw") as other:
            assert other.greeting().granted == "w"
            assert host.writers == 1


def test_with_allwriters_all_may_write() -> None:
    echo = Echo()
    with Host([echo], port=0, period=0.002, allwriters=True) as host, ExitStack() as stack:
        clients = [stack.enter_context(RawClient(host.port, b"aw")) for _ in range(3)]
        assert [client.greeting().granted for client in clients] == ["w"] * 3
        for number, client in enumerate(clients):
            client.sync({"order": 10 + number})
            until(lambda number=number: 10 + number in echo.seen)  # type: ignore[misc]
            # Each is told its own values too (section 4).
            clients[0].sync({})
            assert clients[0].value("order") == 10 + number


def test_synchronized_each_tick_waits_for_the_master() -> None:
    echo = Echo()
    # So long a wait that the test ends within one if the host waits at all.
    with Host([echo], port=0, period=0.1, synchronized=True) as host, RawClient(host.port, b"aw") as master:
        master.greeting()
        master.sync({"order": 1})
        first = master.value("tick")
        for number in range(5):
            master.sync({"order": number})
        assert master.value("tick") == first + 5
    assert echo.seen[-5:] == list(range(5))


def test_free_running_ticks_follow_each_other() -> None:
    host = Host([Stops(1000)], port=0, pacing="free")
    host.run()
    assert host.tick == 999


def test_a_tick_that_comes_too_late_is_counted_and_not_made_up_for() -> None:
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


def test_a_host_from_a_file() -> None:
    with Host.from_config(parse_config(CONFIG)) as host, RawClient(host.port) as client:
        (plugin,) = host.plugins
        assert (plugin.name, plugin.is_critical, plugin.safety) == ("robot", True, 3)
        assert host.period == 0.002
        client.greeting()
        assert client.value("gain") == 14


def test_arguments_have_the_last_word_over_the_file() -> None:
    host = Host.from_config(parse_config(CONFIG), period=0.5, clients=1)
    assert host.period == 0.5


def test_a_class_that_is_no_plugin_is_refused() -> None:
    text = CONFIG.replace("tests.rhdlink.test_host:Configured", "collections:OrderedDict")
    with pytest.raises(BadConfiguration, match="is no rhdlink"):
        Host.from_config(parse_config(text))
    with pytest.raises(BadConfiguration, match="in C"):
        Host.from_config(parse_config(CONFIG.replace('"false"', '"true"')))


@pytest.mark.parametrize(
    "wrong",
    [
        {"period": 0.0},
        {"period": float("nan")},
        {"port": 65536},
        {"port": -1},
        {"clients": 0},
        {"pacing": "cron"},
        {"resend": "never"},
        {"width": 3},
        {"client_timeout": 0.0},
    ],
)
def test_arguments_that_cannot_be(wrong: dict[str, Any]) -> None:
    with pytest.raises(BadValue):
        Host(**wrong)


def test_a_plugin_is_given_once_and_a_host_runs_once() -> None:
    plugin = Echo()
    with pytest.raises(BadValue):
        Host([plugin, plugin])
    host = Host([Stops()], port=0, period=0.001)
    host.run()
    with pytest.raises(Closed):
        host.run()
    host.close()
    host.close()


def test_an_address_that_is_taken_or_is_none() -> None:
    notes: list[str] = []
    with Host([Echo()], port=0) as host, pytest.raises(BadAddress, match="cannot listen"):
        Host([Noted("a", notes)], port=host.port).start()
    assert notes == ["init a", "terminate a"]
    with pytest.raises(BadAddress):
        Host(port=0, address="no.such.host.invalid").start()

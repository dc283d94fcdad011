"""The thread that keeps a robot in sync: how it continues, gives up, fails and ends."""

from __future__ import annotations

import itertools
import threading
import time
from collections.abc import Iterator
from typing import Any

import pytest

import rhdlink
from linkcore.errors import BadValue, ConnectionLost, LocalError
from linkcore.simulated import Simulation
from rhdlink import Backoff, Int32, Read, Variables
from rhdlink.sync.sync_thread import SyncThread
from rhdlink.variables import Update
from tests.fakes.rhd import Peer, Robot, ScriptedServer, endless
from tests.waiting import until

pytestmark = pytest.mark.simulated_time


class Smr(Variables):
    tick = Read(Int32)
    encl = Read(Int32)


@pytest.fixture(autouse=True)
def leaves_no_thread() -> Iterator[None]:
    before = set(threading.enumerate())
    yield
    until(lambda: not set(threading.enumerate()) - before)


@pytest.mark.parametrize(
    "seed", [pytest.param(seed, marks=pytest.mark.simulated_time(seed=seed)) for seed in range(40)]
)
def test_only_one_of_two_sync_threads_starts(seed: int, simulated_time: Simulation) -> None:
    simulated_time.preempt("rhdlink")
    with ScriptedServer(endless(Robot())) as server, rhdlink.connect(server.address, Smr) as robot:
        robot.sync()
        errors: list[str] = []

        def begin() -> None:
            try:
                robot.background()
            except LocalError as error:
                errors.append(str(error))

        threads = [threading.Thread(target=begin) for _ in range(2)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert errors == [f"{server.address} already has a sync thread"]


def test_sync_thread_delivers_updates_of_changed_variables() -> None:
    with ScriptedServer(endless(Robot())) as server, rhdlink.connect(server.address, Smr) as robot:
        updates: list[Update] = []
        everything: list[Update] = []
        robot.subscribe(updates.append, "encl", policy=rhdlink.block)
        robot.subscribe(everything.append, policy=rhdlink.block)
        with robot.background() as sync_thread:
            until(lambda: len(updates) >= 20)
            with pytest.raises(LocalError, match="already has a sync thread"):
                robot.background()
        assert not sync_thread.is_running
        assert sync_thread.failure is None
        assert sync_thread.failures == 0
        syncs = sync_thread.syncs
        until(lambda: len(everything) == len(updates) == syncs)
        assert all(set(each.changes) == {"tick", "encl"} for each in everything)
        assert [each["tick"] for each in everything] == list(range(1, syncs + 1))
        assert [each["encl"] for each in updates] == [tick // 2 for tick in range(1, syncs + 1)]
        assert all(list(each.changes) == ["encl"] for each in updates)
        assert "tick" not in updates[0]
        # A variable is fresh because of its time stamp, and changed because of its value.
        assert [each.changes["encl"].changed for each in updates[:4]] == [False, True, False, True]
        assert updates[1].changes["encl"].stamp == (1000, 20_000)
        robot.sync()
        assert robot.tick == syncs + 1


def test_sync_thread_reconnects() -> None:
    side = Robot()

    def fails(peer: Peer) -> None:
        side.greet(peer)
        peer.expect(b"rree")
        peer.send(side.batch(1))

    with ScriptedServer(fails, fails, endless(side)) as server, rhdlink.connect(server.address, Smr) as robot:
        with robot.background(backoff=Backoff(first=0)) as sync_thread:
            until(lambda: sync_thread.syncs > 10)
        assert robot.reconnects == 2
        assert sync_thread.failures >= 2


def test_sync_thread_gives_up_after_the_allowed_tries() -> None:
    def fails(peer: Peer) -> None:
        Robot().greet(peer)

    with ScriptedServer(fails) as server:
        robot = rhdlink.connect(server.address, Smr)
        sync_thread = robot.background(backoff=Backoff(first=0, tries=0))
        until(lambda: not sync_thread.is_running)
        assert isinstance(sync_thread.failure, ConnectionLost)
        robot.close()


def test_sync_thread_keeps_its_period() -> None:
    with ScriptedServer(endless(Robot())) as server, rhdlink.connect(server.address, Smr) as robot:
        with robot.background(period=0.001) as sync_thread:
            until(lambda: sync_thread.syncs >= 5)
        assert robot.tick == sync_thread.syncs
        for period in (0, -1, float("inf")):
            with pytest.raises(BadValue, match="expected a positive number"):
                robot.background(period)


class Timed:
    """Object that notes the times of its syncs; each sync takes the duration that the test defines."""

    def __init__(self, *durations: float) -> None:
        self.times: list[float] = []
        self._durations = iter(durations)

    def sync(self) -> None:
        self.times.append(time.monotonic())
        time.sleep(next(self._durations, 0.0))


@pytest.mark.parametrize("late", [0.015, 0.055, 1.0])
def test_sync_thread_does_not_catch_up_missed_periods(late: float) -> None:
    """After a sync that exceeded the period, the next sync starts immediately, and then one per period."""
    timed = Timed(0.0, 0.0, late)
    with SyncThread(timed.sync, 0.01, name="sync"):
        until(lambda: len(timed.times) >= 12)
    gaps = [after - before for before, after in itertools.pairwise(timed.times[:12])]
    assert gaps == pytest.approx([0.01, 0.01, late, *[0.01] * 8], abs=1e-3)


def test_backoff_restarts_after_a_successful_sync() -> None:
    """With two tries, the thread survives any number of losses if the second try succeeds each time."""
    side = Robot()

    def answers_once(peer: Peer) -> None:
        side.greet(peer)
        peer.expect(b"rree")
        peer.send(side.batch(1))

    def leaves(peer: Peer) -> None:
        peer.expect(b"ar")

    scripts = [answers_once, leaves] * 4
    with ScriptedServer(*scripts, endless(side)) as server, rhdlink.connect(server.address, Smr) as robot:
        with robot.background(backoff=Backoff(first=0, tries=2)) as sync_thread:
            until(lambda: sync_thread.syncs > 10)
        assert sync_thread.failure is None
        # Each loss causes two failures: one when it is noticed, and one when the first new connection ends immediately.
        assert sync_thread.failures == 8
        assert robot.reconnects == 4


class Boom(BaseException):
    """Exception that no code expects."""


@pytest.mark.parametrize("error", [ValueError("boom"), SystemExit(3), Boom()])
def test_unexpected_exception_becomes_the_failure(error: BaseException, caplog: pytest.LogCaptureFixture) -> None:
    class Broken(Smr):
        def sync(self, timeout: float | None = None) -> None:
            raise error

    with ScriptedServer(lambda peer: Robot().greet(peer)) as server, rhdlink.connect(server.address, Broken) as robot:
        sync_thread = robot.background()
        until(lambda: sync_thread.failure is error)
        assert not sync_thread.is_running
        assert repr(error) in repr(sync_thread)
        robot.background()
    assert "sync ended because of an exception" in caplog.text


def test_dropped_robot_is_collected_with_a_warning() -> None:
    def drop_in_use(address: str) -> SyncThread:
        robot = rhdlink.connect(address, Smr)
        robot.subscribe(lambda update: None)
        sync_thread = robot.background()
        until(lambda: sync_thread.syncs > 3)
        return sync_thread

    warns = pytest.warns(ResourceWarning, match="Smr .* was dropped without close")
    with ScriptedServer(endless(Robot())) as server, warns:
        sync_thread = drop_in_use(server.address)
        until(lambda: not sync_thread.is_running)


def no_thread(self: threading.Thread) -> None:
    raise RuntimeError("can't start new thread")


def test_robot_stays_usable_when_no_thread_can_start(monkeypatch: pytest.MonkeyPatch) -> None:
    with ScriptedServer(endless(Robot())) as server, rhdlink.connect(server.address, Smr) as robot:
        with monkeypatch.context() as patched:
            patched.setattr(threading.Thread, "start", no_thread)
            with pytest.raises(LocalError, match="no thread could be started"):
                robot.background()
        robot.sync()
        with robot.background() as sync_thread:
            until(lambda: sync_thread.syncs > 3)


@pytest.mark.parametrize("period", [0, -1, float("nan"), float("inf"), "fast"])
def test_background_rejects_invalid_periods(period: Any) -> None:
    with (
        ScriptedServer(lambda peer: Robot().greet(peer)) as server,
        rhdlink.connect(server.address, Smr) as robot,
        pytest.raises(BadValue, match="expected a positive number of seconds"),
    ):
        robot.background(period)

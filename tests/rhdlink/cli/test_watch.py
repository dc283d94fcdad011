from __future__ import annotations

import os
import re
from collections.abc import Iterator

import pytest

import rhdlink
from linkcore.clock import Stamp
from linkcore.streaming.connection_life import ConnectionEvent, ConnectionState
from rhdlink import Host
from rhdlink.cli.watch_view import RateCounter
from rhdlink.host.plugins.turtle import Turtle
from rhdlink.variables import Change, TimeStamp, Update
from tests import platforms
from tests.harm import strict

from .conftest import Run, Spawn


@pytest.mark.slow
@pytest.mark.simulated_time
def test_plain_watch_prints_units_and_rates(run: Run, address: str) -> None:
    status, out, err = run("watch", address, "rotpos", "counter", "--plain", "--count", "2")
    assert status == 0
    watched, step = err.splitlines()
    assert re.fullmatch(r"rhdlink: watched for \d\.\d s; \d+ syncs \(\d+\.\d/s\), 0 reconnects", watched)
    assert step == f"rhdlink: next: rhdlink record {address} drive.urlog records the robot's data"
    first, second = out.splitlines()
    assert re.match(r"\d\d:\d\d:\d\d CONNECTED \| 127\.0\.0\.1:\d+ \| ", first)
    assert "| rotpos 0 = 0 rad" in first
    rate = re.search(r"\| counter -\d+ \((\d+)\.\d/s\)$", second)
    assert rate is not None
    assert 10 < int(rate[1]) <= 600
    assert "tick" not in out


@pytest.mark.simulated_time
def test_json_watch_prints_each_update(run: Run, address: str) -> None:
    status, out, err = run("watch", address, "--json", "counter", "tick", "--count", "5")
    assert (status, err) == (0, "")
    updates = [strict(each) for each in out.splitlines()]
    ticks = [each["variables"]["tick"][0] for each in updates]
    assert len(ticks) == 5
    assert ticks == sorted(set(ticks))
    # The handshake may fall between a plugin and the tick, and then the counter in the first batch is not new.
    assert all(each["variables"]["counter"][0] == 1 - each["variables"]["tick"][0] for each in updates[1:])
    assert updates[0]["stamps"].keys() == updates[0]["variables"].keys()


@pytest.mark.simulated_time
def test_watch_ends_after_its_duration(run: Run, address: str) -> None:
    for option in ("--plain", "--json"):
        status, out, _ = run("watch", address, option, "--duration", "0.3")
        assert status == 0
        assert out


@pytest.mark.simulated_time
def test_watch_reports_a_missing_variable(run: Run, address: str) -> None:
    status, out, err = run("watch", address, "nope")
    assert (status, out) == (1, "")
    assert "no variable 'nope'" in err


@pytest.mark.slow
@pytest.mark.real_time
def test_watch_shows_old_data_until_the_robot_returns(spawn: Spawn, own_port: int) -> None:
    with Host([Turtle()], period=0.002, port=own_port):
        process = spawn("watch", f"127.0.0.1:{own_port}", "tick", "--plain", "-vv")
        assert process.stdout is not None
        lines = iter(process.stdout.readline, "")
        assert any(" CONNECTED " in each for each in lines)
    lost = next(each for each in lines if " CONNECTED " not in each)
    assert "OLD DATA" in lost
    with Host([Turtle()], period=0.002, port=own_port):
        assert any(" CONNECTED " in each for each in lines)
        process.terminate()
        assert process.wait(20) == 143


def updates(times: int, *, names: tuple[str, ...]) -> Iterator[Update]:
    for number in range(times):
        changes = {name: Change(None, TimeStamp(number, 0), True) for name in names}
        yield Update(changes, Stamp(100.0 + number / 100, 0.0))


def test_watch_computes_rates_over_two_seconds() -> None:
    counter = RateCounter(began=100.0)
    for update in updates(50, names=("a", "b")):
        counter.on_update(update)
    assert counter.rates(100.49) == (None, {})
    assert counter.rates(100.5) == (100.0, {"a": 100.0, "b": 100.0})
    for update in updates(1000, names=("a",)):
        counter.on_update(update)
    rate, rates = counter.rates(109.99)
    assert rate == pytest.approx(100.0, abs=1.0)
    assert rates == {"a": rate}
    assert counter.rates(200.0) == (0.0, {})


def test_watch_shows_the_error_until_the_connection_is_restored() -> None:
    counter = RateCounter(began=0.0)
    lost = rhdlink.ConnectionLost("gone")
    counter.on_connection(ConnectionEvent(ConnectionState.LOST, "x", lost, Stamp(1.0, 1.0)))
    assert str(counter.trouble) == "gone"
    counter.on_connection(ConnectionEvent(ConnectionState.CONNECTED, "x", None, Stamp(2.0, 2.0)))
    assert counter.trouble is None, "connected again"
    assert counter.rates(2.4) == (None, {})


@pytest.mark.simulated_time
def test_watch_view_marks_old_data(address: str) -> None:
    from rhdlink.cli.watch_view import View

    with rhdlink.connect(address) as robot:
        view = View("x\x1b", ConnectionState.LOST, 3.2, 10.0, {}, robot.variables[:1], 1, "gone\x07")
    clock, _, text = view.as_line().partition(" ")
    assert re.fullmatch(r"\d\d:\d\d:\d\d", clock)
    assert text.startswith("LOST | x\\x1b | OLD DATA, 3.2 s | gone\\x07 | tick ")


@pytest.mark.slow
@pytest.mark.real_time
def test_watch_draws_on_a_terminal(spawn: Spawn, address: str) -> None:
    pytest.importorskip("rich")
    pty = pytest.importorskip("pty", reason=platforms.TERMINALS)  # not available on every system
    ours, theirs = pty.openpty()
    environment = os.environ | {"TERM": "xterm-256color", "COLUMNS": "100", "LINES": "40"}
    process = spawn("watch", address, "--duration", "1.2", stdout=theirs, env=environment)
    os.close(theirs)
    painted = b""
    while True:
        try:
            chunk = os.read(ours, 65536)
        except OSError:  # the other end is closed
            break
        if not chunk:
            break
        painted += chunk
    os.close(ours)
    assert process.wait(20) == 0
    text = painted.decode()
    assert "CONNECTED" in text
    assert "linesensor" in text
    assert re.search(r"\d+\.\d/s", text)

from __future__ import annotations

import re
from collections import deque
from pathlib import Path

import pytest

from linkcore.streaming.statistics import StreamStatistics
from urlink.cli.rate_measurement import line
from urlink.simulator import Controller

from .conftest import Run, write

pytestmark = pytest.mark.simulated_time


_STATS = StreamStatistics(
    received=9,
    decoded=8,
    failed=1,
    missed=7,
    gaps=2,
    longest_gap=0.4,
    slow_inline=0,
    reconnects=3,
    rate=0.0,
    bytes=0,
    skipped=0,
    resyncs=0,
    unknown=0,
    tails=0,
    age=None,
)
_COUNTERS = "received 9 missed 7 duplicates 0 failed 1 reconnects 3"


def test_hz_line_shows_rate_and_periods() -> None:
    text = line(deque([0.001, 0.002, 0.003]), 3, _STATS)
    assert text == f"500.00 Hz | period min 1.000 mean 2.000 max 3.000 std 0.816 ms | window 3 | {_COUNTERS}"


def test_hz_line_reports_too_few_states() -> None:
    assert line(deque(), 0, _STATS) == f"no new states | {_COUNTERS}"
    assert line(deque(), 1, _STATS) == f"one state so far | {_COUNTERS}"
    assert line(deque([0.0]), 1, _STATS).startswith("- Hz | period min 0.000")


@pytest.mark.parametrize(("interface", "low", "high"), [("realtime", 250, 1000), ("primary", 5, 20)])
def test_hz_measures_rate_of_simulator(run: Run, address: str, interface: str, low: float, high: float) -> None:
    status, out, err = run("hz", address, "--interface", interface, "--duration", "1.3")
    assert (status, err) == (0, "")
    lines = out.splitlines()
    assert len(lines) == 2
    rate = re.match(r"([\d.]+) Hz \| period min [\d.]+ mean [\d.]+ max [\d.]+ std [\d.]+ ms \| window \d+ ", lines[-1])
    assert rate is not None
    assert low < float(rate[1]) < high


def test_window_limits_number_of_periods(run: Run, address: str) -> None:
    status, out, _ = run("hz", address, "--window", "50", "--duration", "0.5")
    assert status == 0
    assert "| window 50 |" in out


def test_recording_is_measured_to_its_end(run: Run, recording: Path) -> None:
    status, out, _ = run("hz", f"replay://{str(recording).replace(' ', '%20')}")
    assert status == 0
    assert "| window 19 | received 20 " in out.splitlines()[-1]


def test_hz_fails_without_states(run: Run, controller: Controller, address: str, silent_address: str) -> None:
    status, _, err = run("hz", silent_address)
    assert status == 1
    assert "realtime: no state arrived" in err
    controller.faults.stall(30, "realtime")
    try:
        status, out, _ = run("hz", address, "--duration", "0.2")
    finally:
        controller.faults.heal()
    assert status == 1
    assert out.startswith("no new states | received 0 ")


def test_failed_packets_are_counted(run: Run, tmp_path: Path) -> None:
    controller = Controller("UR5", "1.8")
    controller.step()
    bad = bytes.fromhex("000001f4") + bytes(496)
    path = write(tmp_path / "x.urlog", {"realtime": [bad, bad]})
    status, out, err = run("hz", f"replay://{path}")
    assert status == 1
    assert "failed 2" in out
    assert "2 packets could not be decoded" in err

"""Real-time options that are requested from the system for urgent threads, and their results."""

from __future__ import annotations

import gc
import logging
import os
import sys
import threading
from collections.abc import Iterator

import pytest

import linkcore.streaming.scheduling
from linkcore.errors import BadValue
from linkcore.streaming.scheduling import realtime_options, urgent
from tests import platforms
from tests.fakes.link import ScriptedTransport, counts, scripted
from tests.waiting import until


@pytest.fixture(autouse=True)
def as_usual(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(linkcore.streaming.scheduling, "_reported", set())
    interval = sys.getswitchinterval()
    yield
    monkeypatch.undo()
    realtime_options(gc=True, switch_interval=interval)


class System:
    """Fake system calls, which record the requested priorities and CPUs by native thread id."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *, refuses: bool = False) -> None:
        self.priorities: dict[int, tuple[int, int]] = {}
        self.cpus: dict[int, set[int]] = {}

        def schedule(number: int, policy: int, parameter: os.sched_param) -> None:
            if refuses and parameter.sched_priority:
                raise PermissionError(1, "Operation not permitted")
            self.priorities[number] = (policy, parameter.sched_priority)

        monkeypatch.setattr(os, "sched_setscheduler", schedule)
        monkeypatch.setattr(os, "sched_setaffinity", lambda number, cpus: self.cpus.update({number: set(cpus)}))


linux = platforms.needs_linux


@linux
@pytest.mark.real_time
def test_realtime_options_apply_to_old_and_new_readers(monkeypatch: pytest.MonkeyPatch) -> None:
    system = System(monkeypatch)
    cpu = min(os.sched_getaffinity(0))
    high = (os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, 20)
    usual = (os.SCHED_OTHER, 0)
    first, second = ScriptedTransport(), ScriptedTransport()
    with scripted_stream(first) as before:
        report = realtime_options(priority=20, cpu=cpu)
        assert (report.granted, report.refused) == (("priority", "cpu"), {})
        assert (system.priorities[before], system.cpus[before]) == (high, {cpu})
        assert system.priorities[threading.get_native_id()] == usual  # this thread has only tried the options
        with scripted_stream(second) as after:
            assert (system.priorities[after], system.cpus[after]) == (high, {cpu})
            realtime_options()
            assert system.priorities[before] == system.priorities[after] == usual
    assert set(system.cpus[before]) == os.sched_getaffinity(0)


class scripted_stream:  # noqa: N801 - a context manager
    """Context manager: a stream that is being read; yields the native id of its reader thread."""

    def __init__(self, transport: ScriptedTransport) -> None:
        self.stream = scripted(transport)
        self.transport = transport

    def __enter__(self) -> int:
        numbers: list[int] = []
        self.stream.subscribe(lambda packet: numbers.append(threading.get_native_id()), inline=True)
        self.transport.put(counts(1))
        until(lambda: numbers)
        return numbers[0]

    def __exit__(self, *exc: object) -> None:
        self.stream.close()


@linux
def test_refused_option_is_reported_once(monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    system = System(monkeypatch, refuses=True)
    monkeypatch.setattr(linkcore.streaming.scheduling, "_call_mlock", lambda is_wanted: _refuse())
    with caplog.at_level(logging.WARNING):
        for _ in range(3):
            report = realtime_options(priority=50, cpu=0, lock_memory=True)
    assert report.granted == ("cpu",)
    assert list(report.refused) == ["priority", "lock_memory"]
    assert "Operation not permitted" in report.refused["priority"]
    assert "late by milliseconds" in str(report)
    assert [record.levelname for record in caplog.records] == ["WARNING"]
    with urgent():  # applies the granted options
        assert system.cpus[threading.get_native_id()] == {0}
        assert system.priorities[threading.get_native_id()] == (os.SCHED_OTHER, 0)


def _refuse() -> None:
    raise OSError(12, "Cannot allocate memory")


def test_realtime_options_set_gc_and_switch_interval() -> None:
    assert realtime_options(gc=False).granted == ("gc",)
    assert not gc.isenabled()
    frozen = gc.get_freeze_count()
    assert realtime_options(gc="freeze", switch_interval=0.001).granted == ("gc", "switch_interval")
    assert gc.isenabled()
    assert gc.get_freeze_count() >= frozen
    assert sys.getswitchinterval() == pytest.approx(0.001)


def test_realtime_options_reject_invalid_values() -> None:
    for options in (
        {"priority": 0},
        {"priority": 100},
        {"cpu": 99999},
        {"cpu": ()},
        {"gc": "off"},
        {"switch_interval": 0},
    ):
        with pytest.raises(BadValue, match=next(iter(options))):
            realtime_options(**options)

"""`urlink serve` with an adapter that is not a distribution. The real adapters are tested in packages/*/tests."""

from __future__ import annotations

import argparse
import contextlib
import importlib.metadata
import threading
from collections.abc import Iterator, Mapping
from typing import Any

import pytest

import urlink
from urlink.cli.serve import named

from .conftest import Run


class Entry:
    """Entry point whose adapter records its arguments."""

    name = "fake"

    def __init__(self) -> None:
        self.served: list[Any] = []

    def load(self) -> Entry:
        return self

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument("--topic", default="robots")

    @contextlib.contextmanager
    def serve(self, robots: Mapping[str, urlink.Robot], args: argparse.Namespace) -> Iterator[None]:
        self.served.append((args.topic, args.watchdog, {name: str(robot.firmware) for name, robot in robots.items()}))
        with pytest.raises(urlink.NotEnabled):
            robots["arm"].motion.move_joints([0.0] * 6)
        yield
        self.served.append("ended")


@pytest.fixture
def entry(monkeypatch: pytest.MonkeyPatch) -> Entry:
    entry = Entry()
    monkeypatch.setattr(importlib.metadata, "entry_points", lambda group: [entry] if group == "urlink.serve" else [])
    return entry


def test_serve_lists_available_distributions(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.metadata, "entry_points", lambda group: [])
    status, out, err = run("serve")
    assert (status, err) == (0, "")
    for distribution in (
        "urlink-zenoh",
        "urlink-rr",
        "urlink-ros2",
        "urlink-mqtt",
        "urlink-opcua",
        "urlink-mcp",
        "urlink-prometheus",
    ):
        assert f"pip install {distribution}" in out
    for kind, says in (
        ("rr", "pip install urlink-rr"),
        ("carrier-pigeon", "expected one of mcp, mqtt, opcua, prometheus, ros2, rr, zenoh"),
    ):
        status, out, err = run("serve", kind, "sim://")
        assert (status, out) == (1, "")
        assert says in err


@pytest.mark.real_time
def test_serve_runs_adapter_with_named_robots(run: Run, entry: Entry) -> None:
    assert "fake       (installed)" in run("serve")[1]
    options = ("--duration", "0.1", "--topic", "hall", "--require-enable", "on_startup", "--watchdog", "2")
    status, out, err = run("serve", "fake", "arm=sim://ur5e?firmware=5.11", *options)
    assert (status, out) == (0, "serving arm over fake; Ctrl-C ends it\n")
    assert "arm: UR5e, firmware 5.11" in err
    assert entry.served == [("hall", 2.0, {"arm": "5.11"}), "ended"]


@pytest.mark.real_time
def test_serve_ends_when_event_of_adapter_is_set(run: Run, entry: Entry, monkeypatch: pytest.MonkeyPatch) -> None:
    ended = threading.Event()
    ended.set()
    monkeypatch.setattr(entry, "serve", lambda robots, args: contextlib.nullcontext(ended))
    assert run("serve", "fake", "arm=sim://ur5e?firmware=5.11")[:2] == (0, "serving arm over fake; Ctrl-C ends it\n")


@pytest.mark.real_time
def test_serve_passes_points_of_adapter_to_robots(run: Run, entry: Entry, monkeypatch: pytest.MonkeyPatch) -> None:
    names: list[list[str]] = []

    def add_arguments(parser: argparse.ArgumentParser) -> None:
        parser.add_argument("--points")

    @contextlib.contextmanager
    def serve(robots: Mapping[str, urlink.Robot], args: argparse.Namespace) -> Iterator[None]:
        names.append(list(robots["arm"].points))
        yield

    monkeypatch.setattr(entry, "add_arguments", add_arguments)
    monkeypatch.setattr(entry, "serve", serve)
    status, _, _ = run("serve", "fake", "arm=sim://ur5e?firmware=5.11", "--duration", "0.1", "--points", "cell.json")
    assert (status, names) == (0, [[]])


@pytest.mark.parametrize("argv", [("fake",), ("fake", "a=sim://", "a=sim://ur10"), ("fake", "sim://", "--no-such")])
def test_wrong_usage_of_serve_exits_with_2(run: Run, entry: Entry, argv: tuple[str, ...]) -> None:
    status, out, err = run("serve", *argv)
    assert (status, out) == (2, "")
    assert "urlink serve fake" in err
    assert entry.served == []


def test_serve_help_has_options_of_adapter(run: Run, entry: Entry) -> None:
    status, out, _ = run("serve", "fake", "--help")
    assert status == 0
    assert "--topic" in out
    assert "--require-enable" in out


def test_robot_without_name_is_named_after_its_address() -> None:
    given = ["ur://robot-3.local?primary=40001", "replay:///data/run%201.urlog", "sim://", "b=sim://"]
    assert list(named(given)) == ["ur_robot_3_local", "run_run_1", "sim", "b"]
    with pytest.raises(urlink.BadAddress, match="have the same name sim"):
        named(["sim://", "sim://"])

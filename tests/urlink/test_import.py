"""Importing urlink starts nothing, touches no network and brings in nothing that is not needed."""

from __future__ import annotations

import json
import subprocess
import sys
from typing import Any

import pytest

import urlink

pytestmark = pytest.mark.real_time

#: What the commands, the simulator and the plots need, and a reading program does not.
NOT_NEEDED = (
    "rich",
    "matplotlib",
    "lark",
    "urlink.simulator",
    "urlink.cli",
    "hypothesis",
    "asyncio",
    "multiprocessing",
    "construct",
)

#: What decoding bytes does without.
NOT_NEEDED_TO_DECODE = (
    *NOT_NEEDED,
    "socket",
    "linkcore.net",
    "linkcore.streaming",
    "linkcore.recording",
    "urlink.command",
    "urlink.motion",
    "urlink.protocol.dashboard",
)

#: What connecting and reading states does without.
NOT_NEEDED_TO_READ = (
    *NOT_NEEDED,
    "linkcore.recording",
    "linkcore.handle",
    "linkcore.wire.http",
    "urlink.command.channel",
    "urlink.motion.control",
    "urlink.protocol.dashboard",
    "urlink.protocol.gripper",
    "urlink.protocol.rtde",
    "urlink.arm.kinematics",
    "urlink.motion",
    "urlink.script.commands",
)

# A fresh interpreter: in this one everything has been imported already.
PROGRAM = """
import json, sys, threading
import numpy
told = []
sys.addaudithook(lambda event, arguments: told.append(event))
before = set(sys.modules)
{statement}
events = sorted({{event for event in told if event.split(".")[0] in ("socket", "subprocess", "os", "_thread")}})
print(json.dumps({{
    "events": events,
    "threads": threading.active_count(),
    "modules": sorted(set(sys.modules)),
}}))
"""


def outcome(statement: str) -> dict[str, Any]:
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", PROGRAM.format(statement=statement)], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    told: dict[str, Any] = json.loads(done.stdout)
    return told


@pytest.fixture(scope="module")
def imported() -> dict[str, Any]:
    """With every public name, each of which is imported when it is asked for, but those that are for asyncio."""
    names = [name for name in vars(urlink)["__all__"] if "async" not in name.lower()]
    return outcome(f"from urlink import {', '.join(names)}; import urlink")


def test_starts_no_thread_and_opens_no_socket(imported: dict[str, Any]) -> None:
    assert imported["threads"] == 1
    assert [event for event in imported["events"] if not event.startswith("os.")] == []


@pytest.mark.parametrize(
    ("statement", "event"),
    [
        ("import socket; socket.socket().close()", "socket.__new__"),
        ("import threading; threading.Thread(target=print).start()", "_thread.start_new_thread"),
    ],
)
def test_it_would_be_noticed(statement: str, event: str) -> None:
    if event.startswith("_thread") and sys.version_info < (3, 12):
        # Before, starting a thread told no hook; but it can be counted.
        statement = "import threading; threading.Thread(target=threading.Event().wait, daemon=True).start()"
        assert outcome(statement)["threads"] == 2
    else:
        # From 3.13 on, threading starts threads that can be joined, which is an event of its own.
        events = {name.replace("start_joinable_thread", "start_new_thread") for name in outcome(statement)["events"]}
        assert event in events


def those(modules: list[str], unwanted: tuple[str, ...]) -> list[str]:
    return [each for each in modules if any(each == name or each.startswith(f"{name}.") for name in unwanted)]


def test_imports_nothing_that_is_not_needed(imported: dict[str, Any]) -> None:
    assert "urlink.robot" in imported["modules"]
    assert those(imported["modules"], NOT_NEEDED) == []


@pytest.mark.slow
def test_who_only_decodes_imports_no_streams_and_no_commands() -> None:
    modules = outcome("import urlink; urlink.decode(b'', 'primary', '5.11'); urlink.packets.RealtimeState('3.4')")[
        "modules"
    ]
    assert "urlink.protocol.decoding" in modules
    assert those(modules, NOT_NEEDED_TO_DECODE) == []


def test_who_connects_and_reads_imports_nothing_that_commands() -> None:
    modules = outcome("import urlink; urlink.connect; urlink.Robot.realtime; urlink.packets.RealtimeState")["modules"]
    assert "urlink.robot" in modules
    assert those(modules, NOT_NEEDED_TO_READ) == []


@pytest.mark.slow
def test_the_simulator_is_imported_by_who_asks_for_it() -> None:
    assert "urlink.simulator" in outcome("import urlink.simulator")["modules"]
    # Its sockets only by who starts it.
    assert "urlink.simulator.server" not in outcome("import urlink.simulator")["modules"]

"""Tests that importing urlink starts nothing, uses no network and imports no unneeded module."""

from __future__ import annotations

import json
import subprocess
import sys
from typing import Any

import pytest

import urlink

pytestmark = pytest.mark.real_time

#: Modules for commands, the simulator and plots, which a program that only reads does not need.
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

#: Modules that are not needed to decode bytes.
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

#: Modules that are not needed to connect and read states.
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

# Program for a new interpreter, because the interpreter of the tests has already imported everything.
PROGRAM = """
import json, sys, threading
import numpy
audited = []
sys.addaudithook(lambda event, arguments: audited.append(event))
before = set(sys.modules)
{statement}
events = sorted({{event for event in audited if event.split(".")[0] in ("socket", "subprocess", "os", "_thread")}})
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
    audited: dict[str, Any] = json.loads(done.stdout)
    return audited


@pytest.fixture(scope="module")
def imported() -> dict[str, Any]:
    """Provide the outcome of importing every public name except the names for asyncio.

    Each name is imported at its first use.
    """
    names = [name for name in vars(urlink)["__all__"] if "async" not in name.lower()]
    return outcome(f"from urlink import {', '.join(names)}; import urlink")


def test_import_starts_no_thread_and_opens_no_socket(imported: dict[str, Any]) -> None:
    assert imported["threads"] == 1
    assert [event for event in imported["events"] if not event.startswith("os.")] == []


@pytest.mark.parametrize(
    ("statement", "event"),
    [
        ("import socket; socket.socket().close()", "socket.__new__"),
        ("import threading; threading.Thread(target=print).start()", "_thread.start_new_thread"),
    ],
)
def test_import_check_detects_sockets_and_threads(statement: str, event: str) -> None:
    if event.startswith("_thread") and sys.version_info < (3, 12):
        # Before 3.12, starting a thread raises no audit event, but the thread can be counted.
        statement = "import threading; threading.Thread(target=threading.Event().wait, daemon=True).start()"
        assert outcome(statement)["threads"] == 2
    else:
        # Since 3.13, threading starts joinable threads, which raise a different event.
        events = {name.replace("start_joinable_thread", "start_new_thread") for name in outcome(statement)["events"]}
        assert event in events


def those(modules: list[str], unwanted: tuple[str, ...]) -> list[str]:
    return [each for each in modules if any(each == name or each.startswith(f"{name}.") for name in unwanted)]


def test_import_loads_no_unneeded_module(imported: dict[str, Any]) -> None:
    assert "urlink.robot" in imported["modules"]
    assert those(imported["modules"], NOT_NEEDED) == []


@pytest.mark.slow
def test_decoding_loads_no_streams_and_no_commands() -> None:
    modules = outcome("import urlink; urlink.decode(b'', 'primary', '5.11'); urlink.packets.RealtimeState('3.4')")[
        "modules"
    ]
    assert "urlink.protocol.decoding" in modules
    assert those(modules, NOT_NEEDED_TO_DECODE) == []


def test_reading_loads_no_command_module() -> None:
    modules = outcome("import urlink; urlink.connect; urlink.Robot.realtime; urlink.packets.RealtimeState")["modules"]
    assert "urlink.robot" in modules
    assert those(modules, NOT_NEEDED_TO_READ) == []


@pytest.mark.slow
def test_simulator_is_imported_on_request() -> None:
    assert "urlink.simulator" in outcome("import urlink.simulator")["modules"]
    # The server, which opens sockets, is imported only when a controller is started.
    assert "urlink.simulator.server" not in outcome("import urlink.simulator")["modules"]

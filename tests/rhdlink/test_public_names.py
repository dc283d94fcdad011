"""The public names of rhdlink. A change here is a change for users, and stands in the changelog."""

from __future__ import annotations

import inspect
import json
import subprocess
import sys

import pytest

import rhdlink

NAMES = [
    "AccessDenied",
    "Ackerman",
    "Background",
    "Backoff",
    "BadAddress",
    "BadConfiguration",
    "BadRecording",
    "BadValue",
    "Bool",
    "Change",
    "Closed",
    "Configuration",
    "ConnectFailed",
    "ConnectionEvent",
    "ConnectionLost",
    "ConnectionState",
    "Database",
    "Float32",
    "Float64",
    "Gps",
    "Host",
    "HostStatistics",
    "Int32",
    "Int64",
    "Kind",
    "Limits",
    "LinkError",
    "LinkTimeout",
    "LocalError",
    "Millionths",
    "NotThere",
    "PacketError",
    "Plugin",
    "PluginFailed",
    "Policy",
    "Read",
    "RemoteError",
    "Scaled",
    "Smr",
    "Stamp",
    "Structure",
    "Subscription",
    "Text",
    "TimeStamp",
    "UInt32",
    "Update",
    "Variable",
    "Variables",
    "VelocityOmega",
    "Write",
    "WrongPeer",
    "WrongVariables",
    "block",
    "connect",
    "drop_oldest",
    "latest",
    "read_config",
]


def test_public_names() -> None:
    assert sorted(rhdlink.__all__) == NAMES
    assert sorted(set(NAMES)) == NAMES


def test_each_is_there_and_says_what_it_is() -> None:
    for name in NAMES:
        value = getattr(rhdlink, name)
        if inspect.isclass(value) or inspect.isfunction(value):
            assert inspect.getdoc(value), f"{name} has no docstring"


def test_nothing_public_is_forgotten() -> None:
    """What the package imports for users is in `__all__`; modules are no names."""
    there = {name for name, value in vars(rhdlink).items() if not name.startswith("_") and not inspect.ismodule(value)}
    assert there - {"annotations"} == set(NAMES)


PROGRAM = """
import json, sys, threading
told = []
sys.addaudithook(lambda event, arguments: told.append(event))
import rhdlink
print(json.dumps({
    "events": sorted({event for event in told if event.split(".")[0] in ("socket", "subprocess", "_thread")}),
    "threads": threading.active_count(),
    "modules": sorted(sys.modules),
}))
"""


def test_importing_it_starts_nothing_and_brings_in_nothing_that_is_not_needed() -> None:
    done = subprocess.run([sys.executable, "-W", "error", "-c", PROGRAM], capture_output=True, text=True, check=True)
    told = json.loads(done.stdout)
    assert (told["threads"], told["events"]) == (1, [])
    for name in ("rich", "matplotlib", "construct", "asyncio", "rhdlink.cli", "linkcore.cli", "urlink"):
        assert name not in told["modules"], name


@pytest.mark.parametrize("robot", [rhdlink.Smr, rhdlink.VelocityOmega, rhdlink.Ackerman, rhdlink.Gps])
def test_the_ready_made_robots_say_what_their_variables_are(robot: type[rhdlink.Variables]) -> None:
    assert inspect.getdoc(robot)
    assert robot.declared()

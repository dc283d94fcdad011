"""The public names of rhdlink. A change here affects users, and must be in the changelog."""

from __future__ import annotations

import inspect
import json
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest

import rhdlink
import rhdlink.sync.sync_thread
from rhdlink.host.plugins.logger import Logger
from rhdlink.host.plugins.turtle import SmrTurtle, Turtle
from rhdlink.host.plugins.velocity import VelocityBridge
from rhdlink.host.world import World
from tests.listed import assert_listed

NAMES = [
    "AccessDenied",
    "Backoff",
    "BadAddress",
    "BadConfiguration",
    "BadMission",
    "BadRecording",
    "BadValue",
    "Bool",
    "Cancelled",
    "Closed",
    "ConnectFailed",
    "ConnectionLost",
    "ConnectionState",
    "Drive",
    "Float32",
    "Float64",
    "Host",
    "HostFailed",
    "Int32",
    "Int64",
    "LinkError",
    "LinkTimeout",
    "LocalError",
    "Millionths",
    "Mission",
    "MissionFailed",
    "MissionLimit",
    "NotThere",
    "PacketError",
    "Phase",
    "Plugin",
    "PluginFailed",
    "Read",
    "RemoteError",
    "Scaled",
    "Structure",
    "Text",
    "UInt32",
    "Variables",
    "Write",
    "WrongPeer",
    "WrongVariables",
    "block",
    "connect",
    "connect_async",
    "drop_oldest",
    "latest",
    "load",
    "schema",
    "simulated_time",
]


#: This file, as named in the messages.
HERE = "tests/rhdlink/test_public_names.py"
#: Modules with further public names.
MODULES = ["host", "mqtt", "robots", "smrcl", "variables"]


def test_public_names_equal_the_list() -> None:
    assert_listed(vars(rhdlink)["__all__"], NAMES, f"NAMES in {HERE}")
    assert_listed(dir(rhdlink), [*NAMES, *MODULES], f"NAMES or MODULES in {HERE}")
    assert sorted(set(NAMES)) == NAMES


def test_public_name_is_in_only_one_module() -> None:
    places = [rhdlink, *(getattr(rhdlink, module) for module in MODULES)]
    names = Counter(name for place in places for name in vars(place)["__all__"])
    twice = [name for name, count in names.items() if count > 1]
    assert not twice, f"remove from all but one __all__ of src/rhdlink/: {', '.join(twice)}"


def errors(*places: object) -> list[str]:
    held = {name: getattr(place, name) for place in places for name in vars(place)["__all__"]}
    return [name for name, each in held.items() if inspect.isclass(each) and issubclass(each, BaseException)]


def test_every_error_is_public_and_documented() -> None:
    assert errors(*(getattr(rhdlink, module) for module in MODULES)) == []
    page = (Path(__file__).parents[2] / "docs" / "errors.md").read_text(encoding="utf-8")
    assert [name for name in errors(rhdlink) if name not in page] == []


def test_every_public_name_has_a_docstring() -> None:
    for name in NAMES:
        value = getattr(rhdlink, name)
        if inspect.isclass(value) or inspect.isfunction(value):
            assert inspect.getdoc(value), f"{name} has no docstring"


#: The attributes and methods of public objects, as tab completion shows them; declared variables are listed as well.
VARIABLES = """access address background changed close connection declared discarded fresh received reconnects stamp
    subscribe subscribe_connection sync updated variables width"""
PLUGIN = "declared init is_critical is_updated name periodic safety terminate"
VALUE_TYPE = "length pack pack_many packer reader unit unpack unpack_many"
SURFACES: list[tuple[object, str]] = [
    (rhdlink.Variables, VARIABLES),
    (rhdlink.robots.Smr, f"{VARIABLES} {' '.join(rhdlink.robots.Smr.declared())}"),
    (rhdlink.sync.sync_thread.SyncThread, "close is_running"),
    (rhdlink.variables.Update, ""),
    (rhdlink.Host, "address close from_config plugins port run start stats stop wait writers"),
    (rhdlink.Plugin, PLUGIN),
    (Turtle, f"{PLUGIN} {' '.join(Turtle.declared())}"),
    (SmrTurtle, f"{PLUGIN} {' '.join(SmrTurtle.declared())}"),
    (VelocityBridge, f"{PLUGIN} stats update_pose {' '.join(VelocityBridge.declared())}"),
    (Logger, f"{PLUGIN} path stats"),
    (rhdlink.variables.Database, "encode_handshake freeze table"),
    (
        rhdlink.variables.Database().read,
        """add begin_round changed clock direction dirty encode find fresh is_frozen layout memory receive rows select
        set set_many stamp stamps start updated value values words""",
    ),
    (rhdlink.Read(rhdlink.Int32), "attribute count direction doc is_optional length name order type unit unpack"),
    (rhdlink.Int32, VALUE_TYPE),
    (rhdlink.Scaled(0.1), f"{VALUE_TYPE} scale"),
    (World(), "blocked brightness odometry path pose scene size start step wall"),
]


@pytest.mark.parametrize(("held", "names"), SURFACES)
def test_public_attributes_of_each_class_equal_the_list(held: object, names: str) -> None:
    there = [name for name in dir(held) if not name.startswith("_")]
    assert_listed(there, names.split(), f"the row of {held!r} of SURFACES in {HERE}")


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


@pytest.mark.real_time
def test_import_starts_no_thread_and_loads_no_extra_module() -> None:
    done = subprocess.run([sys.executable, "-W", "error", "-c", PROGRAM], capture_output=True, text=True, check=True)
    told = json.loads(done.stdout)
    assert (told["threads"], told["events"]) == (1, [])
    for name in (
        *("rich", "matplotlib", "construct", "asyncio", "rhdlink.cli", "linkcore.cli", "urlink"),
        *("rhdlink.drive", "rhdlink.smrcl"),
    ):
        assert name not in told["modules"], name


@pytest.mark.parametrize(
    "robot", [rhdlink.robots.Smr, rhdlink.robots.VelocityOmega, rhdlink.robots.Ackerman, rhdlink.robots.Gps]
)
def test_predefined_robots_are_documented_and_declared(robot: type[rhdlink.Variables]) -> None:
    assert inspect.getdoc(robot)
    assert robot.declared()

"""The turtle must drive exactly as the robots that the original MRC drove, to the last recorded digit."""

from __future__ import annotations

import csv
import math
from pathlib import Path
from typing import Any

import pytest

from linkcore.errors import BadValue
from rhdlink.host.config import Configuration, Element, parse_config
from rhdlink.host.host import Host
from rhdlink.host.plugin import Plugin
from rhdlink.host.plugins.turtle import SmrTurtle, Turtle
from rhdlink.host.world import World
from rhdlink.wire.decoder import ClientDecoder
from tests.real_captures import folder
from tests.rhdlink.raw_client import RawClient

pytestmark = pytest.mark.simulated_time


@pytest.fixture
def drives() -> Path:
    return folder("mrc")


class Watched(Plugin):
    """Plugin that notes the pose of the robot in each round."""

    safety = 1

    def __init__(self, world: World) -> None:
        self.world = world
        self.poses: list[tuple[str, ...]] = []

    def periodic(self, tick: int) -> None:
        self.poses.append(tuple(f"{value:.6f}" for value in self.world.odometry))


LOCKSTEP = (
    "arc_lockstep",
    "spiral_lockstep",
    "arc_then_wait",
    "arc_then_stop",
    "server_arc",
)


@pytest.mark.slow
@pytest.mark.captures("mrc")
@pytest.mark.matrix(3)
@pytest.mark.parametrize("drive", [f"{kind}_{name}" for kind in ("vw", "smr") for name in LOCKSTEP])
def test_recorded_commands_reproduce_the_recorded_drive(drives: Path, drive: str) -> None:
    with (drives / f"{drive}.csv").open() as file:
        columns, *rows = csv.reader(file)
    # Some drives are longer than 11 m.
    world = World(1000.0)
    turtle = Turtle(world) if drive.startswith("vw") else SmrTurtle(world)
    commands = columns[5 : columns.index("tick", 5)]
    reported = columns[columns.index("tick", 5) :]
    watched = Watched(world)
    with Host([turtle, watched], port=0, pacing="lockstep") as host, RawClient(host.port, b"aw") as master:
        master.greeting()
        found = []
        for row in rows:
            written = dict(zip(commands, map(int, row[5:]), strict=False))
            master.sync(written)
            found.append([str(master.value(name)) for name in reported])
    assert found == [row[5 + len(commands) :] for row in rows]
    assert watched.poses[: len(rows)] == [tuple(row[2:5]) for row in rows]
    assert len(rows) > 600


@pytest.mark.slow
@pytest.mark.captures("mrc")
@pytest.mark.parametrize("drive", ["vw_arc", "vw_spiral", "smr_arc", "smr_spiral"])
def test_recorded_bytes_of_mrc_move_the_turtle_identically(drives: Path, drive: str) -> None:
    """The bytes are sent as fast as replies arrive, and must move the robot exactly as in the recording."""
    asked = (drives / f"{drive}_rhd64.c2s.bin").read_bytes()
    with (drives / f"{drive}_rhd64.csv").open() as file:
        rows = list(csv.reader(file))[1:]
    world = World(1000.0)
    turtle = Turtle(world) if drive.startswith("vw") else SmrTurtle(world)
    watched = Watched(world)
    with Host([turtle, watched], port=0, pacing="lockstep") as host, RawClient(host.port, asked[:2]) as master:
        assert master.greeting().granted == "w"
        for request in requests(asked, host):
            master.send(request)
            batch = master.batch()
            # The original server replies to its only master with read variables only.
            assert [data.direction for data in batch.data] == ["r"]
    # The original made more ticks before and after the drive, so only the poses during the motion are compared.
    theirs = [tuple(row[1:4]) for row in rows]
    moved = sorted(set(theirs), key=theirs.index)
    ours = sorted(set(watched.poses), key=watched.poses.index)
    assert ours == moved
    assert len(moved) > 500


def requests(asked: bytes, host: Host) -> list[bytes]:
    """Return the bytes of MRC after its access request, split into requests."""
    stream = ClientDecoder(host.database.write.layout)
    stream.feed(asked)
    assert stream.take_access() == "w"
    found, at = [], 2
    while (request := stream.take_request()) is not None:
        found.append(asked[at : at + request.size])
        at += request.size
    assert at == len(asked)
    return found


def lockstep(turtle: Plugin) -> Host:
    return Host([turtle], port=0, pacing="lockstep")


def test_encoder_counters_stop_when_the_turtle_hits_a_wall() -> None:
    turtle = Turtle(World(1.0), linear_scale=1000.0)
    with lockstep(turtle) as host, RawClient(host.port, b"aw") as master:
        master.greeting()
        for _ in range(102):
            master.sync({"cmdtransvel": 1000})
        assert master.value("transpos") == 500
        for _ in range(12):
            master.sync({"cmdtransvel": -1000})
        assert master.value("transpos") == 390
    assert turtle.world.blocked > 0


def test_wheels_at_a_wall_turn_only_as_far_as_the_robot_moves() -> None:
    turtle = SmrTurtle(World(1.0), tick_length=0.001)
    with lockstep(turtle) as host, RawClient(host.port, b"aw") as master:
        master.greeting()
        for _ in range(120):
            master.sync({"speedl": 100, "speedr": 100})
        assert (master.value("encl"), master.value("encr")) == (500, 500)
        assert master.words("irsensor") == [108, 255, 255, 255, 108, 0]


def test_16_bit_counters_wrap() -> None:
    turtle = SmrTurtle(World(100.0), tick_length=0.00001, encoder_bits=16)
    with lockstep(turtle) as host, RawClient(host.port, b"aw") as master:
        master.greeting()
        for _ in range(41):
            master.sync({"speedl": 100, "speedr": -100})
        assert (master.value("encl"), master.value("encr")) == (40000 - 65536, 65536 - 40000)


@pytest.mark.parametrize(
    ("turtle", "command"),
    [(Turtle(), {"cmdtransvel": 50000}), (SmrTurtle(), {"speedl": 50, "speedr": 50})],
    ids=["velocity-omega", "smr"],
)
def test_turtle_stops_without_a_master_until_a_new_command(turtle: Any, command: dict[str, int]) -> None:
    with lockstep(turtle) as host, RawClient(host.port) as reader:
        reader.greeting()
        with RawClient(host.port, b"aw") as master:
            master.greeting()
            for _ in range(4):
                master.sync(command)
            moving = turtle.world.odometry.x
            assert moving > 0.0
        # Without a writer, readers cause the ticks; the first tick might come before the host notices the master's end.
        while host.writers:
            reader.sync()
        reader.sync()
        reader.sync()
        at_rest = turtle.world.odometry
        for _ in range(5):
            reader.sync()
        assert turtle.world.odometry == at_rest
        with RawClient(host.port, b"aw") as other:
            other.greeting()
            # The old command is still in the database, but no client has sent it again.
            assert all(other.value(name) == value for name, value in command.items())
            other.send(b"rwee")
            other.batch()
            other.send(b"rwee")
            other.batch()
            assert turtle.world.odometry == at_rest
            other.sync(command)
            other.sync(command)
            other.sync(command)
            assert turtle.world.odometry.x > at_rest.x


def test_turtle_can_keep_moving_without_a_master() -> None:
    turtle = Turtle(needs_master=False)
    with lockstep(turtle) as host, RawClient(host.port) as reader:
        reader.greeting()
        with RawClient(host.port, b"aw") as master:
            master.greeting()
            master.sync({"cmdtransvel": 50000})
        while host.writers:
            reader.sync()
        before = reader.value("transpos")
        reader.sync()
        reader.sync()
        reader.sync()
        assert reader.value("transpos") >= before + 1000


def test_world_is_configured_in_the_host_file() -> None:
    text = """<rhd><server><port value="0"/></server><plugins>
      <robot enable="true" lib="rhdlink.host.plugins.turtle:SmrTurtle" critical="true" size="4">
        <x value="1"/><theta value="0.5"/></robot></plugins></rhd>"""
    config = parse_config(text)
    assert isinstance(config, Configuration)
    with Host.from_config(config, pacing="lockstep") as host:
        (turtle,) = host.plugins
        assert isinstance(turtle, SmrTurtle)
        assert (turtle.world.size, tuple(turtle.world.start)) == (4.0, (1.0, 2.0, 0.5))


def test_world_argument_overrides_the_world_in_the_file() -> None:
    turtle = Turtle(World(3.0))
    turtle.init(Element("turtle", {"size": "5"}))
    assert turtle.world.size == 3.0


@pytest.mark.parametrize("wrong", [{"linear_scale": 0.0}, {"angular_scale": math.nan}])
def test_turtle_rejects_invalid_scales(wrong: dict[str, float]) -> None:
    with pytest.raises(BadValue):
        Turtle(**wrong)  # type: ignore[arg-type]


@pytest.mark.parametrize("wrong", [{"width": 0.0}, {"tick_length": -1.0}, {"encoder_bits": 8}])
def test_smr_turtle_rejects_invalid_wheels(wrong: dict[str, Any]) -> None:
    with pytest.raises(BadValue):
        SmrTurtle(**wrong)


def test_turtle_rejects_an_object_that_is_not_a_world() -> None:
    with pytest.raises(BadValue, match=r"world=3; expected rhdlink.host.world.World\(...\)"):
        Turtle(3)  # type: ignore[arg-type]

"""Missions and drives on a robot behind a port.

The commands must be the same as for a robot in this process, and the robot must be stopped at every kind of end.
"""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Iterator

import pytest

from linkcore.errors import ConnectFailed, ConnectionLost, LinkError, LinkTimeout
from rhdlink import AccessDenied, Cancelled, Drive, Host, Mission, Phase, connect
from rhdlink.host.plugins.turtle import SmrTurtle, Turtle
from rhdlink.host.world import World
from rhdlink.smrcl.robot_link import ClientLink
from tests.waiting import until

pytestmark = pytest.mark.real_time

SCRIPT = "fwd 0.3\nturn -90\nturnr 0.2 60\nfwd -0.1 @v -0.2\n"
#: Script that continues until it is ended.
ENDLESS = 'drive\nlabel "on"\nwait 1\ngoto "on"\n'


class Told(Turtle):
    """Velocity-omega turtle that stores its commands, tick by tick."""

    def __init__(self) -> None:
        super().__init__(World(1000.0))
        self.commands: list[tuple[int, int]] = []

    def periodic(self, tick: int) -> None:
        super().periodic(tick)
        self.commands.append((self.cmdtransvel, self.cmdrotvel))

    @property
    def is_stopped(self) -> bool:
        return self.commands[-1] == (0, 0)


class ToldSmr(SmrTurtle):
    """SMR turtle that stores its commands, tick by tick."""

    def __init__(self) -> None:
        super().__init__(World(1000.0))
        self.commands: list[tuple[int, int]] = []

    def periodic(self, tick: int) -> None:
        super().periodic(tick)
        self.commands.append((self.speedl, self.speedr))


class Held(Told):
    """Turtle whose plugin blocks until the test releases it."""

    def __init__(self) -> None:
        super().__init__()
        self.goes_on = threading.Event()
        self.goes_on.set()

    def periodic(self, tick: int) -> None:
        self.goes_on.wait(20.0)
        super().periodic(tick)


@pytest.fixture
def robot() -> Told:
    return Told()


@pytest.fixture
def host(robot: Told) -> Iterator[Host]:
    with Host([robot], port=0) as host:
        yield host


@pytest.mark.slow
@pytest.mark.parametrize("kind", [Told, ToldSmr])
def test_mission_sends_same_commands_over_host_and_plugin_link(kind: type[Told | ToldSmr]) -> None:
    here, there = kind(), kind()
    Mission(SCRIPT, here).run()
    with Host([there], port=0, pacing="lockstep") as host, connect(host.address, access="w") as client:
        link = ClientLink(client, is_lockstep=True)
        run = Mission(SCRIPT, link).run()
        assert run.phase is Phase.DONE
    moved = [each for each in here.commands if each != (0, 0)]
    assert [each for each in there.commands if each != (0, 0)] == moved
    assert len(moved) > 300
    # A host runs a tick before its first request.
    first = next(place for place, each in enumerate(here.commands) if each != (0, 0))
    assert there.commands[first : first + 100] == here.commands[first : first + 100]


@pytest.mark.slow
def test_mission_runs_on_a_host_in_real_time(host: Host, robot: Told) -> None:
    run = Mission("fwd 0.2\nturn 45\n", host.address).run(30.0)
    assert run.phase is Phase.DONE
    x, _, theta = robot.world.odometry
    assert (x, theta) == pytest.approx((0.2, 0.785), abs=0.03)
    until(lambda: robot.is_stopped)  # a command is executed in the next tick
    until(lambda: host.writers == 0)


def test_given_connection_is_left_open(host: Host) -> None:
    with connect(host.address, access="w") as robot:
        Mission("fwd 0.1\n", robot).run(30.0)
        robot.sync()
        assert robot.connection.name == "CONNECTED"
    with connect(host.address) as reader, pytest.raises(AccessDenied, match="connect with access='w'"):
        Mission("fwd 0.1\n", reader).run()


def test_mission_raises_when_no_host_listens() -> None:
    with Host([Turtle()], port=0) as gone:
        address = gone.address
    with pytest.raises(ConnectFailed):
        Mission("fwd 0.1\n", address).start()


def test_cancelled_mission_stops_the_robot(host: Host, robot: Told) -> None:
    run = Mission(ENDLESS, host.address).start()
    until(lambda: robot.world.odometry.x > 0.05)
    run.cancel()
    with pytest.raises(Cancelled):
        run.wait(20.0)
    until(lambda: robot.is_stopped)


def test_closed_host_ends_the_mission(robot: Told) -> None:
    with Host([robot], port=0) as host:
        run = Mission(ENDLESS, host.address).start()
        until(lambda: robot.world.odometry.x > 0.05)
    with pytest.raises(ConnectionLost):
        run.wait(20.0)
    assert run.phase is Phase.FAILED


def test_silent_host_ends_the_mission_and_stops_later() -> None:
    robot = Held()
    with Host([robot], port=0) as host:
        try:
            with connect(host.address, access="w", timeout=0.3) as client:
                run = Mission(ENDLESS, client).start()
                until(lambda: robot.world.odometry.x > 0.05)
                robot.goes_on.clear()
                with pytest.raises((LinkTimeout, ConnectionLost)):
                    run.wait(20.0)
        finally:
            robot.goes_on.set()
        where = len(robot.commands)
        until(lambda: len(robot.commands) > where + 20)
        before = robot.world.odometry
        where = len(robot.commands)
        until(lambda: len(robot.commands) > where + 20)
        assert robot.world.odometry == before


PROGRAM = """
import sys, time, rhdlink
what, address, how = sys.argv[1:]
if what == "mission":
    run = rhdlink.Mission('drive\\nlabel "on"\\nwait 1\\ngoto "on"\\n', address).start()
else:
    drive = rhdlink.Drive(address)
    drive.forward(100)
if how == "end":
    sys.stdin.readline()
else:
    time.sleep(60)
"""


@pytest.mark.slow
@pytest.mark.parametrize(("what", "how"), [("mission", "end"), ("drive", "end"), ("mission", "killed")])
def test_ended_process_leaves_the_robot_stopped(host: Host, robot: Told, what: str, how: str) -> None:
    process = subprocess.Popen([sys.executable, "-c", PROGRAM, what, host.address, how], stdin=subprocess.PIPE)
    try:
        until(lambda: robot.world.odometry.x > 0.05, 30.0)
        if how == "killed":
            process.kill()
        process.communicate(b"\n", timeout=30.0)
    finally:
        process.kill()
        process.communicate()
    until(lambda: host.writers == 0)
    # A process that ends normally sends a stop to the robot; if it is killed, the host has to stop the robot.
    if how == "end":
        assert process.returncode == 0
        assert robot.is_stopped
    where = len(robot.commands)
    until(lambda: len(robot.commands) > where + 3)
    before = robot.world.odometry
    where = len(robot.commands)
    until(lambda: len(robot.commands) > where + 20)
    assert robot.world.odometry == before


@pytest.mark.slow
def test_drive_moves_a_robot_of_a_host(host: Host, robot: Told) -> None:
    with Drive(host.address) as drive:
        drive.forward(0.2).wait(30.0)
        drive.turn(45).wait(30.0)
        pose = drive.pose
    assert (pose.x, pose.theta) == pytest.approx((0.2, 0.785), abs=0.03)
    assert robot.is_stopped


def test_closed_host_ends_the_drive(robot: Told) -> None:
    with Host([robot], port=0) as host:
        drive = Drive(host.address)
        motion = drive.forward(100.0)
        until(lambda: robot.world.odometry.x > 0.05)
    with pytest.raises(ConnectionLost):
        motion.wait(20.0)
    until(lambda: drive.error is not None)
    with pytest.raises(LinkError):
        drive.turn(90)
    drive.close()

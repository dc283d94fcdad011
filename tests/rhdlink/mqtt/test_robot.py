"""A client of a simulated robot with MQTT, over a real broker (mosquitto): mastership, the end, and programs."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

pytest.importorskip("paho.mqtt.client")

import rhdlink
from linkcore.errors import BadValue, Closed, ConnectFailed, ConnectionLost, LinkTimeout, LocalError
from rhdlink import AccessDenied, Drive, Host, Mission
from rhdlink.address import MqttAddress
from rhdlink.host.scene import Scene, Tape
from rhdlink.host.world import World
from rhdlink.mqtt import Command, MqttRobot, SimulatedRobobot
from rhdlink.mqtt.broker import BrokerConnection
from rhdlink.mqtt.commands import STANDSTILL, alive, stop
from rhdlink.robots import Robobot, VelocityOmega
from tests.mosquitto import needs_broker, running
from tests.waiting import threads_named, until

pytestmark = [needs_broker, pytest.mark.real_time]
DIALECTS = ["2025", "2026"]
OTHER = "2026-01-01 00:00:00.000000"


@pytest.fixture(params=DIALECTS)
def robot(request: pytest.FixtureRequest, broker: int) -> Iterator[SimulatedRobobot]:
    """A simulated robot in each dialect, in a large world."""
    with SimulatedRobobot("127.0.0.1", broker, dialect=request.param, world=World(1000.0)) as robot:
        yield robot


def newest(robot: SimulatedRobobot, keyword: str) -> Command | None:
    return next((each for each in reversed(robot.commands) if each.keyword == keyword), None)


def until_synced(client: rhdlink.Variables, condition: Callable[[], object]) -> None:
    """Sync the client until the condition is true."""

    def is_true() -> bool:
        client.sync()
        return bool(condition())

    until(is_true)


def sync_forever(client: rhdlink.Variables) -> None:
    """Sync until an error is raised, for at most a minute."""
    end = time.monotonic() + 60.0
    while time.monotonic() < end:
        client.sync()


def sync_often(client: rhdlink.Variables) -> None:
    for _ in range(10):
        client.sync()


class Overheard:
    """Messages on the broker, in the order of their arrival."""

    def __init__(self, port: int, topics: str = "robobot/cmd/#") -> None:
        self.messages: list[tuple[str, str]] = []
        self.connection = BrokerConnection(
            MqttAddress("127.0.0.1", port),
            10.0,
            topics=(topics,),
            on_message=lambda topic, payload, is_retained: self.messages.append((topic, payload.decode())),
        )

    def __enter__(self) -> Overheard:
        return self

    def __exit__(self, *exc: object) -> None:
        self.connection.close()


# -- identity and mastership ---------------------------------------------------------------------------------------


def test_connect_recognises_the_dialect_and_becomes_the_master(robot: SimulatedRobobot) -> None:
    with rhdlink.connect(robot.address, Robobot, access="w") as client:
        until_synced(client, lambda: client.master)
        assert client.master == robot.master
        assert client.access == "w"
        client.cmdtransvel, client.cmdrotvel = 0.2, 0.5
        client.sync()
        until(lambda: newest(robot, "rc") == Command("ti", "rc", "0.2 0.5"))
        until_synced(client, lambda: robot.world.odometry.x > 0.05)
        assert client.velleft > 0.0


@pytest.mark.parametrize("dialect", DIALECTS)
def test_dialect_in_the_address_is_the_only_one_that_is_sent(broker: int, dialect: str) -> None:
    world = World(1000.0)
    with Overheard(broker) as overheard, SimulatedRobobot("127.0.0.1", broker, dialect=dialect, world=world) as robot:
        with rhdlink.connect(f"{robot.address}?dialect={dialect}", access="w"):
            until(lambda: robot.master)
        until(lambda: newest(robot, "stop"))
        assert robot.ignored == 0
        alive_topic = "robobot/cmd/ti/alive" if dialect == "2025" else "robobot/cmd/ti"
        assert alive_topic in {topic for topic, _ in overheard.messages}
        assert all((topic.count("/") == 3) == (dialect == "2025") for topic, _ in overheard.messages)


def test_wrong_dialect_in_the_address_is_reported(robot: SimulatedRobobot) -> None:
    wrong = "2026" if robot.dialect == "2025" else "2025"
    with pytest.raises(LinkTimeout, match=f"does not answer alive messages of the dialect {wrong}"):
        rhdlink.connect(f"{robot.address}?dialect={wrong}", access="w")


def test_alive_is_sent_every_half_second_without_a_sync(broker: int) -> None:
    with (
        Overheard(broker) as overheard,
        SimulatedRobobot("127.0.0.1", broker, dialect="2026") as robot,
        rhdlink.connect(f"{robot.address}?dialect=2026", access="w"),
    ):
        overheard.messages.clear()
        began = time.monotonic()

        def alives() -> int:
            return sum(payload.startswith("alive ") for _, payload in overheard.messages)

        until(lambda: alives() >= 5)
        assert 1.5 <= time.monotonic() - began <= 6.0
        assert robot.master


def test_second_client_is_refused_and_the_first_one_drives_on(robot: SimulatedRobobot) -> None:
    with rhdlink.connect(robot.address, Robobot, access="w") as first:
        until_synced(first, lambda: robot.master)
        with pytest.raises(AccessDenied, match=f"another client drives the robot: its master is '{robot.master}'"):
            rhdlink.connect(robot.address, access="w")
        with rhdlink.connect(robot.address, Robobot, access="w", fallback="r") as second:
            assert second.access == "r"
            until_synced(second, lambda: second.hbtvoltage)
            with pytest.raises(AccessDenied):
                second.cmdtransvel = 0.1
        first.cmdtransvel = 0.2
        until_synced(first, lambda: robot.world.odometry.x > 0.02)
        assert newest(robot, "stop") is None


def test_another_master_ends_the_client_without_a_command(robot: SimulatedRobobot) -> None:
    """The course's client also sends nothing more when it reads the ID of another client."""
    with rhdlink.connect(robot.address, Robobot, access="w") as client:
        client.cmdtransvel = 0.2
        until_synced(client, lambda: newest(robot, "rc") != STANDSTILL)
        robot.master = OTHER
        before = robot.commands.copy()

        with pytest.raises(AccessDenied, match=OTHER):
            sync_forever(client)
        with pytest.raises(AccessDenied, match=OTHER):
            client.sync()
    new = list(robot.commands)[len(before) :]
    assert not [each for each in new if each in (STANDSTILL, stop())]


def test_reader_sends_nothing(broker: int) -> None:
    with (
        SimulatedRobobot("127.0.0.1", broker, dialect="2025", world=World(1000.0)) as robot,
        Overheard(broker) as overheard,
        rhdlink.connect(robot.address, Robobot) as client,
    ):
        until_synced(client, lambda: client.hbtvoltage == pytest.approx(15.7) and client.livn[0])
        assert client.dname == "" or client.dname == "Simulated"
        assert not overheard.messages
        assert list(client["linesensor"]) == list(client.livn[::-1])


# -- the end -------------------------------------------------------------------------------------------------------


def test_close_sends_both_commands_and_no_last_will(broker: int) -> None:
    with Overheard(broker) as overheard, SimulatedRobobot("127.0.0.1", broker, world=World(1000.0)) as robot:
        with rhdlink.connect(f"{robot.address}?dialect=2026", Robobot, access="w") as client:
            client.cmdtransvel = 0.2
            until_synced(client, lambda: robot.world.odometry.x > 0.02)
        assert not threads_named("alive")
        until(lambda: overheard.messages[-1] == ("robobot/cmd/T0", "stop"))
        assert overheard.messages[-2] == ("robobot/cmd/ti", "rc 0 0")
        with pytest.raises(Closed):
            client.sync()
        overheard.connection.publish("robobot/cmd/end", "")  # after everything that the client could have sent
        until(lambda: overheard.messages[-1][0] == "robobot/cmd/end")
        assert [payload for _, payload in overheard.messages].count("stop") == 1


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGKILL")
def test_killed_process_stops_the_robot_by_both_last_wills(robot: SimulatedRobobot) -> None:
    program = (
        "import rhdlink, time\n"
        f"robot = rhdlink.connect({robot.address!r}, rhdlink.robots.Robobot, access='w')\n"
        "robot.cmdtransvel = 0.3\n"
        "while True: robot.sync()\n"
    )
    process = subprocess.Popen([sys.executable, "-c", program])
    try:
        until(lambda: robot.world.odometry.x > 0.05)
        assert newest(robot, "stop") is None
        process.send_signal(signal.SIGKILL)
        process.wait()
        killed = time.monotonic()
        until(lambda: newest(robot, "stop") and newest(robot, "rc") == STANDSTILL)
        until(lambda: robot._left.speed == robot._right.speed == 0.0)
        # Well before the robot of 2025 would stop on its own.
        assert time.monotonic() - killed < 1.5
    finally:
        process.kill()
        process.wait()


def test_each_last_will_alone_stops_the_robot(robot: SimulatedRobobot) -> None:
    for command in (STANDSTILL, stop()):
        with Overheard(robot._place.port) as sender:
            for sent in (alive(OTHER), Command("ti", "rc", "0.2 0")):
                sender.connection.publish(*robot._dialect.encode(sent))
            until(lambda: robot._left.speed > 0.1)
            sender.connection.publish(*robot._dialect.encode(command))
            until(lambda: robot._left.speed == robot._right.speed == 0.0)


def test_lost_master_stops_only_the_robot_of_2025(robot: SimulatedRobobot) -> None:
    """The log of 2025 shows the stop; the source of 2026 has it commented out."""
    robot._timeout = 0.2
    with Overheard(robot._place.port) as sender:
        for sent in (alive(OTHER), Command("ti", "rc", "0.2 0")):
            sender.connection.publish(*robot._dialect.encode(sent))
        until(lambda: robot._left.speed > 0.1)
        until(lambda: not robot.master)
        if robot.dialect == "2025":
            until(lambda: robot._left.speed == 0.0)
        else:
            x = robot.world.odometry.x
            until(lambda: robot.world.odometry.x > x + 0.1)


@pytest.mark.slow
def test_lost_broker_is_reported_and_the_next_sync_reconnects(tmp_path: Path) -> None:
    with running(tmp_path) as port:
        address = f"mqtt://127.0.0.1:{port}"
        with SimulatedRobobot("127.0.0.1", port, dialect="2026"):
            client = rhdlink.connect(address, Robobot, access="w")
            client.sync()
    try:
        with pytest.raises(ConnectionLost, match="connection to the broker was lost"):
            sync_forever(client)
        with pytest.raises(ConnectFailed, match="no MQTT broker"):
            client.sync()
    finally:
        client.close()


def test_silent_robot_is_reported(broker: int) -> None:
    robot = SimulatedRobobot("127.0.0.1", broker, dialect="2026").start()
    try:
        with rhdlink.connect(robot.address, Robobot, access="w", timeout=1.0) as client:
            client.sync()
            robot.close()
            with pytest.raises(ConnectionLost, match="the robot has sent no message for 1 s"):
                sync_forever(client)
    finally:
        robot.close()


def test_robot_without_odometry_is_commanded_to_stop(broker: int, caplog: pytest.LogCaptureFixture) -> None:
    with (
        SimulatedRobobot("127.0.0.1", broker, dialect="2026", world=World(1000.0)) as robot,
        rhdlink.connect(robot.address, Robobot, access="w") as client,
    ):
        client.cmdtransvel = 0.2
        until_synced(client, lambda: robot.world.odometry.x > 0.02)
        robot._intervals.update(pose=0, vel=0)

        def stands() -> bool:
            client.cmdtransvel = 0.2
            return newest(robot, "rc") == STANDSTILL

        until_synced(client, stands)
    assert "no pose and no wheel speeds for 1 s" in caplog.text


# -- errors --------------------------------------------------------------------------------------------------------


def test_broker_without_a_robot_is_reported(broker: int) -> None:
    with pytest.raises(ConnectFailed, match=r"no robot has published on robobot/drive/# within .* teensy_interface"):
        rhdlink.connect(f"mqtt://127.0.0.1:{broker}", timeout=0.5)


def test_missing_paho_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "paho.mqtt.client", None)
    with pytest.raises(LocalError, match=r"a robot with MQTT needs paho.mqtt.*pip install 'urlink-robot\[mqtt\]'"):
        rhdlink.connect("mqtt://127.0.0.1:1883")


def test_unknown_dialect_is_rejected_before_connecting() -> None:
    with pytest.raises(BadValue, match="dialect is '2024'; expected one of 2025, 2026"):
        rhdlink.connect("mqtt://127.0.0.1:1?dialect=2024")


# -- programs ------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_drive_moves_the_robot(robot: SimulatedRobobot) -> None:
    with Drive(robot.address) as drive:
        drive.forward(0.3).wait(30.0)
        drive.turn(90).wait(30.0)
        x, _, heading = robot.world.odometry
        assert x == pytest.approx(0.3, abs=0.03)
        assert heading == pytest.approx(1.57, abs=0.1)
        assert drive.pose.theta == pytest.approx(heading, abs=0.05)


def _floor() -> World:
    """White tape on a black floor, as in the course, and a wall behind its end."""
    scene = Scene([Tape(((1.0, 5.5), (3.0, 5.5)), brightness=1.0)], walls=[[(5.0, 4.0), (5.0, 7.0)]], floor=0.0)
    return World(11.0, (0.9, 5.52, 0.0), scene)


@pytest.mark.slow
@pytest.mark.matrix(2)
@pytest.mark.parametrize("dialect", DIALECTS)
def test_mission_follows_a_line_and_measures_a_distance(broker: int, dialect: str) -> None:
    world = _floor()
    script = 'followline "wm" @v 0.3 : ($drivendist > 1.5)\nfwd 3 @v 0.3 : ($dist[1] < 0.6)\nstop\neval $dist[1]\n'
    values: list[str] = []
    with SimulatedRobobot("127.0.0.1", broker, dialect=dialect, world=world) as robot:
        Mission(script, robot.address).on("values", values.append).run(60.0)
        x, y, _ = robot.world.pose
    assert float(values[0]) == pytest.approx(5.0 - x, abs=0.1)
    assert 4.2 < x < 4.6
    assert y == pytest.approx(5.5, abs=0.15)
    middle = [place[1] for place in robot.world.path if 1.8 < place[0] < 2.4]
    assert max(abs(each - 5.5) for each in middle) < 0.03


def test_host_serves_the_robot_to_rhd_programs(robot: SimulatedRobobot) -> None:
    with (
        Host([MqttRobot(robot.address)], port=0) as host,
        rhdlink.connect(host.address, VelocityOmega, access="w") as client,
    ):
        client.cmdtransvel = 0.2
        until_synced(client, lambda: client.transpos > 5000)
        client.close()
        until(lambda: newest(robot, "rc") == STANDSTILL)
    until(lambda: newest(robot, "stop"))


def test_teensy_command_reaches_the_robot_once_per_setting(robot: SimulatedRobobot) -> None:
    with rhdlink.connect(robot.address, Robobot, access="w") as client:
        for text in ("confw 0.08 0.08 19 68 0.24", "confi", "leds 16 0 0 30"):
            client.teensy = text
            client.sync()
        until_synced(client, lambda: client.confbase == pytest.approx(0.24))
        until_synced(client, lambda: newest(robot, "leds"))
        assert client.info == "# got confw: r1=0.08, r2=0.08, G=19, PPR=68, WB=0.24"
        assert [each.keyword for each in robot.commands].count("leds") == 1
        client.interfacelog = True
        until_synced(client, lambda: newest(robot, "log") == Command("ti", "log", "1"))


def test_calls_of_several_threads_are_possible(robot: SimulatedRobobot) -> None:
    with rhdlink.connect(robot.address, Robobot, access="w") as client:
        threads = [threading.Thread(target=sync_often, args=(client,)) for _ in range(3)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(30.0)
        assert not any(thread.is_alive() for thread in threads)


def test_recording_is_played_like_one_of_a_robot_with_rhd(broker: int, tmp_path: Path) -> None:
    path = tmp_path / "drive.urlog"
    with (
        SimulatedRobobot("127.0.0.1", broker, dialect="2025", world=World(1000.0)) as robot,
        rhdlink.connect(robot.address, Robobot, access="w", record=path) as client,
    ):
        client.cmdtransvel = 0.2
        until_synced(client, lambda: client.transpos > 2000)
        last = client.transpos
    table = rhdlink.load(path, Robobot)
    assert table["transpos"][-1] == last
    assert table["velleft"].max() == pytest.approx(0.2, abs=0.1)

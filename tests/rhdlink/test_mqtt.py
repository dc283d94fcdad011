"""Robots over MQTT: the table of topics, a robot and its master, and a real broker (mosquitto) if available."""

from __future__ import annotations

import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("paho.mqtt.client")

from paho.mqtt.client import Client

from linkcore.errors import BadValue
from rhdlink import Float64, Host, Mission, PluginFailed, Read, Variables, connect
from rhdlink.host.plugins.mqtt import (
    MASTER_TIMEOUT,
    ROBOBOT,
    ROBOBOT_TABLE,
    MqttRobot,
    MqttTopic,
    MqttTurtle,
    parse_topics,
    read_topics,
)
from rhdlink.host.world import World
from rhdlink.robots import VelocityOmega
from tests.mosquitto import needs_broker
from tests.waiting import until

# -- the table -------------------------------------------------------------------------------------------------


def test_table_is_read_from_an_edited_file(tmp_path: Path) -> None:
    path = tmp_path / "topics.txt"
    path.write_text(ROBOBOT_TABLE.replace("robobot/drive", "mine/drive") + "read mine/battery battery time volts\n")
    topics = read_topics(path)
    assert topics.pose == MqttTopic("read", "mine/drive/T0/pose", "pose", ("time", "x", "y", "heading"))
    assert [topic.variable for topic in topics.read] == ["pose", "battery"]
    assert (topics.command.values, topics.alive.name) == (("linear", "angular"), "robobot/cmd/ti/alive")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "expected one topic with x, y and heading"),
        ("watch a b c", "line 1: expected read, command or alive"),
        ("# nothing\nread a b", "line 2: expected read, command or alive"),
        ("read a/+/b v time", "without wildcards"),
        (ROBOBOT_TABLE + "alive another - time", "one alive"),
        (ROBOBOT_TABLE.replace("linear", "forward"), "must have values called linear and angular"),
        (ROBOBOT_TABLE.replace("ti/rc ", "ti/alive "), "is listed twice"),
    ],
)
def test_invalid_table_raises_the_reason(text: str, said: str) -> None:
    with pytest.raises(BadValue, match=said):
        parse_topics(text)


@pytest.mark.parametrize(
    ("payload", "values"),
    [
        (b"12.5 1 2 0.5", (12.5, 1.0, 2.0, 0.5)),
        (b" 12.5\t1 2 0.5 0.01 more\n", (12.5, 1.0, 2.0, 0.5)),
        (b"12.5 1 2", None),
        (b"12.5 1 2 x", None),
        (b"12.5 1 2 nan", None),
        ("12.5 1 2 \u0663".encode(), None),
        (b"", None),
    ],
)
def test_payload_is_parsed_as_numbers_or_rejected(payload: bytes, values: tuple[float, ...] | None) -> None:
    assert ROBOBOT.pose.parse(payload) == values


@pytest.mark.property
@given(st.binary(max_size=80))
def test_any_payload_is_parsed_or_rejected(payload: bytes) -> None:
    values = ROBOBOT.pose.parse(payload)
    assert values is None or len(values) == 4


@pytest.mark.property
@given(linear=st.floats(-9, 9), angular=st.floats(-9, 9))
def test_written_command_is_read_back(linear: float, angular: float) -> None:
    payload = ROBOBOT.command.write({"linear": linear, "angular": angular}).encode()
    assert ROBOBOT.command.parse(payload) == pytest.approx((linear, angular), abs=1e-4)


# -- with a broker ---------------------------------------------------------------------------------------------


def until_synced(robot: Variables, condition: Callable[[], object]) -> None:
    """Sync the robot until the condition is true."""

    def is_true() -> bool:
        robot.sync()
        return bool(condition())

    until(is_true)


class Robobot(VelocityOmega):
    pose = Read(Float64, 4)


@pytest.mark.slow
@needs_broker
@pytest.mark.real_time
def test_mission_drives_a_robot_behind_a_broker(broker: int) -> None:
    world = World(1000.0)
    with (
        Host([MqttTurtle(port=broker, world=world)], port=0),
        Host([MqttRobot(port=broker)], port=0) as host,
        connect(host.address, Robobot, access="w") as robot,
    ):
        until_synced(robot, lambda: robot.pose[0] > 0.0)
        Mission("fwd 0.2\nturn 45\n", robot).run(30.0)
        robot.sync()
        # Each pose is several ticks old, so the robot drives slightly further than in a single process.
        x, _, heading = world.odometry
        assert x == pytest.approx(0.2, abs=0.05)
        assert heading == pytest.approx(0.785, abs=0.15)
        assert robot.pose[1] == pytest.approx(x, abs=0.01)


@needs_broker
@pytest.mark.real_time
def test_robot_stops_when_its_master_disappears(broker: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Simulate a host of the master that is killed: it sends no more messages."""
    now = [0.0]
    world = World(1000.0)
    turtle = MqttTurtle(port=broker, world=world, clock=lambda: now[0])
    bridge = MqttRobot(port=broker)
    with Host([turtle], port=0), Host([bridge], port=0) as host:
        with connect(host.address, VelocityOmega, access="w") as robot:
            robot.cmdtransvel = 0.3
            until_synced(robot, lambda: world.odometry.x > 0.05)
            assert turtle.has_master
            publish = Client.publish

            def lost(client: Client, topic: str, *arguments: Any, **options: Any) -> Any:
                return publish(client, topic, *arguments, **options) if topic == ROBOBOT.pose.name else None

            monkeypatch.setattr(Client, "publish", lost)
            now[0] += MASTER_TIMEOUT + 0.1
            until(lambda: not turtle.has_master)
        at = world.odometry.x
        until(lambda: turtle.host.tick > 100 or world.odometry.x > at + 0.5)
        assert world.odometry.x < at + 0.05


@needs_broker
@pytest.mark.real_time
def test_robot_stops_immediately_when_its_program_leaves(broker: int) -> None:
    world = World(1000.0)
    turtle = MqttTurtle(port=broker, world=world)
    with Host([turtle], port=0), Host([MqttRobot(port=broker)], port=0) as host:
        with connect(host.address, VelocityOmega, access="w") as robot:
            robot.cmdtransvel = 0.3
            until_synced(robot, lambda: world.odometry.x > 0.05)
        places: list[float] = []

        def stands() -> bool:
            places.append(world.odometry.x)
            return len(places) > 100 and places[-100] == places[-1]

        until(stands)
        assert turtle.has_master  # the timeout of 2 s has not expired yet


@needs_broker
@pytest.mark.real_time
def test_robot_without_a_pose_is_commanded_to_stop(broker: int, monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]
    world = World(1000.0)
    bridge = MqttRobot(port=broker, clock=lambda: now[0])
    with Host([MqttTurtle(port=broker, world=world)], port=0) as robot_host, Host([bridge], port=0) as host:
        with connect(host.address, VelocityOmega, access="w") as robot:
            robot.cmdtransvel = 0.3

            def drives() -> bool:
                now[0] += 0.05
                robot.sync()
                return world.odometry.x > 0.05

            until(drives)
            speeds: list[float] = []

            publish = Client.publish

            def without_pose(client: Client, topic: str, payload: str, **options: Any) -> Any:
                if topic == ROBOBOT.command.name:
                    speeds.append(float(payload.split()[0]))
                return None if topic == ROBOBOT.pose.name else publish(client, topic, payload, **options)

            monkeypatch.setattr(Client, "publish", without_pose)
            now[0] += 1.1
            until(lambda: speeds[-1:] == [0.0])  # after the next alive message
        assert robot_host.tick > 0


@needs_broker
@pytest.mark.real_time
def test_second_mqtt_master_waits_until_the_first_one_is_silent(broker: int) -> None:
    now = [0.0]
    turtle = MqttTurtle(clock=lambda: now[0])
    for alive, moment, master in (
        ((1.0,), 0.0, (1.0,)),
        ((2.0,), 1.0, (1.0,)),
        ((2.0,), 2.5, (2.0,)),
        (None, 4.4, (2.0,)),
        (None, 4.6, None),
    ):
        now[0] = moment
        turtle._follow_master(alive)
        assert turtle._master == master


@needs_broker
@pytest.mark.real_time
def test_bridge_reconnects_to_a_broker_and_sends_nothing_late(broker: int, tmp_path: Path) -> None:
    bridge = MqttRobot(port=broker)
    with Host([bridge], port=0) as host, connect(host.address, VelocityOmega, access="w") as robot:
        until_synced(robot, lambda: bridge.mqtt is not None and bridge.mqtt.sent > 0)
        assert bridge._broker is not None
        client = bridge._broker._client
        assert client is not None
        client.disconnect()
        until(lambda: not client.is_connected())
        assert bridge.mqtt is not None
        # One message might have been in transit when the connection ended, so count from the first dropped message.
        dropped = bridge.mqtt.dropped
        until_synced(robot, lambda: bridge.mqtt is not None and bridge.mqtt.dropped > dropped)
        sent, dropped = bridge.mqtt.sent, bridge.mqtt.dropped
        until_synced(robot, lambda: bridge.mqtt is not None and bridge.mqtt.dropped > dropped)
        assert bridge.mqtt.sent == sent


@pytest.mark.real_time
def test_missing_broker_or_invalid_arguments_raise() -> None:
    with socket.create_server(("127.0.0.1", 0)) as probe:
        port = probe.getsockname()[1]
    with pytest.raises(PluginFailed, match=f"no MQTT broker at 127.0.0.1:{port}"):
        Host([MqttRobot("127.0.0.1", port)], port=0).start()
    with pytest.raises(BadValue):
        MqttRobot(port=0)
    with pytest.raises(BadValue):
        MqttRobot(timeout=0.0)

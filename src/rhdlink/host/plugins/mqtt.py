"""Robots over MQTT: a plugin for DTU's current robots, which publish values to a broker, and a simulated robot.

Known facts about these robots: they use the broker mosquitto, with topics such as ``robobot/drive/T0/pose``. A payload
is ASCII, with numbers separated by blanks, and the time first. One client is the master, and sends messages to stay the
master. The robot stops after 2 s without such a message. All other entries in `ROBOBOT` (names of the other topics,
order and units of values) are assumptions, and marked as such. Therefore `ROBOBOT` is made from a table that users can
replace by their own (`read_topics`).

This module needs paho-mqtt (``pip install urlink-robot[mqtt]``), which is imported when a plugin begins. paho uses its
own thread for each connection; its callbacks here only store payloads in a dictionary.
"""

from __future__ import annotations

import logging
import math
import os
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from linkcore import clock
from linkcore.arguments import check_seconds, check_whole
from linkcore.errors import BadValue, ConnectFailed, LocalError

from ...variables.value_types import Float64
from ..config import Element
from ..plugin import Plugin
from ..world import World
from .velocity import Twist, VelocityBridge

if TYPE_CHECKING:
    from paho.mqtt.client import Client, MQTTMessage

_log = logging.getLogger(__name__)

#: Time, in seconds, without a message from the master after which a robot stops.
MASTER_TIMEOUT = 2.0
#: Interval, in seconds, between two messages of a master, and between two commands.
_ALIVE = 0.25
#: Maximum number of bytes in a payload and in a table; maximum number of values in a payload.
_LONGEST, _LARGEST, _MOST_VALUES = 4096, 1 << 16, 64
#: Timeout for connecting, in seconds; time without data from the broker until the connection counts as lost.
_CONNECT_TIMEOUT, _KEEPALIVE = 5.0, 10

#: Table for DTU's robots. A line contains a direction, a topic, the RHD variable ("-" for none) and the names of the
#: values; "#" begins a comment.
ROBOBOT_TABLE = """\
# known: the topic, and the time first; assumed: m, m, rad
read     robobot/drive/T0/pose  pose  time x y heading
# assumed: m/s, rad/s to the left
command  robobot/cmd/ti/rc      -     linear angular
# assumed: time when the master began, which identifies it
alive    robobot/cmd/ti/alive   -     time
"""

_DIRECTIONS = ("read", "command", "alive")


@dataclass(frozen=True)
class MqttTopic:
    """Line of the table of topics.

    Attributes:
        direction: "read" for data of the robot, "command" for its velocity, "alive" for the message of its master.
        name: Name of the topic.
        variable: RHD variable that holds the values as doubles; "" for none.
        values: Names of the values, in the order of the payload; a payload may have more values.
    """

    direction: str
    name: str
    variable: str
    values: tuple[str, ...]

    def parse(self, payload: bytes) -> tuple[float, ...] | None:
        """Return the values of a payload; None if it is not valid."""
        try:
            words = payload[:_LONGEST].decode("ascii").split()
            found = tuple(float(word) for word in words[: len(self.values)])
        except (UnicodeDecodeError, ValueError):
            return None
        return found if len(found) == len(self.values) and all(map(math.isfinite, found)) else None

    def write(self, values: Mapping[str, float]) -> str:
        """Return the payload for values by name; missing values are 0."""
        return " ".join(f"{values.get(name, 0.0):.4f}" for name in self.values)


@dataclass(frozen=True)
class Topics:
    """Table of topics.

    Attributes:
        pose: Pose of the robot; its values include x, y and heading.
        command: Velocity of the robot; its values include linear and angular.
        alive: Message of the master.
        read: All variables from the robot, including the pose.
    """

    pose: MqttTopic
    command: MqttTopic
    alive: MqttTopic
    read: tuple[MqttTopic, ...]


def parse_topics(text: str, source: str = "table") -> Topics:
    """Parse the table in a text.

    Raises:
        BadValue: If it is not such a table; the message names the line.
    """
    found: list[MqttTopic] = []
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.partition("#")[0].split()
        if not words:
            continue
        place = f"{source}, line {number}"
        if len(words) < 4 or words[0] not in _DIRECTIONS:
            raise BadValue(f"{place}: expected read, command or alive, a topic, a variable or -, and names of values")
        direction, name, variable, *values = words
        if "+" in name or "#" in name or len(values) > _MOST_VALUES:
            raise BadValue(f"{place}: expected a topic without wildcards, with at most {_MOST_VALUES} values")
        found.append(MqttTopic(direction, name, "" if variable == "-" else variable, tuple(values)))
    by_direction = {word: [topic for topic in found if topic.direction == word] for word in _DIRECTIONS}
    poses = [topic for topic in by_direction["read"] if {"x", "y", "heading"} <= set(topic.values)]
    if not (len(poses) == len(by_direction["command"]) == len(by_direction["alive"]) == 1):
        raise BadValue(f"{source}: expected one topic with x, y and heading, one command, and one alive")
    (command,), (alive,) = by_direction["command"], by_direction["alive"]
    if not {"linear", "angular"} <= set(command.values):
        raise BadValue(f"{source}: the command must have values called linear and angular")
    if len({topic.name for topic in found}) != len(found):
        raise BadValue(f"{source}: a topic is listed twice; expected each topic once")
    return Topics(poses[0], command, alive, tuple(by_direction["read"]))


def read_topics(path: str | os.PathLike[str]) -> Topics:
    """Read the table in a file.

    Raises:
        BadValue: If the file cannot be read, or is not such a table.
    """
    try:
        with open(path, "rb") as file:
            text = file.read(_LARGEST).decode("utf-8")
    except (OSError, ValueError) as error:
        raise BadValue(f"cannot read {os.fspath(path)}: {getattr(error, 'strerror', None) or error}") from error
    return parse_topics(text, Path(path).name)


#: `ROBOBOT_TABLE`, parsed.
ROBOBOT = parse_topics(ROBOBOT_TABLE)


class MqttStatistics(NamedTuple):
    """Counters of messages.

    Attributes:
        received: Number of messages on topics of the table.
        bad: Number of these messages whose payload is invalid.
        sent: Number of messages to the broker.
        dropped: Number of messages that were not sent, because there was no connection. They are never sent later.
    """

    received: int
    bad: int
    sent: int
    dropped: int


class _Broker:
    """Connection to a broker, with the newest payload of each topic. It reconnects automatically.

    Raises:
        LocalError: If paho-mqtt is not installed.
        ConnectFailed: If there is no broker.
    """

    def __init__(self, address: str, port: int, topics: tuple[MqttTopic, ...]) -> None:
        self._topics = {topic.name: topic for topic in topics}
        self._place = address, port
        self._newest: dict[str, tuple[float, ...]] = {}
        self.received = self.bad = self.sent = self.dropped = 0
        try:
            from paho.mqtt.client import Client
            from paho.mqtt.enums import CallbackAPIVersion
        except ImportError as error:
            raise LocalError("MQTT needs paho-mqtt (pip install urlink-robot[mqtt])") from error
        client = Client(CallbackAPIVersion.VERSION2)
        client.connect_timeout = _CONNECT_TIMEOUT
        client.on_connect = self._on_connect
        client.on_message = self._on_message
        try:
            client.connect(address, port, keepalive=_KEEPALIVE)
        except (OSError, ValueError) as error:
            raise ConnectFailed(f"no MQTT broker at {address}:{port}: {error}") from error
        client.loop_start()
        self._client: Client | None = client

    def _on_connect(self, client: Client, userdata: Any, flags: Any, reason: Any, properties: Any) -> None:
        if reason.is_failure:
            _log.warning("MQTT broker at %s:%d: connection refused: %s", *self._place, reason)
            return
        # Subscribe again after each lost connection, because the broker keeps no subscriptions of a clean session.
        client.subscribe([(name, 0) for name in self._topics])

    def _on_message(self, client: Client, userdata: Any, message: MQTTMessage) -> None:
        self.received += 1
        topic = self._topics.get(message.topic)
        values = None if topic is None else topic.parse(bytes(message.payload))
        if values is None:
            self.bad += 1
        else:
            self._newest[message.topic] = values

    def take(self, topic: MqttTopic) -> tuple[float, ...] | None:
        """Return the newest values of a topic, once; None if none have arrived since."""
        return self._newest.pop(topic.name, None)

    def send(self, topic: MqttTopic, values: Mapping[str, float]) -> None:
        """Send values, unless there is no connection, because a velocity must not be sent late."""
        client = self._client
        if client is None or not client.is_connected():
            self.dropped += 1
            return
        client.publish(topic.name, topic.write(values), qos=0)
        self.sent += 1

    def close(self) -> None:
        """Disconnect, after all messages have been sent. Idempotent."""
        client, self._client = self._client, None
        if client is not None:
            client.disconnect()
            client.loop_stop()

    @property
    def statistics(self) -> MqttStatistics:
        return MqttStatistics(self.received, self.bad, self.sent, self.dropped)


def _configured(config: Element, broker: str, port: int, topics: Topics) -> tuple[str, int, Topics]:
    """Return ``broker``, ``port`` and ``topics``, from the file if it contains them."""
    path = config.attributes.get("topics")
    return (
        config.attributes.get("broker", broker),
        config.integer("port", port, least=1, most=65535),
        topics if path is None else read_topics(path),
    )


class MqttRobot(VelocityBridge):
    """Plugin for a robot behind an MQTT broker. RHD programs (MRC, missions, your programs) use it like other robots.

    The pose of the robot is converted to `transpos` and `rotpos`, and `cmdtransvel` and `cmdrotvel` are converted to
    its command. Each topic that the robot publishes becomes a read variable of doubles, with the name from the table::

        class Robobot(rhdlink.robots.VelocityOmega):
            pose = rhdlink.Read(rhdlink.Float64, 4)      # time, x, y, heading

    While a program may write, the plugin sends an alive message and the velocity to the robot four times a second. When
    no program may write, or when the host ends, the plugin sends the velocity 0 and nothing more. If that message is
    lost, the robot stops on its own 2 s later. If no pose has arrived for `timeout` seconds, the velocity 0 is sent
    until a pose arrives.

    Args:
        broker: Address of the broker; in an `rhdconfig.xml`, ``broker="..."``.
        port: Port of the broker; ``port="..."``.
        topics: Table of topics; ``topics="path"``.
        timeout: Maximum age of the pose, in s.
        clock: Monotonic clock, in s.

    Raises:
        BadValue: If an argument is invalid.
    """

    def __init__(
        self,
        broker: str = "localhost",
        port: int = 1883,
        *,
        topics: Topics = ROBOBOT,
        timeout: float = 1.0,
        clock: Callable[[], float] = clock.now,
    ) -> None:
        super().__init__(self._command, own_thread=False)
        check_whole(port, "port", 1, 65535)
        self._timeout = check_seconds(timeout, "timeout", positive=True)
        self._source = broker, port, topics
        self._clock = clock
        self._broker: _Broker | None = None
        self._began = 0.0
        self._told = self._seen = -math.inf
        self._twist = Twist(0.0, 0.0)
        self._identities: dict[MqttTopic, int] = {}  # ids of the variables, by topic

    @property
    def mqtt(self) -> MqttStatistics | None:
        """Counters of messages; None before `init`."""
        return None if self._broker is None else self._broker.statistics

    def init(self, config: Element) -> None:
        """Create the variables, and connect.

        Raises:
            LocalError: If paho-mqtt is not installed.
            ConnectFailed: If there is no broker.
            BadValue: If the table cannot be read, or contains an invalid variable name.
        """
        super().init(config)
        broker, port, self._topics = _configured(config, *self._source)
        table = self.host.database.read
        for topic in self._topics.read:
            if topic.variable:
                self._identities[topic] = table.add(topic.variable, Float64.length(len(topic.values)))
        self._broker = _Broker(broker, port, self._topics.read)
        self._began = time.time()

    def periodic(self, tick: int) -> None:
        """Process the robot's messages, and send the velocity that programs have written."""
        broker, now = self._broker, self._clock()
        assert broker is not None
        pose = self._topics.pose
        for topic in self._topics.read:
            values = broker.take(topic)
            if values is None:
                continue
            if topic in self._identities:
                words = Float64.pack_many(values, len(values), "little")
                self.host.database.read.set(self._identities[topic], words)
            if topic is pose:
                self._take_pose(dict(zip(topic.values, values, strict=True)), now)
        super().periodic(tick)
        if self.host.writers and now - self._told >= _ALIVE:
            self._told = now
            broker.send(self._topics.alive, {"time": self._began})
            self._send(self._twist)

    def _take_pose(self, pose: Mapping[str, float], now: float) -> None:
        try:
            self.update_pose(pose["x"], pose["y"], pose["heading"])
        except BadValue as error:
            _log.warning("a pose was ignored: %s", error)
            return
        self._seen = now

    def _command(self, twist: Twist) -> None:
        """Store a new velocity, and send it immediately."""
        self._twist = twist
        self._send(twist)

    def _send(self, twist: Twist) -> None:
        if self._broker is None:
            return
        if self._clock() - self._seen > self._timeout:
            twist = Twist(0.0, 0.0)  # the pose is too old, so the robot must not drive
        self._broker.send(self._topics.command, twist._asdict())

    def terminate(self) -> None:
        """Stop the robot, and disconnect."""
        super().terminate()
        broker, self._broker = self._broker, None
        if broker is not None:
            broker.close()


class MqttTurtle(Plugin):
    """Simulated robot in a square world, which publishes its pose and obeys its master over MQTT, as DTU's robots do.

    The first client that sends an alive message becomes the master. Messages with the same value are from the same
    master. 2 s after the last message of the master, the robot stops, and another client can become the master.

    Args:
        broker: Address of the broker; in an `rhdconfig.xml`, ``broker="..."``.
        port: Port of the broker; ``port="..."``.
        world: World to drive in.
        topics: Table of topics; ``topics="path"``.
        clock: Monotonic clock, in s.
    """

    def __init__(
        self,
        broker: str = "localhost",
        port: int = 1883,
        *,
        world: World | None = None,
        topics: Topics = ROBOBOT,
        clock: Callable[[], float] = clock.now,
    ) -> None:
        check_whole(port, "port", 1, 65535)
        self.world = World() if world is None else world
        self._source = broker, port, topics
        self._clock = clock
        self._broker: _Broker | None = None
        self._master: tuple[float, ...] | None = None
        self._received_at = -math.inf
        self._command: Mapping[str, float] = {}
        self._seconds = 0.0

    @property
    def has_master(self) -> bool:
        """Whether there is a master, which has sent an alive message within the last 2 s."""
        return self._master is not None

    def init(self, config: Element) -> None:
        """Connect.

        Raises:
            LocalError: If paho-mqtt is not installed.
            ConnectFailed: If there is no broker.
            BadValue: If the table cannot be read.
        """
        broker, port, self._topics = _configured(config, *self._source)
        self._broker = _Broker(broker, port, (self._topics.command, self._topics.alive))

    def periodic(self, tick: int) -> None:
        """Drive for one period, and publish the new pose."""
        broker, topics = self._broker, self._topics
        assert broker is not None
        self._follow_master(broker.take(topics.alive))
        command = broker.take(topics.command)
        if self._master is None:
            self._command = {}
        elif command is not None:
            self._command = dict(zip(topics.command.values, command, strict=True))
        seconds = self.host.period
        self.world.step(self._command.get("linear", 0.0), self._command.get("angular", 0.0), seconds)
        self._seconds += seconds
        x, y, heading = self.world.odometry
        broker.send(topics.pose, {"time": self._seconds, "x": x, "y": y, "heading": heading})

    def _follow_master(self, alive: tuple[float, ...] | None) -> None:
        now = self._clock()
        if now - self._received_at > MASTER_TIMEOUT:
            self._master = None
        if alive is not None and self._master in (None, alive):
            self._master, self._received_at = alive, now

    def terminate(self) -> None:
        """Disconnect."""
        broker, self._broker = self._broker, None
        if broker is not None:
            broker.close()

"""Robots over MQTT: what DTU's current robots publish to a broker, as RHD variables, and a turtle that acts as one.

Known of these robots: they talk to the broker mosquitto, on topics such as ``robobot/drive/T0/pose``; a payload is
ASCII, numbers with blanks between them, the time first; there is one master, which keeps itself alive by messages;
after 2 s without one the robot stops. What stands beyond that in `ROBOBOT`, the names of the other topics and the order
and the units of values, is a guess, and marked as one. That is why it is a table, which a user can edit
(`read_topics`).

It needs paho-mqtt (``pip install urlink-robot[mqtt]``), which is imported when a plugin begins. paho has a thread of
its own for each connection; what it calls here only puts payloads into a dictionary.
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

#: Seconds without a message of its master after which a robot stops.
MASTER_TIMEOUT = 2.0
#: Seconds between two messages of a master, which are the command too.
_ALIVE = 0.25
#: Bytes of a payload, and of a table, that are read; values in a payload.
_LONGEST, _LARGEST, _MOST_VALUES = 4096, 1 << 16, 64
#: Seconds to connect, and without a word of the broker until the connection counts as lost.
_CONNECT_TIMEOUT, _KEEPALIVE = 5.0, 10

#: The table for DTU's robots. A line is a direction, a topic, the variable of RHD ("-" for none) and the names of the
#: values; "#" begins a comment.
ROBOBOT_TABLE = """\
read     robobot/drive/T0/pose  pose  time x y heading   # known: the topic, and the time first. A guess: m, m, rad
command  robobot/cmd/ti/rc      -     linear angular     # a guess: m/s, rad/s to the left
alive    robobot/cmd/ti/alive   -     time               # a guess: the time at which the master began, as its name
"""

_DIRECTIONS = ("read", "command", "alive")


@dataclass(frozen=True)
class MqttTopic:
    """One line of the table.

    Attributes:
        direction: "read" for what the robot tells, "command" for its velocity, "alive" for its master's message.
        name: of the topic.
        variable: of RHD, in which the values are doubles; "" for none.
        values: their names, in the order of the payload; a payload may have more.
    """

    direction: str
    name: str
    variable: str
    values: tuple[str, ...]

    def parse(self, payload: bytes) -> tuple[float, ...] | None:
        """The values of a payload; None for anything else."""
        try:
            words = payload[:_LONGEST].decode("ascii").split()
            found = tuple(float(word) for word in words[: len(self.values)])
        except (UnicodeDecodeError, ValueError):
            return None
        return found if len(found) == len(self.values) and all(map(math.isfinite, found)) else None

    def write(self, values: Mapping[str, float]) -> str:
        """The payload of values by name; 0 for one that is not there."""
        return " ".join(f"{values.get(name, 0.0):.4f}" for name in self.values)


@dataclass(frozen=True)
class Topics:
    """The table.

    Attributes:
        pose: where the robot is; its values have an x, a y and a heading among them.
        command: its velocity, with a linear and an angular one.
        alive: what its master says.
        read: all variables from the robot, the pose among them.
    """

    pose: MqttTopic
    command: MqttTopic
    alive: MqttTopic
    read: tuple[MqttTopic, ...]


def parse_topics(text: str, source: str = "table") -> Topics:
    """The table in a text.

    Raises:
        BadValue: it is not such a table; the message names the line.
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
            raise BadValue(f"{place}: a topic has no wildcards, and at most {_MOST_VALUES} values")
        found.append(MqttTopic(direction, name, "" if variable == "-" else variable, tuple(values)))
    by_direction = {word: [topic for topic in found if topic.direction == word] for word in _DIRECTIONS}
    poses = [topic for topic in by_direction["read"] if {"x", "y", "heading"} <= set(topic.values)]
    if not (len(poses) == len(by_direction["command"]) == len(by_direction["alive"]) == 1):
        raise BadValue(f"{source}: expected one topic with x, y and heading, one command, and one alive")
    (command,), (alive,) = by_direction["command"], by_direction["alive"]
    if not {"linear", "angular"} <= set(command.values):
        raise BadValue(f"{source}: the command has no values called linear and angular")
    if len({topic.name for topic in found}) != len(found):
        raise BadValue(f"{source}: a topic is there twice")
    return Topics(poses[0], command, alive, tuple(by_direction["read"]))


def read_topics(path: str | os.PathLike[str]) -> Topics:
    """The table in a file.

    Raises:
        BadValue: it cannot be read, or is not such a table.
    """
    try:
        with open(path, "rb") as file:
            text = file.read(_LARGEST).decode("utf-8")
    except (OSError, ValueError) as error:
        raise BadValue(f"cannot read {os.fspath(path)}: {getattr(error, 'strerror', None) or error}") from error
    return parse_topics(text, Path(path).name)


#: `ROBOBOT_TABLE`, read.
ROBOBOT = parse_topics(ROBOBOT_TABLE)


class MqttStatistics(NamedTuple):
    """What has passed.

    Attributes:
        received: messages on topics of the table.
        bad: those of them whose payload cannot be read.
        sent: messages to the broker.
        dropped: messages that were not sent, because the broker was not there. They are never sent later.
    """

    received: int
    bad: int
    sent: int
    dropped: int


class _Broker:
    """A connection to a broker, which is made again by itself, and the newest payload of each topic.

    Raises:
        LocalError: paho-mqtt is not installed.
        ConnectFailed: there is no broker.
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
            _log.warning("the MQTT broker at %s:%d refuses: %s", *self._place, reason)
            return
        # Anew after each loss: the session is clean, so the broker keeps no subscriptions.
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
        """The newest values of a topic, once; None if none have come since."""
        return self._newest.pop(topic.name, None)

    def send(self, topic: MqttTopic, values: Mapping[str, float]) -> None:
        """Send values, unless the broker is away: a velocity is not to be sent however late."""
        client = self._client
        if client is None or not client.is_connected():
            self.dropped += 1
            return
        client.publish(topic.name, topic.write(values), qos=0)
        self.sent += 1

    def close(self) -> None:
        """Disconnect, when what was sent has gone. Idempotent."""
        client, self._client = self._client, None
        if client is not None:
            client.disconnect()
            client.loop_stop()

    @property
    def statistics(self) -> MqttStatistics:
        return MqttStatistics(self.received, self.bad, self.sent, self.dropped)


def _configured(config: Element, broker: str, port: int, topics: Topics) -> tuple[str, int, Topics]:
    """As the file says, where it does: ``broker``, ``port`` and ``topics``."""
    path = config.attributes.get("topics")
    return (
        config.attributes.get("broker", broker),
        config.integer("port", port, least=1, most=65535),
        topics if path is None else read_topics(path),
    )


class MqttRobot(VelocityBridge):
    """A robot behind an MQTT broker, as programs for RHD know robots: MRC's, missions', your own.

    Its pose becomes `transpos` and `rotpos`, `cmdtransvel` and `cmdrotvel` become its command; and each topic that it
    tells is a read variable of doubles by the name that the table has for it::

        class Robobot(rhdlink.robots.VelocityOmega):
            pose = rhdlink.Read(rhdlink.Float64, 4)      # time, x, y, heading

    While a program may write, the robot is sent that, and its velocity again, four times a second. When none may, or
    the host ends, it is sent the velocity 0 and nothing more, and stops by itself 2 s later if that was lost. When no
    pose has come for `timeout` seconds it is sent the velocity 0 until there is one.

    Args:
        broker: address of the broker; in an `rhdconfig.xml`, ``broker="..."``.
        port: of the broker; ``port="..."``.
        topics: the table; ``topics="path"``.
        timeout: s.
        clock: monotonic, s.

    Raises:
        BadValue: an argument that cannot be.
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
        self._identities: dict[MqttTopic, int] = {}  # of the variables, by their topics

    @property
    def mqtt(self) -> MqttStatistics | None:
        """Counters of messages; None before `init`."""
        return None if self._broker is None else self._broker.statistics

    def init(self, config: Element) -> None:
        """Make the variables, and connect.

        Raises:
            LocalError: paho-mqtt is not installed.
            ConnectFailed: there is no broker.
            BadValue: the table cannot be read, or names what cannot be a variable.
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
        """Take the robot's messages, and send it the velocity that programs want."""
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
            _log.warning("a pose is left out: %s", error)
            return
        self._seen = now

    def _command(self, twist: Twist) -> None:
        """Remember a new velocity, and send it at once."""
        self._twist = twist
        self._send(twist)

    def _send(self, twist: Twist) -> None:
        if self._broker is None:
            return
        if self._clock() - self._seen > self._timeout:
            twist = Twist(0.0, 0.0)  # the pose is too old to be driven by
        self._broker.send(self._topics.command, twist._asdict())

    def terminate(self) -> None:
        """Have it stand, and disconnect."""
        super().terminate()
        broker, self._broker = self._broker, None
        if broker is not None:
            broker.close()


class MqttTurtle(Plugin):
    """A robot in a square world that talks MQTT as DTU's do: it publishes its pose, and obeys its master.

    Its master is whoever's alive message came first; the same value in it is the same master. 2 s after its last one it
    stops, and another may be.

    Args:
        broker: address of the broker; in an `rhdconfig.xml`, ``broker="..."``.
        port: of the broker; ``port="..."``.
        world: to be driven in.
        topics: the table; ``topics="path"``.
        clock: monotonic, s.
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
        """Whether an alive message has come within the last 2 s."""
        return self._master is not None

    def init(self, config: Element) -> None:
        """Connect.

        Raises:
            LocalError: paho-mqtt is not installed.
            ConnectFailed: there is no broker.
            BadValue: the table cannot be read.
        """
        broker, port, self._topics = _configured(config, *self._source)
        self._broker = _Broker(broker, port, (self._topics.command, self._topics.alive))

    def periodic(self, tick: int) -> None:
        """Drive for one period, and tell where that led."""
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

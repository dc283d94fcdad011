"""The simulated robot as the course's own client of 2026 uses it, and the page about these robots."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest

pytest.importorskip("paho.mqtt.client")

from linkcore.errors import BadValue, ConnectFailed
from rhdlink.address import MqttAddress
from rhdlink.host.world import World
from rhdlink.mqtt import SimulatedRobobot, decode
from rhdlink.mqtt.broker import BrokerConnection
from rhdlink.mqtt.variables import RobobotVariables
from tests.mosquitto import needs_broker
from tests.waiting import until

PAGE = Path(__file__).resolve().parents[3] / "docs" / "robobot.md"
IDENTITY = "2026-11-29 04:00:00.123456"


class CourseClient:
    """The messages of the course's client, in its order: it waits for some answers, and compares the master's ID."""

    def __init__(self, port: int) -> None:
        self.counts: dict[str, int] = {}
        self.masters: list[str] = []
        self.connection = BrokerConnection(
            MqttAddress("127.0.0.1", port), 10.0, topics=("robobot/drive/#",), on_message=self._take
        )

    def _take(self, topic: str, payload: bytes, is_retained: bool) -> None:
        name = topic.removeprefix("robobot/drive/")
        assert decode(topic, payload) is not None
        self.counts[name] = self.counts.get(name, 0) + 1
        if name == "master":
            self.masters.append(payload.decode().partition(" ")[2])

    def send(self, target: str, text: str) -> None:
        self.connection.publish(f"robobot/cmd/{target}", text)

    def has(self, *names: str) -> Callable[[], bool]:
        return lambda: all(name in self.counts for name in names)


@needs_broker
@pytest.mark.real_time
def test_simulated_robot_answers_the_start_of_the_courses_client(broker: int) -> None:
    with SimulatedRobobot("127.0.0.1", broker, dialect="2026", world=World(1000.0)) as robot:
        client = CourseClient(broker)
        try:
            client.send("ti", "log 1")
            until(client.has("T0/hbt", "T0/ird", "T0/gyro", "T0/acc", "T0/vel", "T0/pose"))
            assert "T0/livn" not in client.counts
            for text in ("enc0", "confw 0.074 0.074 19 92 0.23", "confi", "lip 1", "sub livn 10", "liwi"):
                client.send("T0", text)
            until(client.has("T0/conf", "T0/info", "T0/liw", "T0/livn"))
            client.send("ti", f"alive {IDENTITY}")
            client.send("ti", "rc 0.200 0.000 1738332036.629009")
            until(lambda: robot.world.odometry.x > 0.05)
            assert not client.masters  # the first message has no answer
            client.send("ti", f"alive {IDENTITY}")
            client.send("ti", "alive 2026-11-29 04:00:07.000000")
            until(lambda: client.masters == [IDENTITY, IDENTITY])
            client.send("T0/leds", "leds 16 0 0 100")  # some programs of students write the keyword twice
            client.send("ti", "rc 0 0")
            client.send("T0", "stop")
            until(lambda: robot._left.speed == robot._right.speed == 0.0)
            assert robot.ignored == 0
        finally:
            client.connection.close()


@needs_broker
@pytest.mark.slow
@pytest.mark.real_time
def test_simulated_robot_of_2025_has_the_rates_of_the_log(broker: int) -> None:
    """Rates of the log: 191 to 196 Hz, 98 Hz, 33 Hz, 39 Hz and 9.7 Hz."""
    with SimulatedRobobot("127.0.0.1", broker, dialect="2025") as robot:
        client = CourseClient(broker)
        try:
            first = robot._ticks
            until(lambda: robot._ticks >= first + 400)  # 2 s of the robot's time
            counts, seconds = dict(client.counts), (robot._ticks - first) * 0.005
        finally:
            client.connection.close()
    for name, rate in {"vel": 196.0, "mvel": 191.0, "livn": 98.0, "dist": 33.0, "mot": 39.0, "current": 9.7}.items():
        assert counts[f"T0/{name}"] / seconds == pytest.approx(rate, rel=0.15), name
    assert "T0/pose" not in counts


@pytest.mark.parametrize("text", ["rc", "rc 1 x", "rc nan 0", "sub unknown 10", "unknown", "confw 1 two"])
def test_simulated_robot_ignores_invalid_commands(text: str) -> None:
    robot = SimulatedRobobot(dialect="2026")
    target = "ti" if text.startswith("rc") else "T0"
    robot._receive(f"robobot/cmd/{target}", text.encode(), False)
    robot._obey(robot._waiting.popleft())
    assert (robot.ignored, len(robot.commands)) == (1, 0)
    assert robot._left.target == robot._right.target == 0.0


@pytest.mark.real_time
def test_simulated_robot_needs_a_broker() -> None:
    with pytest.raises(ConnectFailed, match="no MQTT broker"):
        SimulatedRobobot("127.0.0.1", 1).start()
    with pytest.raises(BadValue, match="expected one of 2025, 2026"):
        SimulatedRobobot(dialect="2024")


def test_page_lists_every_variable() -> None:
    table = PAGE.read_text(encoding="utf-8").partition("## Variables")[2].partition("\n## ")[0]
    listed = set(re.findall(r"`([a-z]+)`", table))
    assert {each.name for each in RobobotVariables.declared().values()} <= listed

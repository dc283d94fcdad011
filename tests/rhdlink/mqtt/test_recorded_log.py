"""The recorded log of a robot, message by message: what the robot published, and what its master sent."""

from __future__ import annotations

import math
import threading
from functools import partial

import pytest

pytest.importorskip("paho.mqtt.client")

import rhdlink
from rhdlink.address import MqttAddress
from rhdlink.mqtt import DIALECTS, TOPICS, Command, decode
from rhdlink.mqtt.broker import BrokerConnection
from rhdlink.mqtt.commands import alive, configure, interface_log, leds, stop, teensy, velocity
from rhdlink.mqtt.session import RobotSession
from rhdlink.mqtt.wheel_odometry import Odometry
from rhdlink.robots import Robobot
from tests.mosquitto import needs_broker
from tests.rhdlink.mqtt.recorded_log import Logged, count_of_lines, from_master, from_robot, rows
from tests.waiting import until

pytestmark = pytest.mark.captures("mqtt")
DIALECT = DIALECTS["2025"]


def test_log_has_only_messages_of_the_robot_and_its_master() -> None:
    assert (len(from_robot()), len(from_master())) == (15931, 195)
    assert count_of_lines() == len(from_robot()) + len(from_master())


def test_decode_reads_every_number_of_every_message() -> None:
    for logged in from_robot():
        message = decode(logged.topic, logged.payload.encode())
        assert message is not None, logged
        time, *words = logged.payload.split(" ")
        assert f"{message.stamp.seconds}.{message.stamp.microseconds // 100:04d}" == time
        if message.topic in ("T0/info", "T0/dname", "master"):
            (text,) = message.values.values()
            assert text == logged.payload.partition(" ")[2].strip()
            continue
        numbers: list[float] = []
        for value in message.values.values():
            numbers += value if isinstance(value, tuple) else (value,)
        assert numbers == [float(word) for word in words], logged


@pytest.mark.parametrize(
    ("topic", "variable", "log", "columns"),
    [
        ("T0/livn", "livn", "log_t0_edge_livn", slice(1, 9)),
        ("T0/current", "current", "log_t0_motor_current", slice(1, 3)),
        ("T0/hbt", "hbtvoltage", "log_t0_hbt", slice(4, 5)),
        ("T0/hbt", "hbtused", "log_t0_hbt", slice(7, 8)),
    ],
)
def test_decoded_values_equal_the_log_of_the_robot(topic: str, variable: str, log: str, columns: slice) -> None:
    own: dict[float, list[list[float]]] = {}
    for row in rows(log):
        own.setdefault(round(row[0], 3), []).append(row[columns])
    compared = 0
    for logged in from_robot():
        message = decode(logged.topic, logged.payload.encode())
        if message is None or message.topic != topic:
            continue
        value = message.values[variable]
        values = list(value) if isinstance(value, tuple) else [value]
        # The robot rounds the time to 1 ms in its log, and writes the log just before or after it publishes.
        near = [each for shift in (-1, 0, 1) for each in own.get(round(message.stamp.time + 1e-3 * shift, 3), [])]
        if near:
            compared += 1
            assert values in near
    assert compared >= 0.9 * len(rows(log)), f"compared {compared} of {len(rows(log))}"


def test_turn_rate_and_velocity_of_the_log_are_as_described() -> None:
    """The velocity equals the left wheel, and the turn rate follows from the wheel base of 0.23 m."""
    moving = 0
    for logged in from_robot():
        message = decode(logged.topic, logged.payload.encode())
        if message is None or message.topic != "T0/vel":
            continue
        values = message.values
        assert values["velocity"] == values["velleft"]
        moving += values["velright"] > 0.1
        assert values["turnrate"] == pytest.approx((values["velright"] - values["velleft"]) / 0.23, abs=0.006)
    assert moving > 2000


def test_every_topic_has_a_unit_or_is_a_plain_number() -> None:
    declared = Robobot.declared()
    plain = {each for topic in TOPICS.values() for each in topic.variables if not declared[each].unit}
    assert plain == {
        *("velcount", "livn", "livnextra", "liv", "liw", "mot", "confgear", "confpulses", "confreversed"),
        *("hbtindex", "hbtversion", "hbtstate", "hbtshutdown", "dname", "info", "master"),
    }


def _called(command: Command) -> Command:
    """Make the command by the call that a program would use."""
    words = command.arguments.split()
    match command.keyword:
        case "rc":
            # A program has numbers. The log has 0.0 and 0, and the course's line follower appends the time.
            numbers = [float(word) if "." in word else int(word) for word in words]
            return velocity(numbers[0], numbers[1], time=numbers[2] if len(numbers) > 2 else None)
        case "alive":
            return alive(command.arguments)
        case "log":
            return interface_log(words[0] == "1")
        case "stop":
            return stop()
        case "leds":
            number, red, green, blue = map(int, words)
            return leds(number, red, green, blue)
        case "confw":
            left, right, gear, pulses, base = words
            return configure(float(left), float(right), int(gear), int(pulses), float(base))
        case _:
            return teensy(f"{command.keyword} {command.arguments}")


def test_calls_produce_every_command_of_the_master() -> None:
    seen: dict[str, int] = {}
    for logged in from_master():
        command = DIALECT.decode(logged.topic, logged.payload.encode())
        assert command is not None
        assert DIALECT.encode(_called(command)) == (logged.topic, logged.payload)
        seen[command.keyword] = seen.get(command.keyword, 0) + 1
    assert seen == {
        **{"log": 3, "enc0": 3, "confw": 3, "encrev": 3, "confi": 3, "lip": 3, "liwi": 65, "leds": 18},
        **{"rc": 51, "alive": 41, "stop": 2},
    }


# -- over a broker ---------------------------------------------------------------------------------------------


def _same(one: Command, other: Command) -> bool:
    """Whether a robot does the same."""

    def numbers(command: Command) -> list[float]:
        return [float(word) for word in command.arguments.split()[:2]]

    if one.keyword == other.keyword == "rc":
        return numbers(one) == numbers(other)
    return one == other


class Listener:
    """A robot of 2025 that remembers commands, and answers `alive`."""

    def __init__(self, port: int) -> None:
        self.commands: list[Command] = []
        self.master = ""
        self.connection = BrokerConnection(
            MqttAddress("127.0.0.1", port), 10.0, topics=("robobot/cmd/#",), on_message=self._take
        )

    def has_more_than(self, count: int) -> bool:
        return len(self.commands) > count

    def _take(self, topic: str, payload: bytes, is_retained: bool) -> None:
        command = DIALECT.decode(topic, payload)
        if command is None:
            return
        if command.keyword == "alive":
            if self.master:
                self.connection.publish("robobot/drive/master", f"1738331987.0000 {self.master}")
            self.master = self.master or command.arguments
        else:
            self.commands.append(command)


@needs_broker
@pytest.mark.slow
@pytest.mark.real_time
def test_variables_produce_the_commands_of_each_run(broker: int) -> None:
    """The commands of the three runs, except `alive`, are sent by setting variables."""
    runs: list[list[Command]] = []
    for logged in from_master():
        command = DIALECT.decode(logged.topic, logged.payload.encode())
        assert command is not None
        if command.keyword == "log":
            runs.append([])
        # The client sends a velocity only if it has changed.
        is_repeated = any(_same(command, each) for each in runs[-1][-1:]) and command.keyword == "rc"
        if command.keyword not in ("alive", "stop") and not is_repeated:
            runs[-1].append(command)
    assert len(runs) == 3
    listener = Listener(broker)
    try:
        for run in runs:
            listener.commands.clear()
            listener.master = ""
            listener.connection.publish("robobot/drive/T0/vel", "1738331987.0 1.0 0.0 0.0")
            address = f"mqtt://127.0.0.1:{broker}?dialect=2025"
            connecting = _Publishing(listener)
            with connecting, rhdlink.connect(address, Robobot, access="w") as robot:
                until(lambda: len(listener.commands) == 1)  # rc 0 0
                for command in run:
                    before = len(listener.commands)
                    words = command.arguments.split()
                    if command.keyword == "rc":
                        if _same(command, next(each for each in reversed(listener.commands) if each.keyword == "rc")):
                            continue  # the robot stands already
                        robot.cmdtransvel, robot.cmdrotvel = float(words[0]), float(words[1])
                    elif command.keyword == "log":
                        robot.interfacelog = words == ["1"]
                    else:
                        robot.teensy = f"{command.keyword} {command.arguments}"
                    robot.sync()
                    until(partial(listener.has_more_than, before))
            until(lambda: listener.commands[-1] == stop())
            sent = _without_repeats(listener.commands[1:-2])
            wanted = [each for each in run if not _same(each, velocity(0.0, 0.0))]
            got = [each for each in sent if not _same(each, velocity(0.0, 0.0))]
            assert len(got) == len(wanted)
            assert all(map(_same, got, wanted))
    finally:
        listener.connection.close()


def _without_repeats(commands: list[Command]) -> list[Command]:
    """Remove the velocities that the client repeats with `alive`."""
    kept: list[Command] = []
    newest: Command | None = None
    for each in commands:
        if each.keyword == "rc":
            if each == newest:
                continue
            newest = each
        kept.append(each)
    return kept


class _Publishing:
    """Publish wheel speeds until the end of the block: a robot without them is not driven."""

    def __init__(self, listener: Listener) -> None:
        self._listener = listener
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run)

    def _run(self) -> None:
        seconds = 1.0
        while not self._ended.wait(0.02):
            seconds += 0.02
            self._listener.connection.publish("robobot/drive/T0/vel", f"1738331987.0 {seconds:.4f} 0.0 0.0")

    def __enter__(self) -> None:
        self._thread.start()

    def __exit__(self, *exc: object) -> None:
        self._ended.set()
        self._thread.join()


def _has_received(session: RobotSession, count: int) -> bool:
    return session.received == count


@needs_broker
@pytest.mark.slow
@pytest.mark.real_time
def test_client_reads_the_replayed_log(broker: int) -> None:
    """The driven distance and the turn are those of the log, and no message is lost or bad."""
    messages = from_robot()
    sender = BrokerConnection(MqttAddress("127.0.0.1", broker), 10.0)
    connection = MqttAddress("127.0.0.1", broker)
    taken: list[str] = []
    session = RobotSession(connection, lambda message: taken.append(message.topic), silence=60.0)
    try:
        for number, logged in enumerate(messages, start=1):
            sender.publish(logged.topic, logged.payload)
            if number % 200 == 0:  # not more, because a broker drops messages if a client is slow
                until(partial(_has_received, session, number))
        until(partial(_has_received, session, len(messages)))
        assert session.bad == 0
        assert taken == [logged.topic.removeprefix("robobot/drive/") for logged in messages]
    finally:
        session.close()
        sender.close()


def _integrated(messages: list[Logged]) -> tuple[float, float]:
    odometry = Odometry()
    for logged in messages:
        message = decode(logged.topic, logged.payload.encode())
        if message is not None and message.topic == "T0/vel":
            odometry.take_wheels(message.values)
    return odometry.distance, odometry.heading


def test_odometry_of_the_log_is_the_commanded_distance() -> None:
    """The third run drives about 10.4 s with 0.1 m/s and 0.5 rad/s, after 0.44 s with 0.25 m/s."""
    begin = 1738332036.6
    distance, heading = _integrated([each for each in from_robot() if each.time > begin])
    assert distance == pytest.approx(0.1 * 10.383 + 0.25 * 0.441, abs=0.03)
    # The mixer computes with a wheel base of 0.22 m, and the odometry with 0.23 m.
    assert heading == pytest.approx(0.5 * 10.383 * 0.22 / 0.23, rel=0.03)
    assert math.isfinite(distance)

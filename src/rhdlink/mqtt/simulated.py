"""`SimulatedRobobot`: a robot with MQTT in a square world, in both dialects, on a real broker."""

from __future__ import annotations

import logging
import math
import time
from collections import deque
from collections.abc import Callable, Mapping
from random import Random

from linkcore import clock
from linkcore.arguments import check_whole
from linkcore.errors import ConnectionLost
from linkcore.names import StrictAttributes
from linkcore.threads import ReentrantEvent, Runnable

from ..address import MQTT_PORT, MqttAddress
from ..host.world import World
from .broker import BrokerConnection
from .commands import CMD, Command, find_dialect
from .motors import STEP, Wheel
from .topics import DRIVE
from .wheel_odometry import WHEEL_BASE

_log = logging.getLogger(__name__)

#: Duration of a tick of the Teensy in s: the shortest interval of a topic.
TICK = 0.005
#: Wheel base with which the robot turns a velocity into wheel speeds, in m (log_mixer).
MIXER_BASE = 0.22
#: Line sensors: distance before the middle of the robot, and to its left for each sensor, sensor 0 first, in m. The
#: values are assumed; they are those of MRC.
_LINE_AHEAD = 0.21
_LINE_ASIDE = tuple(0.02 * (3.5 - number) for number in range(8))
#: Normalised values of the line sensors on black and on white. In the log, the floor reads 107 to 137.
_BLACK, _WHITE = 110.0, 1000.0
#: Directions of the distance sensors in rad, and their range in m. Programs of students use the first one to the right.
#: In the log, the largest value is 1.5 m.
_DIRECTIONS, _RANGE = (-math.pi / 2, 0.0), 1.5
#: White levels of the line sensors (log).
_WHITE_LEVELS = (592, 722, 745, 807, 841, 789, 729, 590)

#: Intervals of the topics in ms; 0 for topics that are not published without a request. 2025: the robot.ini of the log.
_INTERVALS = {
    "2025": {"vel": 5, "mvel": 5, "livn": 10, "dist": 30, "mot": 25, "current": 100, "hbt": 500, "dname": 8000},
    "2026": {"pose": 5, "vel": 5, "livn": 0, "ird": 30, "gyro": 12, "acc": 12, "hbt": 500, "dname": 8000},
}
#: Seconds after the last alive message after which the master is lost, and whether the robot then stops.
_MASTER_TIMEOUT = {"2025": (2.1, True), "2026": (4.0, False)}
#: Maximum number of commands that are remembered, and that wait for the next tick.
_MOST_COMMANDS = 10_000
_CLOSE_TIMEOUT = 5.0


class SimulatedRobobot(StrictAttributes, Runnable):
    """A robot of DTU with MQTT in a square world. A context manager that starts and closes itself::

        with SimulatedRobobot(dialect="2026", world=World(11.0)) as robot:
            ...  # rhdlink.connect(robot.address)

    It needs a broker, such as mosquitto. Its time is real time. The wheels are those of `Wheel`.

    Args:
        broker: Host of the broker.
        port: Port of the broker.
        dialect: Dialect of its commands, "2025" or "2026".
        world: World to drive in; by default 11 x 11 m, with the start in the middle.
        seed: Seed of the load of its wheels; None for wheels without noise.

    Attributes:
        world: See the argument `world`.
        master: ID of the master that it obeys; "" for none.
        commands: Commands that it has understood, the newest last.
        ignored: Number of messages that it has not understood.

    Raises:
        BadValue: If an argument is not valid.
    """

    def __init__(
        self,
        broker: str = "localhost",
        port: int = MQTT_PORT,
        *,
        dialect: str = "2026",
        world: World | None = None,
        seed: int | None = 1,
    ) -> None:
        super().__init__("simulated robot", _CLOSE_TIMEOUT, "the broker")
        check_whole(port, "port", 1, 65535)
        self.world = World() if world is None else world
        self.master = ""
        self.commands: deque[Command] = deque(maxlen=_MOST_COMMANDS)
        self.ignored = 0
        self._place = MqttAddress(broker, port)
        self._dialect = find_dialect(dialect)
        self._intervals = dict(_INTERVALS[dialect])
        self._timeout, self._stops_without_master = _MASTER_TIMEOUT[dialect]
        random = [None if seed is None else Random(2 * seed + side) for side in (0, 1)]
        self._left, self._right = (Wheel(each) for each in random)
        self._waiting: deque[Command] = deque(maxlen=_MOST_COMMANDS)
        self._connection: BrokerConnection | None = None
        self._stopping = ReentrantEvent()
        self._ticks = 0
        self._heard = -math.inf
        self._origin = self.world.odometry
        self._conf = [0.075, 0.075, 19.0, 68.0, WHEEL_BASE]

    @property
    def address(self) -> str:
        """Address of the robot, as for `rhdlink.connect`."""
        return str(self._place)

    @property
    def dialect(self) -> str:
        """Name of the dialect of its commands."""
        return self._dialect.name

    # -- its life --------------------------------------------------------------------------------------

    def _begin(self) -> None:
        self._connection = BrokerConnection(
            self._place, _CLOSE_TIMEOUT, topics=(f"{CMD}#",), on_message=self._receive, on_lost=self._lose
        )

    def _lose(self, reason: str) -> None:
        self.failure = ConnectionLost(f"{self._place}: the broker was lost: {reason}")
        self._stopping.set()

    def _wake(self) -> None:
        self._stopping.set()

    def _serve(self) -> None:
        due = clock.now()
        try:
            while not (self._is_stopping or clock.wait(self._stopping.wait, clock.left(due))):
                self._tick()
                # After an interruption of this computer, time that has passed is not simulated.
                due = max(due + TICK, clock.now() - 10 * TICK)
        except ConnectionLost as error:
            self.failure = self.failure or error
        finally:
            self._give_up()

    def _give_up(self) -> None:
        if self._connection is not None:
            self._connection.close()

    # -- a tick ----------------------------------------------------------------------------------------

    def _tick(self) -> None:
        while self._waiting:
            self._obey(self._waiting.popleft())
        if self.master and clock.now() - self._heard > self._timeout:
            self.master = ""
            if self._stops_without_master:
                self._left.target = self._right.target = 0.0
        for _ in range(round(TICK / STEP)):
            self._left.step()
            self._right.step()
        left, right = self._left.speed, self._right.speed
        self.world.step((left + right) / 2, (right - left) / WHEEL_BASE, TICK)
        self._ticks += 1
        for name, interval in self._intervals.items():
            # An interval is a multiple of a tick only for most topics, so compare how often it has passed.
            if interval and self._ticks * 5 // interval != (self._ticks - 1) * 5 // interval:
                self._publish(name)

    def _publish(self, name: str, text: str | None = None) -> None:
        assert self._connection is not None
        text = _PAYLOADS[name](self) if text is None else text
        topic = name if name == "master" else f"T0/{name}"
        self._connection.publish(f"{DRIVE}{topic}", f"{time.time():.4f} {text}")

    # -- commands --------------------------------------------------------------------------------------

    def _receive(self, topic: str, payload: bytes, is_retained: bool) -> None:
        command = self._dialect.decode(topic, payload)
        if command is None:
            self.ignored += 1
        else:
            self._waiting.append(command)

    def _obey(self, command: Command) -> None:
        try:
            known = (self._obey_interface if command.target == "ti" else self._obey_teensy)(command)
        except (ValueError, IndexError):  # a number is missing, or is not a number
            known = False
        if known:
            self.commands.append(command)
        else:
            self.ignored += 1

    def _obey_interface(self, command: Command) -> bool:
        words = command.arguments.split()
        if command.keyword == "alive":
            self._hear(command.arguments)
        elif command.keyword == "rc":
            linear, angular = float(words[0]), float(words[1])
            if not (math.isfinite(linear) and math.isfinite(angular)):
                return False
            turn = angular * MIXER_BASE / 2
            self._left.target, self._right.target = linear - turn, linear + turn
            self._left.is_on = self._right.is_on = True
        else:
            return command.keyword == "log"
        return True

    def _hear(self, identity: str) -> None:
        if not self.master:
            # The first message has no answer.
            self.master = identity
        else:
            self._publish("master", self.master)
        # As in the robot's program, which compares the IDs up to the length of the new one.
        if self.master.startswith(identity):
            self._heard = clock.now()

    def _obey_teensy(self, command: Command) -> bool:
        words = command.arguments.split()
        if command.keyword == "stop":
            for wheel in (self._left, self._right):
                wheel.target, wheel.is_on = 0.0, False
            self._publish("info", "# stopping")
        elif command.keyword == "enc0":
            self._origin = self.world.odometry
        elif command.keyword == "confw":
            self._conf = [float(word) for word in words[:5]]
            left, right, gear, pulses, base = self._conf
            self._publish("info", f"# got confw: r1={left:g}, r2={right:g}, G={gear:g}, PPR={pulses:g}, WB={base:g}")
        elif command.keyword == "confi":
            self._publish("conf")
        elif command.keyword in ("liwi", "licw"):
            self._publish("liw")
        elif command.keyword == "livi":
            self._publish("liv")
        elif command.keyword == "sub":
            if words[0] not in _PAYLOADS:
                return False
            self._intervals[words[0]] = max(int(words[1]), 0)
        else:
            return command.keyword in ("lip", "leds", "encrev", "eew", "litb", "servo")
        return True

    # -- payloads --------------------------------------------------------------------------------------

    @property
    def _turn_rate(self) -> float:
        return (self._right.speed - self._left.speed) / self._conf[4]

    def _clock(self) -> str:
        return f"{self._ticks * TICK:.4f}"

    def _pose(self) -> str:
        x, y, heading = self.world.odometry
        dx, dy, start = x - self._origin.x, y - self._origin.y, self._origin.theta
        c, s = math.cos(start), math.sin(start)
        turned = math.remainder(heading - start, 2 * math.pi)
        return f"{self._clock()} {dx * c + dy * s:.3f} {dy * c - dx * s:.3f} {turned:.4f} 0.0000"

    def _vel(self) -> str:
        left, right = self._left.speed, self._right.speed
        # In the log, the last speed equals the left wheel, and the last number alternates.
        return f"{self._clock()} {left:.3f} {right:.3f} {self._turn_rate:.4f} {left:.3f} {2 + self._ticks % 2}"

    def _mvel(self) -> str:
        return f"{self._left.speed:.3f} {self._right.speed:.3f}"

    def _livn(self) -> str:
        seen = self.world.brightness(_LINE_AHEAD, _LINE_ASIDE)
        text = " ".join(f"{_BLACK + (_WHITE - _BLACK) * each:.0f}" for each in seen)
        # The meaning of the ninth number is not known.
        return text if self._dialect.name == "2026" else f"{text} 0"

    def _liv(self) -> str:
        normalised = self._livn().split()[: len(_WHITE_LEVELS)]
        return " ".join(
            f"{0.001 * int(word) * level:.0f}" for word, level in zip(normalised, _WHITE_LEVELS, strict=True)
        )

    def _distances(self) -> str:
        return " ".join(f"{min(self.world.wall(direction), _RANGE):.3f}" for direction in _DIRECTIONS)

    def _mot(self) -> str:
        return f"{self._left.volts:.2g} {self._right.volts:.2g} 0.1 0.1 0"

    def _current(self) -> str:
        # The ratio of the mean current to the mean voltage in the log is about 0.1 A / V.
        return f"{abs(self._left.volts) * 0.1:.3f} {abs(self._right.volts) * 0.1:.3f}"

    def _confi(self) -> str:
        left, right, gear, pulses, base = self._conf
        return f"{left:.4f} {right:.4f} {gear:.3f} {pulses:.0f} {base:.4f} 0.0020 0"


#: Payload of each topic.
_PAYLOADS: Mapping[str, Callable[[SimulatedRobobot], str]] = {
    "pose": SimulatedRobobot._pose,
    "vel": SimulatedRobobot._vel,
    "mvel": SimulatedRobobot._mvel,
    "livn": SimulatedRobobot._livn,
    "liv": SimulatedRobobot._liv,
    "liw": lambda robot: " ".join(map(str, _WHITE_LEVELS)),
    "dist": SimulatedRobobot._distances,
    "ird": SimulatedRobobot._distances,
    "mot": SimulatedRobobot._mot,
    "current": SimulatedRobobot._current,
    "gyro": lambda robot: f"0.000 0.000 {math.degrees(robot._turn_rate):.3f}",
    "acc": lambda robot: "0.000 0.000 1.000",
    "hbt": lambda robot: "119 1033 4 15.70 8.9 0.45 83.905 0 50.2",
    "dname": lambda robot: "Simulated",
    "conf": SimulatedRobobot._confi,
}

"""`MqttRobot`: a robot over MQTT as variables, for `rhdlink.connect` and for a host."""

from __future__ import annotations

import logging
import threading
from typing import Literal

from linkcore import clock
from linkcore.arguments import check_choice, check_seconds
from linkcore.errors import BadValue

from ..address import MqttAddress, parse_mqtt_address
from ..host.config import Element
from ..host.plugin import Plugin
from ..variables.database import TimeStamp
from ..variables.value_types import wrapped
from .commands import STANDSTILL, Command, find_dialect, interface_log, teensy, velocity
from .session import RobotSession
from .topics import Message
from .variables import ANGULAR_SCALE, LINEAR_SCALE, RobobotVariables
from .wheel_odometry import Odometry

_log = logging.getLogger(__name__)

#: Maximum age of the odometry, in s, at which the robot may drive.
_OLDEST = 1.0
#: Maximum wait for the first heartbeat, in s. A robot sends two of them in each second.
_HEARTBEAT = 0.6


class MqttRobot(RobobotVariables, Plugin):
    """A robot over MQTT as RHD variables.

    `rhdlink.connect("mqtt://192.168.0.55")` uses it in the same process. A host presents the robot to programs that
    speak RHD only, such as MRC::

        with Host([MqttRobot("mqtt://192.168.0.55")]) as host:
            ...

    With access "w", the plugin is the master of the robot from `init` to `terminate`. At the end it sends the commands
    ``rc 0 0`` and ``stop``. If no program may write, it sends the speed 0. The speed 0 is also sent if the robot has
    not published its pose or the speeds of its wheels for one second. If the broker is lost, if the robot is silent, or
    if another client drives the robot, `periodic` raises an error, and the host ends.

    Args:
        address: Address such as ``"mqtt://192.168.0.55"`` or ``"mqtt://localhost:1883?dialect=2026"``. In an
            `rhdconfig.xml`, the attribute ``address``.
        access: "w" to be the master of the robot; "r" to read only.
        timeout: Maximum time for connecting, in seconds.
        silence: Seconds without a message of the robot after which it counts as lost.

    Raises:
        BadAddress, BadValue: If an argument is not valid.
    """

    def __init__(
        self,
        address: str = "mqtt://localhost",
        access: Literal["r", "w"] = "w",
        *,
        timeout: float = 5.0,
        silence: float = 5.0,
    ) -> None:
        self._address = _checked(address)
        check_choice(access, "access", ("r", "w"))
        self._access = access
        self._timeout = check_seconds(timeout, "timeout", positive=True, finite=True)
        self._silence = check_seconds(silence, "silence", positive=True)
        self._lock = threading.RLock()
        self._news: dict[str, Message] = {}
        self._odometry = Odometry()
        self._moved: TimeStamp | None = None
        self._moved_at = float("-inf")
        self._session: RobotSession | None = None
        self._sent = STANDSTILL
        self._is_stale = False

    @property
    def session(self) -> RobotSession | None:
        """Session with the robot; None before `init` and after `terminate`."""
        return self._session

    def init(self, config: Element) -> None:
        """Connect, and become the master of the robot.

        Raises:
            LocalError: If paho-mqtt is not installed.
            ConnectFailed, LinkTimeout: If there is no broker or no robot.
            AccessDenied: If another client drives the robot.
        """
        if "address" in config.attributes:
            self._address = _checked(config.attributes["address"])
        until = clock.now() + self._timeout
        session = RobotSession(self._address, self._take, timeout=self._timeout, silence=self._silence)
        try:
            session.wait_for_robot(clock.left(until))
            if self._access == "w":
                session.drive(clock.left(until))
            session.wait_for_values(min(_HEARTBEAT, clock.left(until)))
        except BaseException:
            session.close()
            raise
        self._session = session

    def periodic(self, tick: int) -> None:
        """Set the variables, and send the commands that programs have written.

        Raises:
            AccessDenied, ConnectionLost: If the session has ended; see the class.
        """
        self.send_commands()
        self.update_values()

    def terminate(self) -> None:
        """Stop the robot, and disconnect."""
        session, self._session = self._session, None
        if session is not None:
            session.close()

    # -- from the robot --------------------------------------------------------------------------------

    def _take(self, message: Message) -> None:
        with self._lock:
            self._news[message.topic] = message
            odometry = self._odometry
            if message.topic == "T0/pose":
                odometry.take_pose(message.values)
            elif message.topic == "T0/conf":
                if "confbase" in message.values and message.values["confbase"] > 0.0:
                    odometry.base = message.values["confbase"]
                return
            elif message.topic != "T0/vel" or not odometry.take_wheels(message.values):
                return
            self._moved, self._moved_at = message.stamp, clock.now()

    def update_values(self) -> None:
        """Set the variables of the messages that have arrived since the last call."""
        with self._lock:
            news, self._news = self._news, {}
            moved, self._moved = self._moved, None
            distance, heading = self._odometry.distance, self._odometry.heading
        for message in news.values():
            for name, value in message.values.items():
                self._set(name, value, message.stamp)
            if message.topic == "T0/livn":
                self._set("linesensor", message.values["livn"][::-1], message.stamp)
        if moved is not None:
            self._set("transpos", wrapped(distance * LINEAR_SCALE), moved)
            self._set("rotpos", wrapped(heading * ANGULAR_SCALE) / ANGULAR_SCALE, moved)

    def _set(self, name: str, value: object, stamp: TimeStamp) -> None:
        table, identity = self._place(self.declared()[name])
        table.set(identity, self._bound_packers[name](value), stamp)

    # -- to the robot ----------------------------------------------------------------------------------

    def send_commands(self) -> None:
        """Send the commands that programs have written since the last call.

        Raises:
            AccessDenied, ConnectionLost: If the session has ended; see the class.
        """
        session = self._session
        assert session is not None
        session.check()
        if not session.is_master:
            return
        wanted = self._wanted()
        if wanted != self._sent:
            self._sent = wanted
            session.send(wanted)
        if self.is_updated(RobobotVariables.teensy):
            try:
                session.send(teensy(self.teensy))
            except BadValue as error:
                _log.warning("%s: %s", self._address, error)
        if self.is_updated(RobobotVariables.interfacelog):
            session.send(interface_log(self.interfacelog))

    def _wanted(self) -> Command:
        """Velocity to send: the written one, or a standstill."""
        if not self.host.writers:
            return STANDSTILL
        wanted = self._sent
        if self.is_updated(RobobotVariables.cmdtransvel) or self.is_updated(RobobotVariables.cmdrotvel):
            # Remove the digits that a fixed-point number adds, such as the last one of 0.30000000000000004.
            linear, angular = round(self.cmdtransvel, 6), round(self.cmdrotvel, 6)
            wanted = velocity(linear, angular) if linear or angular else STANDSTILL
        was_stale = self._is_stale
        self._is_stale = wanted != STANDSTILL and clock.now() - self._moved_at > _OLDEST
        if self._is_stale and not was_stale:
            _log.warning("%s: the robot has sent no pose and no wheel speeds for %g s: stopped", self._address, _OLDEST)
        return STANDSTILL if self._is_stale else wanted


def _checked(address: str) -> MqttAddress:
    parsed = parse_mqtt_address(address)
    if parsed.dialect is not None:
        find_dialect(parsed.dialect)
    return parsed

"""A robot over MQTT as the transport of a client, so that everything above it is the same as for a robot with RHD.

The transport runs the plugin `MqttRobot` in the process of the client, and answers the requests of the client as a host
does: at the next tick, with the variables that have changed. So the bytes of a recording are those of a robot with RHD,
and `rhdlink replay` plays them without MQTT. A tick has 10 ms, like a tick of DTU's robots with RHD.
"""

from __future__ import annotations

from typing import Literal

from linkcore import clock
from linkcore.clock import Stamp
from linkcore.errors import ConnectionLost, LinkTimeout
from linkcore.threads import ReentrantEvent

from ..address import MqttAddress
from ..errors import AccessDenied
from ..host.plugin import Plugin, initialise
from ..host.service import Service
from ..variables.database import Database
from ..variables.value_types import wrapped
from ..wire.messages import encode_access
from .commands import find_dialect
from .mqtt_robot import MqttRobot

#: Duration of a tick, in s.
PERIOD = 0.01


class _HostedRobot:
    """A connected robot, and the host of its plugin for one client.

    Attributes:
        database: Variables of the robot.
        period: Duration of a tick, in s.
        tick: Number of the tick.
        has_ended: Event of the end.
    """

    def __init__(self, plugin: MqttRobot, access: str, width: int) -> None:
        self.database = Database()
        self.period = PERIOD
        self.tick = 0
        self.has_ended = ReentrantEvent()
        self._plugin = plugin
        self._access = access
        self.database.read.add("tick")
        initialise(plugin, self)
        plugin.update_values()
        self._service = Service(self.database, clients=1, width=width)
        client = self._service.connect("client")
        assert client is not None  # the only one
        self._client = client
        self._greeting = b""
        self._began = clock.now()

    @property
    def writers(self) -> int:
        """Number of clients that may write."""
        return self._service.writers

    @property
    def plugins(self) -> tuple[Plugin, ...]:
        """Plugins of the robot."""
        return (self._plugin,)

    def stop(self) -> None:
        """End. The plugin never calls it."""
        self.has_ended.set()

    def request(self, data: bytes) -> None:
        """Process a request."""
        if self._client.access is None and self._access == "r" and data == encode_access("w"):
            data = encode_access("r")  # the fallback: the robot has another master
        self._greeting += self._service.receive(self._client, data)
        if self._client.failure is not None:
            raise ConnectionLost(f"invalid request: {self._client.failure}")

    def until_tick(self) -> float:
        """Return the seconds until the next tick."""
        return self._began + (self.tick + 1) * self.period - clock.now()

    def answer(self) -> bytes:
        """Return the handshake, or the answer to a request if a tick is due; otherwise nothing.

        Raises:
            AccessDenied, ConnectionLost, Closed: If the session with the robot has ended.
        """
        if self._greeting:
            greeting, self._greeting = self._greeting, b""
            return greeting
        session = self._plugin.session
        if self.has_ended.is_set() or session is None:
            raise ConnectionLost("the connection was closed by this program")
        session.check()
        if not self._client.is_asking or self.until_tick() > 0.0:
            return b""
        # Count missed ticks, so that a mission measures the time correctly.
        self.tick = max(self.tick + 1, int((clock.now() - self._began) / self.period))
        self.database.read.set(0, wrapped(self.tick))
        self._plugin.update_values()
        replies = self._service.sync()
        self._plugin.send_commands()
        return b"".join(data for _, data in replies)

    def close(self) -> None:
        """Stop the robot, and disconnect. Wake threads that wait for an answer."""
        self.has_ended.set()
        self._plugin.terminate()


class MqttTransport:
    """The transport of a client to a robot over MQTT. For its methods, see `rhdlink.wire.transport.Transport`.

    Args:
        address: Address of the broker.
        access: Requested access, "r" or "w".
        fallback: "r" accepts read access if the robot has another master; otherwise None.
        width: Number of 32-bit words of a time stamp; None for 2.
        silence: Seconds without a message of the robot after which it counts as lost.

    Attributes:
        name: Address of the broker, used in messages.
        period: Duration of a tick, in s.

    Raises:
        BadValue: If the dialect in the address is not known.
    """

    def __init__(
        self,
        address: MqttAddress,
        *,
        access: Literal["r", "w"],
        fallback: Literal["r"] | None = None,
        width: int | None = None,
        silence: float = 5.0,
    ) -> None:
        self.name = str(address)
        self.period = PERIOD
        if address.dialect is not None:
            find_dialect(address.dialect)
        self._address = address
        self._access, self._fallback = access, fallback
        self._width = 2 if width is None else width
        self._silence = silence
        self._robot: _HostedRobot | None = None

    def open(self, timeout: float) -> None:
        """Connect, and become the master of the robot if the access is "w".

        Raises:
            LocalError: If paho-mqtt is not installed.
            ConnectFailed, LinkTimeout: If there is no broker or no robot.
            AccessDenied: If another client drives the robot, and there is no fallback.
        """
        self.abort()
        until = clock.now() + timeout
        try:
            self._robot = self._opened(self._access, timeout)
        except AccessDenied:
            if self._fallback is None:
                raise
            self._robot = self._opened("r", max(clock.left(until), 0.1))

    def _opened(self, access: Literal["r", "w"], timeout: float) -> _HostedRobot:
        plugin = MqttRobot(str(self._address), access, timeout=timeout, silence=self._silence)
        return _HostedRobot(plugin, access, self._width)

    def _connected(self) -> _HostedRobot:
        robot = self._robot
        if robot is None:
            raise ConnectionLost(f"{self.name} is not connected")
        return robot

    def receive(self, timeout: float | None = None) -> tuple[bytes, Stamp]:
        """Wait for the answer of the next tick."""
        until = clock.now() + (self._silence if timeout is None else timeout)
        robot = self._connected()
        while not (data := robot.answer()):
            left = until - clock.now()
            if left <= 0.0:
                raise LinkTimeout(f"{self.name}: no answer within the time limit")
            clock.wait(robot.has_ended.wait, min(left, robot.until_tick()))
        return data, Stamp.now()

    def receive_waiting(self) -> tuple[bytes, Stamp] | None:
        """Return an answer that is due now, or None. Does not wait."""
        data = self._connected().answer()
        return (data, Stamp.now()) if data else None

    def send(self, data: bytes, timeout: float) -> None:
        """Pass a request to the robot's variables."""
        self._connected().request(data)

    def abort(self) -> None:
        """Stop the robot, and disconnect."""
        robot, self._robot = self._robot, None
        if robot is not None:
            robot.close()

    def close(self) -> None:
        """Stop the robot, and disconnect."""
        self.abort()

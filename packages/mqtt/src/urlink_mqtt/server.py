"""Server of a robot over MQTT: one connection, whose last will reports that the robot is no longer served."""

from __future__ import annotations

import contextlib
import json
import logging
import math
import re
import threading
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from paho.mqtt.client import Client, MQTTMessage
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion
from paho.mqtt.subscribeoptions import SubscribeOptions

from linkcore import clock
from urlink import BadValue, ConnectFailed, LinkError, LocalError, Motion, PendingCall, Robot

from .commands import COMMANDS, LARGEST_AGE, MOTIONS, Asked, ServerClock, begin, read

if TYPE_CHECKING:
    from typing_extensions import Self

__all__ = ["PREFIX", "Broker", "Server"]

_log = logging.getLogger("urlink.mqtt")

#: Default for the first part of all topics.
PREFIX = "urlink"
#: Keepalive, in s. After this silence, broker and server consider each other lost; the broker waits 1.5 times as long.
_KEEPALIVE = 5
#: Maximum time, in s, for the broker to answer when the server starts, and to accept the last status when it ends.
_SOON = 10.0
#: Maximum number of queued messages while the broker is away: answers and ends of motions, but no status.
_QUEUED = 100
#: one level of a topic, without wildcards
_LEVEL = re.compile(r"[A-Za-z0-9_.-]+")
_FIELDS = ("q_actual", "qd_actual", "tool_vector_actual", "tcp_force", "motor_temperatures", "speed_scaling")
_MODES = ("robot_mode", "safety_mode", "program_state")


class Broker(NamedTuple):
    """Address of a broker, and login data.

    Attributes:
        host: Name or address.
        port: TCP port; None for 1883, or 8883 with TLS.
        user, password: Login data; None for none.
        tls: Whether to encrypt, and to check the broker's certificate.
        ca: File of certificates for this check; None for the certificates of the system.
    """

    host: str = "localhost"
    port: int | None = None
    user: str | None = None
    password: str | None = None
    tls: bool = False
    ca: str | None = None


class Server:
    """Serve a robot over MQTT until the server is closed; a context manager.

    A motion ends when its client has left according to its topic ``client/ID``, which should have a last will. It also
    ends when the connection to the broker is lost, because no client could stop the arm then.

    Args:
        robot: Robot to serve. It is not closed with the server.
        name: Name of the robot, one level of its topics.
        broker: Broker to connect to.
        prefix: First part of all topics.
        status_rate: Number of status messages per second.
        allow_commands: Whether to accept commands. If false, all commands are refused.

    Raises:
        BadValue: If the name cannot be a level of a topic, if the rate is not from 0.1 to 100, or if the file contains
            no certificates.
        ConnectFailed: If the broker cannot be reached within 10 s, or refuses the connection.
    """

    def __init__(
        self,
        robot: Robot,
        name: str,
        broker: Broker,
        *,
        prefix: str = PREFIX,
        status_rate: float = 5.0,
        allow_commands: bool = False,
    ) -> None:
        if not _LEVEL.fullmatch(name) or not all(map(_LEVEL.fullmatch, prefix.split("/"))):
            raise BadValue(f"invalid topic {prefix}/{name}; expected levels of letters, digits, '_', '.' and '-'")
        if not 0.1 <= status_rate <= 100:
            raise BadValue(f"status_rate={status_rate!r}; expected 0.1 to 100 per second")
        self.topic = f"{prefix}/{name}"
        self._robot = robot
        self._allows = allow_commands and _takes_commands(robot)
        self._clock = ServerClock()
        self._present: set[str] = set()
        self._held: tuple[str, Motion] | None = None
        #: requested motions without an answer, each with its client
        self._requested: list[tuple[str, PendingCall]] = []
        #: executed commands, and when they expire; needed because a broker might deliver a message again
        self._executed: dict[tuple[str, bytes], float] = {}
        self._ended = threading.Event()
        self._answered = threading.Event()
        # Set while the broker passes commands on to this server.
        self._hears = threading.Event()
        self._refused = f"no answer within {_SOON:g} s"
        # A separate lane for stops, so that a stop never waits for another command.
        self._stops, self._others = (ThreadPoolExecutor(1, f"{name} {lane}") for lane in ("stops", "commands"))
        # With MQTT 5, a subscriber can see that a command was published with the retain flag.
        self._client = Client(CallbackAPIVersion.VERSION2, protocol=MQTTProtocolVersion.MQTTv5)
        self._client.max_queued_messages_set(_QUEUED)
        self._client.reconnect_delay_set(1, 5)
        self._client.on_connect = self._connected
        self._client.on_subscribe = self._subscribed
        self._client.on_disconnect = self._disconnected
        self._client.on_message = self._heard
        self._client.will_set(f"{self.topic}/status", json.dumps({"served": False}), qos=1, retain=True)
        self._connect(broker)
        self._teller = threading.Thread(
            target=self._tell, args=(1.0 / status_rate,), name=f"{name} status", daemon=True
        )
        self._teller.start()

    def _connect(self, broker: Broker) -> None:
        where = f"{broker.host}:{broker.port or (8883 if broker.tls else 1883)}"
        if broker.user is not None:
            self._client.username_pw_set(broker.user, broker.password)
        if broker.tls:
            try:
                self._client.tls_set(broker.ca)
            except (OSError, ValueError) as error:
                raise BadValue(f"{broker.ca}: {error}") from None
        try:
            self._client.connect(broker.host, int(where.rpartition(":")[2]), keepalive=_KEEPALIVE)
        except (OSError, ValueError) as error:
            raise ConnectFailed(f"cannot connect to the broker at {where}: {error}") from error
        self._client.loop_start()
        if not clock.wait(self._answered.wait, _SOON) or self._refused:
            self._client.disconnect()
            self._client.loop_stop()
            raise ConnectFailed(f"cannot connect to the broker at {where}: {self._refused}")

    def close(self) -> None:
        """End the motion of a client, report the end of serving, and disconnect; idempotent."""
        if self._ended.is_set():
            return
        self._ended.set()
        self._teller.join(_SOON)
        for lane in (self._others, self._stops):
            lane.shutdown(cancel_futures=True)
        self._cancel()
        with contextlib.suppress(ValueError, RuntimeError):  # if the broker is away, it publishes the last will instead
            self._put("status", {"served": False}, retain=True).wait_for_publish(1.0)
        self._client.disconnect()
        self._client.loop_stop()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    # -- state -----------------------------------------------------------------------------------------

    def _put(self, topic: str, said: dict[str, Any], *, qos: int = 1, retain: bool = False) -> Any:
        payload = json.dumps(_plain(said), allow_nan=False)
        return self._client.publish(f"{self.topic}/{topic}", payload, qos=qos, retain=retain)

    def _tell(self, period: float) -> None:
        while not clock.wait(self._ended.wait, period):
            # A client that sees the status may send a command at once, which the broker must not lose.
            if not self._hears.is_set():
                continue
            try:
                # A status that cannot be sent now is not worth sending later.
                self._put("status", self._status(), qos=0, retain=True)
            except LinkError as error:
                _log.warning("%s: could not publish the status: %s", self.topic, error)

    def _status(self) -> dict[str, Any]:
        robot, state = self._robot, self._robot.realtime.latest
        said: dict[str, Any] = {
            "served": True,
            "connection": robot.realtime.connection.value,
            **self._clock.described(),
        }
        if self._allows:
            refusal = robot.safety.refusal
            held = self._held
            said["refusal"] = None if refusal is None else str(refusal)
            said["motion"] = None if held is None or held[1].done else _of_motion(*held)
        if state is not None and state.received is not None:
            said |= {"age": state.received.age, "received": state.received.wall}
            said |= {name: getattr(state, name) for name in _FIELDS}
            modes = {name: getattr(state, name) for name in _MODES}
            said |= {name: None if mode is None else mode.name for name, mode in modes.items()}
        return said

    # -- commands: in the client's thread, which must not be blocked -----------------------------------

    def _connected(self, client: Client, data: Any, flags: Any, reason: Any, properties: Any) -> None:
        self._refused = str(reason) if reason.is_failure else ""
        if not reason.is_failure:
            # Subscribe here, so that it also happens after each reconnect.
            options = SubscribeOptions(qos=1, retainAsPublished=True)
            client.subscribe([(f"{self.topic}/command/+", options), (f"{self.topic}/client/+", options)])
            identity = self._robot.identity
            self._put(
                "info",
                {
                    "model": identity.model,
                    "firmware": str(identity.firmware),
                    "commands": ["cancel", "stop", *sorted(COMMANDS)] if self._allows else [],
                },
                retain=True,
            )
        self._answered.set()

    def _subscribed(self, client: Client, data: Any, number: Any, reasons: Any, properties: Any) -> None:
        self._hears.set()

    def _disconnected(self, client: Client, data: Any, flags: Any, reason: Any, properties: Any) -> None:
        self._hears.clear()
        self._present.clear()
        with contextlib.suppress(RuntimeError):  # the server is closed
            self._abandon(list(self._requested))
            self._stops.submit(self._cancel)

    def _heard(self, client: Client, data: Any, message: MQTTMessage) -> None:
        kind, name = message.topic.removeprefix(f"{self.topic}/").split("/", 1)
        with contextlib.suppress(RuntimeError):  # the server is closed
            if kind == "client" and message.payload:
                self._present.add(name)
            elif kind == "client":
                self._present.discard(name)
                self._abandon([each for each in self._requested if each[0] == name])
                self._stops.submit(self._lost, name)
            elif not message.retain:  # retained commands are old: no client waits for them now
                self._take(name, bytes(message.payload))

    def _take(self, name: str, payload: bytes) -> None:
        """Pass a command on to its lane.

        The call counts as entered now, so that a stop which arrives later takes effect on it.
        """
        requested = ("", PendingCall())
        if name == "cancel":
            self._abandon(list(self._requested))
        elif name in MOTIONS:
            with contextlib.suppress(BadValue):  # the lane reports this error in its answer
                requested = (read(payload).client, requested[1])
            self._requested.append(requested)
        lane = self._stops if name in ("stop", "cancel") else self._others
        lane.submit(self._execute, name, payload, requested)

    def _abandon(self, requested: list[tuple[str, PendingCall]]) -> None:
        """Abandon these motions, in any state."""
        for _, call in requested:
            call.give_up(self._stops.submit)

    # -- in the threads of the lanes -------------------------------------------------------------------

    def _execute(self, name: str, payload: bytes, requested: tuple[str, PendingCall]) -> None:
        asked, said = Asked(), {}
        call = requested[1]
        try:
            # An unreadable stop still stops the arm.
            with contextlib.suppress(*((BadValue,) if name in ("stop", "cancel") else ())):
                asked = read(payload)
            self._note(name, payload)
            said = call.make(lambda: self._done(name, asked))
        except Exception as error:
            if not isinstance(error, LinkError):
                _log.exception("%s: %s failed", self.topic, name)
            said = _failed(error)
        finally:
            if requested in self._requested:
                self._requested.remove(requested)
        self._put("answer", {"client": asked.client, "id": asked.id, "command": name, "error": None, **said})

    def _note(self, name: str, payload: bytes) -> None:
        """Reject a message that was already executed.

        Raises:
            LocalError: If the same message arrived within the time for which a command can be valid.
        """
        if name in ("stop", "cancel"):
            return  # stopping twice does no harm
        now = self._clock.now()
        self._executed = {each: until for each, until in self._executed.items() if until > now}
        if (name, payload) in self._executed:
            raise LocalError(f"this {name} was received before; each command needs its own id")
        self._executed[name, payload] = now + LARGEST_AGE

    def _done(self, name: str, asked: Asked) -> dict[str, Any]:
        if not self._allows:
            raise LocalError("this server accepts no commands; start it with --allow-commands and without --read-only")
        if name == "cancel":
            self._cancel()
        elif name == "stop":
            self._robot.motion.stop()
        elif name not in MOTIONS:
            self._clock.check(asked)
            begin(self._robot, name, asked.arguments)
        else:
            return self._moved(name, asked)
        return {"phase": "done"}

    def _moved(self, name: str, asked: Asked) -> dict[str, Any]:
        client = asked.client
        if client not in self._present:
            raise LocalError(f"client {client!r} is not present; publish a retained message to {self.topic}/client/ID")
        held = self._held
        if held is not None and held[0] != client and not held[1].done:
            raise LocalError(f"client {held[0]} is moving the arm ({held[1].name}); another client cannot preempt it")
        self._clock.check(asked)
        motion: Motion = begin(self._robot, name, asked.arguments)
        self._held = (client, motion)
        # The client might have left while the command was being sent.
        if client not in self._present or not self._client.is_connected():
            motion.cancel()
        self._put("motion", {"id": asked.id, **_of_motion(client, motion)})
        motion.add_done_callback(lambda motion: self._put("motion", {"id": asked.id, **_of_motion(client, motion)}))
        return {"phase": motion.phase.value}

    def _lost(self, client: str) -> None:
        if self._held is not None and self._held[0] == client:
            self._cancel()

    def _cancel(self) -> None:
        held = self._held
        if held is not None:
            held[1].cancel()


def _takes_commands(robot: Robot) -> bool:
    try:
        return robot.motion is not None
    except LocalError:
        return False


def _of_motion(client: str, motion: Motion) -> dict[str, Any]:
    failed = {"error": None} if motion.error is None else _failed(motion.error)
    return {"client": client, "name": motion.name, "phase": motion.phase.value, "progress": motion.progress, **failed}


def _failed(error: BaseException) -> dict[str, Any]:
    return {"error": type(error).__name__ if isinstance(error, LinkError) else "LocalError", "message": str(error)}


def _plain(value: Any) -> Any:
    """Convert to values that JSON can represent: NaN and infinity become null."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: _plain(each) for key, each in value.items()}
    return [_plain(each) for each in value] if isinstance(value, (list, tuple)) else value

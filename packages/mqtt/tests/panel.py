"""Test client with its own connection to the broker."""

from __future__ import annotations

import json
import os
import queue
import socket
import uuid
from typing import Any

from paho.mqtt.client import Client
from paho.mqtt.enums import CallbackAPIVersion

from tests.waiting import until

__all__ = ["Panel"]


#: topics that clients publish
_ASKED = ("urlink/arm/command/", "urlink/arm/client/")


class Panel:
    """Messages that a client received, and commands that it sends.

    Attributes:
        heard: All messages of each topic, in order.

    Args:
        ca: Certificate to check an encrypted broker; None for an unencrypted broker.
    """

    def __init__(self, port: int, name: str = "panel", *, is_there: bool = True, ca: str | None = None) -> None:
        self.name = name
        self.heard: dict[str, list[Any]] = {}
        self._answers: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
        self.mqtt = Client(CallbackAPIVersion.VERSION2)
        self.mqtt.will_set(f"urlink/arm/client/{name}", b"", qos=1, retain=True)
        self.mqtt.on_message = self._came
        if ca is not None:
            self.mqtt.tls_set(ca)
        self.mqtt.connect("127.0.0.1", port, keepalive=5)
        self.mqtt.loop_start()
        self.mqtt.subscribe("urlink/#", 1)
        until(self.mqtt.is_connected)
        if is_there:
            self.mqtt.publish(f"urlink/arm/client/{name}", b"here", qos=1, retain=True).wait_for_publish(10.0)

    def _came(self, client: Client, data: Any, message: Any) -> None:
        said = message.payload if message.topic.startswith(_ASKED) else json.loads(message.payload)
        self.heard.setdefault(message.topic, []).append(said)
        if message.topic == "urlink/arm/answer" and said["client"] == self.name:
            self._answers.put(said)

    @property
    def status(self) -> dict[str, Any]:
        """Newest status."""
        until(lambda: "urlink/arm/status" in self.heard)
        found: dict[str, Any] = self.heard["urlink/arm/status"][-1]
        return found

    def of(self, topic: str) -> list[Any]:
        return self.heard.get(f"urlink/arm/{topic}", [])

    def send(self, name: str, arguments: dict[str, Any], **changed: Any) -> None:
        until(lambda: self.status.get("server"))
        status = self.status
        asked = {"client": self.name, "id": uuid.uuid4().hex, "server": status["server"], "time": status["time"]}
        self.publish(name, json.dumps({**asked, "age": 30.0, "arguments": arguments, **changed}))

    def publish(self, name: str, payload: str, *, retain: bool = False) -> None:
        """Send a command as text, which may be the same as an earlier one."""
        self.mqtt.publish(f"urlink/arm/command/{name}", payload, qos=1, retain=retain)

    def answer(self) -> dict[str, Any]:
        """Return the next answer to this client."""
        return self._answers.get(timeout=30.0)

    def ask(self, name: str, arguments: dict[str, Any] | None = None, **changed: Any) -> dict[str, Any]:
        self.send(name, arguments or {}, **changed)
        return self.answer()

    def lose(self) -> None:
        """Break the connection without disconnecting, so that the broker publishes the last will."""
        connection = self.mqtt.socket()
        assert connection is not None
        self.mqtt.reconnect_delay_set(60, 60)
        with socket.socket(fileno=os.dup(connection.fileno())) as same:
            same.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        self.mqtt.disconnect()
        self.mqtt.loop_stop()

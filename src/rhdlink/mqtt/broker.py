"""One connection to an MQTT broker. It never reconnects, because the robot may have changed its master meanwhile.

This is the only module that imports paho-mqtt. paho makes its socket and its thread itself, so a broker cannot be used
in simulated time.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from linkcore import clock
from linkcore.errors import ConnectFailed, ConnectionLost, LinkTimeout
from linkcore.names import needs
from linkcore.threads import ReentrantEvent

from ..address import MqttAddress

if TYPE_CHECKING:
    from paho.mqtt.client import MQTTMessage

#: Seconds without data after which a client asks whether the broker is still there. A broker sends the last will after
#: 1.5 times this time, if the network has failed.
KEEPALIVE = 2
#: Maximum number of seconds that one address of a broker may take to accept a connection, as part of the timeout.
_LEAST_TIMEOUT = 0.1

#: Function that gets the topic and the payload of each message, and whether the broker had retained it.
OnMessage = Callable[[str, bytes, bool], object]


class BrokerConnection:
    """A connection to a broker.

    The functions are called in the thread of paho-mqtt. They must be quick and must not raise an exception.

    Args:
        address: Address of the broker.
        timeout: Maximum time until the broker has accepted the connection, in seconds.
        will: Topic and payload that the broker publishes if this process is killed or the network fails.
        topics: Topics to subscribe to.
        on_message: Function that gets each message.
        on_lost: Function that is called when the connection is lost, with the reason.

    Raises:
        LocalError: If paho-mqtt is not installed.
        ConnectFailed: If there is no broker, or it refuses the connection.
        LinkTimeout: If the broker does not answer in time.
    """

    def __init__(
        self,
        address: MqttAddress,
        timeout: float,
        *,
        will: tuple[str, str] | None = None,
        topics: tuple[str, ...] = (),
        on_message: OnMessage | None = None,
        on_lost: Callable[[str], object] | None = None,
    ) -> None:
        with needs("mqtt", "a robot with MQTT"):
            from paho.mqtt.client import Client
            from paho.mqtt.enums import CallbackAPIVersion
        until = clock.now() + timeout
        self._address = address
        self._topics = topics
        self._take = on_message
        self._lost = on_lost
        self._answered = ReentrantEvent()
        self._refusal = ""
        self._is_closing = False
        self._is_up = False
        client = self._client = Client(CallbackAPIVersion.VERSION2, reconnect_on_failure=False)
        client.connect_timeout = max(timeout, _LEAST_TIMEOUT)
        client.on_connect = self._on_connect
        client.on_subscribe = self._on_subscribe
        client.on_disconnect = self._on_disconnect
        client.on_message = self._on_message
        if will is not None:
            client.will_set(*will, qos=0)
        try:
            client.connect(address.host, address.port, keepalive=KEEPALIVE)
        except TimeoutError as error:
            self._release()
            raise LinkTimeout(f"{address}: no answer within {timeout:g} s") from error
        except (OSError, ValueError) as error:
            self._release()
            raise ConnectFailed(f"{address}: no MQTT broker: {error}") from error
        client.loop_start()
        if not clock.wait(self._answered.wait, clock.left(until)):
            self.close()
            raise LinkTimeout(f"{address}: no answer of an MQTT broker within {timeout:g} s")
        if self._refusal:
            self.close()
            raise ConnectFailed(f"{address}: the broker refused the connection: {self._refusal}")
        self._is_up = True

    @property
    def is_up(self) -> bool:
        """Whether the connection has not been closed or lost."""
        return self._is_up and not self._is_closing

    def publish(self, topic: str, payload: str) -> None:
        """Send a message. It is dropped if the connection is lost.

        Raises:
            ConnectionLost: If the connection was lost or closed before.
        """
        if not self.is_up:
            raise ConnectionLost(f"{self._address}: the connection to the broker was lost")
        self._client.publish(topic, payload, qos=0)

    def close(self) -> None:
        """Disconnect after all messages were sent. The broker then discards the last will. Idempotent."""
        if self._is_closing:
            return
        self._is_closing = True
        with contextlib.suppress(OSError, ValueError):
            self._client.disconnect()
        # The thread ends when the broker has been sent the end of the connection, or within a second.
        self._client.loop_stop()
        self._release()

    def _release(self) -> None:
        client = self._client
        # paho leaves the socket open if the broker has not accepted the connection.
        if (connection := client.socket()) is not None:
            connection.close()
        # Break the reference cycle, so that paho closes its other sockets when this object is no longer used.
        client.on_connect = client.on_subscribe = client.on_disconnect = client.on_message = None

    # -- in the thread of paho -------------------------------------------------------------------------

    def _on_connect(self, client: Any, userdata: Any, flags: Any, reason: Any, properties: Any) -> None:
        if reason.is_failure:
            self._refusal = str(reason)
            self._answered.set()
        elif self._topics:
            client.subscribe([(topic, 0) for topic in self._topics])
        else:
            self._answered.set()

    def _on_subscribe(self, client: Any, userdata: Any, number: Any, reasons: Any, properties: Any) -> None:
        if any(reason.is_failure for reason in reasons):
            self._refusal = f"it rejects a subscription to {' or '.join(self._topics)}"
        self._answered.set()

    def _on_disconnect(self, client: Any, userdata: Any, flags: Any, reason: Any, properties: Any) -> None:
        self._is_up = False
        if not self._answered.is_set():
            self._refusal = str(reason)
            self._answered.set()
        elif not self._is_closing and self._lost is not None:
            self._lost(str(reason))

    def _on_message(self, client: Any, userdata: Any, message: MQTTMessage) -> None:
        if self._take is not None:
            self._take(message.topic, bytes(message.payload), message.retain)

"""Connections to a broker: peers that are not brokers, and lost connections."""

from __future__ import annotations

import socket
import threading

import pytest

pytest.importorskip("paho.mqtt.client")

from linkcore.errors import ConnectFailed, ConnectionLost, LinkTimeout
from rhdlink.address import MqttAddress
from rhdlink.mqtt.broker import BrokerConnection
from tests.mosquitto import needs_broker
from tests.waiting import until

pytestmark = pytest.mark.real_time


def test_peer_that_does_not_answer_is_reported_in_time() -> None:
    with (
        socket.create_server(("127.0.0.1", 0)) as server,
        pytest.raises(LinkTimeout, match=r"no answer of an MQTT broker within 0.3 s"),
    ):
        BrokerConnection(MqttAddress("127.0.0.1", server.getsockname()[1]), 0.3)


def test_peer_that_closes_the_connection_is_reported() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        thread = threading.Thread(target=lambda: server.accept()[0].close())
        thread.start()
        with pytest.raises(ConnectFailed, match="the broker refused the connection"):
            BrokerConnection(MqttAddress("127.0.0.1", server.getsockname()[1]), 10.0)
        thread.join(10.0)


@needs_broker
def test_closed_connection_rejects_messages(broker: int) -> None:
    lost: list[str] = []
    connection = BrokerConnection(MqttAddress("127.0.0.1", broker), 10.0, on_lost=lost.append)
    connection.publish("a", "b")
    connection.close()
    connection.close()
    with pytest.raises(ConnectionLost, match="the connection to the broker was lost"):
        connection.publish("a", "b")
    assert not lost


@needs_broker
def test_last_will_is_published_only_without_a_disconnect(broker: int) -> None:
    address = MqttAddress("127.0.0.1", broker)
    heard: list[str] = []
    listener = BrokerConnection(
        address, 10.0, topics=("will/#",), on_message=lambda topic, payload, is_retained: heard.append(topic)
    )
    try:
        BrokerConnection(address, 10.0, will=("will/closed", "x")).close()
        lost: list[str] = []
        cut = BrokerConnection(address, 10.0, will=("will/cut", "x"), on_lost=lost.append)
        connection = cut._client.socket()
        assert isinstance(connection, socket.socket)
        connection.shutdown(socket.SHUT_RDWR)
        until(lambda: heard and lost)
        assert heard == ["will/cut"]
        cut.close()
    finally:
        listener.close()

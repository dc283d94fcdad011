"""The example of a robot behind an MQTT broker, with a real one (mosquitto), where there is one."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import urlink
from tests.mosquitto import needs_broker
from tests.waiting import until
from urlink.simulator import Controller

mqtt = pytest.importorskip("paho.mqtt.client")

EXAMPLE = Path(__file__).parents[2] / "examples" / "mqtt_robot.py"
HOME = [0.0, -1.5, 1.5, -1.5, -1.5, 0.0]

# The example is a process that has to start.
pytestmark = [needs_broker, pytest.mark.real_time, pytest.mark.timeout(240)]


def test_a_robot_behind_a_broker(broker: int) -> None:
    heard: dict[str, list[Any]] = {"arm/state": [], "arm/motion": []}
    with Controller("UR5e", "5.11") as controller, urlink.connect(controller.address) as robot:
        command = [sys.executable, "-W", "error", str(EXAMPLE), controller.address, "--port", str(broker)]
        process = subprocess.Popen(command)
        try:
            watch = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2)
            watch.on_message = lambda client, userdata, message: heard[message.topic].append(
                json.loads(message.payload)
            )
            watch.connect("127.0.0.1", broker)
            for topic in heard:
                watch.subscribe(topic)
            watch.loop_start()
            until(lambda: sum("q" in state for state in heard["arm/state"]) > 5, 90.0)

            panel = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2)
            panel.will_set("arm/gone/panel", "")
            panel.connect("127.0.0.1", broker)
            panel.loop_start()
            until(panel.is_connected)
            panel.publish("arm/move_joints", json.dumps({"q": HOME, "client": "panel"}))
            until(lambda: heard["arm/motion"], 60.0)
            assert heard["arm/motion"] == [{"phase": "done", "error": None}]
            panel.publish("arm/move_joints", json.dumps({"q": [0.0]}))
            until(lambda: len(heard["arm/motion"]) == 2)
            assert heard["arm/motion"][1]["error"].startswith("BadValue")

            panel.publish("arm/move_joints", json.dumps({"q": [1.0, *HOME[1:]], "speed": 0.1, "client": "panel"}))
            until(lambda: robot.realtime.wait().q_actual[0] > 0.02)
            # Lost, rather than gone in order: the broker says its last will.
            panel.socket().shutdown(socket.SHUT_RDWR)
            panel.loop_stop()
            until(lambda: len(heard["arm/motion"]) == 3)
            assert heard["arm/motion"][2]["phase"] == "cancelled"
            assert robot.realtime.wait().q_actual[0] < 0.9
            watch.disconnect()
            watch.loop_stop()
        finally:
            process.terminate()
            process.wait(10.0)

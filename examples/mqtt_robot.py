"""A robot behind an MQTT broker: its state as JSON, and motions that end when their client is gone.

    pip install urlink[mqtt]
    python mqtt_robot.py 192.168.56.101 --broker localhost --name arm

Topics, below the name of the robot:

    arm/state             what it does, ten times a second; retained
    arm/move_joints       {"q": [...], "speed": 1.0, "client": "panel"} moves it
    arm/stop              anything: stops it
    arm/gone/panel        stops what the client "panel" moves: let it be the last will of that client
    arm/motion            what became of each motion

The arm also stops when this program loses the broker: then nobody could stop it any more.
"""

import argparse
import contextlib
import json
import time
from typing import Any

from paho.mqtt.client import Client, MQTTMessage
from paho.mqtt.enums import CallbackAPIVersion

import urlink


class Bridge:
    """One robot and one connection to a broker."""

    def __init__(self, robot: urlink.Robot, name: str, broker: str, port: int) -> None:
        self.robot = robot
        self.name = name
        self.mover: str | None = None
        self.client = Client(CallbackAPIVersion.VERSION2)
        self.client.on_connect = self.on_connect
        self.client.on_disconnect = lambda *arguments: self.stop()
        self.client.on_message = self.on_message
        self.client.will_set(f"{name}/state", json.dumps({"connection": "lost"}), retain=True)
        self.client.connect(broker, port, keepalive=5)
        self.client.loop_start()

    def on_connect(self, client: Client, *rest: Any) -> None:
        # Here, so that it holds for the connection after a lost one too.
        for topic in ("move_joints", "stop", "gone/+"):
            client.subscribe(f"{self.name}/{topic}", qos=1)

    def on_message(self, client: Client, userdata: Any, message: MQTTMessage) -> None:
        topic = message.topic.removeprefix(f"{self.name}/")
        if message.retain:
            return  # said before we were here: nobody waits for it now
        if topic == "stop" or topic == f"gone/{self.mover}":
            self.stop()
        elif topic == "move_joints":
            self.move(message.payload)

    def move(self, payload: bytes) -> None:
        try:
            asked = json.loads(payload)
            motion = self.robot.motion.move_joints(asked["q"], asked.get("speed", 1.05))
        except urlink.LinkError as error:
            self.tell("refused", error)
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            self.tell("refused", urlink.BadValue(f"expected an object with q: {error!r}"))
        else:
            self.mover = asked.get("client")
            motion.add_done_callback(lambda motion: self.tell(motion.phase.value, motion.error))

    def stop(self) -> None:
        motion = self.robot.motion.current
        if motion is not None:
            motion.cancel()

    def tell(self, phase: str, error: Exception | None) -> None:
        said = {"phase": phase, "error": None if error is None else f"{type(error).__name__}: {error}"}
        self.client.publish(f"{self.name}/motion", json.dumps(said), qos=1)

    def tell_state(self) -> None:
        state = self.robot.realtime.latest
        if state is not None and state.received is not None:
            said = {
                "connection": self.robot.realtime.connection.value,
                "age": state.received.age,
                "q": state.q_actual.tolist(),
                "pose": state.tool_vector_actual.tolist(),
            }
            self.client.publish(f"{self.name}/state", json.dumps(said), retain=True)

    def close(self) -> None:
        self.stop()
        self.client.publish(f"{self.name}/state", json.dumps({"connection": "closed"}), retain=True).wait_for_publish(1)
        self.client.disconnect()
        self.client.loop_stop()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("address", nargs="?", default="sim://")
    parser.add_argument("--broker", default="localhost")
    parser.add_argument("--port", type=int, default=1883)
    parser.add_argument("--name", default="arm")
    parser.add_argument("--duration", type=float, default=float("inf"), help="seconds (until Ctrl-C)")
    args = parser.parse_args()
    with urlink.connect(args.address) as robot:
        robot.realtime.wait()
        with contextlib.closing(Bridge(robot, args.name, args.broker, args.port)) as bridge:
            end = time.monotonic() + args.duration
            while time.monotonic() < end:
                bridge.tell_state()
                time.sleep(0.1)


if __name__ == "__main__":
    with contextlib.suppress(KeyboardInterrupt):
        main()

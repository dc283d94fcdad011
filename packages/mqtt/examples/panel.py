"""Read a robot through a broker, and move its base by one degree; see the page *MQTT*.

urlink serve mqtt arm=sim://ur5e --broker localhost --allow-commands
python panel.py --broker localhost arm
"""

import argparse
import json
import math
import queue
import uuid
from typing import Any

from paho.mqtt.client import Client
from paho.mqtt.enums import CallbackAPIVersion

CLIENT = "panel"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("name", help="name of the robot")
    parser.add_argument("--broker", default="localhost")
    parser.add_argument("--port", type=int, default=1883)
    args = parser.parse_args()
    arm = f"urlink/{args.name}"
    heard: queue.SimpleQueue[tuple[str, Any]] = queue.SimpleQueue()

    def next_of(kind: str) -> Any:
        while True:
            topic, said = heard.get(timeout=30.0)
            if topic == f"{arm}/{kind}":
                return said

    client = Client(CallbackAPIVersion.VERSION2)
    client.on_message = lambda client, data, message: heard.put((message.topic, json.loads(message.payload)))
    # When this program ends, the broker publishes this will, and the motion ends.
    client.will_set(f"{arm}/client/{CLIENT}", b"", qos=1, retain=True)
    client.connect(args.broker, args.port, keepalive=5)
    client.loop_start()
    client.publish(f"{arm}/client/{CLIENT}", b"here", qos=1, retain=True).wait_for_publish(10.0)
    client.subscribe([(f"{arm}/{kind}", 1) for kind in ("status", "answer", "motion")])
    status = next_of("status")
    q = status["q_actual"]
    print(f"{args.name}: base at {math.degrees(q[0]):.2f} degrees, {status['safety_mode']}")
    q[0] += math.radians(1.0)
    command = {"client": CLIENT, "id": uuid.uuid4().hex, "age": 5.0, **{key: status[key] for key in ("server", "time")}}
    client.publish(f"{arm}/command/move_joints", json.dumps({**command, "arguments": {"q": q, "speed": 0.2}}), qos=1)
    print("answer:", next_of("answer"))
    while (motion := next_of("motion"))["phase"] in ("sent", "running"):
        print(motion["name"], motion["phase"])
    print(motion["name"], motion["phase"])
    client.publish(f"{arm}/client/{CLIENT}", b"", qos=1, retain=True).wait_for_publish(10.0)
    client.disconnect()
    client.loop_stop()


if __name__ == "__main__":
    main()
